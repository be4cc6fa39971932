"""Help, keys of pages, and accessibility of every page, light and dark."""

from __future__ import annotations

from typing import Any

import pytest

from strainwave.workbench.web import PAGE_TABS, STUDY_TABS

PAGES = [f"/{key}" for key, _, _ in PAGE_TABS]
PAGES += [f"/{key}/arm/study.toml" for key, _, _ in STUDY_TABS]
PAGES += ["/help/signals", "/help/warnings"]


def test_help_opens_and_closes_by_keyboard(visit: Any) -> None:
    page = visit.open("/signals/arm/study.toml")
    page.wait_for_selector("#time[data-drawn]")
    page.focus("#record")
    page.keyboard.press("?")  # a menu takes letters: nothing opens
    assert not page.locator("dialog").count()
    page.focus("#help")
    page.keyboard.press("?")
    page.wait_for_selector("dialog[open] h1")
    assert page.locator("dialog h1").inner_text() == "Signals"
    visit.check_accessibility()
    page.keyboard.press("Escape")
    page.wait_for_selector("dialog", state="detached")
    assert page.evaluate("document.activeElement.id") == "help"


def test_two_keys_open_a_page(visit: Any) -> None:
    page = visit.open("/study/arm/study.toml")
    page.keyboard.press("g")
    page.keyboard.press("f")
    page.wait_for_url("**/files/arm/study.toml")
    page.keyboard.press("g")
    page.keyboard.press("x")  # no such page
    page.keyboard.press("h")
    assert page.url.endswith("/files/arm/study.toml")


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_no_page_has_an_accessibility_finding(visit: Any, scheme: str) -> None:
    visit.page.emulate_media(color_scheme=scheme)
    for path in PAGES:
        page = visit.open(path)
        page.wait_for_load_state("networkidle")
        visit.check_accessibility()
