"""One joint, revolute or prismatic: c_1 = m_M + n^2 m_L, motor side, (18)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

from strainwave.domain.arm import ArmDescription, Joint, NonNegative, Servo
from strainwave.domain.keys import Key, Row, Values
from strainwave.domain.kinds.base import (
    ASSUMED_LENGTH,
    MOTOR_SHARE,
    Body,
    Fault,
    Kind,
    ParameterLookup,
    StageInertias,
    about_axis,
    in_plane_gravity,
    is_positive,
    negative_ratios,
    require_positive,
    wrong_number_of_joints,
)
from strainwave.errors import InvalidInput

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
            yield wrong_number_of_joints("single-joint", len(joints), 1)
        elif joints[0].motion == "prismatic" and table.gravity:
            yield Fault(
                "a prismatic joint moves along x, perpendicular to gravity",
                "remove gravity; the fit reports a constant force as friction_offset",
                "arm",
                key="gravity",
            )
        yield from negative_ratios(joints)

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
            return (Body.in_plane(inertia, 0.0, inertia * ASSUMED_LENGTH**2),)
        moment = need("gravity_torque_1") / gravity if gravity else 0.0
        return (about_axis(inertia, moment, ASSUMED_LENGTH),)
