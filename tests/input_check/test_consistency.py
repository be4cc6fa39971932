"""The input check reports each fault with its code and factor, and accepts fault-free input."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from benchmarks.studies.short_motions import suspected

from consistency_inputs import Input, changed, delayed
from strainwave import pipeline
from strainwave.domain import Suspicion
from strainwave.domain.arm.kinds import change_arm_keys
from strainwave.dynamics.arm import Arm
from strainwave.identification import rigid
from strainwave.input_check import check_consistency
from strainwave.io.logs import read_logs, write_log
from strainwave.io.study import read_study, write_study
from strainwave.signals.channels import estimate_encoder_count
from strainwave.signals.motor import prepare_motor_signals

DEGREE = np.pi / 180.0


def the_one(given: Input) -> Suspicion:
    suspicions = check_consistency(*given).suspected
    assert len(suspicions) == 1, [each.message for each in suspicions]
    return suspicions[0]


def with_joint(given: Input, joint: int, **keys: Any) -> Input:
    logs, study = given
    joints = list(study.arm.joints)
    joints[joint - 1] = replace(joints[joint - 1], **keys)
    return logs, replace(study, arm=replace(study.arm, joints=tuple(joints)))


def swapped(given: Input, kind: str) -> Input:
    logs, study = given
    other = {f"{kind}1": f"{kind}2", f"{kind}2": f"{kind}1"}
    return tuple(
        replace(log, channels={other.get(k, k): v for k, v in log.channels.items()}) for log in logs
    ), study


def test_fault_free_input_gives_no_suspicion(arm: Input) -> None:
    assert check_consistency(*arm).suspected == ()


@pytest.mark.parametrize("share", [2.0, 3.0, 5.0])
def test_accelerometers_too_coarse_for_slow_motion_give_no_suspicion(
    horizontal_arm: Input, share: float
) -> None:
    """Their steps are a multiple of what they read in the slow motion, up to a constant reading."""
    logs, study = horizontal_arm
    motion = next(log for log in logs if log.experiment.name == "motion")
    steps = {name: share * np.std(motion.channels[name]) for name in ("a1", "a2")}
    coarse = [
        {name: step * np.round(log.channels[name] / step) for name, step in steps.items()}
        for log in logs
    ]
    rounded = tuple(
        replace(log, channels={**log.channels, **readings})
        for log, readings in zip(logs, coarse, strict=True)
    )
    assert check_consistency(rounded, study).suspected == ()


@pytest.mark.parametrize("number", [23, 38, 71, 88, 98, 107, 133, 144])
def test_short_fault_free_records_give_no_suspicion(number: int) -> None:
    """Fault-free records of 6 s: similar motion of both joints, servo lag, or almost no motion."""
    assert suspected(number) == ()


@pytest.mark.parametrize(
    "name", ["scara-linear-5kg", "scara-strainwave-3kg", "vertical-linear-0kg"]
)
def test_lab_arms_give_no_suspicion(name: str, shared_data: Path) -> None:
    study = read_study(shared_data / "lab" / name / "study.toml")
    assert check_consistency(read_logs(study), study).suspected == ()


@pytest.mark.parametrize("name", ["dfki-double-pendulum", "emps", "ist-flexible-arm"])
def test_real_arms_give_no_suspicion(name: str, shared_data: Path) -> None:
    study = read_study(shared_data / "real" / name / "study.toml")
    assert check_consistency(read_logs(study), study).suspected == ()


@pytest.mark.parametrize(
    ("name", "factor", "code", "said"),
    [
        ("a1", 1.0 / 9.80665, "wrong-unit", "logged in g?"),
        ("a2", 1.0 / 9.80665, "wrong-unit", "logged in g?"),
        ("a1", -1.0, "wrong-sign", "its sign is wrong"),
        ("a2", -1.0, "wrong-sign", "its sign is wrong"),
        ("gyro2", 1.0 / DEGREE, "wrong-unit", "logged in deg/s?"),
        ("theta_m1", 1.0 / DEGREE, "wrong-unit", "logged in degrees?"),
        ("theta_m2", 8192.0 / (2.0 * np.pi), "wrong-unit", "logged in encoder counts?"),
        ("theta_m2", 0.5 / np.pi, "wrong-unit", "logged in turns?"),
        ("theta_m1", -1.0, "wrong-sign", "its sign is wrong"),
        ("u1", -1.0, "wrong-sign", "its sign is wrong"),
        ("u2", -1.0, "wrong-sign", "its sign is wrong"),
    ],
)
def test_wrong_units_and_signs_are_reported(
    horizontal_arm: Input, name: str, factor: float, code: str, said: str
) -> None:
    suspicion = the_one(changed(horizontal_arm, **{name: factor}))
    assert (suspicion.code, suspicion.where) == (code, name)
    assert suspicion.factor == pytest.approx(factor, rel=1e-3)
    assert said in suspicion.message
    # The remedy states the correction that removes the fault.
    assert f'channels.{name} = {{ column = "{name}", scale = {1.0 / factor:.7g}' in suspicion.remedy


@pytest.mark.parametrize(("factor", "unit"), [(1e3, "milliseconds"), (1e6, "microseconds")])
def test_a_wrong_unit_of_time_is_reported(arm: Input, factor: float, unit: str) -> None:
    logs, study = arm
    rescaled = tuple(
        replace(log, time=factor * log.time, sample_time=factor * log.sample_time) for log in logs
    )
    suspicion = the_one((rescaled, study))
    assert (suspicion.code, suspicion.where) == ("wrong-unit", "t")
    assert suspicion.factor == pytest.approx(factor)
    assert unit in suspicion.message


@pytest.mark.parametrize("kind", ["a", "u", "theta_m"])
def test_swapped_joints_are_reported(arm: Input, kind: str) -> None:
    suspicion = the_one(swapped(arm, kind))
    assert (suspicion.code, suspicion.where) == ("swapped-channels", f"{kind}1, {kind}2")
    assert f'channels.{kind}1 = "{kind}2"' in suspicion.remedy


@pytest.mark.parametrize("joint", [1, 2])
@pytest.mark.parametrize("ratio", [1.0, 0.02, 0.005])
def test_wrong_gear_ratios_are_reported(vertical_arm: Input, joint: int, ratio: float) -> None:
    suspicion = the_one(with_joint(vertical_arm, joint, gear_ratio=ratio))
    assert (suspicion.code, suspicion.where) == ("wrong-gear-ratio", f"joint {joint} gear_ratio")
    assert suspicion.factor == pytest.approx(ratio / 0.01, rel=0.03)


@pytest.mark.parametrize("degrees", [-10.0, 10.0])
def test_an_encoder_zero_error_is_not_a_wrong_gear_ratio(arm: Input, degrees: float) -> None:
    logs, study = arm
    motor = np.radians(degrees) / study.arm.joints[1].gear_ratio
    turned = tuple(
        replace(log, channels={**log.channels, "theta_m2": log.channels["theta_m2"] + motor})
        for log in logs
    )
    codes = {each.code for each in check_consistency(turned, study).suspected if not each.accepted}
    assert not codes - {"wrong-zero"}


@pytest.mark.parametrize("degrees", [-5.0, 5.0])
def test_a_tilted_table_is_not_a_wrong_gear_ratio(arm: Input, degrees: float) -> None:
    logs, study = arm
    ratios = np.array([joint.gear_ratio for joint in study.arm.joints])
    where = 0.5 * np.pi if study.arm.gravity else 0.5  # The tilt of a vertical arm rotates gravity.
    tilted = []
    for log in logs:
        angle = np.cumsum([n * log.channels[f"theta_m{i}"] for i, n in enumerate(ratios, 1)], 0)
        down = 9.81 * np.sin(np.radians(degrees)) * np.cos(angle - where)
        more = {f"a{i}": log.channels[f"a{i}"] + down[i - 1] for i in (1, 2)}
        tilted.append(replace(log, channels={**log.channels, **more}))
    assert check_consistency(tuple(tilted), study).suspected == ()


@pytest.mark.parametrize("joint", [1, 2])
def test_a_distance_from_the_wrong_axis_is_reported(arm: Input, joint: int) -> None:
    true_distance = arm[1].arm.joints[joint - 1].accelerometer_distance or 0.0
    suspicion = the_one(with_joint(arm, joint, accelerometer_distance=true_distance + 0.35))
    assert (suspicion.code, suspicion.where) == (
        "wrong-geometry",
        f"joint {joint} accelerometer_distance",
    )
    assert suspicion.factor == pytest.approx((true_distance + 0.35) / true_distance, rel=0.03)
    assert "measured from axis 1" in suspicion.message


@pytest.mark.parametrize(("joint", "factor"), [(1, 1.05), (2, 1.05), (2, 0.9)])
def test_the_rigid_fit_reports_a_wrong_torque_constant(
    arm: Input, tmp_path: Path, joint: int, factor: float
) -> None:
    e = arm[1].arm.joints[joint - 1].torque_per_command
    logs, study = with_joint(arm, joint, torque_per_volt=factor * e)
    for log in logs:
        write_log(tmp_path / log.experiment.file, {"t": log.time, **log.channels})
    write_study(study, tmp_path / "study.toml")
    result = pipeline.identify(tmp_path / "study.toml", stages=["rigid"])
    assert result.verdict.status == "inconsistent-input"
    assert {each.code for each in result.suspected} == {"wrong-torque-constant"}
    if len(result.suspected) > 1:  # found before the fit, which cannot tell the joints apart either
        return
    (suspicion,) = result.suspected
    assert suspicion.where == "torque_per_volt"
    assert suspicion.factor == pytest.approx(factor if joint == 1 else 1.0 / factor, rel=0.01)
    assert "multiply torque_per_volt of [[joint]] 2 by" in suspicion.remedy


def test_correct_torque_constants_give_a_ratio_of_one(small_arm: Input) -> None:
    logs, study = small_arm
    motion = [log for log in logs if log.experiment.use == "motion"]
    estimate = rigid.fit_rigid(
        [prepare_motor_signals(log, Arm.of(study.arm)) for log in motion], Arm.of(study.arm)
    )
    value, std = estimate.torque_ratios[2]
    assert abs(value - 1.0) < 4.0 * std + 1e-3
    assert std < 0.01


def test_a_torque_constant_wrong_by_ten_is_reported_by_the_input_check(small_arm: Input) -> None:
    e = small_arm[1].arm.joints[0].torque_per_command
    suspicion = the_one(with_joint(small_arm, 1, torque_per_volt=10.0 * e))
    assert suspicion.code == "wrong-torque-constant"
    assert "about" in suspicion.remedy
    assert suspicion.factor == pytest.approx(10.0, rel=0.3)


@pytest.mark.parametrize("factor", [0.5, 50.0])
def test_wrong_gear_ratios_of_a_small_arm_are_reported(small_arm: Input, factor: float) -> None:
    n = small_arm[1].arm.joints[1].gear_ratio
    suspicion = the_one(with_joint(small_arm, 2, gear_ratio=factor * n))
    assert (suspicion.code, suspicion.where) == ("wrong-gear-ratio", "joint 2 gear_ratio")
    assert suspicion.factor == pytest.approx(factor, rel=0.02)


@pytest.mark.parametrize(
    ("length", "scale", "where"), [(1.3, 1.0, "link_length"), (1.0, 0.85, "a2")]
)
def test_geometry_and_scale_errors_are_not_a_wrong_gear_ratio(
    small_arm: Input, length: float, scale: float, where: str
) -> None:
    logs, study = changed(small_arm, a2=scale)
    longer = change_arm_keys(study.arm, link_length=length * study.arm.joints[1].origin.xyz[0])
    suspicion = the_one((logs, replace(study, arm=longer)))
    assert suspicion.where == where
    assert suspicion.factor == pytest.approx(length * scale, rel=0.02)


def test_a_delay_of_a_millisecond_gives_no_suspicion(arm: Input) -> None:
    delayed_input = delayed(arm, ("a1", "a2", "gyro1", "gyro2"), 1e-3, 0.0)
    assert check_consistency(*delayed_input).suspected == ()


def test_a_large_delay_is_reported(arm: Input) -> None:
    suspicion = the_one(delayed(arm, ("a1", "a2", "gyro1", "gyro2"), 2e-2, 0.0))
    assert suspicion.code == "misaligned"
    assert suspicion.delay_s == pytest.approx(2e-2, rel=0.1)


def test_clock_drift_is_reported(arm: Input) -> None:
    rate = 1.5e-3 if arm[1].arm.gravity else 1e-3  # Gravity reduces the sensitivity.
    suspicion = the_one(delayed(arm, ("a1", "a2"), 0.0, rate))
    assert (suspicion.code, suspicion.where) == ("clock-drift", "a1, a2")
    assert suspicion.factor == pytest.approx(1.0 + rate, abs=3e-4)


def test_a_clipped_sensor_is_reported(arm: Input) -> None:
    logs, study = arm
    top = max(float(log.channels["a2"].max()) for log in logs)
    clipped_logs = tuple(
        replace(log, channels={**log.channels, "a2": np.minimum(log.channels["a2"], 0.6 * top)})
        for log in logs
    )
    suspicions = check_consistency(clipped_logs, study).suspected
    assert [(each.code, each.where) for each in suspicions] == [("clipped", "a2")]


def test_a_fault_gives_exit_code_3_and_a_remedy(arm: Input, tmp_path: Path) -> None:
    """The result contains only the rigid model, which does not use the accelerometers."""
    logs, study = changed(arm, a1=1.0 / 9.80665)
    for log in logs:
        write_log(tmp_path / log.experiment.file, {"t": log.time, **log.channels})
    write_study(study, tmp_path / "study.toml")
    result = pipeline.identify(tmp_path / "study.toml")
    assert result.verdict.status == "inconsistent-input"
    assert [each.where for each in result.suspected] == ["a1"]
    assert result.rigid is not None
    assert not result.joints
    assert result.whole_arm is None


def test_time_in_milliseconds_gives_no_traceback(arm: Input, tmp_path: Path) -> None:
    logs, study = arm
    for log in logs:
        write_log(tmp_path / log.experiment.file, {"t": 1e3 * log.time, **log.channels})
    write_study(study, tmp_path / "study.toml")
    result = pipeline.identify(tmp_path / "study.toml")
    assert result.verdict.status == "inconsistent-input"
    assert result.rigid is None


def test_no_usable_record_shows_no_encoder_count() -> None:
    assert estimate_encoder_count([]) is None


@pytest.mark.parametrize("fraction", [0.05, 0.25, 1.0 / 3.0, 0.5, 0.8])
def test_interpolated_samples_show_the_count_of_the_encoder(fraction: float) -> None:
    time = np.arange(20_000) / 4000.0
    angle = np.floor(200.0 * np.sin(2.0 * np.pi * 3.0 * time) + 2000.0 * time**2) * 1e-3
    shifted = np.interp(np.arange(len(time)) + fraction, np.arange(len(time)), angle)
    assert estimate_encoder_count([shifted]) == pytest.approx(1e-3, rel=1e-3)
