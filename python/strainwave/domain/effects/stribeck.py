"""f_M + f_S exp(-(dq_M/w_s)^2): friction that is largest at standstill, (S10)."""

from __future__ import annotations

from collections.abc import Mapping

from strainwave.domain.effects.interface import Effect, KnownJoint, Values

_SHARE = 0.2  # of Coulomb friction


class Stribeck(Effect):
    """The motor breaks away beyond Coulomb friction."""

    name = "stribeck"
    sizes = ("stribeck_friction",)
    shapes: Mapping[str, float] = {"stribeck_velocity": 3.0}
    description = "friction that falls with the motor's velocity"
    consequence = "Coulomb and viscous friction are biased"
    experiment = "turn the motor slowly, at several constant speeds of either sign"
    record = "a record of slow motion"

    def typical_sizes(self, joint: KnownJoint) -> Values:
        """A share of Coulomb friction."""
        return {"stribeck_friction": _SHARE * joint.coulomb_friction}
