"""A record prepared for the comparison of measured and simulated channels.

The recorded voltages drive the simulated arm, so that the servo may be unknown. Angles are compared
as velocities, because open-loop angles drift. The same linear-phase low-pass filters the measured
and the simulated channels, which are then decimated to rows.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from strainwave.domain import BoolArray, FloatArray, Log
from strainwave.domain.arm.link_sensors import (
    ConstantKind,
    SensorAxis,
    constant_of,
    is_kind,
    with_bandwidths,
)
from strainwave.domain.arm.link_sensors.link_space import LINK_SIGNALS, Quantity
from strainwave.domain.keys import Key, Values
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.link_sensors import differentiate_rows, mount_resonance
from strainwave.dynamics.simulation import (
    Drive,
    LowPass,
    PlannedRun,
    RecordInputs,
    channel_sensitivities,
    plan_run,
    record_inputs,
    simulate_runs,
)
from strainwave.numerics.filters import noise_std
from strainwave.signals.prepared_record import prepare_record
from strainwave.signals.recorded_input import hold_torques

Motion = Mapping[Quantity, FloatArray]
"""Simulated samples (n_samples, n_joints) of each quantity."""

Variant = tuple[Values, Sequence[Key]]
"""Values, and sizes of effects that are zero."""

INITIAL_STATES = ("initial_motor_velocity", "initial_link_angle", "initial_link_velocity")
"""Unknown initial states of a record that begins in motion, one of each per joint."""

INITIAL_INTERVAL = 0.02
"""Time [s] from the start in which initial velocity and standstill are estimated."""

_REFINEMENT_FACTOR = 2.0  # factor of shorter steps, with a sixteenth of the step error
# steps per period of the cut-off (600 per resonance period): negligible error
_REFINED_STEPS_PER_PERIOD = 120.0
# Shares of the stable step, in which the integrator damps the fastest mode by 3e-5 and 2e-3. With
# the latter, derivatives with respect to the damping of a gear err by a third at most.
_ACCURATE_SHARE, _RESOLVING_SHARE = 0.2, 0.4
_RELATIVE_BANDWIDTH_STEP = 1e-3  # relative change of a bandwidth for its numerical derivative
# of a torque hold for its numerical derivative; a step of one shifts reversals by half a sample
_HOLD_STEP = 0.01
_POSTURES = 4  # of a record, for which the stable time step is computed
_MAX_SHORTENING = 10.0  # of the time step; values with even faster modes cannot be simulated

_ROWS_PER_PERIOD = 4.0  # rows per period of the cut-off; further rows would be redundant
_HALF_LENGTH_PERIODS = 1.5  # half-length of the filter, in periods of the cut-off
_ROWS_PER_PRODUCT = 8  # output rows per matrix product
_KAISER_BETA = 5.0  # beta of the Kaiser window: 50 dB stop-band attenuation

_MIN_NOISE = 1e-12  # [SI] of an ideal sensor, far below the resolution of any real one


@dataclass(frozen=True, slots=True)
class Kernels:
    """Taps of a low-pass and of its derivative, with decimation."""

    smooth: FloatArray  # (n_taps,)
    slope: FloatArray  # (n_taps,) [1/s]
    step: int  # samples per row

    def taps(self, *, slope: bool) -> FloatArray:
        """Taps (n_taps,) of the derivative if `slope` is true, otherwise of the low-pass."""
        return self.slope if slope else self.smooth

    def rows(self, samples: FloatArray, *, slope: bool) -> FloatArray:
        """Filter and decimate samples (n_samples, ...) to rows (n_rows, ...), without the edges.

        One product of a banded matrix with overlapping blocks of samples computes several rows.
        """
        taps, step = self.taps(slope=slope), self.step
        n_rows = (len(samples) - len(taps)) // step + 1
        band = np.zeros((_ROWS_PER_PRODUCT, (_ROWS_PER_PRODUCT - 1) * step + len(taps)))
        for k in range(_ROWS_PER_PRODUCT):
            band[k, k * step : k * step + len(taps)] = taps
        flat = np.ascontiguousarray(samples).reshape(len(samples), -1)
        rows = np.empty((n_rows, flat.shape[1]))
        n_blocked = n_rows // _ROWS_PER_PRODUCT * _ROWS_PER_PRODUCT
        if n_blocked:
            n_reached, (sample_stride, column_stride) = band.shape[1], flat.strides
            blocks: FloatArray = np.ndarray(  # overlapping views of the samples
                (n_blocked // _ROWS_PER_PRODUCT, n_reached, flat.shape[1]),
                buffer=flat,
                strides=(_ROWS_PER_PRODUCT * step * sample_stride, sample_stride, column_stride),
            )
            rows[:n_blocked] = np.matmul(band, blocks).reshape(n_blocked, -1)
        remaining = flat[n_blocked * step : (n_rows - 1) * step + len(taps)]
        rows[n_blocked:] = band[: n_rows - n_blocked, : len(remaining)] @ remaining
        return rows.reshape(n_rows, *samples.shape[1:])


def low_pass_kernels(cutoff_hz: float, sample_time: float, ahead: float = 0.0) -> Kernels:
    """Design a windowed-sinc low-pass and its derivative with a Kaiser window.

    `sample_time` is in s; `ahead` is a fractional advance of the rows in samples. The cut-off sets
    the decimation `step`, and the number of taps is a multiple of it.
    """
    step = max(1, int(1.0 / (_ROWS_PER_PERIOD * cutoff_hz * sample_time)))
    n_steps = 2 * int(np.ceil(_HALF_LENGTH_PERIODS / (cutoff_hz * sample_time * step)))
    n_taps = n_steps * step
    half = 0.5 * (n_taps - 1)
    offset = np.arange(n_taps) - half - ahead
    window = np.i0(_KAISER_BETA * np.sqrt(np.clip(1.0 - (offset / half) ** 2, 0.0, None)))
    # a tap that the advance moves beyond the window keeps its weight, so that rows are continuous
    smooth = np.sinc(2.0 * cutoff_hz * sample_time * offset) * window
    smooth /= smooth.sum()
    # derivative by convolution with -d(taps)/dt; a constant gives exactly zero, a unit ramp one
    slope = -np.gradient(smooth)
    slope -= np.sum(slope) * smooth
    slope /= np.sum(slope * offset) * sample_time
    return Kernels(smooth, slope, step)


@dataclass(frozen=True, slots=True, weakref_slot=True)
class Dataset:
    """A record with its simulation inputs and its filtered measured channels."""

    log: Log
    arm: Arm  # without encoder quantisation, so that the outputs are smooth in the parameters
    cutoff_hz: float
    drive: Drive
    channels: tuple[SensorAxis, ...]
    kernels: Kernels
    time: FloatArray  # (n_rows,) [s]
    measured: FloatArray  # (n_rows, n_channels)
    noise: FloatArray  # (n_channels,) standard deviation of the filtered sensor noise
    counts: tuple[float, ...]  # resolution of each channel; zero if unknown
    begins_in_motion: bool  # whether it begins in motion
    max_time_step: float  # [s] of the integrator
    # (n_rows, n_channels) correction of the integrator step error
    step_error_correction: FloatArray
    # (n_ticks, n_joints) change of the voltage for a torque hold of one
    hold_change: FloatArray = field(kw_only=True)
    # (n_rows, n_channels) False where a row contains masked samples; None if none does
    is_counted: BoolArray | None = field(default=None, kw_only=True)
    # (n_rows, n_channels) step error at the last correction; None if there was none
    step_error: FloatArray | None = field(default=None, kw_only=True)

    @property
    def initial_states(self) -> tuple[tuple[str, int], ...]:
        """Unknown initial states, (name, joint)."""
        if not self.begins_in_motion:
            return ()
        return tuple((name, i) for name in INITIAL_STATES for i in range(1, self.arm.n_joints + 1))

    @property
    def biased(self) -> tuple[int, ...]:
        """Channels whose sensor has a bias."""
        return tuple(k for k, channel in enumerate(self.channels) if channel.sensor.has_bias)

    @property
    def channel_names(self) -> tuple[str, ...]:
        """Names of the channels in results; angles are compared as velocities."""
        return tuple(channel.channel.replace("theta", "omega") for channel in self.channels)

    def start(self) -> FloatArray:
        """Starting values (n_initial,) of the initial states, with unloaded gears."""
        if not self.begins_in_motion:
            return np.zeros(0)
        T = self.log.sample_time
        n_first = max(2, round(INITIAL_INTERVAL / T))
        angle = prepare_record(self.log, self.arm).motor_angle[:n_first]
        slope, origin = np.polyfit(T * np.arange(n_first), angle, 1)
        return np.concatenate([slope, self.arm.links_of(origin), self.arm.links_of(slope)])

    def run(
        self, values: Mapping[Key, float], initial: FloatArray, record: Sequence[Quantity]
    ) -> Motion:
        """Simulate the record: arrays (n_samples, n_joints), one per quantity in `record`."""
        return simulate_runs([self._plan(values, initial, record)])[0]

    def plan(self, values: Mapping[Key, float], initial: FloatArray) -> PlannedRun:
        """Prepare the simulation of the quantities that `linearise` reads, for `simulate_runs`."""
        return self._plan(values, initial, list(self._taps), self._sums(values))

    def _plan(
        self,
        values: Mapping[Key, float],
        initial: FloatArray,
        record: Sequence[Quantity],
        sums: Mapping[Quantity, FloatArray] | None = None,
    ) -> PlannedRun:
        inputs = self._inputs(values)
        return plan_run(
            self._arm_at(values),
            inputs.values,
            inputs.shift_start(self._drive_at(values, initial)),
            sample_time=self.log.sample_time,
            samples=len(self.log),
            record=record,
            max_time_step=self._time_step(inputs.values),
            sums=sums,
        )

    @property
    def _taps(self) -> dict[Quantity, FloatArray]:
        """Taps of the low-pass of each quantity that the channels read, signals of links summed."""
        return {c.summed_quantity: self.kernels.taps(slope=c.reads_angle) for c in self.channels}

    def linearise(
        self,
        values: Mapping[Key, float],
        initial: FloatArray,
        directions: Sequence[Key],
        simulated: Motion | None = None,
        *,
        slope: FloatArray | None = None,
        variants: Sequence[Variant] = (),
    ) -> tuple[FloatArray, FloatArray]:
        """Simulated channels without biases (n_rows, n_channels), and their derivatives.

        The derivatives (n_rows, n_channels, n_initial + n_directions + n_of_variants) are those
        with respect to the initial states, then to the `directions`, which are parameters and
        sensor constants, and then to sizes of effects in `variants`. `slope` (n_directions,
        n_columns) are derivatives of the directions by variables that replace them, by default
        themselves. `simulated` is the run of `plan`, if it is known: without derivatives, it
        suffices.
        """
        inputs, scales = self._inputs(values), self.sensor_scales(values)
        if not directions and not self.initial_states:  # a plain run is several times faster
            if simulated is None:
                (simulated,) = simulate_runs([self.plan(values, initial)])
            channels = self.filtered_channels(simulated, values)
            channels = (channels + self.step_error_correction) * scales
            return channels + self.drifts(values), np.zeros((*channels.shape, 0))
        slope = np.eye(len(directions)) if slope is None else slope
        of_sensors = np.array([constant_of(key) is not None for key in directions], dtype=bool)
        by_core = [key for key in directions if not constant_of(key)]
        core_directions = inputs.directions(by_core)
        n, n_initial, n_columns = len(core_directions), len(self.initial_states), slope.shape[1]
        n_of_variants = sum(len(sizes) for _, sizes in variants)
        chain = np.zeros((n + n_initial + n_of_variants, n_initial + n_columns + n_of_variants))
        own = slice(n_initial, n_initial + n_columns)
        chain[:n, own] = inputs.chain(core_directions, by_core) @ slope[~of_sensors]
        chain[n : n + n_initial, :n_initial] = np.eye(n_initial)
        chain[n + n_initial :, own.stop :] = np.eye(n_of_variants)
        resonates = self._has_resonant_mount(values)
        read, tangent = channel_sensitivities(
            self._arm_at(values),
            inputs.values,
            inputs.shift_start(self._drive_at(values, initial)),
            [*core_directions, *self.initial_states],
            channels=[
                (c.summed_quantity, c.joint, scale * c.factor(values))
                for c, scale in zip(self.channels, scales.tolist(), strict=True)
            ],
            chain=chain,
            sample_time=self.log.sample_time,
            samples=len(self.log),
            max_time_step=self._time_step(inputs.values),
            low_pass=None if resonates else LowPass(self._taps, self.kernels.step),
            sums=self._sums(values),
            variants=[(self._inputs(one).values, keys) for one, keys in variants],
        )
        if resonates:
            read, tangent = (self._behind_mounts(one, values) for one in (read, tangent))
        channels = read / scales + self.step_error_correction
        if of_sensors.any():
            keys = [key for key in directions if constant_of(key)]
            by_sensors = self.sensor_tangent(channels, values, initial, keys)
            changed = np.flatnonzero(slope[of_sensors].any(axis=0))
            tangent[..., n_initial + changed] += by_sensors @ slope[np.ix_(of_sensors, changed)]
        return channels * scales + self.drifts(values), tangent

    def _inputs(self, values: Mapping[Key, float]) -> RecordInputs:
        """Inputs of the compiled core, with the effects that are realised through inputs."""
        return record_inputs(
            self.arm,
            dict(values),
            self.log.name,
            hanging=not self.begins_in_motion,
            payload=self.log.experiment.payload,
        )

    def _time_step(self, values: Values) -> float:
        """Time step [s] for the simulation: shorter than that of the record if a mode requires it.

        A mode far above the cut-off, as of a wrist, need not be resolved, but in a longer step the
        integrator would be unstable.
        """
        stable = self._stable_time_step(values)
        return min(self.max_time_step, max(stable, self.max_time_step / _MAX_SHORTENING))

    def _stable_time_step(self, values: Values) -> float:
        """Longest time step [s] that is stable in the postures of the record."""
        n_samples = len(self.log)
        angles = prepare_record(self.log, self.arm).motor_angle[:: max(1, n_samples // _POSTURES)]
        return self.arm.stable_time_step(values, self.arm.links_of(angles))

    def _arm_at(self, values: Mapping[Key, float]) -> Arm:
        """The arm with the sensor bandwidths of `values`."""
        if not any(is_kind(key, ConstantKind.BANDWIDTH) for key in values):
            return self.arm
        joints = enumerate(self.arm.joints, start=1)
        return self.arm.with_joints(with_bandwidths(joint, i, values) for i, joint in joints)

    def advance_measured(self, values: Mapping[Key, float]) -> FloatArray:
        """Measured channels (n_rows, n_channels), advanced by the delays of their sensors.

        The first and the last sample extend the record.
        """
        delays = [channel.delay(values) for channel in self.channels]
        if not any(delays):
            return self.measured
        T, channels = self.log.sample_time, self.measured.copy()
        for k, (channel, delay) in enumerate(zip(self.channels, delays, strict=True)):
            if not delay:
                continue
            n_delay = round(delay / T)
            raw = self.log.channels[channel.channel]
            advanced = raw[np.clip(np.arange(len(raw)) + n_delay, 0, len(raw) - 1)]
            kernels = low_pass_kernels(self.cutoff_hz, T, delay / T - n_delay)
            channels[:, k] = kernels.rows(advanced, slope=channel.reads_angle)
        return channels

    def sensor_tangent(
        self,
        simulated: FloatArray,
        values: Mapping[Key, float],
        initial: FloatArray,
        keys: Sequence[Key],
    ) -> FloatArray:
        """Derivatives of simulated minus measured channels with respect to sensor constants.

        s x(t) + r (t - t_m) - y(t + D) has the derivatives x with respect to s, t - t_m with
        respect to r, and -y' with respect to D, approximated by -s x'. `simulated` (n_rows,
        n_channels) is x, without scale factors; `initial` (n_initial,) are the initial states;
        `keys` are sensor constants. Returns (n_rows, n_channels, n_keys).
        """
        motion: Mapping[Quantity, FloatArray] = {}
        constants = [constant_of(key) for key in keys]
        if any(one and (one.is_mounting or one.is_of_mount) for one in constants):
            motion = self.run(values, initial, self.quantities())
            motion = motion if self._has_resonant_mount(values) else self.rows(motion)
        tangent, scales = np.zeros((*simulated.shape, len(keys))), self.sensor_scales(values)
        row_time = self.kernels.step * self.log.sample_time
        mounting = [k for k, one in enumerate(constants) if one and one.is_mounting]
        for k, channel in enumerate(self.channels):
            scale = channel.key(ConstantKind.SCALE)
            drift = channel.key(ConstantKind.DRIFT, self.log.name)
            for at, key in enumerate(keys):
                if key == scale:
                    tangent[:, k, at] = simulated[:, k]
                elif key == drift:
                    tangent[:, k, at] = self.since_middle
                elif key in channel.delays:
                    tangent[:, k, at] = -scales[k] * differentiate_rows(simulated[:, k], row_time)
            for key, slope in self._mount_slopes(channel, motion, values, keys).items():
                tangent[:, k, keys.index(key)] = scales[k] * slope
            if channel.is_mounted and mounting:
                quantities = np.stack(
                    [motion[name][:, channel.joint - 1] for name in channel.quantities], 1
                )
                if self._has_resonant_mount(values):
                    quantities = self.kernels.rows(
                        self._filter_by_mount(channel, quantities, values), slope=False
                    )
                by = channel.slopes(values, [keys[at] for at in mounting])
                tangent[:, k, mounting] += scales[k] * quantities @ by
        for (k, at), slope in self._bandwidth_slopes(values, initial, keys).items():
            tangent[:, k, at] = scales[k] * slope
        for at, key in enumerate(keys):
            if is_kind(key, ConstantKind.HOLD):
                held = {key: values.get(key, 0.0) + _HOLD_STEP}
                tangent[..., at] = scales * (self._change(values, initial, held) / _HOLD_STEP)
        return tangent

    def _change(
        self, values: Mapping[Key, float], initial: FloatArray, changed: Values
    ) -> FloatArray:
        """Change of the channels (n_rows, n_channels) by other values, without scale factors."""
        runs = (self.run(at, initial, self.quantities()) for at in ({**values, **changed}, values))
        after, before = (self.filtered_channels(run, values) for run in runs)
        return np.asarray(after - before)

    def _bandwidth_slopes(
        self, values: Mapping[Key, float], initial: FloatArray, keys: Sequence[Key]
    ) -> dict[tuple[int, int], FloatArray]:
        """Derivatives of channels by their bandwidths in `keys`, without scale factors.

        The result maps the indices of channel and key to rows (n_rows,).
        """
        pairs = [
            (k, keys.index(key))
            for k, channel in enumerate(self.channels)
            if (key := channel.key(ConstantKind.BANDWIDTH)) in keys
        ]
        if not pairs:
            return {}
        steps = {keys[at]: _RELATIVE_BANDWIDTH_STEP * values[keys[at]] for _, at in pairs}
        wider = {key: values[key] + step for key, step in steps.items()}
        change = self._change(values, initial, wider)
        return {(k, at): change[:, k] / steps[keys[at]] for k, at in pairs}

    def _mount_slopes(
        self,
        channel: SensorAxis,
        motion: Mapping[Quantity, FloatArray],
        values: Mapping[Key, float],
        keys: Sequence[Key],
    ) -> dict[Key, FloatArray]:
        """Derivatives of a channel's rows by its mount constants, without scale factors."""
        mount, names = mount_resonance(channel, values), channel.mount
        if mount is None or names is None or not any(name in keys for name in names):
            return {}
        slopes = mount.slopes(channel.reading(motion, values), self.log.sample_time)
        pairs = zip(names, slopes, strict=True)
        return {n: self.kernels.rows(x, slope=channel.reads_angle) for n, x in pairs if n in keys}

    def sensor_scales(self, values: Mapping[Key, float]) -> FloatArray:
        """Scale factors (n_channels,), one where a sensor has none."""
        return np.array([channel.value(ConstantKind.SCALE, values) for channel in self.channels])

    def drifts(self, values: Mapping[Key, float]) -> FloatArray:
        """Contribution (n_rows, n_channels) of the sensor drifts to the channels."""
        name = self.log.name
        rates = [channel.value(ConstantKind.DRIFT, values, name) for channel in self.channels]
        return np.outer(self.since_middle, rates)

    @property
    def since_middle(self) -> FloatArray:
        """Time (n_rows,) [s] minus its mean, so that a drift does not change the mean."""
        return np.asarray(self.time - np.mean(self.time))

    def correct_step_error(
        self,
        values: Mapping[Key, float],
        initial: FloatArray,
        exact: Motion | None = None,
        simulated: FloatArray | None = None,
    ) -> Dataset:
        """Correct the integrator step error and the noise estimate at the given parameters.

        The step error changes little near these parameters, so a search can continue in long steps.
        The noise estimate excludes the simulated motion. `exact` and `simulated` are arguments of
        `step_errors`; what is not known is simulated.
        """
        if exact is None:
            (exact,) = simulate_runs([self.plan_exact(values, initial)])
        if simulated is None:
            run = self.run(values, initial, self.quantities())
            simulated = self.filtered_channels(run, values) + self.step_error_correction
        error = self.step_errors(values, exact, simulated)
        noise = np.minimum(self.noise, self._residual_noise(exact, values))
        correction = error
        if self.step_error is not None:
            correction = self.step_error_correction + error - self.step_error
        return replace(self, step_error_correction=correction, noise=noise, step_error=error)

    def resolve_modes(self, values: Mapping[Key, float]) -> Dataset:
        """The record in steps that resolve its fastest mode, without correction of their error.

        Longer steps damp a mode above the cut-off, as of a wrist, so that derivatives with respect
        to the gear's parameters are wrong. Returns the record itself if its steps are short enough.
        """
        stable = self._stable_time_step(self._inputs(values).values)
        step = max(_RESOLVING_SHARE * stable, self.max_time_step / _MAX_SHORTENING)
        if step >= self.max_time_step:
            return self
        correction = np.zeros_like(self.step_error_correction)
        return replace(self, max_time_step=step, step_error_correction=correction, step_error=None)

    def plan_exact(self, values: Mapping[Key, float], initial: FloatArray) -> PlannedRun:
        """Prepare the simulation of `quantities` in shorter steps.

        They resolve modes far above the cut-off, because longer ones would damp them.
        """
        step = min(
            self.max_time_step / _REFINEMENT_FACTOR,
            1.0 / (_REFINED_STEPS_PER_PERIOD * self.cutoff_hz),
            _ACCURATE_SHARE * self._stable_time_step(self._inputs(values).values),
        )
        refined = replace(self, max_time_step=max(step, self.max_time_step / _MAX_SHORTENING))
        return refined._plan(values, initial, self.quantities())

    def step_errors(
        self, values: Mapping[Key, float], exact: Motion, simulated: FloatArray
    ) -> FloatArray:
        """Channels (n_rows, n_channels) of an exact motion minus those in the record's steps.

        `exact` is the simulation of `plan_exact`, `simulated` (n_rows, n_channels) are the channels
        in the steps of the record with their correction.
        """
        coarse = simulated - self.step_error_correction
        return self.filtered_channels(exact, values) - coarse

    def _residual_noise(
        self, runs: Mapping[Quantity, FloatArray], values: Mapping[Key, float]
    ) -> FloatArray:
        """Filtered sensor noise (n_channels,) from the residuals of the unfiltered samples.

        This is an upper bound. It is tighter than that of the samples alone if the motion is fast
        relative to the sampling rate.
        """
        scales = self.sensor_scales(values)
        residuals = [
            self.log.channels[c.channel]
            - scale * self._filter_by_mount(c, c.reading(runs, values), values)
            for c, scale in zip(self.channels, scales, strict=True)
        ]
        return noise_behind(self.channels, residuals, self.kernels, self.counts)

    def _drive_at(self, values: Mapping[Key, float], initial: FloatArray) -> Drive:
        """Inputs of the simulation with torque holds and initial states (n_initial,)."""
        drive = hold_torques(self.drive, self.hold_change, values)
        if not self.begins_in_motion:
            return drive
        parts = initial.reshape(len(INITIAL_STATES), -1).tolist()
        velocity, link, link_velocity = (tuple(part) for part in parts)
        return replace(drive, motor_velocity=velocity, link_angle=link, link_velocity=link_velocity)

    def quantities(self) -> list[Quantity]:
        """Simulated quantities that the channels require."""
        return list(dict.fromkeys(name for c in self.channels for name in c.quantities))

    def _sums(self, values: Mapping[Key, float]) -> dict[Quantity, FloatArray]:
        """Weights (n_joints, n_signals) of the signals of links in readings of several signals."""
        sums: dict[Quantity, FloatArray] = {}
        for channel in self.channels:
            if len(channel.quantities) > 1:
                empty = np.zeros((self.arm.n_joints, len(LINK_SIGNALS)))
                weights = sums.setdefault(channel.summed_quantity, empty)
                weights[channel.joint - 1] = channel.signal_weights(values)
        return sums

    def filtered_channels(
        self, runs: Mapping[Quantity, FloatArray], values: Mapping[Key, float]
    ) -> FloatArray:
        """Rows (n_rows, n_channels) from samples (n_samples, n_joints) of each quantity.

        `values` must contain the mountings of sensors of unknown mounting.
        """
        if self._has_resonant_mount(values):
            return self._behind_mounts(self._stack_channels(runs, values), values)
        return self._stack_channels(self.rows(runs), values)

    def _behind_mounts(self, samples: FloatArray, values: Mapping[Key, float]) -> FloatArray:
        """Rows (n_rows, n_channels, ...) of channels (n_samples, n_channels, ...) on mounts."""
        rows = (
            self.kernels.rows(
                self._filter_by_mount(channel, samples[:, k], values), slope=channel.reads_angle
            )
            for k, channel in enumerate(self.channels)
        )
        return np.stack(list(rows), axis=1)

    def _has_resonant_mount(self, values: Mapping[Key, float]) -> bool:
        """Whether any sensor mount resonates, which requires samples instead of rows."""
        return any(mount_resonance(channel, values) for channel in self.channels)

    def _filter_by_mount(
        self, channel: SensorAxis, samples: FloatArray, values: Mapping[Key, float]
    ) -> FloatArray:
        """Filter samples (n_samples, ...) of a channel by its mount resonance, if any."""
        mount = mount_resonance(channel, values)
        return samples if mount is None else mount.read(samples, self.log.sample_time)

    def rows(self, runs: Mapping[Quantity, FloatArray]) -> dict[Quantity, FloatArray]:
        """Rows (n_rows, n_joints, ...) of each quantity, or sum of signals, from its samples."""
        names = [(c.reads_angle, (c.summed_quantity, *c.quantities)) for c in self.channels]
        kinds = dict.fromkeys((name, rate) for rate, of in names for name in of if name in runs)
        return {name: self.kernels.rows(runs[name], slope=rate) for name, rate in kinds}

    def _stack_channels(
        self, of: Mapping[Quantity, FloatArray], values: Mapping[Key, float]
    ) -> FloatArray:
        """Channels (n, n_channels) from samples or rows (n, n_joints) of each quantity."""
        return np.stack([channel.reading(of, values) for channel in self.channels], axis=1)


def noise_behind(
    channels: Sequence[SensorAxis],
    samples: Sequence[FloatArray],
    kernels: Kernels,
    counts: Sequence[float],
) -> FloatArray:
    """Standard deviation (n_channels,) of the filtered noise, from the top of the spectra.

    `samples` holds one array (n_samples,) per channel. `counts` are the resolutions of the
    channels; the noise is at least that of rounding, count / sqrt(12).
    """
    stds = [noise_std(x) for x in samples]
    gain = [np.linalg.norm(kernels.taps(slope=channel.reads_angle)) for channel in channels]
    stds = np.maximum(stds, np.array(counts) / np.sqrt(12.0)) * gain
    return np.asarray(np.maximum(stds, _MIN_NOISE))
