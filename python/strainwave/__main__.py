"""The process of the command line: `strainwave`, and `python -m strainwave` off the path."""

from __future__ import annotations

import sys


def main() -> None:
    """Listen for Ctrl-C before anything heavy is imported, then run the command line."""
    from strainwave.io import interrupt

    interrupt.listen()
    try:
        from strainwave.cli import main as run

        run()
    except interrupt.Interrupted:
        interrupt.say()
        sys.exit(interrupt.STOPPED)


if __name__ == "__main__":
    main()
