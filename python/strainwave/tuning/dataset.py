"""Log -> `Replayed`: a record to simulate, and what of it is compared with a simulated arm.

The recorded voltages drive the arm, so that no servo has to be known. Angles are compared as
velocities, which do not drift away as open-loop angles do. Every channel passes through one
linear-phase low-pass on both sides and is then thinned to what that leaves of it.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from strainwave.closed_loop import has_accelerometer
from strainwave.errors import InvalidInput
from strainwave.filters import noise_deviation
from strainwave.link_sensors import (
    constants_of,
    delay_of,
    is_sensor_constant,
    scale_of,
    slope_of_rows,
)
from strainwave.recorded_input import (
    driving_voltages,
    missing_for_replay,
    missing_motor_signal,
    replay,
)
from strainwave.records import FloatArray, Joint, Log, Study
from strainwave.simulation import Drive, LowPass, Quantity, sensitivities, simulate_arms

INITIAL = ("initial_motor_velocity", "initial_link_angle", "initial_link_velocity")
"""What is unknown of the beginning of a record that begins in motion, joint by joint."""

_STEP = 2.5e-4  # [s] of the integrator: its error stays below a quarter of the sensors' noise
_SHORTER = 4.0  # times shorter steps, whose error no longer counts
_SHORT_STEPS = 120.0  # nor that of so many in a period of the cut-off, 600 in one of a resonance
_PER_PERIOD = 4.0  # rows in a period of the cut-off; more would only repeat each other
_REACH = 1.5  # periods of the cut-off that the low-pass reaches to either side
_BAND = 8  # rows of the low-pass that share a matrix product
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

    def taps(self, *, rate: bool) -> FloatArray:
        """Those of the slope, or of the low-pass itself: (n_taps,)."""
        return self.slope if rate else self.smooth

    def rows(self, samples: FloatArray, *, rate: bool) -> FloatArray:
        """(n_samples, ...) -> (n_rows, ...), without the edges that the low-pass cannot reach.

        Some rows at a time are one product of a banded matrix with the samples that they reach.
        """
        taps, step = self.taps(rate=rate), self.step
        n_rows = (len(samples) - len(taps)) // step + 1
        band = np.zeros((_BAND, (_BAND - 1) * step + len(taps)))
        for k in range(_BAND):
            band[k, k * step : k * step + len(taps)] = taps
        flat = np.ascontiguousarray(samples).reshape(len(samples), -1)
        rows = np.empty((n_rows, flat.shape[1]))
        whole = n_rows // _BAND * _BAND
        if whole:
            reach, (along, across) = band.shape[1], flat.strides
            blocks: FloatArray = np.ndarray(  # views that overlap: each has what its rows reach
                (whole // _BAND, reach, flat.shape[1]),
                buffer=flat,
                strides=(_BAND * step * along, along, across),
            )
            rows[:whole] = np.matmul(band, blocks).reshape(whole, -1)
        rest = flat[whole * step : (n_rows - 1) * step + len(taps)]
        rows[whole:] = band[: n_rows - whole, : len(rest)] @ rest
        return rows.reshape(n_rows, *samples.shape[1:])


@dataclass(frozen=True, slots=True)
class Replayed:
    """One record, ready to be compared."""

    log: Log
    study: Study  # as it was driven; without counts, to be smooth in the parameters
    cutoff_hz: float
    drive: Drive
    channels: tuple[Channel, ...]
    kernels: Kernels
    time: FloatArray  # (n_rows,) [s]
    measured: FloatArray  # (n_rows, n_channels)
    noise: FloatArray  # (n_channels,) standard deviation of the sensors' own noise behind it
    counts: tuple[float, ...]  # of each channel, by which its samples are rounded; zero: unknown
    moving: bool  # whether it begins in motion
    longest_step: float  # [s] of the integrator
    lacking: FloatArray  # (n_rows, n_channels) what the integrator's step takes from the channels

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

    def run(
        self,
        values: Mapping[tuple[str, int | None], float],
        local: FloatArray,
        record: Sequence[Quantity],
    ) -> dict[Quantity, FloatArray]:
        """What an arm does in this experiment: (n_samples, n_joints) of each quantity."""
        runs = simulate_arms(
            self.study,
            [dict(values)],
            self._begun(local),
            sample_time=self.log.sample_time,
            samples=len(self.log),
            record=record,
            longest_step=self.longest_step,
        )
        return {name: run[0] for name, run in runs.items()}

    def linearised(
        self,
        values: Mapping[tuple[str, int | None], float],
        local: FloatArray,
        directions: Sequence[tuple[str, int | None]],
    ) -> tuple[FloatArray, FloatArray]:
        """The channels of an arm, without their unknown constants, and their derivatives.

        Derivatives are those with respect to parameters, sensor constants among them, and then to
        initial states.

        Returns
        -------
        (n_rows, n_channels), (n_rows, n_channels, n_directions + n_local)
        """
        simulated = [key for key in directions if not is_sensor_constant(key)]
        runs = sensitivities(
            self.study,
            dict(values),
            self._begun(local),
            [*simulated, *self.local],
            sample_time=self.log.sample_time,
            samples=len(self.log),
            record=self.quantities(),
            longest_step=self.longest_step,
            low_pass=self.low_pass(),
        )
        seen, tangent = (
            self._by_channel({name: run[k] for name, run in runs.items()}) for k in (0, 1)
        )
        seen = seen + self.lacking
        scales = self.sensor_scales(values)
        if np.any(scales != 1.0):
            tangent = tangent * scales[:, None]
        if len(simulated) < len(directions):
            tangent = self._with_sensors(seen, tangent, values, directions)
        return seen * scales, tangent

    def observed(self, values: Mapping[tuple[str, int | None], float]) -> FloatArray:
        """The measured channels, those of late sensors moved back by their delays.

        (n_rows, n_channels). Before its first and after its last sample a record goes on as it was.
        """
        delays = [
            values.get(key, 0.0) if (key := delay_of(c.quantity, c.joint)) else 0.0
            for c in self.channels
        ]
        if not any(delays):
            return self.measured
        T, found = self.log.sample_time, self.measured.copy()
        for k, (channel, delay) in enumerate(zip(self.channels, delays, strict=True)):
            if not delay:
                continue
            whole = round(delay / T)
            raw = self.log.channels[channel.name]
            moved = raw[np.clip(np.arange(len(raw)) + whole, 0, len(raw) - 1)]
            kernels = low_pass_kernels(self.cutoff_hz, T, delay / T - whole)
            found[:, k] = kernels.rows(moved, rate=channel.rate)
        return found

    def sensor_tangent(
        self,
        seen: FloatArray,
        values: Mapping[tuple[str, int | None], float],
        keys: Sequence[tuple[str, int | None]],
    ) -> FloatArray:
        """Derivatives of simulated less measured channels by sensor constants.

        s x(t) - y(t + D) has the derivatives x by s and -y', for which -s x' stands, by D.

        Parameters
        ----------
        seen : (n_rows, n_channels)
            x, without scales.
        values : dict
        keys : sequence of (name, joint)
            Sensor constants.

        Returns
        -------
        (n_rows, n_channels, n_keys)
        """
        found, scales = np.zeros((*seen.shape, len(keys))), self.sensor_scales(values)
        row_time = self.kernels.step * self.log.sample_time
        for k, channel in enumerate(self.channels):
            for at, key in enumerate(keys):
                if key == scale_of(channel.quantity, channel.joint):
                    found[:, k, at] = seen[:, k]
                elif key == delay_of(channel.quantity, channel.joint):
                    found[:, k, at] = -scales[k] * slope_of_rows(seen[:, k], row_time)
        return found

    def sensor_constants(self) -> list[tuple[str, int | None]]:
        """Delays and scales of the link sensors among the channels."""
        return list(constants_of((c.quantity, c.joint) for c in self.channels))

    def _with_sensors(
        self,
        seen: FloatArray,
        tangent: FloatArray,
        values: Mapping[tuple[str, int | None], float],
        directions: Sequence[tuple[str, int | None]],
    ) -> FloatArray:
        """Simulated derivatives with those by sensor constants at their places among directions."""
        own = [k for k, key in enumerate(directions) if is_sensor_constant(key)]
        whole = np.empty((*seen.shape, tangent.shape[2] + len(own)))
        rest = np.delete(np.arange(whole.shape[2]), own)
        whole[..., rest] = tangent
        whole[..., own] = self.sensor_tangent(seen, values, [directions[k] for k in own])
        return whole

    def sensor_scales(self, values: Mapping[tuple[str, int | None], float]) -> FloatArray:
        """(n_channels,) one where a sensor has none."""
        keys = (scale_of(channel.quantity, channel.joint) for channel in self.channels)
        return np.array([1.0 if key is None else values.get(key, 1.0) for key in keys])

    def corrected(
        self, values: Mapping[tuple[str, int | None], float], local: FloatArray
    ) -> Replayed:
        """The same, with the error of its integrator's step made good, as it is for an arm.

        For arms nearby it is nearly the same: a search may go on in long steps. Of the sensors'
        noise it knows more, too: what is noise is not in the arm's motion, quick as that may be.
        """
        step = min(self.longest_step / _SHORTER, 1.0 / (_SHORT_STEPS * self.cutoff_hz))
        short = replace(self, longest_step=step)
        runs = (one.run(values, local, self.quantities()) for one in (short, self))
        exact, own = runs
        noise = np.minimum(self.noise, self._noise_beside(exact, values))
        return replace(self, lacking=self.seen(exact) - self.seen(own), noise=noise)

    def _noise_beside(
        self, runs: Mapping[Quantity, FloatArray], values: Mapping[tuple[str, int | None], float]
    ) -> FloatArray:
        """The sensors' noise behind the low-pass, from what an arm's samples leave of the log's.

        (n_channels,) An upper bound, as the log's samples alone give one: those of a motion that is
        quick beside the sampling are no smooth signal.
        """
        scales = self.sensor_scales(values)
        left = [
            self.log.channels[c.name] - scale * runs[c.quantity][:, c.joint - 1]
            for c, scale in zip(self.channels, scales, strict=True)
        ]
        return _noise(self.channels, left, self.kernels, self.counts)

    def _begun(self, local: FloatArray) -> Drive:
        if not self.moving:
            return self.drive
        parts = local.reshape(len(INITIAL), -1).tolist()
        velocity, link, link_velocity = (tuple(part) for part in parts)
        return replace(
            self.drive, motor_velocity=velocity, link_angle=link, link_velocity=link_velocity
        )

    def quantities(self) -> list[Quantity]:
        """What has to be simulated for the channels."""
        return list(dict.fromkeys(channel.quantity for channel in self.channels))

    def low_pass(self) -> LowPass:
        """What each quantity's samples pass through."""
        taps = {c.quantity: self.kernels.taps(rate=c.rate) for c in self.channels}
        return LowPass(taps, self.kernels.step)

    def seen(self, runs: Mapping[Quantity, FloatArray]) -> FloatArray:
        """Rows of each channel from samples (n_samples, n_joints, ...) of each quantity."""
        kinds = dict.fromkeys((channel.quantity, channel.rate) for channel in self.channels)
        return self._by_channel({name: self.kernels.rows(runs[name], rate=r) for name, r in kinds})

    def _by_channel(self, rows: Mapping[Quantity, FloatArray]) -> FloatArray:
        """(n_rows, n_channels, ...) from rows (n_rows, n_joints, ...) of each quantity."""
        return np.stack([rows[c.quantity][:, c.joint - 1] for c in self.channels], axis=1)


