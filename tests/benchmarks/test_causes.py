"""The study of causes: drawn runs, agreement of both simulators, and evaluation."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from benchmarks.families.catalogue import plans
from benchmarks.families.causes import NO_CAUSE, OwnPlant
from benchmarks.studies.causes.evaluation import (
    evaluate,
    matters,
    naming_outcome,
    selection_outcome,
)
from benchmarks.studies.causes.runs import Run, causes, draw_run
from benchmarks.studies.causes.stated_causes import STATED, stated_table
from benchmarks.studies.causes.tables import tables

from strainwave.domain import FloatArray
from strainwave.dynamics.arm import Arm
from strainwave.virtual.experiments import Plan, Simulator

SAMPLES = 400
FINE_COUNTS = 1e12  # per motor turn, so that quantisation does not matter
DIFFERENT = ("tilt", "flexible-link", "drive-lag")
"""Causes with other parameters in MuJoCo (angle, stiffness, current loop) than our effects."""
SHARED = tuple(name for name in causes("own") if name not in (NO_CAUSE, *DIFFERENT))


def horizontal(name: str, joint: int | None = None) -> Run:
    """A run whose arm is excited in open loop."""
    runs = (draw_run(name, number) for number in range(30))
    return next(
        run for run in runs if not run.rig.study.arm.gravity and joint in (None, run.cause.joint)
    )


def excitation(run: Run) -> tuple[int, Plan]:
    """Index and shortened plan of the record that excites the joint of the cause."""
    study = run.rig.study
    for k, experiment in enumerate(study.experiments):
        if experiment.use == "frequency" and experiment.joint == run.cause.joint:
            alone = replace(run.rig, study=replace(study, experiments=(experiment,)))
            (plan,) = plans(alone, 0)
            return k, replace(plan, samples=SAMPLES)
    raise LookupError("no record excites the joint")


def encoder(run: Run, simulator: Simulator, plan: Plan) -> FloatArray:
    """Motor angle of the joint of the cause, without quantisation."""
    joints = tuple(replace(j, encoder_counts=FINE_COUNTS) for j in run.rig.study.arm.joints)
    arm = Arm.of(replace(run.rig.study.arm, joints=joints))
    trajectory = simulator(
        arm,
        run.rig.values,
        plan.drive,
        sample_time=plan.sample_time,
        samples=plan.samples,
        record=["encoder"],
    )
    return trajectory["encoder"][:, run.cause.joint - 1]


def test_a_run_is_drawn_again_by_its_number() -> None:
    run = draw_run("backlash", 3)
    assert draw_run("backlash", 3) == run
    assert draw_run("backlash", 4).cause != run.cause
    assert draw_run("backlash", 3, series=1).cause != run.cause


@pytest.mark.parametrize("name", SHARED)
def test_both_simulators_agree_on_a_cause(name: str) -> None:
    from benchmarks.studies.causes.in_mujoco import InMujoco

    run = horizontal(name)
    if "sliding_frequency" in run.cause.sizes:  # our base does not slide
        sizes = {**run.cause.sizes, "sliding_frequency": 1000.0}
        run = replace(run, cause=replace(run.cause, sizes=sizes))
    k, plan = excitation(run)
    none = replace(run.cause, name=NO_CAUSE)
    ours, ours_clean = (encoder(run, OwnPlant(cause, k), plan) for cause in (run.cause, none))
    theirs, theirs_clean = (encoder(run, InMujoco(cause, k), plan) for cause in (run.cause, none))
    effect = ours - ours_clean
    difference = np.linalg.norm(theirs - theirs_clean - effect)
    # both differ without a cause too, because friction takes MuJoCo two steps
    clean_difference = np.linalg.norm(theirs_clean - ours_clean)
    assert difference < 0.1 * np.linalg.norm(effect) + clean_difference


def test_a_slow_drive_is_a_current_loop_of_low_bandwidth() -> None:
    from benchmarks.studies.causes.in_mujoco import InMujoco

    run = horizontal("drive-lag")
    (k, plan), arm, index = excitation(run), run.rig.study.arm, run.cause.joint - 1
    joints = list(arm.joints)
    joints[index] = replace(joints[index], current_loop_hz=run.cause.sizes["bandwidth"])
    study = replace(run.rig.study, arm=replace(arm, joints=tuple(joints)))
    slow, none = replace(run, rig=replace(run.rig, study=study)), replace(run.cause, name=NO_CAUSE)
    ours, ours_clean = (encoder(each, OwnPlant(none, k), plan) for each in (slow, run))
    theirs, theirs_clean = (encoder(run, InMujoco(cause, k), plan) for cause in (run.cause, none))
    difference = np.linalg.norm(theirs - theirs_clean - (ours - ours_clean))
    clean_difference = np.linalg.norm(theirs_clean - ours_clean)
    assert difference < 0.1 * np.linalg.norm(ours - ours_clean) + clean_difference


def relative_change(run: Run, stiffness: float) -> float:
    """Change of the motor's motion by a flexible link, relative to its motion with a rigid one."""
    from benchmarks.studies.causes.in_mujoco import InMujoco

    k, plan = excitation(run)
    sizes = {**run.cause.sizes, "stiffness": stiffness}
    flexible = encoder(run, InMujoco(replace(run.cause, sizes=sizes), k), plan)
    rigid = encoder(run, InMujoco(replace(run.cause, name=NO_CAUSE), k), plan)
    return float(np.linalg.norm(flexible - rigid) / np.linalg.norm(rigid - rigid[0]))


