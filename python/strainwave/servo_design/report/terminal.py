"""Terminal output of a servo design."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from rich.console import Console
from rich.text import Text

from strainwave.presentation.report.blocks import Cell, Row
from strainwave.presentation.terminal import printed_table
from strainwave.servo_design.design import ServoDesign
from strainwave.servo_design.report import words


def print_design(design: ServoDesign, page: Path, *, console: Console | None = None) -> None:
    """Print current servo, designed gains, margins, limits, shapers, observers and moves."""
    console = console or Console(highlight=False)
    for line in words.current_sentences(design):
        console.print(Text(line))
    _print(
        console,
        "Gains",
        words.servo_heads(design),
        words.gain_rows(design),
    )
    title = "Behaviour, worst over all plants"
    _print(console, title, words.BEHAVIOUR_HEADS, words.behaviour_rows(design))
    _print(console, "Worst margins", words.MARGIN_HEADS, words.margin_rows(design))
    for joint in design.joints:
        console.print(Text(words.limit_sentence(design, joint)))
    _print(console, "Input shapers", words.SHAPER_HEADS, words.shaper_rows(design))
    title = words.estimation_title()
    _print(console, title, words.ESTIMATION_HEADS, words.estimation_rows(design))
    title = "Least damping of the links over all plants"
    _print(console, title, words.DAMPING_HEADS, words.damping_rows(design))
    for line in (*words.observer_gaps(design), *words.damping_sentences(design)):
        console.print(Text(line))
    _print(console, words.move_title(), words.move_heads(design), words.move_rows(design))
    if design.refusal:
        console.print(Text(f"note: no moves are compared: {design.refusal}"), style="yellow")
    console.print(Text(f"written: {page}"), soft_wrap=True)


def _print(console: Console, title: str, heads: Row, rows: Iterable[Row]) -> None:
    """Print a table with its title, or nothing without rows."""
    cells = [[each.text if isinstance(each, Cell) else each for each in row] for row in rows]
    if not cells:
        return
    table = printed_table(*heads)
    for row in cells:
        table.add_row(*map(Text, row))
    console.print()
    console.print(Text(title), style="bold")
    console.print(table)
