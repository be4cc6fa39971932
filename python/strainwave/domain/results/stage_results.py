"""Results of the stages of one run: rigid model, models of elastic joints, and all others."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Literal, Self

import numpy as np

from strainwave.display import Displayed
from strainwave.domain.arm.description import ArmDescription
from strainwave.domain.keys import BoolArray, FloatArray, JointNumber
from strainwave.domain.messages import Clause, Value, text_of
from strainwave.domain.results.arm_model import ArmModel, MotorResponse
from strainwave.domain.results.consistency import Suspicion
from strainwave.domain.results.estimates import Diagnostic, Parameter, Prediction
from strainwave.domain.results.linear_models import (
    FrequencyResponse,
    Mode,
    ModelCheck,
    Modes,
    StateSpace,
)
from strainwave.domain.results.signals import Activity, Fusion, Lag, LinkSummary, Log
from strainwave.domain.study import Experiment, Stage, Study


@dataclass(frozen=True, slots=True)
class DriveGains:
    """Torques per volt, estimated from records with and without a known payload."""

    parameters: tuple[Parameter, ...]  # `torque_per_volt` of the joints whose drive is unknown
    relative_covariance: FloatArray  # (n_gains, n_gains) of their logarithms
    warnings: tuple[Diagnostic, ...] = ()

    def of(self, arm: ArmDescription) -> ArmDescription:
        """The arm with the estimates."""
        for parameter in self.parameters:
            arm = arm.with_joint(parameter.joint or 1, torque_per_volt=parameter.value)
        return arm


@dataclass(frozen=True, slots=True)
class FrictionTerm:
    """Effect of rigid joints in addition to inertia, viscous and Coulomb friction."""

    effect: str  # names the law
    joint: JointNumber | None  # None for all joints
    size: Parameter
    shape: float  # of the law
    estimated_shape: Parameter | None = None  # None if the shape is given or the law has none
    changes: Mapping[str, float] = field(default_factory=dict)  # of other values, by their labels

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Estimates of size and shape."""
        return (self.size,) if self.estimated_shape is None else (self.size, self.estimated_shape)


ASSUMED_TORQUE_ERROR = 0.01
"""Error of a motor's torque over its rms value: friction and drives of a rig vary by this much."""


@dataclass(frozen=True, slots=True)
class RigidModel(Displayed):
    """Estimate of the arm with rigid joints, (5) to (7)."""

    parameters: tuple[Parameter, ...]
    solution: FloatArray  # (n_parameters,) values, of minimum norm if not determined
    covariance: FloatArray  # (n_parameters, n_parameters), order of `parameters`; NaN where unknown
    condition_number: float  # of the column-scaled, weighted regressor
    fit_percent: Mapping[str, Mapping[str, float]]  # by experiment and channel
    bandwidth_hz: float  # of the zero-phase filter, chosen from the data
    decimation: int
    n_rows: int  # equations after decimation and rejection
    status: Literal["determined", "partly-determined", "not-identifiable"]
    warnings: tuple[Diagnostic, ...] = ()
    # joint -> torque of joint 1 over that joint relative to the symmetry of M(q), and its standard
    # deviation; 1 if both torque constants are right
    torque_ratios: Mapping[int, tuple[float, float]] = field(default_factory=dict)
    # joint -> residual of the equations over their torque, rms values within the bandwidth
    torque_errors: Mapping[int, float] = field(default_factory=dict)
    friction_terms: tuple[FrictionTerm, ...] = ()  # further friction that the data support
    # samples of the fitted motion: angle, velocity, acceleration of the motors. The velocity is
    # zero where the motor may stick.
    motion: FloatArray = field(default_factory=lambda: np.zeros((3, 0, 0)))  # (3, n, n_joints)

    def value(self, name: str, joint: int | None = None) -> float | None:
        """Value of one parameter; None if it is not identifiable.

        Raises KeyError if the model has no such parameter.
        """
        for parameter in self.parameters:
            if parameter.name == name and parameter.joint == joint:
                return parameter.value
        raise KeyError(f"{name} of joint {joint}" if joint else name)


@dataclass(frozen=True, slots=True)
class Check:
    """One check of the data and its result."""

    name: str
    passed: bool
    value: float
    limit: float
    values: tuple[tuple[str, Value], ...]  # of the message

    @property
    def clause(self) -> Clause:
        """Observation, and the remedy if the check failed."""
        return Clause(f"{self.name}/passed" if self.passed else self.name, **dict(self.values))

    @property
    def message(self) -> str:
        """Observation, and the remedy if the check failed, as text."""
        return text_of(self.clause)


