"""Defects of sensors put into clean logs: kind, place and size by chance."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from strainwave.domain import FloatArray, Log
from strainwave.dynamics.arm import Arm
from strainwave.signals.hygiene import Defect, Kind

_SIDE = 200  # samples at either end of a record that stay clean
_MOVES = 8.0  # counts in a stretch, from which a motor counts as moving in it
_TRIES = 200


@dataclass(frozen=True, slots=True)
class Injected:
    """One defect in one channel of one record, or of all records."""

    kind: Kind
    size: float  # in the unit of its kind, see `SIZES`
    record: str
    channel: str
    spans: tuple[tuple[int, int], ...]
    logs: tuple[Log, ...]

    def named(self, found: Sequence[Defect]) -> bool:
        """Whether most of its stretches are among what was found in its record."""
        own = [d for d in found if d.kind == self.kind and d.channel == self.channel]
        hits = sum(any(d.start <= b + 1 and a <= d.stop + 1 for d in own) for a, b in self.spans)
        return 2 * hits > len(self.spans)


SIZES: Mapping[Kind, tuple[str, tuple[float, ...]]] = {
    "spikes": ("of the largest change from sample to sample", (1.0, 3.0, 10.0, 100.0)),
    "frozen": ("ms", (5.0, 20.0, 50.0, 200.0)),
    "encoder-steps": ("counts", (5.0, 50.0, 500.0, 4096.0)),
    "flat-tops": ("% of the record", (0.1, 0.3, 0.9)),
    "mains-hum": ("of the channel's deviation", (0.02, 0.05, 0.1, 0.3)),
}
"""Units and sizes of each kind."""

_CHANNELS: Mapping[Kind, tuple[str, ...]] = {
    "spikes": ("theta_m", "a", "gyro"),
    "frozen": ("theta_m", "a"),
    "encoder-steps": ("theta_m",),
    "flat-tops": ("a",),
    "mains-hum": ("a", "gyro"),
}

Draw = Callable[[FloatArray, Log, int, float, Arm, np.random.Generator], list[tuple[int, int]]]


def injected(
    logs: Sequence[Log], arm: Arm, kind: Kind, size: float, rng: np.random.Generator
) -> Injected | None:
    """Logs with one defect.

    `logs`: Clean; in those of use "check" nothing is put, for it would move no parameter. `size`:
    In the unit that `SIZES` names. Returns: None where no drawn place can show it: a motor that
    stands.
    """
    for _ in range(_TRIES):
        at = int(rng.integers(len(logs)))
        joint = int(rng.integers(1, arm.n_joints + 1))
        channel = f"{rng.choice(_CHANNELS[kind])}{joint}"
        if channel not in logs[at].channels or logs[at].experiment.use == "check":
            continue
        log = logs[at]
        x = log.channels[channel].copy()
        spans = _DRAWS[kind](x, log, joint, size, arm, rng)
        if not spans:
            continue
        changed = [replace(log, channels={**log.channels, channel: x})]
        others = [changed[0] if k == at else each for k, each in enumerate(logs)]
        if kind == "mains-hum":
            others = _hum_in_all(logs, channel, size, rng)
        return Injected(kind, size, log.name, channel, tuple(spans), tuple(others))
    return None


def _spikes(
    x: FloatArray, log: Log, joint: int, size: float, arm: Arm, rng: np.random.Generator
) -> list[tuple[int, int]]:
    largest = float(np.abs(np.diff(x)).max())
    spans = []
    for start in sorted(rng.integers(_SIDE, len(x) - _SIDE, int(rng.integers(1, 6))).tolist()):
        stop = start + int(rng.integers(1, 4))
        x[start:stop] += size * largest * rng.choice([-1.0, 1.0]) * rng.uniform(1.0, 1.5)
        spans.append((start, stop))
    return spans


def _frozen(
    x: FloatArray, log: Log, joint: int, size: float, arm: Arm, rng: np.random.Generator
) -> list[tuple[int, int]]:
    length = max(2, round(1e-3 * size / log.sample_time))
    start = int(rng.integers(_SIDE, len(x) - _SIDE - length))
    angle = log.channels[f"theta_m{joint}"][start : start + length]
    if np.ptp(angle) < _MOVES * _count(arm, joint):
        return []
    x[start : start + length] = x[start]
    return [(start + 1, start + length)]


def _steps(
    x: FloatArray, log: Log, joint: int, size: float, arm: Arm, rng: np.random.Generator
) -> list[tuple[int, int]]:
    at = int(rng.integers(_SIDE, len(x) - _SIDE))
    x[at:] += rng.choice([-1.0, 1.0]) * size * _count(arm, joint)
    return [(at, at + 1)]


def _flat(
    x: FloatArray, log: Log, joint: int, size: float, arm: Arm, rng: np.random.Generator
) -> list[tuple[int, int]]:
    limit = float(np.quantile(x, 1.0 - 0.01 * size))
    cut = x > limit
    x[:] = np.minimum(x, limit)
    edges = np.flatnonzero(np.diff(np.r_[False, cut, False].astype(np.int8))).reshape(-1, 2)
    return [(a, b) for a, b in edges.tolist() if b - a > 2]


def _hum(
    x: FloatArray, log: Log, joint: int, size: float, arm: Arm, rng: np.random.Generator
) -> list[tuple[int, int]]:
    return [(0, len(x))] if len(x) * log.sample_time > 2.0 else []


def _hum_in_all(
    logs: Sequence[Log], channel: str, size: float, rng: np.random.Generator
) -> list[Log]:
    mains = float(rng.choice([50.0, 60.0])) * (1.0 + rng.uniform(-2e-3, 2e-3))
    own = [log.channels[channel] for log in logs if channel in log.channels]
    amplitude = size * float(np.median([np.std(x) for x in own]))
    found = []
    for log in logs:
        channels = dict(log.channels)
        if channel in channels:
            phase = 2.0 * np.pi * (mains * log.time + rng.uniform())
            channels[channel] = channels[channel] + amplitude * np.sin(phase)
        found.append(replace(log, channels=channels))
    return found


def _count(arm: Arm, joint: int) -> float:
    return 2.0 * np.pi / (arm.joints[joint - 1].encoder_counts or 8192)


_DRAWS: Mapping[Kind, Draw] = {
    "spikes": _spikes,
    "frozen": _frozen,
    "encoder-steps": _steps,
    "flat-tops": _flat,
    "mains-hum": _hum,
}
