"""Write the comparisons as HTML, JSON and Markdown."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from strainwave.domain import Identification, Tally
from strainwave.io.atomic_files import write_whole
from strainwave.paper import (
    OWN_SETTINGS,
    PUBLISHED_SETTINGS,
    compare_seeds,
    document_of,
    to_json,
    to_markdown,
)
from strainwave.presentation.report import render_comparisons
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
    from strainwave.presentation.matplotlib_backend import images

    return {
        f"images/comparisons/{arm}-{t.first.figure}-{t.first.protocol}.png": images(
            t.first.plots[0], resolution=_RESOLUTION
        )["png"]
        for t in tallies
        if t.first.plots
    }
