"""Tilt, (S23): unmodelled gravity s_t sin a + c_t cos a over the link's absolute angle a."""

from __future__ import annotations

from strainwave.domain.effects.interface import Effect, KnownJoint, Values

_TYPICAL_TORQUE_SHARE = 0.05  # of the largest gear torque


class Tilt(Effect):
    """The base is not level, or the direction of gravity differs from the study."""

    name = "tilt"
    sizes = ("tilt_sin", "tilt_cos")
    misleads_inertias = True
    description = "gravity that the model lacks, for example from a tilted base"
    consequence = "friction and inertias of slow motion are biased"
    experiment = "check the base with a level, or hold the joint at angles half a turn apart"
    record = "a record of slow motion over the whole range of the joint"

    def typical_sizes(self, joint: KnownJoint) -> Values:
        """A share of the largest gear torque."""
        return dict.fromkeys(self.sizes, _TYPICAL_TORQUE_SHARE * joint.largest_torque)
