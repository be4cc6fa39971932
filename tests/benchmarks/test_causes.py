"""The study of causes: what is drawn, that both engines mean the same by a cause, what is counted."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from benchmarks.studies.causes.drawn import Run, causes, drawn
from benchmarks.studies.causes.judged import judged, matters, taken_up, verdict_on
from benchmarks.studies.causes.stated import STATED, before_and_after
from benchmarks.studies.causes.tables import tables

from strainwave.domain import FloatArray
from strainwave.dynamics.arm import Arm
from strainwave.virtual.families.causes import NOTHING, OwnPlant
from strainwave.virtual.families.short_records import plans
from strainwave.virtual.plans import Plan
from strainwave.virtual.records import Simulator

SAMPLES = 400
_FINE = 1e12  # counts
APART = ("tilt", "flexible-link", "drive-lag")
"""Causes that MuJoCo has by an angle, a stiffness or another current loop, and our plant as effects."""
SHARED = tuple(name for name in causes("own") if name not in (NOTHING, *APART))


def horizontal(name: str, joint: int | None = None) -> Run:
    """A run whose arm is shaken in open loop."""
    found = (drawn(name, number) for number in range(30))
    return next(
        run for run in found if not run.rig.study.arm.gravity and joint in (None, run.cause.joint)
    )


def shaken(run: Run) -> tuple[int, Plan]:
    """The start of the record that shakes the joint of the cause."""
    for k, (experiment, plan) in enumerate(
        zip(run.rig.study.experiments, plans(run.rig, 0), strict=True)
    ):
        if experiment.use == "frequency" and experiment.joint == run.cause.joint:
            return k, replace(plan, samples=SAMPLES)
    raise LookupError("no record shakes the joint")


def encoder(run: Run, simulator: Simulator, plan: Plan) -> FloatArray:
    """Of the joint of the cause, as fine as numbers are."""
    joints = tuple(replace(j, encoder_counts=_FINE) for j in run.rig.study.arm.joints)
    arm = Arm.of(replace(run.rig.study.arm, joints=joints))
    found = simulator(
        arm,
        run.rig.values,
        plan.drive,
        sample_time=plan.sample_time,
        samples=plan.samples,
        record=["encoder"],
    )
    return found["encoder"][:, run.cause.joint - 1]


def test_a_run_is_drawn_again_by_its_number() -> None:
    one, other = drawn("backlash", 3), drawn("backlash", 3)
    assert one == other
    assert drawn("backlash", 4).cause != one.cause
    assert drawn("backlash", 3, series=1).cause != one.cause


@pytest.mark.parametrize("name", SHARED)
def test_both_engines_mean_the_same_by_a_cause(name: str) -> None:
    from benchmarks.studies.causes.in_mujoco import InMujoco

    run = horizontal(name)
    if "sliding_frequency" in run.cause.sizes:  # what our plant's base does not do
        sizes = {**run.cause.sizes, "sliding_frequency": 1000.0}
        run = replace(run, cause=replace(run.cause, sizes=sizes))
    k, plan = shaken(run)
    none = replace(run.cause, name=NOTHING)
    own, own_none = (encoder(run, OwnPlant(each, k), plan) for each in (run.cause, none))
    other, other_none = (encoder(run, InMujoco(each, k), plan) for each in (run.cause, none))
    effect = own - own_none
    disagreement = np.linalg.norm(other - other_none - effect)
    # friction takes the engine two steps, by which both differ without a cause as well
    engines = np.linalg.norm(other_none - own_none)
    assert disagreement < 0.1 * np.linalg.norm(effect) + engines


def test_a_slow_drive_has_the_current_loop_that_our_plant_would_have() -> None:
    from benchmarks.studies.causes.in_mujoco import InMujoco

    run = horizontal("drive-lag")
    (k, plan), arm, place = shaken(run), run.rig.study.arm, run.cause.joint - 1
    joints = list(arm.joints)
    joints[place] = replace(joints[place], current_loop_hz=run.cause.sizes["bandwidth"])
    study = replace(run.rig.study, arm=replace(arm, joints=tuple(joints)))
    slow, none = replace(run, rig=replace(run.rig, study=study)), replace(run.cause, name=NOTHING)
    own, own_none = (encoder(each, OwnPlant(none, k), plan) for each in (slow, run))
    other, other_none = (encoder(run, InMujoco(each, k), plan) for each in (run.cause, none))
    disagreement = np.linalg.norm(other - other_none - (own - own_none))
    engines = np.linalg.norm(other_none - own_none)
    assert disagreement < 0.1 * np.linalg.norm(own - own_none) + engines


def bending(run: Run, stiffness: float) -> float:
    """How far a flexible link takes the motor from where a rigid one does, over its way."""
    from benchmarks.studies.causes.in_mujoco import InMujoco

    k, plan = shaken(run)
    sizes = {**run.cause.sizes, "stiffness": stiffness}
    bent = encoder(run, InMujoco(replace(run.cause, sizes=sizes), k), plan)
    rigid = encoder(run, InMujoco(replace(run.cause, name=NOTHING), k), plan)
    return float(np.linalg.norm(bent - rigid) / np.linalg.norm(rigid - rigid[0]))


@pytest.mark.parametrize("name", causes("mujoco"))
def test_every_cause_moves_an_upright_arm_of_the_engine(name: str) -> None:
    from benchmarks.studies.causes.in_mujoco import InMujoco

    run = next(r for r in (drawn(name, k) for k in range(0, 60, 2)) if r.rig.study.arm.gravity)
    k, plan = shaken(replace(run, cause=replace(run.cause, joint=2)))
    moved, without = (
        encoder(run, InMujoco(each, k), plan)
        for each in (run.cause, replace(run.cause, name=NOTHING))
    )
    assert np.all(np.isfinite(moved))
    assert np.ptp(moved - without) > 0.0 or name in ("encoder-zero", "sensor-mount")


@pytest.mark.parametrize("joint", [1, 2])
def test_a_flexible_link_of_great_stiffness_is_a_rigid_one(joint: int) -> None:
    run = horizontal("flexible-link", joint)
    # its compliance is one over its stiffness
    assert bending(run, 400.0) < 0.2 * bending(run, 40.0) < 0.02


def test_a_clean_arm_is_identified_and_nothing_named() -> None:
    found = judged(drawn(NOTHING, 3), engine="own", series=0)
    assert found["plain"]["status"] == "determined"
    assert found["plain"]["named"] is None
    assert not matters(found)
    assert "with_it" not in found


def finding(cause: str, value: float | None, named: list[Any] | None) -> dict[str, Any]:
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
    ("value", "named", "said", "counts"),
    [
        (1.03, ["backlash", 1], "effect and joint", True),
        (1.03, ["backlash", 2], "effect", True),
        (1.03, ["stribeck", 1], "another", True),
        (None, None, "nothing", True),
        (1.015, None, "nothing", False),  # its interval holds the truth
    ],
)
def test_what_is_said_of_a_run(value: float | None, named: Any, said: str, counts: bool) -> None:
    found = finding("backlash", value, named)
    assert verdict_on(found) == said
    assert matters(found) == counts


def test_what_the_arm_without_its_cause_does_not_show_either_does_not_count() -> None:
    found = finding("backlash", None, None)
    found["healthy"] = found["plain"]
    assert not matters(found)


@pytest.mark.parametrize(
    ("effects", "said"),
    [
        ([["backlash", 2]], "it alone"),
        ([["backlash", 2], ["stribeck", 1]], "it and others"),
        ([["stribeck", 1]], "others"),
        ([], "none"),
    ],
)
def test_what_a_fit_takes_up_by_itself(effects: list[Any], said: str) -> None:
    found = {**finding("backlash", 1.0, None), "auto": {"effects": effects}}
    assert taken_up(found) == said


def test_a_torque_constant_that_is_refused_by_name_counts_as_named() -> None:
    found = finding("drive-gain", None, None)
    found["plain"]["suspected"] = ["wrong-torque-constant"]
    assert verdict_on(found) == "input fault"
    assert verdict_on({**found, "cause": "backlash"}) == "refused"


def test_what_is_wrong_before_and_after_stands_beside_what_is_named() -> None:
    one = {**finding("backlash", 1.03, ["backlash", 1]), "text": "backlash of 0.2 mrad"}
    one["auto"] = finding("backlash", 1.001, None)["plain"] | {"effects": [["backlash", 1]]}
    (row,) = before_and_after([one]).rows
    assert row[1] == "motor_inertia 1 +3 %"
    assert row[2:] == ("backlash of joint 1", "backlash 1", "none")


def test_every_stated_cause_has_its_kind_of_arm() -> None:
    for stated in STATED:
        run = stated.run(0)
        assert run.cause.name in causes("mujoco")
        assert run.rig.classes["gravity"] == stated.gravity


def test_tables_count_what_is_taken_for_what() -> None:
    runs = [
        finding("backlash", 1.03, ["backlash", 1]),
        finding("backlash", 1.03, ["stribeck", 1]),
        finding(NOTHING, 1.0, None),
    ]
    named, mended, confused, alarms = tables(runs)
    assert named.rows[0][:6] == ("backlash", "2", "2", "2", "1", "0")
    assert mended.rows[0][1] == "0.0"
    assert confused.head == ("cause", "backlash", "stribeck", "nothing")
    assert confused.rows == (("backlash", "1", "1", ""),)
    assert alarms.rows[0] == ("nothing", "1")
    assert "| backlash | 2 | 2 |" in named.markdown()


@pytest.mark.parametrize(
    ("cause", "number", "series", "said"),
    [
        ("load-friction", 0, 7070, "effect and joint"),
        ("drive-saturation", 0, 6060, "effect and joint"),
        ("drive-gain", 0, 8080, "input fault"),
    ],
)
def test_torques_that_contradict_are_laid_to_what_explains_them(
    cause: str, number: int, series: int, said: str
) -> None:
    found = judged(drawn(cause, number, series), engine="own", series=series, named=False)
    assert verdict_on(found) == said
    assert found["plain"]["status"] != "determined"
