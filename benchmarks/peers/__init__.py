"""Other tools for the same work; install them with `pip install -r benchmarks/peers.txt`.

Tools are imported where they are called. The table marks a tool that is not installed.
"""
