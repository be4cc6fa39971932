"""A log's channels: which there are, where motors slide, where drives are at their limits."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from strainwave.domain import BoolArray, Decoupled, Diagnostic, FloatArray, Joint, Log
from strainwave.dynamics.arm import Arm
from strainwave.errors import InvalidInput
from strainwave.signals.standstill import runs_of, sliding_direction

_STANDING = 0.02  # [s] of an unmoved encoder that count as standing still
_STANDING_SAMPLES = 6  # and at least so many
_FLAT = 5  # equal samples at the extreme that make a flat top
_MUCH_SATURATION = 0.01  # share of a record worth a warning


def torque_channel(log: Log, joint: int) -> str:
    """The channel that holds a motor's torque: `torque{i}`, or else the voltage `u{i}`.

    Parameters
    ----------
    log : Log
    joint : int
        From 1.

    Returns
    -------
    str

    Raises
    ------
    InvalidInput
        There is neither.
    """
    for name in (f"torque{joint}", f"u{joint}"):
        if name in log.channels:
            return name
    raise InvalidInput(
        f"neither torque{joint} nor u{joint} is there",
        where=log.name,
        remedy="log the drive's torque or voltage",
    )


def channel_of(log: Log, name: str) -> FloatArray:
    """One channel of a log.

    Parameters
    ----------
    log : Log
    name : str

    Returns
    -------
    (n_samples,)

    Raises
    ------
    InvalidInput
        It is not there.
    """
    if name not in log.channels:
        raise InvalidInput(f"{name} is not there", where=log.name, remedy=f"log {name}")
    return log.channels[name]


def resolution(joint: Joint, noise: float) -> float:
    """What a motor's encoder resolves.

    One count of toggling, or five deviations of noise, say nothing of the direction.

    Parameters
    ----------
    joint : Joint
    noise : float [rad]
        Standard deviation, white.

    Returns
    -------
    float [rad]
    """
    count = 2.0 * np.pi / joint.encoder_counts if joint.encoder_counts else 0.0
    return max(1.5 * count, 0.0 if count else 5.0 * noise)


def directions(angle: FloatArray, noise: FloatArray, arm: Arm, T: float) -> FloatArray:
    """Sliding direction of each motor, from the angles as measured.

    Parameters
    ----------
    angle : (n_samples, n_joints) [rad]
    noise : (n_joints,) [rad]
        Standard deviation, white.
    arm : Arm
    T : float [s]
        Sample time.

    Returns
    -------
    (n_samples, n_joints)
        +1, -1, or 0 where it is uncertain.
    """
    columns = []
    standing = max(_STANDING_SAMPLES, round(_STANDING / T))
    for i, joint in enumerate(arm.joints):
        least = resolution(joint, float(noise[i]))
        columns.append(sliding_direction(angle[:, i], least, standing))
    return np.column_stack(columns)


def saturation(
    log: Log, arm: Arm, channels: tuple[str, ...]
) -> tuple[BoolArray, tuple[Diagnostic, ...]]:
    """Where the drive is at its limit: what is logged may then not be what the motor got.

    Only a servoed joint counts: an open-loop test may sit at its extremes on purpose.

    Parameters
    ----------
    log : Log
    arm : Arm
    channels : tuple of str
        Of each motor's torque, from `torque_channel`.

    Returns
    -------
    (n_samples, n_joints) bool
    tuple of Diagnostic
    """
    saturated = np.zeros((len(log), arm.n_joints), dtype=bool)
    warnings: list[Diagnostic] = []
    for i, channel in enumerate(channels):
        if log.experiment.control[i] != "servo":
            continue
        size = np.abs(log.channels[channel])
        limit = arm.servo.limit if arm.servo and channel.startswith("u") else None
        saturated[:, i] = size >= 0.999 * limit if limit else _flat_tops(log.channels[channel])
        share = float(saturated[:, i].mean())
        if share > _MUCH_SATURATION:
            text = f"{channel} is at its limit for {100.0 * share:.1f} % of the record; left out"
            text += ". Record a slower motion"
            warnings.append(Diagnostic("saturated", log.name, text))
    return saturated, tuple(warnings)


def unmeasured(log: Log, channels: Iterable[str], longer: int = 0) -> BoolArray:
    """Where any of some channels was bridged and is no measurement.

    Parameters
    ----------
    log : Log
    channels : iterable of str
    longer : int
        Samples up to which a bridge is good enough.

    Returns
    -------
    (n_samples,)
    """
    found = np.zeros(len(log), dtype=bool)
    for name in channels:
        mask = log.masked.get(name)
        if mask is None or name not in log.channels:
            continue
        for start, stop in runs_of(mask).tolist():
            found[start:stop] |= stop - start > longer
    return found


def _flat_tops(signal: FloatArray) -> BoolArray:
    """Runs of at least `_FLAT` equal samples at the largest or the smallest value.

    A drive's limits lie far from zero: a joint without torque is not at one, nor is a constant.
    """
    flat = np.zeros(len(signal), dtype=bool)
    if signal.max() == signal.min():
        return flat
    for extreme in (signal.max(), signal.min()):
        if abs(extreme) <= 0.8 * np.abs(signal).max():
            continue
        for start, stop in runs_of(signal == extreme).tolist():
            flat[start:stop] |= stop - start >= _FLAT
    return flat


def check_alike(records: Sequence[Decoupled]) -> None:
    """Check that decoupled records can be taken together: one joint, one rate.

    Parameters
    ----------
    records : sequence of Decoupled

    Raises
    ------
    InvalidInput
        There is none, or they are of different joints, inputs or sample times.
    """
    if not records:
        raise InvalidInput("there is no record to take a model from")
    first = records[0]
    for record in records[1:]:
        if record.joint != first.joint or record.inputs.shape[1] != first.inputs.shape[1]:
            raise InvalidInput(
                f"records of different joints: {first.joint} and {record.joint}",
                where=record.experiment.name,
                remedy="take one joint at a time",
            )
        if abs(record.sample_time - first.sample_time) > 1e-6 * first.sample_time:
            raise InvalidInput(
                f"sample times differ: {first.sample_time:g} s and {record.sample_time:g} s",
                where=record.experiment.name,
                remedy="log all records at one rate",
            )
