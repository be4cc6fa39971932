"""Logs -> Evidence: every record at low frequencies, and what clocks and counters show at once.

Everything here scales with the data: bands are chosen from the motion and from the record's length,
never in hertz, so that a log whose time is in milliseconds is looked at like any other.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from strainwave.domain import BoolArray, Experiment, FloatArray, Log, Study
from strainwave.dynamics.arm import Arm
from strainwave.numerics.filters import differentiate, low_pass
from strainwave.numerics.parallel import side_by_side
from strainwave.signals.consistency.clocks import Clocks, clocks_of
from strainwave.signals.consistency.counts import count_of

_SLOW = (0.8, 2.0)  # share of the velocities' power, and bandwidth over the band that holds it
_FAST = (0.5, 0.25)
_LEAST_CYCLES = 10.0  # of the bandwidth in a record
_OVERSAMPLING = 20.0  # rows per cycle of the bandwidth: second derivatives lose 0.1 % there
_MOST_SAMPLES = 2**18  # of a record that are looked at


@dataclass(frozen=True, slots=True)
class SlowRecord:
    """One record at low frequencies: low-passed, at a low rate."""

    experiment: Experiment
    sample_time: float  # [s] between rows
    bandwidth_hz: float
    channels: Mapping[str, FloatArray]  # (n_rows,)
    noise: Mapping[str, float]  # standard deviation of a row by the channel's noise above the band
    direction: FloatArray  # (n_rows, n_joints) of the motors, mean over a row
    inside: BoolArray  # (n_rows,) away from the filter's ends
    start: float  # [s] of the first row after the log's first sample
    clocks: Clocks


@dataclass(frozen=True, slots=True)
class Evidence:
    """A study and what its logs show, as a hypothesis about the input may change them."""

    study: Study  # as it is written
    arm: Arm  # as the hypothesis has it
    records: tuple[SlowRecord, ...]
    counts: Mapping[int, float]  # joint -> step of its motor angle, where it has one

    def scaled(self, channel: str, factor: float) -> Evidence:
        """With one channel multiplied by a factor in all logs."""
        records = []
        for record in self.records:
            channels = dict(record.channels)
            if channel in channels:
                channels[channel] = factor * channels[channel]
            noise = {k: v * (abs(factor) if k == channel else 1.0) for k, v in record.noise.items()}
            direction, clocks = record.direction, record.clocks
            if channel.startswith("theta_m") and factor < 0.0:
                direction = direction.copy()
                direction[:, int(channel[-1]) - 1] *= -1.0
            if channel in clocks.level:
                level = {**clocks.level, channel: abs(factor) * clocks.level[channel]}
                clocks = replace(clocks, level=level)
            records.append(
                replace(record, channels=channels, noise=noise, direction=direction, clocks=clocks)
            )
        counts = dict(self.counts)
        if channel.startswith("theta_m") and int(channel[-1]) in counts:
            counts[int(channel[-1])] *= abs(factor)
        return replace(self, records=tuple(records), counts=counts)

    def swapped(self, kind: str) -> Evidence:
        """With one kind of channel of the two joints exchanged in all logs."""
        other = {f"{kind}1": f"{kind}2", f"{kind}2": f"{kind}1"}
        records = []
        for record in self.records:
            channels = {other.get(k, k): v for k, v in record.channels.items()}
            noise = {other.get(k, k): v for k, v in record.noise.items()}
            level = {other.get(k, k): v for k, v in record.clocks.level.items()}
            swap = kind == "theta_m"
            records.append(
                replace(
                    record,
                    channels=channels,
                    noise=noise,
                    direction=record.direction[:, ::-1] if swap else record.direction,
                    clocks=replace(record.clocks, level=level),
                )
            )
        counts = {3 - k: v for k, v in self.counts.items()} if kind == "theta_m" else self.counts
        return replace(self, records=tuple(records), counts=counts)

    def shifted(self, names: Sequence[str], delay: float, drift: float) -> Evidence:
        """With some channels earlier by a delay that grows from each record's start on."""
        records = []
        for record in self.records:
            time = record.sample_time * np.arange(len(record.inside))
            at = time + delay + drift * time
            channels = dict(record.channels)
            for name in names:
                if name in channels:
                    channels[name] = np.interp(at, time, channels[name])
            records.append(replace(record, channels=channels))
        return replace(self, records=tuple(records))

    def without(self, names: Sequence[str]) -> Evidence:
        """Without some channels."""
        records = [
            replace(r, channels={k: v for k, v in r.channels.items() if k not in names})
            for r in self.records
        ]
        return replace(self, records=tuple(records))

    def retimed(self, factor: float) -> Evidence:
        """With all time stamps multiplied by a factor."""
        records = [
            replace(
                record,
                sample_time=factor * record.sample_time,
                bandwidth_hz=record.bandwidth_hz / factor,
                start=factor * record.start,
                clocks=record.clocks.retimed(factor),
            )
            for record in self.records
        ]
        return replace(self, records=tuple(records))

    def with_joint(self, joint: int, **keys: float) -> Evidence:
        """With keys of one [[joint]] changed; joints from 1."""
        joints = list(self.arm.joints)
        joints[joint - 1] = replace(joints[joint - 1], **keys)  # type: ignore[arg-type]
        return replace(self, arm=self.arm.with_joints(joints))

    def with_length(self, link_length: float) -> Evidence:
        """With another distance between the axes."""
        return replace(self, arm=replace(self.arm, link_length=link_length))


