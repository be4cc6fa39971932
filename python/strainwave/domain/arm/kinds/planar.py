"""Arms that move in one plane: two links with parallel axes, and a single joint.

Two links have alpha, beta and gamma of (3):

    M(q) = [alpha + beta + 2 gamma cos q2, beta + gamma cos q2; beta + gamma cos q2, beta]

One joint, revolute or prismatic, has c_1 = m_M + n^2 m_L, motor side, (18).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from strainwave.domain.arm.description import (
    ArmDescription,
    Joint,
    NonNegative,
    Origin,
    Positive,
    Servo,
    Vector,
)
from strainwave.domain.arm.kinds.base import (
    MOTOR_SHARE,
    Body,
    Fault,
    Kind,
    ParameterLookup,
    StageInertias,
    is_positive,
    require_positive,
)
from strainwave.domain.keys import Key, Row, Values
from strainwave.domain.messages import Clause
from strainwave.errors import InvalidInput

_ASSUMED_LENGTH = 1.0  # [m] of a link if the study gives none
_ALPHA: Key = ("alpha", None)
_BETA: Key = ("beta", None)
_GAMMA: Key = ("gamma", None)
# M(q) is positive definite if alpha > gamma^2 / beta. Both factors multiply that bound.
_MIN_ALPHA_FACTOR = 1.05  # an estimate below it leaves no margin for a search
_STARTING_ALPHA_FACTOR = 1.5  # alpha if no estimate is usable
_RECORD_FASTER_MOTIONS = "record faster motions of both joints and identify again"


@dataclass(frozen=True, slots=True)
class PlanarTable:
    """Keys of `[arm]`."""

    link_length: Positive  # l_1 [m], from axis 1 to axis 2
    gravity: NonNegative | None = None  # [m/s^2] along -y in the plane of motion


def planar_two_link(
    joints: Iterable[Joint],
    link_length: float,
    gravity: float | None = None,
    servo: Servo | None = None,
) -> ArmDescription:
    """Two links in one plane, along +x at zero angle; `link_length` and `gravity` as in the table.

    Both axes point along +z, gravity along -y.
    """
    first, second = joints
    second = replace(second, origin=Origin((link_length, 0.0, 0.0)))
    return ArmDescription(
        "planar-two-link", (first, second), in_plane_gravity(gravity), servo=servo
    )


class PlanarTwoLink(Kind[PlanarTable]):
    """Joint 2 sits at the end of link 1 with its axis parallel to that of joint 1."""

    name = "planar-two-link"
    max_joints = 2
    table = PlanarTable
    gravity_note = "gravity_torque_2 link_length/gamma"

    def standard_rows(self, arm: ArmDescription) -> Mapping[Key, Row]:
        """Both centres of mass are on the x axes of their links."""
        length, g = _link_length(arm), arm.gravity_size
        mass, first, second = ("link_mass", 2), *((("link_first_moment_x", i)) for i in (1, 2))
        return {
            _ALPHA: {("link_inertia_zz", 1): 1.0, mass: length**2},
            _BETA: {("link_inertia_zz", 2): 1.0},
            _GAMMA: {second: length},
            ("gravity_torque_1", None): {first: g, mass: g * length},
            ("gravity_torque_2", None): {second: g},
        }

    def rigid_combinations(self, arm: ArmDescription) -> Mapping[Key, Row]:
        """Alpha + m_M1/n_1^2, (6)."""
        reflected = arm.joints[0].gear_ratio ** -2
        return {("rigid_inertia", 1): {_ALPHA: 1.0, ("motor_inertia", 1): reflected}}

    def starting_inertias(
        self, arm: ArmDescription, estimates: StageInertias
    ) -> tuple[Values, Values]:
        """Beta and alpha from the joint models, gamma from the rigid model."""
        motor, link, rejected = dict(estimates.motor), estimates.link, Values()
        n2 = [joint.gear_ratio**2 for joint in arm.joints]
        gamma, beta = estimates.require_rigid("gamma"), link[2]
        if not is_positive(beta):
            rejected[_BETA] = beta
            beta = require_positive("beta", estimates.require_rigid("beta"))
        if not is_positive(motor[2]):
            rejected["motor_inertia", 2] = motor[2]
            known = estimates.rigid.get(("motor_inertia", 2))
            motor[2] = known if known is not None and is_positive(known) else n2[1] * beta
        rigid = estimates.rigid.get(("rigid_inertia", 1))
        if not is_positive(motor[1]):
            rejected["motor_inertia", 1] = motor[1]
            total = rigid if rigid is not None and is_positive(rigid) else link[1]
            motor[1] = MOTOR_SHARE * n2[0] * require_positive("rigid_inertia of joint 1", total)
        alpha, bound = link[1] - beta - 2.0 * gamma, gamma**2 / beta
        if not np.isfinite(alpha) or alpha <= max(0.0, _MIN_ALPHA_FACTOR * bound):
            rejected[_ALPHA] = alpha
            alpha = max((rigid or 0.0) - motor[1] / n2[0], _STARTING_ALPHA_FACTOR * bound)
        start: Values = {_ALPHA: alpha, _BETA: beta, _GAMMA: gamma}
        return start | {("motor_inertia", i): motor[i] for i in (1, 2)}, rejected

    def contradictions(self, values: Values) -> Mapping[Key, Clause]:
        """Gamma, unless M(q) is positive definite in every posture: alpha beta > gamma^2."""
        if not {_ALPHA, _BETA, _GAMMA} <= values.keys():
            return {}
        product, square = values[_ALPHA] * values[_BETA], values[_GAMMA] ** 2
        if min(values[_ALPHA], values[_BETA]) <= 0.0 or square < product:
            return {}
        return {_GAMMA: Clause("reason/gamma", square=square, product=product)}

    def complete(self, known: Values, arm: ArmDescription) -> None:
        """Alpha from `link_inertia` of joint 1, or from `rigid_inertia` and the motor's inertia."""
        beta, gamma = known.get(_BETA), known.get(_GAMMA)
        if _ALPHA in known or beta is None or gamma is None:
            return
        n2 = arm.joints[0].gear_ratio ** 2
        rigid, motor = known.get(("rigid_inertia", 1)), known.get(("motor_inertia", 1))
        if ("link_inertia", 1) in known:
            known[_ALPHA] = known["link_inertia", 1] - beta - 2.0 * gamma
        elif rigid is not None and motor is not None:
            known[_ALPHA] = rigid - motor / n2
        elif rigid is not None and not arm.joints[0].elastic:
            # the motor gets all of rigid_inertia except the share that M(q) > 0 needs
            known[_ALPHA] = min(_STARTING_ALPHA_FACTOR * gamma**2 / beta, rigid)
        if motor is None and rigid is not None and _ALPHA in known:
            known["motor_inertia", 1] = (rigid - known[_ALPHA]) * n2

    def faults(self, table: PlanarTable, joints: Sequence[Joint]) -> Iterator[Fault]:
        """A wrong number of joints, or a prismatic joint."""
        if len(joints) != 2:
            yield _wrong_number_of_joints("planar-two-link", len(joints), 2)
        for index, joint in enumerate(joints):
            if joint.motion == "prismatic":
                yield Fault(
                    "a planar two-link arm has revolute joints only",
                    'use kind = "single-joint" for a prismatic joint',
                    "joint",
                    index,
                    "motion",
                )
        yield from _negative_ratios(joints)

    def construct(
        self, table: PlanarTable, joints: Sequence[Joint], servo: Servo | None = None
    ) -> ArmDescription:
        """See `planar_two_link`."""
        return planar_two_link(joints, table.link_length, table.gravity, servo)

    def table_of(self, arm: ArmDescription) -> PlanarTable:
        """Distance of the axes, and gravity."""
        return PlanarTable(_link_length(arm), arm.gravity_size or None)

    def bodies(
        self, arm: ArmDescription, need: ParameterLookup, gravity: float
    ) -> tuple[Body, ...]:
        """Two bodies with positive masses and inertias for every positive definite M(q).

        With kappa = gamma^2/(alpha beta) < 1:

            m2 l1^2 = alpha (1 + kappa)/2,   m2 lc2 = gamma/l1,   I2 = beta (1 - kappa)/(1 + kappa)

        The remaining inertia of link 1 is alpha (1 - kappa)/2. Link 1 is `about_axis` with the
        first moment that its gravity torque implies.
        """
        length = _link_length(arm)
        alpha, beta, gamma = (need(*key) for key in (_ALPHA, _BETA, _GAMMA))
        if not (alpha > 0.0 and beta > 0.0 and alpha * beta > gamma**2):
            raise InvalidInput(
                f"no bodies have alpha = {alpha:g}, beta = {beta:g}, gamma = {gamma:g} kg m^2: "
                "their inertia matrix is not positive definite",
                remedy=_RECORD_FASTER_MOTIONS,
            )
        kappa = gamma**2 / (alpha * beta)
        mass = alpha * (1.0 + kappa) / (2.0 * length**2)
        moment = gamma / length
        second = Body.in_plane(mass, moment / mass, beta * (1.0 - kappa) / (1.0 + kappa))
        first_moment = need("gravity_torque_1") / gravity - mass * length if gravity else 0.0
        return about_axis(alpha * (1.0 - kappa) / 2.0, first_moment, length), second

    def effective_gravity(self, arm: ArmDescription, need: ParameterLookup) -> float:
        """G2 l1/gamma. It differs from the gravity of the study by the errors of G2 and gamma."""
        if not arm.gravity:
            return 0.0
        torque, gamma = need("gravity_torque_2"), need(*_GAMMA)
        if torque * gamma <= 0.0:
            raise InvalidInput(
                f"gravity_torque_2 = {torque:g} N m and gamma = {gamma:g} kg m^2 put the centre of "
                "link 2 on opposite sides of its axis",
                remedy=_RECORD_FASTER_MOTIONS,
            )
        return torque * _link_length(arm) / gamma