@dataclass(frozen=True, slots=True)
class Decoupled(Displayed):
    """One joint with the interaction torque as second input.

    m_M ddtheta_M + d_M dtheta_M = u - n [k delta + d_G ddelta]
    m_L ddtheta_L + d_L dtheta_L = k delta + d_G ddelta + tau
    """

    experiment: Experiment
    joint: JointNumber
    time: FloatArray  # (n_samples,) [s]
    sample_time: float  # [s]
    inputs: FloatArray  # (n_samples, 1 or 2) [N m] u, and tau if other links or gravity act
    outputs: FloatArray  # (n_samples, 2) [rad/s] motor velocity, link velocity
    valid: BoolArray  # (n_samples,)
    held: bool  # zero-order hold of u; tau has a first-order hold
    gear_ratio: float  # n, link turns per motor turn
    total_inertia: float | None  # c_1 = m_M + n^2 m_L [kg m^2] motor side; None: unknown
    total_viscous_friction: float | None  # c_0 = d_M + n^2 d_L [N m s/rad] motor side
    bandwidth_hz: float | None  # of a zero-phase filter of all signals; None: no filter
    shared: tuple[Lag, ...]  # low-passes applied to every signal
    fusion: Fusion | None  # of the link velocity; part of the output equation
    richness_hz: FloatArray  # (n_frequencies,) [Hz] at which the inputs are tested
    checks: tuple[Check, ...]
    warnings: tuple[Diagnostic, ...] = ()
    posture: tuple[float, ...] = ()  # link angles [rad] of m_L; empty: all are zero


@dataclass(frozen=True, slots=True)
class Resonance:
    """Zero pair and pole pair from motor torque to motor velocity."""

    anti_resonance_hz: float  # modulus over 2 pi
    anti_resonance_damping: float  # ratio
    resonance_hz: float
    resonance_damping: float


@dataclass(frozen=True, slots=True)
class TorsionFit:
    """Stiffness of a gear from the torsion that its encoders show in slow motion.

    Torque and torsion are low-passed, without offsets and without the parts that follow the link's
    own acceleration and velocity.
    """

    joint: JointNumber
    experiments: tuple[str, ...]
    stiffness: Parameter
    torque: FloatArray  # (n_rows,) [N m, N] of the rigid model
    torsion: FloatArray  # (n_rows,) [rad, m]
    fit_percent: float


@dataclass(frozen=True, slots=True)
class JointModel(Displayed):
    """Physical parameters of one joint, estimated from one or several records."""

    joint: JointNumber
    experiments: tuple[str, ...]
    method: Literal["grey-box", "transfer-function", "motor-response", "catalogue"]
    parameters: tuple[Parameter, ...]
    values: Mapping[str, float]  # of all parameters, including poorly identified ones
    covariance: FloatArray  # (n_values, n_values), in the order of `values`
    anti_resonance: Mode | None  # zeros of motor torque to motor velocity
    resonance: Mode | None  # its poles
    band_hz: tuple[float, float]
    fit_percent: Mapping[str, float]  # of each equation, or of each output
    status: Literal["determined", "partly-determined", "implausible"]
    warnings: tuple[Diagnostic, ...] = ()
    posture: tuple[float, ...] = ()  # link angles [rad] of `link_inertia`; empty: all are zero


@dataclass(frozen=True, slots=True)
class RecordModel(Displayed):
    """All models of the joint that was excited in one record."""

    signals: Decoupled
    physical: JointModel | None  # from the equations of motion; None: failed or not requested
    state_space: StateSpace | None  # by the prediction-error method; None: failed
    modes: Modes | None  # of the state-space model
    # from the state-space model, by (17), (18); None: failed or not requested
    transfer: JointModel | None
    check: ModelCheck | None = None  # the state-space model on held-out data
    response: FrequencyResponse | None = None  # nonparametric; None: inputs not separable
    warnings: tuple[Diagnostic, ...] = ()

    @property
    def joint_model(self) -> JointModel | None:
        """The model from the equations of motion, or else the model by (17), (18)."""
        return self.physical or self.transfer


@dataclass(frozen=True, slots=True)
class SweepPoint:
    """Estimates of one joint at one excitation amplitude."""

    experiment: str
    amplitude: float  # [V], or [N m] if torque is logged
    squared_anti_resonance: float  # (2 pi f_a)^2 [rad^2/s^2], proportional to the stiffness
    squared_anti_resonance_std: float
    gear_stiffness: float  # [N m/rad], equivalent
    gear_stiffness_std: float


@dataclass(frozen=True, slots=True)
class Sweep(Displayed):
    """Equivalent stiffness of one joint over the amplitude."""

    joint: JointNumber
    points: tuple[SweepPoint, ...]  # by amplitude
    slope: float  # of the squared anti-resonance over the amplitude [rad^2/s^2 per V]
    slope_std: float
    verdict: Literal["hardening", "softening", "no-trend"]


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

    def warn(self, warnings: Iterable[Diagnostic]) -> Self:
        """The results with further warnings."""
        return replace(self, stage_warnings=(*self.stage_warnings, *warnings))

    def fail(self, reason: Clause) -> Self:
        """The results with the reason why a stage failed."""
        return replace(self, failures=(*self.failures, reason))
