"""Ground spring, (S19): torque c_g q_L + t_g on the link, for example from cables."""

from __future__ import annotations

from strainwave.domain.effects.interface import Effect, KnownJoint, Values

_TYPICAL_TORQUE_SHARE = 0.05  # of the largest gear torque, per radian


class GroundSpring(Effect):
    """A cable bundle pulls at the link."""

    name = "ground-spring"
    sizes = ("ground_stiffness", "ground_preload")
    misleads_inertias = True
    description = "a spring and a preload between the link and ground"
    consequence = "gravity torques and inertias of slow motion are biased"
    experiment = "hold the joint at several angles of its range, approached from both sides"
    record = "a record of slow motion over the whole range of the joint"

    def typical_sizes(self, joint: KnownJoint) -> Values:
        """A share of the largest gear torque, at one radian."""
        return dict.fromkeys(self.sizes, _TYPICAL_TORQUE_SHARE * joint.largest_torque)
