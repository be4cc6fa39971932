"""Log -> Replayed: a record to go through again, and what of it is compared with a simulated arm.

The recorded voltages drive the arm, so that no servo has to be known. Angles are compared as
velocities, which do not drift away as open-loop angles do. Every channel passes through one
linear-phase low-pass on both sides and is then thinned to what that leaves of it.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from strainwave.errors import InvalidInput
from strainwave.filters import noise_deviation
from strainwave.records import FloatArray, Joint, Log, Study
from strainwave.replay import replay
from strainwave.simulation import Drive, Quantity, sensitivities, simulate_arms

INITIAL = ("initial_motor_velocity", "initial_link_angle", "initial_link_velocity")
"""What is unknown of the beginning of a record that begins in motion, joint by joint."""

_STEP = 2.5e-4  # [s] of the integrator: below 100 Hz its error is a hundredth of the sensors' noise
_PER_PERIOD = 4.0  # rows in a period of the cut-off; more would only repeat each other
_REACH = 1.5  # periods of the cut-off that the low-pass reaches to either side
_SHAPE = 5.0  # of its Kaiser window: 50 dB outside its band
_REST = 3.0  # encoder counts, or deviations of its noise, within which a joint is at rest
_BEGINNING = 0.02  # [s] that are looked at for it
_TURN = 0.002  # [s] over which accelerations are seen


@dataclass(frozen=True, slots=True)
class Channel:
    """One compared signal of one joint."""

    name: str
    joint: int  # from 1
    quantity: Quantity
    rate: bool  # whether it is an angle, compared as a velocity
    shifted: bool  # whether an unknown constant is added to it


@dataclass(frozen=True, slots=True)
class Kernels:
    """A low-pass as weights of the samples around each row, and the same of the slope."""

    smooth: FloatArray  # (n_taps,)
    slope: FloatArray  # (n_taps,) [1/s]
    step: int  # samples from row to row

    def rows(self, samples: FloatArray, *, rate: bool) -> FloatArray:
        """(n_samples, ...) -> (n_rows, ...), without the edges that the low-pass cannot reach.

        Sums of products block by block: a block of `step` samples meets every part of the kernel in
        one matrix product, whose shifted sums are the rows.
        """
        taps = self.slope if rate else self.smooth
        parts = taps.reshape(-1, self.step)
        n_blocks = len(samples) // self.step
        flat = samples[: n_blocks * self.step].reshape(n_blocks, self.step, -1)
        products = np.matmul(parts, flat)  # (n_blocks, n_parts, columns)
        n_rows = n_blocks - len(parts) + 1
        rows = products[:n_rows, 0].copy()
        for part in range(1, len(parts)):
            rows += products[part : part + n_rows, part]
        return np.asarray(rows.reshape(n_rows, *samples.shape[1:]))


@dataclass(frozen=True, slots=True)
class Replayed:
    """One record, ready to be compared."""

    log: Log
    study: Study  # encoders without counts, so that the simulation is smooth in the parameters
    drive: Drive
    channels: tuple[Channel, ...]
    kernels: Kernels
    time: FloatArray  # (n_rows,) [s]
    measured: FloatArray  # (n_rows, n_channels)
    noise: FloatArray  # (n_channels,) standard deviation of the sensors' own noise behind it
    moving: bool  # whether it begins in motion

    @property
    def local(self) -> tuple[tuple[str, int], ...]:
        """Unknown initial states, (name, joint)."""
        if not self.moving:
            return ()
        return tuple((name, i) for name in INITIAL for i in range(1, self.study.n_joints + 1))

    def start(self) -> FloatArray:
        """A first guess of the unknown initial states, (n_local,): gears untwisted."""
        if not self.moving:
            return np.zeros(0)
        n, T = self.study.n_joints, self.log.sample_time
        first = max(2, round(_BEGINNING / T))
        ratios = np.array([joint.gear_ratio for joint in self.study.joints])
        angle = np.column_stack([self.log.channels[f"theta_m{i + 1}"][:first] for i in range(n)])
        slope, origin = np.polyfit(T * np.arange(first), angle, 1)
        return np.concatenate([slope, ratios * origin, ratios * slope])

    def simulated(
        self, values: Mapping[tuple[str, int | None], float], local: FloatArray
    ) -> FloatArray:
        """The channels of an arm, without their unknown constants: (n_rows, n_channels)."""
        runs = simulate_arms(
            self.study,
            [dict(values)],
            self._begun(local),
            sample_time=self.log.sample_time,
            samples=len(self.log),
            record=self._quantities(),
            longest_step=_STEP,
        )
        return self._seen({name: run[0] for name, run in runs.items()})

    def linearised(
        self,
        values: Mapping[tuple[str, int | None], float],
        local: FloatArray,
        directions: Sequence[tuple[str, int | None]],
    ) -> tuple[FloatArray, FloatArray]:
        """The same, and its derivatives with respect to parameters and then initial states.

        Returns
        -------
        (n_rows, n_channels), (n_rows, n_channels, n_directions + n_local)
        """
        runs = sensitivities(
            self.study,
            dict(values),
            self._begun(local),
            [*directions, *self.local],
            sample_time=self.log.sample_time,
            samples=len(self.log),
            record=self._quantities(),
            longest_step=_STEP,
        )
        seen = self._seen({name: run[0] for name, run in runs.items()})
        return seen, self._seen({name: run[1] for name, run in runs.items()})

    def _begun(self, local: FloatArray) -> Drive:
        if not self.moving:
            return self.drive
        parts = local.reshape(len(INITIAL), -1).tolist()
        velocity, link, link_velocity = (tuple(part) for part in parts)
        return replace(
            self.drive, motor_velocity=velocity, link_angle=link, link_velocity=link_velocity
        )

    def _quantities(self) -> list[Quantity]:
        return list(dict.fromkeys(channel.quantity for channel in self.channels))

    def _seen(self, runs: Mapping[Quantity, FloatArray]) -> FloatArray:
        """Rows of each channel from samples (n_samples, n_joints, ...) of each quantity."""
        kinds = dict.fromkeys((channel.quantity, channel.rate) for channel in self.channels)
        rows = {kind: self.kernels.rows(runs[kind[0]], rate=kind[1]) for kind in kinds}
        parts = [rows[c.quantity, c.rate][:, c.joint - 1] for c in self.channels]
        return np.stack(parts, axis=1)


def replayed(log: Log, study: Study, cutoff_hz: float) -> Replayed:
    """A record ready to be compared with simulated arms.

    Parameters
    ----------
    log : Log
    study : Study
    cutoff_hz : float [Hz]
        Of the low-pass.

    Returns
    -------
    Replayed

    Raises
    ------
    InvalidInput
        The log lacks something that going through it again needs, or is too short.
    """
    missing = _missing(log, study)
    if missing:
        raise InvalidInput(missing, where=log.name, remedy="log every motor's angle and voltage")
    T = log.sample_time
    kernels = low_pass_kernels(cutoff_hz, T)
    reach = len(kernels.smooth)
    if len(log) < 4 * reach:
        raise InvalidInput(
            f"lasts {len(log) * T:.3g} s, which a low-pass of {cutoff_hz:.3g} Hz leaves little of",
            where=log.name,
            remedy=f"record at least {4 * reach * T:.2g} s",
        )
    channels = tuple(_channels(log, study))
    raw = [log.channels[channel.name] for channel in channels]
    rows = [kernels.rows(x, rate=c.rate) for x, c in zip(raw, channels, strict=True)]
    norm = [np.linalg.norm(kernels.slope if c.rate else kernels.smooth) for c in channels]
    steps = [
        _count(study.joints[c.joint - 1]) if c.quantity == "motor_angle" else 0.0 for c in channels
    ]
    own = [noise_deviation(x) for x in raw]
    noise = np.maximum(own, np.array(steps) / np.sqrt(12.0)) * norm
    middle = 0.5 * (reach - 1) * T
    return Replayed(
        log=log,
        study=_countless(study),
        drive=_drive(log, study),
        channels=channels,
        kernels=kernels,
        time=log.time[0] + middle + kernels.step * T * np.arange(len(rows[0])),
        measured=np.column_stack(rows),
        noise=np.asarray(noise),
        moving=_begins_in_motion(log, study),
    )


def low_pass_kernels(cutoff_hz: float, sample_time: float) -> Kernels:
    """A windowed-sinc low-pass and its slope, for rows as far apart as the cut-off allows.

    Parameters
    ----------
    cutoff_hz : float [Hz]
    sample_time : float [s]

    Returns
    -------
    Kernels
        Its number of taps is a multiple of `step`.
    """
    step = max(1, int(1.0 / (_PER_PERIOD * cutoff_hz * sample_time)))
    n_parts = 2 * int(np.ceil(_REACH / (cutoff_hz * sample_time * step)))
    n = n_parts * step
    at = np.arange(n) - 0.5 * (n - 1)
    smooth = np.sinc(2.0 * cutoff_hz * sample_time * at) * np.kaiser(n, _SHAPE)
    smooth /= smooth.sum()
    # an angle's slope is the product with minus the kernel's own; a ramp must give one exactly
    slope = -np.gradient(smooth)
    slope /= np.sum(slope * at) * sample_time
    return Kernels(smooth, slope, step)


def _channels(log: Log, study: Study) -> Iterator[Channel]:
    for i in range(1, study.n_joints + 1):
        yield Channel(f"theta_m{i}", i, "motor_angle", rate=True, shifted=False)
    for i, joint in enumerate(study.joints, start=1):
        if f"a{i}" in log.channels and _has_place(joint):
            yield Channel(f"a{i}", i, "accelerometer", rate=False, shifted=True)
        elif f"theta_l{i}" in log.channels:
            yield Channel(f"theta_l{i}", i, "link_angle", rate=True, shifted=False)
        elif f"gyro{i}" in log.channels:
            yield Channel(f"gyro{i}", i, "gyro", rate=False, shifted=True)


def _has_place(joint: Joint) -> bool:
    return joint.motion == "prismatic" or joint.accelerometer_distance is not None


def _drive(log: Log, study: Study) -> Drive:
    """The recorded voltages or torques, held from sample to sample."""
    voltage = np.column_stack([log.channels[name] for name in _inputs(log, study) if name])
    free = (False,) * study.n_joints
    return replace(replay(study, log), voltage=voltage, servo=free)


def _inputs(log: Log, study: Study) -> list[str | None]:
    """The logged voltage or torque of each joint."""
    return [
        next((name for name in (f"u{i}", f"torque{i}") if name in log.channels), None)
        for i in range(1, study.n_joints + 1)
    ]


def _missing(log: Log, study: Study) -> str | None:
    """What keeps a record from being gone through again, if anything."""
    for i, name in enumerate(_inputs(log, study), start=1):
        if name is None:
            return f"neither u{i} nor torque{i} is there"
        if f"theta_m{i}" not in log.channels:
            return f"theta_m{i} is not there"
    return None


def _begins_in_motion(log: Log, study: Study) -> bool:
    """Whether any motor is further on, at some early instant, than it could get from rest.

    From rest it gets no further than a t^2 / 2, a its largest acceleration in the whole record.
    """
    T = log.sample_time
    span = max(1, round(_TURN / T))
    first = min(max(2, round(_BEGINNING / T)), len(log) // 4)
    t = T * np.arange(first)
    for i, joint in enumerate(study.joints, start=1):
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


def _countless(study: Study) -> Study:
    joints = tuple(replace(joint, encoder_counts=None) for joint in study.joints)
    return replace(study, joints=joints)


def usable(logs: Sequence[Log], study: Study) -> list[Log]:
    """The records of the whole-arm fit: all that excite gears and can be gone through again.

    Parameters
    ----------
    logs : sequence of Log
    study : Study

    Returns
    -------
    list of Log
    """
    uses = ("frequency", "sweep", "tuning")
    return [log for log in logs if log.experiment.use in uses and _missing(log, study) is None]
