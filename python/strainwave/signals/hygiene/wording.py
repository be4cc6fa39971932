"""Defects -> warnings: which record, channel and time, how large, and what to do."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

from strainwave.domain import Diagnostic, Log
from strainwave.signals.hygiene.defects import Defect, Kind

_LISTED = 4  # stretches that are named one by one

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
    """What to say of one record.

    Parameters
    ----------
    log : Log
        As it was read.
    defects : sequence of Defect
    left_out : sequence of str
        Channels of which too much is defective.
    used : bool
        Whether the record is.

    Yields
    ------
    Diagnostic
        One for each channel and kind.
    """
    by_place: dict[tuple[str, Kind, str], list[Defect]] = {}
    for each in defects:
        if each.kind != "mains-hum":
            by_place.setdefault((each.channel, each.kind, each.words), []).append(each)
    for (channel, kind, _), own in by_place.items():
        done = _done(kind, channel in left_out, used=used)
        text = f"{_seen(log, channel, own)}; {done}. {_REMEDY[kind]}"
        yield Diagnostic(kind, f"{log.name}, {channel}", text, (log.name,))


def hum_warnings(logs: Sequence[Log], defects: Sequence[Sequence[Defect]]) -> Iterator[Diagnostic]:
    """What to say of hum, which is in all records.

    Parameters
    ----------
    logs : sequence of Log
    defects : sequence of sequence of Defect
        Of each.

    Yields
    ------
    Diagnostic
        One for each channel and line.
    """
    lines: dict[tuple[str, str], dict[str, float]] = {}
    for log, own in zip(logs, defects, strict=True):
        for each in own:
            if each.kind == "mains-hum":
                lines.setdefault((each.channel, each.words), {})[log.name] = each.size
    for (channel, words), sizes in lines.items():
        text = f"{channel} has {words}, of amplitude {max(sizes.values()):.2g}, throughout; "
        text += f"it stays in the records. {_REMEDY['mains-hum']}"
        yield Diagnostic("mains-hum", channel, text, tuple(sizes))


def _seen(log: Log, channel: str, own: Sequence[Defect]) -> str:
    first = own[0]
    largest = max(abs(each.size) for each in own)
    times = _times(log, own)
    if first.kind == "spikes":
        what = "a spike" if len(own) == 1 else f"{len(own)} spikes"
        return f"{channel} has {what} of up to {largest:.3g} {times}"
    if first.kind == "encoder-steps":
        return f"{channel}: {first.words}, by {largest:.4g} rad, {times}"
    return f"{channel} {first.words} {times}"


def _times(log: Log, own: Sequence[Defect]) -> str:
    every = [
        f"at {log.time[d.start]:.6g} s"
        if d.stop - d.start == 1
        else f"from {log.time[d.start]:.6g} to {log.time[d.stop - 1]:.6g} s"
        for d in own[:_LISTED]
    ]
    more = len(own) - len(every)
    return ", ".join(every) + (f", and {more} times more" if more > 0 else "")


def _done(kind: Kind, left_out: bool, *, used: bool) -> str:
    if not used:
        return "the record is not used" if left_out else "the record is not used for another defect"
    if left_out:
        return "the channel is not used in this record"
    if kind == "encoder-steps":
        return "the step was taken off what follows it"
    return "left out of the fits"
