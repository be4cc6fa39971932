"""Drive lag, (S30): tau_u dm/dt = u - m, a first-order lag from voltage to torque."""

from __future__ import annotations

from strainwave.domain.effects.interface import Effect, KnownJoint, Values

_TYPICAL_TIME_CONSTANT = 5e-4  # [s] a current loop of about 300 Hz


class DriveLag(Effect):
    """The current loop is slower than the study states, or the drive computes with a delay."""

    name = "drive-lag"
    sizes = ("drive_lag",)
    description = "a lag from voltage to torque"
    consequence = "damping is biased and resonances shift slightly"
    experiment = "hold the rotor and record the motor's current during a voltage step"
    record = "a record whose band extends beyond the joint's resonance"

    def typical_sizes(self, joint: KnownJoint) -> Values:
        """The lag of a common current loop."""
        return {"drive_lag": _TYPICAL_TIME_CONSTANT}
