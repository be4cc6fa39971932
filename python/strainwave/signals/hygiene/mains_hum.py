"""Hum: lines at the mains' frequency and its multiples, alike in all records."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from strainwave.domain import FloatArray, Log
from strainwave.dynamics.arm import Arm
from strainwave.signals.hygiene.defects import NOISY, Defect, of_kinds

MAINS = (50.0, 60.0)
"""[Hz]"""

_OFF = 0.006  # of it, by which the mains or the logger's clock may be off
_LINES = tuple(sorted({k * hz for hz in MAINS for k in (1, 2, 3, 4, 5)}))
_SHORTEST = 1.2  # [s] of a record that separates a line from a resonance
_LONGEST = 1 << 16  # samples that are looked at
_NEAR = 8.0  # [Hz] to either side, in which nothing may be nearly as high
_ABOVE = 5.0  # times the highest amplitude there
_WIDTH = 3  # lines of the spectrum that a Hann window makes of one, to either side
_ALIKE = 2.0  # times, by which its amplitude may differ from record to record


def detect(log: Log, _: Arm) -> list[Defect]:
    """The mains' lines in the spectra of sensors, where they stand alone.

    A periodic excitation has lines as high beside any of its own; a resonance is wide.
    """
    if not _lasts(log):
        return []
    found = []
    for name, x in of_kinds(log, NOISY).items():
        spectrum, duration = _amplitudes(x[:_LONGEST]), _duration(log)
        for hz in _LINES:
            at = _highest(spectrum, hz, duration)
            if at is not None and spectrum[at] > _ABOVE * _beside(spectrum, at, duration):
                size = float(spectrum[at])
                found.append(Defect("mains-hum", name, 0, len(log), size, f"hum at {hz:.0f} Hz"))
    return found


def confirmed(logs: Sequence[Log], found: Sequence[Sequence[Defect]]) -> set[tuple[str, str]]:
    """Lines that are the mains', since they are in all records, and alike: what an arm does is not.

    At least two records, or the only one, show a line of nearly one amplitude; in the others it, or
    what it drowns in, is no lower.

    Parameters
    ----------
    logs : sequence of Log
    found : sequence of sequence of Defect
        Of each log.

    Returns
    -------
    set of (channel, words)
    """
    sizes: dict[tuple[str, str, float], list[float]] = {}
    for each in (d for own in found for d in own if d.kind == "mains-hum"):
        hz = next(hz for hz in _LINES if f"{hz:.0f} Hz" in each.words)
        sizes.setdefault((each.channel, each.words, hz), []).append(each.size)
    kept = set()
    for (channel, words, hz), own in sizes.items():
        able = [log for log in logs if channel in log.channels and _lasts(log)]
        enough = len(own) > 1 or len(able) == 1
        if not enough or max(own) > _ALIKE * min(own):
            continue
        heights = (_height(log, channel, hz) for log in able)
        if min(heights) * _ALIKE > float(np.median(own)):
            kept.add((channel, words))
    return kept


def _height(log: Log, channel: str, hz: float) -> float:
    """What a line is at most, or what it may drown in."""
    spectrum, duration = _amplitudes(log.channels[channel][:_LONGEST]), _duration(log)
    at = _highest(spectrum, hz, duration)
    return np.inf if at is None else max(float(spectrum[at]), _beside(spectrum, at, duration))


def _duration(log: Log) -> float:
    return min(len(log), _LONGEST) * log.sample_time


def _lasts(log: Log) -> bool:
    """Whether a record is long enough to separate a line from what lies beside it."""
    return _duration(log) >= _SHORTEST


def _amplitudes(x: FloatArray) -> FloatArray:
    """Of each line of the spectrum, in the channel's unit."""
    window = np.hanning(len(x))
    return np.asarray(2.0 * np.abs(np.fft.rfft((x - x.mean()) * window)) / window.sum())


def _highest(spectrum: FloatArray, hz: float, duration: float) -> int | None:
    """The highest line about a frequency; None where the record has nothing there."""
    off = max(1.0, hz * _OFF * duration)
    low, high = int(hz * duration - off), int(np.ceil(hz * duration + off)) + 1
    near = int(_NEAR * duration)
    if low - near < 1 or high + near >= len(spectrum):
        return None
    return low + int(np.argmax(spectrum[low:high]))


def _beside(spectrum: FloatArray, at: int, duration: float) -> float:
    near = int(_NEAR * duration)
    below, above = spectrum[at - near : at - _WIDTH], spectrum[at + _WIDTH + 1 : at + near + 1]
    return float(max(below.max(), above.max()))
