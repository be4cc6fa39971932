"""The form of a study: missing values, units, copies, undo, picture, channels and text."""

from __future__ import annotations

import json
import re
from typing import Any

import pytest

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
    page.wait_for_url("**/study/rig/study.toml")
    page.wait_for_selector("#state[data-state=error]")
    visit.check_accessibility()
    # from the list to the first, then Enter leads to the next
    count = page.locator("#missing-list li").count()
    page.locator("#missing-list button").first.press("Enter")
    for k in range(count):
        field = page.evaluate("document.activeElement.id")
        page.keyboard.type(VALUES[re.sub(r".*-", "", field)])
        page.keyboard.press("Enter")
        visit.wait_until(
            f"document.querySelectorAll('#missing-list li').length === {count - k - 1}"
        )
    page.wait_for_selector("#state[data-state=valid]")
    page.wait_for_selector("#arm[data-drawn]")
    page.get_by_label("Preview a1").click()
    page.wait_for_selector("#preview[data-drawn]")
    study = read_study(visit.folder / "rig" / "study.toml")
    assert study.arm.joints[1].gear_ratio == 0.01
    page.select_option("#field-channels-a1", "a2")
    wait_for_text(visit, 'column = "a2"')
    assert read_study(visit.folder / "rig" / "study.toml").channels["a1"].column == "a2"


def open_study(visit: Any, field: str = "") -> Any:
    page = visit.open(f"/study/arm/study.toml{field}")
    page.wait_for_selector("#state[data-state]")
    return page


def wait_for_text(visit: Any, part: str) -> None:
    visit.wait_until(f"document.querySelector('#text').value.includes({json.dumps(part)})")


def joints_of(visit: Any) -> Any:
    return read_study(visit.folder / "arm" / "study.toml").arm.joints


def write_chain(visit: Any, n_joints: int) -> None:
    """A draft of a serial arm in place of the study."""
    joints = "".join(
        f'[[joint]]\nspring = "linear"\ngear_ratio = {"0.01" if k == 0 else "TODO"}\n'
        f"origin = {{ xyz = [0.1, 0.0, 0.2], rpy = [0.0, 0.5, 0.0] }}\n"
        for k in range(n_joints)
    )
    control = ", ".join(['"servo"'] * n_joints)
    (visit.folder / "arm" / "study.toml").write_text(
        f'[arm]\nkind = "serial"\n{joints}[[experiment]]\nname = "motion"\n'
        f'file = "motion.parquet"\nuse = "motion"\ncontrol = [{control}]\n'
    )


def test_typed_text_survives_a_change_of_the_form(visit: Any) -> None:
    page = open_study(visit)
    page.click("summary:has-text('Text of')")
    text = page.locator("#text")
    text.fill(f"# typed\n{text.input_value()}")
    page.fill("#field-joint-0-gear_ratio", "0.02")
    page.fill("#field-joint-1-gear_ratio", "0.03")  # before the first change is saved
    page.keyboard.press("Tab")
    wait_for_text(visit, "gear_ratio = 0.03")
    assert text.input_value().startswith("# typed\n")
    assert (visit.folder / "arm" / "study.toml").read_text() == text.input_value()
    assert [joint.gear_ratio for joint in joints_of(visit)] == [0.02, 0.03]


def test_a_save_keeps_the_control_its_focus_and_what_is_typed(visit: Any) -> None:
    page = open_study(visit)
    page.fill("#field-joint-0-gear_ratio", "0.02")
    page.focus("#field-joint-1-gear_ratio")  # the first is saved meanwhile
    page.evaluate("document.activeElement.mark = 'same'")
    page.keyboard.press("Control+A")
    page.keyboard.type("0.0")
    wait_for_text(visit, "gear_ratio = 0.02")
    page.keyboard.type("4")
    assert page.evaluate("[document.activeElement.mark, document.activeElement.value]") == [
        "same",
        "0.04",
    ]


def test_a_wrong_value_keeps_its_text_and_names_its_field(visit: Any) -> None:
    page = open_study(visit)
    page.fill("#field-joint-1-gear_ratio", "3 mm")
    page.keyboard.press("Tab")
    visit.wait_until("document.querySelector('#message').textContent.includes('joint 2')")
    visit.take_refusals()
    field = page.locator("#field-joint-1-gear_ratio")
    assert (field.input_value(), field.get_attribute("aria-invalid")) == ("3 mm", "true")


