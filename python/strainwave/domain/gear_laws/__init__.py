"""Elastic laws of gears: `spring` of a study's `[[joint]]` -> what the law says, one file each.

A new law is a file beside these, a line below, and its equations in `rust/core/src/joint`. All
others ask the law of a joint and name none.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from types import MappingProxyType

from strainwave.domain.gear_laws.cubic import Cubic
from strainwave.domain.gear_laws.interface import STIFFNESS, GearLaw, GearParameter
from strainwave.domain.gear_laws.linear import Linear
from strainwave.domain.gear_laws.rigid import Rigid
from strainwave.domain.gear_laws.three_slope import ThreeSlope
from strainwave.domain.parameter_table import parameter_table
from strainwave.domain.registry import Registry
from strainwave.errors import InvalidInput

__all__ = [
    "RIGID",
    "STIFFNESS",
    "GearLaw",
    "GearParameter",
    "gear_law",
    "gear_parameters",
    "is_by_load",
    "is_slope",
    "known_instead",
    "lists",
    "names",
    "register",
    "unregister",
]

RIGID = Rigid.name
"""The law of the rigid stage."""

_LAWS = Registry[GearLaw]("gear law", "a", "spring", (Linear(), ThreeSlope(), Cubic(), Rigid()))


def gear_law(name: str) -> GearLaw:
    """A law by its name.

    `name`: As `spring` in a study file. Raises `InvalidInput`: There is none of that name.
    """
    return _LAWS[name]


def names() -> tuple[str, ...]:
    """Of all laws, in the order in which they were registered."""
    return _LAWS.names()


def register(law: GearLaw) -> None:
    """Make a law known, so that studies can name it.

    Raises `InvalidInput`: There is one of that name, or one of its parameters is none of the core's
    or means something else in another law.
    """
    _LAWS.check_new(law.name)
    known = gear_parameters()
    for own in law.parameters:
        other = known.get(own.name, own)
        if own.name not in parameter_table() or own != other:
            problem = "is none of the core's" if own == other else "is another in another law"
            raise InvalidInput(
                f"the parameter {own.name!r} of the gear law {law.name!r} {problem}",
                remedy="give it another name",
            )
    _LAWS.add(law)
    gear_parameters.cache_clear()


def unregister(name: str) -> None:
    """Forget a law.

    Raises `InvalidInput`: There is none of that name.
    """
    _LAWS.remove(name)
    gear_parameters.cache_clear()


@cache
def gear_parameters() -> Mapping[str, GearParameter]:
    """Every law's parameters by name; of a name that several have, the first law's."""
    found: dict[str, GearParameter] = {}
    for law in _LAWS.all():
        for parameter in law.parameters:
            found.setdefault(parameter.name, parameter)
    return MappingProxyType(found)


def is_slope(name: str) -> bool:
    """Whether a parameter is a stiffness of some law."""
    parameter = gear_parameters().get(name)
    return parameter is not None and parameter.is_slope


def is_by_load(name: str) -> bool:
    """Whether a parameter of some law shows only where a record loads the gear far enough."""
    parameter = gear_parameters().get(name)
    return parameter is not None and parameter.by_load


def lists() -> Mapping[str, Mapping[int, tuple[str, ...]]]:
    """Keys of a parameter file that take lists: key -> number of values -> parameters."""
    found: dict[str, dict[int, tuple[str, ...]]] = {}
    for law in _LAWS.all():
        for key, listed in law.lists.items():
            found.setdefault(key, {})[len(listed)] = listed
    for key, of_length in found.items():
        if key != STIFFNESS:  # of a law that has no such parameters
            of_length.setdefault(0, ())
    return found


def known_instead(law: GearLaw, known: Mapping[str, float]) -> GearLaw:
    """The law that values suffice for: a simpler one while none of a law's own is known.

    `known`: Name -> value.
    """
    if law.simpler is None:
        return law
    simpler = gear_law(law.simpler)
    own = set(law.names) - set(simpler.names)
    return known_instead(simpler, known) if own.isdisjoint(known) else law
