"""Effects of rigid joints, of which only the rigid step has equations."""

from __future__ import annotations

from strainwave.domain.effects.interface import Effect


class LoadSpeedFriction(Effect):
    """The teeth and bearings of a loaded gear drag with the speed.

    The fourth term of the friction law of strain-wave gears: mu_v |tau| dq_M.
    """

    name = "load-speed-friction"
    sizes = ("load_speed_friction",)
    typical_size = 1e-3
    core_name: str | None = None
    description = "viscous friction that grows with the load"
    consequence = "viscous friction depends on the loads of the records"
    experiment = "turn the joint at several constant speeds under several loads"
    record = "a record of motion at all speeds under changing load"


class DirectionFriction(Effect):
    """The friction of one direction grows faster with the speed than that of the other.

    Viscous friction by direction, d_a |dq_M|; Coulomb friction by direction is the offset.
    """

    name = "direction-friction"
    sizes = ("direction_friction",)
    typical_size = 0.1
    core_name: str | None = None
    description = "viscous friction that differs between the directions"
    consequence = "viscous friction is an average over the directions"
    experiment = "turn the joint at several constant speeds of both signs"
    record = "a record of motion at all speeds"


class TorqueDelay(Effect):
    """The logged torque lags the motion: latency of a bus, or a filter of the drive.

    The torque of time t is logged at t + T_d.
    """

    name = "torque-delay"
    sizes = ("torque_delay",)
    typical_size = 1e-3  # [s]
    misleads_inertias = True
    core_name: str | None = None
    description = "a delay of the logged torque behind the motion"
    consequence = "the phase of the torque turns inertia into viscous friction"
    experiment = "log torque and angle in the same cycle, or compare both at a hard stop"
    record = "a record with fast reversals"


RIGID_ONLY = (LoadSpeedFriction(), DirectionFriction(), TorqueDelay())
"""Effects that studies can name for rigid joints only."""

OF_RIGID_JOINTS = (
    "stribeck",
    "power-friction",
    "load-friction",
    "load-speed-friction",
    "direction-friction",
    "ground-spring",
    "encoder-zero",
    "torque-delay",
)
"""Names of the effects of which the rigid step has equations."""
