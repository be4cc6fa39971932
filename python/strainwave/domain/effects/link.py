"""Effects on the link and under its base."""

from __future__ import annotations

from collections.abc import Mapping

from strainwave.domain.effects.interface import Effect


class GroundSpring(Effect):
    """A cable bundle pulls at the link.

    Ground spring, (S19): torque c_g q_L + t_g on the link, for example from cables.
    """

    name = "ground-spring"
    sizes = ("ground_stiffness", "ground_preload")
    typical_size = 0.05  # at one radian
    relative_to = "largest_torque"
    misleads_inertias = True
    description = "a spring and a preload between the link and ground"
    consequence = "gravity torques and inertias of slow motion are biased"
    experiment = "hold the joint at several angles of its range, approached from both sides"
    record = "a record of slow motion over the whole range of the joint"


class Tilt(Effect):
    """The base is not level, or the direction of gravity differs from the study.

    Tilt, (S23): unmodelled gravity s_t sin a + c_t cos a over the link's absolute angle a.
    """

    name = "tilt"
    sizes = ("tilt_sin", "tilt_cos")
    typical_size = 0.05
    relative_to = "largest_torque"
    misleads_inertias = True
    description = "gravity that the model lacks, for example from a tilted base"
    consequence = "friction and inertias of slow motion are biased"
    experiment = "check the base with a level, or hold the joint at angles half a turn apart"
    record = "a record of slow motion over the whole range of the joint"


class FlexibleLink(Effect):
    """A part of the link has a vibration mode.

    Flexible link, (S24): inertia J_f on a spring and a damper attached to the link.
    """

    name = "flexible-link"
    sizes = ("flexible_inertia",)
    typical_size = 0.05
    relative_to = "link_inertia"
    # the half-power bands of neighbours overlap at the tested damping
    shapes: Mapping[str, float] = {"flexible_frequency": 30.0, "flexible_damping": 0.2}
    tested: Mapping[str, tuple[float, ...]] = {"flexible_frequency": (12.0, 18.0, 24.0, 45.0, 65.0)}
    starting_shapes: Mapping[str, float] = {"flexible_damping": 0.05}
    is_part_of_link = True
    misleads_inertias = True
    description = "a vibration mode of a part of the link"
    consequence = "the mode biases the stiffness and damping of the gear"
    experiment = "hold the motor, hit the link and look for a second resonance"
    record = "a frequency record up to twice the frequency of that mode"


class SoftBase(Effect):
    """The base rotates on its support.

    Soft base, (S28): the base rotates about the first axis on compliance c_B and a damper.
    """

    name = "soft-base"
    sizes = ("base_compliance",)
    typical_size = 0.2
    relative_to = "gear_compliance"
    # the half-power bands of neighbours overlap at the tested damping
    shapes: Mapping[str, float] = {"base_frequency": 25.0, "base_damping": 0.5}
    tested: Mapping[str, tuple[float, ...]] = {"base_frequency": (12.0, 17.0, 36.0, 52.0)}
    starting_shapes: Mapping[str, float] = {"base_damping": 0.1}
    needs_elastic_gear = True
    first_joint_only = True
    moves_link_encoder = True
    description = "a base that rotates on a compliant support"
    consequence = "its compliance and its mode bias the first gear's stiffness and damping"
    experiment = "hold the motors, hit the base and measure its motion with an accelerometer on it"
    record = "a frequency record of joint 1 up to twice the natural frequency of the base"