def replayed(log: Log, study: Study, cutoff_hz: float, *, closed_loop: bool = False) -> Replayed:
    """A record ready to be compared with simulated arms.

    Parameters
    ----------
    log : Log
    study : Study
    cutoff_hz : float [Hz]
        Of the low-pass.
    closed_loop : bool
        Servoed joints follow their references under the study's servo, where the log has enough
        for that; otherwise the recorded voltages drive them.

    Returns
    -------
    Replayed

    Raises
    ------
    InvalidInput
        The log lacks something that going through it again needs, or is too short.
    """
    missing = missing_motor_signal(study, log)
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
    counts = tuple(
        _count(study.joints[c.joint - 1]) if c.quantity == "motor_angle" else 0.0 for c in channels
    )
    middle = 0.5 * (reach - 1) * T
    return Replayed(
        log=log,
        study=_as_driven(log, study),
        cutoff_hz=cutoff_hz,
        drive=_drive(log, study, closed_loop=closed_loop),
        channels=channels,
        kernels=kernels,
        time=log.time[0] + middle + kernels.step * T * np.arange(len(rows[0])),
        measured=np.column_stack(rows),
        noise=_noise(channels, raw, kernels, counts),
        counts=counts,
        moving=_begins_in_motion(log, study),
        longest_step=_STEP,
        lacking=np.zeros((len(rows[0]), len(channels))),
    )


