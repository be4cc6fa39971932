"""Motors, gears and actuators of an MJCF file, and the MuJoCo versions that read them.

A fixed tendon over motor and link joint with coefficients n and -1 has the length
delta = n theta_M - theta_L; its stiffness and damping act on both sides as in (1) and (2). A tendon
with a slack range acts beyond the range only: parallel tendons give a law whose slope changes at
knees, and backlash. A stiffness polynomial is a cubic gear, and elastic-plastic tendons are near
Dahl's hysteresis (S11). A DC motor without electrical part is a torque ripple (S17).
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial
from xml.etree import ElementTree as ET

import numpy as np

from strainwave.domain import Diagnostic, Joint, Place, PositionServo
from strainwave.domain.arm.combinations import is_rigid_drive
from strainwave.domain.arm.effects import all_effects
from strainwave.domain.keys import JointNumber
from strainwave.dynamics.arm import Arm
from strainwave.errors import InvalidInput
from strainwave.export import completion, source
from strainwave.export.source import IdentifiedArm, numbers

STEP_S = 1e-4  # [s] time step; Coulomb friction, a constraint, takes two steps to stop a motor
_FAR = 1e9  # [rad or m] of a spring: its force is constant to 1e-9 per radian
# Elements that not all versions read: first version, and the attribute.
_ELEMENTS = {
    "armature": ((3, 3, 1), "tendon/fixed armature"),
    "delay": ((3, 5, 0), "actuator delay"),
    "polynomial": ((3, 7, 0), "stiffness and damping of three coefficients"),
    "ripple": ((3, 12, 0), 'dcmotor input="none"'),
    "hysteresis": ((4, 0, 0), "springyield"),
}
OLDEST, NEWEST = (3, 0, 0), (4, 0, 0)
_EFFECT_ELEMENTS = {"hysteresis": "hysteresis", "torque-ripple": "ripple"}
_EXACT_EFFECTS = ("backlash", "ground-spring", "drive-gain", "drive-lag", "drive-limit")
# Dahl's torque T_h (1 - exp(-x/delta_h)) from rest reverses twice as steeply. Elastic-plastic
# elements repeat the curve from rest over twice the torsion instead. Between both, this steepness
# loses the same energy per cycle within 5 % for amplitudes above delta_h, with three elements.
_HYSTERESIS_STEEPNESS = 1.6
_N_HYSTERESIS_ELEMENTS = 3


@dataclass(frozen=True, slots=True)
class Target:
    """The version of MuJoCo that reads a file."""

    version: tuple[int, ...] = NEWEST

    @classmethod
    def of(cls, text: str) -> Target:
        """Version "3", which means all of 3, "3.5" or "4.0.0"; `InvalidInput` if it has no such."""
        parts = tuple(map(int, text.split("."))) if re.fullmatch(r"\d+(\.\d+){0,2}", text) else ()
        version = (*parts, 0, 0)[:3] if parts else (0,)
        if version < OLDEST:
            raise InvalidInput(
                f"{text!r} is not a version of MuJoCo that the file can be written for: it has "
                'no `dyntype="filterexact"`',
                where="--mujoco",
                remedy="give 3 or later, such as 3.2 or 4",
            )
        return cls(version)

    def has(self, element: str) -> bool:
        """Whether it reads an element of `_ELEMENTS`."""
        return self.version >= _ELEMENTS[element][0]

    def loss(self, part: str, element: str, joints: list[JointNumber]) -> Diagnostic:
        """The loss of a part for which a later version has the element."""
        since, attribute = _since(element)
        return source.loss(part, joints, "version", since=since, element=attribute)

    @property
    def effects(self) -> frozenset[str]:
        """Effects that the file has."""
        later = (name for name, element in _EFFECT_ELEMENTS.items() if self.has(element))
        return frozenset((*_EXACT_EFFECTS, *later))


def _since(element: str) -> tuple[str, str]:
    """First version that reads an element, and its attribute."""
    version, attribute = _ELEMENTS[element]
    return ".".join(map(str, version[: 3 if version[2] else 2])), attribute


def note_of_version(root: ET.Element) -> tuple[str, ...]:
    """A note on the oldest version that reads a file; none if all of 3 do."""
    used = {"armature": any("armature" in fixed.attrib for fixed in root.iter("fixed"))}
    used["delay"] = root.find("actuator/*[@delay]") is not None
    forces = [e.get(name, "") for e in root.iter() for name in ("stiffness", "damping")]
    used["polynomial"] = any(len(force.split()) > 1 for force in forces)
    used["ripple"] = root.find("actuator/dcmotor") is not None
    used["hysteresis"] = root.find("tendon/*[@springyield]") is not None
    newest = max((e for e in _ELEMENTS if used[e]), key=lambda e: _ELEMENTS[e][0], default=None)
    if newest is None:
        return ()
    since, attribute = _since(newest)
    return (f"the file needs MuJoCo {since} or later: {attribute}",)


def has_effect(arm: IdentifiedArm, number: JointNumber, name: str) -> bool:
    """Whether a joint has an effect of a size other than zero."""
    sizes = next(effect.sizes for effect in all_effects() if effect.name == name)
    return any(arm.values.get((size, number)) for size in sizes)


def losses_of_effects(arm: IdentifiedArm, target: Target) -> tuple[set[str], list[Diagnostic]]:
    """Names of the parts that the file holds, and losses of effects that it could hold."""
    held, losses = set[str](), list[Diagnostic]()
    numbers_of_joints = range(1, arm.study.arm.n_joints + 1)
    for effect in all_effects():
        if effect.name not in (*_EXACT_EFFECTS, *_EFFECT_ELEMENTS):
            continue
        held |= {effect.name, *effect.names}
        joints = [i for i in numbers_of_joints if has_effect(arm, i, effect.name)]
        element = _EFFECT_ELEMENTS.get(effect.name)
        if joints and element and not target.has(element):
            losses.append(target.loss(effect.name, element, joints))
            continue
        if unlike := [i for i in joints if not _is_representable(arm, i, effect.name)]:
            losses.append(source.loss(effect.name, unlike))
    return held, losses


def _is_representable(arm: IdentifiedArm, number: JointNumber, effect: str) -> bool:
    """Whether the file can have an effect with its values."""
    values = arm.values
    if effect == "torque-ripple":  # MuJoCo has whole numbers of periods
        return float(values.get(("torque_ripple_order", number), 0.0)).is_integer()
    if effect == "drive-limit":  # MuJoCo loses all voltage beyond a limit
        return values.get(("drive_limit_loss", number)) == 1.0
    return True


def motor_friction(
    arm: IdentifiedArm, number: int, rest: str, ratio: float = 1.0, of_link: float = 0.0
) -> dict[str, str]:
    """Attributes for the friction of a motor at an element that turns `ratio` times as fast.

    `of_link` is the viscous friction of the element itself. The time constant of the friction
    constraint is twice the settling time (S9). The offset is a soft spring that is far from its
    rest, the attribute `rest`: -stiffness (q - rest). It is a passive force, so that inverse
    dynamics contain it.
    """
    higher = [arm.values.get((name, number), 0.0) for name in completion.DAMPING]
    powers = [arm.need("motor_viscous_friction", number), *(higher if any(higher) else ())]
    turns = 1.0 / abs(ratio)
    damping = [coefficient * turns ** (k + 2) for k, coefficient in enumerate(powers)]
    damping[0] += of_link
    settling = arm.values.get(("friction_settling_time", number), 0.0)
    attributes = {
        "damping": numbers(*damping),
        "frictionloss": numbers(arm.need("motor_coulomb_friction", number) / abs(ratio)),
        "solreffriction": numbers(max(2.0 * settling, 2.0 * STEP_S), 1.0),
        "solimpfriction": "0.9999 0.9999 0.001",
    }
    offset = arm.values.get(("friction_offset", number), 0.0) / ratio
    if offset:
        attributes["stiffness"] = numbers(abs(offset) / _FAR)
        attributes[rest] = numbers(-math.copysign(_FAR, offset))
    return attributes


Terms = tuple[tuple[str, float], ...]
"""Joints of a tendon with their coefficients."""


def add_gear(
    tendons: ET.Element, arm: IdentifiedArm, number: int, terms: Terms, target: Target
) -> None:
    """The spring as parallel tendons, one per slope (1); the first has the damping."""
    backlash = arm.values.get(("backlash", number), 0.0)
    for part, (stiffness, slack) in enumerate(_springs(arm, number, target), start=1):
        name = f"gear{number}" if part == 1 else f"gear{number}_beyond_t{part - 1}"
        fixed = _fixed(tendons, terms, name=name, stiffness=numbers(*stiffness))
        end = slack + backlash
        fixed.set("springlength", numbers(-end, end) if end else "0")
        if part == 1:
            fixed.set("damping", numbers(arm.need("gear_damping", number)))
    if target.has("hysteresis") and has_effect(arm, number, "hysteresis"):
        for part, (stiffness_of_part, end) in enumerate(_hysteresis(arm, number), start=1):
            element = _fixed(tendons, terms, name=f"gear{number}_hysteresis{part}")
            element.set("stiffness", numbers(stiffness_of_part))
            element.set("springlength", "0")
            element.set("springyield", numbers(end))


def _springs(
    arm: IdentifiedArm, number: int, target: Target
) -> tuple[tuple[tuple[float, ...], float], ...]:
    """Coefficients of each spring's polynomial, and the torsion [rad] beyond which it acts."""
    law, need = arm.joint(number).law, partial(arm.need, joint=number)
    springs = law.parallel_springs(need)
    if springs is not None:
        return tuple(((stiffness,), slack) for stiffness, slack in springs)
    polynomial = law.polynomial(need)
    if polynomial is None or not target.has("polynomial"):
        return (((need(law.linearised_by),), 0.0),)
    return ((polynomial, 0.0),)


