"""Defects of a channel: kind, samples and size, functions of all detectors, and their warnings."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from strainwave.domain import Clause, Diagnostic, FloatArray, Log, Place, channel_parts
from strainwave.domain.arm.link_sensors import all_types, sensor_of
from strainwave.dynamics.arm import Arm

Kind = Literal["spikes", "frozen", "encoder-steps", "flat-tops", "mains-hum"]
"""Kinds of defects, which are also warning codes; see docs/troubleshooting.md."""


def encoder_kinds() -> tuple[str, ...]:
    """Channels of angle sensors, without the joint's number."""
    return ("theta_m", *(k for s in all_types() if s.reads_angle for k in s.channel_kinds))


def noisy_kinds() -> tuple[str, ...]:
    """Channels of sensors whose reading changes from sample to sample: by noise or motion."""
    return tuple(k for s in all_types() if not s.reads_angle for k in s.channel_kinds)


INPUTS = ("u", "torque")
"""Motor inputs."""

# maximum number of samples for statistics of the changes of a channel
_MAX_STATISTICS_SAMPLES = 65_536
_USUAL_QUANTILE = 0.995  # quantile of the absolute changes that defines the usual change


@dataclass(frozen=True, slots=True)
class Defect:
    """One defective stretch of one channel."""

    kind: Kind
    channel: str
    start: int  # first sample
    stop: int  # index after the last sample
    size: float  # in the unit of the channel; duration [s] if frozen
    level: float | None = None  # frequency of hum [Hz], or end of a sensor's range
    wraps: bool = False  # whether the step is the full range of a counter


Detector = Callable[[Log, Arm], list[Defect]]
"""Function that detects one kind of defect in a record, ordered by channel and time."""


def of_kinds(log: Log, kinds: tuple[str, ...]) -> Mapping[str, FloatArray]:
    """Channels of the given kinds that are not constant: name -> (n_samples,).

    `kinds` are channel names without the joint number.
    """
    chosen = {name: x for name, x in log.channels.items() if channel_parts(name)[0] in kinds}
    return {name: x for name, x in chosen.items() if x.min() < x.max()}


def count_of(channel: str, arm: Arm) -> float:
    """One count of an encoder [rad]; zero if unknown or for another channel."""
    kind, joint = channel_parts(channel)
    if not 0 < joint <= arm.n_joints:
        return 0.0
    if kind == "theta_m":
        return arm.joints[joint - 1].encoder_resolution
    sensor = sensor_of(arm.joints[joint - 1], kind)
    return sensor.resolution if sensor else 0.0


def usual_change(change: FloatArray) -> float:
    """Quantile `_USUAL_QUANTILE` of the nonnegative changes of a channel, (n,); zero if empty."""
    subset = change[:: max(1, len(change) // _MAX_STATISTICS_SAMPLES)]
    if not len(subset):
        return 0.0
    k = min(len(subset) - 1, int(_USUAL_QUANTILE * len(subset)))
    return float(np.partition(subset, k)[k])


def resolution_of(signal: FloatArray) -> float:
    """First percentile of the nonzero steps of a signal, (n_samples,): one count if quantized."""
    step = np.abs(np.diff(signal[:_MAX_STATISTICS_SAMPLES]))
    step = step[step > 0.0]
    if not len(step):
        return 0.0
    k = len(step) // 100
    return float(np.partition(step, k)[k])


_MAX_LISTED = 4  # maximum number of stretches that a warning lists


def build_defect_warnings(
    log: Log, defects: Sequence[Defect], excluded_channels: Sequence[str], *, used: bool
) -> Iterator[Diagnostic]:
    """Yield the warnings for one record as read, one per channel and kind of defect.

    `excluded_channels` are the excluded channels; `used` is whether the record is used.
    """
    by_place: dict[tuple[str, Kind, float | None, bool], list[Defect]] = {}
    for defect in defects:
        if defect.kind != "mains-hum":
            place = (defect.channel, defect.kind, defect.level, defect.wraps)
            by_place.setdefault(place, []).append(defect)
    for (channel, kind, level, wraps), group in by_place.items():
        spikes = Clause("spikes-count", count=len(group))
        if len(group) == 1:
            spikes = Clause("spikes-count/one")
        yield Diagnostic(
            kind,
            Place((log.name,), channel),
            "overflow" if wraps else "",
            channel=channel,
            count=spikes,
            level=level,
            size=max(abs(defect.size) for defect in group),
            times=_times(log, group),
            consequence=_consequence(kind, channel in excluded_channels, used=used),
        )


def build_hum_warnings(
    logs: Sequence[Log], defects: Sequence[Sequence[Defect]]
) -> Iterator[Diagnostic]:
    """Yield the warnings about mains hum in all records, one per channel and line.

    `defects` has one sequence per log.
    """
    lines: dict[tuple[str, float | None], dict[str, float]] = {}
    for log, record_defects in zip(logs, defects, strict=True):
        for defect in record_defects:
            if defect.kind == "mains-hum":
                lines.setdefault((defect.channel, defect.level), {})[log.name] = defect.size
    for (channel, hz), sizes in lines.items():
        place, amplitude = Place(tuple(sizes), channel), max(sizes.values())
        yield Diagnostic("mains-hum", place, channel=channel, frequency_hz=hz, amplitude=amplitude)


def _times(log: Log, channel_defects: Sequence[Defect]) -> tuple[Clause, ...]:
    """List the times of the first `_MAX_LISTED` defects and the number of others."""
    times = [
        Clause("instant", time=float(log.time[d.start]))
        if d.stop - d.start == 1
        else Clause("interval", start=float(log.time[d.start]), stop=float(log.time[d.stop - 1]))
        for d in channel_defects[:_MAX_LISTED]
    ]
    more = len(channel_defects) - len(times)
    return (*times, Clause("more", count=more)) if more > 0 else tuple(times)


def _consequence(kind: Kind, is_excluded: bool, *, used: bool) -> Clause:
    """Consequence of a defect for the result."""
    if not used:
        return Clause("record-not-used" if is_excluded else "record-not-used/other-defect")
    if is_excluded:
        return Clause("channel-not-used")
    return Clause("step-subtracted" if kind == "encoder-steps" else "samples-not-used")
