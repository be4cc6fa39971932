"""Identify the physical model of a robot arm with elastic joints from its logs.

    import strainwave as sw

    result = sw.identify("study.toml")
    result["gear_stiffness", 1].value

Every stage of `identify` is here too, as a function from records to one record.
Each name is imported when it is first used, so importing the package is fast.
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
        Stage,
        Study,
        WholeArmOptions,
    )
    from strainwave.domain.progress import ProgressEvent
    from strainwave.dynamics.arm import Arm
    from strainwave.errors import Cancelled, InvalidInput, NotIdentifiable, StrainwaveError
    from strainwave.identification.amplitude_sweep import compare_amplitudes
    from strainwave.identification.decoupling import decouple
    from strainwave.identification.frequency import estimate_response
    from strainwave.identification.joint_model import (
        fit_linear,
        identify_joint,
        identify_record,
        models_from_motors,
    )
    from strainwave.identification.rigid import fit_rigid
    from strainwave.identification.validation import predict_elastic, predict_rigid
    from strainwave.identification.whole_arm import fit_whole_arm
    from strainwave.io.logs import read_logs
    from strainwave.signals.consistency import check_consistency
    from strainwave.signals.hygiene import repair_records
    from strainwave.signals.link_motion import prepare_link_signals
    from strainwave.signals.motor import prepare_motor_signals

__version__ = "0.1.0"

_NAMES_OF_MODULE = {
    "strainwave.api": "Result compare identify read_result read_study",
    "strainwave.campaign.store": "read_parameters read_runs",
    "strainwave.domain": (
        "ArmDescription Channel Experiment FrequencyOptions Joint LinearOptions LinkOptions "
        "Options Parameter PhysicalOptions Prbs RigidOptions Servo Stage Study WholeArmOptions"
    ),
    "strainwave.domain.progress": "ProgressEvent",
    "strainwave.dynamics.arm": "Arm",
    "strainwave.errors": "Cancelled InvalidInput NotIdentifiable StrainwaveError",
    "strainwave.identification.amplitude_sweep": "compare_amplitudes",
    "strainwave.identification.decoupling": "decouple",
    "strainwave.identification.frequency": "estimate_response",
    "strainwave.identification.joint_model": (
        "fit_linear identify_joint identify_record models_from_motors"
    ),
    "strainwave.identification.rigid": "fit_rigid",
    "strainwave.identification.validation": "predict_elastic predict_rigid",
    "strainwave.identification.whole_arm": "fit_whole_arm",
    "strainwave.io.logs": "read_logs",
    "strainwave.signals.consistency": "check_consistency",
    "strainwave.signals.hygiene": "repair_records",
    "strainwave.signals.link_motion": "prepare_link_signals",
    "strainwave.signals.motor": "prepare_motor_signals",
}
_MODULE_OF = {name: module for module, names in _NAMES_OF_MODULE.items() for name in names.split()}

__all__ = [
    "Arm",
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
    "Stage",
    "StrainwaveError",
    "Study",
    "WholeArmOptions",
    "__version__",
    "check_consistency",
    "compare",
    "compare_amplitudes",
    "decouple",
    "estimate_response",
    "fit_linear",
    "fit_rigid",
    "fit_whole_arm",
    "identify",
    "identify_joint",
    "identify_record",
    "models_from_motors",
    "predict_elastic",
    "predict_rigid",
    "prepare_link_signals",
    "prepare_motor_signals",
    "read_logs",
    "read_parameters",
    "read_result",
    "read_runs",
    "read_study",
    "repair_records",
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
