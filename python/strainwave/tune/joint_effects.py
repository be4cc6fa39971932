"""Identified effects of joints that follow from a reference motion, for feed-forward."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from strainwave.domain import FloatArray
from strainwave.domain.effects import Effect, all_effects
from strainwave.domain.parameter_table import base_name
from strainwave.errors import InvalidInput
from strainwave.export.source import IdentifiedArm

COMPENSATED = (
    "stribeck",
    "load-friction",
    "power-friction",
    "torque-ripple",
    "kinematic-error",
    "ground-spring",
    "tilt",
    "drive-gain",
    "drive-lag",
)
"""Effects that are functions of the reference, and those that scale or delay the drive."""

_POWER_VELOCITY = 100.0  # [rad/s] at which power friction is about f_P, as in the core
_POWER_OFFSET = 0.01  # of the relative velocity, as in the core
_N_NEWTON = 20  # steps; five reach rounding error for real gears


@dataclass(frozen=True, slots=True)
class JointEffects:
    """Values of the identified effects of one joint, by effect and parameter.

    Arrays are those of one joint: (n_samples,).
    """

    values: Mapping[str, Mapping[str, float]]

    def load(self, angle: FloatArray) -> FloatArray:
        """Torque [N m] of a ground spring at the link, (S19)."""
        spring = self.values.get("ground-spring")
        if spring is None:
            return np.zeros_like(angle)
        return spring["ground_stiffness"] * angle + spring["ground_preload"]

    def weight(self, angle: FloatArray) -> FloatArray:
        """Torque [N m] of unmodelled gravity over the angle of the link in space, (S23)."""
        tilt = self.values.get("tilt")
        if tilt is None:
            return np.zeros_like(angle)
        return np.asarray(tilt["tilt_sin"] * np.sin(angle) + tilt["tilt_cos"] * np.cos(angle))

    def dry_friction(self, velocity: FloatArray, load: FloatArray) -> FloatArray:
        """Dry friction [N m] in addition to Coulomb friction, (S10), (S15), without a sign.

        `load` [N m] is the gear torque at the motor.
        """
        friction = np.zeros_like(velocity)
        if stribeck := self.values.get("stribeck"):
            share = velocity / stribeck["stribeck_velocity"]
            friction += stribeck["stribeck_friction"] * np.exp(-(share**2))
        if teeth := self.values.get("load-friction"):
            friction += teeth["load_friction"] * np.abs(load)
        return friction

    def motor_torque(self, angle: FloatArray, velocity: FloatArray) -> FloatArray:
        """Torque [N m] that balances power friction, (S16), and torque ripple, (S17)."""
        torque = np.zeros_like(angle)
        if drag := self.values.get("power-friction"):
            power, offset = drag["power_exponent"], _POWER_OFFSET
            speed = np.abs(velocity) / _POWER_VELOCITY + offset
            torque += np.sign(velocity) * drag["power_friction"] * (speed**power - offset**power)
        if ripple := self.values.get("torque-ripple"):
            phase = ripple["torque_ripple_order"] * angle
            torque -= ripple["torque_ripple_cos"] * np.cos(phase)
            torque -= ripple["torque_ripple_sin"] * np.sin(phase)
        return torque

    def motor_angle(self, ideal: FloatArray, gear_ratio: float) -> tuple[FloatArray, FloatArray]:
        """Motor angle theta, and ratio of the output's velocity to n dtheta, (S12).

        n theta + e(theta) = n theta_ideal
        """
        error = self.values.get("kinematic-error")
        if error is None:
            return ideal, np.ones_like(ideal)
        k, a, b = (error[f"kinematic_error_{name}"] for name in ("order", "cos", "sin"))
        theta = ideal
        for _ in range(_N_NEWTON):
            cos, sin = np.cos(k * theta), np.sin(k * theta)
            ratio = 1.0 + k * (b * cos - a * sin) / gear_ratio
            theta = theta - (theta - ideal + (a * cos + b * sin) / gear_ratio) / ratio
        return theta, 1.0 + k * (b * np.cos(k * theta) - a * np.sin(k * theta)) / gear_ratio


def effects_of(arm: IdentifiedArm) -> tuple[JointEffects, ...]:
    """Identified effects of all joints that feed-forward can compensate.

    Raises InvalidInput if a shape is missing, or if a kinematic error reverses a gear.
    """
    estimated = {(base_name(p.name), p.joint) for p in arm.parameters if p.value is not None}
    joints = []
    for number in range(1, arm.study.arm.n_joints + 1):
        values = {
            effect.name: _values_of(effect, arm, number)
            for effect in all_effects()
            if effect.name in COMPENSATED
            and any((size, number) in estimated for size in effect.sizes)
        }
        if error := values.get("kinematic-error"):
            size = np.hypot(error["kinematic_error_cos"], error["kinematic_error_sin"])
            slope = error["kinematic_error_order"] * size / abs(arm.joint(number).gear_ratio)
            if slope >= 1.0:
                raise InvalidInput(
                    f"the kinematic error of joint {number} reverses the gear: its slope is "
                    f"{slope:.3g} times the gear ratio",
                    where=f"{arm.source}: parameters",
                    remedy="check kinematic_error_cos and kinematic_error_sin",
                )
        joints.append(JointEffects(values))
    return tuple(joints)


def _values_of(effect: Effect, arm: IdentifiedArm, number: int) -> Mapping[str, float]:
    """Sizes and shapes of an effect; sizes that are not identified are zero."""
    by_default = dict.fromkeys(effect.sizes, 0.0) | dict(effect.defaults)
    return {
        name: by_default[name]
        if name in by_default and (name, number) not in arm.values
        else arm.need(name, number)
        for name in effect.names
    }
