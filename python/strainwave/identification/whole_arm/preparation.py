"""Log -> `Dataset`: which records are fitted, and what of each is compared with a simulated arm."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from strainwave.domain import BoolArray, Imu, Joint, Log
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.mounting import Axis, axes_of
from strainwave.dynamics.simulation import Drive
from strainwave.errors import InvalidInput
from strainwave.identification.closed_loop import has_accelerometer
from strainwave.identification.whole_arm.dataset import BEGINNING, Channel, Dataset, noise_behind
from strainwave.identification.whole_arm.low_pass import Kernels, low_pass_kernels
from strainwave.numerics.filters import noise_deviation
from strainwave.signals.channels import unmeasured
from strainwave.signals.recorded_input import (
    driven_by_voltage,
    missing_motor_signal,
    missing_recorded_input,
    recorded_drive,
)

_STEP = 2.5e-4  # [s] of the integrator: its error stays below a quarter of the sensors' noise
_REST = 3.0  # encoder counts, or deviations of its noise, within which a joint is at standstill
STEPS_PER_PERIOD = 8.0
"""Integrator steps in a period of the cut-off, where the step's error is corrected or tolerated."""
_SAME_STEP = 1.0 + 1e-9  # factor within which two steps are the same but for rounding
_TURN = 0.002  # [s] over which accelerations are seen


def usable(logs: Sequence[Log], arm: Arm) -> list[Log]:
    """The records of the whole-arm fit: all that excite gears and can be gone through again."""
    uses = ("frequency", "sweep", "tuning")
    return [
        log for log in logs if log.experiment.use in uses and not missing_motor_signal(arm, log)
    ]


def dataset_of(log: Log, arm: Arm, cutoff_hz: float, *, closed_loop: bool = False) -> Dataset:
    """A record ready to be compared with simulated arms.

    `cutoff_hz` [Hz]: Of the low-pass.
    `closed_loop`: Servoed joints follow their references under the study's servo, where the log has
        enough for that; otherwise the recorded voltages drive them.

    Raises `InvalidInput`: the log lacks something that going through it again needs, or is too
    short.
    """
    missing = missing_motor_signal(arm, log)
    if missing:
        raise InvalidInput(missing, where=log.name, remedy="log every motor's angle and voltage")
    log = _with_link_angles(log, arm)
    T = log.sample_time
    kernels = low_pass_kernels(cutoff_hz, T)
    reach = len(kernels.smooth)
    if len(log) < 4 * reach:
        raise InvalidInput(
            f"lasts {len(log) * T:.3g} s, which a low-pass of {cutoff_hz:.3g} Hz leaves little of",
            where=log.name,
            remedy=f"record at least {4 * reach * T:.2g} s",
        )
    channels = tuple(_channels(log, arm))
    raw = [log.channels[channel.name] for channel in channels]
    rows = [kernels.rows(x, rate=c.rate) for x, c in zip(raw, channels, strict=True)]
    counts = tuple(
        _count(arm.joints[c.joint - 1]) if c.quantity == "motor_angle" else 0.0 for c in channels
    )
    middle = 0.5 * (reach - 1) * T
    return Dataset(
        log=log,
        arm=_as_driven(log, arm),
        cutoff_hz=cutoff_hz,
        drive=_drive(log, arm, closed_loop=closed_loop),
        channels=channels,
        kernels=kernels,
        time=log.time[0] + middle + kernels.step * T * np.arange(len(rows[0])),
        measured=np.column_stack(rows),
        noise=noise_behind(channels, raw, kernels, counts),
        counts=counts,
        moving=_begins_in_motion(log, arm),
        longest_step=_STEP,
        lacking=np.zeros((len(rows[0]), len(channels))),
        counted=_counted(log, channels, kernels),
    )


def coarsened(record: Dataset, longest_step: float) -> Dataset:
    """The same record in longer steps, for a search that is still far off.

    `longest_step` [s]: Of the integrator; samples that lie closer are thinned, and voltages become
        their means.

    Returns: Its rows lie as far apart, about.
    """
    coarse = _thinned(record, max(1, int(longest_step / record.log.sample_time)))
    return replace(coarse, longest_step=max(longest_step, _STEP))


def in_long_steps(record: Dataset) -> Dataset:
    """The same rows of a record whose arm is simulated in the longest steps that the band allows.

    Samples are thinned by a divisor of the samples per row, and the low-pass of the simulated
    channels looks ahead by the distance between the centres of its taps before and after.
    """
    step, T = record.kernels.step, record.log.sample_time
    longest_step = 1.0 / (STEPS_PER_PERIOD * record.cutoff_hz)
    divisors = (every for every in range(1, step + 1) if step % every == 0)
    every = max(each for each in divisors if each == 1 or each * T <= longest_step * _SAME_STEP)
    if every == 1:
        return replace(record, longest_step=max(longest_step, record.longest_step))
    coarse = _thinned(record, every)
    ahead = 0.5 * (1.0 - 1.0 / every)
    kernels = low_pass_kernels(record.cutoff_hz, every * T, ahead)
    return replace(coarse, kernels=kernels, longest_step=max(longest_step, record.longest_step))