def _hysteresis(arm: IdentifiedArm, number: int) -> Iterator[tuple[float, float]]:
    """Stiffness and yield of parallel elastic-plastic elements with the torque T_h together.

    The torque from rest is T_h (1 - exp(-c x/delta_h)) at points of equal steps of the torque.
    """
    torque, twist = (arm.need(f"hysteresis_{name}", number) for name in ("torque", "twist"))
    n = _N_HYSTERESIS_ELEMENTS
    levels = np.append(np.arange(n) / n, 1.0 - 0.25 / n)
    torsion = -np.log1p(-levels) * twist / _HYSTERESIS_STEEPNESS
    slopes = torque * np.append(np.diff(levels / levels[-1]) / np.diff(torsion), 0.0)
    yield from zip((-np.diff(slopes)).tolist(), torsion[1:].tolist(), strict=True)


def add_ground_spring(tendons: ET.Element, arm: IdentifiedArm, number: int) -> None:
    """The torque c q + t of cables on a link (S19)."""
    stiffness = arm.values.get(("ground_stiffness", number), 0.0)
    preload = arm.values.get(("ground_preload", number), 0.0)
    if not stiffness:  # a soft spring that is far from its rest
        stiffness = abs(preload) / _FAR
    terms = ((arm.study.arm.joint_names[number - 1], 1.0),)
    rest = -preload / stiffness
    if rest == -1.0:  # which means the length at the start
        rest = float(np.nextafter(rest, 0.0))
    attributes = {"stiffness": numbers(stiffness), "springlength": numbers(rest)}
    _fixed(tendons, terms, name=f"ground{number}", **attributes)