def coarser(record: Replayed, longest_step: float) -> Replayed:
    """The same record in longer steps, for a search that is still far off.

    Parameters
    ----------
    record : Replayed
    longest_step : float [s]
        Of the integrator; samples that lie closer are thinned, and voltages become their means.

    Returns
    -------
    Replayed
        Its rows lie as far apart, about.
    """
    log = record.log
    every = max(1, int(longest_step / log.sample_time))
    n = len(log) // every
    channels = {
        name: x[: n * every].reshape(n, every).mean(axis=1)
        if name.startswith(("u", "torque"))
        else x[: n * every : every]
        for name, x in log.channels.items()
    }
    thinned = replace(
        log,
        sample_time=every * log.sample_time,
        time=log.time[: n * every : every],
        channels=channels,
    )
    coarse = replayed(thinned, record.study, record.cutoff_hz, closed_loop=any(record.drive.servo))
    step = max(longest_step, _STEP)
    return replace(coarse, noise=record.noise, moving=record.moving, longest_step=step)


def low_pass_kernels(cutoff_hz: float, sample_time: float, ahead: float = 0.0) -> Kernels:
    """A windowed-sinc low-pass and its slope, for rows as far apart as the cut-off allows.

    Parameters
    ----------
    cutoff_hz : float [Hz]
    sample_time : float [s]
    ahead : float [samples], between -1 and 1
        By which the rows look ahead of their time.

    Returns
    -------
    Kernels
        Its number of taps is a multiple of `step`.
    """
    step = max(1, int(1.0 / (_PER_PERIOD * cutoff_hz * sample_time)))
    n_parts = 2 * int(np.ceil(_REACH / (cutoff_hz * sample_time * step)))
    n = n_parts * step
    half = 0.5 * (n - 1)
    at = np.arange(n) - half - ahead
    window = np.i0(_SHAPE * np.sqrt(np.clip(1.0 - (at / half) ** 2, 0.0, None)))
    smooth = np.sinc(2.0 * cutoff_hz * sample_time * at) * np.where(np.abs(at) > half, 0.0, window)
    smooth /= smooth.sum()
    # an angle's slope is the product with minus the kernel's own; a ramp must give one exactly
    slope = -np.gradient(smooth)
    slope /= np.sum(slope * at) * sample_time
    return Kernels(smooth, slope, step)


