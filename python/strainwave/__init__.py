"""Identify the physical model of a robot arm with elastic joints from its logs.

    import strainwave as sw

    result = sw.identify("study.toml")
    result["gear_stiffness", 1].value

Importing this package is cheap: each name is loaded when it is first asked for. Behind these names
the stages are modules, each with one main function from records to a record;
`strainwave.pipeline` runs them in order.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from strainwave.display import Display, register

if TYPE_CHECKING:
    from strainwave.api import Result, identify, read_result, read_study
    from strainwave.campaign.store import read_parameters, read_runs
    from strainwave.domain import (
        ArmDescription,
        Channel,
        Experiment,
        Joint,
        Options,
        Parameter,
        Prbs,
        Servo,
        Study,
    )
    from strainwave.domain.progress import ProgressEvent
    from strainwave.errors import Cancelled, InvalidInput, NotIdentifiable, StrainwaveError

__version__ = "0.1.0"

_HOMES = {
    "strainwave.api": ("Result", "identify", "read_result", "read_study"),
    "strainwave.campaign.store": ("read_parameters", "read_runs"),
    "strainwave.domain": (
        "ArmDescription",
        "Channel",
        "Experiment",
        "Joint",
        "Options",
        "Parameter",
        "Prbs",
        "Servo",
        "Study",
    ),
    "strainwave.domain.progress": ("ProgressEvent",),
    "strainwave.errors": ("Cancelled", "InvalidInput", "NotIdentifiable", "StrainwaveError"),
}
_HOME = {name: module for module, names in _HOMES.items() for name in names}

__all__ = [
    "ArmDescription",
    "Cancelled",
    "Channel",
    "Experiment",
    "InvalidInput",
    "Joint",
    "NotIdentifiable",
    "Options",
    "Parameter",
    "Prbs",
    "ProgressEvent",
    "Result",
    "Servo",
    "StrainwaveError",
    "Study",
    "__version__",
    "identify",
    "read_parameters",
    "read_result",
    "read_runs",
    "read_study",
]


def __getattr__(name: str) -> Any:
    """Load a public name; see `__all__`."""
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from importlib import import_module

    return getattr(import_module(_HOME[name]), name)


def __dir__() -> list[str]:
    return sorted(__all__)


def _notebook() -> Display:
    """What shows a record, loaded when a person looks."""
    from strainwave.presentation import notebook

    return notebook


register(_notebook)
