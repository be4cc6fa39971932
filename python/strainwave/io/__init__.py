"""Files: study files, logs, parameters, results; whole or not at all, and faults named by place."""
