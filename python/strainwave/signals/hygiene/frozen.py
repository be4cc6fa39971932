"""Frozen stretches, which repeat one value while the arm moves, and steps of encoders.

A motor at standstill, encoder quantization, and a voltage that is held or at its limit are not
defects. An encoder is frozen if it stops within one sample during motion, or if the missed motion
appears in one sample. Other steps of an encoder are lost counts, a reset by the index pulse or a
counter overflow. A noisy sensor is frozen if it repeats one value much longer than is likely by
chance while the motor of the joint moves.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from strainwave.domain import FloatArray, IntArray, Log, channel_parts
from strainwave.dynamics.arm import Arm
from strainwave.signals.hygiene.defects import (
    Defect,
    count_of,
    encoder_kinds,
    noisy_kinds,
    of_kinds,
    resolution_of,
    usual_change,
)
from strainwave.signals.hygiene.jumps import Jump, classify_jumps
from strainwave.signals.standstill import runs_of

_MIN_ZERO_INCREMENTS = 3  # minimum number of zero increments before the step by the missed motion
# maximum difference of step and motion predicted from both sides, per step
_MAX_PREDICTION_ERROR = 0.5
_STANDSTILL_RATIO = 0.25  # maximum rest after the step, relative to the rest before it
_MAX_SPEED_RATIO = 4.0  # maximum speed during a frozen stretch, relative to the speed around it
_SPEED_INCREMENTS = 16  # number of increments on each side for this speed
_MIN_REST_RATIO = 2.5  # minimum length relative to the longest rest nearby
_REST_INCREMENTS = 60  # number of increments on each side that are nearby
_VELOCITY_INCREMENTS = 4  # number of increments on each side for a mean velocity
# increment, relative to its usual change, from which no motor stops in one sample
_MIN_ABRUPT_RATIO = 4.0
_MIN_REPEATED_READINGS = 8  # minimum number of repeated readings of a noisy sensor
_FALSE_ALARM_PROBABILITY = 1e-4  # probability of a false detection per record
_BLOCK_SAMPLES = 128  # block length [samples] for the share of repetitions
_TYPICAL_QUANTILE = 0.95  # quantile of run lengths and of block shares that is typical of a channel
_MAX_REPEATED_SHARE = 0.9  # share of repetitions above which a channel is too coarse for this test
_MIN_OUTLIER_RATIO = 6.0  # length, relative to the typical run, above which a run is not random
# distance from an extreme, relative to the range, that counts as saturation
_RANGE_TOLERANCE = 1e-3
_MIN_EDGE_STEPS = 4.0  # minimum difference from adjacent readings, in units of the resolution
# minimum motion of the motor in counts, and minimum number of nonzero increments
_MIN_MOTION_COUNTS = 6.0


def detect_frozen(log: Log, arm: Arm) -> list[Defect]:
    """Detect frozen stretches of encoders, noisy sensors and the voltages of servos."""
    detections = []
    for name, x in of_kinds(log, encoder_kinds()).items():
        detections += [
            _frozen_defect(log, name, *span)
            for span in _find_frozen_encoder(x, count_of(name, arm))
        ]
    for name, x in of_kinds(log, (*noisy_kinds(), "u")).items():
        kind, joint = channel_parts(name)
        drives = kind == "u"
        if joint > arm.n_joints or (drives and log.experiment.control[joint - 1] != "servo"):
            continue
        # A link sensor also measures the motion of all preceding joints.
        motors = [f"theta_m{i}" for i in range(joint if drives else 1, joint + 1)]
        spans = [
            span
            for span in _find_repeated_runs(x, drives=drives)
            if any(_is_moving(log.channels[motor], *span, count_of(motor, arm)) for motor in motors)
        ]
        detections += [_frozen_defect(log, name, *span) for span in spans]
    return detections


def _is_moving(angle: FloatArray, start: int, stop: int, count: float) -> bool:
    """Whether a motor moves during a stretch by more than its encoder noise at standstill."""
    stretch = angle[start - 1 : stop]
    is_beyond_noise = np.ptp(stretch) > _MIN_MOTION_COUNTS * (count or resolution_of(angle))
    # A single step is not motion.
    return bool(is_beyond_noise and np.count_nonzero(np.diff(stretch)) > _MIN_MOTION_COUNTS)


def _find_frozen_before(x: FloatArray, jump: Jump, rest_runs: IntArray) -> tuple[int, int] | None:
    """Stretch in which an encoder missed the motion of a jump, or None.

    `rest_runs` contains the runs of zero increments, (n_runs, 2). The stretch is frozen if the
    velocities on both sides predict the jump, or if the motor moves after a rest that is unusually
    long.
    """
    end = jump.sample - 1  # the increment that is the jump
    k = int(np.searchsorted(rest_runs[:, 1], end))
    if (
        k == len(rest_runs)
        or rest_runs[k, 1] != end
        or end - rest_runs[k, 0] < _MIN_ZERO_INCREMENTS
    ):
        return None
    start = int(rest_runs[k, 0])
    length, step = end - start, x[end + 1] - x[end]
    mean_increment = 0.5 * (_mean_increment(x, start, before=True) + _mean_increment(x, end + 1))
    is_predicted = abs(mean_increment * (length + 1) - step) < _MAX_PREDICTION_ERROR * abs(step)
    has_rest_after = k + 1 < len(rest_runs) and rest_runs[k + 1, 0] == end + 1
    rest_after = rest_runs[k + 1, 1] - end - 1 if has_rest_after else 0
    is_moving_after = rest_after < _STANDSTILL_RATIO * length + 2
    before = x[max(0, start - _SPEED_INCREMENTS) : start + 1]
    after = x[end + 1 : end + 2 + _SPEED_INCREMENTS]
    speed = float(max(np.ptp(before), np.ptp(after))) / _SPEED_INCREMENTS
    is_plausible = abs(step) < _MAX_SPEED_RATIO * speed * (length + 1)
    min_length = max(_MIN_ZERO_INCREMENTS, _MIN_REST_RATIO * _usual_rest(x, start, end))
    is_frozen = is_predicted or (is_moving_after and is_plausible and length > min_length)
    return (start + 1, end + 1) if is_frozen else None


def _usual_rest(x: FloatArray, start: int, end: int) -> int:
    """Length of the longest run of zero increments on either side of a stretch."""
    sides = [
        x[max(0, start - _REST_INCREMENTS) : start + 1],
        x[end + 1 + _VELOCITY_INCREMENTS : end + 1 + _REST_INCREMENTS],
    ]
    runs = [runs_of(np.diff(side) == 0.0) for side in sides if len(side) > 1]
    return max((int(np.max(r[:, 1] - r[:, 0], initial=0)) for r in runs), default=0)


def _mean_increment(x: FloatArray, k: int, *, before: bool = False) -> float:
    other = k - _VELOCITY_INCREMENTS if before else k + _VELOCITY_INCREMENTS
    other = min(max(0, other), len(x) - 1)
    return float((x[k] - x[other]) / (k - other)) if k != other else 0.0


def _find_frozen_encoder(x: FloatArray, count: float) -> Iterator[tuple[int, int]]:
    """Frozen stretches (first sample, index after the last one) of an encoder."""
    increment = np.diff(x)
    rest_runs = runs_of(increment == 0.0)
    if not len(rest_runs):
        return
    _, isolated_steps = classify_jumps(x, count)
    spans = [_find_frozen_before(x, jump, rest_runs) for jump in isolated_steps]
    frozen = {span for span in spans if span is not None}
    abrupt = _MIN_ABRUPT_RATIO * max(
        usual_change(np.abs(np.diff(increment))), count or resolution_of(x)
    )
    long_runs = rest_runs[rest_runs[:, 1] - rest_runs[:, 0] > _MIN_ZERO_INCREMENTS]
    inside = long_runs[(long_runs[:, 0] > 0) & (long_runs[:, 1] < len(increment))]
    ends = np.minimum(np.abs(increment[inside[:, 0] - 1]), np.abs(increment[inside[:, 1]]))
    for start, end in inside[ends > abrupt].tolist():
        speeds = _mean_increment(x, start, before=True), _mean_increment(x, end + 1)
        if min(map(abs, speeds)) > abrupt:
            frozen.add((start + 1, end + 1))
    yield from sorted(frozen)


def _find_repeated_runs(x: FloatArray, *, drives: bool) -> Iterator[tuple[int, int]]:
    """Runs of one reading that are too long to be random and end with a step.

    Runs at an end of the range, and runs of a voltage at zero, are not frozen.
    """
    is_repeated = np.diff(x) == 0.0
    repeated_runs = runs_of(is_repeated)
    if not len(repeated_runs):
        return
    length = repeated_runs[:, 1] - repeated_runs[:, 0]
    typical = float(np.quantile(length, _TYPICAL_QUANTILE))
    random_repeats = is_repeated.copy()
    is_outlier = length > max(_MIN_REPEATED_READINGS, _MIN_OUTLIER_RATIO * typical)
    for start, stop in repeated_runs[is_outlier].tolist():
        random_repeats[start:stop] = False
    n_blocks = len(is_repeated) // _BLOCK_SAMPLES
    whole_blocks = random_repeats[: n_blocks * _BLOCK_SAMPLES]
    blocks = whole_blocks.reshape(n_blocks, _BLOCK_SAMPLES).mean(axis=1)
    share = max(float(np.quantile(blocks, _TYPICAL_QUANTILE)) if n_blocks else 1.0, 1e-3)
    if share > _MAX_REPEATED_SHARE:
        return
    min_length = max(
        _MIN_REPEATED_READINGS,
        int(np.log(_FALSE_ALARM_PROBABILITY / len(x)) / np.log(share)),
        3 * int(typical),
    )
    low, high = x.min(), x.max()
    limit, step = _RANGE_TOLERANCE * (high - low), _MIN_EDGE_STEPS * resolution_of(x)
    for start, stop in repeated_runs[length >= min_length].tolist():
        value = x[start]
        is_saturated = min(value - low, high - value) < limit
        adjacent = np.r_[
            x[max(0, start - _VELOCITY_INCREMENTS) : start],
            x[stop + 1 : stop + 1 + _VELOCITY_INCREMENTS],
        ]
        has_step = np.max(np.abs(adjacent - value), initial=0.0) > step
        if has_step and not is_saturated and not (drives and value == 0.0):
            yield start + 1, stop + 1


def _frozen_defect(log: Log, name: str, start: int, stop: int) -> Defect:
    seconds = (stop - start) * log.sample_time
    return Defect("frozen", name, start, stop, seconds)


_MAX_OVERFLOW_SPREAD = 0.02  # maximum spread of overflow steps, relative to the largest one


def detect_encoder_steps(log: Log, arm: Arm) -> list[Defect]:
    """Detect permanent steps of an angle that are inconsistent with the motion around them.

    A reading that is repeated once is not a step: the log is written faster than the encoder is
    read, and the angle is late by up to one sample.
    """
    detections = []
    for name, x in of_kinds(log, encoder_kinds()).items():
        _, isolated_steps = classify_jumps(x, count_of(name, arm))
        rest_runs = runs_of(np.diff(x) == 0.0)
        steps = [
            jump
            for jump in isolated_steps
            if x[jump.sample] != x[jump.sample - 1] and not _find_frozen_before(x, jump, rest_runs)
        ]
        size = np.abs([step.size for step in steps])
        wraps = len(size) > 1 and bool(np.ptp(size) < _MAX_OVERFLOW_SPREAD * size.max())
        detections += [
            Defect("encoder-steps", name, step.sample, step.sample + 1, step.size, wraps=wraps)
            for step in steps
        ]
    return detections
