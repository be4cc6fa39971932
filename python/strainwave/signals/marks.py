"""Marks of a record: stretches of its channels that a reader of the log should know of."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from strainwave.domain import BoolArray, Log
from strainwave.dynamics.arm import Arm
from strainwave.signals import hygiene
from strainwave.signals.prepared_record import prepare_record
from strainwave.signals.standstill import runs_of

_MAX_MARKS = 200  # listed; the largest
_MIN_STANDSTILL = 0.05  # [s] shorter ones belong to every reversal


@dataclass(frozen=True, slots=True)
class Mark:
    """A stretch of a channel."""

    kind: str
    channel: str
    start: float  # [s]
    stop: float  # [s]


def marks_of(log: Log, arm: Arm) -> list[Mark]:
    """Saturation, standstill and defects of sensors, in the order of time.

    Logs of position servos have no input that shows saturation or standstill.
    """
    marks = [] if arm.position_servo is not None else list(_marks_of_drives(log, arm))
    for defect in hygiene.detect_defects([log], arm)[0]:
        last = min(defect.stop, len(log) - 1)
        kind = defect.kind.replace("-", " ")
        times = float(log.time[defect.start]), float(log.time[last])
        marks.append(Mark(kind, defect.channel, *times))
    longest = sorted(marks, key=lambda m: m.start - m.stop)[:_MAX_MARKS]
    return sorted(longest, key=lambda m: (m.start, m.channel))


def _marks_of_drives(log: Log, arm: Arm) -> Iterator[Mark]:
    record = prepare_record(log, arm)
    for channel, at in zip(record.channels, record.saturation.samples.T, strict=True):
        yield from _stretches(log, "saturation", channel, at)
    for joint, at in enumerate(record.sliding.T == 0.0, start=1):
        standing = _stretches(log, "standstill", f"theta_m{joint}", at)
        yield from (mark for mark in standing if mark.stop - mark.start >= _MIN_STANDSTILL)


def _stretches(log: Log, kind: str, channel: str, at: BoolArray) -> Iterator[Mark]:
    for start, stop in runs_of(at).tolist():
        last = min(stop, len(log) - 1)
        yield Mark(kind, channel, float(log.time[start]), float(log.time[last]))
