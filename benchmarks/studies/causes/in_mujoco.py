"""Arms with a cause in MuJoCo, each cause written a second time, without the project's core.

A torque that is put on a joint holds for a step of the engine. It is worked out in the middle of
that step, from velocities and accelerations, so that it does not lag.
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

from benchmarks.studies.engine import STEP, Plant, in_mujoco
from strainwave.domain import FloatArray
from strainwave.domain.parameters import Values
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.simulation import Drive, Quantity, Trajectory
from strainwave.virtual.families.causes import (
    NOTHING,
    Cause,
    with_encoder_zero,
    with_sensor_mount,
)

_SETTLING_STEPS = 8000
_SETTLING_LOSS = 0.995  # of the links' velocities that a settling step leaves
_GRAVITY = 9.81  # [m/s^2]
_FLEXIBLE_AT = 0.4  # of a link's length, where its hinge is
_BEYOND = 0.6  # of a link's mass


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
        """What the arm did, as its study's sensors show it."""

        def simulated(sample_time: float, samples: int) -> Trajectory:
            return in_mujoco(
                arm,
                values,
                drive,
                sample_time=sample_time,
                samples=samples,
                record=record,
                plant=partial(_PLANTS[self.cause.name], cause=self.cause, record=self.record),
            )

        found = with_sensor_mount(simulated, sample_time, samples, self.cause)
        return with_encoder_zero(found, arm, self.cause)


class _Ailing(Plant):
    """An arm whose cause sits at one joint."""

    def __init__(self, arm: Arm, values: Values, cause: Cause, record: int) -> None:
        super().__init__(arm, values)
        self.cause, self.record, self.joint = cause, record, cause.joint
        self.sizes: Mapping[str, float] = cause.sizes
        self.ratio = arm.joints[self.joint - 1].gear_ratio

    def value(self, name: str) -> float:
        """One of the joint's parameters."""
        return self.values[name, self.joint]

    def begin(self, model: Any, data: Any, drive: Drive) -> None:
        """All hang at standstill, whatever pulls: motors held, all else slowed down.

        The places of the joint's angles and velocities in the engine's lists are known from here.
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
            data.qvel *= _SETTLING_LOSS
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


class _DryFriction(_Ailing):
    """Coulomb friction that something else moves."""

    def act(self, model: Any, data: Any) -> None:
        model.dof_frictionloss[self.motor] = self.value("motor_coulomb_friction") + self.more(data)

    def more(self, data: Any) -> float:
        """What there is beside its constant part [N m]."""
        raise NotImplementedError


class _Stribeck(_DryFriction):
    def more(self, data: Any) -> float:
        share = self.middle(data)[1] / self.sizes["stribeck_velocity"]
        return self.sizes["stribeck_friction"] * math.exp(-share * share)


class _LoadFriction(_DryFriction):
    def more(self, data: Any) -> float:
        q_m, w_m, q_l, w_l = self.middle(data)
        torque = self.spring(self.ratio * q_m - q_l)
        torque += self.value("gear_damping") * (self.ratio * w_m - w_l)
        return self.sizes["load_friction"] * abs(self.ratio * torque)


class _FrictionByRecord(_DryFriction):
    def more(self, data: Any) -> float:
        factor = self.sizes[f"factor_{self.record}"]
        return (factor - 1.0) * self.value("motor_coulomb_friction")


class _PowerFriction(_Ailing):
    def act(self, model: Any, data: Any) -> None:
        w = self.middle(data)[1]
        p = self.sizes["power_exponent"]
        torque = self.sizes["power_friction"] * ((abs(w) / 100.0 + 0.01) ** p - 0.01**p)
        data.qfrc_applied[self.motor] = -math.copysign(torque, w)


class _TorqueRipple(_Ailing):
    def act(self, model: Any, data: Any) -> None:
        angle = self.sizes["torque_ripple_order"] * self.middle(data)[0]
        cos, sin = self.sizes["torque_ripple_cos"], self.sizes["torque_ripple_sin"]
        data.qfrc_applied[self.motor] = cos * math.cos(angle) + sin * math.sin(angle)


class _Gear(_Ailing):
    """A gear whose torque differs from that of the engine's spring and damper."""

    def put(self, data: Any, torque: float, at_motor: float) -> None:
        """A torque on the link, and one against the motor."""
        data.qfrc_applied[self.link] = torque
        data.qfrc_applied[self.motor] = -at_motor


