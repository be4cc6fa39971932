"""Screenshots of every page of the workbench: light and dark, 1280 and 2560 pixels wide.

    python -m benchmarks.workbench_screenshots FOLDER

FOLDER is served as `strainwave serve` does; its first study with a finished run is shown. The
pictures are in `build/workbench`. Needs Playwright and Chromium.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from benchmarks.bench_workbench import chromium, serve
from strainwave.workbench.runs import Runs
from strainwave.workbench.web import PAGE_TABS, STUDY_TABS
from strainwave.workbench.workspace import Workspace

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

_WIDTHS, _HEIGHT = (1280, 2560), 900
_SETTLE_MS = 2500  # after the last change of a page


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--out", type=Path, default=Path("build/workbench"))
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    study = _study_with_run(options.folder)
    pages = {key or "studies": f"/{key}" for key, _, _ in PAGE_TABS}
    pages |= {key: f"/{key}/{study}" for key, _, _ in STUDY_TABS}
    with serve(options.folder) as link, _browser() as browser:
        url = link.partition("/?")[0]
        for scheme in ("light", "dark"):
            for width in _WIDTHS:
                page = browser.new_page(
                    viewport={"width": width, "height": _HEIGHT}, color_scheme=scheme
                )
                page.goto(link)
                for name, path in pages.items():
                    page.goto(f"{url}{path}")
                    _act(page, name)
                    page.wait_for_timeout(_SETTLE_MS)
                    page.screenshot(path=options.out / f"{name}-{scheme}-{width}.png")
                page.close()
    print(f"{len(pages) * 4} pictures are in {options.out}")


def _act(page: Page, name: str) -> None:
    """Bring a page into the state that a user works with."""
    if name == "estimate":
        page.click("#orders")
        page.wait_for_selector("#order-plot[data-drawn]")
    elif name == "check":
        page.click("#check")
        page.wait_for_selector("#signal[data-drawn]")
    elif name == "compare" and page.locator("#results input:checked").count() > 1:
        page.click("#compare")
        page.wait_for_selector("#bode[data-drawn]")


def _study_with_run(folder: Path) -> str:
    workspace = Workspace(folder.resolve(), 0)
    studies = workspace.studies()
    finished = [
        study
        for study in studies
        if any(run.state == "done" for run in Runs(workspace.study(study)).all())
    ]
    return (finished or studies)[0]


@contextmanager
def _browser() -> Iterator[Browser]:
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium(), args=["--no-sandbox"])
        yield browser
        browser.close()


if __name__ == "__main__":
    main()
