"""Detection of mains hum: spectral lines at the mains frequency and its harmonics."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import chain

import numpy as np

from strainwave.domain import FloatArray, Log
from strainwave.dynamics.arm import Arm
from strainwave.signals.hygiene.defects import Defect, noisy_kinds, of_kinds

MAINS_FREQUENCIES_HZ = (50.0, 60.0)
"""Mains frequencies [Hz]."""

# relative tolerance of the mains frequency and of the clock of the logger
_FREQUENCY_TOLERANCE = 0.006
# [Hz] fundamental and harmonics up to the fifth
_LINES_HZ = tuple(sorted({k * hz for hz in MAINS_FREQUENCIES_HZ for k in (1, 2, 3, 4, 5)}))
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
    if not _is_long_enough(log):
        return []
    detections = []
    for name, x in of_kinds(log, noisy_kinds()).items():
        spectrum, duration = _amplitudes(x[:_MAX_SAMPLES]), _duration(log)
        for hz in _LINES_HZ:
            line = _peak_index(spectrum, hz, duration)
            if line is None:
                continue
            size = float(spectrum[line])
            if size > _MIN_LINE_RATIO * _largest_nearby(spectrum, line, duration):
                detections.append(Defect("mains-hum", name, 0, len(log), size, hz))
    return detections


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
        usable = [log for log in logs if channel in log.channels and _is_long_enough(log)]
        is_sufficient = len(amplitudes) > 1 or len(usable) == 1
        if not is_sufficient or max(amplitudes) > _MAX_AMPLITUDE_RATIO * min(amplitudes):
            continue
        upper_bounds = (_amplitude_bound(log, channel, hz) for log in usable)
        if min(upper_bounds) * _MAX_AMPLITUDE_RATIO > float(np.median(amplitudes)):
            lines.add((channel, hz))
    return lines


def _amplitude_bound(log: Log, channel: str, hz: float) -> float:
    """Upper bound of the amplitude of a line: its peak or the largest amplitude around it."""
    spectrum, duration = _amplitudes(log.channels[channel][:_MAX_SAMPLES]), _duration(log)
    line = _peak_index(spectrum, hz, duration)
    if line is None:
        return np.inf
    return max(float(spectrum[line]), _largest_nearby(spectrum, line, duration))


def _duration(log: Log) -> float:
    return min(len(log), _MAX_SAMPLES) * log.sample_time


def _is_long_enough(log: Log) -> bool:
    return _duration(log) >= _MIN_DURATION


def _amplitudes(x: FloatArray) -> FloatArray:
    """Amplitude spectrum in the unit of the channel."""
    window = np.hanning(len(x))
    return np.asarray(2.0 * np.abs(np.fft.rfft((x - x.mean()) * window)) / window.sum())


def _peak_index(spectrum: FloatArray, hz: float, duration: float) -> int | None:
    """Index of the largest line near a frequency [Hz]; None if outside the spectrum."""
    off = max(1.0, hz * _FREQUENCY_TOLERANCE * duration)
    low, high = int(hz * duration - off), int(np.ceil(hz * duration + off)) + 1
    near = int(_COMPARISON_BAND_HZ * duration)
    if low - near < 1 or high + near >= len(spectrum):
        return None
    return low + int(np.argmax(spectrum[low:high]))


def _largest_nearby(spectrum: FloatArray, at: int, duration: float) -> float:
    """Largest amplitude within `_COMPARISON_BAND_HZ` of a line, without the line itself."""
    near = int(_COMPARISON_BAND_HZ * duration)
    below = spectrum[at - near : at - _LINE_HALF_WIDTH]
    above = spectrum[at + _LINE_HALF_WIDTH + 1 : at + near + 1]
    return float(max(below.max(), above.max()))
