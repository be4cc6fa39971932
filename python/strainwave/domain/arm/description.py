"""Description of an arm: a serial chain of joints with drives, gears, sensors and servos.

`strainwave.io.study` checks the constraints of `annotated_types`. The kinds of
`strainwave.domain.arm.kinds` construct descriptions from the `[arm]` tables of study files.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable
from dataclasses import dataclass, replace
from typing import Annotated, Any, Literal, Self

import numpy as np
from annotated_types import Ge, Gt, Le

from strainwave.domain.arm.effects import all_effects
from strainwave.domain.arm.gear_laws import AUTO, RIGID, GearLaw, determined_law, stated_law
from strainwave.domain.arm.parameter_table import base_name, parameter_table
from strainwave.domain.keys import BoolArray, ComplexArray, FloatArray, JointNumber, Key
from strainwave.errors import InvalidInput

_LARGEST = 1e12  # in SI units: beyond all rigs, and far below what overflows when it is squared
Positive = Annotated[float, Gt(0.0), Le(_LARGEST)]
NonNegative = Annotated[float, Ge(0.0), Le(_LARGEST)]

Motion = Literal["revolute", "prismatic"]
Spring = str  # name of a gear law, or "auto"
EffectName = str  # of one of `domain.effects`
Component = Annotated[float, Ge(-_LARGEST), Le(_LARGEST)]
Vector = tuple[Component, Component, Component]
Matrix = tuple[tuple[float, ...], ...]  # rows
Unknown = Literal["unknown"]
UNKNOWN: Unknown = "unknown"
Output = Literal["torque", "current", "duty"]  # of a position servo
LinkPrior = tuple[float, ...]  # the ten standard parameters of a link, in the order of the core

_PLANAR_PROGRAMS = ("planar-two-link", "single-joint")  # kinds with a compiled program


def _without_rounding(angle: float) -> float:
    """The multiple of pi/2 that an angle [rad] such as 1.5708 or 3.14 has the first digits of."""
    text = repr(float(angle))
    digits = len(text.partition(".")[2])
    if "e" in text or digits < 2:
        return angle
    multiple = round(angle / (0.5 * math.pi)) * 0.5 * math.pi
    truncated = math.trunc(multiple * 10**digits) / 10**digits
    return multiple if angle in (round(multiple, digits), truncated) else angle


@dataclass(frozen=True, slots=True)
class Origin:
    """Frame of a joint at zero angle in the frame of the link before it, as in URDF."""

    xyz: Vector = (0.0, 0.0, 0.0)  # [m]
    rpy: Vector = (0.0, 0.0, 0.0)  # [rad] roll, pitch and yaw

    def __post_init__(self) -> None:
        # axes that are parallel but for rounding would have base parameters that no motion shows
        roll, pitch, yaw = (_without_rounding(angle) for angle in self.rpy)
        object.__setattr__(self, "rpy", (roll, pitch, yaw))


@dataclass(frozen=True, slots=True)
class Imu:
    """Accelerometers and gyros in one case on a joint's link, at any position and attitude."""

    xyz: tuple[float, float, float] | None = None  # position [m] in the link's frame
    rpy: tuple[float, float, float] | None = None  # [rad] roll, pitch and yaw, as in URDF
    accelerometer_hz: Positive | None = None  # second-order Butterworth
    gyro_hz: Positive | None = None  # second-order Butterworth


@dataclass(frozen=True, slots=True)
class JointLimits:
    """Limits of a joint's motion and load, as in URDF; None: unknown or none."""

    lower: float | None = None  # [rad, m] position
    upper: float | None = None
    velocity: Positive | None = None  # [rad/s, m/s]
    effort: Positive | None = None  # [N m, N]


