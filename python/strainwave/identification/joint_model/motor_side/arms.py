"""Family of arms that the search for gears on the motor side considers.

The rigid model gives the total inertia of each joint, c_1 = m_M + n^2 m_L, its viscous friction c_0
= d_M + n^2 d_L and its Coulomb friction. The coordinates of the search are the gear parameters and
the motor's share of the inertia. For a single joint without a rigid model, c_1 and c_0 are
coordinates too.

Linearised about a posture, an arm with elastic gears moves by

    A q_L = K_s T q_M,   A = M s^2 + D_L s + G + K_s,   K_s = diag(k + d_G s),   T = C N
    u = (m_M s + d_M) w + T^T K_s (T q_M - q_L),   w = s q_M

With Z(s) of u = Z w, the poles of Z are the modes with all motors held, the anti-resonances. 1/Z_ii
is the response of a motor with the others held; Z^-1 with the others free.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from strainwave.domain import ComplexArray, FloatArray, RigidModel
from strainwave.domain.arm.combinations import FRICTION_COLUMNS, LINK_INERTIA, inertias_of_links
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.rigid_prediction import base_parameters, total_inertias
from strainwave.dynamics.two_inertia import TwoInertia

COORDINATES_PER_JOINT = 3
"""Number of coordinates of each joint: log k, log d_G, log odds of the motor's share of c_1."""

NO_ARM = (
    "the inertias of the rigid model belong to no arm: whatever part of joint 1's is the motor's,"
    " the links' inertia matrix is not positive definite"
)
"""Message if the inertia matrix of no arm of a family is positive definite."""

_DIFFERENCE_STEP = 1e-4  # [rad] step for central differences
# minimum relative standard deviation of a motor inertia from the rigid model
_MIN_RELATIVE_STD = 0.02
_MAX_SHARE = 0.99  # maximum motor's share of c_1 from the rigid model
_START_DECAY_RATE = 0.5  # [1/s] starting value of c_0 / c_1
_MIN_DECAY_RATE = 0.01  # [1/s] least c_0 / c_1 of a rigid model
# motor's share of the viscous friction, which motor signals do not determine
_MOTOR_VISCOUS_SHARE = 0.5
_RIGID_FREQUENCY = 1e5  # [rad/s] anti-resonance of a rigid gear with all of its joint's inertia


@dataclass(frozen=True, slots=True)
class Posture:
    """Contribution of each base parameter to inertia matrix and gravity stiffness in a posture."""

    inertia: FloatArray  # (n_base, n_joints, n_joints) of M(q)
    gravity: FloatArray  # (n_base, n_joints, n_joints) of the derivative of gravity torques


def posture_of(arm: Arm, angle: FloatArray) -> Posture:
    """Inertia matrix and gravity stiffness per base parameter, at link angles (n_joints,) [rad]."""
    unit = np.eye(arm.n_joints)
    rest, angles = np.zeros_like(unit), np.tile(angle, (arm.n_joints, 1))
    inertia = arm.base_regressor(angles, rest, unit) - arm.base_regressor(angles, rest, rest)
    above, below = (
        arm.base_regressor(angle + step * unit, rest, rest)
        for step in (_DIFFERENCE_STEP, -_DIFFERENCE_STEP)
    )
    gravity = (above - below) / (2.0 * _DIFFERENCE_STEP)
    # by moved joint, torque and parameter
    return Posture(np.transpose(inertia, (2, 1, 0)), np.transpose(gravity, (2, 1, 0)))


