"""Elastic laws of gears: a class for each value of `spring` in a study's `[[joint]]` table.

A new law needs a class in this package, an entry in `LAWS`, and its equations in
`rust/core/src/joint`. All other code asks the law of a joint.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from functools import cache
from types import MappingProxyType

from strainwave.domain.arm.gear_laws.interface import STIFFNESS as STIFFNESS
from strainwave.domain.arm.gear_laws.interface import GearLaw as GearLaw
from strainwave.domain.arm.gear_laws.interface import GearParameter as GearParameter
from strainwave.domain.arm.gear_laws.laws import Cubic, Linear, Rigid, ThreeSlope
from strainwave.errors import entry_of

RIGID = Rigid.name
"""Name of the law without elasticity, which the rigid step uses for every joint."""

AUTO = "auto"
"""Value of `spring` for the law that the data support; linear until they have decided."""

LAWS: dict[str, GearLaw] = {law.name: law for law in (Linear(), ThreeSlope(), Cubic(), Rigid())}
"""All laws by name."""


def gear_law(name: str) -> GearLaw:
    """The law with a name. Raises InvalidInput if there is none."""
    return entry_of(LAWS, name, "gear law", "spring")


@cache
def gear_parameters() -> Mapping[str, GearParameter]:
    """Parameters of all laws by name. Laws that share a name share the parameter."""
    parameters = (parameter for law in LAWS.values() for parameter in law.parameters)
    return MappingProxyType({parameter.name: parameter for parameter in parameters})


def is_slope(name: str) -> bool:
    """Whether a parameter is a stiffness of some law."""
    parameter = gear_parameters().get(name)
    return parameter is not None and parameter.is_slope


def is_by_load(name: str) -> bool:
    """Whether only a record that loads the gear far enough identifies a parameter of some law."""
    parameter = gear_parameters().get(name)
    return parameter is not None and parameter.by_load


def lists() -> Mapping[str, Mapping[int, tuple[str, ...]]]:
    """Keys of a parameter file that accept lists: parameter names by key and number of values."""
    keys: dict[str, dict[int, tuple[str, ...]]] = {}
    for law in LAWS.values():
        for key, listed in law.lists.items():
            keys.setdefault(key, {})[len(listed)] = listed
    for key, by_length in keys.items():
        if key != STIFFNESS:  # an empty list belongs to a law without such parameters
            by_length.setdefault(0, ())
    return keys


def curved_laws() -> tuple[GearLaw, ...]:
    """Laws with more than one stiffness, those with the fewest parameters first."""
    curved = (law for law in LAWS.values() if law.is_curved)
    return tuple(sorted(curved, key=lambda law: len(law.parameters)))


def stated_law(spring: str) -> GearLaw:
    """The law that `spring` names. Raises InvalidInput if there is none."""
    return gear_law(Linear.name if spring == AUTO else spring)


def determined_law(spring: str, known: Collection[str]) -> GearLaw:
    """The law of a gear whose parameters in `known` have values.

    With `spring = "auto"` this is the law of which `known` has a parameter of its own. Otherwise it
    is the stated law, or the simpler law if no parameter of the stated law itself is known.
    """
    law = stated_law(spring)

    def has_own(law: GearLaw, simpler: GearLaw) -> bool:
        return not set(law.names).difference(simpler.names).isdisjoint(known)

    if spring == AUTO:
        return next((curved for curved in curved_laws() if has_own(curved, law)), law)
    if law.simpler is None or has_own(law, gear_law(law.simpler)):
        return law
    return determined_law(law.simpler, known)