@pytest.mark.parametrize("name", causes("mujoco"))
def test_every_cause_changes_the_motion_of_a_vertical_arm(name: str) -> None:
    from benchmarks.studies.causes.in_mujoco import InMujoco

    run = next(r for r in (draw_run(name, k) for k in range(0, 60, 2)) if r.rig.study.arm.gravity)
    k, plan = excitation(replace(run, cause=replace(run.cause, joint=2)))
    with_cause, clean = (
        encoder(run, InMujoco(cause, k), plan)
        for cause in (run.cause, replace(run.cause, name=NO_CAUSE))
    )
    assert np.all(np.isfinite(with_cause))
    assert np.ptp(with_cause - clean) > 0.0 or name in ("encoder-zero", "sensor-mount")


@pytest.mark.parametrize("joint", [1, 2])
def test_a_stiff_flexible_link_is_a_rigid_one(joint: int) -> None:
    run = horizontal("flexible-link", joint)
    # the change is proportional to the compliance
    assert relative_change(run, 400.0) < 0.2 * relative_change(run, 40.0) < 0.02


def test_a_clean_arm_is_determined_without_a_named_effect() -> None:
    result = evaluate(draw_run(NO_CAUSE, 3), engine="own", series=0)
    assert result["plain"]["status"] == "determined"
    assert result["plain"]["named"] is None
    assert not matters(result)
    assert "with_effect" not in result


def result_of(cause: str, value: float | None, named: list[Any] | None) -> dict[str, Any]:
    plain = {
        "parameters": [["motor_inertia", 1, 1.0, value, 0.02]],
        "named": named,
        "fit": "converged",
        "seconds": 1.0,
        "suspected": [],
    }
    healthy = {**plain, "parameters": [["motor_inertia", 1, 1.0, 1.001, 0.02]]}
    return {"cause": cause, "joint": 1, "plain": plain, "healthy": healthy}


@pytest.mark.parametrize(
    ("value", "named", "outcome", "matter"),
    [
        (1.03, ["backlash", 1], "effect and joint", True),
        (1.03, ["backlash", 2], "effect", True),
        (1.03, ["stribeck", 1], "another", True),
        (None, None, "nothing", True),
        (1.015, None, "nothing", False),  # its interval contains the true value
    ],
)
def test_outcome_of_a_run(value: float | None, named: Any, outcome: str, matter: bool) -> None:
    result = result_of("backlash", value, named)
    assert naming_outcome(result) == outcome
    assert matters(result) == matter


def test_a_value_missing_without_the_cause_too_does_not_matter() -> None:
    result = result_of("backlash", None, None)
    result["healthy"] = result["plain"]
    assert not matters(result)


@pytest.mark.parametrize(
    ("effects", "outcome"),
    [
        ([["backlash", 2]], "alone"),
        ([["backlash", 2], ["stribeck", 1]], "with others"),
        ([["stribeck", 1]], "others"),
        ([], "none"),
    ],
)
def test_outcome_of_a_selection(effects: list[Any], outcome: str) -> None:
    result = {**result_of("backlash", 1.0, None), "auto": {"effects": effects}}
    assert selection_outcome(result) == outcome


def test_a_suspected_torque_constant_names_a_drive_gain() -> None:
    result = result_of("drive-gain", None, None)
    result["plain"]["suspected"] = ["wrong-torque-constant"]
    assert naming_outcome(result) == "input fault"
    assert naming_outcome({**result, "cause": "backlash"}) == "refused"


def test_a_stated_cause_has_a_row_of_errors_and_effects() -> None:
    result = {**result_of("backlash", 1.03, ["backlash", 1]), "text": "backlash of 0.2 mrad"}
    result["auto"] = result_of("backlash", 1.001, None)["plain"] | {"effects": [["backlash", 1]]}
    (row,) = stated_table([result]).rows
    assert row[1] == "motor_inertia 1 +3 %"
    assert row[2:] == ("backlash of joint 1", "backlash 1", "none")


def test_every_stated_cause_is_drawn_with_its_kind_of_arm() -> None:
    for stated in STATED:
        run = stated.run(0)
        assert run.cause.name in causes("mujoco")
        assert run.rig.classes["gravity"] == stated.gravity


def test_tables_count_named_effects() -> None:
    runs = [
        result_of("backlash", 1.03, ["backlash", 1]),
        result_of("backlash", 1.03, ["stribeck", 1]),
        result_of(NO_CAUSE, 1.0, None),
    ]
    naming, accuracy, confusion, alarms = tables(runs)
    assert naming.rows[0][:6] == ("backlash", "2", "2", "2", "1", "0")
    assert accuracy.rows[0][1] == "0.0"
    assert confusion.head == ("cause", "backlash", "stribeck", "nothing")
    assert confusion.rows == (("backlash", "1", "1", ""),)
    assert alarms.rows[0] == ("nothing", "1")
    assert "| backlash | 2 | 2 |" in naming.markdown()


@pytest.mark.parametrize(
    ("cause", "number", "series", "outcome"),
    [
        ("drive-saturation", 0, 6060, "effect and joint"),
        ("drive-gain", 0, 8080, "input fault"),
    ],
)
def test_contradicting_torques_are_attributed_to_their_cause(
    cause: str, number: int, series: int, outcome: str
) -> None:
    run = draw_run(cause, number, series)
    result = evaluate(run, engine="own", series=series, healthy=False, with_effect=False)
    assert naming_outcome(result) == outcome
    is_refused = result["plain"]["status"] == "inconsistent-input"
    assert is_refused == (outcome == "input fault")