def add_shared_motor(
    tendons: ET.Element, arm: IdentifiedArm, number: int, terms: Terms, target: Target
) -> None:
    """A motor behind a rigid gear that turns with several joints."""
    attributes = motor_friction(arm, number, "springlength")
    if not is_rigid_drive(arm.study.arm) and target.has("armature"):
        attributes["armature"] = numbers(arm.need("motor_inertia", number))
    _fixed(tendons, terms, name=f"motor{number}", **attributes)


def _fixed(tendons: ET.Element, terms: Terms, **attributes: str) -> ET.Element:
    fixed = ET.SubElement(tendons, "fixed", attributes)
    for joint, weight in terms:
        ET.SubElement(fixed, "joint", joint=joint, coef=numbers(weight))
    return fixed


def actuator_name(arm: IdentifiedArm, number: int) -> str:
    """Name of the actuator of a joint."""
    return f"{'servo' if arm.study.arm.position_servo else 'drive'}{number}"


def add_actuator(
    actuators: ET.Element, arm: IdentifiedArm, number: int, target: Target, *, is_shared: bool
) -> None:
    """Voltage to torque (1), e u behind the current loop; or the position servo of the joint."""
    joint, servo = arm.joint(number), arm.study.arm.position_servo
    place, gear = {"joint": f"motor_joint{number}"}, 1.0
    if is_shared:
        place = {"tendon": f"motor{number}"}
    elif not joint.elastic:
        place = {"joint": arm.study.arm.joint_names[number - 1]}
        gear = 1.0 / joint.gear_ratio
    if servo is not None:
        # its angles and torques are those of the joint
        gear_of_servo = numbers(gear * joint.gear_ratio)
        attributes = {"name": actuator_name(arm, number), **place, "gear": gear_of_servo}
        _add_servo(actuators, arm, number, servo, target, attributes)
    else:
        drive = {"name": actuator_name(arm, number), **place, "gear": numbers(gear)}
        gain = joint.torque_per_command * (1.0 + arm.values.get(("drive_gain", number), 0.0))
        element = ET.SubElement(actuators, "general", drive, gainprm=numbers(gain))
        if (lag := lag_of(arm, number)) is not None:
            element.set("dyntype", "filterexact")
            element.set("dynprm", numbers(lag))
        if has_effect(arm, number, "drive-limit") and _is_representable(arm, number, "drive-limit"):
            limit = arm.need("drive_limit", number)
            element.set("ctrlrange", numbers(-limit, limit))
    if target.has("ripple") and has_effect(arm, number, "torque-ripple"):
        _add_ripple(actuators, arm, number, place | {"gear": numbers(gear)})