@dataclass(frozen=True, slots=True)
class Joint:
    """Placement, drive, gear and sensors of one joint: `[[joint]]`."""

    spring: Spring
    gear_ratio: float  # n, link turns (prismatic: m per rad) of the motor; not zero
    motion: Motion = "revolute"
    # e [N m/V], motor side; "unknown": estimated from records with and without a known payload
    torque_per_volt: Positive | Literal["unknown"] | None = None
    current_loop_hz: Positive | None = None
    encoder_counts: Positive | None = None  # per motor turn
    link_encoder_counts: Positive | None = None  # per turn of the link
    accelerometer_distance: Positive | None = None  # l_a [m]; None: estimated
    accelerometer_hz: Positive | None = None  # second-order Butterworth
    gyro_hz: Positive | None = None  # first-order low-pass
    imu: Imu | None = None
    # optional terms of the model; "auto": those that the data support
    effects: tuple[EffectName, ...] | Literal["auto"] = "auto"
    origin: Origin = Origin()
    axis: Vector = (0.0, 0.0, 1.0)  # in the joint's frame; its length does not matter
    name: str | None = None  # in the URDF and in exports
    limits: JointLimits | None = None
    # the logs have no torque of the motor, but that of a sensor between gear and link, which shows
    # neither the rotor's inertia nor the motor's friction
    torque_at_link: bool = False

    @property
    def torque_per_command(self) -> float:
        """Motor torque per unit of the input: e [N m/V]; 1 if it is a torque, or e unknown."""
        return self.known_torque_per_volt or 1.0

    @property
    def known_torque_per_volt(self) -> float | None:
        """E [N m/V]; None if it is not given."""
        return None if self.torque_per_volt == UNKNOWN else self.torque_per_volt

    @property
    def encoder_resolution(self) -> float:
        """One count of the motor encoder [rad]; zero if unknown."""
        return math.tau / self.encoder_counts if self.encoder_counts else 0.0

    @property
    def law(self) -> GearLaw:
        """Elastic law of the gear; the linear law while the data have not selected one."""
        return stated_law(self.spring)

    @property
    def elastic(self) -> bool:
        """Whether the gear is elastic."""
        return self.law.elastic

    @property
    def selects_law(self) -> bool:
        """Whether the fit selects the elastic law of this joint."""
        return self.spring == AUTO

    @property
    def selects_effects(self) -> bool:
        """Whether the fit selects the effects of this joint."""
        return self.effects == "auto"

    @property
    def named_effects(self) -> tuple[EffectName, ...]:
        """Effects that the study names."""
        return () if self.effects == "auto" else self.effects

    @property
    def possible_effects(self) -> tuple[EffectName, ...]:
        """Effects that the joint may have: the named ones, or all if the fit selects."""
        if self.effects != "auto":
            return self.effects
        return tuple(e.name for e in all_effects() if self.elastic or not e.needs_elastic_gear)


PI_VELOCITY: Literal["pi-velocity"] = "pi-velocity"
POSITION: Literal["position"] = "position"
SERVOS = (PI_VELOCITY, POSITION)
"""Kinds of servo of a study."""


@dataclass(frozen=True, slots=True)
class Servo:
    """PI velocity servo: u = kp e + ki integral(e), e = reference - encoder difference / period.

    With `position_gain`, e contains position_gain (theta_M(0) + integral(reference) - encoder) in
    addition.
    """

    kind: Literal["pi-velocity"]
    period: Positive  # [s]
    kp: tuple[NonNegative, ...]  # [V s/rad], one per joint
    ki: tuple[NonNegative, ...]  # [V/rad], one per joint
    limit: Positive  # [V]
    position_gain: tuple[NonNegative, ...] | None = None  # [1/s], one per joint


@dataclass(frozen=True, slots=True)
class PositionServo:
    """PD servos with feed-forward, one per joint, on the angles of the joints.

        v = sat(kp (ref(t - T) - q) - kd dq + feed-forward)

    It is sampled at `period` and held. The output v is a torque [N m] at the joint; a current [A]
    with the torque `torque_constant` v; or a duty of 1 at most, with the torque
    `stall_torque` (v - dq / no_load_speed). Gains and limits have the unit of the output.
    """

    kind: Literal["position"]
    period: Positive  # [s]
    kp: tuple[Positive | Unknown, ...]  # [N m/rad, A/rad, 1/rad]
    kd: tuple[NonNegative | Unknown, ...]  # [N m s/rad, A s/rad, s/rad]
    delay: NonNegative | Unknown | tuple[NonNegative | Unknown, ...] = UNKNOWN  # [s]
    limit: tuple[Positive | Unknown, ...] | None = None  # [N m, A, 1]; None: unknown
    output: Output = "torque"
    torque_constant: tuple[Positive, ...] | None = None  # [N m/A] at the joint
    stall_torque: tuple[Positive | Unknown, ...] | None = None  # [N m] at the joint
    no_load_speed: tuple[Positive | Unknown, ...] | None = None  # [rad/s] of the joint

    def gain(self, joint: JointNumber) -> float | None:
        """Proportional gain [N m/rad] of a joint; None if it is unknown."""
        return self._torque(self.kp[joint - 1], joint)

    def damping_gain(self, joint: JointNumber) -> float | None:
        """Derivative gain [N m s/rad] of a joint; None if it is unknown."""
        return self._torque(self.kd[joint - 1], joint)

    def torque_limit(self, joint: JointNumber) -> float | None:
        """Largest torque [N m] of the output of a joint; None if it is unknown."""
        limit = UNKNOWN if self.limit is None else self.limit[joint - 1]
        if self.output == "duty" and limit == UNKNOWN:
            limit = 1.0
        return self._torque(limit, joint)

    def delay_of(self, joint: JointNumber) -> float | None:
        """Delay [s] of the reference of a joint; None if it is unknown."""
        delay = self.delay[joint - 1] if isinstance(self.delay, tuple) else self.delay
        return None if delay == UNKNOWN else float(delay)

    def back_emf_damping(self, joint: JointNumber) -> float | None:
        """Damping [N m s/rad] of a joint by the back-EMF; None if it is unknown."""
        if self.output != "duty":
            return 0.0
        speed = self.no_load_speed[joint - 1] if self.no_load_speed else UNKNOWN
        torque = self.torque_per_output(joint)
        return None if torque is None or isinstance(speed, str) else torque / speed

    def torque_per_output(self, joint: JointNumber) -> float | None:
        """Torque at standstill per unit of the output; None if it is unknown."""
        if self.output == "torque":
            return 1.0
        known = self.torque_constant if self.output == "current" else self.stall_torque
        value = UNKNOWN if known is None else known[joint - 1]
        return None if isinstance(value, str) else value

    def _torque(self, output: float | Unknown, joint: JointNumber) -> float | None:
        scale = self.torque_per_output(joint)
        return None if scale is None or isinstance(output, str) else scale * output


