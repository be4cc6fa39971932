"""u less c_u of what is beyond +-u_L: an amplifier that gives less beyond a voltage, (S29)."""

from __future__ import annotations

from collections.abc import Mapping

from strainwave.domain.effects.interface import Effect, KnownJoint, Values

_LIMIT = "drive_limit"
_VOLTS = 6.0  # of a common drive of 10 V
_SHARES = (0.9, 0.75, 0.6)  # of the largest voltage
_TYPICAL = 0.5  # of what is beyond


class DriveLimit(Effect):
    """The amplifier clips, or nearly so."""

    name = "drive-limit"
    sizes = ("drive_limit_loss",)
    shapes: Mapping[str, float] = {_LIMIT: _VOLTS}
    misleads_inertias = True
    description = "a drive that gives less beyond a voltage"
    consequence = "inertia and friction depend on how large the voltage was"
    experiment = "measure the motor's current as the voltage rises to its largest, rotor held"
    record = "records at several amplitudes of the voltage, up to the largest"

    def typical_sizes(self, joint: KnownJoint) -> Values:
        """Half of what is beyond, the same of every drive."""
        return {"drive_limit_loss": _TYPICAL}

    def tested_shapes(self, joint: KnownJoint) -> tuple[Values, ...]:
        """Limits below the largest voltage."""
        if not joint.largest_voltage > 0.0:
            return super().tested_shapes(joint)
        return tuple({_LIMIT: share * joint.largest_voltage} for share in _SHARES)
