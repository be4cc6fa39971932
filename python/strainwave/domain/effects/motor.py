"""Effects on the motor: friction and torque ripple."""

from __future__ import annotations

from collections.abc import Mapping

from strainwave.domain.effects.interface import Effect


class Stribeck(Effect):
    """The breakaway torque of the motor exceeds Coulomb friction.

    Stribeck friction, (S10): f_M + f_S exp(-(dq_M/w_s)^2), largest at standstill.
    """

    name = "stribeck"
    sizes = ("stribeck_friction",)
    typical_size = 0.2
    relative_to = "coulomb_friction"
    shapes: Mapping[str, float] = {"stribeck_velocity": 3.0}
    description = "friction that falls with the motor's velocity"
    consequence = "Coulomb and viscous friction are biased"
    experiment = "turn the motor slowly at several constant speeds of both signs"
    record = "a record of slow motion"


class LoadFriction(Effect):
    """The teeth rub under load.

    Load friction, (S15): dry friction mu |n T| that grows with the gear torque.
    """

    name = "load-friction"
    sizes = ("load_friction",)
    typical_size = 0.05  # of the gear torque, motor side
    needs_elastic_gear = True
    description = "dry friction that grows with the gear torque"
    consequence = "Coulomb friction is too large and inertias are biased"
    experiment = (
        "turn the motor slowly back and forth under several loads, for example in several postures"
    )
    record = "a record of motion under changing load"


class PowerFriction(Effect):
    """Drag of grease that grows less than in proportion to the velocity.

    Power friction, (S16): f_P ((|dq_M|/w + s)^p - s^p), a power of the motor velocity.
    """

    name = "power-friction"
    sizes = ("power_friction",)
    typical_size = 0.2
    relative_to = "coulomb_friction"
    shapes: Mapping[str, float] = {"power_exponent": 0.5}
    description = "friction that grows with a power of the motor's velocity"
    consequence = "Coulomb and viscous friction each absorb a part of it"
    experiment = "turn the motor at several constant speeds of both signs up to the highest"
    record = "a record of motion at all speeds"


class TorqueRipple(Effect):
    """The motor cogs, or its commutation is wrong.

    Torque ripple, (S17): motor torque a_r cos(k q_M) + b_r sin(k q_M) over the motor angle.
    """

    name = "torque-ripple"
    sizes = ("torque_ripple_cos", "torque_ripple_sin")
    typical_size = 0.1
    relative_to = "coulomb_friction"
    # periods per turn: poles, windings, eccentricity
    shapes: Mapping[str, float] = {"torque_ripple_order": 2.0}
    tested: Mapping[str, tuple[float, ...]] = {"torque_ripple_order": (1.0, 4.0, 6.0)}
    description = "a periodic motor torque over the motor angle"
    consequence = "friction is biased, and so is damping if the ripple excites a resonance"
    experiment = (
        "turn the motor slowly at constant speed and look for spectral lines per turn"
        " in the voltage"
    )
    record = "a record of slow rotation at constant speed"
