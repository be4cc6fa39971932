"""mu |n T|: dry friction that grows with the torque through the gear, (S15)."""

from __future__ import annotations

from strainwave.domain.effects.interface import Effect, KnownJoint, Values

_TYPICAL = 0.05  # of the gear's torque at the motor


class LoadFriction(Effect):
    """The teeth rub under load."""

    name = "load-friction"
    sizes = ("load_friction",)
    needs_elastic_gear = True
    description = "dry friction that grows with the gear's torque"
    consequence = "Coulomb friction is too large, and inertias lean with it"
    experiment = (
        "turn the motor slowly to and fro under several loads, as an arm in gravity has them"
    )
    record = "a record of motion under changing load"

    def typical_sizes(self, joint: KnownJoint) -> Values:
        """The same share in every gear."""
        return {"load_friction": _TYPICAL}
