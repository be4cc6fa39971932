"""Signals in a browser: zoom, window, cursor, overlays, units, steps, and the view in the address."""

from __future__ import annotations

from typing import Any
from urllib.parse import parse_qsl, urlsplit

import pytest

from strainwave.domain.steps import Detrend, LowPass
from strainwave.io.study import read_study

PATH = "/signals/arm/study.toml"
NAMES = "[...new Set(document.querySelector('#time').data.map(t => t.name))]"
ROWS = "[...document.querySelectorAll('#time-values tr')].map(r => [...r.cells].map(c => c.textContent.trim()))"


def open_page(visit: Any, query: str = "") -> Any:
    page = visit.open(PATH + query)
    page.wait_for_selector("#time[data-drawn]")
    page.wait_for_selector("#coherence[data-drawn]")
    return page


def address_of(page: Any) -> list[tuple[str, str]]:
    return parse_qsl(urlsplit(page.url).query, keep_blank_values=True)


def experiments_of(visit: Any) -> dict[str, Any]:
    study = read_study(visit.folder / "arm" / "study.toml")
    return {each.name: each for each in study.experiments}


def test_zoom_and_window(visit: Any) -> None:
    page = open_page(visit)
    page.select_option("#record", "prbs-j1")
    visit.wait_until("document.querySelector('#sequences li') !== null")
    before = page.evaluate("document.querySelector('#time').data[0].x.length")
    page.evaluate("Plotly.relayout('time', {'xaxis.range': [1.0, 1.1]})")
    visit.wait_until("document.querySelector('#time').data[0].x.at(-1) < 1.2")
    zoomed = page.evaluate("document.querySelector('#time').data[0].x")
    assert zoomed[0] <= 1.0
    assert len(zoomed) > 0.9 * 0.1 / (zoomed[1] - zoomed[0])  # every sample
    assert before <= 4000
    visit.check_accessibility()
    page.focus("#visible")  # one step from the zoom to the window
    page.keyboard.press("Enter")
    page.wait_for_selector("#message:not([hidden])")
    window = experiments_of(visit)["prbs-j1"]
    assert (window.start, window.stop) == (1.0, 1.1)
    assert page.evaluate("document.activeElement.id") == "visible"
    visit.wait_until("document.querySelector('#start').value === '1'")
    visit.wait_until("document.querySelector('#time').layout.shapes.length >= 2")


