"""Simulate a record on an elastic arm under its recorded input, and compare the sensors.

Servo, references and open-loop voltages come from the record. The compared channels are motor
velocities, differentiated from the encoders, and accelerometers, all with one zero-phase low-pass.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace

import numpy as np

from strainwave.domain import FloatArray, Log, Prediction
from strainwave.domain.arm.effects import effect_named
from strainwave.domain.arm.gear_laws import determined_law
from strainwave.domain.arm.link_sensors import SensorAxis, compared_axes
from strainwave.domain.arm.link_sensors.link_space import Quantity
from strainwave.domain.arm.link_sensors.single_axis import MotorEncoder
from strainwave.domain.arm.parameter_table import base_name
from strainwave.domain.keys import Key, Values
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.link_sensors import apply_sensor_model
from strainwave.dynamics.rigid_prediction import fit_percent
from strainwave.dynamics.simulation import (
    Drive,
    Samples,
    plan_run,
    record_inputs,
    simulate_runs,
)
from strainwave.numerics.filters import differentiate, low_pass, noise_std
from strainwave.signals.prepared_record import prepare_record
from strainwave.signals.recorded_input import (
    check_recorded_input,
    hold_torques,
    recorded_drive,
)

MIN_SIGNAL_TO_NOISE = 10.0
"""Minimum ratio of signal to noise; below it, a fit measures the sensor instead of the model."""
_READ: Quantity = "accelerometer"  # quantity of the compared sensors


def keep_known_effects(arm: Arm, known: Collection[Key]) -> Arm:
    """The arm with only the effects whose parameters are all known."""
    known = {(base_name(name), joint) for name, joint in known}
    joints = tuple(
        replace(
            joint,
            effects=tuple(
                effect
                for effect in joint.possible_effects
                if all((name, number) in known for name in effect_named(effect).required)
            ),
        )
        for number, joint in enumerate(arm.joints, start=1)
    )
    return arm.with_joints(joints)


def restrict_to_values(arm: Arm, values: Mapping[Key, float]) -> Arm:
    """The arm with known effects only, and with the simplest springs that the values describe.

    `values` maps (name, joint) to a value.
    """
    joints = tuple(
        replace(joint, spring=determined_law(joint.spring, names).name)
        for number, joint in enumerate(arm.joints, start=1)
        for names in [[name for name, of in values if of == number]]
    )
    return keep_known_effects(arm.with_joints(joints), values.keys())


def velocity_band(log: Log, arm: Arm) -> float:
    """Highest frequency [Hz] at which a motor angle exceeds its noise, over all motors."""
    return max(prepare_record(log, arm).bands_hz)


@dataclass(frozen=True, slots=True)
class ObservedMotion:
    """Measured motion of a record, with the data that the comparison with a simulation needs."""

    log: Log
    drive: Drive
    cutoff_hz: float
    channels: tuple[str, ...]  # omega_m{i} [rad/s], then those of `axes` [m/s^2]
    axes: tuple[SensorAxis, ...]  # accelerometers
    time: FloatArray  # (n_rows,) [s] without the edges of the filter
    measured: FloatArray  # (n_rows, n_channels)
    noise: FloatArray  # (n_channels,) standard deviation of the filtered sensor noise

    @property
    def moves(self) -> tuple[bool, ...]:
        """Whether each channel clearly exceeds its noise."""
        return tuple((np.std(self.measured, axis=0) > MIN_SIGNAL_TO_NOISE * self.noise).tolist())

    def simulate(self, arm: Arm, *variants: Mapping[Key, float]) -> list[FloatArray]:
        """Simulated channels (n_rows, n_channels) of an arm with several sets of values.

        The bias of an accelerometer is unknown, so the simulated mean is set to the measured one.
        Torque holds, delays and scales are applied if they are among the values. The arm has
        the springs and effects of the values, which map (name, joint) to a value.
        """
        record: list[Quantity] = ["encoder"]
        if self.axes:
            record.append(_READ)
        runs = []
        for values in variants:
            restricted = restrict_to_values(arm, values)
            inputs = record_inputs(
                restricted,
                dict(values),
                self.log.name,
                hanging=self.drive.link_angle is None,
                payload=self.log.experiment.payload,
            )
            change = prepare_record(self.log, arm).hold_change * np.logical_not(self.drive.servo)
            run = plan_run(
                restricted,
                inputs.values,
                hold_torques(inputs.shift_start(self.drive), change, values),
                sample_time=self.log.sample_time,
                samples=len(self.log),
                record=record,
            )
            runs.append(run)
        pairs = zip(simulate_runs(runs), variants, strict=True)
        return [self._channels(run, arm, values) for run, values in pairs]

    def _channels(self, run: Samples, arm: Arm, values: Mapping[Key, float]) -> FloatArray:
        """Channels (n_rows, n_channels) of a simulation."""
        motors = [
            SensorAxis(MotorEncoder.of_joint(joint), i) for i, joint in enumerate(arm.joints, 1)
        ]
        read: list[tuple[Quantity, SensorAxis]] = [("encoder", axis) for axis in motors] + [
            (_READ, axis) for axis in self.axes
        ]
        columns = []
        for name, axis in read:
            ideal = run[name][:, axis.joint - 1]
            columns.append(apply_sensor_model(ideal, self.log.sample_time, axis, values)[:, None])
        filtered = _filter(np.hstack(columns), arm.n_joints, self.log, self.cutoff_hz)
        shift = self.measured.mean(axis=0) - filtered.mean(axis=0)
        shift[: arm.n_joints] = 0.0
        return np.asarray(filtered + shift)


def observe(log: Log, arm: Arm, cutoff_hz: float | None = None) -> ObservedMotion:
    """Velocities and accelerations of a record, prepared for the comparison.

    `cutoff_hz` [Hz] is that of the low-pass; the default is the bandwidth of the measured motion.
    Raises `InvalidInput` if the log lacks a channel that the simulation needs.
    """
    check_recorded_input(arm, log)
    cutoff = cutoff_hz or velocity_band(log, arm)
    numbers = range(1, arm.n_joints + 1)
    compared = (compared_axes(arm, i, log.channels) for i in numbers)
    axes = tuple(axis for one in compared for axis in one if axis.quantities == (_READ,))
    record = prepare_record(log, arm)
    readings = [log.channels[axis.channel] for axis in axes]
    raw = np.column_stack([record.motor_angle, *readings])
    T = log.sample_time
    # gain of white noise below the cut-off; encoders are differentiated
    derivative_gain = 2.0 * np.pi * cutoff / np.sqrt(3.0)
    gains = np.array([derivative_gain] * arm.n_joints + [1.0] * len(axes))
    noise = np.r_[record.angle_noise, [noise_std(reading) for reading in readings]]
    return ObservedMotion(
        log=log,
        drive=recorded_drive(arm, log),
        cutoff_hz=cutoff,
        channels=tuple([f"omega_m{i}" for i in numbers] + [axis.channel for axis in axes]),
        axes=axes,
        time=log.time[_inside(log, cutoff)],
        measured=_filter(raw, arm.n_joints, log, cutoff),
        noise=noise * gains * np.sqrt(min(1.0, 2.0 * T * cutoff)),
    )


def predict_closed_loop(
    values: Values, log: Log, arm: Arm, cutoff_hz: float | None = None
) -> Prediction:
    """Simulate a record on an arm with elastic joints and compare it with the measurement.

    `values` maps (name, joint) to a value; one `gear_stiffness` is sufficient for a nonlinear gear.
    The references and open-loop voltages come from `log`. `cutoff_hz` [Hz] is the low-pass of both
    sides; the default is derived from the record.

    The channels are `omega_m{i}` [rad/s] and, with accelerometers, `a{i}` [m/s^2]. The fit of a
    channel that does not clearly exceed its noise is NaN.

    Raises `InvalidInput` if the log lacks a channel, or a parameter is missing or impossible;
    `NumericalFailure` if the simulated motion is not finite.
    """
    observed = observe(log, arm, cutoff_hz)
    return build_prediction(observed, *observed.simulate(arm, values))


def build_prediction(observation: ObservedMotion, predicted: FloatArray) -> Prediction:
    """Prediction record of a comparison. `predicted` is (n_rows, n_channels)."""
    fits = np.where(observation.moves, fit_percent(observation.measured, predicted), np.nan)
    return Prediction(
        experiment=observation.log.name,
        time=observation.time,
        channels=observation.channels,
        measured=observation.measured,
        predicted=predicted,
        fit_percent=dict(zip(observation.channels, fits.tolist(), strict=True)),
    )


def _inside(log: Log, cutoff_hz: float) -> slice:
    """Rows without the edges of the record, which contain filter transients."""
    edge = min(int(np.ceil(1.0 / (cutoff_hz * log.sample_time))), len(log) // 4)
    return slice(edge, len(log) - edge)


def _filter(raw: FloatArray, n_joints: int, log: Log, cutoff_hz: float) -> FloatArray:
    """Low-pass encoders and accelerometers (n_samples, n_channels, ...), differentiate encoders."""
    filtered = np.array(low_pass(raw, cutoff_hz, log.sample_time))
    filtered[:, :n_joints] = differentiate(filtered[:, :n_joints], log.sample_time)
    return np.asarray(filtered[_inside(log, cutoff_hz)])
