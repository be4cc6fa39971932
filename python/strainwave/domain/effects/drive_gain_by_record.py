"""(1 + g_r) of the drive's torque per volt: a gain that differs from record to record, (S27)."""

from __future__ import annotations

from collections.abc import Mapping

from strainwave.domain.effects.interface import Input, KnownJoint, RecordEffect, Values

_GAIN, _CHANGE = "drive_gain", "drive_gain_change"
_TYPICAL = 0.05  # magnets that warm up by fifty kelvins, or an amplifier that drifts


class DriveGainByRecord(RecordEffect):
    """The amplifier drifts, or the motor's magnets warm up."""

    name = "drive-gain-by-record"
    sizes = (_CHANGE,)
    by_record = True
    prior_std = 0.1
    needs: Mapping[str, float] = {_GAIN: 0.0}
    misleads_inertias = True
    description = "a torque per volt that differs from record to record"
    consequence = (
        "torques are scaled by an average, and inertias and stiffness lean between records"
    )
    experiment = "measure the motor's current at a known voltage before and after the session"
    record = "several records of this joint's motion"

    @property
    def core_name(self) -> str | None:
        """That of a gain in all records."""
        return "drive-gain"

    def typical_sizes(self, joint: KnownJoint) -> Values:
        """Some percent, the same of every drive."""
        return {_CHANGE: _TYPICAL}

    def inputs(self, values: Values, gear_ratio: float) -> tuple[Input, ...]:
        """One plus the gain's error times one plus its change, less one."""
        gain, factor = 1.0 + values.get(_GAIN, 0.0), 1.0 + values[_CHANGE]
        return (Input(_GAIN, gain * factor - 1.0, {_GAIN: factor, _CHANGE: gain}),)
