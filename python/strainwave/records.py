"""Frozen data that the stages pass on: logs -> signals -> rigid -> ... -> report.

Samples are rows everywhere: arrays are (n_samples, n_joints) or (n_samples,). All units SI, angles
in rad. Joints are numbered from 1 where a person reads them and from 0 as array columns.

The study's records carry their constraints as `annotated_types`; `strainwave.study` checks them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from annotated_types import Ge, Gt, MinLen
from numpy.typing import NDArray

from strainwave.shown import Shown

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.int_]
ComplexArray = NDArray[np.complex128]

Positive = Annotated[float, Gt(0.0)]
NonNegative = Annotated[float, Ge(0.0)]

ArmKind = Literal["planar-two-link", "single-joint"]
Motion = Literal["revolute", "prismatic"]
Spring = Literal["linear", "three-slope", "rigid"]
Effect = Literal["stribeck", "hysteresis", "kinematic-error"]
Use = Literal["motion", "frequency", "sweep", "tuning", "check"]
Control = Literal["open", "servo"]


# --- the study: what was measured, on what, and how -------------------------------------------


@dataclass(frozen=True, slots=True)
class Arm:
    """The arm as a whole: `[arm]`."""

    kind: ArmKind
    link_length: Positive | None = None  # l_1 [m], joint 1 axis to joint 2 axis
    gravity: NonNegative | None = None  # [m/s^2] along -y in the plane of motion


@dataclass(frozen=True, slots=True)
class Joint:
    """One joint's drive and sensors: `[[joint]]`."""

    spring: Spring
    gear_ratio: Positive  # n, link turns per motor turn
    motion: Motion = "revolute"
    torque_per_volt: Positive | None = None  # e [N m/V] at the motor
    current_loop_hz: Positive | None = None
    encoder_counts: Positive | None = None  # per motor turn
    accelerometer_distance: Positive | None = None  # l_a [m]
    accelerometer_hz: Positive | None = None  # second-order Butterworth
    gyro_hz: Positive | None = None  # first order
    effects: tuple[Effect, ...] = ()  # that its friction and gear may have


@dataclass(frozen=True, slots=True)
class Servo:
    """PI velocity servo: u = kp e + ki integral(e), e = reference - encoder difference / period."""

    kind: Literal["pi-velocity"]
    period: Positive  # [s]
    kp: tuple[NonNegative, ...]  # [V s/rad], one a joint
    ki: tuple[NonNegative, ...]  # [V/rad], one a joint
    limit: Positive  # [V]


@dataclass(frozen=True, slots=True)
class Channel:
    """Where a channel comes from: value = scale * column + offset."""

    column: str
    scale: float = 1.0
    offset: float = 0.0


@dataclass(frozen=True, slots=True)
class TopicChannel:
    """Where a channel comes from in a bag: a number in each message of a topic."""

    topic: Annotated[str, MinLen(1)]
    field: Annotated[str, MinLen(1)]  # as in a message: "position", "data[0]", "a.b.c"
    name: str | None = None  # of the joint, where the field has one number a joint
    scale: float = 1.0
    offset: float = 0.0

    @property
    def channel(self) -> Channel:
        """The same, with the name that the bag's reader gives to the column."""
        at = "" if self.name is None else f"[{self.name}]"
        return Channel(f"{self.topic}.{self.field}{at}", self.scale, self.offset)


@dataclass(frozen=True, slots=True)
class Prbs:
    """A maximum-length binary sequence, `2**order - 1` clocks long."""

    order: Annotated[int, Ge(2)]
    clock: Positive  # [s]
    periods: Annotated[int, Ge(1)]
    amplitude: Positive  # [V]


@dataclass(frozen=True, slots=True)
class Experiment:
    """One log file and what it is for: `[[experiment]]`."""

    name: Annotated[str, MinLen(1)]
    file: Annotated[str, MinLen(1)]  # beside the study file
    use: Use
    control: tuple[Control, ...]  # one a joint
    joint: Annotated[int, Ge(1)] | None = None  # the excited joint, from 1
    prbs: Prbs | None = None
    start: float | None = None  # [s]
    stop: float | None = None  # [s]
    add: Mapping[str, str] = field(default_factory=dict)  # channel -> column added to it


