"""Evidence for the input check: low-frequency records, command clocks, encoder counts.

All frequency bands follow from the motion and the length of the record. No band is fixed in hertz,
so a log with its time in milliseconds gives the same evidence as a log in seconds.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Hashable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, TypeVar

import numpy as np

from strainwave.domain import (
    BoolArray,
    Channel,
    Correction,
    Experiment,
    FloatArray,
    Log,
    Study,
    channel_parts,
)
from strainwave.domain.keys import JointNumber
from strainwave.domain.results.consistency import apply_corrections
from strainwave.dynamics.arm import Arm
from strainwave.input_check.timing import (
    DelayProfile,
    compute_delay_profile,
    estimate_clocks,
    find_excited_inputs,
    input_levels,
)
from strainwave.numerics.filters import differentiate, low_pass
from strainwave.numerics.parallel import run_parallel
from strainwave.signals.channels import estimate_encoder_count, resolutions_of
from strainwave.signals.motor import detect_standing_motors, motion_bands

# Bandwidth of a record over the median of all motors in the slow records above which noise
# determines it: a motor at constant velocity has no other power.
_MAX_BAND_RATIO = 4.0
# Minimum record length in periods of the bandwidth frequency.
_MIN_CYCLES = 10.0
# Rows per period of the bandwidth frequency. Second derivatives lose 0.1 % at this rate.
_ROWS_PER_CYCLE = 20.0
# Samples per period of the bandwidth frequency at least: with fewer, velocities that controllers
# calculate by differences lose more than the tolerance of a scale.
_MIN_SAMPLES_PER_CYCLE = 10.0
# Maximum number of samples evaluated per record, from its start.
_MAX_SAMPLES = 2**18
# The same after decimation: a record of wide motion has ten times the cycles that a search of
# causes needs, and each cause takes as long as its rows.
_MAX_ROWS = 2**14


Result = TypeVar("Result")


class HypothesisCache:
    """Results by the identity of the objects that they follow from.

    A hypothesis about the input shares all signals that it does not correct, so that only the rest
    is computed again.
    """

    def __init__(self) -> None:
        self._results: dict[tuple[Hashable, ...], tuple[tuple[object, ...], Any]] = {}
        self._stated: dict[int, object] = {}  # the large results are kept for these alone

    def state(self, arm: Arm, records: Sequence[SlowRecord]) -> None:
        """Keep large results of an arm and of the signals of records."""
        signals = [x for record in records for x in record.channels.values()]
        self._stated = {id(x): x for x in (arm, *signals)}

    def is_stated(self, *sources: object) -> bool:
        """Whether large results of the sources are kept."""
        return all(id(x) in self._stated for x in sources)

    def recall(
        self,
        name: Hashable,
        sources: Sequence[object],
        compute: Callable[[], Result],
        *,
        is_kept: bool = True,
    ) -> Result:
        """The result of that name from these objects; computed once if it `is_kept`."""
        if not is_kept:
            return compute()
        key = (name, *map(id, sources))
        if key not in self._results:  # the sources are kept, so that their identities stay unique
            self._results[key] = tuple(sources), compute()
        result: Result = self._results[key][1]
        return result


@dataclass(frozen=True, slots=True)
class SlowRecord:
    """One record after low-pass filtering and decimation to n_rows."""

    experiment: Experiment
    sample_time: float  # [s] between rows
    bandwidth_hz: float
    channels: Mapping[str, FloatArray]  # (n_rows,)
    # std of a row, extrapolated from the noise above the band, and at least that of rounding
    noise: Mapping[str, float]
    direction: FloatArray  # (n_rows, n_joints) mean sign of the motor velocity
    moves: BoolArray  # (n_joints,) motors that move; the others deflect at most
    inside: BoolArray  # (n_rows,) rows without end effects of the filter
    prbs_clock: float | None  # [s] of the PRBS
    servo_clock: float | None  # [s] update period of the servo output
    levels: Mapping[str, float]  # half the range of open-loop inputs
    excited: frozenset[str]  # commands that contain a test signal
    delays: Mapping[JointNumber, DelayProfile]  # where the record determines the delay
    removed_delays: Mapping[str, float] = field(default_factory=dict)  # by channel [s]


@dataclass(frozen=True, slots=True)
class PredictedSignal:
    """A signal of one record, or of several, compared with its prediction."""

    channel: str
    explained: float  # share of the variance of the signal
    values: Mapping[str, tuple[float, float]]  # kind of observation -> value, standard deviation
    seconds: float = np.inf  # length of the record
    signal: float = np.inf  # signal-to-noise ratio at low frequency
    expected_signal: float = np.inf  # the same of the prediction
    size: float = 1.0  # standard deviation over that of the prediction


@dataclass(frozen=True, slots=True)
class Evidence:
    """A study and the low-frequency content of its logs, under one hypothesis about the input."""

    study: Study  # with the corrections of the hypothesis
    records: tuple[SlowRecord, ...]
    counts: Mapping[JointNumber, float]  # encoder count of its motor angle, if quantised
    high_passes: Mapping[str, float] = field(default_factory=dict)  # channel -> cutoff [Hz]
    # of the best explanation of the torques: half the mean logarithm of the unexplained shares of
    # held-out stretches, and the ratio of unexplained variances, less 1, up to which others are as
    # good; None without torques
    best_fit: tuple[float, float] | None = None
    # of all hypotheses about the same logs
    cache: HypothesisCache = field(default_factory=HypothesisCache)

    @property
    def arm(self) -> Arm:
        """Arm of the study."""
        description = self.study.arm
        return self.cache.recall("arm", (description,), lambda: Arm.of(description))

    @property
    def channels(self) -> frozenset[str]:
        """Names of the channels of all records."""
        return frozenset(name for record in self.records for name in record.channels)

    def corrected(self, corrections: Sequence[Correction]) -> Evidence:
        """Evidence after corrections of the study and the logs."""
        after = replace(self, study=apply_corrections(self.study, corrections))
        experiments = {each.name: each for each in after.study.experiments}
        records = [replace(r, experiment=experiments[r.experiment.name]) for r in self.records]
        after = replace(after, records=tuple(records))
        changed = {c.entry for c in corrections if c.table == "channels"}
        if "t" in changed:
            after = after._retimed(after.channel("t").scale / self.channel("t").scale)
        if changed - {"t"}:
            after = after._remapped(self, changed - {"t"})
        for name, key, value in (
            (c.entry, c.key, c.number) for c in corrections if c.table == "log"
        ):
            if key == "high_pass_hz":
                after = replace(after, high_passes={**after.high_passes, name: value})
            elif key == "unusable":
                after = after.without([name])
            else:  # a delay [s], or its drift [s/s]
                shift = (value, 0.0) if key == "delay_s" else (0.0, value)
                shifted = [_shift_channel(record, name, *shift) for record in after.records]
                after = replace(after, records=tuple(shifted))
        return after

    def corrected_in(self, record: str, corrections: Sequence[Correction]) -> Evidence:
        """Evidence after corrections of the channels of one record, or of all if it is empty."""
        if not record:
            return self.corrected(corrections)
        (one,) = [r for r in self.records if r.experiment.name == record]
        (changed,) = replace(self, records=(one,)).corrected(corrections).records
        return replace(self, records=tuple(changed if r is one else r for r in self.records))

    def channel(self, name: str) -> Channel:
        """Column, scale and offset of a channel."""
        return self.study.channels.get(name) or Channel(name)

    def _remapped(self, before: Evidence, changed: Collection[str]) -> Evidence:
        """Evidence after a change of the columns, scales or offsets of the `changed` channels."""
        owners = {before.channel(name).column: name for name in before.channels}
        sources, counts = {}, dict(self.counts)
        for name in changed:
            after, joint = self.channel(name), channel_parts(name)[1]
            source = owners.get(after.column, name)
            stated, from_joint = before.channel(source), channel_parts(source)[1]
            factor = after.scale / stated.scale
            sources[name] = source, factor, after.offset - factor * stated.offset
            if name == f"theta_m{joint}":
                counts.pop(joint, None)
                if from_joint in self.counts:
                    counts[joint] = abs(factor) * self.counts[from_joint]
        records = tuple(_remapped(record, sources) for record in self.records)
        return replace(self, records=records, counts=counts)

    def without(self, names: Collection[str]) -> Evidence:
        """Evidence without the channels `names`."""
        records = [
            replace(r, channels={k: v for k, v in r.channels.items() if k not in names})
            for r in self.records
        ]
        return replace(self, records=tuple(records))

    def _retimed(self, factor: float) -> Evidence:
        """Evidence after all time stamps are multiplied by `factor`."""
        records = []
        for each in self.records:
            prbs, servo = (x and factor * x for x in (each.prbs_clock, each.servo_clock))
            T, hz = factor * each.sample_time, each.bandwidth_hz / factor
            changed = replace(each, sample_time=T, bandwidth_hz=hz, delays={})
            records.append(replace(changed, prbs_clock=prbs, servo_clock=servo))
        return replace(self, records=tuple(records))


def _shift_channel(record: SlowRecord, name: str, delay: float, drift: float) -> SlowRecord:
    """Record after removal of a delay from one channel.

    The delay is `delay` [s] at the start of the record and grows by `drift` [s/s].
    """
    if name not in record.channels:
        return record
    removed = record.removed_delays
    T, last = record.sample_time, len(record.inside) - 1
    rows = np.clip((1.0 + drift) * np.arange(last + 1) + delay / T, 0, last)
    near = np.rint(rows).astype(np.intp)
    moved, part = record.channels[name][near], T * (rows - near)
    derivative, power = record.channels[name], np.ones(last + 1)
    for order in (1, 2, 3):  # of Taylor's series: half a row changes the derivatives little
        derivative, power = differentiate(derivative, T), power * part / order
        moved = moved + power * derivative[near]
    return replace(
        record,
        channels={**record.channels, name: moved},
        removed_delays={**removed, name: removed.get(name, 0.0) + delay},
    )


def _remapped(record: SlowRecord, sources: Mapping[str, tuple[str, float, float]]) -> SlowRecord:
    """Record with channels from others; `sources` have name -> (name before, factor, offset)."""
    channels = {name: x for name, x in record.channels.items() if name not in sources}
    noise = {name: std for name, std in record.noise.items() if name not in sources}
    levels = {name: x for name, x in record.levels.items() if name not in sources}
    excited = set(record.excited) - set(sources)
    direction, moves = record.direction.copy(), record.moves.copy()
    for name, (source, factor, offset) in sources.items():
        kind, joint = channel_parts(name)
        if source in record.channels:
            signal, is_same = record.channels[source], factor == 1.0 and offset == 0.0
            channels[name] = signal if is_same else factor * signal + offset
            noise[name] = abs(factor) * record.noise[source]
        if source in record.levels:
            levels[name] = abs(factor) * record.levels[source]
        if source in record.excited:
            excited.add(name)
        if kind == "theta_m":
            origin = channel_parts(source)[1] - 1
            direction[:, joint - 1] = np.sign(factor) * record.direction[:, origin]
            moves[joint - 1] = record.moves[origin]
    delays = {}
    for joint in range(1, direction.shape[1] + 1):
        names = [f"{kind}{joint}" for kind in ("theta_m", "u", "torque")]
        before = [sources[n][0] if n in sources else n for n in names if n in channels]
        origins = {channel_parts(name)[1] for name in before}
        if len(origins) == 1 and (profile := record.delays.get(origins.pop())) is not None:
            delays[joint] = profile
    return replace(
        record,
        channels=channels,
        noise=noise,
        direction=direction,
        moves=moves,
        levels=levels,
        excited=frozenset(excited),
        delays=delays,
    )


def collect_evidence(logs: Sequence[Log], study: Study) -> Evidence:
    """Collect the evidence of a study. Records that are too short are omitted.

    Motors that only deflect stand; fast records excite their gears.
    """
    # a shorter log stays the same object, with what other stages prepared from it
    logs = [log.cut(slice(_MAX_SAMPLES)) if len(log) > _MAX_SAMPLES else log for log in logs]
    arm, slow = Arm.of(study.arm), [is_slow(log.experiment) for log in logs]
    angles = [
        np.column_stack([log.channels[f"theta_m{i + 1}"] for i in range(arm.n_joints)])
        for log in logs
    ]
    stands = iter(detect_standing_motors([angles[k] for k in np.flatnonzero(slow)]))
    moves = [~next(stands) if each else np.ones(arm.n_joints, dtype=bool) for each in slow]
    bands = [
        motion_bands(angle[:, moving], log.sample_time, slow=each)
        for log, angle, moving, each in zip(logs, angles, moves, slow, strict=True)
    ]
    of_slow = [hz for k in np.flatnonzero(slow) for hz in bands[k]]
    limit = (
        _MAX_BAND_RATIO * float(np.quantile(of_slow, 0.5, method="lower")) if of_slow else np.inf
    )
    jobs, resolutions = [], resolutions_of(logs)
    for log, angle, moving, hz, each in zip(logs, angles, moves, bands, slow, strict=True):
        band = min(max(hz, default=0.0), limit if each else np.inf)
        jobs.append(partial(_slow_record, log, arm, angle, moving, band, resolutions))
    records = run_parallel(jobs)
    counts = {
        joint: count
        for joint in range(1, arm.n_joints + 1)
        if (count := estimate_encoder_count([log.channels[f"theta_m{joint}"] for log in logs]))
    }
    return Evidence(study, tuple(r for r in records if r is not None), counts)


def _slow_record(
    log: Log,
    arm: Arm,
    angle: FloatArray,
    moves: BoolArray,
    band: float,
    resolutions: Mapping[str, float],
) -> SlowRecord | None:
    """Low-pass filter and decimate a record. Returns None if the record is too short.

    `angle` are the motor angles, (n_samples, n_joints), `band` is the bandwidth of the motion [Hz].
    `resolutions` are those of the channels; no low-pass removes the rounding of a slow reading.
    """
    T, n = log.sample_time, len(angle)
    band = max(min(band, 1.0 / (_MIN_SAMPLES_PER_CYCLE * T)), _MIN_CYCLES / (n * T))
    block = max(1, int(1.0 / (_ROWS_PER_CYCLE * band * T)))
    n_rows = min(n // block, _MAX_ROWS)
    edge = int(np.ceil(1.0 / (band * block * T)))
    if n_rows < 4 * edge:
        return None
    names = list(log.channels)
    samples = np.column_stack([log.channels[name][: n_rows * block] for name in names])
    smooth = low_pass(angle[: n_rows * block], min(4.0 * band, 0.2 / T), T)
    direction = np.sign(differentiate(smooth, T))
    rows = np.column_stack([samples, direction]).reshape(n_rows, block, -1).mean(axis=1)
    slow = low_pass(rows, band, block * T)
    inside = np.zeros(n_rows, dtype=bool)
    inside[edge : n_rows - edge] = True
    all_band_noise = np.sqrt(np.mean(np.diff(samples, axis=0) ** 2, axis=0) / 2.0)
    share = np.sqrt(2.0 * band * T)  # of white noise in the band
    prbs, servo = estimate_clocks(log, arm)
    return SlowRecord(
        experiment=log.experiment,
        sample_time=block * T,
        bandwidth_hz=band,
        channels={name: slow[:, k] for k, name in enumerate(names)},
        noise={
            name: max(float(all_band_noise[k] * share), resolutions.get(name, 0.0) / np.sqrt(12.0))
            for k, name in enumerate(names)
        },
        direction=slow[:, len(names) :],
        moves=moves,
        inside=inside,
        prbs_clock=prbs,
        servo_clock=servo,
        levels=input_levels(log),
        excited=find_excited_inputs(log),
        delays=_delay_profiles(log, arm),
    )


def _delay_profiles(log: Log, arm: Arm) -> dict[JointNumber, DelayProfile]:
    """Delay profiles of the joints that a test signal excites."""
    profiles = {}
    if log.experiment.use in ("frequency", "sweep"):
        open_loop = {i for i, control in enumerate(log.experiment.control, 1) if control == "open"}
        excited = {channel_parts(name)[1] for name in find_excited_inputs(log)}
        for joint in excited | {i for i in open_loop if i == log.experiment.joint}:
            profile = compute_delay_profile(log, arm, joint - 1)
            if profile is not None:
                profiles[joint] = profile
    return profiles


def is_slow(experiment: Experiment) -> bool:
    """Whether an experiment moves all joints slowly, so that the rigid model applies."""
    return experiment.joint is None and experiment.use in ("motion", "check")


def exchanged_tests(evidence: Evidence) -> tuple[list[str], list[str]]:
    """Records with a stated PRBS that no command contains, and motions whose commands contain one.

    Their files can be exchanged.
    """
    tests = [(record.experiment, bool(record.excited)) for record in evidence.records]
    silent = [e.name for e, has_signal in tests if e.prbs is not None and not has_signal]
    return silent, [e.name for e, has_signal in tests if is_slow(e) and has_signal]