def _link_length(arm: ArmDescription) -> float:
    """l_1 [m]."""
    return arm.joints[1].origin.xyz[0]


_LINK: Key = ("link_inertia", 1)
_MOTOR: Key = ("motor_inertia", 1)


@dataclass(frozen=True, slots=True)
class SingleJointTable:
    """Keys of `[arm]`."""

    gravity: NonNegative | None = None  # [m/s^2] along -y in the plane of motion


def single_joint(
    joint: Joint, gravity: float | None = None, servo: Servo | None = None
) -> ArmDescription:
    """One joint; its link lies along +x at zero angle. `gravity` [m/s^2] acts along -y.

    A revolute joint turns about +z, a prismatic joint moves along +x.
    """
    if joint.motion == "prismatic":
        joint = replace(joint, axis=(1.0, 0.0, 0.0))
    return ArmDescription("single-joint", (joint,), in_plane_gravity(gravity), servo=servo)


class SingleJoint(Kind[SingleJointTable]):
    """One motor, one gear and one link."""

    name = "single-joint"
    max_joints = 1
    table = SingleJointTable

    def standard_rows(self, arm: ArmDescription) -> Mapping[Key, Row]:
        """The centre of mass of a revolute link is on its x axis."""
        is_prismatic = arm.joints[0].motion == "prismatic"
        inertia = ("link_mass" if is_prismatic else "link_inertia_zz", 1)
        return {
            _LINK: {inertia: 1.0},
            ("gravity_torque_1", None): {("link_first_moment_x", 1): arm.gravity_size},
        }

    def rigid_combinations(self, arm: ArmDescription) -> Mapping[Key, Row]:
        """c_1, the sum of motor and reflected link inertia."""
        return {("inertia", 1): {_MOTOR: 1.0, _LINK: arm.joints[0].gear_ratio ** 2}}

    def starting_inertias(
        self, arm: ArmDescription, estimates: StageInertias
    ) -> tuple[Values, Values]:
        """An impossible inertia is replaced by its usual share of the total inertia."""
        motor, link, rejected = estimates.motor[1], estimates.link[1], Values()
        n2, total = arm.joints[0].gear_ratio ** 2, estimates.rigid.get(("inertia", 1))
        if not is_positive(link):
            rejected[_LINK] = link
            total_inertia = (
                total if is_positive(total) else require_positive("inertia", motor) / MOTOR_SHARE
            )
            link = (1.0 - MOTOR_SHARE) * (total_inertia or 0.0) / n2
        if not is_positive(motor):
            rejected[_MOTOR] = motor
            motor = MOTOR_SHARE / (1.0 - MOTOR_SHARE) * n2 * link
        return {_LINK: link, _MOTOR: motor}, rejected

    def complete(self, known: Values, arm: ArmDescription) -> None:
        """Assign all of c_1 to the motor if the gear is rigid: motor and link are then one body."""
        if not arm.joints[0].elastic and ("inertia", 1) in known:
            known.setdefault(_MOTOR, known["inertia", 1])
            known.setdefault(_LINK, 0.0)

    def faults(self, table: SingleJointTable, joints: Sequence[Joint]) -> Iterator[Fault]:
        """A wrong number of joints, or a prismatic joint under gravity."""
        if len(joints) != 1:
            yield _wrong_number_of_joints("single-joint", len(joints), 1)
        elif joints[0].motion == "prismatic" and table.gravity:
            yield Fault(
                "a prismatic joint moves along x, perpendicular to gravity",
                "remove gravity; the fit reports a constant force as friction_offset",
                "arm",
                key="gravity",
            )
        yield from _negative_ratios(joints)

    def construct(
        self, table: SingleJointTable, joints: Sequence[Joint], servo: Servo | None = None
    ) -> ArmDescription:
        """See `single_joint`."""
        return single_joint(joints[0], table.gravity, servo)

    def table_of(self, arm: ArmDescription) -> SingleJointTable:
        """Gravity."""
        return SingleJointTable(arm.gravity_size or None)

    def bodies(
        self, arm: ArmDescription, need: ParameterLookup, gravity: float
    ) -> tuple[Body, ...]:
        """The link; with a rigid gear the motor is part of it."""
        joint = arm.joints[0]
        inertia = need(*_LINK)
        if not joint.elastic:
            inertia += need(*_MOTOR) / joint.gear_ratio**2
        if inertia <= 0.0:
            raise InvalidInput(
                f"the link's inertia is {inertia:g}, not positive",
                remedy="record faster motions and identify again",
            )
        if joint.motion == "prismatic":
            # it does not rotate: the rotational inertia has no effect
            return (Body.in_plane(inertia, 0.0, inertia * _ASSUMED_LENGTH**2),)
        moment = need("gravity_torque_1") / gravity if gravity else 0.0
        return (about_axis(inertia, moment, _ASSUMED_LENGTH),)


