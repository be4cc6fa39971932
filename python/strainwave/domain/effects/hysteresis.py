"""Hysteresis, (S11): Dahl torque T_h z added to the spring, dz = (ddelta - |ddelta| z)/delta_h."""

from __future__ import annotations

from collections.abc import Mapping

from strainwave.domain.effects.interface import Effect, KnownJoint, Values

_TYPICAL_TORQUE_SHARE = 0.02  # of the largest gear torque


class Hysteresis(Effect):
    """The gear's torque depends on the direction of its torsion."""

    name = "hysteresis"
    sizes = ("hysteresis_torque",)
    shapes: Mapping[str, float] = {"hysteresis_twist": 1.5e-4}
    needs_elastic_gear = True
    description = "hysteresis of the gear torque over the torsion"
    consequence = "damping and the lowest slope of the stiffness are biased"
    experiment = "hold the link and turn the motor slowly back and forth up to several torques"
    record = "a record of slow reversals"

    def typical_sizes(self, joint: KnownJoint) -> Values:
        """A share of the largest gear torque."""
        return {"hysteresis_torque": _TYPICAL_TORQUE_SHARE * joint.largest_torque}
