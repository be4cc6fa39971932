"""Elastic laws of gears: a class for each value of `spring` in a study's `[[joint]]` table.

A new law needs a class in this package, an entry in `_LAWS`, and its equations in
`rust/core/src/joint`. All other code asks the law of a joint.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from functools import cache
from types import MappingProxyType

from strainwave.domain.gear_laws.interface import STIFFNESS as STIFFNESS
from strainwave.domain.gear_laws.interface import GearLaw as GearLaw
from strainwave.domain.gear_laws.interface import GearParameter as GearParameter
from strainwave.domain.gear_laws.smooth import Cubic, Linear, Rigid
from strainwave.domain.gear_laws.three_slope import ThreeSlope
from strainwave.domain.parameter_table import parameter_table
from strainwave.domain.registry import Registry
from strainwave.errors import InvalidInput

RIGID = Rigid.name
"""Name of the law without elasticity, which the rigid step uses for every joint."""

AUTO = "auto"
"""Value of `spring` for the law that the data support; linear until they have decided."""

_LAWS = Registry[GearLaw]("gear law", "a", "spring", (Linear(), ThreeSlope(), Cubic(), Rigid()))


gear_law = _LAWS.__getitem__
"""The law with a name. Raises InvalidInput if there is none."""

names = _LAWS.names
"""Names of all laws in the order of registration."""


def register(law: GearLaw) -> None:
    """Register a law, so that studies can name it.

    Raises InvalidInput if the name is taken, if the core does not know a parameter, or if a
    parameter has a different meaning in another law.
    """
    for parameter in law.parameters:
        problem = None
        if gear_parameters().get(parameter.name, parameter) != parameter:
            problem = "has a different meaning in another law"
        elif parameter.name not in parameter_table():
            problem = "is not a parameter of the compiled core"
        if problem:
            raise InvalidInput(
                f"the parameter {parameter.name!r} of the gear law {law.name!r} {problem}",
                remedy="give it another name",
            )
    _LAWS.add(law)
    gear_parameters.cache_clear()


def unregister(name: str) -> None:
    """Remove a law. Raises InvalidInput if there is none of that name."""
    _LAWS.remove(name)
    gear_parameters.cache_clear()


@cache
def gear_parameters() -> Mapping[str, GearParameter]:
    """Parameters of all laws by name. Laws that share a name share the parameter."""
    parameters = (parameter for law in _LAWS.all() for parameter in law.parameters)
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
    for law in _LAWS.all():
        for key, listed in law.lists.items():
            keys.setdefault(key, {})[len(listed)] = listed
    for key, by_length in keys.items():
        if key != STIFFNESS:  # an empty list belongs to a law without such parameters
            by_length.setdefault(0, ())
    return keys


def curved_laws() -> tuple[GearLaw, ...]:
    """Laws with more than one stiffness, those with the fewest parameters first."""
    curved = (law for law in _LAWS.all() if law.is_curved)
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
