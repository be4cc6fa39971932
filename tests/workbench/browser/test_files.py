"""Downloads and exports in a browser."""

from __future__ import annotations

from typing import Any

import strainwave as sw


def test_export_and_download(visit: Any) -> None:
    folder = visit.folder / "arm" / "runs" / "one"
    folder.mkdir(parents=True)
    (folder / "run.json").write_text(
        '{"name": "one", "kind": "identify", "created": "2026-01-01T00:00:00", "state": "done",'
        ' "commands": [["identify", "study.toml", "--out", "."]]}'
    )
    result = sw.identify(visit.folder / "arm" / "study.toml", stages=("rigid", "decoupled"))
    result.save(folder / "result.json")
    page = visit.open("/files/arm/study.toml")
    page.wait_for_selector("#files tr")
    visit.check_accessibility()
    page.select_option("#format", "c")
    page.focus("#make")
    page.keyboard.press("Enter")
    with page.expect_download() as download:
        page.click("#notes a")
    assert download.value.suggested_filename == "arm.h"
    with page.expect_download() as download:
        page.click("#zip")
    assert download.value.suggested_filename == "one.zip"
    page.context.grant_permissions(["clipboard-read", "clipboard-write"])
    page.click("#copy")
    page.wait_for_selector("#message:not([hidden])")
    assert "sw.identify('study.toml')" in page.evaluate("navigator.clipboard.readText()")
    assert page.locator("#script").is_hidden()
