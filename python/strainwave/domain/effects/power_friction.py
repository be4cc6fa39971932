"""Power friction, (S16): f_P ((|dq_M|/w + s)^p - s^p), a power of the motor velocity."""

from __future__ import annotations

from collections.abc import Mapping

from strainwave.domain.effects.interface import Effect, KnownJoint, Values

_TYPICAL_SHARE = 0.2  # of Coulomb friction


class PowerFriction(Effect):
    """Drag of grease that grows less than in proportion to the velocity."""

    name = "power-friction"
    sizes = ("power_friction",)
    shapes: Mapping[str, float] = {"power_exponent": 0.5}
    description = "friction that grows with a power of the motor's velocity"
    consequence = "Coulomb and viscous friction each absorb a part of it"
    experiment = "turn the motor at several constant speeds of both signs up to the highest"
    record = "a record of motion at all speeds"

    def typical_sizes(self, joint: KnownJoint) -> Values:
        """A share of Coulomb friction."""
        return {"power_friction": _TYPICAL_SHARE * joint.coulomb_friction}
