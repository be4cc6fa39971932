"""Reading the arm of a result: study, parameters, refusals and warnings."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

import exports
from strainwave.domain.arm.kinds import change_arm_keys
from strainwave.domain.keys import Values
from strainwave.errors import InvalidInput
from strainwave.export import IdentifiedArm, read_arm
from strainwave.export.flat import to_json
from strainwave.export.mjcf import to_mjcf
from strainwave.io.study import document_of, write_study

Change = Callable[[dict[str, Any]], Any]


def test_study_and_parameters_are_read(tmp_path: Path) -> None:
    study = exports.two_links(tmp_path)
    values = exports.values_of(study)
    arm = exports.arm_of(study, values)
    assert arm.values == values
    assert arm.study.arm.joints == study.arm.joints
    assert arm.warnings == ()
    assert arm.parameters[0].std == pytest.approx(0.01 * values["alpha", None])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda d: d.pop("schema"), 'has no key "schema"'),
        (lambda d: d.update(schema="strainwave/comparisons/1"), "strainwave/comparisons/1"),
        (lambda d: d.update(parameters=[]), "contains no parameters"),
        (lambda d: d.update(parameters={"alpha": 1.0}), "contains no parameters"),
        (lambda d: d["parameters"].insert(2, "alpha"), "entry 3"),
        (lambda d: d["parameters"][1].update(value="1.0"), "entry 2: 'value' is invalid"),
        (lambda d: d["parameters"][1].update(joint=True), "entry 2: 'joint' is invalid"),
        (lambda d: d["parameters"][1].update(value=float("inf")), "entry 2"),
        (lambda d: d["parameters"][1].pop("unit"), "entry 2: 'unit' is invalid"),
        (lambda d: d["parameters"][1].update(name="a b"), "'a b' is not a parameter name"),
        (lambda d: d["parameters"].append(d["parameters"][0]), "alpha is listed twice"),
        (lambda d: d["parameters"][5].update(joint=3), "belongs to joint 3"),
        (lambda d: d["parameters"][5].update(joint=0), "belongs to joint 0"),
        (lambda d: d.pop("study"), "does not name its study file"),
        (lambda d: d["study"].update(path="gone.toml"), "--study"),
        (lambda d: d["study"].update(path="x" * 5000), "--study"),
        (lambda d: d["study"].update(path="a\0b"), "--study"),
    ],
)
def test_invalid_results_are_refused(change: Change, message: str, tmp_path: Path) -> None:
    study = exports.two_links(tmp_path)
    path = exports.write(study, exports.values_of(study))
    document = json.loads(path.read_text())
    change(document)
    path.write_text(json.dumps(document))
    with pytest.raises(InvalidInput) as caught:
        read_arm(path)
    assert message in str(caught.value)
    assert str(path) in str(caught.value)
    assert caught.value.remedy


@pytest.mark.parametrize("text", ["", "{", "[" * 100000, "[1]", '"alpha"'])
def test_other_files_are_refused(text: str, tmp_path: Path) -> None:
    path = tmp_path / "result.json"
    path.write_text(text)
    with pytest.raises(InvalidInput, match=r"result\.json: "):
        read_arm(path)


def test_a_missing_result_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InvalidInput, match="does not exist"):
        read_arm(tmp_path / "result.json")


def test_a_study_moved_with_its_result_is_found(tmp_path: Path) -> None:
    study = exports.two_links(tmp_path)
    path = exports.write(study, exports.values_of(study))
    moved = tmp_path.rename(tmp_path.with_name("moved"))
    assert read_arm(moved / path.name).study.path == moved / "study.toml"
    (moved / "study.toml").rename(moved / "other.toml")
    with pytest.raises(InvalidInput, match="does not exist any more"):
        read_arm(moved / path.name)
    assert read_arm(moved / path.name, moved / "other.toml").warnings == ()


def test_the_study_is_looked_for_from_the_folder_of_the_result(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Another study of the same name is in the working directory."""
    project, elsewhere = tmp_path / "project", tmp_path / "elsewhere"
    for folder in (project, project / "results", elsewhere):
        folder.mkdir(parents=True, exist_ok=True)
    study = exports.two_links(project)
    path = exports.write(study, exports.values_of(study))
    document = json.loads(path.read_text())
    document["study"]["path"] = "study.toml"
    result = project / "results" / "result.json"
    result.write_text(json.dumps(document))
    (elsewhere / "study.toml").write_text(study.path.read_text().replace("0.35", "0.36"))
    monkeypatch.chdir(elsewhere)
    arm = read_arm(result)
    assert arm.study.path == study.path
    assert arm.warnings == ()


def test_the_study_is_looked_for_where_it_was_identified(tmp_path: Path) -> None:
    """The command was called in the folder of the study, and wrote the result elsewhere."""
    project, results = tmp_path / "project", tmp_path / "results"
    project.mkdir()
    results.mkdir()
    study = exports.two_links(project)
    document = json.loads(exports.write(study, exports.values_of(study)).read_text())
    document["study"] |= {"path": "study.toml", "folder": str(project)}
    result = results / "result.json"
    result.write_text(json.dumps(document))
    assert read_arm(result).study.path == study.path


def test_a_changed_study_is_reported(tmp_path: Path) -> None:
    study = exports.two_links(tmp_path)
    path = exports.write(study, exports.values_of(study))
    text = study.path.read_text()
    study.path.write_text(text.replace("0.35", "0.36"))
    arm = read_arm(path)
    assert arm.study.arm.joints[1].origin.xyz[0] == 0.36
    assert [warning.code for warning in arm.warnings] == ["study-changed"]