def test_explanations_open_on_demand(visit: Any) -> None:
    page = open_study(visit)
    about = page.locator("#about-joint-current_loop_hz")
    assert not about.is_visible()
    button = page.get_by_label("About Current loop")
    button.press("Enter")
    assert "Bandwidth of the first-order lag" in about.inner_text()
    assert "Plausible: 5 to 1000000 Hz." in about.inner_text()
    assert button.get_attribute("aria-expanded") == "true"
    title = page.locator("#field-joint-0-current_loop_hz").get_attribute("title")
    assert "[Hz]" in title
    visit.check_accessibility()


def test_joint_1_is_copied_to_all_in_one_change(visit: Any) -> None:
    write_chain(visit, 7)
    page = open_study(visit)
    assert page.locator("#missing-list li").count() == 6
    page.get_by_label("Copy Gear ratio of joint 1 to all joints").press("Enter")
    page.wait_for_selector("#state[data-state=valid]")
    assert [joint.gear_ratio for joint in joints_of(visit)] == [0.01] * 7
    page.keyboard.press("Control+Z")  # one step
    visit.wait_until("document.querySelectorAll('#missing-list li').length === 6")
    page.fill("#field-joint-0-gear_ratio", "0.02")
    page.select_option("#field-joint-0-spring", "rigid")
    page.get_by_label("Copy all values of joint 1").click()
    page.wait_for_selector("#state[data-state=valid]")
    joints = joints_of(visit)
    assert [(joint.gear_ratio, joint.spring) for joint in joints] == [(0.02, "rigid")] * 7


def test_seven_joints_are_a_table_that_fits(visit: Any) -> None:
    write_chain(visit, 7)
    page = open_study(visit)
    box = page.locator("#rig").bounding_box()
    assert box["height"] < 900
    assert page.evaluate("document.documentElement.scrollWidth") <= 1280
    heads = page.locator("#rig thead th").all_inner_texts()
    assert heads == ["unit", *(f"Joint {k}" for k in range(1, 8))]
    field = page.locator("#field-joint-3-encoder_counts")
    assert not field.is_visible()  # empty for all joints
    page.get_by_text("Show 14 optional rows").press("Enter")
    assert field.is_visible()
    visit.check_accessibility()
    unit = page.get_by_label("Unit of Gear ratio")
    assert unit.is_visible()
    page.focus("#field-joint-6-motion")
    page.select_option("#field-joint-6-motion", "prismatic")  # m per rad for this joint
    visit.wait_until("document.body.textContent.includes('link rad (or m) per motor rad')")
    assert unit.count() == 0
    assert page.evaluate("document.activeElement.id") == "field-joint-6-motion"


def test_the_edited_joint_is_marked_in_the_picture_of_a_draft(visit: Any) -> None:
    write_chain(visit, 3)
    page = open_study(visit)
    page.wait_for_selector("#arm[data-drawn]")
    page.focus("#field-joint-1-gear_ratio")
    page.wait_for_selector("#arm[data-joint='2']")
    rings = page.evaluate("document.querySelector('#arm').data.filter((t) => t.name === 'joint 2')")
    (joints,) = page.evaluate(
        "document.querySelector('#arm').data.filter((t) => t.name === 'joints')"
    )
    assert rings[0]["x"][0] == pytest.approx(joints["x"][1], abs=1e-4)
    assert rings[0]["y"][0] == pytest.approx(joints["y"][1], abs=1e-4)
    page.focus("#field-arm-kind")
    page.wait_for_selector("#arm[data-joint='']")


@pytest.mark.parametrize(
    ("named", "focused"),
    [
        ("joint-1-gear_ratio", "joint-1-gear_ratio"),
        ("joint-3-encoder_counts", "joint-3-encoder_counts"),  # of an optional row
        ("experiment-0-start", "experiment-0-start"),
        ("channels-tau_l1-scale", "channels-tau_l1"),  # a scale needs a column
    ],
)
def test_the_field_that_the_address_names_has_the_focus(
    visit: Any, named: str, focused: str
) -> None:
    write_chain(visit, 4)
    page = open_study(visit, f"#field-{named}")
    field = page.locator(f"#field-{focused}")
    visit.wait_until(f"document.activeElement.id === 'field-{focused}'")
    assert field.is_visible()
    assert field.evaluate("(one) => one.getBoundingClientRect().bottom <= innerHeight")
    assert field.evaluate("(one) => one.getBoundingClientRect().top >= 0")
    page.focus("#reload")
    page.keyboard.press("Enter")  # reads the file, and leaves the focus
    visit.wait_until("!document.querySelector('#reload[aria-busy]')")
    assert page.evaluate("document.activeElement.id") == "reload"