@dataclass(frozen=True, slots=True)
class ConsistentArms:
    """All arms that are consistent with a rigid model."""

    arm: Arm
    ratio: FloatArray  # (n_joints,)
    total_inertia: FloatArray | None  # (n_joints,) c_1 [kg m^2], motor side; None: coordinate
    total_viscous: FloatArray | None  # (n_joints,) c_0 [N m s/rad]; None: coordinate
    coulomb: FloatArray | None  # (n_joints,) [N m]; None: estimated per record
    base: FloatArray  # (n_base,) base parameters, those of link inertias replaced
    known_share: FloatArray  # (n_joints,) motor's share of c_1 from the rigid model; NaN: unknown
    known_deviation: FloatArray  # (n_joints,) standard deviation of the log of that inertia
    viscous_std: FloatArray  # (n_joints,) standard deviation of c_0; zero if it is a coordinate
    # (n_base, n_joints) change of `base` per motor inertia where motion determines combinations
    base_per_motor: FloatArray

    @property
    def n_joints(self) -> int:
        """Number of joints."""
        return len(self.ratio)

    def point(
        self, ring: FloatArray, share: FloatArray, damping: float, total: FloatArray | None = None
    ) -> FloatArray:
        """Coordinates (..., n_coordinates) of arms with given anti-resonances.

        `ring` (..., n_joints) [rad/s] is sqrt(k / m_L) of each joint, `share` (..., n_joints) the
        motor's share of each c_1, and `damping` the damping ratio of the anti-resonances. `total`
        (..., n_joints) [kg m^2] is c_1 if the rigid model does not give it.
        """
        c1 = np.asarray(total if self.total_inertia is None else self.total_inertia)
        link = (1.0 - share) * c1 / self.ratio**2
        gears = np.log(ring**2 * link), np.log(2.0 * damping * ring * link)
        blocks = np.stack([*gears, np.log(share / (1.0 - share))], axis=-1)
        blocks = blocks.reshape(*ring.shape[:-1], -1)
        if self.total_inertia is not None:
            return blocks
        return np.concatenate([blocks, np.log(c1), np.log(_START_DECAY_RATE * c1)], axis=-1)

    def parts(self, points: FloatArray) -> dict[str, FloatArray]:
        """Physical parameters at points, (..., n_joints) per name of `TwoInertia`."""
        n = self.n_joints
        gears = points[..., : COORDINATES_PER_JOINT * n].reshape(
            *points.shape[:-1], n, COORDINATES_PER_JOINT
        )
        share = 1.0 / (1.0 + np.exp(-gears[..., 2]))
        total, viscous = self.total_inertia, self.total_viscous
        if total is None or viscous is None:
            total, viscous = np.exp(points[..., -2 * n : -n]), np.exp(points[..., -n:])
        viscous = np.broadcast_to(viscous, share.shape)
        stiffness, damping = np.exp(gears[..., 0]), np.exp(gears[..., 1])
        rigid = [number - 1 for number in self.arm.rigid_joints]  # their coordinates have no effect
        stiffness[..., rigid] = (_RIGID_FREQUENCY**2 * total / self.ratio**2)[..., rigid]
        damping[..., rigid] = 0.0
        return {
            "motor_inertia": share * total,
            "motor_viscous_friction": _MOTOR_VISCOUS_SHARE * viscous,
            "link_inertia": (1.0 - share) * total / self.ratio**2,
            "link_viscous_friction": (1.0 - _MOTOR_VISCOUS_SHARE) * viscous / self.ratio**2,
            "gear_stiffness": stiffness,
            "gear_damping": damping,
        }

    def joints(self, point: FloatArray) -> list[TwoInertia]:
        """Two-inertia model of each joint at a point (n_coordinates,)."""
        parts = self.parts(point)
        return [
            TwoInertia(**{name: float(x[i]) for name, x in parts.items()}, gear_ratio=float(n))
            for i, n in enumerate(self.ratio)
        ]

    def least_inertia(self, points: FloatArray) -> FloatArray:
        """Least eigenvalue of the inertia matrix, arm stretched and at right angles [kg m^2].

        Maps points (..., n_coordinates) to (...,). No arm has an eigenvalue of zero or less.
        """
        base = self._base(self.parts(points)["link_inertia"])
        least = np.full(points.shape[:-1], np.inf)
        for angle in (0.0, 0.5 * np.pi):
            posture = posture_of(self.arm, np.full(self.n_joints, angle))
            inertia = np.tensordot(base, posture.inertia, axes=1)
            least = np.minimum(least, np.linalg.eigvalsh(inertia)[..., 0])
        return least

    def linear(self, points: FloatArray, posture: Posture) -> LinearisedArms:
        """The arms at the points, linearised about a posture."""
        parts = self.parts(points)
        base = self._base(parts.pop("link_inertia"))
        inertia = np.asarray(np.tensordot(base, posture.inertia, axes=1))
        gravity = np.asarray(np.tensordot(base, posture.gravity, axes=1))
        return LinearisedArms(self.arm.transmission, inertia=inertia, gravity=gravity, **parts)

    def _base(self, link_inertia: FloatArray) -> FloatArray:
        """Base parameters (..., n_base) of arms with these link inertias when stretched."""
        if self.arm.base.has_groups and self.total_inertia is not None:
            known = np.nan_to_num(self.known_share) * self.total_inertia
            motor = self.total_inertia - self.ratio**2 * link_inertia
            return np.asarray(self.base + (motor - known) @ self.base_per_motor.T)
        base = np.broadcast_to(self.base, (*link_inertia.shape[:-1], len(self.base))).copy()
        at = {key: k for k, key in enumerate(self.arm.base_names)}
        for key, row in inertias_of_links(self.arm):
            total = np.zeros(link_inertia.shape[:-1])
            for part, weight in row.items():
                if part[0] == LINK_INERTIA and part[1] is not None:
                    total += weight * link_inertia[..., part[1] - 1]
                else:
                    total += weight * base[..., at[part]]
            base[..., at[key]] = total
        return base


