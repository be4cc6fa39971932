"""Entry point of the command line: `strainwave` and `python -m strainwave`."""

from __future__ import annotations

import sys


def main() -> None:
    """Handle Ctrl-C before the slow imports begin, then run the command line."""
    from strainwave.io import interrupt, system

    interrupt.listen()
    system.print_any_letter()
    try:
        from strainwave.cli import main as run

        run()
    except interrupt.Interrupted:
        interrupt.report()
        sys.exit(interrupt.EXIT_CODE)


if __name__ == "__main__":
    main()
