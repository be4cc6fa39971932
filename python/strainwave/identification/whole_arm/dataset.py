"""Log -> `Dataset`: a record to simulate, and what of it is compared with a simulated arm.

The recorded voltages drive the arm, so that no servo has to be known. Angles are compared as
velocities, which do not drift away as open-loop angles do. Every channel passes through one
linear-phase low-pass on both sides and is then thinned to what that leaves of it.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from strainwave.domain import FloatArray, Imu, Joint, Log, Study
from strainwave.dynamics.link_sensors import (
    bandwidth_of,
    constants_of,
    delay_of,
    is_bandwidth,
    is_sensor_constant,
    scale_of,
    slope_of_rows,
)
from strainwave.dynamics.mounting import (
    TILT,
    Axis,
    axes_of,
    factors,
    is_mounting,
    scale_is_apart,
    slopes,
)
from strainwave.dynamics.simulation import Drive, LowPass, Quantity, sensitivities, simulate_arms
from strainwave.errors import InvalidInput
from strainwave.identification.closed_loop import has_accelerometer
from strainwave.numerics.filters import noise_deviation
from strainwave.signals.recorded_input import (
    driven_by_voltage,
    missing_for_replay,
    missing_motor_signal,
    replay,
)

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
_WIDER = 1e-3  # share by which a bandwidth is varied for its slope
_SENSORS = ("accelerometer", "gyro", "imu_accelerometer", "imu_gyro")  # that have a bandwidth
_TURN = 0.002  # [s] over which accelerations are seen


@dataclass(frozen=True, slots=True)
class Channel:
    """One compared signal of one joint."""

    name: str
    joint: int  # from 1
    quantity: Quantity
    rate: bool  # whether it is an angle, compared as a velocity
    shifted: bool  # whether an unknown constant is added to it
    axis: Axis | None = None  # of a sensor that may sit anywhere

    @property
    def sensor(self) -> str:
        """By what its sensor's constants are named."""
        return self.quantity if self.axis is None else self.axis.sensor

    @property
    def scaled(self) -> str:
        """By what its scale is named."""
        return self.quantity if self.axis is None else self.axis.scaled

    @property
    def reads(self) -> tuple[Quantity, ...]:
        """What has to be simulated for it."""
        return (self.quantity,) if self.axis is None else self.axis.quantities


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
class Dataset:
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
        return tuple((name, i) for name in INITIAL for i in range(1, self.study.arm.n_joints + 1))

    def start(self) -> FloatArray:
        """A first guess of the unknown initial states, (n_local,): gears untwisted."""
        if not self.moving:
            return np.zeros(0)
        n, T = self.study.arm.n_joints, self.log.sample_time
        first = max(2, round(_BEGINNING / T))
        ratios = np.array([joint.gear_ratio for joint in self.study.arm.joints])
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
            self._study_at(values),
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
            self._study_at(values),
            dict(values),
            self._begun(local),
            [*simulated, *self.local],
            sample_time=self.log.sample_time,
            samples=len(self.log),
            record=self.quantities(),
            longest_step=self.longest_step,
            low_pass=self.low_pass(),
        )
        rows = {name: run[0] for name, run in runs.items()}
        seen = self._by_channel(rows, values) + self.lacking
        tangent = self._by_channel({name: run[1] for name, run in runs.items()}, values)
        scales = self.sensor_scales(values)
        if np.any(scales != 1.0):
            tangent = tangent * scales[:, None]
        if len(simulated) < len(directions):
            own = [k for k, key in enumerate(directions) if is_sensor_constant(key)]
            keys = [directions[k] for k in own]
            by_sensors = self._sensor_tangent(seen, rows, values, local, keys)
            whole = np.empty((*seen.shape, tangent.shape[2] + len(own)))
            whole[..., np.delete(np.arange(whole.shape[2]), own)] = tangent
            whole[..., own] = by_sensors
            tangent = whole
        return seen * scales, tangent

    def _study_at(self, values: Mapping[tuple[str, int | None], float]) -> Study:
        """The study with those bandwidths of sensors that are among the values."""
        found = {k: hz for k, hz in values.items() if is_bandwidth(k) and np.isfinite(hz)}
        return with_bandwidths(self.study, found) if found else self.study

    def observed(self, values: Mapping[tuple[str, int | None], float]) -> FloatArray:
        """The measured channels, those of late sensors moved back by their delays.

        (n_rows, n_channels). Before its first and after its last sample a record goes on as it was.
        """
        delays = [
            values.get(key, 0.0) if (key := delay_of(c.sensor, c.joint)) else 0.0
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
        local: FloatArray,
        keys: Sequence[tuple[str, int | None]],
    ) -> FloatArray:
        """Derivatives of simulated less measured channels by sensor constants.

        s x(t) - y(t + D) has the derivatives x by s and -y', for which -s x' stands, by D.

        Parameters
        ----------
        seen : (n_rows, n_channels)
            x, without scales.
        values : dict
        local : (n_local,)
        keys : sequence of (name, joint)
            Sensor constants.

        Returns
        -------
        (n_rows, n_channels, n_keys)
        """
        rows: Mapping[Quantity, FloatArray] = {}
        if any(map(is_mounting, keys)):
            rows = self._rows(self.run(values, local, self.quantities()))
        return self._sensor_tangent(seen, rows, values, local, keys)

    def _sensor_tangent(
        self,
        seen: FloatArray,
        rows: Mapping[Quantity, FloatArray],
        values: Mapping[tuple[str, int | None], float],
        local: FloatArray,
        keys: Sequence[tuple[str, int | None]],
    ) -> FloatArray:
        """The same, of rows (n_rows, n_joints) of each quantity."""
        found, scales = np.zeros((*seen.shape, len(keys))), self.sensor_scales(values)
        row_time = self.kernels.step * self.log.sample_time
        mounting = [k for k, key in enumerate(keys) if is_mounting(key)]
        for k, channel in enumerate(self.channels):
            for at, key in enumerate(keys):
                if key == scale_of(channel.scaled, channel.joint):
                    found[:, k, at] = seen[:, k]
                elif key == delay_of(channel.sensor, channel.joint):
                    found[:, k, at] = -scales[k] * slope_of_rows(seen[:, k], row_time)
            if channel.axis is not None and mounting:
                each = np.stack([rows[name][:, channel.joint - 1] for name in channel.reads], 1)
                by = slopes(channel.axis, self.study, values, [keys[at] for at in mounting])
                found[:, k, mounting] += scales[k] * each @ by
        bandwidths = [k for k, key in enumerate(keys) if is_bandwidth(key)]
        if bandwidths:
            wider = {keys[k]: (1.0 + _WIDER) * values[keys[k]] for k in bandwidths}
            runs = (self.run(at, local, self.quantities()) for at in ({**values, **wider}, values))
            wide, own = (self._by_channel(self._rows(run), values) for run in runs)
            for k, channel in enumerate(self.channels):
                for at in bandwidths:
                    if keys[at] == bandwidth_of(channel.sensor, channel.joint):
                        by = (wide[:, k] - own[:, k]) / (_WIDER * values[keys[at]])
                        found[:, k, at] = scales[k] * by
        return found

    def sensor_constants(self) -> list[tuple[str, int | None]]:
        """What may be wrong with the link sensors among the channels: delays, scales, tilts."""
        found = list(constants_of((c.sensor, c.joint) for c in self.channels))
        axes = self._axes()
        for axis in axes:
            own = [one for one in axes if one.joint == axis.joint]
            scale = scale_of(axis.scaled, axis.joint)
            apart = scale_is_apart(axis, own, self.study)
            if scale is not None and apart and scale not in found:
                found.append(scale)
            if scale in found and not apart:
                found.remove(scale)
            if axis.kind == "tangential":
                found.append((TILT, axis.joint))
        return found

    def tables(
        self, values: Mapping[tuple[str, int | None], float], axes: Sequence[Axis]
    ) -> list[FloatArray]:
        """Of each axis, rows of what it reads a combination of and, last, of what it reads.

        (n_rows, n_quantities + 1) without means, from an arm that begins at its first guess; no
        rows of axes that the record lacks.
        """
        rows = self._rows(self.run(values, self.start(), self.quantities()))
        at = {channel.axis: k for k, channel in enumerate(self.channels)}
        found = []
        for axis in axes:
            parts = [rows[name][:, axis.joint - 1] for name in axis.quantities if name in rows]
            whole = np.zeros((0, len(axis.quantities) + 1))
            if axis in at:
                whole = np.column_stack([*parts, self.measured[:, at[axis]]])
                whole = whole - whole.mean(axis=0)
            found.append(whole)
        return found

    def _axes(self) -> list[Axis]:
        return [channel.axis for channel in self.channels if channel.axis is not None]

    def sensor_scales(self, values: Mapping[tuple[str, int | None], float]) -> FloatArray:
        """(n_channels,) one where a sensor has none."""
        keys = (scale_of(channel.scaled, channel.joint) for channel in self.channels)
        return np.array([1.0 if key is None else values.get(key, 1.0) for key in keys])

    def corrected(
        self, values: Mapping[tuple[str, int | None], float], local: FloatArray
    ) -> Dataset:
        """The same, with the error of its integrator's step made good, as it is for an arm.

        For arms nearby it is nearly the same: a search may go on in long steps. Of the sensors'
        noise it knows more, too: what is noise is not in the arm's motion, quick as that may be.
        """
        step = min(self.longest_step / _SHORTER, 1.0 / (_SHORT_STEPS * self.cutoff_hz))
        short = replace(self, longest_step=step)
        runs = (one.run(values, local, self.quantities()) for one in (short, self))
        exact, own = runs
        noise = np.minimum(self.noise, self._noise_beside(exact, values))
        lacking = self.seen(exact, values) - self.seen(own, values)
        return replace(self, lacking=lacking, noise=noise)

    def _noise_beside(
        self, runs: Mapping[Quantity, FloatArray], values: Mapping[tuple[str, int | None], float]
    ) -> FloatArray:
        """The sensors' noise behind the low-pass, from what an arm's samples leave of the log's.

        (n_channels,) An upper bound, as the log's samples alone give one: those of a motion that is
        quick beside the sampling are no smooth signal.
        """
        scales = self.sensor_scales(values)
        left = [
            self.log.channels[c.name] - scale * self._reading(c, runs, values)
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
        return list(dict.fromkeys(name for channel in self.channels for name in channel.reads))

    def low_pass(self) -> LowPass:
        """What each quantity's samples pass through."""
        taps = {name: self.kernels.taps(rate=c.rate) for c in self.channels for name in c.reads}
        return LowPass(taps, self.kernels.step)

    def seen(
        self,
        runs: Mapping[Quantity, FloatArray],
        values: Mapping[tuple[str, int | None], float] | None = None,
    ) -> FloatArray:
        """Rows of each channel from samples (n_samples, n_joints, ...) of each quantity.

        Of sensors whose place is unknown the values have the mounting.
        """
        return self._by_channel(self._rows(runs), values or {})

    def _rows(self, runs: Mapping[Quantity, FloatArray]) -> dict[Quantity, FloatArray]:
        """Rows (n_rows, n_joints, ...) of each quantity from its samples."""
        kinds = dict.fromkeys((name, c.rate) for c in self.channels for name in c.reads)
        return {name: self.kernels.rows(runs[name], rate=rate) for name, rate in kinds}

    def _by_channel(
        self,
        rows: Mapping[Quantity, FloatArray],
        values: Mapping[tuple[str, int | None], float],
    ) -> FloatArray:
        """(n_rows, n_channels, ...) from rows (n_rows, n_joints, ...) of each quantity."""
        return np.stack([self._reading(c, rows, values) for c in self.channels], axis=1)

    def _reading(
        self,
        channel: Channel,
        of: Mapping[Quantity, FloatArray],
        values: Mapping[tuple[str, int | None], float],
    ) -> FloatArray:
        """(n, ...) of one channel from (n, n_joints, ...) of each quantity."""
        at = channel.joint - 1
        if channel.axis is None:
            return of[channel.quantity][:, at]
        counts = factors(channel.axis, self.study, values)
        parts = zip(counts, channel.reads, strict=True)
        return np.asarray(sum(count * of[name][:, at] for count, name in parts))


def dataset_of(log: Log, study: Study, cutoff_hz: float, *, closed_loop: bool = False) -> Dataset:
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
    Dataset

    Raises
    ------
    InvalidInput
        The log lacks something that going through it again needs, or is too short.
    """
    missing = missing_motor_signal(study, log)
    if missing:
        raise InvalidInput(missing, where=log.name, remedy="log every motor's angle and voltage")
    log = _with_link_angles(log, study)
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
        _count(study.arm.joints[c.joint - 1]) if c.quantity == "motor_angle" else 0.0
        for c in channels
    )
    middle = 0.5 * (reach - 1) * T
    return Dataset(
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


def coarsened(record: Dataset, longest_step: float) -> Dataset:
    """The same record in longer steps, for a search that is still far off.

    Parameters
    ----------
    record : Dataset
    longest_step : float [s]
        Of the integrator; samples that lie closer are thinned, and voltages become their means.

    Returns
    -------
    Dataset
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
    coarse = dataset_of(
        thinned, record.study, record.cutoff_hz, closed_loop=any(record.drive.servo)
    )
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


def _with_link_angles(log: Log, study: Study) -> Log:
    """With theta_l = n theta_m + deflection of joints whose torsion is what was measured."""
    channels = dict(log.channels)
    for i, joint in enumerate(study.arm.joints, start=1):
        if f"deflection{i}" in channels and f"theta_l{i}" not in channels:
            motor = channels[f"theta_m{i}"]
            channels[f"theta_l{i}"] = joint.gear_ratio * motor + channels[f"deflection{i}"]
    return replace(log, channels=channels)


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
    for i in range(1, study.arm.n_joints + 1):
        yield Channel(f"theta_m{i}", i, "motor_angle", rate=True, shifted=False)
    for i in range(1, study.arm.n_joints + 1):
        if has_accelerometer(log, study, i):
            yield Channel(f"a{i}", i, "accelerometer", rate=False, shifted=True)
        elif f"theta_l{i}" in log.channels:
            yield Channel(f"theta_l{i}", i, "link_angle", rate=True, shifted=False)
        elif f"gyro{i}" in log.channels:
            yield Channel(f"gyro{i}", i, "gyro", rate=False, shifted=True)
        for axis in axes_of(log.channels, study, i):
            yield Channel(axis.channel, i, axis.quantities[0], False, True, axis)


def _drive(log: Log, study: Study, *, closed_loop: bool) -> Drive:
    """The recorded voltages, held from sample to sample, in place of servos and references."""
    if closed_loop and missing_for_replay(study, log) is None:
        return replay(study, log)
    return driven_by_voltage(study, log)[1]


def _begins_in_motion(log: Log, study: Study) -> bool:
    """Whether any motor is further on, at some early instant, than it could get from rest.

    From rest it gets no further than a t^2 / 2, a its largest acceleration in the whole record.
    """
    T = log.sample_time
    span = max(1, round(_TURN / T))
    first = min(max(2, round(_BEGINNING / T)), len(log) // 4)
    t = T * np.arange(first)
    for i, joint in enumerate(study.arm.joints, start=1):
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
    """Encoders without counts; an accelerometer of unknown place is simulated as an IMU."""
    joints = tuple(
        replace(joint, encoder_counts=None, imu=_imu(axes_of(log.channels, study, i), joint))
        for i, joint in enumerate(study.arm.joints, start=1)
    )
    return replace(study, arm=replace(study.arm, joints=joints))


def _imu(axes: Sequence[Axis], joint: Joint) -> Imu | None:
    """What the axes that may sit anywhere need to be simulated."""
    if not axes:
        return None
    if axes[0].kind == "tangential":
        return Imu(accelerometer_hz=joint.accelerometer_hz)
    return joint.imu or Imu()


def with_bandwidths(study: Study, values: Mapping[tuple[str, int | None], float]) -> Study:
    """A study, as it is simulated, with some sensors' bandwidths.

    Parameters
    ----------
    study : Study
    values : dict
        Bandwidths [Hz] among others.

    Returns
    -------
    Study
    """
    joints = []
    for i, joint in enumerate(study.arm.joints, start=1):
        own = {f"{name}_hz": values.get((f"{name}_bandwidth", i)) for name in _SENSORS}
        given = {key: hz for key, hz in own.items() if hz is not None}
        tangential = joint.accelerometer_distance is None
        imu = joint.imu
        if imu is not None:
            inner = {k[len("imu_") :]: hz for k, hz in given.items() if k.startswith("imu_")}
            if tangential and "accelerometer_hz" in given:
                inner.setdefault("accelerometer_hz", given["accelerometer_hz"])
            imu = replace(imu, **inner)  # type: ignore[arg-type]
        outer = {k: hz for k, hz in given.items() if not k.startswith("imu_")}
        joints.append(replace(joint, imu=imu, **outer))  # type: ignore[arg-type]
    return replace(study, arm=replace(study.arm, joints=tuple(joints)))


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
