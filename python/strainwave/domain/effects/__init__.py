"""Effects: optional terms of the joint model.

A new effect needs an entry in `effects.toml`, and its equations in `rust/core/src/joint`. One that
changes parameters and initial states of the core in a record needs no equations, but a
`RecordEffect` in `interface.py`. All other code loops over the effects.
"""

from __future__ import annotations

import tomllib
from pathlib import Path

from strainwave.domain.effects.interface import SUBCLASSES
from strainwave.domain.effects.interface import Effect as Effect
from strainwave.domain.effects.interface import Input as Input
from strainwave.domain.effects.interface import KnownJoint as KnownJoint
from strainwave.domain.effects.interface import RecordEffect as RecordEffect
from strainwave.errors import entry_of

_TABLES = tomllib.loads(Path(__file__).with_name("effects.toml").read_text(encoding="utf-8"))


def _effects(group: str) -> tuple[Effect, ...]:
    effects = []
    for name, table in _TABLES[group].items():
        core_name = name if group == "core" else table.pop("core_name", None)
        kind, sizes = SUBCLASSES.get(name, Effect), tuple(table.pop("sizes"))
        effects.append(kind(name=name, core_name=core_name, sizes=sizes, **table))
    return tuple(effects)


EFFECTS = {effect.name: effect for effect in (*_effects("core"), *_effects("record"))}
"""Effects of elastic and of rigid joints by name."""

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
    "gear-torsion",
)
"""Names of the effects of which the rigid step has equations."""

(STIFFNESS_CURVE,) = _effects("gear-law")
"""The rival of all effects of an elastic gear with one stiffness. A study cannot name it."""


def effect_named(name: str) -> Effect:
    """The effect with a name. Raises InvalidInput if there is none."""
    further = {effect.name: effect for effect in (STIFFNESS_CURVE, *RIGID_ONLY)}
    return further.get(name) or entry_of(EFFECTS, name, "effect", "effects")


def study_names() -> tuple[str, ...]:
    """Names that studies can use: those of all effects, and of the effects of rigid joints."""
    return (*names(), *(effect.name for effect in RIGID_ONLY))


def possible_causes() -> tuple[Effect, ...]:
    """Everything that a model of a joint may lack: all effects, and a curve of its stiffness."""
    return (STIFFNESS_CURVE, *EFFECTS.values())


def names() -> tuple[str, ...]:
    """Names of all effects."""
    return tuple(EFFECTS)


def all_effects() -> tuple[Effect, ...]:
    """All effects."""
    return tuple(EFFECTS.values())
