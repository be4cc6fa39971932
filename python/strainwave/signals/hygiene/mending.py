"""A record with defects -> one that may be used: bridged, masked, or without a channel."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from strainwave.domain import BoolArray, FloatArray, Log
from strainwave.dynamics.arm import Arm
from strainwave.signals.hygiene.defects import INPUTS, Defect, count_of, kind_of
from strainwave.signals.standstill import runs_of

MOST = 0.2
"""Share of a record that may be masked in a channel which is used."""

_LONGEST_INPUT = 0.01  # [s] for which what drives a joint may be unknown
_MOST_STEPS = 20  # of an encoder in one record, but for wraps
_REQUIRED = ("theta_m", *INPUTS)  # without which a record is of no use


def mended(log: Log, arm: Arm, defects: Sequence[Defect]) -> tuple[Log | None, tuple[str, ...]]:
    """Take a record's defects out.

    An encoder's step is taken off all that follows. Other stretches are bridged: by a straight
    line, or of a voltage by its last value. Each is masked, an encoder's step for one sample on
    either side. Hum stays.

    Parameters
    ----------
    log : Log
    arm : Arm
    defects : sequence of Defect
        Of this record.

    Returns
    -------
    log : Log or None
        None where too much of an angle or an input is defective.
    left_out : tuple of str
        Channels that are not used.
    """
    by_channel: dict[str, list[Defect]] = {}
    for each in defects:
        if each.kind != "mains-hum":
            by_channel.setdefault(each.channel, []).append(each)
    if not by_channel:
        return log, ()
    channels, masked = dict(log.channels), dict(log.masked)
    left_out = []
    for name, own in by_channel.items():
        bad = _mask(own, len(log))
        if _too_much(name, own, bad, log.sample_time):
            left_out.append(name)
            del channels[name]
            continue
        x = _unstepped(channels[name], own, count_of(name, arm))
        channels[name] = bridged(x, bad, hold=name.startswith("u"))
        masked[name] = bad
    if any(kind_of(name) in _REQUIRED for name in left_out):
        return None, tuple(left_out)
    return replace(log, channels=channels, masked=masked), tuple(left_out)


def bridged(x: FloatArray, bad: BoolArray, *, hold: bool = False) -> FloatArray:
    """A signal with straight lines, or its last value, where it is bad.

    Parameters
    ----------
    x : (n_samples,)
    bad : (n_samples,)
        Not all True.
    hold : bool

    Returns
    -------
    (n_samples,)
    """
    good = np.flatnonzero(~bad)
    if not hold:
        return np.asarray(np.interp(np.arange(len(x)), good, x[good]))
    last = np.clip(np.searchsorted(good, np.arange(len(x)), side="right") - 1, 0, None)
    return np.asarray(x[good[last]])


def _mask(own: Sequence[Defect], n_samples: int) -> BoolArray:
    bad = np.zeros(n_samples, dtype=bool)
    for each in own:
        bad[max(0, each.start - (each.kind == "encoder-steps")) : each.stop] = True
    return bad


def _too_much(name: str, own: Sequence[Defect], bad: BoolArray, sample_time: float) -> bool:
    steps = sum(each.kind == "encoder-steps" and not each.wraps for each in own)
    if bad.mean() > MOST or steps > _MOST_STEPS:
        return True
    runs = runs_of(bad)
    longest = float(np.max(runs[:, 1] - runs[:, 0], initial=0)) * sample_time
    return kind_of(name) in INPUTS and longest > _LONGEST_INPUT


def _unstepped(x: FloatArray, own: Sequence[Defect], count: float) -> FloatArray:
    """Without an encoder's steps, which are whole counts where these are known."""
    steps = [each for each in own if each.kind == "encoder-steps"]
    if not steps:
        return x
    offset = np.zeros(len(x))
    wrap = float(np.median([abs(each.size) for each in steps]))
    for each in steps:
        size = float(np.copysign(wrap, each.size)) if each.wraps else each.size
        offset[each.start] += count * np.round(size / count) if count else size
    return np.asarray(x - np.cumsum(offset))
