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
    page.wait_for_selector("#tests .badge >> nth=7")
    page.wait_for_selector("#difference[data-drawn]")
    page.wait_for_selector("#bode-difference[data-drawn]")
    count = page.locator("#parameters tr").count()
    page.check("#only-changed")  # the results are equal
    assert page.locator("#parameters tr").count() == 0
    assert f"{count} of {count} rows" in page.inner_text("#hidden-rows")
    page.select_option("#joint", "2")
    visit.wait_until("location.search.includes('joint=2')")
    page.select_option("#scale", "std")
    visit.wait_until("location.search.includes('scale=std')")
    page.go_back()
    visit.wait_until("location.search.includes('scale=percent')")
    visit.wait_until("document.querySelector('#scale').value === 'percent'")
    assert page.input_value("#joint") == "2"
    page.click("#save")
    page.wait_for_selector("#saved a")
    # a link compares at once, and shows the same
    visit.open(page.url.removeprefix(visit.url))
    page.wait_for_selector("#figures .plot[data-drawn] >> nth=1")
    assert page.input_value("#joint") == "2"
    assert page.is_checked("#only-changed")