@dataclass(frozen=True, slots=True)
class Study:
    """A whole study file, checked."""

    path: Path
    sha256: str
    arm: Arm
    joints: tuple[Joint, ...]
    experiments: tuple[Experiment, ...]
    servo: Servo | None = None
    channels: Mapping[str, Channel] = field(default_factory=dict)

    @property
    def n_joints(self) -> int:
        """Joints of the arm."""
        return len(self.joints)

    def log_path(self, experiment: Experiment) -> Path:
        """Where an experiment's log lies: beside the study file."""
        return self.path.parent / experiment.file


CHANNELS = ("u", "torque", "theta_m", "omega_m", "a", "theta_l", "deflection", "gyro", "ref")
"""Channels there is one of per joint; `t` stands alone."""


def channel_names(count: int) -> tuple[str, ...]:
    """Every channel an arm of `count` joints can have.

    Parameters
    ----------
    count : int

    Returns
    -------
    tuple of str
    """
    return ("t", *(f"{name}{i}" for name in CHANNELS for i in range(1, count + 1)))


# --- what is said beside the numbers ----------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Caution:
    """Something the reader must know to trust, or not trust, an answer."""

    code: str  # kebab-case, stable: the troubleshooting page is indexed by it
    where: str  # file, experiment, joint or parameter
    message: str  # what, and what to do about it


# --- logs and signals -------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Log(Shown):
    """One experiment's measured channels on a uniform time base, in SI units."""

    experiment: Experiment
    time: FloatArray  # (n_samples,) [s], uniform
    sample_time: float  # [s]
    channels: Mapping[str, FloatArray]  # contract's channel name -> (n_samples,)
    warnings: tuple[Caution, ...] = ()

    @property
    def name(self) -> str:
        """The experiment's."""
        return self.experiment.name

    def __len__(self) -> int:
        return len(self.time)


@dataclass(frozen=True, slots=True)
class Signals:
    """Motor-side signals of one experiment, every one through the same zero-phase filter.

    Filtered quantities of different kinds may be put into one equation: the same linear filter
    acts on both sides of it. What is not linear, the direction of sliding, comes unfiltered.
    """

    experiment: Experiment
    time: FloatArray  # (n_samples,) [s]
    sample_time: float  # [s]
    motor_torque: FloatArray  # (n_samples, n_joints) [N m] at the motor, filtered
    motor_angle: FloatArray  # (n_samples, n_joints) [rad], filtered
    motor_velocity: FloatArray  # (n_samples, n_joints) [rad/s], filtered
    motor_acceleration: FloatArray  # (n_samples, n_joints) [rad/s^2], filtered
    direction: FloatArray  # (n_samples, n_joints) +-1 where the motor slides; 0: it may stand
    bandwidth_hz: float | None  # of the zero-phase filter; None where nothing was filtered
    angle_noise: FloatArray  # (n_joints,) [rad] standard deviation, white
    valid: BoolArray  # (n_samples, n_joints): False at edges and where the drive saturates
    unfiltered_torque: FloatArray  # (n_samples, n_joints) [N m] at the motor, at the stamps
    torque_channel: tuple[str, ...]  # the log's channel each torque came from
    warnings: tuple[Caution, ...] = ()


# --- models -----------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Parameter:
    """One physical parameter with its uncertainty; `None` is what could not be told."""

    name: str  # as in docs/notation.md
    joint: int | None  # from 1; None for the arm's own
    value: float | None
    std: float | None
    unit: str
    stage: str
    ci95: tuple[float, float] | None = None


