"""A record ready to be compared: how it is simulated, and what its channels should read.

The recorded voltages drive the arm, so that no servo has to be known. Angles are compared as
velocities, which do not drift away as open-loop angles do. Every channel passes through one
linear-phase low-pass on both sides and is then thinned to what that leaves of it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from strainwave.domain import BoolArray, FloatArray, Log
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.link_sensors import (
    bandwidth_of,
    constants_of,
    delay_of,
    drift_of,
    is_bandwidth,
    is_of_mount,
    is_sensor_constant,
    mount_of,
    mount_resonance,
    scale_of,
    slope_of_rows,
)
from strainwave.dynamics.mount_resonance import MountResonance
from strainwave.dynamics.mounting import (
    TILT,
    Axis,
    factors,
    is_mounting,
    scale_is_apart,
    slopes,
)
from strainwave.dynamics.record_effects import RecordInputs, inputs_in
from strainwave.dynamics.simulation import Drive, LowPass, Quantity, sensitivities, simulate_arms
from strainwave.identification.whole_arm.low_pass import Kernels, low_pass_kernels
from strainwave.numerics.filters import noise_deviation

INITIAL = ("initial_motor_velocity", "initial_link_angle", "initial_link_velocity")
"""What is unknown of the beginning of a record that begins in motion, joint by joint."""

BEGINNING = 0.02
"""[s] In which it is looked for whether a record begins at standstill, and how fast it moves."""

_SHORTER = 4.0  # times shorter steps, whose error no longer counts
_SHORT_STEPS = 120.0  # nor that of so many in a period of the cut-off, 600 in one of a resonance
_WIDER = 1e-3  # share by which a bandwidth is varied for its slope
Key = tuple[str, int | None]
_SENSORS = ("accelerometer", "gyro", "imu_accelerometer", "imu_gyro")  # that have a bandwidth


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
class Dataset:
    """One record, ready to be compared."""

    log: Log
    arm: Arm  # as it was driven; without counts, to be smooth in the parameters
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
    # (n_rows, n_channels) False where it is no measurement; None: all are
    counted: BoolArray | None = field(default=None, kw_only=True)
    # (n_rows, n_channels) the part of `lacking` that is the step's error where it was last
    # corrected; None: it was not
    step_error: FloatArray | None = field(default=None, kw_only=True)

    @property
    def local(self) -> tuple[tuple[str, int], ...]:
        """Unknown initial states, (name, joint)."""
        if not self.moving:
            return ()
        return tuple((name, i) for name in INITIAL for i in range(1, self.arm.n_joints + 1))

    def start(self) -> FloatArray:
        """A first guess of the unknown initial states, (n_local,): gears unloaded."""
        if not self.moving:
            return np.zeros(0)
        n, T = self.arm.n_joints, self.log.sample_time
        first = max(2, round(BEGINNING / T))
        ratios = np.array([joint.gear_ratio for joint in self.arm.joints])
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
        inputs = self._inputs(values)
        runs = simulate_arms(
            self._arm_at(values),
            [inputs.values],
            inputs.begun(self._begun(local)),
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

        Returns: (n_rows, n_channels) (n_rows, n_channels, n_directions + n_local).
        """
        inputs = self._inputs(values)
        simulated = [key for key in directions if not is_sensor_constant(key)]
        given = inputs.directions(simulated)
        ringing = self._rings(values)
        runs = sensitivities(
            self._arm_at(values),
            inputs.values,
            inputs.begun(self._begun(local)),
            [*given, *self.local],
            sample_time=self.log.sample_time,
            samples=len(self.log),
            record=self.quantities(),
            longest_step=self.longest_step,
            low_pass=None if ringing else self.low_pass(),
        )
        motion, slopes = ({name: run[k] for name, run in runs.items()} for k in (0, 1))
        by_channel = self.seen if ringing else self._by_channel
        seen, tangent = by_channel(motion, values) + self.lacking, by_channel(slopes, values)
        tangent = inputs.by_parameters(tangent, given, simulated)
        scales = self.sensor_scales(values)
        if np.any(scales != 1.0):
            tangent = tangent * scales[:, None]
        if len(simulated) < len(directions):
            own = [k for k, key in enumerate(directions) if is_sensor_constant(key)]
            keys = [directions[k] for k in own]
            by_sensors = self._sensor_tangent(seen, motion, values, local, keys)
            whole = np.empty((*seen.shape, tangent.shape[2] + len(own)))
            whole[..., np.delete(np.arange(whole.shape[2]), own)] = tangent
            whole[..., own] = by_sensors
            tangent = whole
        return seen * scales + self.drifts(values), tangent

    def _inputs(self, values: Mapping[tuple[str, int | None], float]) -> RecordInputs:
        """What the core is given in this record, effects that it does not know among it."""
        return inputs_in(self.arm, dict(values), self.log.name, hanging=not self.moving)

    def _arm_at(self, values: Mapping[tuple[str, int | None], float]) -> Arm:
        """The arm with those bandwidths of sensors that are among the values."""
        found = {k: hz for k, hz in values.items() if is_bandwidth(k) and np.isfinite(hz)}
        return with_bandwidths(self.arm, found) if found else self.arm

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

        s x(t) + r (t - t_m) - y(t + D) has the derivatives x by s, t - t_m by r, and -y', for which
        -s x' stands, by D.

        `seen` (n_rows, n_channels): x, without scales.
        `local` (n_local,).
        `keys`: Sensor constants.

        Returns: (n_rows, n_channels, n_keys).
        """
        motion: Mapping[Quantity, FloatArray] = {}
        if any(is_mounting(key) or is_of_mount(key) for key in keys):
            motion = self.run(values, local, self.quantities())
            motion = motion if self._rings(values) else self._rows(motion)
        return self._sensor_tangent(seen, motion, values, local, keys)

    def _sensor_tangent(
        self,
        seen: FloatArray,
        motion: Mapping[Quantity, FloatArray],
        values: Mapping[tuple[str, int | None], float],
        local: FloatArray,
        keys: Sequence[tuple[str, int | None]],
    ) -> FloatArray:
        """The same, of samples (n_samples, n_joints) of each quantity where a mount rings.

        Of rows (n_rows, n_joints) elsewhere.
        """
        found, scales = np.zeros((*seen.shape, len(keys))), self.sensor_scales(values)
        row_time = self.kernels.step * self.log.sample_time
        mounting = [k for k, key in enumerate(keys) if is_mounting(key)]
        for k, channel in enumerate(self.channels):
            for at, key in enumerate(keys):
                if key == scale_of(channel.scaled, channel.joint):
                    found[:, k, at] = seen[:, k]
                elif key == drift_of(channel.scaled, channel.joint, self.log.name):
                    found[:, k, at] = self.since_middle
                elif key == delay_of(channel.sensor, channel.joint):
                    found[:, k, at] = -scales[k] * slope_of_rows(seen[:, k], row_time)
            for key, slope in self._by_mount(channel, motion, values, keys).items():
                found[:, k, keys.index(key)] = scales[k] * slope
            if channel.axis is not None and mounting:
                each = np.stack([motion[name][:, channel.joint - 1] for name in channel.reads], 1)
                if self._rings(values):
                    each = self.kernels.rows(self._behind(channel, each, values), rate=False)
                by = slopes(channel.axis, self.arm, values, [keys[at] for at in mounting])
                found[:, k, mounting] += scales[k] * each @ by
        bandwidths = [k for k, key in enumerate(keys) if is_bandwidth(key)]
        if bandwidths:
            wider = {keys[k]: (1.0 + _WIDER) * values[keys[k]] for k in bandwidths}
            runs = (self.run(at, local, self.quantities()) for at in ({**values, **wider}, values))
            wide, own = (self.seen(run, values) for run in runs)
            for k, channel in enumerate(self.channels):
                for at in bandwidths:
                    if keys[at] == bandwidth_of(channel.sensor, channel.joint):
                        by = (wide[:, k] - own[:, k]) / (_WIDER * values[keys[at]])
                        found[:, k, at] = scales[k] * by
        return found

    def _by_mount(
        self,
        channel: Channel,
        motion: Mapping[Quantity, FloatArray],
        values: Mapping[tuple[str, int | None], float],
        keys: Sequence[tuple[str, int | None]],
    ) -> dict[Key, FloatArray]:
        """Derivatives of one channel's rows by its mount's constants, without scales."""
        mount, names = self._mount(channel, values), mount_of(channel.sensor, channel.joint)
        if mount is None or names is None or not any(name in keys for name in names):
            return {}
        slopes = mount.slopes(self._reading(channel, motion, values), self.log.sample_time)
        pairs = zip(names, slopes, strict=True)
        return {n: self.kernels.rows(x, rate=channel.rate) for n, x in pairs if n in keys}

    def sensor_constants(self) -> list[tuple[str, int | None]]:
        """What may be wrong with the link sensors among the channels: scales, tilts, drifts..."""
        found = list(constants_of((c.sensor, c.joint) for c in self.channels))
        axes = self._axes()
        for axis in axes:
            own = [one for one in axes if one.joint == axis.joint]
            scale = scale_of(axis.scaled, axis.joint)
            apart = scale_is_apart(axis, own, self.arm)
            if scale is not None and apart and scale not in found:
                found.append(scale)
            if scale in found and not apart:
                found.remove(scale)
            if axis.kind == "tangential":
                found.append((TILT, axis.joint))
        drifts = (drift_of(c.scaled, c.joint, self.log.name) for c in self.channels if c.shifted)
        return [*found, *(key for key in drifts if key is not None)]

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

    def drifts(self, values: Mapping[tuple[str, int | None], float]) -> FloatArray:
        """What drifting sensors add to the channels: (n_rows, n_channels)."""
        keys = (drift_of(c.scaled, c.joint, self.log.name) for c in self.channels)
        rates = [0.0 if key is None else values.get(key, 0.0) for key in keys]
        return np.outer(self.since_middle, rates)

    @property
    def since_middle(self) -> FloatArray:
        """(n_rows,) [s] so that a drift leaves a channel's mean as it is."""
        return np.asarray(self.time - np.mean(self.time))

    def corrected(
        self, values: Mapping[tuple[str, int | None], float], local: FloatArray
    ) -> Dataset:
        """The same, with the error of its integrator's step made good, as it is for an arm.

        For arms nearby it is nearly the same: a search may go on in long steps. Of the sensors'
        noise it knows more, too: what is noise is not in the arm's motion, quick as that may be.
        """
        exact, error = self._step_error(values, local)
        noise = np.minimum(self.noise, self._noise_beside(exact, values))
        lacking = error if self.step_error is None else self.lacking + error - self.step_error
        return replace(self, lacking=lacking, noise=noise, step_error=error)

    def with_step_error(
        self, values: Mapping[tuple[str, int | None], float], local: FloatArray
    ) -> Dataset:
        """The same, where `lacking` has the step's error at an arm already."""
        return replace(self, step_error=self._step_error(values, local)[1])

    def _step_error(
        self, values: Mapping[tuple[str, int | None], float], local: FloatArray
    ) -> tuple[dict[Quantity, FloatArray], FloatArray]:
        """A run in shorter steps, and what its channels have beyond those of the own steps."""
        step = min(self.longest_step / _SHORTER, 1.0 / (_SHORT_STEPS * self.cutoff_hz))
        short = replace(self, longest_step=step)
        exact, own = (one.run(values, local, self.quantities()) for one in (short, self))
        return exact, self.seen(exact, values) - self.seen(own, values)

    def _noise_beside(
        self, runs: Mapping[Quantity, FloatArray], values: Mapping[tuple[str, int | None], float]
    ) -> FloatArray:
        """The sensors' noise behind the low-pass, from what an arm's samples leave of the log's.

        (n_channels,) An upper bound, as the log's samples alone give one: those of a motion that is
        quick beside the sampling are no smooth signal.
        """
        scales = self.sensor_scales(values)
        left = [
            self.log.channels[c.name]
            - scale * self._behind(c, self._reading(c, runs, values), values)
            for c, scale in zip(self.channels, scales, strict=True)
        ]
        return noise_behind(self.channels, left, self.kernels, self.counts)

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
        known = values or {}
        if not self._rings(known):
            return self._by_channel(self._rows(runs), known)
        read = [self._behind(c, self._reading(c, runs, known), known) for c in self.channels]
        pairs = zip(read, self.channels, strict=True)
        return np.stack([self.kernels.rows(x, rate=c.rate) for x, c in pairs], axis=1)

    def ringing(
        self,
        values: Mapping[tuple[str, int | None], float],
        local: FloatArray,
        mounts: Mapping[tuple[Key, Key], Sequence[MountResonance]],
    ) -> FloatArray:
        """What sensors that sit firmly would read more, each on some mounts, one at a time.

        `local` (n_local,).
        `mounts`: Names and joints of the frequency and the damping of a sensor's mount -> mounts.

        Returns: (n_rows, n_channels, n_mounts): Of all sensors, one after the other.
        """
        runs, scales = self.run(values, local, self.quantities()), self.sensor_scales(values)
        tested = [(names, mount) for names, own in mounts.items() for mount in own]
        found = np.zeros((len(self.time), len(self.channels), len(tested)))
        for k, channel in enumerate(self.channels):
            reading = self._reading(channel, runs, values)
            for at, (names, mount) in enumerate(tested):
                if names == mount_of(channel.sensor, channel.joint):
                    more = mount.read(reading, self.log.sample_time) - reading
                    found[:, k, at] = scales[k] * self.kernels.rows(more, rate=channel.rate)
        return found

    def _mount(
        self, channel: Channel, values: Mapping[tuple[str, int | None], float]
    ) -> MountResonance | None:
        return mount_resonance(channel.sensor, channel.joint, values)

    def _rings(self, values: Mapping[tuple[str, int | None], float]) -> bool:
        """Whether any sensor's mount does: what it reads needs samples, not rows."""
        return any(self._mount(channel, values) for channel in self.channels)

    def _behind(
        self,
        channel: Channel,
        samples: FloatArray,
        values: Mapping[tuple[str, int | None], float],
    ) -> FloatArray:
        """What a channel's sensor reads on its mount of samples (n_samples, ...)."""
        mount = self._mount(channel, values)
        return samples if mount is None else mount.read(samples, self.log.sample_time)

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
        counts = factors(channel.axis, self.arm, values)
        parts = zip(counts, channel.reads, strict=True)
        return np.asarray(sum(count * of[name][:, at] for count, name in parts))


def noise_behind(
    channels: Sequence[Channel],
    samples: Sequence[FloatArray],
    kernels: Kernels,
    counts: Sequence[float],
) -> FloatArray:
    """Standard deviation behind the low-pass of the noise at the top of the samples' spectra.

    `samples` (n_samples,): Of each channel.
    `counts`: By which each channel's samples are rounded: the noise is no less than rounding's.

    Returns: (n_channels,).
    """
    own = [noise_deviation(x) for x in samples]
    norm = [np.linalg.norm(kernels.taps(rate=channel.rate)) for channel in channels]
    return np.asarray(np.maximum(own, np.array(counts) / np.sqrt(12.0)) * norm)


def with_bandwidths(arm: Arm, values: Mapping[tuple[str, int | None], float]) -> Arm:
    """An arm, as it is simulated, with some sensors' bandwidths.

    `values`: Bandwidths [Hz] among others.
    """
    joints = []
    for i, joint in enumerate(arm.joints, start=1):
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
    return arm.with_joints(joints)