def test_a_result_with_its_rig_needs_no_study_file(tmp_path: Path) -> None:
    """As this version writes results."""
    study = exports.two_links(tmp_path, "three-slope", gravity=9.81)
    path = exports.write(study, exports.values_of(study))
    document = json.loads(path.read_text())
    document["study"] |= {k: v for k, v in document_of(study).items() if k != "experiment"}
    path.write_text(json.dumps(document))
    study.path.unlink()
    arm = read_arm(path)
    assert arm.study.arm == study.arm
    assert arm.warnings == ()
    write_study(
        replace(study, arm=change_arm_keys(study.arm, link_length=0.4)), tmp_path / "other.toml"
    )
    assert read_arm(path, tmp_path / "other.toml").study.arm.joints[1].origin.xyz[0] == 0.4


def arm_without(folder: Path, *names: str) -> IdentifiedArm:
    """The rig without the values of some parameters."""
    study = exports.two_links(folder)
    arm = exports.arm_of(study, exports.values_of(study))
    nulled = tuple(replace(p, value=None) if p.name in names else p for p in arm.parameters)
    return replace(arm, parameters=nulled)


def test_a_missing_parameter_is_named(tmp_path: Path) -> None:
    arm = arm_without(tmp_path, "gear_damping")
    assert arm.need("beta") == arm.values["beta", None]
    with pytest.raises(InvalidInput, match="gear_damping of joint 2 is null"):
        arm.need("gear_damping", 2)
    with pytest.raises(InvalidInput, match="gravity_torque_1 is missing"):
        arm.need("gravity_torque_1")


@pytest.mark.parametrize(
    ("name", "value", "limit"),
    [("motor_inertia", 0.0, "positive"), ("gear_damping", -1.0, "zero or positive")],
)
def test_impossible_values_are_refused(name: str, value: float, limit: str, tmp_path: Path) -> None:
    study = exports.two_links(tmp_path)
    arm = exports.arm_of(study, exports.values_of(study))
    changed = tuple(
        replace(p, value=value) if (p.name, p.joint) == (name, 1) else p for p in arm.parameters
    )
    with pytest.raises(InvalidInput, match=f"{name} of joint 1 is {value:g} and not {limit}"):
        replace(arm, parameters=changed).need(name, 1)


def test_rejected_values_are_not_exported(tmp_path: Path) -> None:
    """Rejected by the list of the verdict, or by the sign."""
    study = exports.two_links(tmp_path)
    values: Values = exports.values_of(study) | {("gear_damping", 1): -1.0}
    path = exports.write(study, values)
    document = json.loads(path.read_text())
    document["verdict"] = {"rejected": ["link_inertia 2", "motor_inertia 2"]}
    path.write_text(json.dumps(document))
    arm = read_arm(path)
    assert arm.rejected == ("link_inertia 2", "motor_inertia 2", "gear_damping 1")
    kept = {p.label: p.value for p in arm.parameters}
    assert kept["gear_damping 1"] is kept["motor_inertia 2"] is None
    with pytest.raises(
        InvalidInput, match="motor_inertia of joint 2 is rejected by the verdict of the result"
    ):
        arm.need("motor_inertia", 2)
    with pytest.raises(
        InvalidInput, match=r"of joint [12] is rejected by the verdict of the result"
    ):
        to_mjcf(arm)
    assert json.loads(to_json(arm).data)["values"]["gear_damping_1"] is None
    document["verdict"] = {"rejected": "gear_damping 1"}
    path.write_text(json.dumps(document))
    with pytest.raises(InvalidInput, match="is not a list of names"):
        read_arm(path)


def test_a_total_replaces_its_parts_with_a_warning(tmp_path: Path) -> None:
    """The part of the motor without that of the link would give another total."""
    study = exports.two_links(tmp_path)
    values = exports.values_of(study)
    del values["link_viscous_friction", 1]
    del values["motor_viscous_friction", 2]
    for joint in (1, 2):
        values["total_viscous_friction", joint] = 2.5e-4
    arm = exports.arm_of(study, values)
    assert arm.need("motor_viscous_friction", 1) == 2.5e-4
    assert arm.need("link_viscous_friction", 1) == 0.0
    own = 2.5e-4 - 0.01**2 * values["link_viscous_friction", 2]
    assert arm.need("motor_viscous_friction", 2) == pytest.approx(own)
    assert [(c.code, c.where) for c in arm.assumed()] == [("assumed", "joint 1")]
    assert exports.arm_of(study, exports.values_of(study)).assumed() == ()
    behind_rigid_gears = exports.two_links(tmp_path, "rigid")
    assert exports.arm_of(behind_rigid_gears, values).assumed() == ()


def test_a_motor_behind_a_rigid_gear_may_have_no_inertia(tmp_path: Path) -> None:
    weightless: Values = {("motor_inertia", 1): 0.0}
    study = exports.two_links(tmp_path, "rigid")
    arm = exports.arm_of(study, exports.values_of(study) | weightless)
    assert arm.need("motor_inertia", 1) == 0.0
    study = exports.two_links(tmp_path, "linear")
    arm = exports.arm_of(study, exports.values_of(study) | weightless)
    with pytest.raises(InvalidInput, match="not positive"):
        arm.need("motor_inertia", 1)


def test_an_arbitrary_split_is_reported(tmp_path: Path) -> None:
    study = exports.two_links(tmp_path, "rigid")
    values = exports.values_of(study)
    total = values["alpha", None] + values["motor_inertia", 1] / 0.01**2
    del values["alpha", None], values["motor_inertia", 1]
    arm = exports.arm_of(study, values | {("rigid_inertia", 1): total})
    assert arm.need("alpha") + arm.need("motor_inertia", 1) / 0.01**2 == pytest.approx(total)
    assert ["arbitrary" in warning.message for warning in arm.assumed()] == [True]
