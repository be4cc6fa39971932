"""Periodic motions: detection of the period, and fits with the information of one period."""

from __future__ import annotations

import numpy as np
import pytest

import virtual_arms
from strainwave.domain import FloatArray, Log, Signals, Study
from strainwave.domain.keys import Values
from strainwave.dynamics.arm import Arm
from strainwave.identification import rigid
from strainwave.identification.rigid.trial import bandwidths_of
from strainwave.signals import motor as signals
from strainwave.signals.motor import period_of

CLOCK = virtual_arms.CLOCK
PERIOD = 4.0


def multisine(period: float, seed: int) -> FloatArray:
    """Motor velocities [rad/s] of one period with harmonics up to 2 Hz: (n_samples, 2)."""
    rng = np.random.default_rng(seed)
    time: FloatArray = CLOCK * np.arange(round(period / CLOCK), dtype=np.float64)
    columns = []
    for _ in range(2):
        angle, velocity = np.zeros(len(time)), np.zeros(len(time))
        for k in range(1, int(2.0 * period) + 1):
            size, phase, w = rng.normal(), rng.uniform(0, 6.28), 2.0 * np.pi * k / period
            angle += size * np.sin(w * time + phase)
            velocity += size * w * np.cos(w * time + phase)
        reach = (100.0 / np.abs(angle - angle.mean()).max(), 150.0 / np.abs(velocity).max())
        columns.append(min(reach) * velocity)
    return np.column_stack(columns)


def repeated_log(study: Study, values: Values, seed: int, periods: int) -> Log:
    """Log of a servoed periodic motion."""
    reference = np.tile(multisine(PERIOD, seed), (periods, 1))
    reference[:200] *= np.linspace(0.0, 1.0, 200)[:, None]
    return virtual_arms.servoed_log(study, values, reference)


def moving(velocity: FloatArray) -> Signals:
    """Signals with the given velocities; the other channels are zero."""
    time: FloatArray = CLOCK * np.arange(len(velocity), dtype=np.float64)
    zeros = np.zeros_like(velocity)
    return virtual_arms.exact_signals((time, zeros, velocity, zeros), zeros)


@pytest.mark.parametrize("periods", [1.6, 2.0, 3.4, 40.0])
def test_a_period_is_estimated(periods: float) -> None:
    one_period = multisine(PERIOD, 1)
    velocity = np.tile(one_period, (41, 1))[: round(periods * len(one_period))]
    velocity = velocity + np.random.default_rng(0).normal(0.0, 1.0, velocity.shape)
    assert period_of(moving(velocity)) == pytest.approx(len(one_period), abs=3.0)


def test_a_period_between_samples_is_estimated() -> None:
    time: FloatArray = CLOCK * np.arange(40_000, dtype=np.float64)
    period = 1.2345  # [s]
    waves = [np.sin(2.0 * np.pi * k * time / period + k) for k in (1, 2, 3)]
    velocity = np.column_stack([waves[0] + waves[1], waves[1] - waves[2]])
    assert period_of(moving(velocity)) == pytest.approx(period / CLOCK, abs=0.05)


def test_motion_without_repetition_has_no_period() -> None:
    time, _, velocity, _ = virtual_arms.exact_motion(2, seed=3)
    assert period_of(moving(velocity)) == len(time)
    assert period_of(moving(np.zeros_like(velocity))) == len(time)
    once_more = np.concatenate([np.tile(velocity[:3000], (4, 1)), 2.0 * velocity[::-1]])
    assert period_of(moving(once_more)) == len(once_more)
    one_joint = np.tile(velocity[:3000], (4, 1))
    one_joint[:, 1] = velocity[: len(one_joint), 1]  # joint 2 is not periodic
    assert period_of(moving(one_joint)) == len(one_joint)


@pytest.mark.parametrize("seed", [2, 4])
def test_sixteen_periods_give_the_estimate_of_one_period(seed: int) -> None:
    """Blocks shorter than a period would allow 2 Hz, with errors of 18 standard deviations."""
    study = virtual_arms.rigid_two_link()
    values = virtual_arms.values_of(study, seed)
    truth = virtual_arms.rigid_truth(study, values)
    model = rigid.fit_rigid(
        [signals.prepare_motor_signals(repeated_log(study, values, seed, 16), Arm.of(study.arm))],
        Arm.of(study.arm),
    )
    assert model.bandwidth_hz > 2.0 * 8.0 / PERIOD
    for name, joint in (
        ("rigid_inertia", 1),
        ("motor_inertia", 2),
        ("beta", None),
        ("gamma", None),
    ):
        (parameter,) = (p for p in model.parameters if (p.name, p.joint) == (name, joint))
        assert parameter.value is not None
        assert parameter.std is not None
        assert abs(parameter.value - truth[name, joint]) < 3.0 * parameter.std


def test_a_repetition_leaves_the_first_bandwidth() -> None:
    """The first bandwidth contains eight harmonics, for any number of periods."""
    bandwidths = [
        next(iter(bandwidths_of([(moving(np.tile(multisine(1.0, 1), (n, 1))), 1000.0)], 2.0)))
        for n in (4, 40)
    ]
    assert bandwidths == [8.0, 8.0]
