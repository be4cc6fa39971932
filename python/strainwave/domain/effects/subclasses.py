"""Effects whose tested shapes depend on the joint, and effects that change inputs of the core."""

from __future__ import annotations

from strainwave.domain.effects.interface import Effect, Input, KnownJoint, RecordEffect, Values

_TWIST_SHARE = 0.1  # of the largest torsion; gears of the catalogue have 0.05 to 0.15
_TESTED_LIMIT_SHARES = (0.9, 0.75, 0.6)  # of the largest recorded voltage
_COULOMB, _FRICTION_CHANGE = "motor_coulomb_friction", "friction_change"
_GAIN, _GAIN_CHANGE = "drive_gain", "drive_gain_change"


class Hysteresis(Effect):
    """Hysteresis of the gear torque over the torsion."""

    def tested_shapes(self, joint: KnownJoint) -> tuple[Values, ...]:
        """The usual twist, or that of a soft gear: a tenth of its largest torsion."""
        ((name, usual),) = self.shapes.items()
        return ({name: max(usual, _TWIST_SHARE * joint.largest_torsion)},)


class DriveLimit(Effect):
    """A drive gain that falls above a voltage."""

    def tested_shapes(self, joint: KnownJoint) -> tuple[Values, ...]:
        """Limits below the largest recorded voltage."""
        if not joint.largest_voltage > 0.0:
            return super().tested_shapes(joint)
        (name,) = self.shapes
        return tuple({name: share * joint.largest_voltage} for share in _TESTED_LIMIT_SHARES)


class FrictionByRecord(RecordEffect):
    """Coulomb friction that differs from record to record."""

    def inputs(self, values: Values, gear_ratio: float) -> tuple[Input, ...]:
        """Coulomb friction times (1 + phi_r)."""
        friction, factor = values[_COULOMB], 1.0 + values[_FRICTION_CHANGE]
        slopes = {_COULOMB: factor, _FRICTION_CHANGE: friction}
        return (Input(_COULOMB, factor * friction, slopes),)


class DriveGainByRecord(RecordEffect):
    """A torque per volt that differs from record to record."""

    def inputs(self, values: Values, gear_ratio: float) -> tuple[Input, ...]:
        """drive_gain = (1 + g_u) (1 + g_r) - 1."""
        gain, factor = 1.0 + values.get(_GAIN, 0.0), 1.0 + values[_GAIN_CHANGE]
        return (Input(_GAIN, gain * factor - 1.0, {_GAIN: factor, _GAIN_CHANGE: gain}),)


class EncoderZero(RecordEffect):
    """A constant error of the joint angle."""

    def inputs(self, values: Values, gear_ratio: float) -> tuple[Input, ...]:
        """Shift of both initial angles; the fit compares velocities, which have no zero."""
        zero = values["encoder_zero"]
        motor = Input("initial_motor_angle", zero / gear_ratio, {"encoder_zero": 1.0 / gear_ratio})
        return motor, Input("initial_link_angle", zero, {"encoder_zero": 1.0})


SUBCLASSES: dict[str, type[Effect]] = {
    "hysteresis": Hysteresis,
    "drive-limit": DriveLimit,
    "friction-by-record": FrictionByRecord,
    "drive-gain-by-record": DriveGainByRecord,
    "encoder-zero": EncoderZero,
}
"""By name; all other effects are an `Effect`."""