def _add_ripple(
    actuators: ET.Element, arm: IdentifiedArm, number: int, place: dict[str, str]
) -> None:
    """The torque a cos(k q) + b sin(k q) = A sin(k q + phase) over the motor angle."""
    if not _is_representable(arm, number, "torque-ripple"):
        return
    a, b = (arm.values.get((f"torque_ripple_{part}", number), 0.0) for part in ("cos", "sin"))
    cogging = math.hypot(a, b), arm.need("torque_ripple_order", number), math.atan2(a, b)
    passive = {"name": f"ripple{number}", "input": "none", "motorconst": "0", "resistance": "1"}
    ET.SubElement(actuators, "dcmotor", passive | place, cogging=numbers(*cogging))


def _add_servo(
    actuators: ET.Element,
    arm: IdentifiedArm,
    number: int,
    servo: PositionServo,
    target: Target,
    attributes: dict[str, str],
) -> None:
    """The servo kp (ref(t - T) - q) - kd dq within its limit; its control is the reference.

    The servo holds its output over a period h, on average h/2 late: that is -kp h/2 of damping,
    h/2 of delay of the reference, and -kd h/2 of inertia. The inertia is that of the motor of an
    elastic joint. For a rigid joint the gains are larger instead, by the same share: at its limit
    the servo does not change the inertia.
    """
    gains, share = servo_gains(arm, number, servo).continuous(servo.period), 1.0
    if not arm.joint(number).elastic:
        inertia = _inertia_of_joint(arm, number)
        share = inertia / (inertia - inertia_of_hold(arm, number, inertia))
    stiffness, damping = share * gains.stiffness, share * gains.damping
    # `position` has no damping before MuJoCo 3.1
    element = ET.SubElement(actuators, "general", attributes, biastype="affine")
    element.set("gainprm", numbers(stiffness))
    element.set("biasprm", numbers(0.0, -stiffness, -damping))
    if gains.limit is not None:
        element.set("forcerange", numbers(-gains.limit, gains.limit))
    if target.has("delay"):
        element.set("delay", numbers(gains.delay))
        element.set("nsample", str(math.ceil(gains.delay / STEP_S) + 1))


NOTE_OF_HOLD = (
    "the servo samples and holds: gains, delay and motor inertia of the file are those of the "
    "nearest continuous law"
)
_MAX_SHARE_OF_HOLD = 0.5  # of an inertia; a law that is later has no continuous one near it


def inertia_of_hold(arm: IdentifiedArm, number: int, inertia: float) -> float:
    """Inertia kd h/2 [kg m^2] by which the hold of a servo reduces that of its joint."""
    servo = arm.study.arm.position_servo
    if servo is None:
        return 0.0
    reduction = 0.5 * servo.period * servo_gains(arm, number, servo).damping
    return min(reduction, _MAX_SHARE_OF_HOLD * inertia)


def _inertia_of_joint(arm: IdentifiedArm, number: int) -> float:
    """Inertia [kg m^2] of a rigid joint with its motor and the links behind it, at zero angles."""
    chain = Arm.of(completion.chain_of(arm, 0.0))
    links = np.concatenate(completion.standard_links(arm, completion.effective_gravity(arm)))
    inertia = chain.inertia_matrix(links, np.zeros(chain.n_joints))[number - 1, number - 1]
    rotor = completion.rotor_inertias(arm)[number - 1]
    return float(inertia + rotor / arm.joint(number).gear_ratio ** 2)


