"""Effects: optional terms of the joint model, one file for each name in `effects` of a study.

A new effect needs a file in this package, an entry in `_EFFECTS`, and its equations in
`rust/core/src/joint`. A `RecordEffect` needs no equations: it states how parameters and initial
states of the core change in a record. All other code loops over the registered effects.
"""

from __future__ import annotations

from strainwave.domain.effects.backlash import Backlash
from strainwave.domain.effects.dead_zone import DeadZone
from strainwave.domain.effects.drive_gain import DriveGain
from strainwave.domain.effects.drive_gain_by_record import DriveGainByRecord
from strainwave.domain.effects.drive_lag import DriveLag
from strainwave.domain.effects.drive_limit import DriveLimit
from strainwave.domain.effects.drive_saturation import DriveSaturation
from strainwave.domain.effects.encoder_zero import EncoderZero
from strainwave.domain.effects.flexible_link import FlexibleLink
from strainwave.domain.effects.friction_by_record import FrictionByRecord
from strainwave.domain.effects.ground_spring import GroundSpring
from strainwave.domain.effects.hysteresis import Hysteresis
from strainwave.domain.effects.interface import Effect, Input, KnownJoint, RecordEffect
from strainwave.domain.effects.kinematic_error import KinematicError
from strainwave.domain.effects.load_friction import LoadFriction
from strainwave.domain.effects.power_friction import PowerFriction
from strainwave.domain.effects.soft_base import SoftBase
from strainwave.domain.effects.stribeck import Stribeck
from strainwave.domain.effects.tilt import Tilt
from strainwave.domain.effects.torque_ripple import TorqueRipple
from strainwave.domain.parameter_table import parameter_table
from strainwave.domain.registry import Registry
from strainwave.errors import InvalidInput

__all__ = [
    "Effect",
    "Input",
    "KnownJoint",
    "RecordEffect",
    "all_effects",
    "effect_named",
    "names",
    "register",
    "unregister",
]

_EFFECTS = Registry[Effect](
    "effect",
    "an",
    "effects",
    (
        Stribeck(),
        Hysteresis(),
        KinematicError(),
        LoadFriction(),
        PowerFriction(),
        TorqueRipple(),
        Backlash(),
        GroundSpring(),
        DeadZone(),
        DriveGain(),
        DriveSaturation(),
        DriveLimit(),
        DriveLag(),
        Tilt(),
        FlexibleLink(),
        SoftBase(),
        FrictionByRecord(),
        DriveGainByRecord(),
        EncoderZero(),
    ),
)


def effect_named(name: str) -> Effect:
    """The effect with a name. Raises InvalidInput if there is none."""
    return _EFFECTS[name]


def names() -> tuple[str, ...]:
    """Names of all effects in the order of registration."""
    return _EFFECTS.names()


def all_effects() -> tuple[Effect, ...]:
    """All effects in the order of registration."""
    return _EFFECTS.all()


def register(effect: Effect) -> None:
    """Register an effect, so that studies can name it and fits test for it.

    Raises InvalidInput if the name is taken, if the core does not know a parameter, if a parameter
    is a size here and a shape in another effect, or if a size cannot be zero.
    """
    _EFFECTS.check_new(effect.name)
    for name in effect.names:
        problem = _parameter_fault(effect, name)
        if problem:
            raise InvalidInput(
                f"the parameter {name!r} of the effect {effect.name!r} {problem}",
                remedy="give it another name",
            )
    _EFFECTS.add(effect)


def _parameter_fault(effect: Effect, name: str) -> str | None:
    """Reason why a parameter cannot belong to an effect; None if it can."""
    if name not in parameter_table():
        return "is not a parameter of the compiled core"
    if name in effect.sizes and effect.described(name).range == "positive":
        return "is a size but cannot be zero"
    others = [other for other in _EFFECTS.all() if name in other.names]
    if any((name in other.sizes) != (name in effect.sizes) for other in others):
        return "has a different role in another effect"
    return None


def unregister(name: str) -> None:
    """Remove an effect. Raises InvalidInput if there is none of that name."""
    _EFFECTS.remove(name)
