"""Margins measured with sines in the voltage of a motor."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from benchmarks.studies.servo_moves.tuned import Tuned, drive_under
from strainwave.domain import ComplexArray, FloatArray
from strainwave.tune.closed_loop import SampledResponses
from strainwave.tune.feed_forward import feed_forward, point_to_point
from strainwave.tune.margins import margins_of, open_loops
from strainwave.tune.plants import Condition, plants_of

_HZ, _N_RUNS = np.geomspace(4.0, 320.0, 48), 4  # each run has every fourth line
_VOLTS, _SPEED, _SECONDS = 0.15, 25.0, 3.0  # [V] each, [rad/s] of the motor, [s]


@dataclass(frozen=True, slots=True, eq=False)
class Loop:
    """One open loop."""

    joint: int  # from 1
    name: str
    omega: FloatArray  # (n_omega,) [rad/s]
    response: ComplexArray  # (n_omega,)

    def cells(self) -> tuple[str, ...]:
        """Gain, phase and modulus margin as text."""
        margins = margins_of(self.response[None], self.omega)
        least = margins.gain_db, margins.phase_deg, margins.modulus
        return tuple(f"{float(each[0]):.3g}" for each in least)


def sweep(tuned: Tuned) -> Iterator[Loop]:
    """The measured loop of each joint, after those of the estimates with both gear slopes."""
    design = tuned.design
    period, posture = design.clock.period, design.conditions[0].posture
    # whole periods within the second half of the record
    used = round(_SECONDS / period) // 2
    hz = np.unique(np.round(_HZ * used * period)) / (used * period)
    omega = math.tau * hz
    controllers = np.stack([each.response(np.exp(1j * omega * period)) for each in design.gains])
    for i in range(tuned.arm.n_joints):
        middle = posture.copy()  # of the used part of the record
        middle[i] += tuned.arm.gear_ratios[i] * _SPEED * (0.75 * _SECONDS - 0.1)
        plants = plants_of(design.arm, [design.arm.values], [Condition(middle)])
        responses = SampledResponses.of(plants, omega, design.clock)
        symmetric = responses.symmetric(np.arange(len(plants)))
        loops = open_loops(symmetric, responses.drive * controllers)[i]
        for name, loop in (("lowest", loops[0]), ("highest", loops[-1])):
            yield Loop(i + 1, f"predicted, {name} slope", omega, loop)
        yield Loop(i + 1, "measured", omega, _measured(tuned, i, hz, used))


def _measured(tuned: Tuned, joint: int, hz: FloatArray, used: int) -> ComplexArray:
    """Open loop of a joint, from 0, at frequencies [Hz], from the last `used` samples."""
    design = tuned.design
    period, n = design.clock.period, 2 * used
    time, rng = period * np.arange(n), np.random.default_rng(joint)
    posture = design.conditions[0].posture
    plan = feed_forward(design.arm, point_to_point(posture, posture, 0.1, period))
    laws = [each.law() for each in design.gains]
    measured = np.empty(len(hz), dtype=complex)
    for run in range(_N_RUNS):
        lines = slice(run, None, _N_RUNS)
        phases = rng.uniform(0.0, math.tau, len(hz[lines]))
        injected = np.zeros((n, tuned.arm.n_joints))
        waves = np.sin(np.outer(time, math.tau * hz[lines]) + phases)
        injected[:, joint] = _VOLTS * waves.sum(axis=1)
        reference = np.zeros_like(injected)
        reference[:, joint] = _SPEED * np.minimum(time / 0.2, 1.0)  # so that the motor slides
        drive = drive_under(design, laws, reference, plan, injected + plan.voltage[0])
        _, voltage = tuned.run(replace(drive, initial_voltage=tuple(plan.voltage[0])), n)
        at = np.round(hz[lines] * used * period).astype(int)
        total = np.fft.rfft(voltage[-used:, joint])[at]
        # a late voltage is that of the last reading when the next one is sampled
        late = injected[-used - 1 : -1] if design.clock.delay else injected[-used:]
        measured[lines] = np.fft.rfft(late[:, joint])[at] / total - 1.0
    return measured