@dataclass(frozen=True, slots=True)
class Urdf:
    """The URDF file that places the joints, and the inertial values in it."""

    file: str  # relative to the study file
    priors: tuple[LinkPrior, ...]  # of the links from the base
    held: tuple[str, ...] = ()  # joints that stay at zero


@dataclass(frozen=True, slots=True)
class ArmDescription:
    """A serial chain on a fixed base, with its servo.

    Frames, axes and angles are those of URDF. Link angles are C N theta_M: C is `coupling`, the
    transmission between joints, and N holds the gear ratios.
    """

    kind: str  # of `domain.kinds`; selects the compiled program and names of combinations
    joints: tuple[Joint, ...]  # in order from the base
    gravity: Vector | None = None  # [m/s^2] in the frame of the base; None: without gravity
    coupling: Matrix | None = None  # C, (n_joints, n_joints): `[transmission]`; None: identity
    servo: Servo | None = None
    urdf: Urdf | None = None
    position_servo: PositionServo | None = None  # in place of `servo`: logs without torque

    @property
    def n_joints(self) -> int:
        """Number of joints."""
        return len(self.joints)

    @property
    def gravity_size(self) -> float:
        """Size of gravity [m/s^2]; zero without gravity."""
        return math.hypot(*self.gravity) if self.gravity else 0.0

    @property
    def is_coupled(self) -> bool:
        """Whether a motor moves several joints."""
        return bool(self.coupled_joints)

    @property
    def coupled_joints(self) -> frozenset[JointNumber]:
        """Joints that several motors move, or whose motor moves several joints."""
        coupled = np.array(self.coupling or np.zeros((self.n_joints,) * 2)) != 0.0
        np.fill_diagonal(coupled, val=False)
        return frozenset((np.flatnonzero(coupled.any(axis=0) | coupled.any(axis=1)) + 1).tolist())

    @property
    def has_planar_program(self) -> bool:
        """Whether the core has a compiled program of this kind, for motion in the xy plane."""
        return self.kind in _PLANAR_PROGRAMS

    @property
    def unknown_drives(self) -> tuple[JointNumber, ...]:
        """Joints whose torque per volt is unknown."""
        numbered = enumerate(self.joints, start=1)
        return tuple(number for number, joint in numbered if joint.torque_per_volt == UNKNOWN)

    @property
    def rigid_joints(self) -> tuple[JointNumber, ...]:
        """Joints with rigid gears."""
        return tuple(n for n, joint in enumerate(self.joints, start=1) if not joint.elastic)

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the joints in models for other programs: `joint1` for a joint without name."""
        numbered = enumerate(self.joints, start=1)
        return tuple(joint.name or f"joint{number}" for number, joint in numbered)

    def with_joints(self, joints: Iterable[Joint]) -> Self:
        """Copy of the arm with other joints."""
        return replace(self, joints=tuple(joints))

    def with_joint(self, number: JointNumber, **changes: Any) -> Self:
        """Copy of the arm with other values of one joint."""
        joints = list(self.joints)
        joints[number - 1] = replace(joints[number - 1], **changes)
        return self.with_joints(joints)

    def with_selected_laws(self, known: Collection[Key]) -> Self:
        """Copy with the laws of gears with `spring = "auto"` that known (name, joint) determine."""
        arm = self
        for number, joint in enumerate(self.joints, start=1):
            if joint.selects_law:
                law = determined_law(AUTO, [key[0] for key in known if key[1] == number])
                arm = arm.with_joint(number, spring=law.name)
        return arm

    def behind_rigid_gears(self) -> Self:
        """Copy of the arm with rigid gears and without effects."""
        return self.with_joints(replace(j, spring=RIGID, effects=()) for j in self.joints)


def unit_of(name: str, joint: Joint | None = None) -> str:
    """SI unit of a parameter, by its name in docs/notation.md; None for a parameter of the arm.

    Raises KeyError if there is no parameter of that name.
    """
    return parameter_table()[base_name(name)].units[
        joint is not None and joint.motion == "prismatic"
    ]


def unit_in(arm: ArmDescription, key: Key) -> str:
    """SI unit of a parameter of an arm, by name and joint."""
    name, joint = key
    return unit_of(name, None if joint is None else arm.joints[joint - 1])


INPUTS = ("reference_angle", "reference_velocity", "motor_angle")
"""Inputs of a law."""

MAX_LAW_STATES = 16  # of the core
_RANK_TOLERANCE = 1e-12  # of singular values; the slowest filter or observer is far above


@dataclass(frozen=True, slots=True, eq=False)
class ControlLaw:
    """Sampled control law of one joint: gains, filters and observer as one linear system.

    From a reading of the motor angle y_k [rad] to the voltage u_k [V]:

        v_k = C x_k + D (r_k, w_k, y_k),   u_k = v_k + feed-forward_k, limited
        x_k+1 = A x_k + B (r_k, w_k, y_k) + E (u_k - feed-forward_k)

    w_k [rad/s] is the velocity of the reference, r_k = y_0 + T (w_0 + ... + w_k-1) [rad] its angle,
    and T the period. E multiplies the voltage that reaches the motor without the feed-forward,
    which is v_k if the voltage is not limited: an observer with this input models the deviation
    from the motion that the feed-forward drives. States that hold, such as integrators, keep their
    value while the voltage is limited.
    """

    A: FloatArray  # (n, n)
    B: FloatArray  # (n, 3)
    C: FloatArray  # (n,)
    D: FloatArray  # (3,)
    E: FloatArray  # (n,)
    holds: BoolArray  # (n,) states that keep their value while the voltage is limited
    names: tuple[str, ...] = ()

    def feedback(self, z: ComplexArray) -> ComplexArray:
        """Response from the motor angle to minus the voltage."""
        closed = self.A + np.outer(self.E, self.C)
        inputs = self.B[:, 2] + self.E * self.D[2]
        states = np.linalg.solve(
            z[:, None, None] * np.eye(len(closed)) - closed,
            np.broadcast_to(inputs[:, None], (len(z), len(inputs), 1)),
        )[..., 0]
        return np.asarray(-(states @ self.C + self.D[2]))

    def rest(self) -> FloatArray:
        """States at rest per motor angle and per voltage, (n, 2): x = rest @ (angle, voltage).

        The reference is the motor angle, and the states are constant:

            (A - I) x = -(B (angle, 0, angle) + E voltage)

        Where this leaves states undetermined, as that of an integrator, the output is the voltage:
        C x + D (angle, 0, angle) = voltage. Both equations are solved by least squares with the
        smallest x. A law without an integrator cannot hold a voltage; its states are at rest.
        """
        n = len(self.A)
        steady = np.column_stack([self.B[:, 0] + self.B[:, 2], self.E])
        left, sizes, right = np.linalg.svd(self.A - np.eye(n))
        rank = int(np.sum(sizes > _RANK_TOLERANCE * sizes.max(initial=0.0)))
        x = -right[:rank].T @ ((left.T @ steady)[:rank] / sizes[:rank, None])
        free = right[rank:].T
        by_free = self.C @ free
        power = by_free @ by_free
        if power > (_RANK_TOLERANCE**2) * (self.C @ self.C):
            missing = np.array([-self.D[0] - self.D[2], 1.0]) - self.C @ x
            x = x + np.outer(free @ by_free / power, missing)
        return np.asarray(x)


@dataclass(frozen=True, slots=True, eq=False)
class LinearServo:
    """Control laws of all joints.

    Raises InvalidInput if a law has more than MAX_LAW_STATES states.
    """

    laws: tuple[ControlLaw, ...]  # one per joint
    period: float  # [s]
    limit: float  # [V]

    def __post_init__(self) -> None:
        sizes = [len(law.A) for law in self.laws]
        if max(sizes, default=0) > MAX_LAW_STATES:
            raise InvalidInput(
                f"a control law has {max(sizes)} states, but at most {MAX_LAW_STATES} are possible",
                remedy="reduce the number of filters",
            )
