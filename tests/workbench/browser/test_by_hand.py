"""Sliders in a browser."""

from __future__ import annotations

import json
from typing import Any

from strainwave.io.parameters import parameter_file
from strainwave.virtual import scara


def test_a_slider_moves_the_curves(visit: Any) -> None:
    start = visit.folder / "arm" / "start.json"
    start.write_bytes(parameter_file(scara.STIFF.parameters()))
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


def test_changes_are_undone_and_faulty_numbers_refused(visit: Any) -> None:
    start = visit.folder / "arm" / "start.json"
    start.write_bytes(parameter_file(scara.STIFF.parameters()))
    page = visit.open("/by-hand/arm/study.toml")
    page.wait_for_selector("#note[data-record]", state="attached")
    # the excited joint of the record is open, the others are folded
    page.select_option("#joint", "2")
    assert page.locator("details[open]").evaluate_all("all => all.map((e) => e.dataset.group)") == [
        "Arm",
        "Joint 2",
    ]
    assert page.input_value("#channel-a") == "omega_m2"
    field = page.get_by_label("Value of gear_damping 2")
    before = field.input_value()
    field.fill("12.5")
    field.press("Tab")
    assert "not saved" in page.inner_text("#state")
    field.fill("")
    field.press("Tab")
    page.wait_for_selector("#message:has-text('takes a number; 12.5 stays')")
    assert field.input_value() == "12.5"
    page.click("#save")
    page.wait_for_selector("#state:has-text('by-hand.json')")
    page.locator(".slider", has_text="gear_damping 2").locator("input[type=range]").press("ArrowUp")
    assert "not saved" in page.inner_text("#state")
    page.click("#undo")
    assert field.input_value() == "12.5"
    assert "by-hand.json" in page.inner_text("#state")
    page.click("#undo")
    assert field.input_value() == before
    page.click("#undo")
    page.wait_for_selector("#message:has-text('no change to undo')")


def test_values_that_the_data_do_not_determine_are_marked(visit: Any) -> None:
    start = visit.folder / "arm" / "start.json"
    values = scara.STIFF.parameters()
    del values["gear_damping", 1]
    start.write_bytes(parameter_file(values))
    page = visit.open("/by-hand/arm/study.toml")
    row = page.locator(".slider", has_text="gear_damping 1")
    row.locator(".chip").wait_for()
    assert "gear_damping 1: the usual value of a gear" in page.inner_text("[data-group='Joint 1']")
    page.wait_for_selector("#note[data-record]", state="attached")
    visit.check_accessibility()