class _Hysteresis(_Gear):
    """Dahl's law, exact between two steps, of which none holds a reversal worth a word."""

    def __init__(self, arm: Arm, values: Values, cause: Cause, record: int) -> None:
        super().__init__(arm, values, cause, record)
        self.z, self.before = 0.0, math.nan

    def act(self, model: Any, data: Any) -> None:
        q_m, _, q_l, _ = self.middle(data)
        torsion = self.ratio * q_m - q_l
        way = 0.0 if math.isnan(self.before) else torsion - self.before
        self.before = torsion
        limit = math.copysign(1.0, way)
        self.z = limit + (self.z - limit) * math.exp(-abs(way) / self.sizes["hysteresis_twist"])
        torque = self.sizes["hysteresis_torque"] * self.z
        self.put(data, torque, self.ratio * torque)


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
        without = self.spring(torsion) + damping * rate
        torque = self.spring(torsion + error) + damping * (rate + slope * w_m)
        self.put(data, torque - without, (self.ratio + slope) * torque - self.ratio * without)


class _Backlash(_Gear):
    def act(self, model: Any, data: Any) -> None:
        q_m, _, q_l, _ = self.middle(data)
        torsion, half = self.ratio * q_m - q_l, self.sizes["backlash"]
        felt = torsion - max(-half, min(half, torsion))
        torque = self.spring(felt) - self.spring(torsion)
        self.put(data, torque, self.ratio * torque)


class _GroundSpring(_Ailing):
    """The engine's own joint spring, whose zero is where it pulls with nothing."""

    def edited(self, mjcf: str) -> str:
        root = ET.fromstring(mjcf)
        joint = _found(root, f".//joint[@name='joint{self.joint}']")
        stiffness, preload = self.sizes["ground_stiffness"], self.sizes["ground_preload"]
        joint.set("stiffness", _text(stiffness))
        joint.set("springref", _text(-preload / stiffness))
        return ET.tostring(root, encoding="unicode")


class _Drive(_Ailing):
    """An amplifier that does not give what it is asked for."""

    def amplified(self, commanded: FloatArray) -> FloatArray:
        found = np.array(commanded, dtype=float)
        found[self.joint - 1] = self.given(float(found[self.joint - 1]))
        return found

    def given(self, voltage: float) -> float:
        """Of one joint."""
        raise NotImplementedError


class _DriveGain(_Drive):
    def given(self, voltage: float) -> float:
        return self.sizes["gain"] * voltage


class _DriveGainByRecord(_Drive):
    def given(self, voltage: float) -> float:
        return self.sizes[f"factor_{self.record}"] * voltage


class _DriveSaturation(_Drive):
    def given(self, voltage: float) -> float:
        return voltage * (1.0 - self.sizes["drive_saturation"] * abs(voltage))


class _DeadZone(_Drive):
    def given(self, voltage: float) -> float:
        return math.copysign(max(0.0, abs(voltage) - self.sizes["dead_zone"]), voltage)


class _DriveLimit(_Drive):
    """An amplifier that clips."""

    def given(self, voltage: float) -> float:
        return float(np.clip(voltage, -self.sizes["drive_limit"], self.sizes["drive_limit"]))


class _DriveLag(_Ailing):
    """A current loop slower than the study has it."""

    def bandwidths(self) -> list[float]:
        found = super().bandwidths()
        found[self.joint - 1] = self.sizes["bandwidth"]
        return found


class _Tilt(_Ailing):
    """Gravity that is not where the study says: turned in the plane, or not quite across it."""

    def begin(self, model: Any, data: Any, drive: Drive) -> None:
        angle, azimuth = self.sizes["angle"], self.sizes["azimuth"]
        pull = float(np.hypot(*model.opt.gravity[:2]))
        if pull > 0.0:
            model.opt.gravity[:2] = pull * math.sin(angle), -pull * math.cos(angle)
        else:
            pull = _GRAVITY * math.sin(angle)
            model.opt.gravity[:2] = pull * math.cos(azimuth), pull * math.sin(azimuth)
        super().begin(model, data, drive)


