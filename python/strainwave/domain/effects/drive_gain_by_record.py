"""Drive gain by record, (S27): the torque per volt is multiplied by 1 + g_r in each record."""

from __future__ import annotations

from collections.abc import Mapping

from strainwave.domain.effects.interface import Input, KnownJoint, RecordEffect, Values

_GAIN, _CHANGE = "drive_gain", "drive_gain_change"
_TYPICAL_CHANGE = 0.05  # magnets that warm up by 50 K, or amplifier drift


class DriveGainByRecord(RecordEffect):
    """The amplifier drifts, or the motor's magnets warm up."""

    name = "drive-gain-by-record"
    sizes = (_CHANGE,)
    by_record = True
    prior_std = 0.1
    needs: Mapping[str, float] = {_GAIN: 0.0}
    misleads_inertias = True
    description = "a torque per volt that differs from record to record"
    consequence = "torques are scaled by an average gain, which biases inertias and stiffness"
    experiment = "measure the motor's current at a known voltage before and after the session"
    record = "several records of this joint's motion"

    @property
    def core_name(self) -> str | None:
        """The core's effect for a gain error that is the same in all records."""
        return "drive-gain"

    def typical_sizes(self, joint: KnownJoint) -> Values:
        """The same for every drive."""
        return {_CHANGE: _TYPICAL_CHANGE}

    def inputs(self, values: Values, gear_ratio: float) -> tuple[Input, ...]:
        """drive_gain = (1 + g_u) (1 + g_r) - 1."""
        gain, factor = 1.0 + values.get(_GAIN, 0.0), 1.0 + values[_CHANGE]
        return (Input(_GAIN, gain * factor - 1.0, {_GAIN: factor, _CHANGE: gain}),)
