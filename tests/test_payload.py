"""Loads of identified arms: recovery, refusals, warnings, the command and its file."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import load_records as records
import strainwave as sw
from command_line import run_here
from strainwave.domain import (
    ArmDescription,
    Control,
    Experiment,
    FloatArray,
    Joint,
    Origin,
    Payload,
    PayloadEstimate,
)
from strainwave.domain.arm.kinds import planar_two_link, single_joint
from strainwave.errors import InvalidInput, NotIdentifiable
from strainwave.io.logs import write_log
from strainwave.io.study import write_study

LOAD = records.LOAD
SERVOS: tuple[Control, ...] = ("servo", "servo", "servo")
MOTION = records.Motion(3)
Columns = dict[str, FloatArray]


def identify(folder: Path, described: ArmDescription, scale: float = 1.0) -> sw.Result:
    """The chain without a load, from two records of 10 s; torques are `scale` times the true."""
    data = {
        name: scaled(
            records.record(None, records.Motion(k), described=described, noise_seed=k), scale
        )
        for k, name in enumerate(("a", "b"), start=1)
    }
    study = records.study(folder, *data, arm=described)
    return sw.identify(study, data=data, stages="rigid")


def scaled(columns: Columns, scale: float) -> Columns:
    """The record with other torques."""
    return {k: x * (scale if k.startswith("torque") else 1.0) for k, x in columns.items()}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("load")


@pytest.fixture(scope="module")
def result(folder: Path) -> sw.Result:
    return identify(folder, records.arm())


@pytest.fixture(scope="module")
def carried() -> Columns:
    """A record of 10 s with the load."""
    return records.record(LOAD, MOTION)


def estimate(result: sw.Result, columns: Columns, **changes: Any) -> PayloadEstimate:
    return result.payload(records.study(Path(), "l", **changes), data={"l": columns})


def codes(load: PayloadEstimate) -> set[str]:
    return {warning.code for warning in load.warnings}


def standard(load: records.Load) -> FloatArray:
    """Ten standard parameters in the order of `PayloadEstimate.standard`."""
    centre = np.array(load.xyz)
    about = np.diag(load.moments)
    about += load.mass * (centre @ centre * np.eye(3) - np.outer(centre, centre))
    pairs = ((0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2))
    return np.array([load.mass, *(load.mass * centre), *(about[pair] for pair in pairs)])


def test_mass_centre_and_inertia_are_recovered(result: sw.Result, carried: Columns) -> None:
    """1 % and 3 mm are the accuracy to reach; the errors have the stated covariance."""
    load = estimate(result, carried)
    assert load.mass is not None
    assert load.mass.value == pytest.approx(LOAD.mass, rel=0.01)
    truth = [LOAD.mass, *LOAD.xyz, LOAD.moments[0], 0.0, 0.0, LOAD.moments[1], 0.0, LOAD.moments[2]]
    members = (load.mass, *load.xyz, *load.inertia_about_centre)
    for quantity, true in zip(members, truth, strict=True):
        assert quantity is not None
        assert abs(quantity.value - true) < 4.0 * quantity.std
        assert quantity.ci95[0] <= quantity.value <= quantity.ci95[1]
    for coordinate, true in zip(load.xyz, LOAD.xyz, strict=True):
        assert coordinate is not None
        assert abs(coordinate.value - true) < 3e-3
    assert codes(load) == {"torque-scale"}
    assert load.assumed == ()
    assert load.records == ("l",)
    assert load.torque_scale is None


def test_normalised_errors_have_unit_variance(result: sw.Result) -> None:
    """Their mean square over four records lies within 0.5 to 2; one arm, so its error is common."""
    squares = []
    for seed in range(4):
        columns = records.record(LOAD, records.Motion(20 + seed), noise_seed=20 + seed)
        load = estimate(result, columns)
        z = (load.standard - standard(LOAD)) / np.sqrt(np.diag(load.covariance))
        squares.append(z**2)
    assert 0.5 < float(np.mean(squares)) < 2.0


def test_without_a_load_the_mass_is_below_what_the_records_show(result: sw.Result) -> None:
    load = estimate(result, records.record(None, MOTION))
    assert load.mass is not None
    assert load.mass.ci95[0] == 0.0
    assert load.mass.ci95[1] < 0.02
    assert load.xyz == (None, None, None)
    assert load.body is None
    assert "load-not-seen" in codes(load)


def test_an_arm_that_lost_its_tool_carries_a_negative_load(folder: Path, carried: Columns) -> None:
    data = {"a": carried, "b": records.record(LOAD, records.Motion(4), noise_seed=4)}
    with_tool = sw.identify(records.study(folder, "a", "b"), data=data, stages="rigid")
    load = estimate(with_tool, records.record(None, records.Motion(5)))
    assert load.mass is not None
    assert load.mass.value == pytest.approx(-LOAD.mass, rel=0.02)
    assert "load-negative" in codes(load)
    assert load.body is None


def test_a_load_that_moves_within_the_record_is_detected(
    result: sw.Result, carried: Columns
) -> None:
    moved = records.record(replace(LOAD, xyz=(0.05, 0.03, 0.16)), MOTION)
    half = len(carried["t"]) // 2
    both = {name: np.r_[carried[name][:half], moved[name][half:]] for name in carried}
    assert "load-moved" in codes(estimate(result, both))
    assert "load-moved" not in codes(estimate(result, carried))


def test_a_known_load_shows_the_scale_of_the_torques(folder: Path) -> None:
    """All torques are stated 10 % too small, in the identification and with the load."""
    stated = Payload(LOAD.mass, LOAD.xyz)
    too_small = identify(folder, records.arm(), scale=1.0 / 1.1)
    record = (Experiment("l", "", "motion", SERVOS, payload=stated),)
    columns = scaled(records.record(LOAD, MOTION), 1.0 / 1.1)
    load = estimate(too_small, columns, experiments=record)
    assert load.stated == stated
    assert load.torque_scale is not None
    assert load.torque_scale.ci95[0] < 1.1 < load.torque_scale.ci95[1]
    assert load.torque_scale.value == pytest.approx(1.1, rel=0.01)
    assert "torque-scale-contradicted" in codes(load)
    assert "load-differs" not in codes(load)


def test_a_wrongly_stated_centre_is_no_error_of_the_scale(
    result: sw.Result, carried: Columns
) -> None:
    wrong = Payload(LOAD.mass, (LOAD.xyz[0], LOAD.xyz[1], -LOAD.xyz[2]))
    record = (Experiment("l", "", "motion", SERVOS, payload=wrong),)
    assert "load-differs" in codes(estimate(result, carried, experiments=record))


def test_one_moving_joint_shows_the_moments_about_its_axis(result: sw.Result) -> None:
    columns = records.record(LOAD, replace(MOTION, moving=(False, False, True)))
    load = estimate(result, columns)
    assert load.mass is None
    assert load.body is None
    first = load.quantities.first_moments
    for k in (0, 1):
        moment = first[k]
        assert moment is not None
        assert moment.value == pytest.approx(LOAD.mass * LOAD.xyz[k], abs=5.0 * moment.std)
    assert first[2] is None
    assert "load-undetermined" in codes(load)


PLANAR = ((4.0, (0.2, 0.0, 0.0)), (2.0, (0.15, 0.0, 0.0)))
JOINT = Joint("rigid", records.RATIO)


def planar_load(described: ArmDescription, load: records.Load) -> PayloadEstimate:
    """The load of a planar arm that two records without it identify."""
    n = described.n_joints
    links = PLANAR[:n]

    def study_of(*names: str) -> sw.Study:
        experiments = tuple(Experiment(name, "", "motion", SERVOS[:n]) for name in names)
        return records.study(Path(), arm=described, experiments=experiments)

    data = {
        name: records.record(
            load if name == "l" else None,
            records.Motion(seed),
            described=described,
            noise_seed=seed,
            links=links,
        )
        for seed, name in enumerate("abl", start=1)
    }
    load_record = {"l": data.pop("l")}
    result = sw.identify(study_of("a", "b"), data=data, stages="rigid")
    return result.payload(study_of("l"), data=load_record)


def test_a_planar_arm_shows_mass_and_centre_in_its_plane() -> None:
    load = records.Load(0.7, (0.28, 0.04, 0.05), (1e-3, 1e-3, 4e-3))
    estimate = planar_load(planar_two_link([JOINT, JOINT], 0.35, 9.81), load)
    x, y, z = estimate.xyz
    zz = estimate.inertia_about_centre[5]
    assert estimate.mass is not None
    for quantity, true in ((estimate.mass, 0.7), (x, 0.28), (y, 0.04), (zz, 4e-3)):
        assert quantity is not None
        assert abs(quantity.value - true) < 4.0 * quantity.std
    assert estimate.mass.value == pytest.approx(0.7, rel=0.01)
    assert z is None
    assert estimate.inertia_about_centre[:5] == (None,) * 5
    assert "z" in estimate.assumed


def test_a_pendulum_shows_first_moments_and_the_inertia_about_its_axis() -> None:
    estimate = planar_load(single_joint(JOINT, 9.81), records.Load(0.5, (0.2, 0.05, 0.0)))
    x, y, z = estimate.quantities.first_moments
    inertia = estimate.quantities.inertia_about_origin[5]
    for quantity, true in ((x, 0.1), (y, 0.025), (inertia, 0.5 * (0.2**2 + 0.05**2))):
        assert quantity is not None
        assert abs(quantity.value - true) < 4.0 * quantity.std
    assert (estimate.mass, estimate.xyz, z) == (None, (None,) * 3, None)
    assert estimate.body is None


# --- refusals ------------------------------------------------------------------------------------


def test_a_study_of_another_arm_is_refused(result: sw.Result, carried: Columns) -> None:
    arm = records.arm()
    others = {
        "gear_ratio of joint 1 is 0.03, and that of the": records.arm(gear_ratio=0.03),
        "gravity of .arm. is": records.arm((0.0, 0.0, 9.81)),
        "axis of joint 1 is": records.arm(axis=(0.0, 1.0, 0.0)),
        "origin of joint 1 is": records.arm(origin=Origin()),
        "attitude of joint 2 is": arm.with_joint(2, origin=Origin((0.06, 0.0, 0.1))),
        "coupling of .transmission. is": replace(
            arm, coupling=((1.0, 0.0, 0.0), (0.1, 1.0, 0.0), (0.0, 0.0, 1.0))
        ),
        "motion of joint 3 is prismatic": arm.with_joint(3, motion="prismatic"),
        "the study has 2 joints": replace(arm, joints=arm.joints[:2]),
    }
    for message, other in others.items():
        record = (Experiment("l", "", "motion", SERVOS[: other.n_joints]),)
        with pytest.raises(InvalidInput, match=message):
            estimate(result, carried, experiments=record, arm=other)


def test_records_that_cannot_show_the_load_are_refused(result: sw.Result, carried: Columns) -> None:
    cases: list[tuple[Columns, type[sw.StrainwaveError], str]] = [
        ({k: x[:100] for k, x in carried.items()}, InvalidInput, "too few"),
        (
            {k.replace("torque", "tau_l"): x for k, x in carried.items()},
            InvalidInput,
            "identified from torque1, and the logs have only tau_l1",
        ),
        (
            {k: 0.0 * x if k.startswith("theta") else x for k, x in carried.items()},
            InvalidInput,
            "the joint did not move",
        ),
        (standing(carried), NotIdentifiable, "no motor slides"),
        (
            records.record(LOAD, replace(MOTION, moving=(True, False, False))),
            NotIdentifiable,
            "determines neither the mass nor a first moment nor an inertia",
        ),
    ]
    for columns, kind, message in cases:
        with pytest.raises(kind, match=message):
            estimate(result, columns)


def standing(columns: Columns) -> Columns:
    """The record of motors that stand, with the noise of their encoders."""
    rng, count = np.random.default_rng(0), 2.0 * np.pi / 8192
    angles: Columns = {
        k: count * rng.integers(0, 2, len(x)).astype(np.float64)
        for k, x in columns.items()
        if k.startswith("theta")
    }
    return columns | angles


def test_records_with_different_stated_payloads_are_refused(
    result: sw.Result, carried: Columns
) -> None:
    given = tuple(
        Experiment(name, "", "motion", SERVOS, payload=payload)
        for name, payload in (("l", Payload(1.0)), ("m", None))
    )
    study = records.study(Path(), experiments=given)
    with pytest.raises(InvalidInput, match=r"different payloads.*Remedy: write one study per load"):
        result.payload(study, data={"l": carried, "m": carried})


def test_a_result_without_the_bodies_of_the_arm_is_refused(
    result: sw.Result, carried: Columns, folder: Path
) -> None:
    document = result.document
    bodies = [p for p in document["parameters"] if "friction" not in p["name"]]
    for parameter in bodies:
        parameter.update(value=None, std=None, ci95=None)
    with pytest.raises(NotIdentifiable, match="no inertia and no gravity torque of the arm"):
        estimate(sw.Result(document, source=folder / "result.json"), carried)
    del document["stages"]["rigid"]
    with pytest.raises(InvalidInput, match="has no rigid model"):
        estimate(sw.Result(document, source=folder / "result.json"), carried)


def test_undetermined_parameters_of_the_arm_widen_the_intervals(
    result: sw.Result, carried: Columns, folder: Path
) -> None:
    document = result.document
    last = [p for p in document["parameters"] if p["name"] == "link_first_moment_x"]
    last[-1].update(value=None, std=None, ci95=None)
    load = estimate(sw.Result(document, source=folder / "result.json"), carried)
    assert "arm-undetermined" in codes(load)
    known = estimate(result, carried)
    assert load.covariance[1, 1] > 100.0 * known.covariance[1, 1]


# --- the command ---------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def files(result: sw.Result, carried: Columns, folder: Path) -> Path:
    """Folder with a result, a study and its log."""
    result.save(folder / "result.json")
    write_log(folder / "l.csv", carried)
    record = (Experiment("l", "l.csv", "motion", SERVOS),)
    write_study(records.study(folder, experiments=record), folder / "load.toml")
    return folder


def test_the_command_writes_what_python_returns(
    files: Path, result: sw.Result, carried: Columns
) -> None:
    finished = run_here("payload", files, files / "load.toml", "--out", files / "out")
    assert (finished.returncode, finished.stderr) == (0, "")
    document = json.loads((files / "out" / "payload.json").read_text())
    load = estimate(result, carried)
    assert load.mass is not None
    assert document["schema"] == "strainwave/payload/1"
    assert set(document["mass"]) == {"value", "std", "ci95", "unit"}
    assert document["mass"]["value"] == pytest.approx(load.mass.value, rel=1e-6)
    assert [len(document[key]) for key in ("xyz", "inertia_about_centre")] == [3, 6]
    assert document["study"]["sha256"]
    assert {w["code"] for w in document["warnings"]} == codes(load)
    printed = " ".join(finished.stdout.split())
    assert "mass 1." in printed
    for text in document["export"].values():
        assert text in finished.stdout
    assert "note [torque-scale]" in printed


def test_exit_codes_of_the_command(files: Path, carried: Columns) -> None:
    """2 for a study of another arm, 3 for a motion that shows nothing; nothing is written."""
    record = (Experiment("l", "l.csv", "motion", SERVOS),)
    other = records.study(files, experiments=record, arm=records.arm(gear_ratio=0.01))
    write_study(other, files / "other.toml")
    write_log(files / "standing.csv", standing(carried))
    still = (Experiment("l", "standing.csv", "motion", SERVOS),)
    write_study(records.study(files, experiments=still), files / "still.toml")
    for name, code in (("other", 2), ("still", 3)):
        finished = run_here("payload", files, files / f"{name}.toml", "--out", files / name)
        assert finished.returncode == code, finished.stderr
        assert finished.stderr.startswith("strainwave: ")
        assert finished.stderr.count("\n") == 1
        assert not (files / name).exists()


# --- arms of an independent engine ---------------------------------------------------------------


def test_the_load_of_an_elastic_chain(shared_data: Path) -> None:
    """0.8 kg on three elastic joints, from the rigid step alone: 1 % and 3 mm."""
    folder = shared_data.parent / "serial" / "chain3-imu"
    truth = json.loads((folder / "payload-truth.json").read_text())
    study = sw.read_study(folder / "study.toml")
    motion = [each for each in study.experiments if each.use == "motion"]
    result = sw.identify(replace(study, experiments=tuple(motion)), stages="rigid")
    load = result.payload(folder / "payload.toml")
    assert load.mass is not None
    assert load.mass.value == pytest.approx(truth["mass"], rel=0.01)
    for coordinate, true in zip(load.xyz, truth["xyz"], strict=True):
        assert coordinate is not None
        assert abs(coordinate.value - true) < min(3e-3, 4.0 * coordinate.std)


def test_the_load_of_a_horizontal_arm(shared_data: Path) -> None:
    """Two disks of 1 kg at the tip, 0.3 m from axis 2: the difference of two records of the lab."""
    lab = shared_data / "lab"
    result = sw.identify(lab / "scara-strainwave-3kg" / "study.toml", stages="rigid")
    load = result.payload(lab / "scara-linear-5kg" / "study.toml")
    for quantity, true in zip((load.mass, *load.xyz[:2]), (2.0, 0.3, 0.0), strict=True):
        assert quantity is not None
        assert abs(quantity.value - true) < 4.0 * quantity.std
    assert load.xyz[2] is None
