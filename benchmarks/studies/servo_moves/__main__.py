"""Run the study: tables in the terminal, and a page with plots."""

from __future__ import annotations

import argparse
from collections.abc import Iterable
from pathlib import Path

import benchmarks.studies.servo_moves as study
from benchmarks.console import Console
from benchmarks.studies.servo_moves.moves import moves, tracking
from benchmarks.studies.servo_moves.page import (
    LOOP_HEADS,
    MOVE_HEADS,
    loop_rows,
    move_rows,
    render,
)
from benchmarks.studies.servo_moves.sweep import sweep
from benchmarks.studies.servo_moves.tuned import arms
from strainwave.report.document.blocks import Row, table
from strainwave.report.terminal import printed_table


def main() -> None:
    parser = argparse.ArgumentParser(description=study.__doc__)
    parser.add_argument("--arms", type=int, default=1, help="drawn arms, after the built-in one")
    parser.add_argument("--draws", type=int, default=1000)
    parser.add_argument("--out", type=Path, default=Path("build/servo-moves.html"))
    options = parser.parse_args()
    console, results = Console(width=110), []
    for tuned in arms(options.arms, options.draws):
        found = tuned.name, moves(tuned), tracking(tuned), list(sweep(tuned))
        results.append(found)
        console.print(f"[bold]{tuned.name}[/bold]")
        _print(console, MOVE_HEADS, move_rows(found[1]))
        console.print(found[2])
        _print(console, LOOP_HEADS, loop_rows(found[3]))
    options.out.parent.mkdir(parents=True, exist_ok=True)
    options.out.write_text(render(results))
    console.print(f"written: {options.out}")


def _print(console: Console, heads: Row, rows: Iterable[Row]) -> None:
    for each in table("", heads, rows):
        console.print(printed_table(each))


if __name__ == "__main__":
    main()
