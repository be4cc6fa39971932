"""Load friction, (S15): dry friction mu |n T| that grows with the gear torque."""

from __future__ import annotations

from strainwave.domain.effects.interface import Effect, KnownJoint, Values

_TYPICAL_SHARE = 0.05  # of the gear torque, motor side


class LoadFriction(Effect):
    """The teeth rub under load."""

    name = "load-friction"
    sizes = ("load_friction",)
    needs_elastic_gear = True
    description = "dry friction that grows with the gear torque"
    consequence = "Coulomb friction is too large and inertias are biased"
    experiment = (
        "turn the motor slowly back and forth under several loads, for example in several postures"
    )
    record = "a record of motion under changing load"

    def typical_sizes(self, joint: KnownJoint) -> Values:
        """The same share for every gear."""
        return {"load_friction": _TYPICAL_SHARE}