SERVO_PARAMETERS = (
    *("servo", "servo_kp", "servo_kd", "servo_damping", "servo_delay", "torque_limit"),
)
"""Parts of a position servo."""


@dataclass(frozen=True, slots=True)
class ServoGains:
    """A position servo at its joint; torques are per unit of kp if that is unknown."""

    stiffness: float  # [N m/rad]
    damping: float  # [N m s/rad]
    delay: float  # [s]
    limit: float | None  # [N m]
    is_relative: bool  # torques are per kp: the stiffness is 1

    def continuous(self, period: float) -> ServoGains:
        """The nearest law in continuous time: stiffness (ref(t - delay) - q) - damping dq, limited.

        The servo holds its output over a period h, on average h/2 late: that is -h/2 stiffness of
        damping, and h/2 of delay. A simulation with semi-implicit Euler steps has the law in
        continuous time without such a change.
        """
        late = 0.5 * period
        damping = max(self.damping - late * self.stiffness, 0.0)
        return replace(self, damping=damping, delay=self.delay + late)


def servo_gains(arm: IdentifiedArm, number: int, servo: PositionServo) -> ServoGains:
    """Identified gains, or those of the study.

    Without a scale, all torques, inertias and friction of a joint are per kp: with kp = 1 the
    motion is the same. `servo_damping` contains the viscous friction.
    """
    values = arm.values
    stiffness = values.get(("servo_kp", number)) or servo.gain(number)
    damping = values.get(("servo_kd", number), servo.damping_gain(number))
    if damping is None:
        viscous = values.get(("link_viscous_friction", number), 0.0)
        viscous += values.get(("motor_viscous_friction", number), 0.0) / (
            arm.joint(number).gear_ratio ** 2
        )
        damping = max(values.get(("servo_damping", number), 0.0) - viscous, 0.0)
    delay = values.get(("servo_delay", number), servo.delay_of(number) or 0.0)
    limit = values.get(("torque_limit", number), servo.torque_limit(number))
    return ServoGains(stiffness or 1.0, damping, delay, limit, is_relative=stiffness is None)


def lag_of(arm: IdentifiedArm, number: JointNumber) -> float | None:
    """Time constant [s] of a drive; None: it has none, or one too short for the time step.

    MuJoCo holds the filtered torque over a step, which adds a lag of half a step. Its Runge-Kutta
    integrator diverges for time constants below 0.36 steps. The lag of the current loop and a
    further one of the drive (S30) are one first-order lag of their sum.
    """
    further, loop = arm.values.get(("drive_lag", number), 0.0), _loop_lag(arm.joint(number))
    if not further + loop:
        return None
    lag = further + loop - 0.5 * STEP_S
    return lag if lag > 0.5 * STEP_S else None


def _loop_lag(joint: Joint) -> float:
    return 1.0 / (2.0 * math.pi * joint.current_loop_hz) if joint.current_loop_hz else 0.0


def approximations(arm: IdentifiedArm, target: Target) -> tuple[Diagnostic, ...]:
    """Warnings on gears and drives that the file approximates."""
    warnings = []
    for number, joint in enumerate(arm.study.arm.joints, start=1):
        place, hz, need = (
            Place(joint=number),
            joint.current_loop_hz,
            partial(arm.need, joint=number),
        )
        is_cubic = joint.elastic and joint.law.parallel_springs(need) is None
        if is_cubic and not (target.has("polynomial") and joint.law.polynomial(need)):
            warnings.append(Diagnostic("linearised", place, note=joint.law.linearised_note))
        if hz and lag_of(arm, number) is None:
            warnings.append(Diagnostic("left-out", place, bandwidth_hz=hz, step=STEP_S))
    return tuple(warnings)


def losses_by_version(
    arm: IdentifiedArm, target: Target, shared: list[JointNumber]
) -> Iterator[Diagnostic]:
    """Gears, servos and motors of several joints for which a later version has an element."""
    joints = list(enumerate(arm.study.arm.joints, start=1))
    curved = [i for i, j in joints if j.elastic and j.law.polynomial(partial(arm.need, joint=i))]
    if curved and not target.has("polynomial"):
        yield target.loss("curvature of the gear", "polynomial", curved)
    if arm.study.arm.position_servo and not target.has("delay"):
        yield target.loss("delay of the servo", "delay", [i for i, _ in joints])
    if shared and not target.has("armature"):
        yield target.loss("motor_inertia", "armature", shared)
