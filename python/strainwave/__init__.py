"""Identify the physical model of a robot arm with elastic joints from its logs.

    import strainwave as sw

    result = sw.identify("study.toml")
    result["gear_stiffness", 1].value

Each name is imported when it is first used, so importing the package is fast. The stages behind
these names are modules with one main function each, from records to a record;
`strainwave.pipeline` runs them in order.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from strainwave.display import Display, register

if TYPE_CHECKING:
    from strainwave.api import Result, compare, identify, read_result, read_study
    from strainwave.campaign.store import read_parameters, read_runs
    from strainwave.domain import (
        ArmDescription,
        Channel,
        Experiment,
        FrequencyOptions,
        Joint,
        LinearOptions,
        LinkOptions,
        Options,
        Parameter,
        PhysicalOptions,
        Prbs,
        RigidOptions,
        Servo,
        Study,
        WholeArmOptions,
    )
    from strainwave.domain.progress import ProgressEvent
    from strainwave.errors import Cancelled, InvalidInput, NotIdentifiable, StrainwaveError

__version__ = "0.1.0"

_NAMES_OF_MODULE = {
    "strainwave.api": ("Result", "compare", "identify", "read_result", "read_study"),
    "strainwave.campaign.store": ("read_parameters", "read_runs"),
    "strainwave.domain": (
        "ArmDescription",
        "Channel",
        "Experiment",
        "FrequencyOptions",
        "Joint",
        "LinearOptions",
        "LinkOptions",
        "Options",
        "Parameter",
        "PhysicalOptions",
        "Prbs",
        "RigidOptions",
        "Servo",
        "Study",
        "WholeArmOptions",
    ),
    "strainwave.domain.progress": ("ProgressEvent",),
    "strainwave.errors": ("Cancelled", "InvalidInput", "NotIdentifiable", "StrainwaveError"),
}
_MODULE_OF = {name: module for module, names in _NAMES_OF_MODULE.items() for name in names}

__all__ = [
    "ArmDescription",
    "Cancelled",
    "Channel",
    "Experiment",
    "FrequencyOptions",
    "InvalidInput",
    "Joint",
    "LinearOptions",
    "LinkOptions",
    "NotIdentifiable",
    "Options",
    "Parameter",
    "PhysicalOptions",
    "Prbs",
    "ProgressEvent",
    "Result",
    "RigidOptions",
    "Servo",
    "StrainwaveError",
    "Study",
    "WholeArmOptions",
    "__version__",
    "compare",
    "identify",
    "read_parameters",
    "read_result",
    "read_runs",
    "read_study",
]


def __getattr__(name: str) -> Any:
    """Import a public name; see `__all__`."""
    if name not in _MODULE_OF:
        from strainwave.errors import suggest_name

        hint = suggest_name(name, __all__)
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}{hint}")
    from importlib import import_module

    return getattr(import_module(_MODULE_OF[name]), name)


def __dir__() -> list[str]:
    return sorted(__all__)


def _notebook() -> Display:
    from strainwave.presentation import notebook

    return notebook


register(_notebook)
