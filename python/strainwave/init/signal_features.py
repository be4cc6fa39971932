"""Features of a column's data: clocks, derivatives, levels, pseudo-random sequences, units."""

from __future__ import annotations

from dataclasses import replace
from itertools import product
from math import pi

import numpy as np

from strainwave.domain import BoolArray, FloatArray, IntArray, Log, Prbs, channel_parts
from strainwave.init.names import UNITS

_MAX_LEVELS = 5  # maximum number of levels
_LEVEL_TOLERANCE = 1e-6  # share of the range; closer levels count as one
_MIN_WRAP_SHARE = 0.6  # minimum share of the range that the jump of a wrapped angle covers
_MIN_JUMP_SHARE = 0.3  # minimum share of the range that a jump covers within one sample
_MIN_REPEATED_SHARE = 0.98  # minimum share of samples that repeat after one period of a sequence
# correlation of a sequence with itself, shifted; a period that is not a whole number of samples
_MAX_SEQUENCE_ERROR = 0.1
_MULTIPLE_TOLERANCE = 0.02  # a fifth of the largest distance of multiples of a step from integers
_MIN_SATURATED_SHARE = 2e-3  # minimum share of samples at the drive's limit that is reported
_COUNTS_TOLERANCE = 2e-3  # relative tolerance to common counts, for rounding in the log and of pi
# lines per turn of common encoders, times a power of ten
_ENCODER_LINES = (100, 125, 200, 250, 256, 300, 360, 400, 500, 512, 600, 625, 720, 800, 900)
MAX_UNIT_RATIO_ERROR = 0.03  # relative tolerance between a measured and a known ratio
_MAX_SAMPLES = 200_000  # maximum number of samples that levels and quantum use


def relation(rate: FloatArray, value: FloatArray, time: FloatArray) -> tuple[float, float]:
    """Return how well `rate` is the derivative of `value`: correlation and ratio.

    Compares changes of `value` over short windows with integrals of `rate`; arrays are
    (n_samples,). The correlation is 1 for an exact derivative. The ratio is the change of `value`
    per integral of `rate`: 1 if the units match.
    """
    width = max(4, len(time) // 400)
    integral = np.concatenate([[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]) * np.diff(time))])
    changes = value[width::width] - value[:-width:width][: len(value[width::width])]
    integrals = integral[width::width] - integral[:-width:width][: len(integral[width::width])]
    return proportion(integrals, changes)


def proportion(x: FloatArray, y: FloatArray) -> tuple[float, float]:
    """Return the correlation of two columns and the slope y/x, without an intercept."""
    norms = float(np.linalg.norm(x) * np.linalg.norm(y))
    if not norms > 0.0:
        return 0.0, 0.0
    product = float(x @ y)
    return product / norms, product / float(x @ x)


def slope_error(x: FloatArray, y: FloatArray) -> float:
    """Relative standard deviation of the slope y/x, from its differences between stretches."""
    stretches = zip(np.array_split(x, 8), np.array_split(y, 8), strict=True)
    slopes = [proportion(a - a.mean(), b - b.mean())[1] for a, b in stretches if np.ptp(a) > 0.0]
    mean = float(np.mean(slopes)) if slopes else 0.0
    return float(np.std(slopes)) / abs(mean) / np.sqrt(len(slopes)) if mean else 0.0


def levels(values: FloatArray) -> FloatArray | None:
    """Return the few distinct values of a column, or None if it has more."""
    span = float(np.ptp(values))
    if span == 0.0:
        return values[:1]
    rounded = np.unique(
        np.round((values[:_MAX_SAMPLES] - values.min()) / (_LEVEL_TOLERANCE * span))
    )
    if len(rounded) > 4 * _MAX_LEVELS:
        return None
    is_new_level = np.concatenate([[True], np.diff(rounded) > 10.0])
    distinct = values.min() + rounded[is_new_level] * _LEVEL_TOLERANCE * span
    return distinct if len(distinct) <= _MAX_LEVELS else None


def switches(values: FloatArray) -> IntArray:
    """Samples before the jumps of a column, which exceed _MIN_JUMP_SHARE of its range."""
    changes = np.abs(np.diff(values))
    return np.flatnonzero((changes > 0.0) & (changes > _MIN_JUMP_SHARE * float(np.ptp(values))))