@dataclass(frozen=True, slots=True)
class RigidModel(Shown):
    """The rigid-joint arm (5)-(7) as estimated."""

    parameters: tuple[Parameter, ...]
    solution: FloatArray  # (n_parameters,) their values, of least norm where not determined
    covariance: FloatArray  # (n_parameters, n_parameters), order of `parameters`; NaN where unknown
    condition_number: float  # of the column-scaled, weighted regressor
    fit_percent: Mapping[str, Mapping[str, float]]  # experiment -> channel -> fit
    bandwidth_hz: float  # of the zero-phase filter the data asked for
    decimation: int
    n_rows: int  # equations used, after decimation and rejection
    status: Literal["determined", "partly-determined", "not-identifiable"]
    warnings: tuple[Caution, ...] = ()

    def value(self, name: str, joint: int | None = None) -> float | None:
        """The value of one parameter; `None` where it could not be told.

        Raises
        ------
        KeyError
            The model has no such parameter.
        """
        for parameter in self.parameters:
            if parameter.name == name and parameter.joint == joint:
                return parameter.value
        raise KeyError(f"{name} of joint {joint}" if joint else name)


@dataclass(frozen=True, slots=True)
class Prediction(Shown):
    """What a model says a record's channels should have been."""

    experiment: str
    time: FloatArray  # (n_samples,) [s]
    channels: tuple[str, ...]
    measured: FloatArray  # (n_samples, n_channels)
    predicted: FloatArray  # (n_samples, n_channels)
    fit_percent: Mapping[str, float]  # channel -> 100 (1 - |y - yhat| / |y - mean y|)
    unfiltered_fit_percent: Mapping[str, float] = field(default_factory=dict)  # with y as logged
    warnings: tuple[Caution, ...] = ()


# --- state-space models -------------------------------------------------------------------------

Hold = Literal["zero", "first"]  # between samples: held, or joined by straight lines


@dataclass(frozen=True, slots=True)
class InputOutput:
    """One uninterrupted stretch of inputs and outputs on a uniform time base."""

    inputs: FloatArray  # (n_samples, n_inputs)
    outputs: FloatArray  # (n_samples, n_outputs)
    sample_time: float  # [s]
    hold: tuple[Hold, ...] = ()  # one an input; empty: all "zero"
    input_names: tuple[str, ...] = ()
    output_names: tuple[str, ...] = ()

    def window(self, start: int, stop: int) -> InputOutput:
        """Samples `start` to `stop` - 1."""
        return replace(self, inputs=self.inputs[start:stop], outputs=self.outputs[start:stop])


@dataclass(frozen=True, slots=True)
class StateSpace:
    """x+ = A x + B u + K e, y = C x + D u + e, e white: a sampled model in innovations form.

    Its coordinates are arbitrary; whatever does not depend on them has a variance, which
    `covariance` gives through the delta method (`strainwave.statespace.propagate`).
    """

    A: FloatArray  # (order, order)
    B: FloatArray  # (order, n_inputs)
    C: FloatArray  # (n_outputs, order)
    D: FloatArray  # (n_outputs, n_inputs)
    K: FloatArray  # (order, n_outputs)
    noise_covariance: FloatArray  # (n_outputs, n_outputs) of e
    initial_states: FloatArray  # (n_records, order) at the first sample of each record
    sample_time: float  # [s]
    hold: tuple[Hold, ...]  # one an input
    method: Literal["subspace", "pem", "output-error"]
    status: Literal["estimated", "converged", "iteration-limit", "stalled", "not-determined"]
    fit_percent: tuple[float, ...]  # one an output: simulated from the inputs alone
    prediction_fit_percent: tuple[float, ...]  # one an output: one step ahead
    n_samples: int
    n_parameters: int  # directions in which the model moves; initial states included
    log_likelihood: float  # Gaussian, at the estimate
    # of the entries A, B, C, D, K, each row by row; singular along changes of coordinates
    covariance: FloatArray | None = None
    covariance_kind: Literal["white", "sandwich"] | None = None
    singular_values: FloatArray | None = None  # of the subspace step
    horizon: int | None = None  # of the subspace step, in samples
    iterations: int = 0
    evaluations: int = 0
    input_names: tuple[str, ...] = ()
    output_names: tuple[str, ...] = ()
    warnings: tuple[Caution, ...] = ()

    @property
    def order(self) -> int:
        """Number of states."""
        return len(self.A)

    @property
    def aic(self) -> float:
        """Akaike's criterion; less is better."""
        return 2.0 * self.n_parameters - 2.0 * self.log_likelihood

    @property
    def bic(self) -> float:
        """Schwarz's criterion; less is better."""
        return self.n_parameters * float(np.log(self.n_samples)) - 2.0 * self.log_likelihood


