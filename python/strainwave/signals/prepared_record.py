"""A log with the motion and the inputs of its motors, which every stage filters further."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from strainwave.domain import FloatArray, Joint, Log
from strainwave.dynamics.arm import Arm
from strainwave.errors import InvalidInput
from strainwave.numerics.filters import noise_std, signal_band
from strainwave.signals.channels import (
    InputKind,
    MotorInput,
    Saturation,
    detect_saturation,
    unmeasured,
)
from strainwave.signals.drive_law import DriveLaw, held_commands
from strainwave.signals.standstill import sliding_direction

_MIN_STANDSTILL_TIME = 0.02  # [s] minimum duration of a standstill of the encoder
_MIN_STANDSTILL_SAMPLES = 6  # minimum duration of a standstill in samples
_MAX_PERIOD_ERROR = 1e-6  # relative, of the servo's period as a multiple of the sample time
_MIN_SAMPLES_PER_COMMAND = 2  # below it, torques do not show when they were sampled


@dataclass(frozen=True)
class PreparedRecord:
    """Motor motion and motor inputs of a log; arrays are (n_samples, n_joints) and unfiltered.

    A quantity is computed when it is first used, and read-only. Raises InvalidInput if its channels
    are missing.
    """

    log: Log
    arm: Arm

    @cached_property
    def motor_angle(self) -> FloatArray:
        """Motor angles [rad]."""
        names = [f"theta_m{i}" for i in range(1, self.arm.n_joints + 1)]
        missing = next((name for name in names if name not in self.log.channels), None)
        if missing:
            message, remedy = f"the log has no channel {missing}", f"log {missing}"
            raise InvalidInput(message, where=self.log.name, remedy=remedy)
        return _read_only([self.log.channels[name] for name in names])

    @cached_property
    def angle_noise(self) -> FloatArray:
        """Standard deviation of the white noise of the motor angles: (n_joints,) [rad]."""
        return np.array([noise_std(angle) for angle in self.motor_angle.T])

    @cached_property
    def bands_hz(self) -> tuple[float, ...]:
        """Frequency of each motor angle above which noise dominates [Hz]."""
        return tuple(signal_band(angle, self.log.sample_time) for angle in self.motor_angle.T)

    @cached_property
    def sliding(self) -> FloatArray:
        """Sliding direction of each motor: +1, -1, or 0 if it is uncertain.

        Changes of the angle below 1.5 encoder counts, or below 5 standard deviations of its white
        noise if the counts are unknown, do not determine the direction.
        """
        standing = max(_MIN_STANDSTILL_SAMPLES, round(_MIN_STANDSTILL_TIME / self.log.sample_time))
        motors = zip(self.motor_angle.T, self.arm.joints, self.angle_noise.tolist(), strict=True)
        return np.column_stack(
            [
                sliding_direction(angle, 1.5 * joint.encoder_resolution or 5.0 * noise, standing)
                for angle, joint, noise in motors
            ]
        )

    @cached_property
    def inputs(self) -> tuple[MotorInput, ...]:
        """Input of each motor: its torque if it is logged, otherwise its voltage."""
        return self._inputs(("torque", "u"))

    @cached_property
    def driving_inputs(self) -> tuple[MotorInput, ...]:
        """Input of each motor: its voltage if it is logged, otherwise its torque."""
        return self._inputs(("u", "torque"))

    @cached_property
    def channels(self) -> tuple[str, ...]:
        """Channel of the input of each motor."""
        return tuple(each.channel for each in self.inputs)

    @cached_property
    def torque(self) -> FloatArray:
        """Motor torque at the time stamps [N m]: as logged, or from the voltage by the law."""
        T = self.log.sample_time
        columns = [
            self.law_of(each).torque(each.values, T) if each.is_voltage else each.values
            for each in self.inputs
        ]
        return _read_only(columns)

    @cached_property
    def voltage(self) -> FloatArray:
        """Voltages that drove the motors, held between samples [V]: as logged, or from the torque.

        The unit is N m if the joint has no torque per volt.
        """
        T = self.log.sample_time
        held = self._held_commands()

        def voltage(motor: MotorInput, joint: Joint) -> FloatArray:
            if motor.is_voltage:
                return motor.values
            if motor.joint in held:
                return held[motor.joint] / joint.torque_per_command
            return DriveLaw.of(joint).voltage(motor.values, T)

        return _read_only(list(map(voltage, self.driving_inputs, self.arm.joints)))

    @cached_property
    def hold_change(self) -> FloatArray:
        """Change of `voltage` if logged torques are commands, (n_samples, n_joints) [V]."""
        laws = map(DriveLaw.of, self.arm.joints)
        return _read_only(
            [
                np.zeros(len(self.log)) if each.is_voltage else law.hold_change(each.values)
                for each, law in zip(self.driving_inputs, laws, strict=True)
            ]
        )

    def _held_commands(self) -> dict[int, FloatArray]:
        """Commands [N m] of a servo by joint, where they follow from logged torques."""
        T, servo, joints = self.log.sample_time, self.arm.servo, self.arm.joints
        logged = [
            each
            for each in self.driving_inputs
            if not each.is_voltage and joints[each.joint - 1].current_loop_hz
        ]
        samples = servo.period / T if servo else 0.0
        is_multiple = abs(samples - round(samples)) < _MAX_PERIOD_ERROR * samples
        if not logged or not is_multiple or round(samples) < _MIN_SAMPLES_PER_COMMAND:
            return {}
        loops = [joints[each.joint - 1].current_loop_hz or np.inf for each in logged]
        # the same for arms that differ in their sensors
        key = "held commands", round(samples), tuple(loops)
        if key not in self.log.prepared:
            torques = [each.values for each in logged]
            self.log.prepared[key] = held_commands(torques, T, round(samples) * T, loops)
        held: Any = self.log.prepared[key]
        return {} if held is None else {e.joint: u for e, u in zip(logged, held, strict=True)}

    @cached_property
    def saturation(self) -> Saturation:
        """Samples at which the drives are at their limits, and warnings."""
        return detect_saturation(self.log, self.arm, self.inputs)

    def law_of(self, motor: MotorInput) -> DriveLaw:
        """Law of a motor's drive; a voltage requires `torque_per_volt`."""
        joint = self.arm.joints[motor.joint - 1]
        if motor.is_voltage and joint.torque_per_volt is None:
            raise InvalidInput(
                "a voltage is logged but torque_per_volt is not given",
                where=f"joint {motor.joint}",
                remedy="add torque_per_volt to the joint, or log the torque",
            )
        return DriveLaw.of(joint)

    def _inputs(self, kinds: Sequence[InputKind]) -> tuple[MotorInput, ...]:
        """Input of each motor of the first logged kind."""
        inputs = []
        for joint in range(1, self.arm.n_joints + 1):
            motor = MotorInput.of(self.log, joint, kinds)
            if motor is None:
                raise InvalidInput(
                    f"the log has neither torque{joint} nor u{joint}",
                    where=self.log.name,
                    remedy="log the torque or the voltage of the motor",
                )
            inputs.append(motor)
        return tuple(inputs)


def prepare_record(log: Log, arm: Arm) -> PreparedRecord:
    """Motion and inputs of the motors of a log; prepared once for each log and arm."""
    if arm not in log.prepared:
        log.prepared[arm] = PreparedRecord(log, arm)
    prepared = log.prepared[arm]
    assert isinstance(prepared, PreparedRecord)
    return prepared


def _read_only(columns: Sequence[FloatArray]) -> FloatArray:
    """An array that stages share, from one column per joint."""
    array = np.column_stack(columns)
    array.setflags(write=False)
    return array


def add_link_angles(log: Log, arm: Arm) -> Log:
    """Add link angles of joints with measured deflection: motor side plus deflection."""
    channels, masked = dict(log.channels), dict(log.masked)
    for i in range(1, arm.n_joints + 1):
        if f"deflection{i}" in channels and f"theta_l{i}" not in channels:
            motor_side = arm.links_of(prepare_record(log, arm).motor_angle)
            channels[f"theta_l{i}"] = motor_side[:, i - 1] + channels[f"deflection{i}"]
            masked[f"theta_l{i}"] = unmeasured(log, (f"theta_m{i}", f"deflection{i}"))
    return replace(log, channels=channels, masked=masked)