def sequence_of(values: FloatArray, period: float) -> Prbs | None:
    """Detect a maximum-length sequence in a column of two levels; None if there is none.

    The longest run of such a sequence is `order` clocks, and its period is 2**order - 1 clocks.
    `values` is (n_samples,); `period` is the sampling period [s].
    """
    two_levels = levels(values)
    if two_levels is None or len(two_levels) != 2:
        return None
    high = values > two_levels.mean()
    edges = np.flatnonzero(np.diff(high))
    if len(edges) < 8:
        return None
    runs = np.diff(edges)
    clock = float(np.percentile(runs, 5))
    all_runs = np.diff([-1, *edges, len(high) - 1])
    # the record may cut the first and last run short
    for longest in (runs.max(), all_runs.max()):
        order = round(float(longest) / clock)
        if 2 <= order <= 24 and _repeats(high, order, clock):
            length = (2**order - 1) * clock
            periods = max(1, round(len(high) / length))
            amplitude = float(f"{np.ptp(two_levels) / 2:.6g}")
            return Prbs(order, float(f"{clock * period:.6g}"), periods, amplitude)
    return None


def sequences_of(log: Log) -> dict[str, Prbs]:
    """The pseudo-random binary sequence of each motor input that has one, by channel."""
    drives = {c: v for c, v in log.channels.items() if channel_parts(c)[0] in ("u", "torque")}
    detections = {
        channel: sequence_of(values, log.sample_time)
        or sequence_under_servo(values, log.sample_time)
        for channel, values in drives.items()
    }
    return {channel: prbs for channel, prbs in detections.items() if prbs is not None}


