"""Resonance of a sensor mount in the whole-arm fit."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from effect_runs import whole_arm
from mount_runs import OnMount
from strainwave.domain import ArmModel, Log, Study, WholeArmOptions
from strainwave.domain.keys import Key, Values
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.link_sensors import MountResonance
from strainwave.dynamics.simulation import SensorNoise
from strainwave.identification.whole_arm import fit_whole_arm
from strainwave.identification.whole_arm.records.preparation import dataset_of
from strainwave.identification.whole_arm.selection import mountings
from strainwave.identification.whole_arm.selection.mountings import mount_changes
from tuning_runs import joint_models, rigid_model, shaken, shaken_study, simulated_logs, truth

FACTORS = np.random.default_rng(0).choice([-1.0, 1.0], size=(2, 6))
CUTOFF = 80.0
FEW_RIVALS = 0.1
"""Effort for a mount at 55 Hz, whose fits leave residuals: fits with effects would take 90 % of it.

The other mounts are fitted with the default effort.
"""


def names(joint: int) -> tuple[Key, Key]:
    return ("accelerometer_mount_frequency", joint), ("accelerometer_mount_damping", joint)


@cache
def mounted(joint: int, frequency: float, damping: float) -> tuple[Study, Values, tuple[Log, ...]]:
    study, values = truth()
    simulator = OnMount(joint, frequency, damping)
    short_study = shaken_study(study, 10.0)
    written, logs = simulated_logs(short_study, values, noise=SensorNoise(), simulator=simulator)
    return written, values, logs


@cache
def fit_of(
    joint: int, frequency: float, damping: float, *, is_held: bool = False
) -> tuple[Values, ArmModel]:
    """True values and the fit; `is_held` ignores the resonance of the mount."""
    study, true_values, logs = mounted(joint, frequency, damping)
    joints = joint_models(study, true_values, 0.05, FACTORS)
    rigid = rigid_model(study, true_values, 0.01, 1.0)
    options = WholeArmOptions(
        hold=("accelerometer_mount_frequency",) if is_held else (),
        rival_effort=FEW_RIVALS if (joint, frequency) == (1, 55.0) else 1.0,
    )
    return true_values, fit_whole_arm(logs, rigid, joints, Arm.of(study.arm), options)


def errors(known: Values, model: ArmModel, name: str) -> list[float]:
    return [abs(model.values[name, j] / known[name, j] - 1.0) for j in (1, 2)]


@pytest.mark.parametrize(
    ("joint", "frequency", "damping"),
    [(1, 55.0, 0.04), (1, 120.0, 0.02), (2, 55.0, 0.02), (2, 120.0, 0.05), (2, 85.0, 0.1)],
)
def test_a_mount_resonance_is_detected_named_and_corrected(
    joint: int, frequency: float, damping: float
) -> None:
    true_values, model = fit_of(joint, frequency, damping)
    assert model.status == "converged"
    estimates = {(p.name, p.joint): p for p in model.parameters}
    assert {key for key in estimates if key[0].startswith("accelerometer")} == set(names(joint))
    for key, true, unit in zip(names(joint), (frequency, damping), ("Hz", "1"), strict=True):
        assert estimates[key].unit == unit
        assert estimates[key].value == pytest.approx(true, rel=0.003 if unit == "Hz" else 0.01)
    assert max(errors(true_values, model, "gear_stiffness")) < 0.001
    assert max(errors(true_values, model, "gear_damping")) < 0.005
    mount_warnings = [w for w in model.warnings if w.code == "sensor-mount"]
    assert [w.where for w in mount_warnings] == [f"joint {joint}"]
    text = f"the mount of the accelerometer of link {joint} resonates at {frequency:g}"
    assert text in mount_warnings[0].message


def test_an_ignored_mount_resonance_resembles_a_delay_and_widens_intervals() -> None:
    """Gear errors stay below 0.1 % in stiffness and 0.5 % in damping."""
    _, with_mount = fit_of(1, 55.0, 0.04)
    true_values, ignored = fit_of(1, 55.0, 0.04, is_held=True)
    assert ignored.status == "at-bounds"
    assert "at-bounds" in {w.code for w in ignored.warnings if "delay" in w.where}
    assert max(errors(true_values, ignored, "gear_stiffness")) < 0.001
    assert max(errors(true_values, ignored, "gear_damping")) < 0.005
    stds = [
        {p.name: p.std for p in model.parameters if p.joint == 1} for model in (with_mount, ignored)
    ]
    for name in ("gear_stiffness", "gear_damping"):
        with_it, without = (std[name] for std in stds)
        assert with_it is not None
        assert without is not None
        assert without > 2.0 * with_it, name


def test_no_mount_is_tested_if_residuals_are_noise(monkeypatch: pytest.MonkeyPatch) -> None:
    """The residuals are noise, so no mount is tested."""

    def refused(*_: object) -> None:
        raise AssertionError("a mount was tested")

    monkeypatch.setattr(mountings, "mount_changes", refused)
    study, true_values, logs = shaken()
    joints = joint_models(study, true_values, 0.05, FACTORS)
    model = fit_whole_arm(
        logs, rigid_model(study, true_values, 0.01, 1.0), joints, Arm.of(study.arm)
    )
    assert not {p.name for p in model.parameters if "mount" in p.name}


@pytest.mark.parametrize("frequency", [18.0, 65.0])
def test_a_flexible_link_is_no_mount(frequency: float) -> None:
    model = whole_arm(("flexible-link",), (), shapes=((("flexible_frequency", 1), frequency),))
    mount_warnings = [
        w for w in model.warnings if w.code in ("flexible-link-likely", "sensor-mount")
    ]
    assert [(w.code, w.where) for w in mount_warnings] == [("flexible-link-likely", "joint 1")]


def test_a_sensor_of_unknown_place_may_ring_as_well() -> None:
    study, true_values, logs = mounted(2, 85.0, 0.1)
    joints = tuple(replace(joint, accelerometer_distance=None) for joint in study.arm.joints)
    unknown_position = replace(study, arm=replace(study.arm, joints=joints))
    start_joints = joint_models(study, true_values, 0.05, FACTORS)
    model = fit_whole_arm(
        logs, rigid_model(study, true_values, 0.01, 1.0), start_joints, Arm.of(unknown_position.arm)
    )
    assert model.status == "converged"
    estimates = {(p.name, p.joint): p.value for p in model.parameters}
    for name, true in zip(names(2), (85.0, 0.1), strict=True):
        assert estimates[name] == pytest.approx(true, rel=0.01)
    for joint, true_joint in enumerate(study.arm.joints, start=1):
        distance = estimates["accelerometer_distance", joint]
        assert distance == pytest.approx(true_joint.accelerometer_distance, rel=0.003)


def test_derivatives_are_those_of_the_difference() -> None:
    study, true_values, logs = shaken(noisy=False, counts=False)
    record = dataset_of(logs[0], Arm.of(study.arm), CUTOFF)
    values = true_values | {names(1)[0]: 70.0, names(1)[1]: 0.05, ("accelerometer_scale", 1): 1.03}
    keys: list[Key] = [*names(1), ("gear_stiffness", 1), ("accelerometer_scale", 1), *names(2)]
    rows, tangent = record.linearise(values, np.zeros(0), keys)
    assert not tangent[..., 4:].any()
    for k, key in enumerate(keys[:4]):
        h = {"gear_stiffness": 5.0, "accelerometer_mount_frequency": 1e-3}.get(key[0], 1e-6)
        ends = [
            record.linearise({**values, key: values[key] + sign * h}, np.zeros(0), [])[0]
            for sign in (1.0, -1.0)
        ]
        slope = (ends[0] - ends[1]) / (2.0 * h)
        # exact derivatives of the core against finite differences
        assert np.max(np.abs(tangent[..., k] - slope)) < 1e-4 * np.max(np.abs(slope)), key
    run = record.run(values, np.zeros(0), record.quantities())
    np.testing.assert_allclose(
        record.filtered_channels(run, values) * record.sensor_scales(values),
        rows,
        atol=1e-6 * np.ptp(rows),
    )


def test_the_tested_column_is_the_contribution_of_a_mount() -> None:
    study, true_values, logs = shaken(noisy=False, counts=False)
    record = dataset_of(logs[0], Arm.of(study.arm), CUTOFF)
    mounts = {names(2): [MountResonance(50.0, 0.05), MountResonance(90.0, 0.02)]}
    added = mount_changes(record, true_values, np.zeros(0), mounts)
    without_mount = record.linearise(true_values, np.zeros(0), [])[0]
    for k, mount in enumerate(mounts[names(2)]):
        values = true_values | dict(zip(names(2), (mount.frequency, mount.damping), strict=True))
        with_mount = record.linearise(values, np.zeros(0), [])[0]
        np.testing.assert_allclose(
            added[..., k], with_mount - without_mount, atol=1e-6 * np.ptp(without_mount)
        )
