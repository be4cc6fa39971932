"""The comparisons as files: claims put to the built-in arm, as a page, as JSON and as Markdown."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from strainwave.domain import Identification, Tally
from strainwave.io.atomic_files import write_whole
from strainwave.paper import OWN, PUBLISHED, compare_seeds, document_of, to_json, to_markdown
from strainwave.presentation.report import render_comparisons
from strainwave.virtual import scara


def write_comparisons(
    identification: Identification,
    folder: Path,
    *,
    seed: int,
    progress: Callable[[str], None],
    seeds: int = 1,
    as_published: bool = False,
) -> tuple[Tally, ...]:
    """The source's claims put to the built-in arm: comparisons.html, .json and .md.

    `identification`: Of that arm; its tuned parameters are compared, if it has them. `seed`: The
    first. `seeds`: How many. `as_published`: Whether by the source's settings as well.
    """
    numbers = range(seed, seed + seeds)
    settings = (OWN, PUBLISHED) if as_published else (OWN,)
    found = compare_seeds(numbers, tuned=identification.tuned, settings=settings, progress=progress)
    progress("writing the comparisons")
    page = render_comparisons(found, arm=scara.DESCRIPTION)
    document = document_of(found, numbers)
    files = {
        "comparisons.html": page.encode(),
        "comparisons.json": to_json(document),
        "comparisons.md": to_markdown(document).encode(),
    }
    write_whole(folder, files)
    return found
