"""Position servos without torque: arm, friction and servo from commanded and measured angles.

The closed loops of all joints are simulated from the commands and fitted to the measured angles. A
linear regression gives the start. The log does not tell what a command does between its samples;
the residuals decide.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from strainwave.domain import FloatArray, Log
from strainwave.domain.arm.parameter_table import COULOMB, OFFSET
from strainwave.domain.keys import Key, Values
from strainwave.dynamics.arm import Arm
from strainwave.errors import NotIdentifiable, NumericalFailure
from strainwave.identification.position_servo.fit import (
    Guess,
    Prior,
    ServoFit,
    Unknown,
    fit_segments,
)
from strainwave.identification.position_servo.loop import (
    DELAY,
    KD,
    KP,
    LIMIT,
    SCALE,
    VELOCITY_LAG,
    VISCOUS,
    ServoLoop,
)
from strainwave.identification.position_servo.records import (
    MAX_DELAY,
    ReferenceHold,
    Segment,
    ServoRecord,
    segments_of,
    servo_record,
)
from strainwave.identification.position_servo.start import linear_starts
from strainwave.identification.position_servo.states import deviations, initial_state

_MAX_STARTS = 3  # delays from which the fit is tried
_COARSE = 3  # one in so many segments takes part in the search of starts
_LIMITS = np.geomspace(0.1, 1.6, 16)  # of a torque limit, over the largest torque of the start
_LIMIT_UNREACHED = 3.0  # factor on the largest torque, beyond which a limit has no effect
_MIN_COUNTS = 8  # of the encoder, that a motion must cover
_DEFAULT_COUNTS = 4096.0  # per turn, of an encoder whose resolution is not given
_PLAUSIBLE_COST = 20.0  # of another course of commands: likelihood ratio of e^-5, errors correlate
_KD_SHARE_STD = 0.29  # of a uniform distribution on [0, 1]
_LAG, _LAG_STD = 0.5, 0.5  # of a servo's velocity: from that at the reading to two periods


def fit_position_servos(logs: Sequence[Log], arm: Arm) -> ServoFit:
    """Fit the arm and its servos to records of motion.

    Raises NotIdentifiable if no record has a motion, or if no simulation follows the records.
    """
    servo = arm.position_servo
    assert servo is not None
    records = [servo_record(log, arm) for log in logs]
    segments = tuple(segment for record in records for segment in segments_of(record))
    resolution = resolutions(arm, records)
    _check_motion(records, segments, resolution)
    floor = float(np.max(resolution)) / np.sqrt(12.0)
    loop = ServoLoop(arm, servo, ReferenceHold.HELD)
    coarse = segments[::_COARSE] if len(segments) >= 4 * _COARSE else segments
    fits = []
    for start in linear_starts(loop, records)[:_MAX_STARTS]:
        fit = _fit(loop, _guess(loop, start.values, coarse, floor), floor, passes=2)
        fits += [fit] if fit is not None else []
    if not fits:
        raise NotIdentifiable(
            "no simulation of the servos follows the records: check the units and signs of the "
            "commanded and measured angles, and gear_ratio"
        )
    best = min(fits, key=lambda fit: fit.cost)
    held = _best_limits(best, floor)
    holds = [held]
    for hold in (ReferenceHold.LINEAR, ReferenceHold.SMOOTH):
        fit = _fit(replace(loop, hold=hold), _delayed(held), floor, passes=2)
        holds += [fit] if fit is not None else []
    least = min(fit.cost for fit in holds)
    plausible = [fit for fit in holds if fit.cost < least + _PLAUSIBLE_COST]
    best = plausible[0]  # logs usually hold the commands as they were sent
    guess = _guess(best.loop, best.values, segments, floor)
    final = _fit(best.loop, guess, floor, passes=3)
    if final is None:
        raise NumericalFailure("the simulation of the servos diverges in some segment")
    changes = [rival.x - best.x for rival in plausible[1:] if len(rival.x) == len(best.x)]
    return replace(final, rival_changes=np.array(changes).reshape(-1, len(final.x)))


def _fit(loop: ServoLoop, guess: Guess, floor: float, *, passes: int) -> ServoFit | None:
    unknowns, priors = _unknowns(loop, guess.values)
    return fit_segments(loop, guess, unknowns, priors, floor, passes=passes)


def resolutions(arm: Arm, records: Sequence[ServoRecord]) -> FloatArray:
    """One count of each encoder at the joint [rad], (n_joints,)."""
    counts = [joint.encoder_counts or _DEFAULT_COUNTS for joint in arm.joints]
    return np.asarray(2.0 * np.pi / np.array(counts) * np.abs(arm.gear_ratios))


def _check_motion(
    records: Sequence[ServoRecord], segments: Sequence[Segment], resolution: FloatArray
) -> None:
    if not segments:
        raise NotIdentifiable("the records are too short: record motions of 10 s or more")
    for i, count in enumerate(resolution.tolist(), start=1):
        span = max(float(np.ptp(record.angle[:, i - 1])) for record in records)
        if span < _MIN_COUNTS * count:
            raise NotIdentifiable(
                f"joint {i} moves by {span:.2g} rad, {span / count:.0f} counts of its encoder: "
                "command motions of some tenths of a radian, fast and slow"
            )


def _guess(loop: ServoLoop, values: Values, segments: Sequence[Segment], floor: float) -> Guess:
    """Start at values, with states from the measured angles and the residuals from there."""
    states = tuple(initial_state(loop, segment) for segment in segments)
    sizes = np.maximum(deviations(loop, values, segments, states), floor)
    return Guess(values, tuple(segments), states, sizes)


def _best_limits(fit: ServoFit, floor: float) -> ServoFit:
    """The fit from the torque limits of the smallest residuals, joint by joint.

    Residuals beyond a limit do not show where it is, so it is searched on a grid.
    """
    loop, values = fit.loop, fit.values
    for i in loop.numbers:
        costs = {}
        for factor in _LIMITS.tolist():
            limit = factor * values[LIMIT, i]
            sizes = deviations(loop, values | {(LIMIT, i): limit}, fit.segments, fit.states)
            costs[limit] = float(np.sum(np.log(np.maximum(sizes, floor))))
        values = values | {(LIMIT, i): min(costs, key=costs.__getitem__)}
    better = _fit(loop, _guess(loop, values, fit.segments, floor), floor, passes=2)
    return better if better is not None and better.cost < fit.cost else fit


def _delayed(fit: ServoFit) -> Guess:
    """Start of a fit without a hold of half a sample on average."""
    guess = fit.as_guess()
    half = 0.5 * float(np.mean([segment.record.sample_time for segment in guess.segments]))
    later = {
        key: min(value + half, MAX_DELAY) for key, value in guess.values.items() if key[0] == DELAY
    }
    return replace(guess, values=guess.values | later)


def _unknowns(loop: ServoLoop, values: Values) -> tuple[list[Unknown], list[Prior]]:
    """Unknowns of a fit with scales from its start, and what is known of them.

    A servo has any share of the damping, and its velocity may be late by two periods.
    """
    servo, unknowns, priors = loop.servo, list[Unknown](), list[Prior]()
    for column in loop.arm.base.columns:
        size = max(
            abs(values[other.key]) for other in loop.arm.base.columns if other.unit == column.unit
        )
        unknowns.append(Unknown((column.key,), size + np.finfo(float).tiny))
    for i in loop.numbers:
        torque = values[LIMIT, i]
        kd, viscous = values[KD, i], values[VISCOUS, i]
        damping = kd + viscous
        size = 0.5 * damping + 3e-3 * torque
        keys: list[tuple[str, float, float, float]] = [
            (VISCOUS, size, 0.0, np.inf),
            (COULOMB, values[COULOMB, i] + 0.01 * torque, 0.0, np.inf),
            (OFFSET, 0.02 * torque, -np.inf, np.inf),
            (VELOCITY_LAG, 0.5, -1.0, 3.0),
            (LIMIT, 0.2 * torque, 0.02 * torque, np.inf),
        ]
        if servo.damping_gain(i) is None or servo.gain(1) is None:
            keys.append((KD, size, 0.0, np.inf))
            share: tuple[tuple[Key, float], ...] = (((KD, i), 1.0), ((VISCOUS, i), -1.0))
            priors.append(Prior(share, 0.0, 2.0 * _KD_SHARE_STD * damping + 1e-3 * torque))
        if i > 1 and servo.gain(i) is None:
            keys.append((KP, 0.3 * values[KP, i], 0.01 * values[KP, i], np.inf))
        if isinstance(servo.delay, tuple) and servo.delay_of(i) is None:
            keys.append((DELAY, 0.003, 0.0, 1.2 * MAX_DELAY))
        unknowns += [Unknown(((name, i),), *of) for name, *of in keys]
        priors.append(Prior((((VELOCITY_LAG, i), 1.0),), _LAG, _LAG_STD))
    if servo.delay == "unknown":
        together = tuple((DELAY, i) for i in loop.numbers)
        unknowns.append(Unknown(together, 0.003, 0.0, 1.2 * MAX_DELAY))
    if SCALE in values:
        unknowns.append(Unknown((SCALE,), 0.3 * values[SCALE], 0.01 * values[SCALE]))
    return unknowns, priors
