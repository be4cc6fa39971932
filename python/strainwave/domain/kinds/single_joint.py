"""One joint, revolute or prismatic: c_1 = m_M + n^2 m_L, motor side, (18)."""

from __future__ import annotations

from collections.abc import Iterator

from strainwave.domain.arm import ArmDescription
from strainwave.domain.keys import Key, Row, Values
from strainwave.domain.kinds.base import Fault, Kind, RigidColumn
from strainwave.domain.kinds.bodies import ASSUMED_LENGTH, Body, ParameterLookup, about_axis
from strainwave.domain.kinds.starts import MOTOR_SHARE, StageInertias, is_positive, require_positive
from strainwave.errors import InvalidInput

_LINK: Key = ("link_inertia", 1)
_MOTOR: Key = ("motor_inertia", 1)


class SingleJoint(Kind):
    """One motor, one gear and one link."""

    n_joints = 1
    inertias = (_LINK,)
    primary = ("inertia 1",)
    primary_of_all = ()

    def link_inertia(self, joint: int) -> Row:
        """m_L."""
        return {("link_inertia", joint): 1.0}

    @property
    def from_link_inertias(self) -> tuple[tuple[Key, Row], ...]:
        """m_L."""
        return ((_LINK, {_LINK: 1.0}),)

    def rigid_inertias(self, arm: ArmDescription) -> tuple[RigidColumn, ...]:
        """c_1, the sum of motor and reflected link inertia."""
        joint = arm.joints[0]
        unit = "kg m^2" if joint.motion == "revolute" else "kg"
        parts = {_MOTOR: 1.0, _LINK: joint.gear_ratio**2}
        return (RigidColumn("inertia", 1, unit, parts),)

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

    def faults(self, arm: ArmDescription) -> Iterator[Fault]:
        """A prismatic joint under gravity."""
        if arm.joints[0].motion == "prismatic" and arm.gravity:
            yield Fault(
                "a prismatic joint moves along x, perpendicular to gravity",
                "remove gravity; the fit reports a constant force as friction_offset",
                "arm",
                key="gravity",
            )

    def bodies(
        self, arm: ArmDescription, need: ParameterLookup, gravity: float
    ) -> tuple[Body, ...]:
        """The link; with a rigid gear the motor is part of it."""
        joint, length = arm.joints[0], arm.link_length or ASSUMED_LENGTH
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
            return (Body(inertia, 0.0, inertia * length**2),)
        moment = need("gravity_torque_1") / gravity if gravity else 0.0
        return (about_axis(inertia, moment, length),)