def about_axis(inertia: float, moment: float, length: float) -> Body:
    """Body with inertia J > 0 [kg m^2] and first moment s [kg m] about its axis.

        m = 3 J/l^2 + s^2/J

    The first term is the mass of a uniform rod of the given length l [m]. The second keeps the
    inertia about the centre of mass, J - s^2/m = (3 J/l^2) J/m, positive.
    """
    rod_mass = 3.0 * inertia / length**2
    mass = rod_mass + moment**2 / inertia
    return Body.in_plane(mass, moment / mass, inertia * rod_mass / mass)


def _wrong_number_of_joints(kind: str, count: int, expected: int) -> Fault:
    """Fault of a study file with the wrong number of `[[joint]]` tables."""
    return Fault(
        f"a {kind} arm has {expected} joint(s), but there are {count} [[joint]] tables",
        f"write {expected} [[joint]] table(s) from the base, recorded with all other joints at"
        " rest, or change kind in [arm]",
        "joint",
    )


def _negative_ratios(joints: Sequence[Joint]) -> Iterator[Fault]:
    """Faults of planar arms: their motors are reversed by the scale of a channel."""
    for index, joint in enumerate(joints):
        if joint.gear_ratio < 0.0:
            yield Fault(
                f"'gear_ratio' is {joint.gear_ratio:g}, but it should be greater than 0",
                f"set a positive ratio; reverse the motor with channels.theta_m{index + 1} = "
                "{ column = ..., scale = -1.0 }",
                "joint",
                index,
                "gear_ratio",
            )


def in_plane_gravity(gravity: float | None) -> Vector | None:
    """Gravity [m/s^2] along -y as a vector; None without gravity."""
    return (0.0, -gravity, 0.0) if gravity else None
