"""Changes of study files, also those that take the rig values of another."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from strainwave.errors import InvalidInput

pytest.importorskip("tomlkit")

from strainwave.init.changes import KeyChange, changed_text, value_of
from strainwave.init.rig_values import rig_changes

TEXT = """# rig
[arm]
kind = "x"

# of all experiments

[[experiment]]
name = "a"  # first
file = "a.csv"
# start = 10

# validation
[[experiment]]
name = "b"
[experiment.prbs]
order = 3

[options]
x = '''
[[experiment]]
'''
"""


def edited(text: str, index: int, value: str | None) -> str:
    return changed_text(text, [KeyChange(("experiment", index), value)], Path("study.toml"))


def test_tables_are_inserted_and_removed_and_all_other_lines_stay() -> None:
    text = TEXT.replace("\n[[experiment]]\n'''", "'''")
    first = '[[experiment]]\nname = "a"  # first\nfile = "a.csv"\n# start = 10\n\n'
    second = '[[experiment]]\nname = "b"\n[experiment.prbs]\norder = 3\n\n'
    assert edited(text, 0, None) == text.replace(first, "")
    assert edited(text, 1, None) == text.replace(second, "")
    new = '[[experiment]]\nname = "c"  # mine\nfile = TODO\n\n'
    body = 'name = "c"  # mine\nfile = TODO'
    assert edited(text, 0, body) == text.replace(first, new + first)
    assert edited(text, 1, body) == text.replace(first, first + new)
    assert edited(text, 2, body) == text.replace(second, second + new)
    for index in range(3):
        assert edited(edited(text, index, body), index, None) == text
    assert edited("[arm]\r\n", 0, 'name = "c"') == '[arm]\r\n\n[[experiment]]\nname = "c"\n'


@pytest.mark.parametrize(
    ("text", "index", "value"),
    [
        (TEXT, 0, None),  # a text of several lines looks like a table
        (TEXT.replace("\n[[experiment]]\n'''", "'''"), 2, None),
        (TEXT.replace("\n[[experiment]]\n'''", "'''"), 3, "name = 1"),
        ('experiment = [{ name = "a" }]', 0, None),
        ("[experiment]", 0, "name = 1"),
        ("[arm]", 0, "name = "),
    ],
)
def test_tables_that_cannot_be_changed_are_refused(text: str, index: int, value: str) -> None:
    with pytest.raises(InvalidInput):
        edited(text, index, value)


def test_a_data_sheet_is_a_table_of_values_in_toml_or_json() -> None:
    draft = (
        "[arm]\nlink_length = TODO  # [m]\n[[joint]]\n[[joint]]\ngear_ratio = TODO\n[channels]\n"
    )
    sheet = {
        "arm": {"link_length": 0.35, "kind": "serial", "gravity": None},
        "joint": [{"imu": {"xyz": [0, 0, 1]}}, {"gear_ratio": "TODO", "name": 'a"b'}],
        "channels": {"a1": {"column": "acc", "scale": 9.81}, "a2": "missing"},
    }
    changes = rig_changes(draft, json.dumps(sheet), ["acc"], Path("study.toml"))
    text = changed_text(draft, changes, Path("study.toml"))
    assert text == (
        "[arm]\nlink_length = 0.35  # [m]\n[[joint]]\nimu = {xyz = [0, 0, 1]}\n[[joint]]\n"
        'gear_ratio = TODO\nname = "a\\"b"\n[channels]\na1 = {column = "acc", scale = 9.81}\n'
    )
    toml = '[arm]\nlink_length = 0.35\n[channels]\na1 = { topic = "/a", field = "b", name = "c" }'
    columns = ["/a.b[c]"]
    assert len(rig_changes(draft, toml, columns, Path("study.toml"))) == 2


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ("[[joint]]\n", "1 joint(s), and this arm has 2"),
        ("x = 1\n", "no values of a rig"),
        ('{"arm": [}', "no valid JSON"),
        ("[arm", "Remedy"),
        ('{"arm": {"gravity": [null]}}', "a value that TOML does not have"),
    ],
)
def test_values_that_cannot_be_taken_are_refused(values: str, message: str) -> None:
    draft = "[arm]\n[[joint]]\n[[joint]]\n"
    with pytest.raises(InvalidInput, match=message.replace("(", r"\(").replace(")", r"\)")):
        changed_text(draft, rig_changes(draft, values, [], Path("s")), Path("s"))


@pytest.mark.parametrize(
    ("text", "kind", "value"),
    [
        ("", "number", None),
        ("8192", "number", 8192),
        ("1e3", "number", 1000.0),
        ("unknown", "number", "unknown"),
        ("0, 0, -9.81", "numbers", [0, 0, -9.81]),
        ("[1, 0], [0.2, 1]", "numbers", [[1, 0], [0.2, 1]]),
        ("[[1, 0], [0.2, 1]]", "numbers", [[1, 0], [0.2, 1]]),
        ("[1.5, 2]", "numbers", [1.5, 2]),
        ("three-slope", "choice", "three-slope"),
    ],
)
def test_values_of_fields(text: str, kind: Any, value: object) -> None:
    assert value_of(text, kind) == value


@pytest.mark.parametrize(
    ("text", "kind", "unit", "chosen", "value"),
    [
        ("100:1", "number", "link turns per motor turn", "", 0.01),
        ("-1:160", "number", "link turns per motor turn", "", -0.00625),
        ("160", "number", "link turns per motor turn", "1/n", 0.00625),
        ("160", "number", "link turns per motor turn", "n", 160),
        ("3.5 mN m/V", "number", "N m/V", "", 0.0035),
        ("3.5", "number", "N m/V", "mN m/V", 0.0035),
        ("3.5 N·m/V", "number", "N m/V", "mN m/V", 3.5),
        ("1e3", "number", "Hz", "kHz", 1e6),
        ("30 deg", "number", "rad", "", 0.523598775598299),
        ("0, 0, 90 deg", "numbers", "rad", "", [0, 0, 1.5707963267949]),
        ("[10, 20, 0.3 m] mm", "numbers", "m", "", [0.01, 0.02, 0.3]),
        ("unknown", "number", "N m/V", "mN m/V", "unknown"),
    ],
)
def test_values_with_units_are_saved_in_si(
    text: str, kind: Any, unit: str, chosen: str, value: object
) -> None:
    assert value_of(text, kind, unit, chosen) == value


@pytest.mark.parametrize(
    ("text", "unit"), [("3 mN m", "m"), ("100:1", "m"), ("5 deg", "counts"), ("3 furlong", "m")]
)
def test_a_unit_of_another_quantity_is_refused(text: str, unit: str) -> None:
    with pytest.raises(InvalidInput, match="is no unit of the value"):
        value_of(text, "number", unit)


def test_zero_has_no_reciprocal() -> None:
    with pytest.raises(InvalidInput, match="zero has no reciprocal"):
        value_of("0", "number", "link turns per motor turn", "1/n")


@pytest.mark.parametrize("text", ["0,5x", "1 2", "true", "[1, [2]]"])
def test_wrong_numbers_are_refused(text: str) -> None:
    for kind in ("number", "numbers"):
        with pytest.raises(InvalidInput):
            value_of(text, kind)
