"""Import logs, map a column, fill in what is missing."""

from __future__ import annotations

import re
from typing import Any

from strainwave.io.study import read_study

VALUES = {
    "link_length": "0.35",
    "gear_ratio": "0.01",
    "torque_per_volt": "0.08",
    "accelerometer_distance": "0.33",
    "accelerometer_hz": "300",
    "gyro_hz": "5",
    "current_loop_hz": "1000",
    "kp": "0.12, 0.1",
    "ki": "1.5, 1.5",
    "limit": "10",
}


def test_from_logs_to_a_complete_study(visit: Any) -> None:
    page = visit.open("/")
    page.click("text=Import logs >> nth=0")
    page.fill("#folder", "rig")
    logs = [visit.folder / "arm" / f"{name}.parquet" for name in ("motion", "prbs-j1", "step-j1")]
    page.set_input_files("#files", [str(path) for path in logs])
    visit.wait_until("!document.querySelector('#draft').disabled")
    visit.check_accessibility()
    page.click("#draft")
    page.click("#continue")
    page.wait_for_selector("#state[data-state=error]")
    visit.check_accessibility()
    # the missing values, by keyboard: the focus stays where Tab leads after each change
    ids = page.evaluate("[...document.querySelectorAll('.todo input')].map((one) => one.id)")
    for field in ids:
        key = re.sub(r".*-", "", field)
        page.focus(f"#{field}")
        page.keyboard.press("Control+A")
        page.keyboard.type(VALUES[key])
        page.keyboard.press("Tab")
        visit.wait_until(f"document.querySelector('#{field}').closest('.todo') === null")
    page.wait_for_selector("#state[data-state=valid]")
    page.wait_for_selector("#arm[data-drawn]")
    page.get_by_label("Preview a1").click()
    page.wait_for_selector("#preview[data-drawn]")
    study = read_study(visit.folder / "rig" / "study.toml")
    assert study.arm.joints[1].gear_ratio == 0.01
    page.select_option("#channel-a1-column", "a2")
    visit.wait_until("document.querySelector('#text').value.includes('column = \"a2\"')")
    assert read_study(visit.folder / "rig" / "study.toml").channels["a1"].column == "a2"


def test_typed_text_survives_a_change_of_the_form(visit: Any) -> None:
    file = visit.folder / "arm" / "study.toml"
    page = visit.open("/study/arm/study.toml")
    page.wait_for_selector("#state[data-state=valid]")
    text = page.locator("#text")
    text.fill(f"# typed\n{text.input_value()}")
    page.fill("#field-joint-0-gear_ratio", "0.02")
    page.fill("#field-joint-1-gear_ratio", "0.03")  # before the first change is saved
    page.keyboard.press("Tab")
    visit.wait_until("document.querySelector('#text').value.includes('gear_ratio = 0.03')")
    assert text.input_value().startswith("# typed\n")
    assert file.read_text() == text.input_value()
    assert [joint.gear_ratio for joint in read_study(file).arm.joints] == [0.02, 0.03]


def test_leaving_with_typed_text_asks(visit: Any) -> None:
    page = visit.open("/study/arm/study.toml")
    page.wait_for_selector("#state[data-state=valid]")
    page.locator("#text").press("x")
    asked: list[str] = []

    def accept(dialog: Any) -> None:
        asked.append(dialog.type)
        dialog.accept()

    page.on("dialog", accept)
    page.click("text=Check >> nth=0")
    page.wait_for_selector("#check")
    assert asked == ["beforeunload"]