def family_of(model: RigidModel | None, arm: Arm) -> ConsistentArms:
    """All arms that are consistent with a rigid model; without one, all single joints.

    Raises `NotIdentifiable` if the rigid model lacks an inertia.
    """
    n = arm.n_joints
    ratio, unknown = arm.gear_ratios, np.full(n, np.nan)
    if model is None:
        base = np.zeros(len(arm.base_names))
        fixed = np.zeros((len(base), n))
        return ConsistentArms(
            arm, ratio, None, None, None, base, unknown, unknown, np.zeros(n), fixed
        )
    total = total_inertias(model, arm)
    share, share_std = unknown.copy(), unknown.copy()
    for parameter in model.parameters:
        is_motor_inertia = parameter.name == "motor_inertia" and parameter.joint is not None
        if is_motor_inertia and parameter.value and parameter.value > 0.0:
            i = (parameter.joint or 1) - 1
            share[i] = min(_MAX_SHARE, parameter.value / total[i])
            relative_std = (parameter.std or 0.0) / parameter.value
            share_std[i] = max(relative_std, _MIN_RELATIVE_STD)
    numbers = range(1, n + 1)
    stds = {parameter.key: parameter.std or 0.0 for parameter in model.parameters}
    viscous_keys = [arm.rigid_columns[arm.n_body + FRICTION_COLUMNS * k].key for k in range(n)]
    viscous = [model.value(*key) or 0.0 for key in viscous_keys]
    coulomb = [model.value("motor_coulomb_friction", i) or 0.0 for i in numbers]
    return ConsistentArms(
        arm,
        ratio,
        total,
        np.maximum(viscous, _MIN_DECAY_RATE * total),
        np.maximum(coulomb, 0.0),
        base_parameters(model, arm),
        share,
        share_std,
        np.array([stds[key] for key in viscous_keys]),
        _base_per_motor(model, arm),
    )


def _base_per_motor(model: RigidModel, arm: Arm) -> FloatArray:
    """Expected change of the link parameters per motor inertia, (n_base, n_joints).

    An inertia that rigid motion does not separate moves from links to motor; the errors of a
    separate motor inertia are correlated with those of other parameters.
    """
    change, base = arm.base.links_per_motor.copy(), arm.links_of_rigid()
    motors = [
        (k, column.joint - 1)
        for k, column in enumerate(arm.rigid_columns)
        if column.name == "motor_inertia"
        and column.joint is not None
        and model.covariance[k, k] > 0.0
    ]
    places = [k for k, _ in motors]
    covariance = np.nan_to_num(model.covariance[: arm.n_body, places])
    regression = np.linalg.pinv(
        np.nan_to_num(model.covariance[np.ix_(places, places)]), hermitian=True
    )
    change[:, [i for _, i in motors]] += base @ covariance @ regression
    return change


