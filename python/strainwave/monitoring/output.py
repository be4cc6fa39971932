"""What a comparison and a trend share in how they are written, printed and headed."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table
from rich.text import Text

from strainwave.io.atomic_files import write_whole
from strainwave.presentation.report.blocks import Callout, Mark, Span, paragraph

REACH = 1.96
"""Deviations of a 95 % interval."""

_NEVER = 1e-16  # below it a p-value says nothing more
_VERDICT = "verdict: "


def write(name: str, document: dict[str, Any], page: str, folder: Path) -> None:
    """Write name.json and name.html.

    Parameters
    ----------
    name : str
    document : dict
        Plain JSON values.
    page : str
        HTML.
    folder : Path

    Raises
    ------
    InvalidInput
        The folder cannot be written to.
    """
    text = json.dumps(document, indent=2, ensure_ascii=False, allow_nan=False)
    write_whole(folder, {f"{name}.json": (text + "\n").encode(), f"{name}.html": page.encode()})


def printed_table() -> Table:
    """An empty table of the terminal."""
    return Table(box=None, padding=(0, 1, 0, 0), header_style="bold")


def print_end(
    console: Console,
    name: str,
    verdict: str,
    notes: Sequence[str],
    folder: Path | None,
    *,
    bad: bool,
) -> None:
    """Print notes, verdict, and where the files are.

    Parameters
    ----------
    console : rich Console
    name : str
        Of the files.
    verdict : str
    notes : sequence of str
    folder : Path or None
        Where the files were written.
    bad : bool
        Whether the verdict asks for action.
    """
    for note in notes:
        console.print(Text(f"note: {note}"), style="yellow")
    console.print(Text(f"{_VERDICT}{verdict}"), style="bold red" if bad else "bold")
    if folder is not None:
        for file in (f"{name}.html", f"{name}.json"):
            console.print(Text(f"written: {folder / file}"), soft_wrap=True)


def opening(verdict: str, facts: Sequence[str], notes: Sequence[str], *, bad: bool) -> Callout:
    """What a page begins with: verdict, facts, notes.

    Parameters
    ----------
    verdict : str
    facts, notes : sequence of str
    bad : bool
        Whether the verdict asks for action.

    Returns
    -------
    Callout
    """
    mark: Mark = "bad" if bad else "good"
    lead = [paragraph(Span(f"{verdict[0].upper()}{verdict[1:]}.", strong=True))]
    lead += [paragraph(f"{fact}.") for fact in facts]
    lead += [paragraph(f"Note: {note}.") for note in notes]
    return Callout(mark, tuple(lead))


def probability(p: float) -> str:
    """A p-value in words.

    Parameters
    ----------
    p : float

    Returns
    -------
    str
        With two digits, one where it is small.
    """
    if p < _NEVER:
        return f"<{_NEVER:.0e}"
    return f"{p:.2g}" if p >= 1e-4 else f"{p:.0e}"
