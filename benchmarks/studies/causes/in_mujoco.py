"""Arms with a cause in MuJoCo, implemented independently of strainwave's core.

An applied torque is constant over a step of MuJoCo. It is computed for the middle of the step, from
velocities and accelerations, so that it does not lag.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any
from xml.etree import ElementTree as ET

import mujoco
import numpy as np

from benchmarks.families.causes import (
    NO_CAUSE,
    Cause,
    with_encoder_zero,
    with_sensor_mount,
)
from benchmarks.studies.engine import STEP, Plant, in_mujoco
from strainwave.domain import FloatArray
from strainwave.domain.arm.link_sensors.link_space import Quantity
from strainwave.domain.keys import Values
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.simulation import Drive, Trajectory

_SETTLING_STEPS = 8000
_SETTLING_FACTOR = 0.995  # of the links' velocities per settling step
_GRAVITY = 9.81  # [m/s^2]
_HINGE_POSITION = 0.4  # of a link's length
_OUTER_MASS = 0.6  # of a link's mass, beyond the hinge


@dataclass(frozen=True, slots=True)
class InMujoco:
    """A simulator of one record."""

    cause: Cause
    record: int  # from 0

    def __call__(
        self,
        arm: Arm,
        values: Values,
        drive: Drive,
        /,
        *,
        sample_time: float,
        samples: int,
        record: Sequence[Quantity],
    ) -> Trajectory:
        """Simulate the sensors of the arm's study."""

        def simulate(sample_time: float, samples: int) -> Trajectory:
            return in_mujoco(
                arm,
                values,
                drive,
                sample_time=sample_time,
                samples=samples,
                record=record,
                plant=partial(_PLANTS[self.cause.name], cause=self.cause, record=self.record),
            )

        trajectory = with_sensor_mount(simulate, sample_time, samples, self.cause)
        return with_encoder_zero(trajectory, arm, self.cause)


class _FaultyArm(Plant):
    """An arm with a cause at one joint."""

    def __init__(self, arm: Arm, values: Values, cause: Cause, record: int) -> None:
        super().__init__(arm, values)
        self.cause, self.record, self.joint = cause, record, cause.joint
        self.sizes: Mapping[str, float] = cause.sizes
        self.ratio = arm.joints[self.joint - 1].gear_ratio

    def value(self, name: str) -> float:
        """One of the joint's parameters."""
        return self.values[name, self.joint]

    def begin(self, model: Any, data: Any, drive: Drive) -> None:
        """Find the equilibrium with the motors held, by damping all other velocities.

        Sets the indices of the joint's angles and velocities in MuJoCo's arrays.
        """
        motor = model.joint(f"motor_joint{self.joint}")
        link = model.joint(f"joint{self.joint}")
        self.motor, self.link = int(motor.dofadr[0]), int(link.dofadr[0])
        self.motor_place, self.link_place = int(motor.qposadr[0]), int(link.qposadr[0])
        speeds, places = [], []
        for i, (joint, angle) in enumerate(zip(self.arm.joints, drive.motor_angle, strict=True), 1):
            data.joint(f"motor_joint{i}").qpos[0] = angle
            data.joint(f"joint{i}").qpos[0] = joint.gear_ratio * angle
            places.append(int(model.joint(f"motor_joint{i}").qposadr[0]))
            speeds.append(int(model.joint(f"motor_joint{i}").dofadr[0]))
        for _ in range(_SETTLING_STEPS):
            self.act(model, data)
            mujoco.mj_step(model, data)
            data.qvel *= _SETTLING_FACTOR
            data.qvel[speeds] = 0.0
            data.qpos[places] = drive.motor_angle
        data.qvel[:] = 0.0
        data.qacc[:] = 0.0
        data.time = 0.0

    def middle(self, data: Any) -> tuple[float, float, float, float]:
        """Angle and velocity of motor and link in the middle of the next step."""
        half = 0.5 * STEP
        w_m, w_l = float(data.qvel[self.motor]), float(data.qvel[self.link])
        q_m, q_l = float(data.qpos[self.motor_place]), float(data.qpos[self.link_place])
        a_m, a_l = float(data.qacc[self.motor]), float(data.qacc[self.link])
        return q_m + half * w_m, w_m + half * a_m, q_l + half * w_l, w_l + half * a_l

    def spring(self, torsion: float) -> float:
        """Torque of the gear's spring [N m]."""
        if ("gear_stiffness", self.joint) in self.values:
            return self.value("gear_stiffness") * torsion
        k1, k2, k3 = (self.value(f"gear_stiffness_k{k}") for k in (1, 2, 3))
        first = self.value("gear_knee_t1") / k1
        second = first + (self.value("gear_knee_t2") - self.value("gear_knee_t1")) / k2
        size = abs(torsion)
        torque = k1 * min(size, first)
        torque += k2 * max(0.0, min(size, second) - first) + k3 * max(0.0, size - second)
        return math.copysign(torque, torsion)


