"""Write the comparisons as HTML, JSON and Markdown; print their verdicts."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from rich.console import Console
from rich.text import Text

from reproduction import (
    OWN_SETTINGS,
    PUBLISHED_SETTINGS,
    compare_seeds,
    document_of,
    to_json,
    to_markdown,
)
from reproduction.page import render_comparisons
from reproduction.records import Tally
from strainwave.domain import Identification
from strainwave.io.atomic_files import write_whole
from strainwave.virtual.scara import ARMS

_RESOLUTION = 72  # [1/in] of the images, which the page shows side by side


def write_comparisons(
    identification: Identification,
    folder: Path,
    *,
    seed: int,
    progress: Callable[[str], None],
    seeds: int,
    as_published: bool,
    arm: str,
    figures: bool,
) -> tuple[Tally, ...]:
    """Test the source's claims on the built-in arm; write comparisons.html, .json and .md.

    `identification` is that of the built-in arm named `arm`; its tuned parameters are compared if
    it has them. `seed` is the first of `seeds` seeds. `as_published` adds the published settings,
    `figures` an image of each figure.
    """
    numbers, built_in = range(seed, seed + seeds), ARMS[arm]
    settings = (OWN_SETTINGS, PUBLISHED_SETTINGS) if as_published else (OWN_SETTINGS,)
    tallies = compare_seeds(
        numbers,
        whole_arm=identification.whole_arm,
        settings=settings,
        built_in=built_in,
        progress=progress,
    )
    progress("writing the comparisons")
    page = render_comparisons(tallies, arm=built_in.description)
    images = _images(tallies, arm) if figures else {}
    shown = sorted({t.first.figure for t in tallies if t.first.plots}) if figures else []
    document = document_of(tallies, numbers, arm, shown)
    files = {
        "comparisons.html": page.encode(),
        "comparisons.json": to_json(document),
        "comparisons.md": to_markdown(document).encode(),
        **images,
    }
    write_whole(folder, files)
    return tallies


def _images(tallies: Sequence[Tally], arm: str) -> dict[str, bytes]:
    """PNG files of the first plot of each figure, by path."""
    from strainwave.report.matplotlib_backend import images

    return {
        f"images/comparisons/{arm}-{t.first.figure}-{t.first.protocol}.png": images(
            t.first.plots[0], resolution=_RESOLUTION
        )["png"]
        for t in tallies
        if t.first.plots
    }


def print_comparisons(
    tallies: Sequence[Tally], folder: Path, *, console: Console | None = None
) -> None:
    """Print each claim with its verdict and numbers, and the files in `folder`."""
    console = console or Console(highlight=False)
    for tally in tallies:
        c = tally.first
        protocol = "" if c.protocol == "own" else " (as published)"
        line = Text(f"Fig. {c.figure:>2}{protocol}: {c.claim} {tally.verdict}: {c.message}")
        is_shown = tally.count("shown") == len(tally.runs)
        console.print(line, style="" if is_shown else "yellow", soft_wrap=True)
        for reason in c.reasons:
            console.print(Text(f"         {reason}"), style="yellow", soft_wrap=True)
    for name in ("comparisons.html", "comparisons.json", "comparisons.md"):
        console.print(Text(f"written: {folder / name}"), soft_wrap=True)
