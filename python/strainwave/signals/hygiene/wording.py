"""Defects -> warnings with record, channel, time, size and remedy."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

from strainwave.domain import Diagnostic, Log
from strainwave.signals.hygiene.defects import Defect, Kind

_MAX_LISTED = 4  # maximum number of stretches that a warning lists

# Recommended action for each kind of defect
_REMEDY: Mapping[Kind, str] = {
    "spikes": "Check the cable, its shield and the plug",
    "frozen": "Look for lost packets, a loose plug, or a sensor that hangs",
    "encoder-steps": "Check the encoder's index, its supply and the counter's number of bits",
    "flat-tops": "Use a sensor of larger range, or a smaller amplitude",
    "mains-hum": "Shield and ground the sensor's cable, away from those of motors",
}


def warnings_of(
    log: Log, defects: Sequence[Defect], left_out: Sequence[str], *, used: bool
) -> Iterator[Diagnostic]:
    """Yield the warnings for one record as read, one per channel and kind of defect.

    `left_out` are the excluded channels; `used` is whether the record is used.
    """
    by_place: dict[tuple[str, Kind, str], list[Defect]] = {}
    for defect in defects:
        if defect.kind != "mains-hum":
            by_place.setdefault((defect.channel, defect.kind, defect.words), []).append(defect)
    for (channel, kind, _), group in by_place.items():
        consequence = _describe_consequence(kind, channel in left_out, used=used)
        text = f"{_describe_defects(log, channel, group)}; {consequence}. {_REMEDY[kind]}"
        yield Diagnostic(kind, f"{log.name}, {channel}", text, (log.name,))


def hum_warnings(logs: Sequence[Log], defects: Sequence[Sequence[Defect]]) -> Iterator[Diagnostic]:
    """Yield the warnings about mains hum in all records, one per channel and line.

    `defects` has one sequence per log.
    """
    lines: dict[tuple[str, str], dict[str, float]] = {}
    for log, record_defects in zip(logs, defects, strict=True):
        for defect in record_defects:
            if defect.kind == "mains-hum":
                lines.setdefault((defect.channel, defect.words), {})[log.name] = defect.size
    for (channel, words), sizes in lines.items():
        text = f"{channel} has {words}, of amplitude {max(sizes.values()):.2g}, throughout; "
        text += f"it stays in the records. {_REMEDY['mains-hum']}"
        yield Diagnostic("mains-hum", channel, text, tuple(sizes))


def _describe_defects(log: Log, channel: str, own: Sequence[Defect]) -> str:
    """Describe the observed defects of one channel and kind."""
    first = own[0]
    largest = max(abs(defect.size) for defect in own)
    times = _describe_times(log, own)
    if first.kind == "spikes":
        spikes = "a spike" if len(own) == 1 else f"{len(own)} spikes"
        return f"{channel} has {spikes} of up to {largest:.3g} {times}"
    if first.kind == "encoder-steps":
        return f"{channel}: {first.words}, by {largest:.4g} rad, {times}"
    return f"{channel} {first.words} {times}"


def _describe_times(log: Log, own: Sequence[Defect]) -> str:
    """List the times of the first `_MAX_LISTED` defects and the number of others."""
    intervals = [
        f"at {log.time[d.start]:.6g} s"
        if d.stop - d.start == 1
        else f"from {log.time[d.start]:.6g} to {log.time[d.stop - 1]:.6g} s"
        for d in own[:_MAX_LISTED]
    ]
    more = len(own) - len(intervals)
    return ", ".join(intervals) + (f", and {more} times more" if more > 0 else "")


def _describe_consequence(kind: Kind, left_out: bool, *, used: bool) -> str:
    """Describe the consequence of a defect for the result."""
    if not used:
        return "the record is not used" if left_out else "the record is not used for another defect"
    if left_out:
        return "the channel is not used in this record"
    if kind == "encoder-steps":
        return "the step was taken off what follows it"
    return "left out of the fits"
