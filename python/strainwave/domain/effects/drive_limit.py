"""Drive limit, (S29): the share c_u of the voltage beyond +-u_L is lost."""

from __future__ import annotations

from collections.abc import Mapping

from strainwave.domain.effects.interface import Effect, KnownJoint, Values

_LIMIT = "drive_limit"
_DEFAULT_LIMIT = 6.0  # [V] for a common 10 V drive, if no voltage is recorded
_TESTED_LIMIT_SHARES = (0.9, 0.75, 0.6)  # of the largest recorded voltage
_TYPICAL_LOSS = 0.5  # share of the voltage beyond the limit


class DriveLimit(Effect):
    """The amplifier clips, partly or completely."""

    name = "drive-limit"
    sizes = ("drive_limit_loss",)
    shapes: Mapping[str, float] = {_LIMIT: _DEFAULT_LIMIT}
    misleads_inertias = True
    description = "a drive gain that falls above a voltage"
    consequence = "inertia and friction depend on the voltage amplitude"
    experiment = "hold the rotor and measure the motor's current up to the largest voltage"
    record = "records at several amplitudes of the voltage, up to the largest"

    def typical_sizes(self, joint: KnownJoint) -> Values:
        """The same for every drive."""
        return {"drive_limit_loss": _TYPICAL_LOSS}

    def tested_shapes(self, joint: KnownJoint) -> tuple[Values, ...]:
        """Limits below the largest recorded voltage."""
        if not joint.largest_voltage > 0.0:
            return super().tested_shapes(joint)
        return tuple({_LIMIT: share * joint.largest_voltage} for share in _TESTED_LIMIT_SHARES)
