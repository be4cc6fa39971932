"""Detection and repair of defective samples before any estimate: logs -> logs and warnings.

Each kind of defect has one function from a record to a list of `Defect`. Short defects are
interpolated and masked, and no row of a fit uses them. If a large share of a channel is defective,
the record, or the channel in it, is excluded.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from strainwave.domain import BoolArray, Diagnostic, FloatArray, Log, channel_parts
from strainwave.dynamics.arm import Arm
from strainwave.numerics.parallel import run_parallel
from strainwave.signals.hygiene.defects import (
    INPUTS,
    Defect,
    Detector,
    Kind,
    build_defect_warnings,
    build_hum_warnings,
    count_of,
)
from strainwave.signals.hygiene.jumps import detect_encoder_steps, detect_frozen, detect_spikes
from strainwave.signals.hygiene.noisy_sensors import confirm_hum, detect_flat_tops, detect_hum
from strainwave.signals.standstill import runs_of

__all__ = ["DETECTORS", "Defect", "Kind", "detect_defects", "repair_records"]

DETECTORS: Mapping[Kind, Detector] = {
    "spikes": detect_spikes,
    "frozen": detect_frozen,
    "encoder-steps": detect_encoder_steps,
    "flat-tops": detect_flat_tops,
    "mains-hum": detect_hum,
}
"""Detector of each kind of defect."""


def detect_defects(logs: Sequence[Log], arm: Arm) -> list[list[Defect]]:
    """Detect all defects of each record; one list per log.

    Mains hum is included only if the records together confirm it.
    """
    detections = run_parallel([partial(_detect_in_record, log, arm) for log in logs])
    hum = confirm_hum(logs, detections)
    return [
        [
            defect
            for defect in record_defects
            if defect.kind != "mains-hum" or (defect.channel, defect.level) in hum
        ]
        for record_defects in detections
    ]


def repair_records(logs: Sequence[Log], arm: Arm) -> tuple[tuple[Log, ...], tuple[Diagnostic, ...]]:
    """Interpolate and mask the defects of all records.

    Returns the usable records, without channels and records that are defective to a large extent,
    and warnings that state record, channel, time and remedy.
    """
    usable_logs: list[Log] = []
    warnings: list[Diagnostic] = []
    detections = detect_defects(logs, arm)
    for log, record_defects in zip(logs, detections, strict=True):
        usable, excluded_channels = repair_record(log, arm, record_defects)
        warnings += build_defect_warnings(
            log, record_defects, excluded_channels, used=usable is not None
        )
        if usable is not None:
            usable_logs.append(usable)
    return tuple(usable_logs), (*warnings, *build_hum_warnings(logs, detections))


def _detect_in_record(log: Log, arm: Arm) -> list[Defect]:
    return [defect for detect in DETECTORS.values() for defect in detect(log, arm)]


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
