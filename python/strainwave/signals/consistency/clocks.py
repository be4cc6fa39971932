"""Log -> Clocks: the rhythm in which commands change, against the rhythm that the study gives."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from strainwave.domain import FloatArray, Log, Prbs, channel_parts
from strainwave.dynamics.arm import Arm

_FEWEST_SWITCHES = 24
_JUMP = 0.3  # of a command's range: below half of it, as a servo's share may add to the test signal
_WHOLE = 0.2  # of a clock, within which a switch is at a whole number of them
_NEARLY_ALL = 0.95
_RESOLVED = 1.5  # samples in a clock, below which a switch in between may be missed
_REPEATS = 0.8  # autocorrelation of a sequence one period later


@dataclass(frozen=True, slots=True)
class Clocks:
    """What a log's commands show of its time base."""

    prbs: float | None = None  # [s] between possible switches of an open-loop PRBS
    servo: float | None = None  # [s] between changes of a servo's output
    level: Mapping[str, float] = field(default_factory=dict)  # half the swing of open-loop inputs
    excited: frozenset[str] = frozenset()  # commands that switch as test signals do

    def retimed(self, factor: float) -> Clocks:
        """With all time stamps multiplied by a factor."""

        def by(clock: float | None) -> float | None:
            return None if clock is None else factor * clock

        return replace(self, prbs=by(self.prbs), servo=by(self.servo))


def clocks_of(log: Log, arm: Arm) -> Clocks:
    """The clocks that a log's commands follow.

    Parameters
    ----------
    log : Log
    arm : Arm

    Returns
    -------
    Clocks
    """
    experiment = log.experiment
    level: dict[str, float] = {}
    prbs = servo = None
    for i, control in enumerate(experiment.control, start=1):
        name = f"u{i}" if f"u{i}" in log.channels else f"torque{i}"
        if name not in log.channels:
            continue
        values = log.channels[name]
        if control == "open" and experiment.prbs is not None:
            level[name] = 0.5 * float(np.ptp(values))
            found = _clock(values, log, two_levels=True) or _period(values, log, experiment.prbs)
            prbs = prbs or found
        elif control == "servo" and arm.servo is not None:
            servo = servo or _clock(values, log, two_levels=False)
    return Clocks(prbs, servo, level, excited_inputs(log))


def excited_inputs(log: Log) -> frozenset[str]:
    """The commands that jump through much of their range again and again."""
    excited = set()
    for name, values in log.channels.items():
        if channel_parts(name)[0] in ("u", "torque"):
            jumps = np.abs(np.diff(values)) > _JUMP * float(np.ptp(values))
            if jumps.sum() >= _FEWEST_SWITCHES:
                excited.add(name)
    return frozenset(excited)


def _clock(values: FloatArray, log: Log, *, two_levels: bool) -> float | None:
    """Period of the clock at which a held signal changes [s]; None: it shows none.

    The stamps of all changes are regressed on the number of clocks that lie between them, which the
    shortest distance gives; a clock is there if nearly all distances are whole numbers of it.
    """
    size = float(np.ptp(values))
    if size == 0.0 or (two_levels and not _two_levels(values, size)):
        return None
    changes = np.flatnonzero(np.abs(np.diff(values)) > (0.5 if two_levels else 1e-9) * size) + 1
    if len(changes) < _FEWEST_SWITCHES:
        return None
    apart = np.diff(changes)
    shortest = float(np.percentile(apart, 5.0))
    if shortest < _RESOLVED:
        return None
    clock = float(np.mean(apart[apart < 1.5 * shortest]))
    at = changes[1:] - changes[0]
    for _ in range(3):
        number = np.cumsum(np.round(apart / clock))
        clock = float(number @ at / (number @ number))
    off = np.abs(apart / clock - np.round(apart / clock))
    return clock * log.sample_time if np.mean(off < _WHOLE) > _NEARLY_ALL else None


def _two_levels(values: FloatArray, size: float) -> bool:
    middle = 0.5 * float(values.max() + values.min())
    return bool(np.mean(np.abs(values - middle) < 0.2 * size) < 1.0 - _NEARLY_ALL)


def _period(values: FloatArray, log: Log, prbs: Prbs) -> float | None:
    """A PRBS's clock from its period, where samples are too far apart to resolve its switches.

    The autocorrelation of a maximum-length sequence is 1 at whole periods and nearly 0 elsewhere.
    """
    size = float(np.ptp(values))
    if prbs.periods < 2 or size == 0.0 or not _two_levels(values, size):
        return None
    n = len(values)
    spectrum = np.fft.rfft(values - values.mean(), 2 * n)
    correlation = np.fft.irfft(np.abs(spectrum) ** 2)[: n // 2 + 1]
    overlap = n - np.arange(len(correlation))
    correlation /= overlap * correlation[0] / n
    first = int(np.argmax(correlation < 0.5))
    lag = first + int(np.argmax(correlation[first:]))
    if first == 0 or correlation[lag] < _REPEATS:
        return None
    whole = np.flatnonzero(correlation > _REPEATS)
    lag = int(whole[whole > first][0]) if np.any(whole > first) else lag
    return float(lag * log.sample_time / (2**prbs.order - 1))
