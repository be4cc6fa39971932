"""a cos k q_M + b sin k q_M in the gear's torsion: error at two per motor turn, (S12)."""

from __future__ import annotations

from collections.abc import Mapping

from strainwave.domain.effects.interface import Effect, KnownJoint, Values

_ORDER = "kinematic_error_order"
_LOBES = 2.0  # of the wave generator
_OTHERS = (1.0, 4.0)  # orders at which gears have errors as well: an axis off, twice the lobes
_TYPICAL = 1e-4  # [rad] at the link, half an arc minute and less


class KinematicError(Effect):
    """The gear's ratio changes with the motor's angle."""

    name = "kinematic-error"
    sizes = ("kinematic_error_cos", "kinematic_error_sin")
    shapes: Mapping[str, float] = {_ORDER: _LOBES}
    defaults: Mapping[str, float] = {_ORDER: _LOBES}
    needs_elastic_gear = True
    description = "an error of the gear that repeats with the motor's angle, twice per turn or so"
    consequence = "what it excites at a resonance is taken for the gear's damping and stiffness"
    experiment = (
        "turn the motor at a constant speed through many turns, and look for lines per turn"
        " in the accelerometers, most often at two"
    )
    record = "a record of slow, even turning"

    def typical_sizes(self, joint: KnownJoint) -> Values:
        """The same of every gear."""
        return dict.fromkeys(self.sizes, _TYPICAL)

    def tested_shapes(self, joint: KnownJoint) -> tuple[Values, ...]:
        """A period apart an error leaves no trace of another: each order is tested."""
        return tuple({_ORDER: order} for order in (_LOBES, *_OTHERS))
