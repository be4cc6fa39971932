"""Effects on the link and under its base."""

from __future__ import annotations

import math
from collections.abc import Mapping

from strainwave.domain.effects.interface import Effect, KnownJoint, Values

_GROUND_SPRING_TYPICAL_TORQUE_SHARE = 0.05  # of the largest gear torque, per radian


class GroundSpring(Effect):
    """A cable bundle pulls at the link.

    Ground spring, (S19): torque c_g q_L + t_g on the link, for example from cables.
    """

    name = "ground-spring"
    sizes = ("ground_stiffness", "ground_preload")
    misleads_inertias = True
    description = "a spring and a preload between the link and ground"
    consequence = "gravity torques and inertias of slow motion are biased"
    experiment = "hold the joint at several angles of its range, approached from both sides"
    record = "a record of slow motion over the whole range of the joint"

    def typical_sizes(self, joint: KnownJoint) -> Values:
        """A share of the largest gear torque, at one radian."""
        return dict.fromkeys(self.sizes, _GROUND_SPRING_TYPICAL_TORQUE_SHARE * joint.largest_torque)


_TILT_TYPICAL_TORQUE_SHARE = 0.05  # of the largest gear torque


class Tilt(Effect):
    """The base is not level, or the direction of gravity differs from the study.

    Tilt, (S23): unmodelled gravity s_t sin a + c_t cos a over the link's absolute angle a.
    """

    name = "tilt"
    sizes = ("tilt_sin", "tilt_cos")
    misleads_inertias = True
    description = "gravity that the model lacks, for example from a tilted base"
    consequence = "friction and inertias of slow motion are biased"
    experiment = "check the base with a level, or hold the joint at angles half a turn apart"
    record = "a record of slow motion over the whole range of the joint"

    def typical_sizes(self, joint: KnownJoint) -> Values:
        """A share of the largest gear torque."""
        return dict.fromkeys(self.sizes, _TILT_TYPICAL_TORQUE_SHARE * joint.largest_torque)


_TYPICAL_INERTIA_SHARE = 0.05  # of the link inertia
_TYPICAL_ANTI_RESONANCE_HZ = 10.0  # gives the link inertia from the gear's stiffness
_PART_STARTING_DAMPING = 0.05  # a fit converges to the mode from a lightly damped one
_LINK_INERTIA_OF_RIGID_GEAR = 1.0  # [kg m^2] if no stiffness gives the link inertia
# The half-power bands of neighbours overlap at the tested damping of 0.2. The first is the default.
_PART_FREQUENCIES_HZ = (30.0, 12.0, 18.0, 24.0, 45.0, 65.0)


class FlexibleLink(Effect):
    """A part of the link has a vibration mode.

    Flexible link, (S24): inertia J_f on a spring and a damper attached to the link.
    """

    name = "flexible-link"
    sizes = ("flexible_inertia",)
    shapes: Mapping[str, float] = {
        "flexible_frequency": _PART_FREQUENCIES_HZ[0],
        "flexible_damping": 0.2,
    }
    description = "a vibration mode of a part of the link"
    consequence = "the mode biases the stiffness and damping of the gear"
    experiment = "hold the motor, hit the link and look for a second resonance"
    record = "a frequency record up to twice the frequency of that mode"

    def typical_sizes(self, joint: KnownJoint) -> Values:
        """A share of the link inertia, which follows from a typical anti-resonance."""
        link = joint.stiffness / (math.tau * _TYPICAL_ANTI_RESONANCE_HZ) ** 2
        return {
            "flexible_inertia": _TYPICAL_INERTIA_SHARE
            * (link if math.isfinite(link) else _LINK_INERTIA_OF_RIGID_GEAR)
        }

    def tested_shapes(self, joint: KnownJoint) -> tuple[Values, ...]:
        """Modes at the tested frequencies, so damped that neighbours overlap."""
        return tuple({**self.shapes, "flexible_frequency": hz} for hz in _PART_FREQUENCIES_HZ)

    def starts(self, joint: KnownJoint) -> Values:
        """The first tested shape with light damping; heavy damping serves only the test."""
        return super().starts(joint) | {"flexible_damping": _PART_STARTING_DAMPING}


_TYPICAL_COMPLIANCE_SHARE = 0.2  # of the gear's compliance
_TYPICAL_COMPLIANCE = 1e-5  # [rad/(N m)] if the gear is rigid
_BASE_STARTING_DAMPING = 0.1  # a fit converges to the mode from a lightly damped one
# The half-power bands of neighbours overlap at the tested damping of 0.5. The first is the default.
_BASE_FREQUENCIES_HZ = (25.0, 12.0, 17.0, 36.0, 52.0)


class SoftBase(Effect):
    """The base rotates on its support.

    Soft base, (S28): the base rotates about the first axis on compliance c_B and a damper.
    """

    name = "soft-base"
    sizes = ("base_compliance",)
    shapes: Mapping[str, float] = {
        "base_frequency": _BASE_FREQUENCIES_HZ[0],
        "base_damping": 0.5,
    }
    needs_elastic_gear = True
    first_joint_only = True
    moves_link_encoder = True
    description = "a base that rotates on a compliant support"
    consequence = "its compliance and its mode bias the first gear's stiffness and damping"
    experiment = "hold the motors, hit the base and measure its motion with an accelerometer on it"
    record = "a frequency record of joint 1 up to twice the natural frequency of the base"

    def typical_sizes(self, joint: KnownJoint) -> Values:
        """A share of the gear's compliance."""
        is_rigid = not math.isfinite(joint.stiffness)
        return {
            "base_compliance": _TYPICAL_COMPLIANCE
            if is_rigid
            else _TYPICAL_COMPLIANCE_SHARE / joint.stiffness
        }

    def tested_shapes(self, joint: KnownJoint) -> tuple[Values, ...]:
        """Modes at the tested frequencies, so damped that neighbours overlap."""
        return tuple({**self.shapes, "base_frequency": hz} for hz in _BASE_FREQUENCIES_HZ)

    def starts(self, joint: KnownJoint) -> Values:
        """The first tested shape with light damping; heavy damping serves only the test."""
        return super().starts(joint) | {"base_damping": _BASE_STARTING_DAMPING}