def test_units_convert_what_is_shown_and_typed(visit: Any) -> None:
    page = open_study(visit)
    ratio, loop = page.locator("#field-joint-0-gear_ratio"), "#field-joint-0-current_loop_hz"
    page.get_by_label("Unit of Gear ratio").select_option("1/n")
    before = 1.0 / joints_of(visit)[0].gear_ratio
    assert float(ratio.input_value()) == pytest.approx(before)
    ratio.fill("160")
    page.keyboard.press("Tab")
    wait_for_text(visit, "gear_ratio = 0.00625")
    assert ratio.input_value() == "160"
    ratio.fill("50:1")
    page.fill(loop, "1.2 kHz")
    page.keyboard.press("Tab")
    wait_for_text(visit, "current_loop_hz = 1200")
    assert (ratio.input_value(), page.input_value(loop)) == ("50", "1200")
    assert joints_of(visit)[0].gear_ratio == 0.02
    page.reload()  # the choice of the unit stays
    page.wait_for_selector("#state[data-state=valid]")
    assert ratio.input_value() == "50"


def test_the_unit_of_a_column_is_its_scale(visit: Any) -> None:
    page = open_study(visit)
    unit = page.get_by_label("Unit of the column of a1")
    assert unit.is_disabled()  # while the column has the channel's name
    page.get_by_label("Preview a1").click()
    page.select_option("#field-channels-a1", "a2")
    visit.wait_until("!document.querySelector('#field-channels-a1-scale').disabled")
    unit.select_option("g")
    visit.wait_until("document.querySelector('#field-channels-a1-scale').value === '9.80665'")
    page.fill("#field-channels-a1-scale", "-9.8067")
    page.keyboard.press("Tab")
    wait_for_text(visit, "scale = -9.8067")
    assert unit.evaluate("(one) => one.selectedOptions[0].text") == "g"
    page.fill("#field-channels-a1-scale", "2")
    page.keyboard.press("Tab")
    wait_for_text(visit, "scale = 2")
    assert unit.evaluate("(one) => one.selectedOptions[0].text") == "other"
    visit.wait_until("document.querySelector('#preview').dataset.drawn === 'true'")
    hidden = page.locator("#field-channels-tau_l1")
    assert not hidden.is_visible()
    page.check("#all-channels")
    assert hidden.is_visible()


def test_changes_are_undone_and_redone(visit: Any) -> None:
    file = visit.folder / "arm" / "study.toml"
    before = file.read_text()
    page = open_study(visit)
    page.fill("#field-joint-0-gear_ratio", "0.02")
    page.keyboard.press("Tab")
    wait_for_text(visit, "gear_ratio = 0.02")
    page.keyboard.press("Control+Z")  # in a field: of the field
    assert "gear_ratio = 0.02" in file.read_text()
    page.reload()  # the steps outlive the page
    page.wait_for_selector("#undo[aria-disabled=false]")
    page.click("#undo")
    page.wait_for_selector("#undo[aria-disabled=true]")
    assert file.read_text() == before
    page.keyboard.press("Control+Shift+Z")
    page.wait_for_selector("#redo[aria-disabled=true]")
    assert "gear_ratio = 0.02" in file.read_text()


def test_an_error_of_the_text_leads_to_its_line(visit: Any) -> None:
    page = open_study(visit)
    page.click("summary:has-text('Text of')")
    text = page.locator("#text")
    good = text.input_value()
    text.fill(good.replace("[arm]", "[arm]\nnonsense", 1))
    page.click("#save")
    selected = "document.querySelector('#text').value.slice(...['Start', 'End'].map((k) => document.querySelector('#text')[`selection${k}`]))"
    visit.wait_until(f"{selected} === 'nonsense'")
    visit.take_refusals()
    text.fill(good.replace("[arm]", "[arm]\nlinklength = 1", 1))
    page.click("#save")
    page.wait_for_selector("#to-line:visible")
    page.click("#to-line")
    assert page.evaluate(selected) == "linklength = 1"
    line = text.input_value()[: text.input_value().index("linklength")].count("\n") + 1
    visit.wait_until(f"document.querySelector('#cursor').textContent === 'Line {line}'")


def test_leaving_with_typed_text_asks(visit: Any) -> None:
    page = open_study(visit)
    page.click("summary:has-text('Text of')")
    page.locator("#text").press("x")
    asked: list[str] = []

    def accept(dialog: Any) -> None:
        asked.append(dialog.type)
        dialog.accept()

    page.on("dialog", accept)
    page.click("text=Check >> nth=0")
    page.wait_for_selector("#check")
    assert asked == ["beforeunload"]