def evidence(logs: Sequence[Log], study: Study) -> Evidence:
    """What a study's logs show at low frequencies.

    Parameters
    ----------
    logs : sequence of Log
    study : Study

    Returns
    -------
    Evidence
    """
    arm = Arm.of(study.arm)
    found = side_by_side([partial(_slow, log, arm) for log in logs]) if logs else []
    counts = {}
    for joint in range(1, arm.n_joints + 1):
        count = count_of([log.channels[f"theta_m{joint}"] for log in logs])
        if count is not None:
            counts[joint] = count
    return Evidence(study, arm, tuple(r for r in found if r is not None), counts)


def _slow(log: Log, arm: Arm) -> SlowRecord | None:
    """A record at low frequencies; None where it is too short for any."""
    joints = range(1, arm.n_joints + 1)
    n = min(len(log), _MOST_SAMPLES)
    T = log.sample_time
    angle = np.column_stack([log.channels[f"theta_m{i}"][:n] for i in joints])
    band = max(motion_band(angle, T, slow=is_slow(log.experiment)), _LEAST_CYCLES / (n * T))
    block = max(1, int(1.0 / (_OVERSAMPLING * band * T)))
    n_rows = n // block
    edge = int(np.ceil(1.0 / (band * block * T)))
    if n_rows < 4 * edge:
        return None
    names = list(log.channels)
    whole = np.column_stack([log.channels[name][: n_rows * block] for name in names])
    smooth = low_pass(angle[: n_rows * block], min(4.0 * band, 0.2 / T), T)
    direction = np.sign(differentiate(smooth, T))
    rows = _means(np.column_stack([whole, direction]), block)
    slow = low_pass(rows, band, block * T)
    inside = np.zeros(n_rows, dtype=bool)
    inside[edge : n_rows - edge] = True
    above = np.sqrt(np.mean(np.diff(whole, axis=0) ** 2, axis=0) / 2.0)
    share = np.sqrt(2.0 * band * T)
    return SlowRecord(
        experiment=log.experiment,
        sample_time=block * T,
        bandwidth_hz=band,
        channels={name: slow[:, k] for k, name in enumerate(names)},
        noise={name: float(above[k] * share) for k, name in enumerate(names)},
        direction=slow[:, len(names) :],
        inside=inside,
        start=0.5 * (block - 1) * T,
        clocks=clocks_of(log, arm),
    )


def is_slow(experiment: Experiment) -> bool:
    """Whether an experiment moves all joints slowly, so that gears are as good as rigid."""
    return experiment.joint is None and experiment.use in ("motion", "check")


def _means(signal: FloatArray, block: int) -> FloatArray:
    whole: FloatArray = signal.reshape(len(signal) // block, block, -1).mean(axis=1)
    return whole


def motion_band(angle: FloatArray, sample_time: float, *, slow: bool) -> float:
    """Bandwidth that holds the slow motion of the fastest motor and little of a spring's [Hz].

    Of a slow record twice the frequency below which most of the velocities' power lies. In a fast
    one the springs ring: a quarter of the frequency below which half of it lies.

    Parameters
    ----------
    angle : (n_samples, n_joints) [rad]
    sample_time : float [s]
    slow : bool

    Returns
    -------
    float [Hz]
    """
    velocity = np.diff(angle[: 2**16], axis=0)
    power = np.cumsum(np.abs(np.fft.rfft(velocity - velocity.mean(axis=0), axis=0)) ** 2, axis=0)
    frequency = np.fft.rfftfreq(len(velocity), sample_time)
    share, reach = _SLOW if slow else _FAST
    moved = power.T[power[-1] > 0.0]
    return max(
        (reach * float(frequency[np.searchsorted(p, share * p[-1])]) for p in moved), default=0.0
    )
