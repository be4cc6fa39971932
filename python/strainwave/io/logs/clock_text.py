"""Dates and clock times in text.

Time stamps of a table in seconds.

A time column may be a counter that overflows, a time of day that begins again at midnight, or be
split into two columns. Stamps may repeat or step back.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from strainwave.domain import Channel, Diagnostic, FloatArray, Place
from strainwave.errors import InvalidInput
from strainwave.io.logs.clocks import MAX_GAP_PERIODS, Track, cut
from strainwave.io.logs.tables import Clock

_STAMP = re.compile(
    r"""(?:(?P<year>\d{4})[-/.](?P<month>\d{1,2})[-/.](?P<day>\d{1,2})
        |(?P<first>\d{1,2})(?P<mark>[-/.])(?P<second>\d{1,2})(?P=mark)(?P<last>\d{4}|\d{2})
        |(?P<number>\d{1,2})[- ](?P<word>[A-Za-z]{3})[a-z]*[- ](?P<after>\d{4}))?
        (?:(?:^|[T ]\s*|(?<=\d)[-_:])(?P<hour>\d{1,2}):(?P<minute>\d{2})
        (?::(?P<whole>\d{2})(?:[.,:](?P<fraction>\d{1,9}))?)?\s*(?P<half>[AaPp][Mm])?
        (?:\s*(?P<zone>Z|UTC|GMT|[+-]\d{2}:?\d{2}))?)?""",
    re.VERBOSE,
)
_SECONDS = re.compile(r"\d{2}(?:[.,]\d{1,9})?Z?")
_MONTHS = ("jan", "feb", "mar", "apr", "may", "jun", "jul", "aug", "sep", "oct", "nov", "dec")


def clock_of(text: str) -> Clock | None:
    """Return the type of a time stamp, or None if the text is none."""
    if not text or not text[0].isdigit() or len(text) > 48:
        return None
    match = _STAMP.fullmatch(text)
    if match is None:
        return None
    has_date = bool(match["year"] or match["last"] or match["after"])
    if match["hour"] is None:
        return "date" if has_date else None
    return "datetime" if has_date else "time"


def stamp_seconds(texts: Sequence[str], place: Callable[[int], str]) -> FloatArray:
    """Convert time stamps of one column to seconds since 1970 UTC or since midnight.

    An empty text is NaN. Without a zone, the time is UTC. In 01/02/2024, the month is first unless
    a row contradicts. Raises InvalidInput at the `place` of the first other text.
    """
    day_first = any(
        match["first"] and (match["mark"] != "/" or int(match["first"]) > 12)
        for date in {text[:10] for text in texts}
        if (match := _STAMP.match(date))
    )
    seconds = np.full(len(texts), np.nan)
    minutes: dict[str, float] = {}  # text up to the minute -> seconds
    for index, text in enumerate(texts):
        head, _, tail = text.rpartition(":")
        try:
            if head[-3:-2] == ":" and head.count(":") == 1 and _SECONDS.fullmatch(tail):
                if head not in minutes:
                    minutes[head] = _seconds(head + ":00", day_first)
                seconds[index] = minutes[head] + float(tail.rstrip("Z").replace(",", "."))
            elif text:
                seconds[index] = _seconds(text, day_first)
        except ValueError as error:
            raise InvalidInput(
                f"{text[:40]!r} is not a date or time",
                where=place(index),
                remedy="correct the value",
            ) from error
    return seconds


def _seconds(text: str, day_first: bool) -> float:
    match = _STAMP.fullmatch(text)
    if match is None or clock_of(text) is None:
        raise ValueError(text)
    seconds = 0.0
    if match["hour"]:
        hour = int(match["hour"])
        if match["half"]:
            hour = hour % 12 + (12 if match["half"].lower() == "pm" else 0)
        fraction = float(f"0.{match['fraction'] or 0}")
        seconds = 3600.0 * hour + 60.0 * int(match["minute"]) + int(match["whole"] or 0) + fraction
        zone = match["zone"] or ""
        if zone[:1] in ("+", "-") and zone:
            shift = 3600.0 * int(zone[1:3]) + 60.0 * int(zone[-2:])
            seconds -= shift if zone[0] == "+" else -shift
    if match["year"]:
        date = match["year"], match["month"], match["day"]
    elif match["last"]:
        first, second = match["first"], match["second"]
        date = (match["last"], second, first) if day_first else (match["last"], first, second)
    elif match["after"]:
        month = _MONTHS.index(match["word"].lower()) + 1
        date = match["after"], str(month), match["number"]
    else:
        return seconds
    year, month, day = map(int, date)
    return (
        datetime(year + (2000 if year < 100 else 0), month, day, tzinfo=UTC).timestamp() + seconds
    )


_DAY = 86400.0  # [s]
# values at which counters begin again: 8 to 32 bits, also of us or ms written in s; midnight in s,
# ms
_MODULI = (
    *(2.0**8, 2.0**16, _DAY, 2.0**24, 1e3 * _DAY, 2.0**32),
    *(2.0**32 * 1e-6, 2.0**32 * 1e-3),
)
_FRACTIONS = (1.0, 1e-3, 1e-6, 1e-9)  # [s] units of the fractions of a second
_RESTART_PAUSE_PERIODS = 1000.0  # [periods] pause in place of a step back, also of a slow bus
# maximum share of rows that repeat a stamp; more: the stamps are coarser than the sampling period
_MAX_REPEATED_SHARE = 0.05


def time_of(
    columns: Mapping[str, FloatArray], clocks: Mapping[str, Clock], channel: Channel
) -> FloatArray:
    """Time stamps [s] of a table, (n_samples,).

    The second column of a channel is added: fractions of a second, in the unit in which all are
    below one second, or the time of day of a date. Text and two columns count from the first row.
    Overflows are removed.
    """
    values = columns[channel.column]
    kinds = {clocks.get(name) for name in channel.columns}
    if channel.second_column is not None:
        second, unit = columns[channel.second_column], 1.0
        if not kinds & {"time", "date"}:
            largest = float(np.max(second, initial=0.0))
            unit = next((each for each in _FRACTIONS if largest * each < 1.0), _FRACTIONS[-1])
        values = (values - values[0]) + unit * (second - second[0])
    elif kinds != {None}:
        values = values - values[0]
    return channel.scale * _without_overflows(values) + channel.offset


def _without_overflows(values: FloatArray) -> FloatArray:
    """Remove the steps back of a counter at its overflow, or of a clock at midnight."""
    steps = np.diff(values)
    back = steps < 0.0
    if not back.any() or back.all():
        return values
    period = float(np.median(steps[~back]))
    for modulus in _MODULI:
        wraps = back & (steps + modulus > 0.0) & (steps + modulus <= MAX_GAP_PERIODS * period)
        if wraps.any() and np.ptp(values) < modulus:
            return np.asarray(values + modulus * np.concatenate([[0.0], np.cumsum(wraps)]))
    return values


def drop_repeats(track: Track, path: Path) -> tuple[Track, list[Diagnostic]]:
    """Drop rows that repeat the time stamp of the row before.

    Raises InvalidInput if so many different rows share their stamps that the stamps are too coarse.
    """
    steps = np.diff(track.time)
    repeated = np.flatnonzero(steps == 0.0) + 1
    if not len(repeated):
        return track, []
    differ = np.zeros(len(repeated), dtype=bool)
    for values in track.columns.values():
        differ |= values[repeated] != values[repeated - 1]
    if np.count_nonzero(differ) > _MAX_REPEATED_SHARE * len(track.time):
        raise InvalidInput(
            f"{np.count_nonzero(differ)} of {len(track.time)} rows repeat the time stamp of the row"
            " before: the stamps are coarser than the sampling period",
            where=f"{path}, {track.row_name(int(repeated[differ][0]))}",
            remedy="log finer stamps; or give sample_rate [Hz] in [channels] instead of t",
        )
    keep = np.ones(len(track.time), dtype=bool)
    keep[repeated] = False
    warning = Diagnostic("repeated-stamps", Place(file=path.name), count=len(repeated))
    return cut(track, keep), [warning]


def continue_time(time: FloatArray) -> FloatArray:
    """Time that continues after a pause where the stamps step back."""
    steps = np.diff(time)
    back = steps < 0.0
    if not back.any():
        return time
    forward = steps[~back]
    pause = _RESTART_PAUSE_PERIODS * float(np.median(forward)) if len(forward) else 1.0
    shifts = np.cumsum(np.where(back, pause - steps, 0.0))
    return np.asarray(time + np.concatenate([[0.0], shifts]))
