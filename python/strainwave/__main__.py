"""`python -m strainwave`: the command line where its script is not on the path."""

from strainwave.cli import main

main()
