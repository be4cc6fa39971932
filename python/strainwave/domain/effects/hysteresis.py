"""T_h z with dz = (ddelta - |ddelta| z)/delta_h beside the spring: Dahl's law, (S11)."""

from __future__ import annotations

from collections.abc import Mapping

from strainwave.domain.effects.interface import Effect, KnownJoint, Values

_SHARE = 0.02  # of the largest gear torque


class Hysteresis(Effect):
    """The gear's torque lags its torsion."""

    name = "hysteresis"
    sizes = ("hysteresis_torque",)
    shapes: Mapping[str, float] = {"hysteresis_twist": 1.5e-4}
    needs_elastic_gear = True
    description = "a torque of the gear that lags its torsion"
    consequence = "damping and the softest stiffness are biased"
    experiment = "hold the link and turn the motor slowly to and fro, to several torques"
    record = "a record of slow reversals"

    def typical_sizes(self, joint: KnownJoint) -> Values:
        """A share of the largest gear torque."""
        return {"hysteresis_torque": _SHARE * joint.largest_torque}
