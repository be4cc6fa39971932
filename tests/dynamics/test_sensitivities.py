"""Derivatives of simulated experiments."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from serial_chains import chain
from strainwave.domain import Prbs, Spring
from strainwave.domain.arm.link_sensors.link_space import (
    ACCELEROMETER_QUANTITIES,
    GYRO_QUANTITIES,
    LINK_SIGNALS,
)
from strainwave.dynamics import excitation
from strainwave.dynamics.arm import Arm
from strainwave.identification.whole_arm.records.dataset import low_pass_kernels
from strainwave.virtual import scara

RIG = Arm.of(scara.STIFF.study(Path()).arm)
ARM = RIG.core
VALUES = RIG.parameter_vector(scara.STIFF.parameters())
ONE = excitation.prbs(Prbs(8, 1e-3, 1, 6.0))[:200]
VOLTAGE = np.column_stack([ONE, ONE[::-1]])
RECORD = ["motor_velocity", "accelerometer", "gyro", "link_angle"]
EXPERIMENT: dict[str, Any] = {
    "voltage": VOLTAGE,
    "motor_angle": (0.0, 0.0),
    "step": 1.25e-4,
    "steps_per_tick": 8,
    "steps_per_sample": 8,
    "samples": 200,
    "record": RECORD,
}


def test_values_match_the_simulation() -> None:
    directions = [("alpha", None), ("motor_inertia", 2), ("initial_link_angle", 1)]
    recorded = ARM.sensitivities(VALUES, ARM.experiment(**EXPERIMENT), directions)
    (plain,) = ARM.simulate(VALUES[None], [ARM.experiment(**EXPERIMENT)])
    for name in RECORD:
        values, tangents = recorded[name]
        np.testing.assert_array_equal(values, plain[name])
        assert tangents.shape == (200, 2, 3)


def test_derivatives_match_differences() -> None:
    k = ARM.parameter_names.index(("gear_damping", 1))
    directions = [ARM.parameter_names[k]]
    recorded = ARM.sensitivities(VALUES, ARM.experiment(**EXPERIMENT), directions)
    step = 1e-5 * VALUES[k]
    moved = VALUES + step * np.array([[1.0], [-1.0]]) * (np.arange(len(VALUES)) == k)
    above, below = ARM.simulate(moved, [ARM.experiment(**EXPERIMENT)] * 2)
    for name in RECORD:
        difference = (above[name] - below[name]) / (2.0 * step)
        # central differences over rounded knees have five digits
        scale = np.abs(difference).max()
        np.testing.assert_allclose(recorded[name][1][..., 0], difference, atol=1e-5 * scale)


def test_threads_do_not_change_the_result() -> None:
    def run(_: int) -> np.ndarray[Any, np.dtype[np.float64]]:
        names = ARM.parameter_names
        recorded = ARM.sensitivities(VALUES, ARM.experiment(**EXPERIMENT), names)
        return recorded["motor_velocity"][1]

    with ThreadPoolExecutor(2) as pool:
        one, other = pool.map(run, range(2))
    np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("direction", [("alpha", 1), ("initial_link_angle", 3), ("mass", None)])
def test_unknown_directions_are_rejected(direction: tuple[str, int | None]) -> None:
    with pytest.raises(ValueError, match=f'unknown direction "{direction[0]}"'):
        ARM.sensitivities(VALUES, ARM.experiment(**EXPERIMENT), [direction])


@pytest.mark.parametrize("spring", ["three-slope", "rigid"])  # two implementations of derivatives
@pytest.mark.parametrize("n_directions", [0, 3, 8])
def test_rows_are_filtered_samples(spring: Spring, n_directions: int) -> None:
    rig = Arm.of(scara.STIFF.study(Path(), spring).arm)
    arm, values = rig.core, rig.parameter_vector(scara.STIFF.parameters(spring=spring))
    directions = arm.parameter_names[:n_directions]
    experiment = arm.experiment(**EXPERIMENT)
    full = arm.sensitivities(values, experiment, directions)
    kernels = low_pass_kernels(60.0, 1e-3)
    taps = [kernels.taps(slope=name == "link_angle") for name in RECORD]
    channels = [(k, i, -2.0 if i else 1.0) for k in range(len(RECORD)) for i in (1, 0)]
    rule = np.random.default_rng(1).normal(size=(n_directions, 5))
    readings, tangents = arm.channel_sensitivities(
        values, experiment, directions, channels, rule, taps=taps, samples_per_row=kernels.step
    )
    for at, (k, i, factor) in enumerate(channels):
        of_values, of_tangents = full[RECORD[k]]
        samples = np.column_stack([of_values[:, i], of_tangents[:, i] @ rule])
        expected = factor * kernels.rows(samples, slope=RECORD[k] == "link_angle")
        actual = np.column_stack([readings[:, at], tangents[:, at]])
        assert actual.shape == expected.shape
        assert np.all(np.abs(actual - expected) <= 1e-12 * np.abs(expected).max(axis=0))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"taps": [np.ones(8)] * 3}, "expected taps for each quantity"),
        ({"taps": [np.ones(8)] * 3 + [np.ones(4)]}, "expected taps for each quantity"),
        ({"taps": [np.ones(8)] * 4, "samples_per_row": 3}, "expected taps for each quantity"),
        ({"channels": [(4, 0, 1.0)]}, "no quantity 4 of joint 0"),
        ({"channels": [(0, 2, 1.0)]}, "no quantity 0 of joint 2"),
        ({"chain": np.eye(2)}, "expected 1 rows, got 2"),
    ],
)
def test_invalid_channels_are_rejected(changes: dict[str, Any], message: str) -> None:
    arguments: dict[str, Any] = {
        "with_respect_to": [("alpha", None)],
        "channels": [(0, 0, 1.0)],
        "chain": np.eye(1),
        "taps": [np.ones(8)] * 4,
        "samples_per_row": 4,
    }
    with pytest.raises(ValueError, match=message):
        ARM.channel_sensitivities(VALUES, ARM.experiment(**EXPERIMENT), **arguments | changes)


def test_readings_of_imus_are_weighted_sums_of_signals_of_links() -> None:
    rng = np.random.default_rng(3)
    directions = [("alpha", None), ("gear_damping", 2), ("initial_link_angle", 1)]
    for is_gyro, signals in ((False, ACCELEROMETER_QUANTITIES), (True, GYRO_QUANTITIES)):
        experiment = ARM.experiment(**EXPERIMENT | {"record": list(signals)})
        expected = ARM.sensitivities(VALUES, experiment, directions)
        weights = np.zeros((2, len(LINK_SIGNALS)))
        at = [LINK_SIGNALS.index(name) for name in signals]
        weights[:, at] = rng.normal(size=(2, len(signals)))
        changes = {"record": ["reading"], "link_sensors": [("reading", is_gyro, weights)]}
        experiment = ARM.experiment(**EXPERIMENT | changes)
        (reading,) = ARM.sensitivities(VALUES, experiment, directions).values()
        for part, weight in ((0, weights[:, at]), (1, weights[:, at, None])):
            stacked = np.stack([expected[name][part] for name in signals], 2)
            total = (stacked * weight).sum(axis=2)
            np.testing.assert_allclose(reading[part], total, atol=1e-12 * np.abs(stacked).max())


def test_sensors_on_links_have_weights_for_each_joint() -> None:
    with pytest.raises(ValueError, match="link_sensors"):
        ARM.experiment(
            link_sensors=[("reading", False, np.zeros((1, 15)))],
            **EXPERIMENT | {"record": ["reading"]},
        )


def test_experiments_on_other_arms_are_rejected() -> None:
    joint = chain([("revolute", [0.0] * 3, [0.0] * 3, [0.0, 0.0, 1.0])])
    with pytest.raises(ValueError, match="expected an experiment on 1 joints, got 2"):
        joint.simulate(np.zeros((1, 18)), [ARM.experiment(**EXPERIMENT)])
