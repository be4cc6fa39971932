"""Terminal output of a servo design."""

from __future__ import annotations

from pathlib import Path

from rich.console import Console
from rich.text import Text

from strainwave.presentation.terminal import print_tables
from strainwave.servo_design.design import ServoDesign
from strainwave.servo_design.report import words


def print_design(design: ServoDesign, page: Path, *, console: Console | None = None) -> None:
    """Print current servo, designed gains, margins, limits, shapers, observers and moves."""
    console = console or Console(highlight=False)
    for line in words.current_sentences(design):
        console.print(Text(line))
    before = (words.gains, words.behaviour, words.worst_margin_table)
    print_tables(console, *(each(design) for each in before))
    for joint in design.joints:
        console.print(Text(words.limit_sentence(design, joint)))
    after = (words.shapers(design, "Input shapers"), words.estimation(design))
    print_tables(console, *after, words.dampings(design))
    for line in (*words.observer_gaps(design), *words.damping_sentences(design)):
        console.print(Text(line))
    print_tables(console, words.moves(design))
    if design.refusal:
        console.print(Text(f"note: no moves are compared: {design.refusal}"), style="yellow")
    console.print(Text(f"written: {page}"), soft_wrap=True)
