"""Kinematic error, (S12): a cos(k q_M) + b sin(k q_M) added to the gear's torsion."""

from __future__ import annotations

from collections.abc import Mapping

from strainwave.domain.effects.interface import Effect, KnownJoint, Values

_ORDER = "kinematic_error_order"
_DEFAULT_ORDER = 2.0  # periods per motor turn: the lobes of a wave generator
_OTHER_ORDERS = (1.0, 4.0)  # eccentricity; second harmonic of the lobes
_TYPICAL_AMPLITUDE = 1e-4  # [rad] link side, about 1/3 arc minute


class KinematicError(Effect):
    """The gear's ratio varies with the motor angle."""

    name = "kinematic-error"
    sizes = ("kinematic_error_cos", "kinematic_error_sin")
    shapes: Mapping[str, float] = {_ORDER: _DEFAULT_ORDER}
    defaults: Mapping[str, float] = {_ORDER: _DEFAULT_ORDER}
    needs_elastic_gear = True
    description = "a periodic error of the gear over the motor angle, usually twice per turn"
    consequence = "its excitation of a resonance biases the gear's damping and stiffness"
    experiment = (
        "turn the motor at constant speed for many turns and look for spectral lines per turn"
        " in the accelerometers, most often at order two"
    )
    record = "a record of slow rotation at constant speed"

    def typical_sizes(self, joint: KnownJoint) -> Values:
        """The same for every gear."""
        return dict.fromkeys(self.sizes, _TYPICAL_AMPLITUDE)

    def tested_shapes(self, joint: KnownJoint) -> tuple[Values, ...]:
        """One set per order: an error of one order does not correlate with another order."""
        return tuple({_ORDER: order} for order in (_DEFAULT_ORDER, *_OTHER_ORDERS))
