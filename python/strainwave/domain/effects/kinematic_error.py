"""a cos 2 q_M + b sin 2 q_M in the gear's torsion: error at two per motor turn, (S12)."""

from __future__ import annotations

from strainwave.domain.effects.interface import Effect, KnownJoint, Values

_TYPICAL = 1e-4  # [rad] at the link, half an arc minute and less


class KinematicError(Effect):
    """The gear's ratio changes with the motor's angle."""

    name = "kinematic-error"
    sizes = ("kinematic_error_cos", "kinematic_error_sin")
    needs_elastic_gear = True
    description = "an error of the gear at two per motor turn"
    consequence = "what it excites at a resonance is taken for the gear's damping and stiffness"
    experiment = (
        "turn the motor at a constant speed through many turns, and look for lines at two per turn"
        " in the accelerometers"
    )
    record = "a record of slow, even turning"

    def typical_sizes(self, joint: KnownJoint) -> Values:
        """The same of every gear."""
        return dict.fromkeys(self.sizes, _TYPICAL)
