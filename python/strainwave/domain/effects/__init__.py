"""Effects: optional terms of the joint model.

A new effect needs an entry in `effects.toml`, and its equations in `rust/core/src/joint`. One that
changes parameters and initial states of the core in a record needs no equations, but a
`RecordEffect` in `subclasses.py`. All other code loops over the registered effects.
"""

from __future__ import annotations

import tomllib
from pathlib import Path

from strainwave.domain.effects.interface import Effect as Effect
from strainwave.domain.effects.interface import Input as Input
from strainwave.domain.effects.interface import KnownJoint as KnownJoint
from strainwave.domain.effects.interface import RecordEffect as RecordEffect
from strainwave.domain.effects.subclasses import SUBCLASSES
from strainwave.domain.parameter_table import parameter_table
from strainwave.domain.registry import Registry
from strainwave.errors import InvalidInput

_TABLES = tomllib.loads(Path(__file__).with_name("effects.toml").read_text(encoding="utf-8"))


def _effects(group: str) -> tuple[Effect, ...]:
    """Effects of a group of `effects.toml`."""
    effects = []
    for name, table in _TABLES[group].items():
        core_name = name if group == "core" else table.pop("core_name", None)
        kind, sizes = SUBCLASSES.get(name, Effect), tuple(table.pop("sizes"))
        effects.append(kind(name=name, core_name=core_name, sizes=sizes, **table))
    return tuple(effects)


_EFFECTS = Registry[Effect]("effect", "an", "effects", (*_effects("core"), *_effects("record")))

RIGID_ONLY = _effects("rigid")
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

(STIFFNESS_CURVE,) = _effects("gear-law")
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