class _DryFriction(_FaultyArm):
    """Coulomb friction that depends on the state."""

    def act(self, model: Any, data: Any) -> None:
        model.dof_frictionloss[self.motor] = self.value("motor_coulomb_friction") + self.additional(
            data
        )

    def additional(self, data: Any) -> float:
        """Friction in addition to the constant part [N m]."""
        raise NotImplementedError


class _Stribeck(_DryFriction):
    def additional(self, data: Any) -> float:
        share = self.middle(data)[1] / self.sizes["stribeck_velocity"]
        return self.sizes["stribeck_friction"] * math.exp(-share * share)


class _LoadFriction(_DryFriction):
    def additional(self, data: Any) -> float:
        q_m, w_m, q_l, w_l = self.middle(data)
        torque = self.spring(self.ratio * q_m - q_l)
        torque += self.value("gear_damping") * (self.ratio * w_m - w_l)
        return self.sizes["load_friction"] * abs(self.ratio * torque)


class _FrictionByRecord(_DryFriction):
    def additional(self, data: Any) -> float:
        factor = self.sizes[f"factor_{self.record}"]
        return (factor - 1.0) * self.value("motor_coulomb_friction")


class _PowerFriction(_FaultyArm):
    def act(self, model: Any, data: Any) -> None:
        w = self.middle(data)[1]
        p = self.sizes["power_exponent"]
        torque = self.sizes["power_friction"] * ((abs(w) / 100.0 + 0.01) ** p - 0.01**p)
        data.qfrc_applied[self.motor] = -math.copysign(torque, w)


class _TorqueRipple(_FaultyArm):
    def act(self, model: Any, data: Any) -> None:
        angle = self.sizes["torque_ripple_order"] * self.middle(data)[0]
        cos, sin = self.sizes["torque_ripple_cos"], self.sizes["torque_ripple_sin"]
        data.qfrc_applied[self.motor] = cos * math.cos(angle) + sin * math.sin(angle)


class _Gear(_FaultyArm):
    """A gear whose torque differs from that of MuJoCo's spring and damper."""

    def apply(self, data: Any, torque: float, at_motor: float) -> None:
        """Apply a torque to the link and the opposite one to the motor."""
        data.qfrc_applied[self.link] = torque
        data.qfrc_applied[self.motor] = -at_motor


class _Hysteresis(_Gear):
    """Dahl's law, exact between two steps; reversals within a step are neglected."""

    def __init__(self, arm: Arm, values: Values, cause: Cause, record: int) -> None:
        super().__init__(arm, values, cause, record)
        self.z, self.previous = 0.0, math.nan

    def act(self, model: Any, data: Any) -> None:
        q_m, _, q_l, _ = self.middle(data)
        torsion = self.ratio * q_m - q_l
        change = 0.0 if math.isnan(self.previous) else torsion - self.previous
        self.previous = torsion
        limit = math.copysign(1.0, change)
        self.z = limit + (self.z - limit) * math.exp(-abs(change) / self.sizes["hysteresis_twist"])
        torque = self.sizes["hysteresis_torque"] * self.z
        self.apply(data, torque, self.ratio * torque)


class _KinematicError(_Gear):
    def act(self, model: Any, data: Any) -> None:
        q_m, w_m, q_l, w_l = self.middle(data)
        cos, sin = self.sizes["kinematic_error_cos"], self.sizes["kinematic_error_sin"]
        order = self.sizes["kinematic_error_order"]
        wave = math.cos(order * q_m), math.sin(order * q_m)
        error = cos * wave[0] + sin * wave[1]
        slope = order * (sin * wave[0] - cos * wave[1])
        damping, torsion = self.value("gear_damping"), self.ratio * q_m - q_l
        rate = self.ratio * w_m - w_l
        nominal = self.spring(torsion) + damping * rate
        torque = self.spring(torsion + error) + damping * (rate + slope * w_m)
        self.apply(data, torque - nominal, (self.ratio + slope) * torque - self.ratio * nominal)