@dataclass(frozen=True, slots=True)
class ContinuousStateSpace:
    """dx/dt = A x + B u, y = C x + D u: what a sampled model is between the samples."""

    A: FloatArray  # (order, order) [1/s]
    B: FloatArray  # (order, n_inputs)
    C: FloatArray  # (n_outputs, order)
    D: FloatArray  # (n_outputs, n_inputs)
    # of the entries A, B, C, D, each row by row
    covariance: FloatArray | None = None
    input_names: tuple[str, ...] = ()
    output_names: tuple[str, ...] = ()
    warnings: tuple[Caution, ...] = ()

    @property
    def order(self) -> int:
        """Number of states."""
        return len(self.A)


@dataclass(frozen=True, slots=True)
class Mode:
    """A pole or a zero of a continuous-time model: one complex pair, or one real number."""

    value: complex  # [rad/s], imaginary part not negative
    frequency_hz: float  # modulus over 2 pi
    damping: float  # -real part over modulus; one on the negative real axis
    frequency_std_hz: float | None
    damping_std: float | None

    @property
    def oscillates(self) -> bool:
        """Whether it is a complex pair."""
        return self.value.imag > 0.0


@dataclass(frozen=True, slots=True)
class Modes:
    """Poles of a model, and zeros from one of its inputs to one of its outputs."""

    poles: tuple[Mode, ...]  # by frequency
    zeros: tuple[Mode, ...]  # by frequency
    resonance: Mode | None  # the least damped pair of poles, if any oscillates
    anti_resonance: Mode | None  # the least damped pair of zeros


@dataclass(frozen=True, slots=True)
class FrequencyResponse(Shown):
    """Response of every output to every input, with its uncertainty."""

    frequencies_hz: FloatArray  # (n_frequencies,)
    response: NDArray[np.complex128]  # (n_frequencies, n_outputs, n_inputs)
    # (n_frequencies, n_outputs, n_inputs, 2, 2) of real and imaginary part
    covariance: FloatArray | None = None
    coherence: FloatArray | None = None  # (n_frequencies, n_outputs), multiple
    # Variance of the response, (n_frequencies, n_outputs, n_inputs), by its source; None: unknown
    noise_variance: FloatArray | None = None
    distortion_variance: FloatArray | None = None  # of one record's response
    method: Literal["model", "periods", "welch"] = "model"
    n_averages: int = 0
    warnings: tuple[Caution, ...] = ()

    @property
    def magnitude_std(self) -> FloatArray | None:
        """Standard deviation of the modulus, to first order."""
        return self._std(self.response / np.abs(self.response))

    @property
    def phase_std(self) -> FloatArray | None:
        """Standard deviation of the phase [rad], to first order."""
        return self._std(1j * self.response / np.abs(self.response) ** 2)

    def _std(self, along: NDArray[np.complex128]) -> FloatArray | None:
        if self.covariance is None:
            return None
        direction = np.stack([along.real, along.imag], axis=-1)
        variance = np.einsum("...i,...ij,...j->...", direction, self.covariance, direction)
        return np.asarray(np.sqrt(np.maximum(variance, 0.0)))


@dataclass(frozen=True, slots=True)
class HypothesisTest:
    """One test of residuals, with its verdict."""

    name: Literal["white", "independent-of-past-inputs", "no-feedback"]
    statistic: float  # chi-square if the hypothesis holds
    degrees: int
    p_value: float
    passed: bool
    message: str  # the verdict in a sentence


