"""Jumps and rests of a channel that motion cannot cause: spikes, steps and frozen stretches.

The increments of a motion change by its acceleration. An increment that differs from both
neighbours far more than is usual is due to counting, transmission or a disturbance.

Frozen stretches repeat one value while the arm moves. A motor at standstill, encoder quantization,
and a voltage that is held or at its limit are not defects. An encoder is frozen if it stops within
one sample during motion, or if the missed motion appears in one sample. Other steps of an encoder
are lost counts, a reset by the index pulse or a counter overflow. A noisy sensor is frozen if it
repeats one value much longer than is likely by chance while the motor of the joint moves.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

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
from strainwave.signals.standstill import runs_of

_MAX_SPIKE_SAMPLES = 3  # maximum duration of a spike [samples]
_MAX_RETURN_ERROR = 0.35  # maximum residual offset after a spike, relative to its size
_MIN_RECORD_RATIO = 3.0  # minimum ratio to the usual value in the record
_MIN_LOCAL_RATIO = 5.0  # minimum ratio to the usual value nearby
# minimum size in units of the resolution; larger than quantization effects
_MIN_RESOLUTION_STEPS = 4.0
_COMPARISON_SAMPLES = 48  # number of samples on each side for comparison
_EXCLUDED_SAMPLES = 4  # number of adjacent samples on each side excluded from the comparison
# maximum number of candidates; more are a property of the channel, not defects
_MAX_CANDIDATES = 4000


@dataclass(frozen=True, slots=True)
class Jump:
    """An isolated increment."""

    sample: int  # first sample after the increment
    size: float  # difference from the adjacent increments


def classify_jumps(signal: FloatArray, count: float) -> tuple[list[tuple[int, int]], list[Jump]]:
    """Classify the jumps of a signal, (n_samples,), as spikes or permanent steps.

    A signal returns from a spike within `_MAX_SPIKE_SAMPLES` samples.
    `count` is the quantization step, or zero if unknown. Returns spikes as (first sample, index
    after the last one), and permanent steps.
    """
    spikes: list[tuple[int, int]] = []
    steps: list[Jump] = []
    last_stop = 0  # end of the last spike
    for jump in detect_jumps(signal, count):
        start = jump.sample
        if start <= last_stop:
            continue
        speed = signal[start] - signal[start - 1] - jump.size
        ends = np.arange(start, min(start + _MAX_SPIKE_SAMPLES, len(signal) - 1) + 1)
        offset = signal[ends] - signal[start - 1] - speed * (ends - start + 1)
        returns = ends[np.abs(offset) < _MAX_RETURN_ERROR * abs(jump.size)].tolist()
        if returns:
            last_stop = returns[0]
            spikes.append((start, last_stop))
        else:
            steps.append(jump)
    return spikes, steps


def detect_jumps(signal: FloatArray, count: float) -> list[Jump]:
    """Detect all isolated increments of a signal, (n_samples,), in order of time.

    `count` is the quantization step, or zero if unknown.
    """
    if len(signal) < 4 * _COMPARISON_SAMPLES:
        return []
    increment = np.diff(signal)
    change = np.abs(np.diff(increment))
    contrast = np.zeros(len(increment))
    np.minimum(change[1:], change[:-1], out=contrast[1:-1])
    threshold = max(
        _MIN_RESOLUTION_STEPS * (count or resolution_of(signal)),
        _MIN_RECORD_RATIO * usual_change(contrast),
    )
    candidates = np.flatnonzero(contrast > threshold)
    if not 0 < len(candidates) <= _MAX_CANDIDATES:
        return []
    jumps = []
    for k in candidates.tolist():
        if contrast[k] > _MIN_LOCAL_RATIO * _usual_nearby(contrast, k):
            before = increment[max(0, k - _EXCLUDED_SAMPLES) : k]
            adjacent = np.r_[before, increment[k + 1 : k + 1 + _EXCLUDED_SAMPLES]]
            jumps.append(Jump(k + 1, float(increment[k] - np.median(adjacent))))
    return jumps


def _usual_nearby(contrast: FloatArray, k: int) -> float:
    """Usual value near a sample: the larger one of both sides, because a motion can begin there."""
    sides = [
        contrast[max(0, k - _COMPARISON_SAMPLES) : max(0, k - _EXCLUDED_SAMPLES)],
        contrast[k + _EXCLUDED_SAMPLES + 1 : k + 1 + _COMPARISON_SAMPLES],
    ]
    return max(
        (float(np.partition(s, -4)[-4]) for s in sides if len(s) > _EXCLUDED_SAMPLES),
        default=np.inf,
    )


# Minimum distance of a spike from the usual voltages, relative to their range.
_MIN_RANGE_MARGIN = {"open": 0.3, "servo": 1.0}
_EXCLUDED_SHARE = 1e-3  # share of samples on each side that the usual range excludes


def detect_spikes(log: Log, arm: Arm) -> list[Defect]:
    """Detect spikes of sensors that motion cannot cause, and of voltages outside their usual range.

    A voltage can step, so a spike must be well outside the range of the other samples.
    """
    spans = [
        (name, *span)
        for name, x in of_kinds(log, (*encoder_kinds(), *noisy_kinds())).items()
        for span in classify_jumps(x, count_of(name, arm))[0]
    ]
    for name, x in of_kinds(log, ("u",)).items():
        margin = _MIN_RANGE_MARGIN[log.experiment.control[channel_parts(name)[1] - 1]]
        spans += [(name, *span) for span in _find_outside_range(x, margin)]
    detections = []
    for name, start, stop in spans:
        x = log.channels[name]
        baseline = 0.5 * (x[max(0, start - 1)] + x[min(len(x) - 1, stop)])
        size = float(np.max(np.abs(x[start:stop] - baseline)))
        detections.append(Defect("spikes", name, start, stop, size))
    return detections


def _find_outside_range(x: FloatArray, min_margin: float) -> Iterator[tuple[int, int]]:
    """Short runs outside the usual range by at least `min_margin` times this range."""
    k = max(1, int(_EXCLUDED_SHARE * len(x)))
    if len(x) <= 4 * k:
        return
    ordered = np.partition(x, (k, len(x) - 1 - k))
    low, high = float(ordered[k]), float(ordered[-1 - k])
    margin = min_margin * (high - low)
    for start, stop in runs_of((x > high + margin) | (x < low - margin)).tolist():
        if start == 0 or stop == len(x) or stop - start > _MAX_SPIKE_SAMPLES:
            continue
        before = x[start - 1]
        if abs(x[stop] - before) < _MAX_RETURN_ERROR * abs(x[start] - before):
            yield start, stop


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
    spans = [
        (name, *span)
        for name, x in of_kinds(log, encoder_kinds()).items()
        for span in _find_frozen_encoder(x, count_of(name, arm))
    ]
    for name, x in of_kinds(log, (*noisy_kinds(), "u")).items():
        kind, joint = channel_parts(name)
        drives = kind == "u"
        if joint > arm.n_joints or (drives and log.experiment.control[joint - 1] != "servo"):
            continue
        # A link sensor also measures the motion of all preceding joints.
        motors = [f"theta_m{i}" for i in range(joint if drives else 1, joint + 1)]
        spans += [
            (name, *span)
            for span in _find_repeated_runs(x, drives=drives)
            if any(_is_moving(log.channels[motor], *span, count_of(motor, arm)) for motor in motors)
        ]
    T = log.sample_time
    return [Defect("frozen", name, start, stop, (stop - start) * T) for name, start, stop in spans]


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
