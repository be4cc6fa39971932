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
from strainwave.domain.arm.gear_laws import RIGID
from strainwave.dynamics.arm import Arm
from strainwave.errors import NotIdentifiable, NumericalFailure
from strainwave.identification.position_servo.candidates import (
    calm_segments,
    choose_delay,
    choose_gear_effects,
    choose_hold,
    choose_limits,
    choose_stiffness,
    fit_from,
    refined,
    with_reached_limits,
    without_needless_limits,
)
from strainwave.identification.position_servo.fit import ServoFit
from strainwave.identification.position_servo.loop import ServoLoop
from strainwave.identification.position_servo.records import (
    ReferenceHold,
    Segment,
    ServoRecord,
    segments_of,
    servo_record,
)
from strainwave.identification.position_servo.start import linear_starts

_MAX_STARTS = 2  # delays from which the fit is tried
_COARSE = 3  # one in so many segments takes part in the search of starts
_MIN_COUNTS = 8  # of the encoder, that a motion must cover
_DEFAULT_COUNTS = 4096.0  # per turn, of an encoder whose resolution is not given


def fit_position_servos(logs: Sequence[Log], arm: Arm) -> ServoFit:
    """Fit the arm and its servos to records of motion.

    Raises NotIdentifiable if no record has a motion, or if no simulation follows the records.
    """
    servo = arm.position_servo
    assert servo is not None
    elastic = [i for i, joint in enumerate(arm.joints, start=1) if joint.elastic]
    for i in elastic:  # their stiffness is added to a fit without
        arm = Arm.of(arm.with_joint(i, spring=RIGID, effects=()))
    records = [servo_record(log, arm) for log in logs]
    segments = tuple(segment for record in records for segment in segments_of(record))
    resolution = resolutions(arm, records)
    _check_motion(records, segments, resolution)
    floor = float(np.max(resolution)) / np.sqrt(12.0)
    coarse = segments[::_COARSE] if len(segments) >= 4 * _COARSE else segments
    fits = []
    for hold in (ReferenceHold.HELD, ReferenceHold.LINEAR):
        loop = ServoLoop(arm, servo, hold)
        for start in linear_starts(loop, records)[:_MAX_STARTS]:
            calm = calm_segments(loop, start.values, coarse, floor)
            fit = fit_from(loop, start.values, calm, floor, passes=2)
            fits += [fit] if fit is not None else []
    starts = sorted(fits, key=lambda fit: fit.cost / sum(s.angle.size for s in fit.segments))
    best = choose_limits(starts[0], coarse) if starts else None
    if best is None:
        raise NotIdentifiable(
            "no simulation of the servos follows the records: check the units and signs of the "
            "commanded and measured angles, and gear_ratio"
        )
    if elastic:
        best = choose_stiffness(best, elastic) or best
    best, by_hold = choose_hold(best)
    best, by_delay = choose_delay(best)
    best, by_gears = choose_gear_effects(best)
    if best.loop.has_stiff_gears:  # without their effect, residuals did not show the commands
        best, by_hold = choose_hold(best)
    final = fit_from(best.loop, best.values, segments, floor, passes=3)
    if final is None:
        raise NumericalFailure("the simulation of the servos diverges in some segment")
    final = without_needless_limits(refined(with_reached_limits(final)))
    changes = (*by_hold, *by_delay, *by_gears)
    return replace(final, rival_changes=changes, has_rival_effect=best.has_rival_effect)


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
