"""Other tools at the same work, each at its best; `pip install -r benchmarks/peers.txt` gets them.

Each module has one tool, imported where it is called. A tool that is not installed is skipped, and
the table says so.
"""
