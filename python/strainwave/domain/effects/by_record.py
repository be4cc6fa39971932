"""Effects that change parameters or initial states of the core in single records."""

from __future__ import annotations

from collections.abc import Mapping

from strainwave.domain.effects.interface import Input, RecordEffect, Values

_COULOMB, _FRICTION_CHANGE = "motor_coulomb_friction", "friction_change"


class FrictionByRecord(RecordEffect):
    """Grease warms up as the joint works.

    Friction by record, (S25): Coulomb friction is (1 + phi_r) f_M in record r.
    """

    name = "friction-by-record"
    sizes = (_FRICTION_CHANGE,)
    typical_size = 0.25  # grease that warms up by 10 K
    by_record = True
    description = "Coulomb friction that differs from record to record"
    consequence = (
        "friction is an average over the records, and its error in each record biases inertias"
    )
    experiment = "repeat the first record at the end of the session, and compare the voltages"
    record = "several records of this joint's motion"

    def inputs(self, values: Values, gear_ratio: float) -> tuple[Input, ...]:
        """Coulomb friction times (1 + phi_r)."""
        friction, factor = values[_COULOMB], 1.0 + values[_FRICTION_CHANGE]
        slopes = {_COULOMB: factor, _FRICTION_CHANGE: friction}
        return (Input(_COULOMB, factor * friction, slopes),)


_GAIN, _GAIN_CHANGE = "drive_gain", "drive_gain_change"


class DriveGainByRecord(RecordEffect):
    """The amplifier drifts, or the motor's magnets warm up.

    Drive gain by record, (S27): the torque per volt is multiplied by 1 + g_r in each record.
    """

    name = "drive-gain-by-record"
    sizes = (_GAIN_CHANGE,)
    typical_size = 0.05  # magnets that warm up by 50 K, or amplifier drift
    by_record = True
    prior_std = 0.05
    core_name = "drive-gain"  # for a gain error that is the same in all records
    defaults: Mapping[str, float] = {_GAIN: 0.0}
    misleads_inertias = True
    description = "a torque per volt that differs from record to record"
    consequence = "torques are scaled by an average gain, which biases inertias and stiffness"
    experiment = "measure the motor's current at a known voltage before and after the session"
    record = "several records of this joint's motion"

    def inputs(self, values: Values, gear_ratio: float) -> tuple[Input, ...]:
        """drive_gain = (1 + g_u) (1 + g_r) - 1."""
        gain, factor = 1.0 + values.get(_GAIN, 0.0), 1.0 + values[_GAIN_CHANGE]
        return (Input(_GAIN, gain * factor - 1.0, {_GAIN: factor, _GAIN_CHANGE: gain}),)


class EncoderZero(RecordEffect):
    """The zero of the encoder differs from the posture with the links along x.

    Encoder zero, (S26): the joint angle exceeds the encoder reading by q_0.
    """

    name = "encoder-zero"
    sizes = ("encoder_zero",)
    typical_size = 0.1  # [rad], or [m] for a prismatic joint: one or two teeth of a belt
    misleads_inertias = True
    description = "a constant error of the joint angle"
    consequence = "inertia and gravity are evaluated in the wrong postures"
    experiment = "align the links with x by a straight edge and read the encoders"
    record = "records in several postures"

    def inputs(self, values: Values, gear_ratio: float) -> tuple[Input, ...]:
        """Shift of both initial angles; the fit compares velocities, which have no zero."""
        zero = values["encoder_zero"]
        motor = Input("initial_motor_angle", zero / gear_ratio, {"encoder_zero": 1.0 / gear_ratio})
        return motor, Input("initial_link_angle", zero, {"encoder_zero": 1.0})
