"""The virtual arm and a design in a browser."""

from __future__ import annotations

from typing import Any


def test_record_identify_and_design(visit: Any) -> None:
    page = visit.open("/virtual")
    visit.check_accessibility()
    page.focus("#run")
    page.keyboard.press("Enter")
    page.wait_for_selector("#verdict[data-status=determined]")
    assert page.locator("#rows tr").count() > 20
    visit.check_accessibility()
    page.click("#open-design")
    page.wait_for_load_state()
    page.fill("#excite-limit-angle", "0.8")
    page.fill("#excite-limit-velocity", "120")
    page.keyboard.press("Enter")
    page.wait_for_selector("#plan-plot[data-drawn]")
    visit.check_accessibility()
    with page.expect_download() as download:
        page.locator("#files a", has_text="apply-prbs-j1.csv").click()
    assert download.value.suggested_filename == "apply-prbs-j1.csv"