@dataclass(frozen=True, slots=True)
class ModelCheck:
    """A state-space model on data: fits and residual tests."""

    fit_percent: tuple[float, ...]  # one an output: simulated, initial state from the data
    prediction_fit_percent: tuple[float, ...]
    tests: tuple[HypothesisTest, ...]
    autocorrelation: FloatArray  # (lags, n_outputs, n_outputs), lags 0, 1, ..., normalised
    cross_correlation: FloatArray  # (2 lags + 1, n_outputs, n_inputs), lags -L..L, normalised
    confidence_99: float  # bound of one normalised correlation

    @property
    def passed(self) -> bool:
        """Whether no test failed."""
        return all(test.passed for test in self.tests)


@dataclass(frozen=True, slots=True)
class OrderSelection:
    """Models of several orders, and the one to take."""

    models: tuple[StateSpace, ...]
    # One tuple a model, one number an output: one step ahead, or simulated if K was not estimated.
    held_out_fit_percent: tuple[tuple[float, ...], ...]
    chosen: int  # the order
    rule: str  # why

    @property
    def model(self) -> StateSpace:
        """The chosen one."""
        return next(model for model in self.models if model.order == self.chosen)


# --- comparisons --------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Comparison:
    """One claim of the method, put to the built-in arm whose truth is known."""

    figure: int  # of the source that makes the claim
    title: str
    claim: str  # in one sentence
    holds: bool  # on this arm
    values: Mapping[str, float]  # NaN: there is none
    message: str  # the number that shows it, or why it does not hold
    plots: tuple[dict[str, Any], ...]  # plotly figures; the caption is `layout.meta`


# --- the whole run ------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Lag:
    """A low-pass filter that a sensor or a drive has."""

    order: Literal[1, 2]  # 2: Butterworth
    cutoff_hz: float


@dataclass(frozen=True, slots=True)
class Fusion:
    """How a link velocity was put together, (10), with the low-pass F of unit gain at rest.

    dtheta_L = (1 - F) integral(ddtheta_L) + F n dtheta_M: above the corner from the acceleration,
    below it from the motor. F = 1/(1 + s T_V), or 1/(1 + sqrt(2) s T_V + (s T_V)^2).
    """

    time_constant: float  # T_V [s]
    order: Literal[1, 2]


@dataclass(frozen=True, slots=True)
class Delay:
    """How far one channel lags behind another."""

    value: float  # [s]
    std: float  # [s]


LinkSource = Literal["accelerometer", "encoder", "deflection", "gyro", "motor"]
"""Where a link's acceleration comes from; "motor": the gear was taken as rigid."""


@dataclass(frozen=True, slots=True)
class LinkSignals:
    """Both sides of every gear in one experiment, every signal through the same filters.

    Angles, velocities and accelerations of links are relative, as in the equations of motion.
    """

    experiment: Experiment
    time: FloatArray  # (n_samples,) [s]
    sample_time: float  # [s]
    motor_torque: FloatArray  # (n_samples, n_joints) [N m] at the motor, behind the current loop
    motor_angle: FloatArray  # (n_samples, n_joints) [rad]
    motor_velocity: FloatArray  # (n_samples, n_joints) [rad/s]
    direction: (
        FloatArray  # (n_samples, n_joints) sgn of the motor's velocity, in (-1, 1): may stand
    )
    sliding: (
        FloatArray  # (n_samples, n_joints) +-1 where the motor surely slides, else 0; unfiltered
    )
    link_angle: FloatArray  # (n_samples, n_joints) [rad]
    link_velocity: FloatArray  # (n_samples, n_joints) [rad/s]
    link_acceleration: FloatArray  # (n_samples, n_joints) [rad/s^2]
    valid: BoolArray  # (n_samples, n_joints): False at edges and where the drive saturates
    sources: tuple[LinkSource, ...]  # one a joint
    held: tuple[bool, ...]  # one a joint: the torque stays constant until the next sample
    shared: tuple[Lag, ...]  # low-passes that every signal has behind it
    bandwidth_hz: float | None  # of a zero-phase filter over everything; None: there is none
    fusion: tuple[Fusion | None, ...]  # one a joint; None: the velocity is a sensor's own
    fusion_error: FloatArray  # (n_joints,) [rad/s] rms that (10) is wrong by, estimated
    bias: FloatArray  # (n_joints,) [rad/s^2] taken off the link acceleration
    sensor_delay: tuple[Delay | None, ...]  # link sensor behind encoder; None: not to be told
    drive_delay: tuple[Delay | None, ...]  # torque behind the log's; None: not to be told
    warnings: tuple[Caution, ...] = ()


