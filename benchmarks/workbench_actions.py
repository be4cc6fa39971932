"""Count clicks and keys from dropped logs to a result, on the pages of the workbench.

    python -m benchmarks.workbench_actions FOLDER...

Each FOLDER has the logs of one rig, and may have its URDF and its `study.toml`. The logs are
dropped without the study; its values are then typed into the form, or dropped as a data sheet.
Needs Playwright and Chromium.
"""

from __future__ import annotations

import argparse
import shutil
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

from rich.table import Table

from benchmarks.bench_workbench import chromium, serve
from benchmarks.console import Console
from strainwave.io.atomic_files import decode, parse_toml

if TYPE_CHECKING:
    from playwright.sync_api import Page

_TIMEOUT_MS = 300_000  # of a run on a busy machine


@dataclass
class Hands:
    """A user of a page, whose actions are counted."""

    page: Page
    clicks: int = 0  # a drop is one
    keys: int = 0  # all, also those of values
    typed: int = 0  # keys of values

    def drop(self, paths: Sequence[Path]) -> None:
        """Drop files or folders."""
        session = self.page.context.new_cdp_session(self.page)
        data = {"items": [], "files": [str(path) for path in paths], "dragOperationsMask": 1}
        for kind in ("dragEnter", "dragOver", "drop"):
            event = {"type": kind, "x": 400, "y": 400, "data": data}
            session.send("Input.dispatchDragEvent", event)
        self.clicks += 1

    def click(self, selector: str) -> None:
        """Click the first element, on a page whose scripts have run."""
        self.page.wait_for_load_state()
        self.page.locator(selector).first.click()
        self.clicks += 1

    def enter(self, text: str) -> None:
        """Type a value and press Enter."""
        self.page.keyboard.type(text)
        self.page.keyboard.press("Enter")
        self.keys += len(text) + 1
        self.typed += len(text)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folders", type=Path, nargs="+")
    table = Table("logs", "values", "clicks", "keys", "of them values", "status", "time")
    for folder in parser.parse_args().folders:
        for is_typed in (True, False):
            hands, status, seconds = _identify(folder, is_typed=is_typed)
            counts = map(str, (hands.clicks, hands.keys, hands.typed))
            how = "typed" if is_typed else "data sheet"
            table.add_row(folder.name, how, *counts, status, f"{seconds:.0f} s")
    Console().print(table)


def _identify(folder: Path, *, is_typed: bool) -> tuple[Hands, str, float]:
    """Go from the dropped logs to the status of the run."""
    from playwright.sync_api import sync_playwright

    with TemporaryDirectory() as name, sync_playwright() as playwright:
        rig, served = Path(name) / "logs", Path(name) / "served"
        served.mkdir()
        ignored = ["*.json", *(["study.toml"] if is_typed else [])]
        shutil.copytree(folder, rig, ignore=shutil.ignore_patterns(*ignored))
        if not is_typed:  # a sheet with the values alone
            text = (rig / "study.toml").read_text().split("[[experiment]]")[0]
            (rig / "study.toml").chmod(0o644)
            (rig / "study.toml").write_text(text)
        browser = playwright.chromium.launch(executable_path=chromium(), args=["--no-sandbox"])
        with serve(served) as link:
            page = browser.new_page()
            page.set_default_timeout(_TIMEOUT_MS)
            page.goto(link)
            hands, begin = Hands(page), time.monotonic()
            hands.drop([rig])
            page.wait_for_url("**/study/**")
            page.wait_for_selector("#signals polyline")
            if is_typed:
                _type_values(hands, folder / "study.toml")
            page.wait_for_selector("#state[data-state=valid]")
            hands.click("nav >> text=Check")
            hands.click("#check")
            hands.click("#go")
            hands.click("#start:not([disabled])")
            page.wait_for_selector("tr[data-run][data-state=done]")
            status = page.locator("tr[data-run] .badge").first.inner_text()
            seconds = time.monotonic() - begin
        browser.close()
    return hands, status, seconds


def _type_values(hands: Hands, study: Path) -> None:
    """Type every value that is missing, as the study has it."""
    page, values = hands.page, parse_toml(decode(study.read_bytes(), study), study)
    missing = page.locator("#missing-list button")
    while count := missing.count():
        field = page.evaluate("document.activeElement.id")
        if not field.startswith("field-"):
            hands.click("#missing-list button")
            continue
        value: Any = values
        for key in field.split("-")[1:]:
            value = value[int(key) if key.isdigit() else key]
        hands.enter(", ".join(map(str, value)) if isinstance(value, list) else str(value))
        page.locator("#missing-list li").nth(count - 1).wait_for(state="detached")


if __name__ == "__main__":
    main()
