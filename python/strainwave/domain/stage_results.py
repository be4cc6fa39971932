"""Results of the stages of one run."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from strainwave.domain.arm_model import ArmModel, MotorResponse
from strainwave.domain.estimates import Diagnostic, Parameter, Prediction, Suspicion
from strainwave.domain.joint_models import JointModel, RecordModel, Sweep, TorsionFit
from strainwave.domain.linear_models import FrequencyResponse
from strainwave.domain.messages import Clause
from strainwave.domain.progress import Stage
from strainwave.domain.rigid_model import RigidModel
from strainwave.domain.signals import Activity, LinkSummary, Log
from strainwave.domain.study import Study


@dataclass(frozen=True, slots=True, kw_only=True)
class StageResults:
    """Results of the stages of one run, before any decision on their estimates."""

    study: Study
    stages: tuple[Stage, ...]  # that were requested
    rigid: RigidModel | None
    drive_gains: tuple[Parameter, ...] = ()  # estimated torques per volt, which `study` has
    fitted: tuple[Prediction, ...] = ()  # the model on the fitted records
    checks: tuple[Prediction, ...] = ()  # the model on validation records
    not_simulated: Mapping[str, str] = field(default_factory=dict)  # check record -> reason
    links: tuple[LinkSummary, ...] = ()  # for every joint and record that excites a gear
    records: tuple[RecordModel, ...] = ()  # for every excited joint, record by record
    joints: tuple[JointModel, ...] = ()  # fitted to all records of a joint
    torsions: tuple[TorsionFit, ...] = ()  # of joints without a model
    responses: Mapping[int, FrequencyResponse] = field(default_factory=dict)  # by joint
    sweeps: tuple[Sweep, ...] = ()
    whole_arm: ArmModel | None = None
    suspected: tuple[Suspicion, ...] = ()  # faults of the input
    stage_warnings: tuple[Diagnostic, ...] = ()  # of all stages
    failures: tuple[Clause, ...] = ()  # why stages failed
    motor_responses: tuple[MotorResponse, ...] = ()  # of fast records, if the arm was fitted
    activity: tuple[Activity, ...] = ()  # for each joint in the fitted records
    logs: tuple[Log, ...] = ()  # as read
