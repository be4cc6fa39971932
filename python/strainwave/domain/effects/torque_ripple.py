"""Torque ripple, (S17): motor torque a_r cos(k q_M) + b_r sin(k q_M) over the motor angle."""

from __future__ import annotations

from collections.abc import Mapping

from strainwave.domain.effects.interface import Effect, KnownJoint, Values

_TYPICAL_SHARE = 0.1  # of Coulomb friction
_TESTED_ORDERS = (2.0, 1.0, 4.0, 6.0)  # periods per turn: poles, windings, eccentricity


class TorqueRipple(Effect):
    """The motor cogs, or its commutation is wrong."""

    name = "torque-ripple"
    sizes = ("torque_ripple_cos", "torque_ripple_sin")
    shapes: Mapping[str, float] = {"torque_ripple_order": _TESTED_ORDERS[0]}
    description = "a periodic motor torque over the motor angle"
    consequence = "friction is biased, and so is damping if the ripple excites a resonance"
    experiment = (
        "turn the motor slowly at constant speed and look for spectral lines per turn"
        " in the voltage"
    )
    record = "a record of slow rotation at constant speed"

    def typical_sizes(self, joint: KnownJoint) -> Values:
        """A share of Coulomb friction."""
        return dict.fromkeys(self.sizes, _TYPICAL_SHARE * joint.coulomb_friction)

    def tested_shapes(self, joint: KnownJoint) -> tuple[Values, ...]:
        """One set per order: a ripple of one order does not correlate with another order."""
        return tuple({"torque_ripple_order": order} for order in _TESTED_ORDERS)