class _Backlash(_Gear):
    def act(self, model: Any, data: Any) -> None:
        q_m, _, q_l, _ = self.middle(data)
        torsion, half = self.ratio * q_m - q_l, self.sizes["backlash"]
        loaded = torsion - max(-half, min(half, torsion))
        torque = self.spring(loaded) - self.spring(torsion)
        self.apply(data, torque, self.ratio * torque)


class _GroundSpring(_FaultyArm):
    """MuJoCo's joint spring, with its zero at the unloaded angle."""

    def edited(self, mjcf: str) -> str:
        root = ET.fromstring(mjcf)
        joint = _find(root, f".//joint[@name='joint{self.joint}']")
        stiffness, preload = self.sizes["ground_stiffness"], self.sizes["ground_preload"]
        joint.set("stiffness", _text(stiffness))
        joint.set("springref", _text(-preload / stiffness))
        return ET.tostring(root, encoding="unicode")


class _Drive(_FaultyArm):
    """An amplifier whose output differs from its command."""

    def amplified(self, commanded: FloatArray) -> FloatArray:
        output = np.array(commanded, dtype=float)
        output[self.joint - 1] = self.output(float(output[self.joint - 1]))
        return output

    def output(self, voltage: float) -> float:
        """Output of the joint's amplifier [V]."""
        raise NotImplementedError


class _DriveGain(_Drive):
    def output(self, voltage: float) -> float:
        return self.sizes["gain"] * voltage


class _DriveGainByRecord(_Drive):
    def output(self, voltage: float) -> float:
        return self.sizes[f"factor_{self.record}"] * voltage


class _DriveSaturation(_Drive):
    def output(self, voltage: float) -> float:
        return voltage * (1.0 - self.sizes["drive_saturation"] * abs(voltage))


class _DeadZone(_Drive):
    def output(self, voltage: float) -> float:
        return math.copysign(max(0.0, abs(voltage) - self.sizes["dead_zone"]), voltage)


class _DriveLimit(_Drive):
    """An amplifier that clips."""

    def output(self, voltage: float) -> float:
        return float(np.clip(voltage, -self.sizes["drive_limit"], self.sizes["drive_limit"]))


class _DriveLag(_FaultyArm):
    """A current loop that is slower than in the study."""

    def bandwidths(self) -> list[float]:
        bandwidths = super().bandwidths()
        bandwidths[self.joint - 1] = self.sizes["bandwidth"]
        return bandwidths


class _Tilt(_FaultyArm):
    """Gravity with a direction that differs from the study's, in or out of the plane."""

    def begin(self, model: Any, data: Any, drive: Drive) -> None:
        angle, azimuth = self.sizes["angle"], self.sizes["azimuth"]
        pull = float(np.hypot(*model.opt.gravity[:2]))
        if pull > 0.0:
            model.opt.gravity[:2] = pull * math.sin(angle), -pull * math.cos(angle)
        else:
            pull = _GRAVITY * math.sin(angle)
            model.opt.gravity[:2] = pull * math.cos(azimuth), pull * math.sin(azimuth)
        super().begin(model, data, drive)


class _FlexibleLink(_FaultyArm):
    """A link with an elastic hinge; most of its mass is beyond the hinge."""

    def edited(self, mjcf: str) -> str:
        root = ET.fromstring(mjcf)
        link = _find(root, f".//body[@name='link{self.joint}']")
        inertial = _find(link, "inertial")
        mass, inertia = float(inertial.attrib["mass"]), _first(inertial.attrib["fullinertia"])
        place = _first(inertial.attrib["pos"])
        away = _HINGE_POSITION * self._length()
        moved = [element for element in link if element.tag not in ("inertial", "joint")]
        name = f"beyond{self.joint}"
        beyond = ET.SubElement(link, "body", name=name, pos=f"{_text(away)} 0 0")
        attributes = {"pos": f"{_text(place - away)} 0 0", "mass": _text(_OUTER_MASS * mass)}
        ET.SubElement(beyond, "inertial", attributes | _spherical_inertia(_OUTER_MASS * inertia))
        inertial.attrib |= {"mass": _text((1.0 - _OUTER_MASS) * mass)}
        inertial.attrib |= _spherical_inertia((1.0 - _OUTER_MASS) * inertia)
        stiffness = self.sizes["stiffness"] * self._gear()
        carried = self.values["beta", None] if self.joint == 2 else self._carried()
        damping = 2.0 * self.sizes["damping_ratio"] * math.sqrt(stiffness * carried)
        hinge = {"name": "flexible", "type": "hinge", "axis": "0 0 1"}
        hinge |= {"stiffness": _text(stiffness), "damping": _text(damping)}
        ET.SubElement(beyond, "joint", hinge)
        for element in moved:
            link.remove(element)
            beyond.append(element)
            _shift(element, away)
        return ET.tostring(root, encoding="unicode")

    def _length(self) -> float:
        if self.joint == 1:
            return self.arm.joints[1].origin.xyz[0] or 0.0
        return self.arm.joints[1].accelerometer_distance or 0.0

    def _gear(self) -> float:
        """Stiffness of the gear at zero torsion."""
        return self.spring(1e-9) / 1e-9

    def _carried(self) -> float:
        return sum(self.values[name, None] for name in ("alpha", "beta", "gamma"))