def _thinned(record: Dataset, every: int) -> Dataset:
    """A record of every so many-th sample, driven by the means of its voltages between them."""
    log = record.log
    n = len(log) // every
    channels = {
        name: x[: n * every].reshape(n, every).mean(axis=1)
        if name.startswith(("u", "torque"))
        else x[: n * every : every]
        for name, x in log.channels.items()
    }
    masked = {
        name: np.asarray(bad[: n * every].reshape(n, every).any(axis=1))
        for name, bad in log.masked.items()
    }
    thinned = replace(
        log,
        masked=masked,
        sample_time=every * log.sample_time,
        time=log.time[: n * every : every],
        channels=channels,
    )
    coarse = dataset_of(thinned, record.arm, record.cutoff_hz, closed_loop=any(record.drive.servo))
    return replace(coarse, noise=record.noise, moving=record.moving)


def _with_link_angles(log: Log, arm: Arm) -> Log:
    """With theta_l = n theta_m + deflection of joints whose torsion is what was measured."""
    channels, masked = dict(log.channels), dict(log.masked)
    for i, joint in enumerate(arm.joints, start=1):
        if f"deflection{i}" in channels and f"theta_l{i}" not in channels:
            motor = channels[f"theta_m{i}"]
            channels[f"theta_l{i}"] = joint.gear_ratio * motor + channels[f"deflection{i}"]
            masked[f"theta_l{i}"] = unmeasured(log, (f"theta_m{i}", f"deflection{i}"))
    return replace(log, channels=channels, masked=masked)


def _counted(log: Log, channels: Sequence[Channel], kernels: Kernels) -> BoolArray | None:
    """(n_rows, n_channels) whether no masked sample has a share in a row; None where all count."""
    masked = [unmeasured(log, (channel.name,)) for channel in channels]
    if not any(bad.any() for bad in masked):
        return None
    reach, step = len(kernels.smooth), kernels.step
    before = [np.r_[0, np.cumsum(bad)] for bad in masked]
    return np.column_stack([(b[reach:] - b[:-reach])[::step] == 0 for b in before])


def _channels(log: Log, arm: Arm) -> Iterator[Channel]:
    for i in range(1, arm.n_joints + 1):
        yield Channel(f"theta_m{i}", i, "motor_angle", rate=True, shifted=False)
    for i in range(1, arm.n_joints + 1):
        if has_accelerometer(log, arm, i):
            yield Channel(f"a{i}", i, "accelerometer", rate=False, shifted=True)
        elif f"theta_l{i}" in log.channels:
            yield Channel(f"theta_l{i}", i, "link_angle", rate=True, shifted=False)
        elif f"gyro{i}" in log.channels:
            yield Channel(f"gyro{i}", i, "gyro", rate=False, shifted=True)
        for axis in axes_of(log.channels, arm, i):
            yield Channel(axis.channel, i, axis.quantities[0], False, True, axis)


def _drive(log: Log, arm: Arm, *, closed_loop: bool) -> Drive:
    """The recorded voltages, held from sample to sample, in place of servos and references."""
    if closed_loop and missing_recorded_input(arm, log) is None:
        return recorded_drive(arm, log)
    return driven_by_voltage(arm, log)[1]


def _begins_in_motion(log: Log, arm: Arm) -> bool:
    """Whether any motor is further on, at some early instant, than it could get from standstill.

    From standstill it gets no further than a t^2 / 2, a its largest acceleration in all.
    """
    T = log.sample_time
    span = max(1, round(_TURN / T))
    first = min(max(2, round(BEGINNING / T)), len(log) // 4)
    t = T * np.arange(first)
    for i, joint in enumerate(arm.joints, start=1):
        angle = log.channels[f"theta_m{i}"]
        error = _REST * max(_count(joint), noise_deviation(angle))
        bend = angle[2 * span :] - 2.0 * angle[span:-span] + angle[: -2 * span]
        fastest = np.max(np.abs(bend)) / (span * T) ** 2
        if np.any(np.abs(angle[:first] - angle[0]) > error + 0.5 * fastest * t**2):
            return True
    return False


def _count(joint: Joint) -> float:
    """One step of the encoder [rad]."""
    return 2.0 * np.pi / joint.encoder_counts if joint.encoder_counts else 0.0


def _as_driven(log: Log, arm: Arm) -> Arm:
    """Encoders without counts; an accelerometer of unknown place is simulated as an IMU."""
    joints = tuple(
        replace(joint, encoder_counts=None, imu=_imu(axes_of(log.channels, arm, i), joint))
        for i, joint in enumerate(arm.joints, start=1)
    )
    return arm.with_joints(joints)


def _imu(axes: Sequence[Axis], joint: Joint) -> Imu | None:
    """What the axes that may sit anywhere need to be simulated."""
    if not axes:
        return None
    if axes[0].kind == "tangential":
        return Imu(accelerometer_hz=joint.accelerometer_hz)
    return joint.imu or Imu()
