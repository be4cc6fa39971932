"""The study of faults: comparison of inputs, classes of remedies and of answers."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from benchmarks.studies.faults.comparison import Tolerance, differences
from benchmarks.studies.faults.inputs import Case, Columns, Input
from benchmarks.studies.faults.remedies import obey
from benchmarks.studies.faults.shared import contradicts_itself, outcome_of
from benchmarks.studies.faults.torques import locked, stating

from strainwave.domain import Clause, Correction, InputCheck, Place, Relation, Suspicion

NOTHING: Any = None  # what the tested function does not read


@pytest.fixture(scope="module")
def given() -> Input:
    """The small arm of the repository."""
    return Input.read(Path(__file__).parents[1] / "data" / "small-arm" / "study.toml")


def suspicion(code: str, *corrections: Correction, channel: str = "theta_m2") -> Suspicion:
    clause = Clause("remedy", steps=())
    return Suspicion(
        code=code,
        places=(Place(channel=channel),),
        clause=clause,
        remedy_clause=clause,
        corrections=corrections,
    )


def answer(*suspected: Suspicion, unchecked: tuple[str, ...] = ()) -> InputCheck:
    return InputCheck(study=NOTHING, suspected=suspected, unchecked=unchecked, seconds=0.0)


def ratio(factor: float, given: Input) -> Input:
    stated = given.study.arm.joints[1].gear_ratio
    return given.stated(Correction("joint", "2", "gear_ratio", factor * stated))


def length(factor: float, given: Input) -> Input:
    return given.stated(Correction("arm", "", "link_length", factor * 0.25))


def late(seconds: float, given: Input) -> Input:
    return given.late(["theta_m2"], seconds)


def zero(angle: float, given: Input) -> Input:
    offset = angle / given.study.arm.joints[1].gear_ratio

    def move(table: Columns) -> Columns:
        return {**table, "theta_m2": table["theta_m2"] + offset}

    return given.changed(move)


def slow_loop(seconds: float, given: Input) -> Input:
    before = given.study.arm.joints[1].current_loop_hz
    assert before is not None
    hz = 1.0 / (1.0 / before + 2.0 * np.pi * seconds)
    return given.stated(Correction("joint", "2", "current_loop_hz", hz))


@pytest.mark.parametrize(
    ("change", "within", "beyond"),
    [
        (ratio, 1.004, 1.006),
        (length, 1.018, 1.022),
        (late, 1.8e-3, 2.2e-3),
        (zero, 0.018, 0.022),
        (slow_loop, 0.8e-4, 1.2e-4),
    ],
)
def test_differences_begin_at_the_tolerance(
    given: Input, change: Callable[[float, Input], Input], within: float, beyond: float
) -> None:
    assert differences(change(within, given), given, Tolerance()) == []
    assert differences(change(beyond, given), given, Tolerance())


def test_a_scale_and_a_constant_of_the_study_correct_the_same_fault(given: Input) -> None:
    faulty = given.scaled(["u2"], 2.0)
    assert differences(faulty, given, Tolerance())
    half = 0.5 * given.study.arm.joints[1].torque_per_command
    corrections = (
        Correction("channels", "u2", "scale", 0.5),
        Correction("joint", "2", "torque_per_volt", half),
    )
    for correction in corrections:
        # the level of the PRBS is that of the voltage in the log
        assert differences(faulty.stated(correction), given, Tolerance()) == []


def test_a_shift_of_the_whole_arm_is_no_difference(given: Input) -> None:
    moved = given.stated(Correction("joint", "1", "origin.xyz", (0.3, -0.2, 0.7)))
    assert differences(moved, given, Tolerance()) == []


def test_another_channel_and_a_meaning_are_differences(given: Input) -> None:
    torques = given.with_torques()
    assert "meaning of torque1" in differences(
        stating(torques, "without-friction"), torques, Tolerance()
    )
    other = given.exchanged(["u1"], ["u2"], ["motion"])
    assert set(differences(other, given, Tolerance())) == {"motion u1", "motion u2"}
    assert differences(given.without_records("motion"), given, Tolerance()) == []
    assert differences(given, given.without_records("motion"), Tolerance()) == ["motion"]


REMEDIES: Mapping[str, tuple[Correction, ...]] = {
    "right": (Correction("channels", "theta_m2", "scale", 0.5),),
    "no-op": (Correction("channels", "theta_m2", "scale", 1.0),),
    "objects": (Correction("channels", "theta_m2", "scale", 0.0),),  # an angle that never changes
    "none": (),
}


@pytest.mark.parametrize("remedy", REMEDIES)
def test_remedies_are_classified(given: Input, remedy: str) -> None:
    case = Case("factor", given.scaled(["theta_m2"], 2.0), ("wrong-unit",), (2,), truth=given)
    obedience = obey(case, (suspicion("wrong-unit", *REMEDIES[remedy]),))
    assert (obedience.remedy, obedience.differing) == (remedy, ())


def test_a_remedy_to_which_the_check_agrees_is_wrong_without_the_true_values(given: Input) -> None:
    case = Case("ratio", given, ("wrong-gear-ratio",), (2,), truth=ratio(1.01, given))
    correction = Correction("channels", "u1", "scale", 1.002)  # which the check cannot see
    obedience = obey(case, (suspicion("wrong-unit", correction),))
    assert obedience.remedy == "wrong"
    assert "gear_ratio 2" in obedience.differing


def test_an_answer_names_a_fault_by_code_and_place() -> None:
    case = Case("fault", NOTHING, ("wrong-sign",), joints=(2,), unchecked="tau_l2")
    assert outcome_of(case, answer()) == "missed"
    assert outcome_of(case, answer(unchecked=("tau_l2",))) == "named"
    assert outcome_of(case, answer(suspicion("wrong-sign"))) == "named"
    assert outcome_of(case, answer(suspicion("wrong-sign", channel="u1"))) == "wrong"
    other = suspicion("wrong-unit")
    assert outcome_of(case, answer(other, other, suspicion("wrong-sign"))) == "wrong"
    clean = Case("clean", NOTHING)
    assert outcome_of(clean, answer()) == "ok"
    assert outcome_of(clean, answer(other)) == "accused"


def test_a_verdict_that_does_not_follow_from_its_values_is_counted() -> None:
    place = Place(channel="a2")
    assert contradicts_itself(Relation("scale", place, 2.0, 0.1, 1.0, True, 0.3))
    assert not contradicts_itself(Relation("scale", place, 1.2, 0.1, 1.0, True, 0.3))
    assert contradicts_itself(Relation("inertia", place, -84.0, 0.1, None, True, 1.0))
    least = Relation("explained-share", place, 0.99, 0.1, 0.95, True, 0.0, "least")
    assert not contradicts_itself(least)


def test_a_clamped_motor_winds_up_its_gear(given: Input) -> None:
    clamped = locked(given)
    table = clamped.tables["motion"]
    assert np.corrcoef(table["theta_m1"], table["u1"])[0, 1] > 0.99
    assert {each.control for each in clamped.study.experiments} == {("open", "open")}
    assert set(clamped.tables) == set(given.motions)
    assert not clamped.of_kinds(("a", "ref"))
