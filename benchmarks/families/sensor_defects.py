"""Inject sensor defects into clean logs at random positions."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from strainwave.domain import FloatArray, Log
from strainwave.dynamics.arm import Arm
from strainwave.signals.hygiene import Defect, Kind

_CLEAN_SAMPLES = 200  # at each end of a record
_MIN_MOTION = 8.0  # [encoder counts] in a section in which a motor moves
_MAX_ATTEMPTS = 200  # to draw a position that shows the defect
_MIN_HUM_DURATION = 2.0  # [s] of a record in which hum is detectable


@dataclass(frozen=True, slots=True)
class Injected:
    """One defect in one channel, in one record or in all records."""

    kind: Kind
    size: float  # in the unit of `SIZES`
    record: str
    channel: str
    spans: tuple[tuple[int, int], ...]
    logs: tuple[Log, ...]

    def named(self, detections: Sequence[Defect]) -> bool:
        """Whether the detections of its record contain most of its sections."""
        matches = [d for d in detections if d.kind == self.kind and d.channel == self.channel]
        hits = sum(
            any(d.start <= b + 1 and a <= d.stop + 1 for d in matches) for a, b in self.spans
        )
        return 2 * hits > len(self.spans)


DEFECT_SIZES: Mapping[Kind, tuple[str, tuple[float, ...]]] = {
    "spikes": ("times the largest change between samples", (1.0, 3.0, 10.0, 100.0)),
    "frozen": ("ms", (5.0, 20.0, 50.0, 200.0)),
    "encoder-steps": ("counts", (5.0, 50.0, 500.0, 4096.0)),
    "flat-tops": ("% of the record", (0.1, 0.3, 0.9)),
    "mains-hum": ("times the standard deviation of the channel", (0.02, 0.05, 0.1, 0.3)),
}
"""Unit and sizes of each kind."""

_CHANNELS: Mapping[Kind, tuple[str, ...]] = {
    "spikes": ("theta_m", "a", "gyro"),
    "frozen": ("theta_m", "a"),
    "encoder-steps": ("theta_m",),
    "flat-tops": ("a",),
    "mains-hum": ("a", "gyro"),
}

Injector = Callable[[FloatArray, Log, int, float, Arm, np.random.Generator], list[tuple[int, int]]]


def injected(
    logs: Sequence[Log], arm: Arm, kind: Kind, size: float, rng: np.random.Generator
) -> Injected | None:
    """Logs with one defect; None if no drawn position shows it, for example if the motor rests.

    Logs of use "check" stay clean because they do not affect parameters. `size` has the unit of
    `SIZES`.
    """
    for _ in range(_MAX_ATTEMPTS):
        index = int(rng.integers(len(logs)))
        joint = int(rng.integers(1, arm.n_joints + 1))
        channel = f"{rng.choice(_CHANNELS[kind])}{joint}"
        if channel not in logs[index].channels or logs[index].experiment.use == "check":
            continue
        log = logs[index]
        x = log.channels[channel].copy()
        spans = _INJECTORS[kind](x, log, joint, size, arm, rng)
        if not spans:
            continue
        changed = list(logs)
        changed[index] = replace(log, channels={**log.channels, channel: x})
        if kind == "mains-hum":
            changed = _add_hum_to_records(logs, channel, size, rng)
        return Injected(kind, size, log.name, channel, tuple(spans), tuple(changed))
    return None


def _inject_spikes(
    x: FloatArray, log: Log, joint: int, size: float, arm: Arm, rng: np.random.Generator
) -> list[tuple[int, int]]:
    largest = float(np.abs(np.diff(x)).max())
    spans = []
    for start in sorted(
        rng.integers(_CLEAN_SAMPLES, len(x) - _CLEAN_SAMPLES, int(rng.integers(1, 6))).tolist()
    ):
        stop = start + int(rng.integers(1, 4))
        x[start:stop] += size * largest * rng.choice([-1.0, 1.0]) * rng.uniform(1.0, 1.5)
        spans.append((start, stop))
    return spans


def _inject_frozen(
    x: FloatArray, log: Log, joint: int, size: float, arm: Arm, rng: np.random.Generator
) -> list[tuple[int, int]]:
    length = max(2, round(1e-3 * size / log.sample_time))
    start = int(rng.integers(_CLEAN_SAMPLES, len(x) - _CLEAN_SAMPLES - length))
    angle = log.channels[f"theta_m{joint}"][start : start + length]
    if np.ptp(angle) < _MIN_MOTION * _count_angle(arm, joint):
        return []
    x[start : start + length] = x[start]
    return [(start + 1, start + length)]


def _inject_encoder_steps(
    x: FloatArray, log: Log, joint: int, size: float, arm: Arm, rng: np.random.Generator
) -> list[tuple[int, int]]:
    start = int(rng.integers(_CLEAN_SAMPLES, len(x) - _CLEAN_SAMPLES))
    x[start:] += rng.choice([-1.0, 1.0]) * size * _count_angle(arm, joint)
    return [(start, start + 1)]


def _inject_flat_tops(
    x: FloatArray, log: Log, joint: int, size: float, arm: Arm, rng: np.random.Generator
) -> list[tuple[int, int]]:
    limit = float(np.quantile(x, 1.0 - 0.01 * size))
    cut = x > limit
    x[:] = np.minimum(x, limit)
    edges = np.flatnonzero(np.diff(np.r_[False, cut, False].astype(np.int8))).reshape(-1, 2)
    return [(a, b) for a, b in edges.tolist() if b - a > 2]


def _inject_hum(
    x: FloatArray, log: Log, joint: int, size: float, arm: Arm, rng: np.random.Generator
) -> list[tuple[int, int]]:
    return [(0, len(x))] if len(x) * log.sample_time > _MIN_HUM_DURATION else []


def _add_hum_to_records(
    logs: Sequence[Log], channel: str, size: float, rng: np.random.Generator
) -> list[Log]:
    mains = float(rng.choice([50.0, 60.0])) * (1.0 + rng.uniform(-2e-3, 2e-3))
    signals = [log.channels[channel] for log in logs if channel in log.channels]
    amplitude = size * float(np.median([np.std(x) for x in signals]))
    changed = []
    for log in logs:
        channels = dict(log.channels)
        if channel in channels:
            phase = 2.0 * np.pi * (mains * log.time + rng.uniform())
            channels[channel] = channels[channel] + amplitude * np.sin(phase)
        changed.append(replace(log, channels=channels))
    return changed


def _count_angle(arm: Arm, joint: int) -> float:
    return 2.0 * np.pi / (arm.joints[joint - 1].encoder_counts or 8192)


_INJECTORS: Mapping[Kind, Injector] = {
    "spikes": _inject_spikes,
    "frozen": _inject_frozen,
    "encoder-steps": _inject_encoder_steps,
    "flat-tops": _inject_flat_tops,
    "mains-hum": _inject_hum,
}
