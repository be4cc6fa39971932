"""a_r cos k q_M + b_r sin k q_M: a motor torque that depends on the angle, (S17)."""

from __future__ import annotations

from collections.abc import Mapping

from strainwave.domain.effects.interface import Effect, KnownJoint, Values

_SHARE = 0.1  # of Coulomb friction
_ORDERS = (2.0, 1.0, 4.0, 6.0)  # periods per turn: an encoder off its centre, poles and windings


class TorqueRipple(Effect):
    """The motor cogs, or its commutation is off."""

    name = "torque-ripple"
    sizes = ("torque_ripple_cos", "torque_ripple_sin")
    shapes: Mapping[str, float] = {"torque_ripple_order": _ORDERS[0]}
    description = "a torque of the motor that depends on its angle"
    consequence = "friction and, where it meets a resonance, damping are biased"
    experiment = (
        "turn the motor slowly at a constant speed, and look for lines per turn in the voltage"
    )
    record = "a record of slow, even turning"

    def typical_sizes(self, joint: KnownJoint) -> Values:
        """A share of Coulomb friction."""
        return dict.fromkeys(self.sizes, _SHARE * joint.coulomb_friction)

    def tested_shapes(self, joint: KnownJoint) -> tuple[Values, ...]:
        """A period apart a ripple leaves no trace of another: each order is tested."""
        return tuple({"torque_ripple_order": order} for order in _ORDERS)
