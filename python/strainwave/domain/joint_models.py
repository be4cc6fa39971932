"""Models of one joint with an elastic gear: decoupled data, parameters, amplitude sweep."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from strainwave.display import Displayed
from strainwave.domain.arrays import BoolArray, FloatArray
from strainwave.domain.estimates import Diagnostic, Parameter
from strainwave.domain.linear_models import FrequencyResponse, Mode, ModelCheck, Modes, StateSpace
from strainwave.domain.messages import Clause, Value, text_of
from strainwave.domain.signals import Fusion, Lag
from strainwave.domain.study import Experiment


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
    joint: int  # from 1
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

    joint: int  # from 1
    experiments: tuple[str, ...]
    stiffness: Parameter
    torque: FloatArray  # (n_rows,) [N m, N] of the rigid model
    torsion: FloatArray  # (n_rows,) [rad, m]
    fit_percent: float


@dataclass(frozen=True, slots=True)
class JointModel(Displayed):
    """Physical parameters of one joint, estimated from one or several records."""

    joint: int  # from 1
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

    joint: int  # from 1
    points: tuple[SweepPoint, ...]  # by amplitude
    slope: float  # of the squared anti-resonance over the amplitude [rad^2/s^2 per V]
    slope_std: float
    verdict: Literal["hardening", "softening", "no-trend"]