@dataclass(frozen=True, slots=True)
class Check:
    """A question asked of the data, and the verdict."""

    name: str
    passed: bool
    value: float
    limit: float
    message: str


@dataclass(frozen=True, slots=True)
class Decoupled(Shown):
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
    warnings: tuple[Caution, ...] = ()


@dataclass(frozen=True, slots=True)
class Resonance:
    """The zero and the pole pair of motor input to motor velocity."""

    anti_resonance_hz: float  # modulus over 2 pi
    anti_resonance_damping: float  # ratio
    resonance_hz: float
    resonance_damping: float


@dataclass(frozen=True, slots=True)
class JointModel(Shown):
    """One joint's physical parameters, as one or several records of it tell them."""

    joint: int  # from 1
    experiments: tuple[str, ...]
    method: Literal["grey-box", "transfer-function"]
    parameters: tuple[Parameter, ...]
    values: Mapping[str, float]  # of all parameters, also of those that the data hardly tell
    covariance: FloatArray  # (n_values, n_values), in the order of `values`
    anti_resonance: Mode | None  # zeros of motor torque to motor velocity
    resonance: Mode | None  # its poles
    band_hz: tuple[float, float]
    fit_percent: Mapping[str, float]  # of each equation, or of each output
    status: Literal["determined", "partly-determined", "implausible"]
    warnings: tuple[Caution, ...] = ()


@dataclass(frozen=True, slots=True)
class RecordModel(Shown):
    """Everything one record tells of the joint that was excited in it."""

    signals: Decoupled
    physical: JointModel | None  # from the equations of motion; None: it failed
    state_space: StateSpace | None  # by prediction-error minimisation; None: it failed
    modes: Modes | None  # of the state-space model
    transfer: JointModel | None  # from the state-space model, by (17), (18)
    check: ModelCheck | None = None  # the state-space model on a part that it was not fitted to
    warnings: tuple[Caution, ...] = ()


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
class Sweep(Shown):
    """How one joint's equivalent stiffness goes with the amplitude."""

    joint: int  # from 1
    points: tuple[SweepPoint, ...]  # by amplitude
    slope: float  # of the squared anti-resonance over the amplitude [rad^2/s^2 per V]
    slope_std: float
    verdict: Literal["hardening", "softening", "no-trend"]


@dataclass(frozen=True, slots=True)
class ResidualTest:
    """What a fit left of one channel of one record, beside its sensor's own noise."""

    experiment: str
    channel: str
    deviation: float  # of what is left, in the channel's unit
    noise: float  # of the sensor's noise behind the same low-pass
    frequency_hz: FloatArray  # (n_frequencies,)
    density: FloatArray  # (n_frequencies,) of what is left, one-sided [unit^2/Hz]
    noise_density: FloatArray  # (n_frequencies,)
    worst_hz: float  # where the one exceeds the other most
    whiteness: float  # probability that noise of the sensor's colour looks no more like it
    input_joint: int  # whose input it follows most, from 1
    input_correlation: float  # with that input
    input_delay: float  # [s] behind it
    input_probability: float  # that an independent input correlates as much


