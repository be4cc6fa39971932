"""Defects -> warnings with record, channel, time, size and remedy."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

from strainwave.domain import Diagnostic, Log
from strainwave.signals.hygiene.defects import Defect, Kind

_MAX_LISTED = 4  # maximum number of stretches that a warning lists

# Recommended action for each kind of defect
_REMEDY: Mapping[Kind, str] = {
    "spikes": "Check the cable, its shield and the connector",
    "frozen": "Check for lost packets, a loose connector, or a sensor that stopped updating",
    "encoder-steps": "Check the index pulse and supply of the encoder, and the bits of the counter",
    "flat-tops": "Use a sensor with a larger range, or a smaller amplitude",
    "mains-hum": "Shield and ground the sensor cable, and route it away from motor cables",
}


def build_defect_warnings(
    log: Log, defects: Sequence[Defect], excluded_channels: Sequence[str], *, used: bool
) -> Iterator[Diagnostic]:
    """Yield the warnings for one record as read, one per channel and kind of defect.

    `excluded_channels` are the excluded channels; `used` is whether the record is used.
    """
    by_place: dict[tuple[str, Kind, str], list[Defect]] = {}
    for defect in defects:
        if defect.kind != "mains-hum":
            by_place.setdefault((defect.channel, defect.kind, defect.description), []).append(
                defect
            )
    for (channel, kind, _), group in by_place.items():
        consequence = _describe_consequence(kind, channel in excluded_channels, used=used)
        text = f"{_describe_defects(log, channel, group)}; {consequence}. {_REMEDY[kind]}"
        yield Diagnostic(kind, f"{log.name}, {channel}", text, (log.name,))


def build_hum_warnings(
    logs: Sequence[Log], defects: Sequence[Sequence[Defect]]
) -> Iterator[Diagnostic]:
    """Yield the warnings about mains hum in all records, one per channel and line.

    `defects` has one sequence per log.
    """
    lines: dict[tuple[str, str], dict[str, float]] = {}
    for log, record_defects in zip(logs, defects, strict=True):
        for defect in record_defects:
            if defect.kind == "mains-hum":
                lines.setdefault((defect.channel, defect.description), {})[log.name] = defect.size
    for (channel, description), sizes in lines.items():
        text = f"{channel} has {description} with an amplitude of up to "
        text += f"{max(sizes.values()):.2g}; the hum is not removed. {_REMEDY['mains-hum']}"
        yield Diagnostic("mains-hum", channel, text, tuple(sizes))


def _describe_defects(log: Log, channel: str, channel_defects: Sequence[Defect]) -> str:
    """Describe the observed defects of one channel and kind."""
    first = channel_defects[0]
    largest = max(abs(defect.size) for defect in channel_defects)
    times = _describe_times(log, channel_defects)
    if first.kind == "spikes":
        spikes = "a spike" if len(channel_defects) == 1 else f"{len(channel_defects)} spikes"
        return f"{channel} has {spikes} of up to {largest:.3g} {times}"
    if first.kind == "encoder-steps":
        return f"{channel}: {first.description}, by {largest:.4g} rad, {times}"
    return f"{channel} {first.description} {times}"


def _describe_times(log: Log, channel_defects: Sequence[Defect]) -> str:
    """List the times of the first `_MAX_LISTED` defects and the number of others."""
    intervals = [
        f"at {log.time[d.start]:.6g} s"
        if d.stop - d.start == 1
        else f"from {log.time[d.start]:.6g} to {log.time[d.stop - 1]:.6g} s"
        for d in channel_defects[:_MAX_LISTED]
    ]
    more = len(channel_defects) - len(intervals)
    return ", ".join(intervals) + (f", and {more} more" if more > 0 else "")


def _describe_consequence(kind: Kind, is_excluded: bool, *, used: bool) -> str:
    """Describe the consequence of a defect for the result."""
    if not used:
        if is_excluded:
            return "the record is not used"
        return "the record is not used because of another defect"
    if is_excluded:
        return "the channel is not used in this record"
    if kind == "encoder-steps":
        return "the step was subtracted from all later samples"
    return "these samples are not used in the fits"