class _SoftBase(_FaultyArm):
    """The first axis on a heavy base that turns about it and slides slightly."""

    def edited(self, mjcf: str) -> str:
        root = ET.fromstring(mjcf)
        world = _find(root, "worldbody")
        link = _find(world, "body[@name='link1']")
        links = sum(float(each.attrib["mass"]) for each in link.iter("inertial"))
        stiffness = 1.0 / self.sizes["base_compliance"]
        turning = stiffness / (math.tau * self.sizes["base_frequency"]) ** 2
        mass = self.sizes["mass"] * links
        base = ET.SubElement(world, "body", name="base")
        base.set("pos", "0 0 0")
        ET.SubElement(
            base, "inertial", {"pos": "0 0 0", "mass": _text(mass)} | _spherical_inertia(turning)
        )
        held = mass * (math.tau * self.sizes["sliding_frequency"]) ** 2
        kinds = (
            ("slide", "1 0 0", mass, held),
            ("slide", "0 1 0", mass, held),
            ("hinge", "0 0 1", turning, stiffness),
        )
        for k, (kind, axis, moved, spring) in enumerate(kinds):
            damping = 2.0 * self.sizes["base_damping"] * math.sqrt(spring * moved)
            joint = {"name": f"base{k}", "type": kind, "axis": axis}
            ET.SubElement(base, "joint", joint, stiffness=_text(spring), damping=_text(damping))
        world.remove(link)
        base.append(link)
        return ET.tostring(root, encoding="unicode")


def _find(element: ET.Element, path: str) -> ET.Element:
    child = element.find(path)
    if child is None:
        raise LookupError(f"the exported model has no {path}")
    return child


def _text(number: float) -> str:
    return repr(float(number))


def _first(numbers: str) -> float:
    return float(numbers.split(maxsplit=1)[0])


def _spherical_inertia(inertia: float) -> dict[str, str]:
    return {"fullinertia": " ".join([_text(inertia)] * 3 + ["0"] * 3)}


def _shift(element: ET.Element, away: float) -> None:
    """Move an element into the frame of a body that begins farther out."""
    if "fromto" in element.attrib:
        return  # for display only
    x, *others = element.attrib.get("pos", "0 0 0").split()
    element.set("pos", " ".join([_text(float(x) - away), *others]))


_PLANTS: dict[str, Callable[..., Plant]] = {
    NO_CAUSE: _FaultyArm,
    "stribeck": _Stribeck,
    "hysteresis": _Hysteresis,
    "kinematic-error": _KinematicError,
    "load-friction": _LoadFriction,
    "power-friction": _PowerFriction,
    "torque-ripple": _TorqueRipple,
    "backlash": _Backlash,
    "ground-spring": _GroundSpring,
    "drive-gain": _DriveGain,
    "drive-saturation": _DriveSaturation,
    "dead-zone": _DeadZone,
    "drive-limit": _DriveLimit,
    "drive-lag": _DriveLag,
    "tilt": _Tilt,
    "encoder-zero": _FaultyArm,
    "sensor-mount": _FaultyArm,
    "friction-by-record": _FrictionByRecord,
    "drive-gain-by-record": _DriveGainByRecord,
    "flexible-link": _FlexibleLink,
    "soft-base": _SoftBase,
}
CAUSES = tuple(name for name in _PLANTS if name != NO_CAUSE)
"""Causes that MuJoCo can simulate."""
