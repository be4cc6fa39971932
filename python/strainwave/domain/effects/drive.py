"""Effects of the drive: an amplifier that is not linear, not exact or not instant."""

from __future__ import annotations

from collections.abc import Mapping

from strainwave.domain.effects.interface import Effect, KnownJoint, Values


class DeadZone(Effect):
    """The drive does not respond to small commands.

    Dead zone of the drive, (S20): u is reduced by u_0 in magnitude, and is zero within +-u_0.
    """

    name = "dead-zone"
    sizes = ("dead_zone",)
    typical_size = 0.1  # [V] 1 % of the range of a 10 V drive
    misleads_inertias = True
    description = "a dead zone of the drive around zero voltage"
    consequence = "Coulomb friction is too large if the voltage has the sign of the velocity"
    experiment = "measure the motor's current at small voltages of either sign"
    record = "a record with many voltage levels, including small ones"


class DriveGain(Effect):
    """The torque per volt of one joint is wrong.

    Drive gain, (S21): u (1 + g_u), an error of the study's torque per volt.
    """

    name = "drive-gain"
    sizes = ("drive_gain",)
    typical_size = 0.05  # tolerance of a motor's torque constant
    misleads_inertias = True
    description = "an error of the torque per volt"
    consequence = "all torques of the joint, and hence inertia, friction and stiffness, are scaled"
    experiment = (
        "measure the motor's torque, or its current and torque constant, at a known voltage"
    )
    record = "records in which this joint and another accelerate each other"


class DriveSaturation(Effect):
    """The motor's iron saturates.

    Drive saturation, (S22): u (1 - s_u |u|), a torque constant that falls with the current.
    """

    name = "drive-saturation"
    sizes = ("drive_saturation",)
    typical_size = 0.005  # [1/V] 5 % at 10 V
    misleads_inertias = True
    description = "a torque constant that falls with the current"
    consequence = "inertia and friction depend on the voltage amplitude"
    experiment = "repeat an excitation at one third of its amplitude"
    record = "records at several amplitudes of the voltage"


_LIMIT = "drive_limit"
_TESTED_LIMIT_SHARES = (0.9, 0.75, 0.6)  # of the largest recorded voltage


class DriveLimit(Effect):
    """The amplifier clips, partly or completely.

    Drive limit, (S29): the share c_u of the voltage beyond +-u_L is lost.
    """

    name = "drive-limit"
    sizes = ("drive_limit_loss",)
    typical_size = 0.5  # share of the voltage beyond the limit
    # [V] for a common 10 V drive, if no voltage is recorded
    shapes: Mapping[str, float] = {_LIMIT: 6.0}
    misleads_inertias = True
    description = "a drive gain that falls above a voltage"
    consequence = "inertia and friction depend on the voltage amplitude"
    experiment = "hold the rotor and measure the motor's current up to the largest voltage"
    record = "records at several amplitudes of the voltage, up to the largest"

    def tested_shapes(self, joint: KnownJoint) -> tuple[Values, ...]:
        """Limits below the largest recorded voltage."""
        if not joint.largest_voltage > 0.0:
            return super().tested_shapes(joint)
        return tuple({_LIMIT: share * joint.largest_voltage} for share in _TESTED_LIMIT_SHARES)


class DriveLag(Effect):
    """The current loop is slower than the study states, or the drive computes with a delay.

    Drive lag, (S30): tau_u dm/dt = u - m, a first-order lag from voltage to torque.
    """

    name = "drive-lag"
    sizes = ("drive_lag",)
    typical_size = 5e-4  # [s] a current loop of about 300 Hz
    description = "a lag from voltage to torque"
    consequence = "damping is biased and resonances shift slightly"
    experiment = "hold the rotor and record the motor's current during a voltage step"
    record = "a record whose band extends beyond the joint's resonance"
