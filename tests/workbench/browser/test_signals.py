"""Signals in a browser: zoom in the resolution of the screen, window by keyboard."""

from __future__ import annotations

from typing import Any

from strainwave.io.study import read_study


def test_zoom_and_window(visit: Any) -> None:
    page = visit.open("/signals/arm/study.toml")
    page.wait_for_selector("#time[data-drawn]")
    page.wait_for_selector("#coherence[data-drawn]")
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
    page.focus("#visible")
    page.keyboard.press("Enter")
    page.keyboard.press("Tab")
    page.keyboard.press("Enter")
    page.wait_for_selector("#message:not([hidden])")
    experiments = {e.name: e for e in read_study(visit.folder / "arm" / "study.toml").experiments}
    assert (experiments["prbs-j1"].start, experiments["prbs-j1"].stop) == (1.0, 1.1)
