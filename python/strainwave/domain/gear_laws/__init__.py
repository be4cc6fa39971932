"""Elastic laws of gears: one file for each value of `spring` in a study's `[[joint]]` table.

A new law needs a file in this package, an entry in `_LAWS`, and its equations in
`rust/core/src/joint`. All other code asks the law of a joint.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from types import MappingProxyType

from strainwave.domain.gear_laws.cubic import Cubic
from strainwave.domain.gear_laws.interface import STIFFNESS as STIFFNESS
from strainwave.domain.gear_laws.interface import GearLaw as GearLaw
from strainwave.domain.gear_laws.interface import GearParameter as GearParameter
from strainwave.domain.gear_laws.linear import Linear
from strainwave.domain.gear_laws.rigid import Rigid
from strainwave.domain.gear_laws.three_slope import ThreeSlope
from strainwave.domain.parameter_table import parameter_table
from strainwave.domain.registry import Registry
from strainwave.errors import InvalidInput

RIGID = Rigid.name
"""Name of the law without elasticity, which the rigid step uses for every joint."""

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


def determined_law(law: GearLaw, known: Mapping[str, float]) -> GearLaw:
    """The law that the known values (by name) determine.

    This is the simpler law if no parameter of the law itself is known.
    """
    if law.simpler is None:
        return law
    simpler = gear_law(law.simpler)
    specific_names = set(law.names) - set(simpler.names)
    return determined_law(simpler, known) if specific_names.isdisjoint(known) else law