@dataclass(frozen=True, slots=True)
class RicherModel:
    """What an effect that is not in the model would explain of a fit's residuals."""

    joint: int  # from 1
    effect: Effect
    sizes: Mapping[str, float]  # parameter -> value, by one linear step
    stds: Mapping[str, float]
    gain: float  # of the cost, given the effects before it in the list: 9 is three deviations
    share: float  # of the cost
    evident: bool


@dataclass(frozen=True, slots=True)
class Criticism:
    """What a fit does not explain, and what might."""

    residuals: tuple[ResidualTest, ...]
    richer: tuple[RicherModel, ...]  # the most telling first


@dataclass(frozen=True, slots=True)
class TorqueHistogram:
    """How often a gear carried which torque in the records, by the model, whatever its sign."""

    joint: int  # from 1
    edges: FloatArray  # (n_bins + 1,) [N m] at the link, from zero
    share: FloatArray  # (n_bins,) of all samples


@dataclass(frozen=True, slots=True)
class ArmModel(Shown):
    """All parameters of the arm, fitted at once to all records that excite its gears."""

    parameters: tuple[Parameter, ...]
    values: Mapping[tuple[str, int | None], float]  # all that simulating the arm needs
    covariance: FloatArray  # (n_parameters, n_parameters), of `parameters`
    fit_percent: Mapping[str, Mapping[str, float]]  # experiment -> channel -> fit
    initial_fit_percent: Mapping[str, Mapping[str, float]]  # before tuning
    simulated: tuple[Prediction, ...]  # the tuned model on the records it was fitted to
    initial: tuple[Prediction, ...]  # the same before tuning
    iterations: int
    status: Literal["converged", "iteration-limit", "at-bounds"]
    warnings: tuple[Caution, ...] = ()
    criticism: Criticism | None = None
    carried: tuple[TorqueHistogram, ...] = ()  # one a joint with an elastic gear


@dataclass(frozen=True, slots=True)
class Identification(Shown):
    """Everything one run learnt: what result.json and the report are made of."""

    study: Study
    created: str  # ISO 8601, UTC
    version: str
    stages: tuple[str, ...]  # those that ran
    rigid: RigidModel | None
    fitted: tuple[Prediction, ...]  # the model on the records it was fitted to
    checks: tuple[Prediction, ...]  # and on the records it never saw
    warnings: tuple[Caution, ...]
    timing_s: Mapping[str, float]
    records: tuple[RecordModel, ...] = ()  # of the joints excited, record by record
    joints: tuple[JointModel, ...] = ()  # all records of a joint at once
    responses: Mapping[int, FrequencyResponse] = field(default_factory=dict)  # by joint
    sweeps: tuple[Sweep, ...] = ()
    tuned: ArmModel | None = None
    reason: str | None = None  # why the question could not be answered, or not wholly

    @property
    def determined(self) -> bool:
        """Whether every parameter asked for was found."""
        return self.reason is None

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The best of each parameter, once.

        What the whole-arm fit tells, which rests on all records and on the rigid model; of the
        other stages' values the one most certain, of equals the later stage's. The arm's own first,
        then joint by joint. One stiffness does not stand beside the three slopes of a curve.
        """
        best: dict[tuple[str, int | None], Parameter] = {}
        for model in (self.rigid, *self.joints):
            for found in model.parameters if model else ():
                earlier = best.get((found.name, found.joint))
                if earlier is None or _deviation(found) <= _deviation(earlier):
                    best[found.name, found.joint] = found
        for found in self.tuned.parameters if self.tuned else ():
            if found.value is not None or (found.name, found.joint) not in best:
                best[found.name, found.joint] = found
        slopes = [best[key] for key in best if key[0] == "gear_stiffness_k1"]
        curved = [slope.joint for slope in slopes if slope.value is not None]
        for joint in curved:
            best.pop(("gear_stiffness", joint), None)
        return tuple(sorted(best.values(), key=lambda p: p.joint or 0))


def _deviation(parameter: Parameter) -> float:
    if parameter.value is None or parameter.std is None:
        return float("inf")
    return parameter.std
