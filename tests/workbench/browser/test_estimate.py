"""Check, run, cancel and report in a browser."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from strainwave.init.changes import KeyChange, edit_study

if TYPE_CHECKING:
    from playwright.sync_api import Page


def press_until_focus(page: Page, name: str) -> None:
    """Press Tab until the control with an accessible name has the focus."""
    for _ in range(80):
        page.keyboard.press("Tab")
        if page.evaluate("document.activeElement.textContent").strip() == name:
            return
    raise AssertionError(f"Tab does not reach {name!r}")


def test_check_remedy_estimate_and_report(visit: Any) -> None:
    study = visit.folder / "arm" / "study.toml"
    edit_study(
        study, [KeyChange(("channels", "theta_m1"), {"column": "theta_m1", "scale": 57.29578})]
    )
    page = visit.open("/estimate/arm/study.toml")
    assert page.locator("#start").is_disabled()
    page = visit.open("/check/arm/study.toml")
    page.click("#check")
    page.wait_for_selector("#state[data-state=suspected]")
    suspected = page.locator("#suspected section").first
    assert suspected.locator("li").count() > 0  # evidence
    field = suspected.locator("a").first
    assert field.get_attribute("href") == "/study/arm/study.toml#field-channels-theta_m1-scale"
    assert page.locator("#contradictions tr").count() > 0
    assert page.locator("#relations").is_hidden()  # those that agree
    visit.check_accessibility()
    page.locator(".remedy").first.click()
    page.wait_for_selector("#state[data-state=consistent]")
    page.wait_for_selector("#signal[data-drawn]")
    page.click("#go")
    page.wait_for_selector("#start:not([disabled])")
    page.check("input[value='rigid']")
    page.click("#start")
    page.wait_for_selector("tr[data-run='identify-1'][data-state='done']")
    page.get_by_role("link", name="identify-1").click()
    frame = page.frame_locator("#report-frame")
    assert "Determined" in frame.locator(".badge").first.inner_text()
    frame.locator(".js-plotly-plot").first.wait_for()  # its scripts run in the sandbox
    visit.check_accessibility()


def test_a_run_is_started_and_cancelled_by_keyboard(visit: Any) -> None:
    page = visit.open("/check/arm/study.toml")
    press_until_focus(page, "Check the study")
    page.keyboard.press("Enter")
    page.wait_for_selector("#state[data-state=consistent]")
    press_until_focus(page, "Continue to Estimate")
    page.keyboard.press("Enter")
    page.wait_for_selector("#start:not([disabled])")
    press_until_focus(page, "Estimate")  # the tab of the page
    page.focus("#name")
    press_until_focus(page, "Estimate")
    page.keyboard.press("Enter")
    page.wait_for_selector("tr[data-state='running'] progress")
    press_until_focus(page, "Cancel")
    page.keyboard.press("Enter")
    page.wait_for_selector("tr[data-state='cancelled']")
    assert page.evaluate("document.activeElement.dataset.key") == "open identify-1"


def test_several_runs_share_one_stream_and_a_typed_name_stays(visit: Any) -> None:
    page = visit.open("/check/arm/study.toml")
    page.click("#check")
    page.wait_for_selector("#state[data-state=consistent]")
    page = visit.open("/estimate/arm/study.toml")
    page.wait_for_selector("#start:not([disabled])")
    streams: list[str] = []
    page.on("request", lambda r: streams.append(r.url) if "run-events" in r.url else None)
    page.check("input[value='rigid']")
    page.dblclick("#start")  # starts one run
    page.wait_for_selector("tr[data-run='identify-1']")
    for number in range(2, 8):  # with the first, one more than a browser has connections
        page.fill("#name", f"run {number}")
        page.click("#start")
        page.wait_for_selector(f"tr[data-run='run {number}']")
    page.fill("#name", "typed while runs end")
    for number in range(2, 8):
        page.wait_for_selector(f"tr[data-run='run {number}'][data-state='done']")
    assert page.locator("tr[data-run]").count() == 7
    assert page.input_value("#name") == "typed while runs end"
    assert len(streams) <= 7  # one for each set of runs, the former one closed