def test_the_cursor_shows_the_values_of_all_curves(visit: Any) -> None:
    page = open_page(visit, "?record=motion&channel=u1&channel=u2&channel=theta_m1")
    assert [row[0] for row in page.evaluate(ROWS)] == ["u1 [V]", "u2 [V]", "theta_m1 [rad]"]
    page.focus("#time")
    page.keyboard.press("Home")
    page.keyboard.press("ArrowRight")
    page.keyboard.press("Shift+ArrowRight")
    data = page.evaluate("document.querySelector('#time').data.map(t => [t.x, t.y])")
    count = 1 + -(-len(data[0][0]) // 20)
    at = data[0][0][count]
    assert f"t = {at:.7g} s" in page.inner_text("#time-at")
    for (_, shown), (x, y) in zip(page.evaluate(ROWS), data, strict=True):
        nearest = min(range(len(x)), key=lambda k: abs(x[k] - at))
        assert float(shown) == pytest.approx(y[nearest], rel=1e-4)
    line = page.locator("#time + .cursor")
    assert line.is_visible()
    first = page.inner_text("#time-at")
    page.hover("#time .nsewdrag >> nth=0")
    visit.wait_until(f"document.querySelector('#time-at').textContent !== {first!r}")
    page.focus("#spectra")
    page.keyboard.press("End")
    assert "Hz" in page.inner_text("#spectra-at")


def test_records_are_overlaid_and_panels_shared(visit: Any) -> None:
    page = open_page(visit, "?record=prbs-j1&channel=u1&channel=a1&channel=u2&panels=unit")
    assert page.evaluate("document.querySelector('#time').data.map(t => t.yaxis)") == [
        "y",
        "y",
        "y2",
    ]
    page.click("summary")
    page.check("[data-overlay][value='prbs-j2']")
    visit.wait_until(f"{NAMES}.length === 6")
    assert "u1 [V], prbs-j2" in page.evaluate(NAMES)
    styles = page.evaluate("document.querySelector('#time').data.map(t => t.line.color)")
    assert len(set(styles)) == 6
    page.select_option("#panels", "channel")
    visit.wait_until("document.querySelector('#time').data.some(t => t.yaxis === 'y3')")
    visit.check_accessibility()


def test_units_and_scales(visit: Any) -> None:
    page = open_page(visit, "?record=motion&channel=theta_m1")
    radians = max(page.evaluate("document.querySelector('#time').data[0].y"))
    page.select_option("#units", "deg")
    visit.wait_until(f"{NAMES}[0] === 'theta_m1 [deg]'")
    degrees = max(page.evaluate("document.querySelector('#time').data[0].y"))
    assert degrees == pytest.approx(57.2958 * radians, rel=1e-3)
    axes = "['xaxis', 'yaxis'].map(k => document.querySelector('#spectra').layout[k].type)"
    assert page.evaluate(axes) == ["log", "log"]
    page.select_option("#frequency", "linear")
    page.select_option("#magnitude", "linear")
    visit.wait_until(f"!{axes}.includes('log')")


def test_the_address_has_the_view(visit: Any) -> None:
    page = open_page(visit)
    page.check("[data-channel][value='u2']")
    page.select_option("#units", "rpm")
    page.evaluate("Plotly.relayout('time', {'xaxis.range': [2.0, 3.0]})")
    visit.wait_until("location.search.includes('to=3')")
    link, view = page.url, address_of(page)
    assert {("record", "motion"), ("channel", "u2"), ("units", "rpm"), ("from", "2")} <= set(view)
    page.go_back()
    visit.wait_until("document.querySelector('#units').value === 'rad'")
    assert page.is_checked("[data-channel][value='u2']")
    page.go_back()
    visit.wait_until("!document.querySelector(\"[data-channel][value='u2']\").checked")
    page = open_page(visit, "?" + urlsplit(link).query)
    assert address_of(page) == view
    assert page.evaluate("document.querySelector('#time').layout.xaxis.range") == [2, 3]
    assert page.is_checked("[data-channel][value='u2']")


def test_steps_are_previewed_and_written(visit: Any) -> None:
    study = visit.folder / "arm" / "study.toml"
    study.write_text("# kept\n" + study.read_text())
    page = open_page(visit, "?record=motion&channel=u1&channel=a1")
    page.select_option("#step-kind", "lowpass")
    page.fill("#lowpass-cutoff_hz", "0.01")
    page.click("#add-step")
    page.wait_for_selector("#message.bad")
    assert "can be filtered from" in page.inner_text("#message")
    assert page.locator("#steps li").count() == 0
    visit.take_refusals()
    page.fill("#lowpass-cutoff_hz", "60")
    page.keyboard.press("Enter")
    visit.wait_until(f"{NAMES}.includes('u1 [V], before the steps')")
    page.select_option("#step-kind", "detrend")
    page.select_option("#detrend-channels", "a1")
    page.click("#add-step")
    visit.wait_until("document.querySelectorAll('#steps li').length === 2")
    page.click("[aria-label='Move step 2 up']")
    visit.wait_until("document.querySelector('#steps li').textContent.startsWith('detrend')")
    assert "step 2" in page.evaluate("document.activeElement.closest('li') ? 'step 2' : ''")
    assert "steps" in dict(address_of(page))  # a link has the steps that are not written
    visit.check_accessibility()
    page.click("#write-steps")
    visit.wait_until("document.querySelector('#write-steps').disabled")
    assert experiments_of(visit)["motion"].steps == (Detrend(("a1",)), LowPass(60.0))
    assert study.read_text().startswith("# kept\n")
    page.click("[aria-label='Remove step 1']")
    visit.wait_until("document.querySelectorAll('#steps li').length === 1")
    page.click("#undo-steps")
    visit.wait_until("document.querySelectorAll('#steps li').length === 2")


def test_a_record_that_cannot_be_read_does_not_stop_the_page(visit: Any) -> None:
    (visit.folder / "arm" / "motion.parquet").write_bytes(b"PAR1 broken PAR1")
    page = visit.open(PATH)
    page.wait_for_selector("#message.bad")
    assert "motion.parquet" in page.inner_text("#message")
    visit.take_refusals()
    page.select_option("#record", "prbs-j1")
    page.wait_for_selector("#coherence[data-drawn]")
    page.evaluate("Plotly.relayout('time', {'xaxis.range': [1.0, 1.1]})")
    visit.wait_until("location.search.includes('to=1.1')")
    page.evaluate("Plotly.relayout('time', {'xaxis.range': [-1.0, 100.0]})")  # everything
    visit.wait_until("!location.search.includes('to=')")


@pytest.mark.parametrize("width", [1280, 2560])
def test_the_page_fits_the_screen(visit: Any, width: int) -> None:
    visit.page.set_viewport_size({"width": width, "height": 1000})
    page = open_page(visit)
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    time, spectra = (page.locator(f"#{name}").bounding_box() for name in ("time", "spectra"))
    is_beside = spectra["x"] > time["x"] + time["width"]
    assert is_beside == (width == 2560)
