"""Records for people: report, figures, notebook display, terminal. No stage imports this."""
