"""Defects of noisy sensors: flat tops, at an end of their range, and mains hum."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import chain

import numpy as np

from strainwave.domain import FloatArray, IntArray, Log
from strainwave.dynamics.arm import Arm
from strainwave.signals.hygiene.defects import Defect, noisy_kinds, of_kinds, resolution_of
from strainwave.signals.standstill import runs_of

MAX_SATURATED_SHARE = 1e-2
"""Share of saturated samples above which a channel is `clipped` and the input is rejected."""

# minimum number of equal samples at an extreme value that are a flat top
_MIN_REPEATED_SAMPLES = 3
# Minimum ratio of the number of samples at the extreme value to the number at the adjacent value.
# At the reversal of an angle, the ratio is 2.4.
_MIN_EXTREME_COUNT_RATIO = 6.0
# minimum number of distinct values; coarser channels have flat tops anyway
_MIN_DISTINCT_VALUES = 50
# minimum total number of samples at an end of the range; a peak has 3 or 4
_MIN_SATURATED_SAMPLES = 6
_MIN_EDGE_STEPS = 4.0  # minimum step into or out of a flat top, in units of the resolution


def detect_flat_tops(log: Log, _: Arm) -> list[Defect]:
    """Detect flat tops of noisy sensors.

    These sensors repeat a value `_MIN_REPEATED_SAMPLES` times only in saturation.
    More than `MAX_SATURATED_SHARE` of a record is a fault that the input check reports, see
    `strainwave.input_check`.
    """
    detections = []
    for name, x in of_kinds(log, noisy_kinds()).items():
        for end_runs in find_saturated_runs(x, rests=False):
            runs = select_abrupt_runs(x, end_runs)
            samples = int((runs[:, 1] - runs[:, 0]).sum())
            if _MIN_SATURATED_SAMPLES <= samples <= MAX_SATURATED_SHARE * len(x):
                level = float(x[runs[0, 0]])
                detections += [
                    Defect("flat-tops", name, start, stop, float(abs(x[start])), level)
                    for start, stop in runs.tolist()
                ]
    return detections


def select_abrupt_runs(values: FloatArray, runs: IntArray) -> IntArray:
    """Runs, (n_runs, 2), that a signal enters or leaves faster than the peak of a smooth signal.

    Each run is its first sample and the index after its last sample.
    """
    step = _MIN_EDGE_STEPS * resolution_of(values)
    before = np.abs(values[np.maximum(runs[:, 0] - 1, 0)] - values[runs[:, 0]])
    after = np.abs(values[np.minimum(runs[:, 1], len(values) - 1)] - values[runs[:, 0]])
    return runs[np.maximum(before, after) > step]


def find_saturated_runs(values: FloatArray, *, rests: bool) -> list[IntArray]:
    """Runs of equal values, (n_runs, 2), at the minimum and maximum, if these limit the range.

    Zero does not limit a range. For a channel that can rest (`rests`), an extreme near its median
    is a rest position and does not limit the range either. Each run is its first sample and the
    index after its last sample.
    """
    low, high = float(values.min()), float(values.max())
    median, span = float(np.median(values)), high - low
    if span == 0.0 or len(np.unique(values[:: max(1, len(values) // 4096)])) < _MIN_DISTINCT_VALUES:
        return []
    flat_tops = []
    for extreme in (low, high):
        at_standstill = rests and abs(extreme - median) < 0.25 * span
        if at_standstill or abs(extreme) < 1e-9 * span:
            continue
        at_extreme = np.abs(values - extreme) <= 1e-9 * span
        tolerance = 1e-9 * span
        inside = np.abs(values - extreme)
        inside = inside[inside > tolerance]
        adjacent = int(np.count_nonzero(inside <= inside.min() + tolerance))
        is_reversal = at_extreme.sum() < _MIN_EXTREME_COUNT_RATIO * adjacent
        if rests and is_reversal:
            continue
        runs = runs_of(at_extreme)
        runs = runs[runs[:, 1] - runs[:, 0] >= _MIN_REPEATED_SAMPLES]
        flat_tops.append(select_abrupt_runs(values, runs) if is_reversal else runs)
    return flat_tops


# relative tolerance of the mains frequency and of the clock of the logger
_FREQUENCY_TOLERANCE = 0.006
# [Hz] mains frequencies and harmonics up to the fifth
_LINES_HZ = tuple(sorted({k * hz for hz in (50.0, 60.0) for k in (1, 2, 3, 4, 5)}))
_MIN_DURATION = 1.2  # [s] minimum duration of a record to separate a line from a resonance
_MAX_SAMPLES = 1 << 16  # maximum number of samples for the spectrum
_COMPARISON_BAND_HZ = 8.0  # [Hz] half-width of the band around a line for comparison
_MIN_LINE_RATIO = 5.0  # minimum ratio of a line to the largest amplitude in that band
_LINE_HALF_WIDTH = 3  # half-width of a line with a Hann window, in spectral lines
_MAX_AMPLITUDE_RATIO = 2.0  # maximum ratio of the amplitudes of a line in different records


def detect_hum(log: Log, _: Arm) -> list[Defect]:
    """Detect isolated lines at the mains frequency and its harmonics in the spectra of sensors.

    A periodic excitation has other lines of similar amplitude nearby, and a resonance is wider than
    a line.
    """
    if _duration(log) < _MIN_DURATION:
        return []
    return [
        Defect("mains-hum", name, 0, len(log), size, hz)
        for name in of_kinds(log, noisy_kinds())
        for hz, (size, nearby) in _hum_lines(log, name).items()
        if size > _MIN_LINE_RATIO * nearby
    ]


def confirm_hum(
    logs: Sequence[Log], detections: Sequence[Sequence[Defect]]
) -> set[tuple[str, float | None]]:
    """Hum lines (channel, frequency [Hz]) that appear in all records with similar amplitude.

    At least two records, or the only one, must have the line with similar amplitude. In the other
    records, the line or the largest amplitude around it must not be smaller. This excludes the
    motion of the arm. `detections` are the defects of each log.
    """
    sizes: dict[tuple[str, float], list[float]] = {}
    for defect in chain.from_iterable(detections):
        if defect.kind == "mains-hum" and defect.level is not None:
            sizes.setdefault((defect.channel, defect.level), []).append(defect.size)
    lines: set[tuple[str, float | None]] = set()
    for (channel, hz), amplitudes in sizes.items():
        usable = [
            log for log in logs if channel in log.channels and _duration(log) >= _MIN_DURATION
        ]
        is_sufficient = len(amplitudes) > 1 or len(usable) == 1
        if not is_sufficient or max(amplitudes) > _MAX_AMPLITUDE_RATIO * min(amplitudes):
            continue
        upper_bounds = (max(_hum_lines(log, channel).get(hz, (np.inf,))) for log in usable)
        if min(upper_bounds) * _MAX_AMPLITUDE_RATIO > float(np.median(amplitudes)):
            lines.add((channel, hz))
    return lines


def _duration(log: Log) -> float:
    return min(len(log), _MAX_SAMPLES) * log.sample_time


def _hum_lines(log: Log, channel: str) -> dict[float, tuple[float, float]]:
    """Amplitudes at each frequency of `_LINES_HZ` within the spectrum, in the unit of the channel.

    Of the line, and the largest one within `_COMPARISON_BAND_HZ` of it.
    """
    x, duration = log.channels[channel][:_MAX_SAMPLES], _duration(log)
    window, near = np.hanning(len(x)), int(_COMPARISON_BAND_HZ * duration)
    spectrum = 2.0 * np.abs(np.fft.rfft((x - x.mean()) * window)) / window.sum()
    lines = {}
    for hz in _LINES_HZ:
        off = max(1.0, hz * _FREQUENCY_TOLERANCE * duration)
        low, high = int(hz * duration - off), int(np.ceil(hz * duration + off)) + 1
        if low - near < 1 or high + near >= len(spectrum):
            continue
        at = low + int(np.argmax(spectrum[low:high]))
        below = spectrum[at - near : at - _LINE_HALF_WIDTH]
        above = spectrum[at + _LINE_HALF_WIDTH + 1 : at + near + 1]
        lines[hz] = float(spectrum[at]), float(max(below.max(), above.max()))
    return lines
