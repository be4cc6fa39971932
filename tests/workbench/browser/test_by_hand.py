"""Sliders in a browser."""

from __future__ import annotations

import json
from typing import Any

from strainwave.virtual import scara
from strainwave.workbench.pages.by_hand import parameter_document


def test_a_slider_moves_the_curves(visit: Any) -> None:
    start = visit.folder / "arm" / "start.json"
    start.write_text(json.dumps(parameter_document(scara.STIFF.parameters())))
    page = visit.open("/by-hand/arm/study.toml")
    page.select_option("#record", "step-j1")
    page.wait_for_selector("#note[data-record='step-j1']", state="attached")
    before = page.inner_text("#fits")
    visit.check_accessibility()
    page.locator(".slider", has_text="motor_inertia 1").locator("input[type=range]").focus()
    for _ in range(30):
        page.keyboard.press("ArrowUp")
    visit.wait_until(f"document.querySelector('#fits').innerText !== {json.dumps(before)}")
    data = page.evaluate("({...document.querySelector('#note').dataset})")
    print(f"an update takes {data['milliseconds']} ms, of which the server {data['server']} ms")
    page.click("#reset")
    visit.wait_until(f"document.querySelector('#fits').innerText === {json.dumps(before)}")
