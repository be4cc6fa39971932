"""Repair of records with defects: correction, interpolation, masks, exclusion of channels."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from strainwave.domain import BoolArray, FloatArray, Log, channel_parts
from strainwave.dynamics.arm import Arm
from strainwave.signals.hygiene.defects import INPUTS, Defect, count_of
from strainwave.signals.standstill import runs_of

MAX_MASKED_SHARE = 0.2
"""Maximum share of masked samples in a channel that is used."""

_MAX_INPUT_GAP = 0.01  # [s] maximum duration of a defective stretch of a motor input
_MAX_ENCODER_STEPS = 20  # maximum number of encoder steps per record, without overflows
_REQUIRED_KINDS = ("theta_m", *INPUTS)  # channels that a record must have


def repair_record(
    log: Log, arm: Arm, defects: Sequence[Defect]
) -> tuple[Log | None, tuple[str, ...]]:
    """Correct, interpolate and mask the defects of a record.

    Each encoder step is subtracted from all subsequent samples. Other stretches are interpolated
    linearly; a voltage keeps its last value. All are masked, an encoder step with one sample on
    each side. Hum is not removed.

    Returns the record, or None if too much of a motor angle or input is defective, and the names of
    the excluded channels.
    """
    by_channel: dict[str, list[Defect]] = {}
    for defect in defects:
        if defect.kind != "mains-hum":
            by_channel.setdefault(defect.channel, []).append(defect)
    if not by_channel:
        return log, ()
    channels, masked = dict(log.channels), dict(log.masked)
    excluded = []
    for name, channel_defects in by_channel.items():
        mask = np.zeros(len(log), dtype=bool)
        for each in channel_defects:
            mask[max(0, each.start - (each.kind == "encoder-steps")) : each.stop] = True
        if _is_unusable(name, channel_defects, mask, log.sample_time):
            excluded.append(name)
            del channels[name]
            continue
        x = _subtract_steps(channels[name], channel_defects, count_of(name, arm))
        channels[name] = interpolate_masked(x, mask, hold=channel_parts(name)[0] == "u")
        masked[name] = mask
    if any(channel_parts(name)[0] in _REQUIRED_KINDS for name in excluded):
        return None, tuple(excluded)
    return replace(log, channels=channels, masked=masked), tuple(excluded)


def interpolate_masked(x: FloatArray, mask: BoolArray, *, hold: bool = False) -> FloatArray:
    """Replace the samples of a signal, (n_samples,), where `mask` is True.

    Interpolation is linear, or holds the last value with `hold`. At least one sample must be good.
    """
    good = np.flatnonzero(~mask)
    if not hold:
        return np.asarray(np.interp(np.arange(len(x)), good, x[good]))
    last = np.clip(np.searchsorted(good, np.arange(len(x)), side="right") - 1, 0, None)
    return np.asarray(x[good[last]])


def _is_unusable(
    name: str, channel_defects: Sequence[Defect], mask: BoolArray, sample_time: float
) -> bool:
    """Whether a channel has too many defects to be used."""
    steps = sum(defect.kind == "encoder-steps" and not defect.wraps for defect in channel_defects)
    if mask.mean() > MAX_MASKED_SHARE or steps > _MAX_ENCODER_STEPS:
        return True
    runs = runs_of(mask)
    longest = float(np.max(runs[:, 1] - runs[:, 0], initial=0)) * sample_time
    return channel_parts(name)[0] in INPUTS and longest > _MAX_INPUT_GAP


def _subtract_steps(x: FloatArray, channel_defects: Sequence[Defect], count: float) -> FloatArray:
    """Subtract encoder steps from a signal, rounded to whole counts if the count is known."""
    steps = [step for step in channel_defects if step.kind == "encoder-steps"]
    if not steps:
        return x
    offset = np.zeros(len(x))
    overflow = float(np.median([abs(step.size) for step in steps]))
    for step in steps:
        size = float(np.copysign(overflow, step.size)) if step.wraps else step.size
        offset[step.start] += count * np.round(size / count) if count else size
    return np.asarray(x - np.cumsum(offset))