@dataclass(frozen=True, slots=True)
class LinearisedArms:
    """One or many arms of n joints with linear gears, linearised about a posture."""

    transmission: FloatArray  # (n, n) T, link angles per motor angle
    motor_inertia: FloatArray  # (..., n) m_M [kg m^2]
    motor_viscous_friction: FloatArray  # (..., n) d_M [N m s/rad]
    link_viscous_friction: FloatArray  # (..., n) d_L [N m s/rad]
    gear_stiffness: FloatArray  # (..., n) k [N m/rad]
    gear_damping: FloatArray  # (..., n) d_G [N m s/rad]
    inertia: FloatArray  # (..., n, n) M of the links in the posture [kg m^2]
    gravity: FloatArray  # (..., n, n) G, derivative of gravity torques [N m/rad]

    def derivative(
        self, above: LinearisedArms, below: LinearisedArms, step: float
    ) -> LinearisedArms:
        """Central differences of the parameters, with the transmission of this arm."""
        names = [each.name for each in fields(self)[1:]]
        changes = [(getattr(above, name) - getattr(below, name)) / (2.0 * step) for name in names]
        return LinearisedArms(self.transmission, *changes)

    def motor(
        self, s: ComplexArray, torque: ComplexArray, velocity: ComplexArray, row: int
    ) -> MotorMotion:
        """Motion of motor `row`, from 0, at the measured velocities (n_lines, n) of all motors.

        `s` (n_lines,) [rad/s] must not be zero. `torque` (n_lines,) is that of the motor without
        Coulomb friction.
        """
        own = self.transmission[:, row] / s[:, None]
        turned = np.stack([velocity @ self.transmission.T / s[:, None], own], axis=-1)
        gear = self.gear_stiffness[..., None, :] + self.gear_damping[..., None, :] * s[:, None]
        identity, s2 = np.eye(len(self.transmission)), s[:, None, None]
        viscous = self.link_viscous_friction[..., None, :, None] * identity
        stiffness = self.inertia[..., None, :, :] * s2**2 + viscous * s2
        stiffness = stiffness + self.gravity[..., None, :, :] + gear[..., None] * identity
        links = _solve(stiffness, gear[..., None] * turned)
        torsion = turned - links
        motor = self.motor_inertia[..., None, row] * s + self.motor_viscous_friction[..., None, row]
        gears = ((self.transmission[:, row] * gear)[..., None] * torsion).sum(axis=-2)
        impedance = motor + gears[..., 1]
        error = (motor * velocity[:, row] + gears[..., 0] - torque) / impedance
        return MotorMotion(s, row, velocity[:, row], links, torsion, impedance, error)


@dataclass(frozen=True, slots=True)
class MotorMotion:
    """One motor at the measured velocities of all motors, or at a velocity of one of its own."""

    s: ComplexArray  # (n_lines,)
    row: int  # the motor, from 0
    velocity: ComplexArray  # (n_lines,) measured
    links: ComplexArray  # (..., n_lines, n, 2) motion of the links, for both
    torsion: ComplexArray  # (..., n_lines, n, 2) of the gears, for both
    impedance: ComplexArray  # (..., n_lines) Z_ii
    error: ComplexArray  # (..., n_lines) velocity minus that of measured torque and other motors

    def derivatives(self, changes: LinearisedArms) -> tuple[ComplexArray, ComplexArray]:
        """Derivatives of `error` and `impedance` of one arm by the parameters.

        `changes` are the derivatives of the arm by n_coordinates, their first axis. Both results
        are (n_coordinates, n_lines). Reciprocity gives them without another solution: A is
        symmetric, so that the links' motion at unit velocity weighs the torques of all gears.
        """
        s, count = self.s, len(self.s)
        motor = changes.motor_inertia[:, self.row, None] * s
        motor = motor + changes.motor_viscous_friction[:, self.row, None]
        torque = []
        for moving, velocity in ((0, self.velocity), (1, np.ones_like(s))):
            strain = (self.torsion[..., 1] * self.torsion[..., moving]).T
            product = self.links[:, :, None, 1] * self.links[:, None, :, moving]
            flat, own = product.reshape(count, -1).T, np.diagonal(product, axis1=1, axis2=2).T
            links = changes.inertia.reshape(len(motor), -1) @ (flat * s**2)
            links += changes.gravity.reshape(len(motor), -1) @ flat
            links += changes.link_viscous_friction @ (own * s)
            gears = changes.gear_stiffness @ strain + changes.gear_damping @ (strain * s)
            torque.append(motor * velocity + s * (gears + links))
        return (torque[0] - self.error * torque[1]) / self.impedance, torque[1]


def _solve(matrices: ComplexArray, right: ComplexArray) -> ComplexArray:
    """Solutions of small systems (..., n, n). Closed forms up to n = 2 are ten times faster."""
    n = matrices.shape[-1]
    if n > 2:
        return np.asarray(np.linalg.solve(matrices, right))
    if n == 1:
        return np.asarray(right / matrices)
    a, b, c, d = (matrices[..., i, k, None] for i in (0, 1) for k in (0, 1))
    first, second = right[..., 0, :], right[..., 1, :]
    solution = np.stack([d * first - b * second, a * second - c * first], axis=-2)
    return np.asarray(solution / (a * d - b * c)[..., None, :])
