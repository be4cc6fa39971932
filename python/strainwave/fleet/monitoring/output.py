"""Files, terminal output and page headers that comparisons and trends share."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.text import Text

from strainwave.io.atomic_files import write_whole
from strainwave.report.document.blocks import Callout, Mark, Span, Table, paragraph
from strainwave.report.terminal import printed_table


def write(name: str, document: dict[str, Any], page: str, folder: Path) -> None:
    """Write name.json and name.html into a folder."""
    text = json.dumps(document, indent=2, ensure_ascii=False, allow_nan=False)
    write_whole(folder, {f"{name}.json": (text + "\n").encode(), f"{name}.html": page.encode()})


def print_tables(console: Console, tables: Iterable[Table]) -> None:
    """Print tables without truncation; the terminal wraps rows that are too long."""
    for printed in map(printed_table, tables):
        wide = console.options.update(width=10_000)
        printed.width = printed.__rich_measure__(console, wide).maximum
        console.print(printed, crop=False, no_wrap=True, overflow="ignore")


def print_end(
    console: Console,
    name: str,
    verdict: str,
    notes: Sequence[str],
    folder: Path | None,
    *,
    bad: bool,
) -> None:
    """Print notes, the verdict, and the paths of name.html and name.json if they were written."""
    for note in notes:
        console.print(Text(f"note: {note}"), style="yellow")
    console.print(Text(f"verdict: {verdict}"), style="bold red" if bad else "bold")
    if folder is not None:
        for file in (f"{name}.html", f"{name}.json"):
            console.print(Text(f"written: {folder / file}"), soft_wrap=True)


def page_summary(verdict: str, facts: Sequence[str], notes: Sequence[str], *, bad: bool) -> Callout:
    """The beginning of a page: verdict, facts, notes; `bad` colours a verdict that needs action."""
    mark: Mark = "bad" if bad else "good"
    lead = [paragraph(Span(f"{verdict[0].upper()}{verdict[1:]}.", strong=True))]
    lead += [paragraph(f"{fact}.") for fact in facts]
    lead += [paragraph(f"Note: {note}.") for note in notes]
    return Callout(mark, tuple(lead))
