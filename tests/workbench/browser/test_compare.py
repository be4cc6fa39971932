"""Compare two results in a browser."""

from __future__ import annotations

from typing import Any

import strainwave as sw


def test_two_results_side_by_side(visit: Any) -> None:
    result = sw.identify(visit.folder / "arm" / "study.toml", stages=("rigid", "decoupled"))
    for name in ("before", "after"):
        folder = visit.folder / "arm" / "runs" / name
        folder.mkdir(parents=True)
        result.save(folder / "result.json")
        result.report(folder / "report.html")
    page = visit.open("/compare/arm/study.toml")
    visit.wait_until("!document.querySelector('#compare').disabled")
    page.focus("#compare")
    page.keyboard.press("Enter")
    page.wait_for_selector("#verdict:has-text('the same logs')")
    for name in ("intervals", "bode", "step", "poles"):
        page.wait_for_selector(f"#{name}[data-drawn]")
    page.wait_for_selector("#figures .plot[data-drawn] >> nth=1")
    assert "alpha" in page.inner_text("#parameters")
    visit.check_accessibility()
    page.click("#save")
    page.wait_for_selector("#saved a")
