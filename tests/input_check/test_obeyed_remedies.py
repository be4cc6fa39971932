"""A correction that the check prints is right, or the check objects to the corrected input."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from benchmarks.studies.drawn_chains import draw_chain, simulate_chain
from benchmarks.studies.faults.cases import faults
from benchmarks.studies.faults.inputs import Case, Input
from benchmarks.studies.faults.remedies import obey
from benchmarks.studies.faults.shared import outcome_of

from consistency_inputs import Input as Records
from strainwave.pipeline.inputs import check_input

Cases = dict[str, dict[str, Case]]


def in_memory(records: Records) -> Input:
    logs, study = records
    return Input(
        replace(study, channels={}), {log.name: {"t": log.time, **log.channels} for log in logs}
    )


def serial_arm(folder: Path) -> Input:
    """A drawn chain of three joints with IMUs under gravity: two motions and PRBS of joint 2."""
    chain = draw_chain(2, (3,), ("imu",))
    motion, prbs = chain.study.experiments[0], chain.study.experiments[3]
    check = replace(motion, name="motion-check", file="motion-check.parquet", use="check")
    study = replace(chain.study, experiments=(motion, check, prbs))
    simulate_chain(replace(chain, study=study), folder, 2)
    return Input.read(folder / "study.toml")


@pytest.fixture(scope="module")
def cases(
    horizontal_arm: Records, vertical_arm: Records, tmp_path_factory: pytest.TempPathFactory
) -> Cases:
    """Faults of joint 2 by kind of study and name."""
    planar = in_memory(horizontal_arm)
    arms = {
        "horizontal": planar,
        "vertical": in_memory(vertical_arm),
        "serial": serial_arm(tmp_path_factory.mktemp("serial")),
        "motors only": planar.motors_only(),
    }
    return {kind: {case.name: case for case in faults(arm, 2)} for kind, arm in arms.items()}


MET = (
    ("horizontal", "torque reversed"),
    ("horizontal", "torques exchanged"),
    ("horizontal", "PRBS clock x 2"),
    ("horizontal", "dead accelerometer"),
    ("vertical", "gear ratio 20 %"),
    ("vertical", "all torques in mN m"),
    ("vertical", "hanging zero pi"),
    ("vertical", "torque reversed in one record"),
    ("serial", "all torques reversed"),
    ("serial", "exchanged in one record"),
    ("motors only", "everything in degrees"),
    ("motors only", "all torques 20 ms late"),
    ("horizontal", "zero 1.6 rad"),
    ("vertical", "exchanged in one record"),
    ("vertical", "payload in one record"),
    ("serial", "zero 1.6 rad"),
    ("serial", "effort without gravity"),
    ("serial", "files exchanged"),
    ("motors only", "files exchanged"),
    ("motors only", "torques exchanged"),
    ("motors only", "exchanged in one record"),
    ("horizontal", "torque x 0.8"),
    ("motors only", "torques in A"),
    ("serial", "gear ratio x 1.25, motors only"),
    ("vertical", "angle 20 ms late"),
    ("vertical", "encoder stands still"),
    ("horizontal", "angle 20 ms late"),
    ("horizontal", "t of PRBS records x 1.05"),
    ("vertical", "torque 20 ms late"),
    ("vertical", "effort without gravity"),
)

MISSED = "the check does not see the fault"
ASTRAY = "the check accepts the input after a correction of another value"
UNMET = {
    ("horizontal", "effort without friction"): ASTRAY,
    ("horizontal", "current loop ten times too slow"): MISSED,
    ("serial", "torques in A"): ASTRAY,
    ("serial", "effort without friction"): MISSED,
    ("serial", "payload in one record"): MISSED,
    ("motors only", "gear ratio x 1.25, motors only"): MISSED,
}


@pytest.mark.parametrize(
    ("kind", "fault"),
    [
        *MET,
        *(
            pytest.param(*names, marks=pytest.mark.xfail(strict=True, reason=reason))
            for names, reason in UNMET.items()
        ),
    ],
)
def test_obeyed_remedies_are_right_or_the_check_objects(
    cases: Cases, kind: str, fault: str
) -> None:
    case = cases[kind][fault]
    suspected = check_input(case.given.study, data=case.given.tables).suspected
    assert suspected
    obedience = obey(case, suspected)
    assert obedience.remedy in ("right", "objects", "none"), obedience.differing


def test_the_inputs_without_a_fault_are_consistent(cases: Cases) -> None:
    for kind in cases:
        truth = cases[kind]["torque reversed"].truth
        assert truth is not None
        assert check_input(truth.study, data=truth.tables).suspected == ()


@pytest.mark.parametrize("kind", ["horizontal", "vertical", "serial"])
def test_locked_outputs_are_named_with_their_records(cases: Cases, kind: str) -> None:
    """The torques follow the angles as springs, which links under gravity can resemble."""
    case = cases[kind]["motors at a locked output"]
    (named,) = check_input(case.given.study, data=case.given.tables).suspected
    assert (named.code, named.corrections) == ("locked-output", ())
    assert {record for place in named.places for record in place.experiments} == set(case.records)


def test_a_motor_that_stands_in_one_record_does_not_count_as_exchanged(shared_data: Path) -> None:
    """The exchange makes one torque much better and the torques together worse."""
    given = Input.read(shared_data / "lab" / "scara-linear-5kg" / "study.toml")
    (case,) = (case for case in faults(given, 2) if "stands still in one record" in case.name)
    suspected = check_input(case.given.study, data=case.given.tables).suspected
    assert "swapped-channels" not in {each.code for each in suspected}


def test_a_ratio_that_predicts_as_well_as_frames_is_named_first(shared_data: Path) -> None:
    """Frames of one joint absorb a ratio that is wrong by 1 %, and errors of the model with it."""
    given = Input.read(shared_data.parent / "serial" / "chain6-motor" / "study.toml")
    (case,) = (case for case in faults(given, 2) if case.name == "gear ratio 1 %")
    suspected = check_input(case.given.study, data=case.given.tables).suspected
    assert (suspected[0].code, suspected[0].where) == ("wrong-gear-ratio", "joint 2 gear_ratio")
    assert obey(case, suspected).remedy == "right"


@pytest.mark.parametrize("fault", ["torque 20 ms late", "motors at a locked output"])
def test_faults_of_a_measured_arm_are_named(shared_data: Path, fault: str) -> None:
    """One of seven torques is late; the faults of simulated arms above are not repeated."""
    given = Input.read(shared_data.parent / "serial" / "kinova-gen3" / "study.toml")
    case = next(case for case in faults(given, 2) if case.name == fault)
    check = check_input(case.given.study, data=case.given.tables)
    assert outcome_of(case, check) == "named"
    assert len(check.suspected) == 1
