"""q_0: an angle that is q_0 more than its encoder says, (S26)."""

from __future__ import annotations

from strainwave.domain.effects.interface import Input, KnownJoint, RecordEffect, Values

_TYPICAL = 0.1  # [rad], or [m] of a prismatic joint


class EncoderZero(RecordEffect):
    """The encoder's zero is not where the links lie along x."""

    name = "encoder-zero"
    sizes = ("encoder_zero",)
    misleads_inertias = True
    description = "an angle that is off by a constant"
    consequence = "inertia and gravity belong to other postures than those they are taken for"
    experiment = "lay the links along x by a straight edge, and read the encoders"
    record = "records in several postures"

    def typical_sizes(self, joint: KnownJoint) -> Values:
        """A tooth or two of a belt."""
        return {"encoder_zero": _TYPICAL}

    def inputs(self, values: Values, gear_ratio: float) -> tuple[Input, ...]:
        """Motor and link begin there; compared are velocities, which know no zero."""
        zero = values["encoder_zero"]
        motor = Input("initial_motor_angle", zero / gear_ratio, {"encoder_zero": 1.0 / gear_ratio})
        return motor, Input("initial_link_angle", zero, {"encoder_zero": 1.0})
