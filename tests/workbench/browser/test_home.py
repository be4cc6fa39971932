"""The list of studies, and a complete way through the pages by keyboard alone."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from playwright.sync_api import Page


def follow_link(page: Page, name: str) -> None:
    """Press Tab until a link has the focus, then Enter."""
    for _ in range(120):
        page.keyboard.press("Tab")
        if page.evaluate("document.activeElement.textContent").strip() == name:
            with page.expect_navigation():
                page.keyboard.press("Enter")
            return
    raise AssertionError(f"Tab does not reach {name!r}")


def test_every_page_is_reached_by_keyboard(visit: Any) -> None:
    page = visit.open("/")
    visit.check_accessibility()
    assert page.get_by_text("Drop logs or folders anywhere on this page").is_visible()
    follow_link(page, "arm")
    for name, address in (
        ("Study", "/study/"),
        ("Check", "/check/"),
        ("Estimate", "/estimate/"),
        ("Compare", "/compare/"),
        ("By hand", "/by-hand/"),
        ("Design", "/design/"),
        ("Files", "/files/"),
        ("Signals", "/signals/"),
    ):
        follow_link(page, name)
        assert address in page.url
        visit.check_accessibility()
    page.emulate_media(color_scheme="dark")
    page.wait_for_selector("#coherence[data-drawn]")
    visit.check_accessibility()  # colours of the dark page have enough contrast
