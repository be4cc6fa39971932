"""Held commands from torques that a drive samples at times of its own."""

from __future__ import annotations

import numpy as np
import pytest

from strainwave.domain import FloatArray
from strainwave.signals.drive_law import held_commands

T, PERIOD, LOOP = 5e-4, 1e-3, 1000.0
FINE = 50  # parts of a sample


def sampled(commands: FloatArray, offset: float, seed: int = 0, std: float = 0.0) -> FloatArray:
    """Torque behind the current loop, sampled `offset` after the time stamps."""
    step, n = T / FINE, round(PERIOD / T) * FINE
    held = np.repeat(commands, n)
    decay, torque = np.exp(-2.0 * np.pi * LOOP * step), np.empty(len(held) + 1)
    torque[0] = commands[0]
    for k, command in enumerate(held):
        torque[k + 1] = command + decay * (torque[k] - command)
    samples = torque[round(offset / step) :][: len(held) - n : FINE]
    return samples + std * np.random.default_rng(seed).normal(size=len(samples))


def random_commands(seed: int = 1, n: int = 400) -> FloatArray:
    rng = np.random.default_rng(seed)
    return np.asarray(rng.choice([-1.0, 1.0], size=n) + 0.2 * rng.normal(size=n))


@pytest.mark.parametrize("offset", [0.0, 6e-5, 2e-4])
def test_commands_are_recovered_at_their_time_stamps(offset: float) -> None:
    commands = random_commands()
    quiet = 0.3 + 0.0 * commands  # a joint at standstill has those of the others' clock
    torques = [sampled(commands, offset, std=2e-3), sampled(quiet, offset, 1, std=2e-3)]
    held = held_commands(torques, T, PERIOD, [LOOP, LOOP])
    assert held is not None
    for one, expected in zip(held, (commands, quiet), strict=True):
        error = one - np.repeat(expected, 2)[: len(one)]
        assert np.std(error[4:-4]) < 6e-3


def test_torques_without_held_commands_are_left_alone() -> None:
    t = T * np.arange(800)
    smooth = np.sin(2.0 * np.pi * 3.0 * t)
    noise = 1e-3 * np.random.default_rng(0).normal(size=len(t))
    assert held_commands([noise], T, PERIOD, [LOOP]) is None
    assert held_commands([smooth + noise], T, PERIOD, [LOOP]) is None
    # commands that change with every sample
    jumps = random_commands(n=800)
    assert held_commands([jumps], T, PERIOD, [LOOP]) is None
