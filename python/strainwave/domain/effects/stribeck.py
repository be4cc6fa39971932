"""Stribeck friction, (S10): f_M + f_S exp(-(dq_M/w_s)^2), largest at standstill."""

from __future__ import annotations

from collections.abc import Mapping

from strainwave.domain.effects.interface import Effect, KnownJoint, Values

_TYPICAL_SHARE = 0.2  # of Coulomb friction


class Stribeck(Effect):
    """The breakaway torque of the motor exceeds Coulomb friction."""

    name = "stribeck"
    sizes = ("stribeck_friction",)
    shapes: Mapping[str, float] = {"stribeck_velocity": 3.0}
    description = "friction that falls with the motor's velocity"
    consequence = "Coulomb and viscous friction are biased"
    experiment = "turn the motor slowly at several constant speeds of both signs"
    record = "a record of slow motion"

    def typical_sizes(self, joint: KnownJoint) -> Values:
        """A share of Coulomb friction."""
        return {"stribeck_friction": _TYPICAL_SHARE * joint.coulomb_friction}
