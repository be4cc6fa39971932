"""Encoder zero, (S26): the joint angle exceeds the encoder reading by q_0."""

from __future__ import annotations

from strainwave.domain.effects.interface import Input, KnownJoint, RecordEffect, Values

_TYPICAL_OFFSET = 0.1  # [rad], or [m] for a prismatic joint: one or two teeth of a belt


class EncoderZero(RecordEffect):
    """The zero of the encoder differs from the posture with the links along x."""

    name = "encoder-zero"
    sizes = ("encoder_zero",)
    misleads_inertias = True
    description = "a constant error of the joint angle"
    consequence = "inertia and gravity are evaluated in the wrong postures"
    experiment = "align the links with x by a straight edge and read the encoders"
    record = "records in several postures"

    def typical_sizes(self, joint: KnownJoint) -> Values:
        """The same for every joint."""
        return {"encoder_zero": _TYPICAL_OFFSET}

    def inputs(self, values: Values, gear_ratio: float) -> tuple[Input, ...]:
        """Shift of both initial angles; the fit compares velocities, which have no zero."""
        zero = values["encoder_zero"]
        motor = Input("initial_motor_angle", zero / gear_ratio, {"encoder_zero": 1.0 / gear_ratio})
        return motor, Input("initial_link_angle", zero, {"encoder_zero": 1.0})
