"""Write the comparisons as HTML, JSON and Markdown."""

from __future__ import annotations

from collections.abc import Callable
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
from strainwave.virtual.scara import BuiltInArm


def write_comparisons(
    identification: Identification,
    folder: Path,
    *,
    seed: int,
    progress: Callable[[str], None],
    seeds: int,
    as_published: bool,
    built_in: BuiltInArm,
) -> tuple[Tally, ...]:
    """Test the source's claims on the built-in arm; write comparisons.html, .json and .md.

    `identification` is that of the arm `built_in`; its tuned parameters are compared if it has
    them. `seed` is the first of `seeds` seeds. `as_published` adds the published settings.
    """
    numbers = range(seed, seed + seeds)
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
    document = document_of(tallies, numbers)
    files = {
        "comparisons.html": page.encode(),
        "comparisons.json": to_json(document),
        "comparisons.md": to_markdown(document).encode(),
    }
    write_whole(folder, files)
    return tallies
