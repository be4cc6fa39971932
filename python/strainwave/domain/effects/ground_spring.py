"""c_g q_L + t_g on the link: cables between it and ground, (S19)."""

from __future__ import annotations

from strainwave.domain.effects.interface import Effect, KnownJoint, Values

_SHARE = 0.05  # of the largest gear torque, per radian


class GroundSpring(Effect):
    """A bundle of cables pulls at the link."""

    name = "ground-spring"
    sizes = ("ground_stiffness", "ground_preload")
    misleads_inertias = True
    description = "a spring and a preload between the link and ground"
    consequence = "gravity torques and inertias of slow motion are biased"
    experiment = "hold the joint at several angles of its range, coming from either side"
    record = "a record of slow motion over the joint's whole range"

    def typical_sizes(self, joint: KnownJoint) -> Values:
        """A share of the largest gear torque at a radian."""
        return dict.fromkeys(self.sizes, _SHARE * joint.largest_torque)