def _noise(
    channels: Sequence[Channel],
    samples: Sequence[FloatArray],
    kernels: Kernels,
    counts: Sequence[float],
) -> FloatArray:
    """Behind the low-pass, of noise at the top of the samples' spectra, no less than rounding's."""
    own = [noise_deviation(x) for x in samples]
    norm = [np.linalg.norm(kernels.taps(rate=channel.rate)) for channel in channels]
    return np.asarray(np.maximum(own, np.array(counts) / np.sqrt(12.0)) * norm)


def _channels(log: Log, study: Study) -> Iterator[Channel]:
    for i in range(1, study.n_joints + 1):
        yield Channel(f"theta_m{i}", i, "motor_angle", rate=True, shifted=False)
    for i in range(1, study.n_joints + 1):
        if has_accelerometer(log, study, i):
            yield Channel(f"a{i}", i, "accelerometer", rate=False, shifted=True)
        elif f"theta_l{i}" in log.channels:
            yield Channel(f"theta_l{i}", i, "link_angle", rate=True, shifted=False)
        elif f"gyro{i}" in log.channels:
            yield Channel(f"gyro{i}", i, "gyro", rate=False, shifted=True)


def _drive(log: Log, study: Study, *, closed_loop: bool) -> Drive:
    """The recorded voltages, held from sample to sample, in place of servos and references."""
    if closed_loop and missing_for_replay(study, log) is None:
        return replay(study, log)
    free = (False,) * study.n_joints
    return replace(replay(study, log), voltage=driving_voltages(study, log), servo=free)


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


def _as_driven(log: Log, study: Study) -> Study:
    """Encoders without counts; where the torque itself was logged, no current loop before it."""
    joints = tuple(
        replace(
            joint,
            encoder_counts=None,
            current_loop_hz=joint.current_loop_hz if f"u{i}" in log.channels else None,
        )
        for i, joint in enumerate(study.joints, start=1)
    )
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
    return [
        log for log in logs if log.experiment.use in uses and not missing_motor_signal(study, log)
    ]