class _FlexibleLink(_Ailing):
    """A hinge with a spring within a link, most of whose mass is beyond it."""

    def edited(self, mjcf: str) -> str:
        root = ET.fromstring(mjcf)
        link = _found(root, f".//body[@name='link{self.joint}']")
        inertial = _found(link, "inertial")
        mass, inertia = float(inertial.attrib["mass"]), _first(inertial.attrib["diaginertia"])
        place = _first(inertial.attrib["pos"])
        away = _FLEXIBLE_AT * self._length()
        moved = [each for each in link if each.tag not in ("inertial", "joint")]
        name = f"beyond{self.joint}"
        beyond = ET.SubElement(link, "body", name=name, pos=f"{_text(away)} 0 0")
        attributes = {"pos": f"{_text(place - away)} 0 0", "mass": _text(_BEYOND * mass)}
        ET.SubElement(beyond, "inertial", attributes | _turning(_BEYOND * inertia))
        inertial.attrib |= {"mass": _text((1.0 - _BEYOND) * mass)}
        inertial.attrib |= _turning((1.0 - _BEYOND) * inertia)
        stiffness = self.sizes["stiffness"] * self._gear()
        carried = self.values["beta", None] if self.joint == 2 else self._carried()
        damping = 2.0 * self.sizes["damping_ratio"] * math.sqrt(stiffness * carried)
        hinge = {"name": "flexible", "type": "hinge", "axis": "0 0 1"}
        hinge |= {"stiffness": _text(stiffness), "damping": _text(damping)}
        ET.SubElement(beyond, "joint", hinge)
        for each in moved:
            link.remove(each)
            beyond.append(each)
            _shift(each, away)
        return ET.tostring(root, encoding="unicode")

    def _length(self) -> float:
        if self.joint == 1:
            return self.arm.link_length or 0.0
        return self.arm.joints[1].accelerometer_distance or 0.0

    def _gear(self) -> float:
        """Stiffness of the gear without torsion."""
        return self.spring(1e-9) / 1e-9

    def _carried(self) -> float:
        return sum(self.values[name, None] for name in ("alpha", "beta", "gamma"))


class _SoftBase(_Ailing):
    """The first axis stands on a heavy base that turns about it, and slides a little."""

    def edited(self, mjcf: str) -> str:
        root = ET.fromstring(mjcf)
        world = _found(root, "worldbody")
        link = _found(world, "body[@name='link1']")
        links = sum(float(each.attrib["mass"]) for each in link.iter("inertial"))
        stiffness = 1.0 / self.sizes["base_compliance"]
        turning = stiffness / (math.tau * self.sizes["base_frequency"]) ** 2
        mass = self.sizes["mass"] * links
        base = ET.SubElement(world, "body", name="base")
        base.set("pos", "0 0 0")
        ET.SubElement(base, "inertial", {"pos": "0 0 0", "mass": _text(mass)} | _turning(turning))
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


def _found(element: ET.Element, path: str) -> ET.Element:
    found = element.find(path)
    if found is None:
        raise LookupError(f"the exported model has no {path}")
    return found


def _text(number: float) -> str:
    return repr(float(number))


def _first(numbers: str) -> float:
    return float(numbers.split(maxsplit=1)[0])


def _turning(inertia: float) -> dict[str, str]:
    return {"diaginertia": " ".join([_text(inertia)] * 3)}


def _shift(element: ET.Element, away: float) -> None:
    """An element of a body, where another body that begins further out has it."""
    if "fromto" in element.attrib:
        return  # it is drawn, nothing else
    x, *others = element.attrib.get("pos", "0 0 0").split()
    element.set("pos", " ".join([_text(float(x) - away), *others]))


_PLANTS: dict[str, Callable[..., Plant]] = {
    NOTHING: _Ailing,
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
    "encoder-zero": _Ailing,
    "sensor-mount": _Ailing,
    "friction-by-record": _FrictionByRecord,
    "drive-gain-by-record": _DriveGainByRecord,
    "flexible-link": _FlexibleLink,
    "soft-base": _SoftBase,
}
CAUSES = tuple(name for name in _PLANTS if name != NOTHING)
"""What the engine's arms can have."""