def sequence_under_servo(values: FloatArray, period: float) -> Prbs | None:
    """Detect a maximum-length sequence that is added to the output of a servo.

    The sequence switches where `values` (n_samples,) jump, up and down in turn; `period` is the
    sampling period [s].
    """
    jumps = np.diff(values)
    size = np.abs(jumps)
    n_largest = max(8, len(size) // 100)  # a sequence jumps more often
    if len(size) <= n_largest:
        return None
    limit = 0.5 * float(np.partition(size, -n_largest)[-n_largest])
    edges = np.flatnonzero(size > limit)
    rises = jumps[edges] > 0.0
    if limit == 0.0 or np.any(rises[1:] == rises[:-1]):
        return None
    # a torque behind a current loop takes two samples; later the servo responds
    inner = edges[(edges > 0) & (edges + 2 < len(values))]
    spans = ((0, 1), (-1, 1), (0, 2))
    changes = [np.median(np.abs(values[inner + b] - values[inner + a])) for a, b in spans]
    amplitude = float(max(changes)) / 2.0
    level = np.concatenate([[not rises[0]], rises])
    two_levels = np.where(level, amplitude, -amplitude)
    sequence = sequence_of(np.repeat(two_levels, np.diff([-1, *edges, len(values) - 1])), period)
    # the response of the servo limits the accuracy
    return sequence and replace(sequence, amplitude=float(f"{amplitude:.2g}"))


def _repeats(high: BoolArray, order: int, clock: float) -> bool:
    """Whether a sequence repeats after its period, or one period is a maximum-length sequence.

    A maximum-length sequence of n bits correlates with itself, shifted by any number of bits, to
    -1/n. Friction that changes its sign now and then does not.
    """
    length = round((2**order - 1) * clock)
    if length > len(high):
        return False
    if len(high) > 1.5 * length:
        return float(np.mean(high[length:] == high[:-length])) > _MIN_REPEATED_SHARE
    spectrum = np.fft.rfft(np.where(high[:length], 1.0, -1.0))
    correlation = np.fft.irfft(np.abs(spectrum) ** 2, length) / length
    apart = correlation[int(np.ceil(clock)) : length // 2]
    return bool(np.max(np.abs(apart + 1.0 / (2**order - 1)), initial=0.0) < _MAX_SEQUENCE_ERROR)


def quantum(values: FloatArray) -> float | None:
    """Return the quantisation step of a column, such as an encoder's, or None."""
    steps = np.abs(np.diff(values[:_MAX_SAMPLES]))
    steps = steps[steps > 1e-9 * max(float(np.ptp(values)), 1e-300)]
    if len(steps) < 20:
        return None
    smallest = float(steps.min())
    small = steps[steps < 50.0 * smallest]
    if len(small) < 20:
        return None
    median_step = float(np.median(small / np.maximum(np.round(small / smallest), 1.0)))
    # more accurate if the log has few digits
    mean_single_step = float(np.mean(small[small < 1.5 * smallest]))
    for step in (median_step, mean_single_step):
        remainders = np.abs(small / step - np.round(small / step))
        if remainders.max() < _MULTIPLE_TOLERANCE * 5:
            return _refine_step(values[:_MAX_SAMPLES] - values[0], step)
    return None


def _refine_step(values: FloatArray, step: float) -> float:
    """Refine a quantisation step over increasing distances.

    Each distance is ten times the previous one, where the step is known to 1/20 count. Stops at the
    last step if the values are no longer integer multiples.
    """
    reach = 50.0
    while True:
        near = values[(np.abs(values) < reach * step) & (values != 0.0)]
        if len(near) >= 20:
            multiples = np.round(near / step)
            if np.abs(near / step - multiples).max() > 0.3:
                return step
            step = float(near @ multiples / (multiples @ multiples))
        if reach * step > np.abs(values).max():
            return step
        reach *= 10.0


def usual_counts(counts: float) -> int | None:
    """Return the common encoder count per turn nearest to a measured one, or None if none is near.

    Common counts are powers of two, and 1, 2 or 4 times a common number of lines.
    """
    lines = [n * 10**decade for n in _ENCODER_LINES for decade in range(5)]
    common = {2**bits for bits in range(5, 25)} | {m * n for n in lines for m in (1, 2, 4)}
    nearest = min(common, key=lambda each: abs(each - counts))
    return nearest if abs(counts / nearest - 1.0) < _COUNTS_TOLERANCE else None


def runs_alike(values: FloatArray) -> bool:
    """Whether all runs of a column have a similar length, as in a square wave."""
    runs = np.diff(switches(values))
    return len(runs) > 1 and bool(runs.max() < 1.5 * np.median(runs))


def flat_top(values: FloatArray) -> float | None:
    """Return the largest magnitude if the column saturates there, else None."""
    top = float(np.abs(values).max())
    at_top = np.abs(values) > (1.0 - 1e-6) * top
    stays_at_top = at_top[1:] & at_top[:-1]
    return top if top > 0.0 and stays_at_top.mean() > _MIN_SATURATED_SHARE else None


def wrap_modulus(values: FloatArray) -> float | None:
    """Return the turn by which an angle jumps, as a single-turn encoder does; None if it does not.

    A jump covers most of the range within one sample; the modulus is the jump without the motion
    of the neighbouring samples.
    """
    steps = np.diff(values)
    span = float(np.ptp(values))
    jumps = np.flatnonzero(np.abs(steps) > _MIN_WRAP_SHARE * span)
    if not 0 < len(jumps) < 0.2 * len(steps) or levels(values) is not None:
        return None
    ordinary = np.delete(steps, jumps)
    if np.abs(ordinary).max(initial=0.0) > 0.25 * span:
        return None
    neighbour = steps[np.clip(jumps - 1, 0, None)]
    neighbour = np.where(np.abs(neighbour) > _MIN_WRAP_SHARE * span, 0.0, neighbour)
    return float(np.median(np.abs(steps[jumps] - neighbour)))


def sign_bit(values: FloatArray, *, wraps: bool = False) -> int | None:
    """Return the bit that holds the sign of a register read as unsigned; None if there is none.

    Negative values are 2**bit plus the magnitude, or 2**(bit + 1) less the magnitude in two's
    complement, which is a wrap of values that may wrap; both leave a gap after the small values.
    """
    if np.any(values != np.round(values)) or values.min() < 0.0:
        return None
    for bit in (15, 10, 11, 31):
        high = values >= 2.0**bit
        small, large = values[~high], values[high] - 2.0**bit
        if 0 < len(large) < len(values) and values.max() < 2.0 ** (bit + 1):
            half = 2.0 ** (bit - 1)
            is_sign = large.max() < half or (not wraps and large.min() > half)
            if small.max() < half and is_sign:
                return bit
    return None


def is_register(values: FloatArray) -> bool:
    """Whether a column has whole numbers of more than a few levels, as of counts or registers."""
    return bool(np.all(values == np.round(values))) and levels(values) is None


def smooth_share(values: FloatArray, period: float, top_hz: float) -> float:
    """Share of a column's power below a frequency [Hz], without the mean."""
    spectrum = np.abs(np.fft.rfft(values - values.mean())) ** 2
    frequency = np.fft.rfftfreq(len(values), period)
    total = float(spectrum.sum())
    return float(spectrum[frequency <= top_hz].sum()) / total if total > 0.0 else 1.0


_ANGLE_UNITS = {"rad": 1.0, "degrees": pi / 180.0, "turns": 2.0 * pi}
_RATE_UNITS = {"rad/s": 1.0, "deg/s": pi / 180.0, "rpm": pi / 30.0}


def unit_pair(ratio: float) -> tuple[float, str] | None:
    """Infer the units of an angle and its velocity from the ratio of the angle to the integral.

    Returns the SI factor of the angle and both units; None if the units match or are unknown.
    """
    for (angle, scale), (rate, factor) in product(_ANGLE_UNITS.items(), _RATE_UNITS.items()):
        if abs(ratio * scale / factor - 1.0) < MAX_UNIT_RATIO_ERROR:
            return (
                None
                if scale == factor
                else (scale, f"the angle in {angle}, the velocity in {rate}")
            )
    return None


def nearest_unit(scale: float) -> float:
    """Return the known SI factor nearest to a measured factor."""
    known = {1.0, 1e-3, *UNITS["velocity"].values(), *UNITS["angle"].values()}
    return min(known, key=lambda each: abs(np.log(scale / each)))
