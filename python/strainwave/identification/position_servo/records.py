"""Records of position servos: commanded and measured angles, cut into segments.

A closed loop forgets its state within a fraction of a second, and beyond its torque limit it is
sensitive to every earlier error. So a record is simulated in segments, each from a state of its
own that the data determine.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from enum import Enum

import numpy as np

from strainwave.domain import FloatArray, Log, Payload
from strainwave.dynamics.arm import Arm

MAX_DELAY = 0.05
"""Largest delay [s] of a reference: buses of hobby servos stay below it."""

_SEGMENT_TIME = 1.0  # [s], several time constants of a servo of 1 Hz bandwidth
_MIN_SEGMENT_SAMPLES = 20  # ten per unknown of its initial state
_MAX_PARTS = 8  # of a servo's period
_CLOCK_TOLERANCE = 1e-3  # relative, of clocks that are multiples of each other
_HISTORY = MAX_DELAY + 0.01  # [s] of reference before the first simulated sample


class ReferenceHold(Enum):
    """Course of the commanded angle between the samples of the log."""

    HELD = "held"  # the commands arrive at the rate of the log
    LINEAR = "linear"
    SMOOTH = "smooth"  # cubic spline: the log samples a faster command


@dataclass(frozen=True, slots=True, eq=False)
class ServoRecord:
    """Commanded and measured angles of the joints in one record."""

    name: str
    time: FloatArray  # (n_samples,) [s]
    reference: FloatArray  # (n_samples, n_joints) [rad] at the joint
    feed_forward: FloatArray  # (n_samples, n_joints) in the unit of the servo's output
    angle: FloatArray  # (n_samples, n_joints) [rad] at the joint
    payload: Payload | None

    @property
    def sample_time(self) -> float:
        """Sampling period [s]."""
        return float(self.time[-1] - self.time[0]) / (len(self.time) - 1)

    def commands(
        self, times: FloatArray, joint: int, hold: ReferenceHold, width: float
    ) -> FloatArray:
        """Commanded angle of a joint (from 0) at times; a held one is a mean over `width` [s]."""
        return _course(self.time, self.reference[:, joint], times, hold, width)

    def feed_forwards(self, times: FloatArray, joint: int, width: float) -> FloatArray:
        """Feed-forward of a joint (from 0) at times, held."""
        return _course(self.time, self.feed_forward[:, joint], times, ReferenceHold.HELD, width)


def _course(
    time: FloatArray, values: FloatArray, times: FloatArray, hold: ReferenceHold, width: float
) -> FloatArray:
    if hold is ReferenceHold.LINEAR:
        return np.interp(times, time, values)
    if hold is ReferenceHold.SMOOTH:
        from scipy.interpolate import CubicSpline

        return np.asarray(CubicSpline(time, values)(np.clip(times, time[0], time[-1])))
    integral = np.concatenate([[0.0], np.cumsum(values[:-1] * np.diff(time))])
    edges = (np.interp(times + half, time, integral) for half in (0.5 * width, -0.5 * width))
    return np.asarray(np.subtract(*edges) / width)


def common_period(period: float, sample_time: float) -> float:
    """Longest time [s] that divides the periods of servo and log, at least 1/8 of the servo's.

    The readings of a servo tell the delay of a held command up to this time.
    """
    for parts in range(1, _MAX_PARTS):
        ratio = sample_time * parts / period
        if abs(ratio - round(ratio)) < _CLOCK_TOLERANCE * ratio and round(ratio) > 0:
            return period / parts
    return period / _MAX_PARTS


@dataclass(frozen=True, slots=True, eq=False)
class Segment:
    """Samples `first` to `last` of a record, simulated from a state of their own."""

    record: ServoRecord
    first: int
    last: int

    @property
    def samples(self) -> slice:
        """Its samples."""
        return slice(self.first, self.last)

    @property
    def time(self) -> FloatArray:
        """Time of its samples [s]."""
        return self.record.time[self.samples]

    @property
    def angle(self) -> FloatArray:
        """Measured angles (n, n_joints) [rad]."""
        return self.record.angle[self.samples]


def servo_record(log: Log, arm: Arm) -> ServoRecord:
    """The record of a log that has all channels."""
    count = len(log)
    angle = np.column_stack([log.channels[f"theta_m{i}"] for i in range(1, arm.n_joints + 1)])

    def columns(kind: str) -> FloatArray:
        names = (f"{kind}{i}" for i in range(1, arm.n_joints + 1))
        return np.column_stack([log.channels.get(name, np.zeros(count)) for name in names])

    return ServoRecord(
        name=log.name,
        time=np.asarray(log.sample_time * np.arange(count), dtype=np.float64),
        reference=columns("ref"),
        feed_forward=columns("u"),
        angle=np.asarray(arm.links_of(angle)),
        payload=log.experiment.payload,
    )


def segments_of(record: ServoRecord, duration: float = _SEGMENT_TIME) -> Iterator[Segment]:
    """Segments of about one second, after the time in which the reference is not known yet."""
    T = record.sample_time
    first, end = int(np.ceil(_HISTORY / T)), len(record.time)
    length = max(round(duration / T), _MIN_SEGMENT_SAMPLES)
    count = max((end - first) // length, 1)
    edges = np.linspace(first, end, count + 1).round().astype(int)
    for a, b in zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True):
        if b - a >= _MIN_SEGMENT_SAMPLES:
            yield Segment(record, a, b)
