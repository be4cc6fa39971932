"""Effects: optional terms of the joint model, grouped by the part of the joint that they act on.

A new effect needs a class in one of these files, an entry in `_EFFECTS`, and its equations in
`rust/core/src/joint`. A `RecordEffect` needs no equations: it states how parameters and initial
states of the core change in a record. All other code loops over the registered effects.
"""

from __future__ import annotations

from strainwave.domain.effects.by_record import DriveGainByRecord, EncoderZero, FrictionByRecord
from strainwave.domain.effects.drive import (
    DeadZone,
    DriveGain,
    DriveLag,
    DriveLimit,
    DriveSaturation,
)
from strainwave.domain.effects.gear import (
    Backlash,
    Hysteresis,
    KinematicError,
    StiffnessCurve,
)
from strainwave.domain.effects.interface import Effect as Effect
from strainwave.domain.effects.interface import Input as Input
from strainwave.domain.effects.interface import KnownJoint as KnownJoint
from strainwave.domain.effects.interface import RecordEffect as RecordEffect
from strainwave.domain.effects.link import FlexibleLink, GroundSpring, SoftBase, Tilt
from strainwave.domain.effects.motor import LoadFriction, PowerFriction, Stribeck, TorqueRipple
from strainwave.domain.effects.rigid import OF_RIGID_JOINTS as OF_RIGID_JOINTS
from strainwave.domain.effects.rigid import RIGID_ONLY
from strainwave.domain.parameter_table import parameter_table
from strainwave.domain.registry import Registry
from strainwave.errors import InvalidInput

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


STIFFNESS_CURVE = StiffnessCurve()
"""The rival of all effects of an elastic gear with one stiffness. A study cannot name it."""


def effect_named(name: str) -> Effect:
    """The effect with a name. Raises InvalidInput if there is none."""
    further = {effect.name: effect for effect in (STIFFNESS_CURVE, *RIGID_ONLY)}
    return further[name] if name in further else _EFFECTS[name]


def study_names() -> tuple[str, ...]:
    """Names that studies can use: those of all effects, and of the effects of rigid joints."""
    return (*names(), *(effect.name for effect in RIGID_ONLY))


def possible_causes() -> tuple[Effect, ...]:
    """Everything that a model of a joint may lack: all effects, and a curve of its stiffness."""
    return (STIFFNESS_CURVE, *_EFFECTS.all())


names = _EFFECTS.names
"""Names of all effects in the order of registration."""

all_effects = _EFFECTS.all
"""All effects in the order of registration."""

unregister = _EFFECTS.remove
"""Remove an effect. Raises InvalidInput if there is none of that name."""


def register(effect: Effect) -> None:
    """Register an effect, so that studies can name it and fits test for it.

    Raises InvalidInput if the name is taken, if the core does not know a parameter, if a parameter
    is a size here and a shape in another effect, or if a size cannot be zero.
    """
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
