"""Channels of a log: names, counts of encoders, sliding directions, saturation of the drives."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Literal, Self

import numpy as np

from strainwave.domain import BoolArray, Decoupled, Diagnostic, FloatArray, Lag, Log, Place
from strainwave.domain.arm.link_sensors import LinkSensor
from strainwave.domain.keys import JointNumber
from strainwave.dynamics.arm import Arm
from strainwave.errors import InvalidInput, RecordTooShort
from strainwave.signals.standstill import runs_of

# minimum number of consecutive equal samples at an extreme value that are saturation
_MIN_SATURATED_SAMPLES = 5
# share of saturated samples in a record above which a warning is issued
_MAX_SATURATED_SHARE = 0.01


InputKind = Literal["torque", "u"]


@dataclass(frozen=True, slots=True)
class MotorInput:
    """Logged input of one motor: its torque, or the voltage command of its drive."""

    kind: InputKind
    joint: JointNumber
    values: FloatArray  # (n_samples,) [N m] or [V]

    @classmethod
    def of(cls, log: Log, joint: int, kinds: Sequence[InputKind]) -> Self | None:
        """Input of a joint of the first logged kind; None if the log has none of them."""
        logged = (kind for kind in kinds if f"{kind}{joint}" in log.channels)
        kind = next(logged, None)
        return None if kind is None else cls(kind, joint, log.channels[f"{kind}{joint}"])

    @property
    def channel(self) -> str:
        """Channel of the log."""
        return f"{self.kind}{self.joint}"

    @property
    def is_voltage(self) -> bool:
        """Whether the input is the voltage command."""
        return self.kind == "u"


def check_length(log: Log, edge: int, cutoff_hz: float) -> None:
    """Check that a record lasts longer than the transients of a low-pass at its ends.

    `edge` [samples] is the length of a transient. Raises RecordTooShort otherwise.
    """
    if len(log) < 4 * edge + 16:
        raise RecordTooShort(
            f"{len(log)} samples are too few for a filter of {cutoff_hz:.3g} Hz",
            where=log.name,
            remedy="record a longer motion",
        )


@dataclass(frozen=True, slots=True)
class Saturation:
    """Samples at which drives are at their limits. Their logged torque can be wrong."""

    samples: BoolArray  # (n_samples, n_joints)
    warnings: tuple[Diagnostic, ...]


def detect_saturation(log: Log, arm: Arm, inputs: Sequence[MotorInput]) -> Saturation:
    """Detect samples at which the drive is at its limit.

    Only servoed joints are examined, because an open-loop voltage can be at its extremes
    intentionally. There is a warning for each input with more than 1 % of saturated samples.
    """
    saturated = np.zeros((len(log), arm.n_joints), dtype=bool)
    warnings: list[Diagnostic] = []
    for i, motor in enumerate(inputs):
        if log.experiment.control[i] != "servo":
            continue
        limit = arm.servo.limit if arm.servo and motor.is_voltage else None
        saturated[:, i] = (
            np.abs(motor.values) >= 0.999 * limit if limit else _detect_flat_tops(motor.values)
        )
        share = float(saturated[:, i].mean())
        if share > _MAX_SATURATED_SHARE:
            place, channel = Place.in_records(log.name), motor.channel
            warnings.append(Diagnostic("saturated", place, channel=channel, share=share))
    return Saturation(saturated, tuple(warnings))


def unmeasured(log: Log, channels: Iterable[str], longer: int = 0) -> BoolArray:
    """Samples, (n_samples,), at which any of the channels is interpolated and not measured.

    Interpolated stretches of up to `longer` samples are accepted as measured.
    """
    interpolated = np.zeros(len(log), dtype=bool)
    for name in channels:
        mask = log.masked.get(name)
        if mask is None or name not in log.channels:
            continue
        for start, stop in runs_of(mask).tolist():
            interpolated[start:stop] |= stop - start > longer
    return interpolated


def _detect_flat_tops(signal: FloatArray) -> BoolArray:
    """Runs of at least `_MIN_SATURATED_SAMPLES` equal samples at the maximum or minimum.

    Extremes near zero and constant signals are not limits of a drive.
    """
    saturated = np.zeros(len(signal), dtype=bool)
    if signal.max() == signal.min():
        return saturated
    for extreme in (signal.max(), signal.min()):
        if abs(extreme) <= 0.8 * np.abs(signal).max():
            continue
        for start, stop in runs_of(signal == extreme).tolist():
            saturated[start:stop] |= stop - start >= _MIN_SATURATED_SAMPLES
    return saturated


def check_alike(records: Sequence[Decoupled]) -> None:
    """Check that decoupled records belong to one joint and have one sampling rate.

    Raises InvalidInput if there is no record, or if joints, inputs or sampling periods differ.
    """
    if not records:
        raise InvalidInput("there is no record from which to estimate a model")
    first = records[0]
    for record in records[1:]:
        if record.joint != first.joint or record.inputs.shape[1] != first.inputs.shape[1]:
            raise InvalidInput(
                f"records of different joints: {first.joint} and {record.joint}",
                where=record.experiment.name,
                remedy="use records of one joint",
            )
        if abs(record.sample_time - first.sample_time) > 1e-6 * first.sample_time:
            raise InvalidInput(
                f"sampling periods differ: {first.sample_time:g} s and {record.sample_time:g} s",
                where=record.experiment.name,
                remedy="log all records at the same sampling rate",
            )


def sensor_lags(sensor: LinkSensor | None) -> tuple[Lag, ...]:
    """Low-pass of a sensor, as the study gives it."""
    return (Lag(sensor.low_pass_order, sensor.hz),) if sensor and sensor.hz else ()


# Minimum number of steps for an estimate.
_MIN_STEPS = 40
# Maximum step in counts. Rounding of the logged digits hides the count in larger steps.
_MAX_STEP_COUNTS = 12.0
# Maximum distance of a step from a whole number of counts, in counts.
_MAX_COUNT_DISTANCE = 0.12
# Minimum share of the steps within `_MAX_COUNT_DISTANCE` of a whole number of counts.
_MIN_WHOLE_SHARE = 0.97
# Minimum share of the steps that are odd multiples of a count.
_MIN_ODD_SHARE = 0.25
# Maximum number of samples evaluated per record.
_MAX_SAMPLES = 40_000


def resolutions_of(logs: Sequence[Log]) -> dict[str, float]:
    """Resolution of each channel: its least change between two samples in any of the logs.

    A sensor that does not move may give the same reading in a whole record, whose noise is then
    unknown. Without rounding, the least change is far below the noise.
    """
    resolutions: dict[str, float] = {}
    for log in logs:
        for name, samples in log.channels.items():
            changes = np.abs(np.diff(samples))
            least = float(np.min(changes, initial=np.inf, where=changes > 0.0))
            resolutions[name] = min(resolutions.get(name, np.inf), least)
    return {name: least for name, least in resolutions.items() if np.isfinite(least)}


def estimate_encoder_count(angles: Sequence[FloatArray]) -> float | None:
    """Size of one encoder count of a motor angle, in the unit of the channel.

    The count is the smallest step between consecutive samples, provided that nearly all small
    steps are whole multiples of it. `angles` holds the same channel of several records, each of
    shape (n_samples,). Returns None if the angle shows no quantisation.
    """
    used = [angle[:_MAX_SAMPLES] for angle in angles]
    # interpolation, as of a shifted log, divides a step, but not that between two held readings
    held = [angle[1:][angle[1:] == angle[:-1]] for angle in used]
    steps = _nonzero_steps(held)
    if len(steps) < _MIN_STEPS:
        steps = _nonzero_steps(used)
    if len(steps) < _MIN_STEPS:
        return None
    sorted_steps = np.sort(steps)
    smallest = sorted_steps[: max(1, len(sorted_steps) // 1000) + 4]
    min_step = float(np.median(smallest))
    if min_step == 0.0:
        return None
    count = float(np.median(sorted_steps[sorted_steps < 1.5 * min_step]))
    small_steps = sorted_steps[sorted_steps < _MAX_STEP_COUNTS * count]
    if len(small_steps) < _MIN_STEPS or len(small_steps) < 0.001 * len(sorted_steps):
        return None
    multiples = np.round(small_steps / count)
    if multiples.min() < 1.0:
        return None
    if np.mean(multiples % 2.0 == 1.0) < _MIN_ODD_SHARE:  # interpolated samples halve a count
        count, multiples = 2.0 * count, 0.5 * multiples
        whole = multiples % 1.0 == 0.0
        small_steps, multiples = small_steps[whole], multiples[whole]
    count = float(multiples @ small_steps / (multiples @ multiples))
    distance = np.abs(small_steps / count - multiples)
    distinct = len(np.unique(multiples))
    return (
        count
        if np.mean(distance < _MAX_COUNT_DISTANCE) > _MIN_WHOLE_SHARE and distinct > 1
        else None
    )


def _nonzero_steps(angles: Sequence[FloatArray]) -> FloatArray:
    steps = np.concatenate([np.zeros(0), *(np.abs(np.diff(angle)) for angle in angles)])
    return np.asarray(steps[steps > 1e-9 * steps.max(initial=0.0)])
