"""Torsional benches that log the torque of the motor at the sampling rate of its command."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import strainwave as sw
from strainwave.domain import FloatArray
from strainwave.domain.arm.link_sensors.link_space import Quantity
from strainwave.domain.keys import Values
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.simulation import Drive, simulate
from strainwave.io.study import read_study
from strainwave.signals.drive_law import smooth_commands

RATE, FINE = 250.0, 16  # Hz; steps of a smooth torque per sample
STUDY = """
[arm]
kind = "single-joint"

[[joint]]
spring = "linear"
gear_ratio = 0.02
encoder_counts = 8192
link_encoder_counts = 262144
effects = []

[[experiment]]
name = "shaking"
file = "shaking.csv"
use = "frequency"
joint = 1
control = ["open"]
"""
TRUE: Values = {
    ("motor_inertia", 1): 6e-5,
    ("link_inertia", 1): 0.12,
    ("gear_stiffness", 1): 900.0,
    ("gear_damping", 1): 0.6,
    ("motor_viscous_friction", 1): 1e-4,
    ("link_viscous_friction", 1): 0.05,
    ("motor_coulomb_friction", 1): 0.015,
    ("friction_offset", 1): 0.0,
}


def multisine(time: FloatArray) -> FloatArray:
    rng, hz = np.random.default_rng(3), np.linspace(0.5, 30.0, 60)
    phase = rng.uniform(0.0, 2.0 * np.pi, len(hz))
    waves = np.sin(2.0 * np.pi * np.outer(time, hz) + phase).sum(axis=1)
    return np.asarray(0.12 * waves / np.std(waves))


def bench(folder: Path, *, held: bool) -> sw.Identification:
    """Result of a bench whose torque is a held command, or smooth between its samples."""
    path, T, n = folder / "study.toml", 1.0 / RATE, 2000
    path.write_text(STUDY)
    log = folder / "shaking.csv"
    log.touch()
    arm = Arm.of(read_study(path).arm)
    tick = T if held else T / FINE
    middle = 0.0 if held else 0.5 * tick
    applied = multisine(np.linspace(middle, middle + n * T, round(n * T / tick), endpoint=False))
    drive = Drive(tick, applied[:, None], 0.0 * applied[:, None], (False,), (0.0,), (0.0,))
    record: list[Quantity] = ["encoder", "link_angle"]
    run = simulate(arm, TRUE, drive, sample_time=T, samples=n, record=record)
    count = 2.0 * np.pi / 262144
    columns = {
        "t": run.time,
        "torque1": multisine(np.asarray(run.time, dtype=np.float64)),
        "theta_m1": run["encoder"][:, 0],
        "theta_l1": count * np.round(run["link_angle"][:, 0] / count),
    }
    np.savetxt(
        log,
        np.column_stack(list(columns.values())),
        delimiter=",",
        header=",".join(columns),
        comments="",
    )
    return sw.identify(path)


@pytest.mark.parametrize("held", [True, False])
def test_the_fit_tells_commands_from_smooth_torques(tmp_path: Path, held: bool) -> None:
    """A smooth torque taken for a command, or the reverse, biases inertias by 1 %."""
    result = bench(tmp_path, held=held)
    names = {p.name for p in result.parameters}
    assert ("torque_hold" in names) is held
    if held:
        assert result["torque_hold", 1].value == pytest.approx(1.0, abs=0.01)
        assert "torque-hold" in {warning.code for warning in result.warnings}
    assert "motor_encoder_delay" not in names
    for name in ("motor_inertia", "link_inertia", "gear_stiffness"):
        assert result[name, 1].value == pytest.approx(TRUE[name, 1], rel=1e-3)


@pytest.mark.parametrize("hz", [10.0, 25.0, 40.0])
def test_smooth_commands_move_an_inertia_as_the_torque_does(hz: float) -> None:
    """The angle under held torques follows the double integral of the wave, -x / w^2."""
    T, w = 1.0 / RATE, 2.0 * np.pi * hz
    commands = smooth_commands(np.cos(w * T * np.arange(400)))[4:-4]
    # from the discrete equation of the angle, (z - 1)^2 q = T^2 / 2 (z + 1) u
    second_difference = 0.5 * T**2 * (commands[1:] + commands[:-1])
    t = T * (np.arange(len(second_difference)) + 5)
    expected = (2.0 - 2.0 * np.cos(w * T)) * np.cos(w * t) / w**2
    assert second_difference == pytest.approx(expected, abs=(0.5 * w * T) ** 8 * T**2)
