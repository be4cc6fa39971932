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
from strainwave.version import __version__

if TYPE_CHECKING:
    from strainwave.api import Result as Result
    from strainwave.api import check as check
    from strainwave.api import compare as compare
    from strainwave.api import identify as identify
    from strainwave.api import read_logs as read_logs
    from strainwave.api import read_result as read_result
    from strainwave.api import read_study as read_study
    from strainwave.domain import ArmDescription as ArmDescription
    from strainwave.domain import Channel as Channel
    from strainwave.domain import Experiment as Experiment
    from strainwave.domain import FrequencyOptions as FrequencyOptions
    from strainwave.domain import Joint as Joint
    from strainwave.domain import LinearOptions as LinearOptions
    from strainwave.domain import LinkOptions as LinkOptions
    from strainwave.domain import Options as Options
    from strainwave.domain import Parameter as Parameter
    from strainwave.domain import Payload as Payload
    from strainwave.domain import PayloadEstimate as PayloadEstimate
    from strainwave.domain import PhysicalOptions as PhysicalOptions
    from strainwave.domain import Prbs as Prbs
    from strainwave.domain import RigidOptions as RigidOptions
    from strainwave.domain import Servo as Servo
    from strainwave.domain import Stage as Stage
    from strainwave.domain import Study as Study
    from strainwave.domain import WholeArmOptions as WholeArmOptions
    from strainwave.domain.steps import Detrend as Detrend
    from strainwave.domain.steps import LowPass as LowPass
    from strainwave.domain.steps import Merge as Merge
    from strainwave.domain.steps import Resample as Resample
    from strainwave.domain.study import ProgressEvent as ProgressEvent
    from strainwave.dynamics.arm import Arm as Arm
    from strainwave.errors import Cancelled as Cancelled
    from strainwave.errors import InvalidInput as InvalidInput
    from strainwave.errors import NotIdentifiable as NotIdentifiable
    from strainwave.errors import StrainwaveError as StrainwaveError
    from strainwave.fleet.campaign.store import read_parameters as read_parameters
    from strainwave.fleet.campaign.store import read_runs as read_runs
    from strainwave.identification.amplitude_sweep import compare_amplitudes as compare_amplitudes
    from strainwave.identification.decoupling import decouple as decouple
    from strainwave.identification.frequency import estimate_response as estimate_response
    from strainwave.identification.joint_model import fit_linear as fit_linear
    from strainwave.identification.joint_model import identify_joint as identify_joint
    from strainwave.identification.joint_model import identify_record as identify_record
    from strainwave.identification.joint_model import models_from_motors as models_from_motors
    from strainwave.identification.rigid import fit_rigid as fit_rigid
    from strainwave.identification.validation import predict_elastic as predict_elastic
    from strainwave.identification.validation import predict_rigid as predict_rigid
    from strainwave.identification.whole_arm import fit_whole_arm as fit_whole_arm
    from strainwave.input_check import check_consistency as check_consistency
    from strainwave.signals.hygiene import repair_records as repair_records
    from strainwave.signals.link_motion import prepare_link_signals as prepare_link_signals
    from strainwave.signals.motor import prepare_motor_signals as prepare_motor_signals
    from strainwave.tune.design import ServoDesign as ServoDesign
    from strainwave.tune.design import ServoOptions as ServoOptions
    from strainwave.tune.margins import Requirements as Requirements

_NAMES_OF_MODULE = {
    "strainwave.api": "Result check compare identify read_logs read_result read_study",
    "strainwave.fleet.campaign.store": "read_parameters read_runs",
    "strainwave.domain": (
        "ArmDescription Channel Experiment FrequencyOptions Joint LinearOptions LinkOptions "
        "Options Parameter Payload PayloadEstimate PhysicalOptions Prbs RigidOptions Servo Stage "
        "Study WholeArmOptions"
    ),
    "strainwave.domain.steps": "Detrend LowPass Merge Resample",
    "strainwave.domain.study": "ProgressEvent",
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
    "strainwave.tune.design": "ServoDesign ServoOptions",
    "strainwave.tune.margins": "Requirements",
    "strainwave.input_check": "check_consistency",
    "strainwave.signals.hygiene": "repair_records",
    "strainwave.signals.link_motion": "prepare_link_signals",
    "strainwave.signals.motor": "prepare_motor_signals",
}
_MODULE_OF = {name: module for module, names in _NAMES_OF_MODULE.items() for name in names.split()}

__all__ = ["__version__"]
__all__ += list(_MODULE_OF)


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
    from strainwave.report import notebook

    return notebook


register(_notebook)
