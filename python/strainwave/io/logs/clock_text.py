"""Dates and clock times in text."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from datetime import UTC, datetime

import numpy as np

from strainwave.domain import FloatArray
from strainwave.errors import InvalidInput
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
