"""Log -> LinkSignals: motor-side and link-side motion through the same filters, (8)-(10)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from strainwave.domain import (
    BoolArray,
    Delay,
    Diagnostic,
    FloatArray,
    Fusion,
    Lag,
    LinkOptions,
    LinkSignals,
    LinkSummary,
    Log,
    Place,
)
from strainwave.domain.keys import JointIndex
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.link_sensors import MAX_SENSOR_DELAY, JointMotion, shift_samples
from strainwave.numerics.filters import (
    Between,
    apply_lags,
    apply_lags_without_aliases,
    differentiate,
    low_pass,
)
from strainwave.numerics.parallel import run_parallel
from strainwave.signals.channels import check_length, unmeasured
from strainwave.signals.delays import (
    build_misalignment_warnings,
    estimate_drive_delay,
    estimate_sensor_delay,
    estimate_sensor_delays,
)
from strainwave.signals.link_readings import CombinedReadings, choose_reading
from strainwave.signals.prepared_record import PreparedRecord, prepare_record


def fuse(rate: FloatArray, slow: FloatArray, fusion: Fusion, sample_time: float) -> FloatArray:
    """Sum of the high-pass filtered integral of a rate and the low-pass filtered slow signal, (10).

    y = (1 - F) (1/s) rate + F slow, with T = T_V:

        order 1: F = 1 / (1 + T s),
                 y = (T rate + slow) / (1 + T s);
        order 2: F = 1 / (1 + sqrt(2) T s + T^2 s^2),
                 y = (T^2 s rate + sqrt(2) T rate + slow) / (1 + sqrt(2) T s + T^2 s^2).

    The two filters sum to one: if `rate` is the derivative of `slow`, y = slow. All signals are
    (n_samples,).
    """
    # Only the high-pass filtered difference is added to slow, which avoids an initial transient.
    integral = np.r_[0.0, np.cumsum(0.5 * (rate[1:] + rate[:-1]))] * sample_time
    difference = integral - (slow - slow[0])
    return np.asarray(slow + difference - complement(difference, fusion, sample_time))


def complement(signal: FloatArray, fusion: Fusion, sample_time: float) -> FloatArray:
    """Low-pass F of the fusion, (n_samples,); its initial state is rest at the first sample."""
    low_pass = Lag(fusion.order, 1.0 / (2.0 * np.pi * fusion.time_constant))
    return apply_lags(signal, [low_pass], sample_time)


def bias_of(acceleration: FloatArray, velocity: FloatArray, sample_time: float, edge: int) -> float:
    """Bias of an acceleration [rad/s^2] relative to an encoder velocity [rad/s].

    The weighted mean of (acceleration - velocity') over the record, integrated by parts,

        sum(w a + w' v) / sum(w),    w = sin^4.

    The weight and its slope vanish at both ends, so a vibration of the spring between the two
    sensors does not contribute. `edge` samples at each end are excluded.
    """
    a, v = acceleration[edge:-edge], velocity[edge:-edge]
    phase = np.pi * (np.arange(len(a)) + 0.5) / len(a)
    weight = np.sin(phase) ** 4
    slope = 4.0 * np.sin(phase) ** 3 * np.cos(phase) * np.pi / (len(a) * sample_time)
    return float((weight @ a + slope @ v) / weight.sum())


_EDGE_PERIODS = 2.0  # excluded edge of a record, in periods of the slowest low-pass (its transient)
_MAX_DELAY_STD = 5e-4  # [s] standard deviation above which a delay estimate is discarded
# standard deviations of a velocity below which its sign is uncertain
_MIN_VELOCITY_SIGNIFICANCE = 4.0
# [s] maximum duration of an interpolated stretch that linear models use
_MAX_INTERPOLATED_TIME = 0.005
_MIN_INTERPOLATED_SAMPLES = 3  # samples of an interpolated stretch that linear models always use
# Maximum number of iterations of the delay estimate: the regression is linear only in short delays.
_MAX_ITERATIONS = 4


def compute_link_signals(
    logs: Sequence[Log],
    arm: Arm,
    options: LinkOptions | None = None,
    combined: CombinedReadings | None = None,
) -> tuple[list[LinkSignals], tuple[Delay, ...]]:
    """Compute motor-side and link-side motion of several records, corrected for sensor delays.

    A delay belongs to a sensor and is the same in all records. It is estimated from all of them,
    see `strainwave.signals.delays`. The channel is shifted by the delay if it exceeds four
    standard deviations and if no delay exceeds `MAX_SENSOR_DELAY`.

    Also returns the removed delay of each joint; its value is zero if nothing was removed. Raises
    InvalidInput under the same conditions as `prepare_link_signals`.
    """
    total = none = (Delay(0.0, 0.0),) * arm.n_joints
    for _ in range(_MAX_ITERATIONS):
        delays = tuple(late.value for late in total)
        records = run_parallel(
            [partial(prepare_link_signals, log, arm, options, delays, combined) for log in logs]
        )
        remaining = estimate_sensor_delays(records, arm.n_joints)
        total = tuple(
            Delay(removed.value + remainder.value, remainder.std)
            for removed, remainder in zip(total, remaining, strict=True)
        )
        if any(abs(late.value) > MAX_SENSOR_DELAY for late in total):  # reported, not corrected
            signals = [prepare_link_signals(log, arm, options, None, combined) for log in logs]
            return signals, none
        if not any(late.value for late in remaining):
            break
    return [replace(record, removed_delay=total) for record in records], total


def prepare_link_signals(
    log: Log,
    arm: Arm,
    options: LinkOptions | None = None,
    delays: Sequence[float] | None = None,
    combined: CombinedReadings | None = None,
) -> LinkSignals:
    """Compute link and motor angles, velocities and accelerations of one record.

    A tangential accelerometer at any position on the link gives (8), (9). The gravity component is
    subtracted because the sensor measures specific force:

        ddtheta_L1 = (a1 - g cos q1) / l_a1
        ddtheta_L2 = (a2 - g cos(q1 + q2)) / l_a2 - ddtheta_L1
                     - (l_1 / l_a2) (ddtheta_L1 cos q2 + dtheta_L1^2 sin q2)

    Its bias is the low-frequency difference from the acceleration of the encoder. Without an
    accelerometer, the acceleration is from a link encoder, the deflection, a gyro or the motor, in
    this order. The low-pass filter of each sensor is applied to all other signals.

    `delays` [s], one per joint, are known delays of the link sensors; their readings are shifted
    back. `combined` has the readings of sensors that are not read as they are, see
    `strainwave.signals.link_readings.combine_axes`. Raises InvalidInput if a channel or the
    position of an accelerometer is missing, or if the record is too short.
    """
    chosen = options or LinkOptions()
    view = _FilteredLog(prepare_record(log, arm), chosen, delays, combined or {})
    torque = np.column_stack([view.torque(i) for i in range(arm.n_joints)])
    motor_velocity = differentiate(view.motor_angle, log.sample_time)
    motion, links = _compute_link_motion(view, motor_velocity)
    sliding, direction = view.directions()
    valid, warnings = _find_valid_samples(view)
    signals = LinkSignals(
        experiment=log.experiment,
        time=log.time,
        sample_time=log.sample_time,
        motor_torque=torque,
        motor_angle=view.motor_angle,
        motor_velocity=motor_velocity,
        direction=direction,
        sliding=sliding,
        link_angle=motion.angle,
        link_velocity=motion.velocity,
        link_acceleration=motion.acceleration,
        valid=valid,
        links=tuple(links),
        held=tuple(view.held(i) for i in range(arm.n_joints)),
        shared=view.shared,
        bandwidth_hz=view.bandwidth_hz,
    )
    return _with_delays(signals, arm, view, warnings, is_single_record=delays is None)


class _FilteredLog:
    """Channels of a log through the filters that all channels share."""

    def __init__(
        self,
        record: PreparedRecord,
        options: LinkOptions,
        delays: Sequence[float] | None,
        combined: CombinedReadings,
    ) -> None:
        log, arm = record.log, record.arm
        self.record, self.log, self.arm, self.options = record, log, arm, options
        self.readings = tuple(
            choose_reading(log, arm, i, combined) for i in range(1, arm.n_joints + 1)
        )
        self.delays = delays or (0.0,) * arm.n_joints
        self.shared = tuple(dict.fromkeys(lag for each in self.readings for lag in each.lags))
        # The largest band of all joints: a joint with little motion does not determine a band.
        self.band = max(record.bands_hz)
        differenced = any(each.source != "accelerometer" for each in self.readings)
        self.bandwidth_hz = options.bandwidth_hz or (self.band if differenced else None)
        cutoffs = [lag.cutoff_hz for lag in self.shared]
        slowest = min([*cutoffs, self.bandwidth_hz or np.inf, 0.1 / log.sample_time])
        self.edge = int(np.ceil(_EDGE_PERIODS / (slowest * log.sample_time)))
        check_length(log, self.edge, slowest)
        self.motor_angle = self.through(record.motor_angle)

    def through(
        self, signal: FloatArray, sensor_lags: Sequence[Lag] = (), between: Between = "smooth"
    ) -> FloatArray:
        """Apply the shared low-pass filters, except those of the sensor itself (`sensor_lags`)."""
        rest = list(self.shared)
        for lag in sensor_lags:
            rest.remove(lag)
        return self.smooth(apply_lags_without_aliases(signal, rest, self.log.sample_time, between))

    def reading(self, i: JointIndex) -> FloatArray:
        """Reading of link i without the delay of its sensor, through the filters of the others."""
        reading, ahead = self.readings[i], self.delays[i] / self.log.sample_time
        samples = shift_samples(reading.samples(self.log, self.arm), ahead)
        return self.through(samples, reading.lags)

    def smooth(self, signal: FloatArray) -> FloatArray:
        """Apply the zero-phase low-pass filter, if there is one."""
        if self.bandwidth_hz is None:
            return signal
        return low_pass(signal, self.bandwidth_hz, self.log.sample_time)

    def held(self, i: JointIndex) -> bool:
        """Whether the torque of joint i is constant between samples."""
        loop = self.arm.joints[i].current_loop_hz
        voltage = self.record.inputs[i].is_voltage
        return voltage and loop is None and not self.shared and self.bandwidth_hz is None

    def torque(self, i: JointIndex) -> FloatArray:
        """Motor torque of joint i; a voltage passes the hold and the current loop."""
        motor = self.record.inputs[i]
        if not motor.is_voltage:
            return self.through(motor.values)
        law, T = self.record.law_of(motor), self.log.sample_time
        if not law.current_loop and not self.shared:
            return self.smooth(law.command(motor.values))
        return self.smooth(law.torque_without_aliases(motor.values, T, self.shared))

    def directions(self) -> tuple[FloatArray, FloatArray]:
        """Certain sliding direction of each motor, and the filtered direction used as a signal.

        At samples without a certain direction, the latter is the velocity over four standard
        deviations of its noise. White noise with standard deviation s of an angle, sampled with
        period T and filtered at f, gives s 2 pi f sqrt(2 f T / 3). The standard deviation of an
        encoder angle is at least 1/sqrt(12) counts.
        """
        f, T, certain = self.band, self.log.sample_time, self.record.sliding
        velocity = differentiate(low_pass(self.record.motor_angle, f, T), T)
        counts = np.array([joint.encoder_resolution for joint in self.arm.joints])
        noise = np.maximum(self.record.angle_noise, counts / np.sqrt(12.0))
        noise = noise * 2.0 * np.pi * f * np.sqrt(2.0 * f * T / 3.0)
        width = np.maximum(_MIN_VELOCITY_SIGNIFICANCE * noise, 1e-12)
        direction = np.where(certain != 0.0, certain, np.clip(velocity / width, -1.0, 1.0))
        return certain, self.through(direction, between="straight")


def _compute_link_motion(
    view: _FilteredLog, motor_velocity: FloatArray
) -> tuple[JointMotion, list[LinkSummary]]:
    """Compute the motion of the links in order, from the base outward."""
    arm, T = view.arm, view.log.sample_time
    motor_angle, motor_side = arm.links_of(view.motor_angle), arm.links_of(motor_velocity)
    # Initialise all joints with the motor-side motion; the loop replaces it joint by joint.
    motion = JointMotion(motor_angle.copy(), motor_side.copy(), differentiate(motor_side, T))
    links = [LinkSummary(view.log.name, each.joint, each.source) for each in view.readings]
    for i, reading in enumerate(view.readings):
        angle, slow = _low_frequency_motion(view, i, motor_angle[:, i])
        if reading.source != "accelerometer":
            if reading.source == "gyro":
                slow = view.reading(i) - reading.predict(arm, motion.without(i))
            motion.angle[:, i], motion.velocity[:, i] = angle, slow
            motion.acceleration[:, i] = differentiate(slow, T)
            continue
        still = replace(motion, acceleration=motion.without(i).acceleration)
        acceleration = (view.reading(i) - reading.predict(arm, still)) / reading.gain
        bias = bias_of(acceleration, slow, T, view.edge)
        links[i] = replace(links[i], bias=bias)
        acceleration = acceleration - bias
        fusion = Fusion(view.options.time_constant, view.options.order)
        motion.velocity[:, i] = fuse(acceleration, slow, fusion, T)
        motion.angle[:, i] = fuse(motion.velocity[:, i], angle, Fusion(fusion.time_constant, 1), T)
        motion.acceleration[:, i] = acceleration
        # With a measured link angle, (10) has no fusion error.
        if not {f"theta_l{i + 1}", f"deflection{i + 1}"} & view.log.channels.keys():
            error = complement(slow - motion.velocity[:, i], fusion, T)[view.edge : -view.edge]
            rms = float(np.sqrt(np.mean(error**2)))
            links[i] = replace(links[i], fusion=fusion, fusion_error=rms)
    return motion, links


def _low_frequency_motion(
    view: _FilteredLog, i: int, motor_side: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Link angle and velocity at low frequencies, from the link encoder, deflection or motor."""
    channels = view.log.channels
    if view.readings[i].source == "encoder":
        motor_side = view.reading(i)
    elif f"theta_l{i + 1}" in channels:
        motor_side = view.through(channels[f"theta_l{i + 1}"])
    elif f"deflection{i + 1}" in channels:
        motor_side = motor_side + view.through(channels[f"deflection{i + 1}"])
    return motor_side, differentiate(motor_side, view.log.sample_time)


def _find_valid_samples(view: _FilteredLog) -> tuple[BoolArray, list[Diagnostic]]:
    """Samples outside record edges, saturation and interpolation, and warnings about sensors."""
    saturation, channels = view.record.saturation, view.record.channels
    link_channels = [name for each in view.readings for name in each.channels]
    motors = [f"theta_m{i}" for i in range(1, view.arm.n_joints + 1)]
    max_samples = max(
        _MIN_INTERPOLATED_SAMPLES, round(_MAX_INTERPOLATED_TIME / view.log.sample_time)
    )
    interpolated = unmeasured(view.log, (*channels, *motors, *link_channels), max_samples)
    valid = ~(saturation.samples | interpolated[:, None])
    valid[: view.edge] = valid[-view.edge :] = False
    warnings = list(saturation.warnings)
    for reading in view.readings:
        if reading.source == "motor":
            place = Place.in_records(view.log.name)
            warnings.append(Diagnostic("no-link-sensor", place, joint=reading.joint))
    experiment, sample_time = view.log.experiment, view.log.sample_time
    prbs = None if experiment.is_resampled else experiment.prbs
    if prbs and prbs.clock < 0.999 * sample_time:
        place = Place.in_records(view.log.name)
        warnings.append(Diagnostic("sub-sampled", place, clock=prbs.clock, sample_time=sample_time))
    return valid, warnings


def _with_delays(
    signals: LinkSignals,
    arm: Arm,
    view: _FilteredLog,
    warnings: list[Diagnostic],
    *,
    is_single_record: bool,
) -> LinkSignals:
    """Signals with the remaining channel delays and their warnings.

    For a single record (`is_single_record`) this includes the delays of link sensors; otherwise
    they are estimated from all records.
    """
    place, links = Place.in_records(signals.experiment.name), []
    for i, link in enumerate(signals.links):
        sensor, drive = (
            delay if delay is not None and delay.std < _MAX_DELAY_STD else None
            for delay in (
                estimate_sensor_delay(signals, arm, view.readings[i]),
                estimate_drive_delay(signals, arm, i, view.band),
            )
        )
        links.append(replace(link, sensor_delay=sensor, drive_delay=drive))
        if is_single_record:
            warnings += build_misalignment_warnings(
                sensor, f"the link sensor of joint {i + 1}", place
            )
        description = f"motor {i + 1}'s response to the channel {view.record.channels[i]}"
        warnings += build_misalignment_warnings(drive, description, place)
    return replace(signals, links=tuple(links), warnings=tuple(warnings))
