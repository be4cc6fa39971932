"""Defects -> warnings with record, channel, time, size and remedy."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from strainwave.domain import Clause, Diagnostic, Log, Place
from strainwave.signals.hygiene.defects import Defect, Kind

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
