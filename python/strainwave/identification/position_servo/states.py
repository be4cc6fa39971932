"""Initial states of segments, and residuals without what these states explain."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np

from strainwave.domain import FloatArray
from strainwave.domain.keys import Values
from strainwave.errors import NumericalFailure
from strainwave.identification.position_servo.loop import LoopInputs, ServoLoop
from strainwave.identification.position_servo.records import Segment
from strainwave.numerics.parallel import run_parallel

MIN_STATE_EFFECT = 1e-4
"""Relative effect of a state below which it is not fitted: friction holds the joint."""

_PARABOLA_TIME = 0.01  # [s] of samples on each side of a start
_STATE_PASSES = 3


def initial_state(loop: ServoLoop, segment: Segment) -> FloatArray:
    """Angles and velocities at the last reading before a segment, of parabolas through samples."""
    record, first = segment.record, segment.first
    half = max(3, int(_PARABOLA_TIME / record.sample_time))
    around = slice(max(first - half, 0), first + half + 1)
    time = record.time[around] - loop.first_tick(segment) * loop.servo.period
    parabola = np.polyfit(time, record.angle[around], 2)
    return np.concatenate([parabola[2], parabola[1]])


def fitted_state(loop: ServoLoop, values: Values, segment: Segment) -> FloatArray:
    """Initial state with the least residual."""
    inputs, state = loop.prepare(values, segment.record), initial_state(loop, segment)
    for _ in range(_STATE_PASSES):
        state = state - _explained(loop, inputs, segment, state)[1]
    return state


def deviations(
    loop: ServoLoop, values: Values, segments: Sequence[Segment], states: Sequence[FloatArray]
) -> FloatArray:
    """Residuals (n_segments, n_joints) [rad] without what the initial states explain."""
    inputs = {id(s.record): loop.prepare(values, s.record) for s in segments}

    def deviation(segment: Segment, state: FloatArray) -> FloatArray:
        rest, _ = _explained(loop, inputs[id(segment.record)], segment, state)
        return np.asarray(np.sqrt(np.mean(rest**2, axis=0)))

    pairs = zip(segments, states, strict=True)
    return np.array(run_parallel([partial(deviation, *pair) for pair in pairs]))


def _explained(
    loop: ServoLoop, inputs: LoopInputs, segment: Segment, state: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Residuals without the part of the initial state, and the error of the state."""
    run = loop.simulate(inputs, segment, state, directions=())
    residual = run.angle - segment.angle
    of_state = run.derivatives.reshape(residual.size, -1)
    if not (np.isfinite(residual).all() and np.isfinite(of_state).all()):
        raise NumericalFailure("the simulation of the servos diverges")
    error = np.linalg.lstsq(of_state, residual.ravel(), rcond=MIN_STATE_EFFECT)[0]
    return residual - (of_state @ error).reshape(residual.shape), np.asarray(
        error, dtype=np.float64
    )
