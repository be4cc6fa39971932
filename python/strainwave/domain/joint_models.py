"""One joint with an elastic gear: decoupled from the others, modelled, swept over amplitudes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from strainwave.display import Displayed
from strainwave.domain.arrays import BoolArray, FloatArray
from strainwave.domain.estimates import Diagnostic, Parameter
from strainwave.domain.linear_models import FrequencyResponse, Mode, ModelCheck, Modes, StateSpace
from strainwave.domain.signals import Fusion, Lag
from strainwave.domain.study import Experiment


@dataclass(frozen=True, slots=True)
class Check:
    """A question asked of the data, and the verdict."""

    name: str
    passed: bool
    value: float
    limit: float
    message: str


@dataclass(frozen=True, slots=True)
class Decoupled(Displayed):
    """One joint on its own: the other links act on it as an input like any other.

    m_M ddtheta_M + d_M dtheta_M = u - n [k delta + d_G ddelta]
    m_L ddtheta_L + d_L dtheta_L = k delta + d_G ddelta + tau
    """

    experiment: Experiment
    joint: int  # from 1
    time: FloatArray  # (n_samples,) [s]
    sample_time: float  # [s]
    inputs: FloatArray  # (n_samples, 1 or 2) [N m] u, and tau where other links or gravity act
    outputs: FloatArray  # (n_samples, 2) [rad/s] motor velocity, link velocity
    valid: BoolArray  # (n_samples,)
    held: bool  # u stays constant until the next sample; tau runs straight
    gear_ratio: float  # n, link turns per motor turn
    total_inertia: float | None  # c_1 = m_M + n^2 m_L [kg m^2] at the motor; None: not known
    total_viscous_friction: float | None  # c_0 = d_M + n^2 d_L [N m s/rad] at the motor
    bandwidth_hz: float | None  # of a zero-phase filter over everything; None: there is none
    shared: tuple[Lag, ...]  # low-passes that every signal has behind it
    fusion: Fusion | None  # how the link velocity was made; belongs into the output equation
    richness_hz: FloatArray  # (n_frequencies,) [Hz]
    richness: FloatArray  # (n_frequencies,) least over largest eigenvalue of the inputs' spectrum
    checks: tuple[Check, ...]
    warnings: tuple[Diagnostic, ...] = ()


@dataclass(frozen=True, slots=True)
class Resonance:
    """The zero and the pole pair of motor input to motor velocity."""

    anti_resonance_hz: float  # modulus over 2 pi
    anti_resonance_damping: float  # ratio
    resonance_hz: float
    resonance_damping: float


@dataclass(frozen=True, slots=True)
class JointModel(Displayed):
    """One joint's physical parameters, as one or several records of it give them."""

    joint: int  # from 1
    experiments: tuple[str, ...]
    method: Literal["grey-box", "transfer-function", "motor-response", "catalogue"]
    parameters: tuple[Parameter, ...]
    values: Mapping[str, float]  # of all parameters, also of those that the data hardly identify
    covariance: FloatArray  # (n_values, n_values), in the order of `values`
    anti_resonance: Mode | None  # zeros of motor torque to motor velocity
    resonance: Mode | None  # its poles
    band_hz: tuple[float, float]
    fit_percent: Mapping[str, float]  # of each equation, or of each output
    status: Literal["determined", "partly-determined", "implausible"]
    warnings: tuple[Diagnostic, ...] = ()


@dataclass(frozen=True, slots=True)
class RecordModel(Displayed):
    """Everything one record shows of the joint that was excited in it."""

    signals: Decoupled
    physical: JointModel | None  # from the equations of motion; None: it failed, or not wanted
    state_space: StateSpace | None  # by prediction-error minimisation; None: it failed
    modes: Modes | None  # of the state-space model
    transfer: (
        JointModel | None
    )  # from the state-space model, by (17), (18); None: failed, not wanted
    check: ModelCheck | None = None  # the state-space model on a part that it was not fitted to
    response: FrequencyResponse | None = None  # nonparametric; None: inputs not separated
    warnings: tuple[Diagnostic, ...] = ()

    @property
    def joint_model(self) -> JointModel | None:
        """From the equations of motion, or where there is none, by (17), (18)."""
        return self.physical or self.transfer


@dataclass(frozen=True, slots=True)
class SweepPoint:
    """One joint at one amplitude of excitation."""

    experiment: str
    amplitude: float  # [V], or [N m] where torque is logged
    squared_anti_resonance: float  # (2 pi f_a)^2 [rad^2/s^2], proportional to the stiffness
    squared_anti_resonance_std: float
    gear_stiffness: float  # [N m/rad], equivalent
    gear_stiffness_std: float


@dataclass(frozen=True, slots=True)
class Sweep(Displayed):
    """How one joint's equivalent stiffness goes with the amplitude."""

    joint: int  # from 1
    points: tuple[SweepPoint, ...]  # by amplitude
    slope: float  # of the squared anti-resonance over the amplitude [rad^2/s^2 per V]
    slope_std: float
    verdict: Literal["hardening", "softening", "no-trend"]
