"""tau_u dm = u - m: a torque that follows the voltage later than the study says, (S30)."""

from __future__ import annotations

from strainwave.domain.effects.interface import Effect, KnownJoint, Values

_TYPICAL = 5e-4  # [s]: a current loop of some 300 Hz


class DriveLag(Effect):
    """The current loop is slower than the study has it, or the drive computes late."""

    name = "drive-lag"
    sizes = ("drive_lag",)
    description = "a torque that lags the voltage"
    consequence = "damping is biased, and resonances move a little"
    experiment = "record the motor's current as the voltage jumps, rotor held"
    record = "a record whose band goes up to the joint's resonance and beyond"

    def typical_sizes(self, joint: KnownJoint) -> Values:
        """That of a current loop of common gains."""
        return {"drive_lag": _TYPICAL}
