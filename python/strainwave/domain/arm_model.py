"""The whole arm with elastic gears, and what criticism finds in its fit."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

from strainwave.display import Displayed
from strainwave.domain.arm import EffectName
from strainwave.domain.arrays import ComplexArray, FloatArray
from strainwave.domain.estimates import Diagnostic, Parameter, Prediction


@dataclass(frozen=True, slots=True)
class ResidualCorrelation:
    """Normalised correlations of a residual with itself and with the inputs."""

    lag_time: float  # [s] between lags
    n_samples: int
    autocorrelation: FloatArray  # (n_lags + 1,) from lag 0
    cross_correlation: FloatArray  # (2 n_lags + 1, n_inputs), input lags -n_lags..n_lags behind
    cross_std: FloatArray  # (n_inputs,) of each value if residual and input are independent


MAX_RESIDUAL_NOISE = 10.0
"""Standard deviations of the sensor's noise from which residuals are far above it."""


@dataclass(frozen=True, slots=True)
class ResidualTest:
    """What a fit left of one channel of one record, beside its sensor's own noise."""

    experiment: str
    channel: str
    deviation: float  # of the residuals, in the channel's unit
    noise: float  # of the sensor's noise behind the same low-pass
    frequency_hz: FloatArray  # (n_frequencies,)
    density: FloatArray  # (n_frequencies,) of the residuals, one-sided [unit^2/Hz]
    noise_density: FloatArray  # (n_frequencies,)
    worst_hz: float  # where the one exceeds the other most
    whiteness: float  # probability that noise of the sensor's colour looks no more like it
    input_joint: int  # whose input it follows most, from 1
    input_correlation: float  # with that input
    input_delay: float  # [s] behind it
    input_probability: float  # that an independent input correlates as much
    correlation: ResidualCorrelation | None = None

    @property
    def is_far_above_noise(self) -> bool:
        """Whether more than the sensor's noise is at work, and not by a little."""
        return self.deviation > MAX_RESIDUAL_NOISE * self.noise > 0.0


@dataclass(frozen=True, slots=True)
class ParameterShift:
    """What one more effect in the model would do to a parameter."""

    name: str
    joint: int | None  # from 1; None for the arm's own
    without: float  # value of the fit without the effect
    shift: float  # that the effect adds to it
    deviations: float  # the shift, in standard deviations of the fit without it


@dataclass(frozen=True, slots=True)
class ScoreTest:
    """What an effect that is not in the model would explain of a fit's residuals."""

    joint: int  # from 1
    effect: EffectName
    sizes: Mapping[str, float]  # parameter -> value, by one linear step
    stds: Mapping[str, float]
    gain: float  # of the cost, given the effects before it in the list: 9 is three deviations
    share: float  # of the cost
    evident: bool
    shifts: tuple[ParameterShift, ...] = ()  # by that step, the most significant first
    limit: float = math.inf  # of the gain: chi-square limit of significance


@dataclass(frozen=True, slots=True)
class Cause:
    """An effect that may be what the model lacks, judged by a fit with it."""

    joint: int  # from 1
    effect: EffectName
    parameters: tuple[Parameter, ...]  # the effect's, with intervals
    gain: float  # of the cost, less what so many parameters gain by chance
    share: float  # of the cost that it explains
    shifts: tuple[ParameterShift, ...]  # of the arm's other parameters, the most significant first


@dataclass(frozen=True, slots=True)
class Criticism:
    """What a fit does not explain, and what might."""

    residuals: tuple[ResidualTest, ...]
    score_tests: tuple[ScoreTest, ...]  # the most significant first
    causes: tuple[Cause, ...] = ()  # that were fitted, the most likely first


@dataclass(frozen=True, slots=True)
class TorqueHistogram:
    """How often a gear carried which torque in the records, by the model, whatever its sign."""

    joint: int  # from 1
    edges: FloatArray  # (n_bins + 1,) [N m] at the link, from zero
    share: FloatArray  # (n_bins,) of all samples


@dataclass(frozen=True, slots=True)
class StageDifference:
    """One value as the rigid and as the whole-arm fit give it.

    The whole-arm fit takes the rigid model as a prior, so that its value has moved towards the
    rigid one already; the standard deviation of the difference counts that.
    """

    name: str
    joint: int | None  # from 1; None for the arm's own
    rigid: float
    whole_arm: float
    std: float  # of the difference
    unit: str

    @property
    def deviations(self) -> float:
        """The difference in standard deviations."""
        return (self.whole_arm - self.rigid) / self.std


MIN_RELATIVE_DIFFERENCE = 0.01
"""Relative difference of two stages below which no use of a model shows it."""

MAX_DISAGREEMENT = 4.0
"""Standard deviations up to which the stages agree: noise alone exceeds it once in 4,000 runs, as
there are four tests of two joints."""


@dataclass(frozen=True, slots=True)
class AgreementTest:
    """Whether the rigid and the whole-arm fit agree on several values at once, by chi-square."""

    scope: Literal["all", "inertias", "friction"]  # "inertias": gravity torques as well
    joint: int | None  # from 1, whose friction; None: of the other scopes
    chi_square: float
    degrees: int
    deviations: float  # of a normal variable that is as unlikely on both sides
    largest: float = math.inf  # relative difference of the value that differs most

    @property
    def matters(self) -> bool:
        """Whether a value differs by so much that somebody would mind, however sure both are."""
        return self.largest >= MIN_RELATIVE_DIFFERENCE

    @property
    def subject(self) -> str:
        """The values that it compares, in words."""
        if self.scope == "friction":
            return f"joint {self.joint}'s friction"
        return "inertias and gravity torques" if self.scope == "inertias" else "the values"


def contradictions(tests: Sequence[AgreementTest]) -> tuple[AgreementTest, ...]:
    """Tests of inertias and of each joint's friction in which the stages contradict each other.

    If all values together disagree but no group does by itself, the group that disagrees most.
    """
    groups = [test for test in tests if test.scope != "all"]
    far = [test for test in tests if test.deviations > MAX_DISAGREEMENT and test.matters]
    own = [test for test in far if test.scope != "all"]
    if far and not own:
        own = sorted(groups, key=lambda test: test.deviations)[-1:]
    return tuple(own)


@dataclass(frozen=True, slots=True)
class SuspectConstant:
    """A constant of the study, or a change between records, that would explain a disagreement."""

    name: str  # key of the study, "payload" or "friction"
    joint: int | None  # from 1; None for the arm's own
    share: float  # of the cost of the fit that it explains, by one linear step
    value: float | None = None  # that explains most, of a key of the study
    unit: str = ""
    experiment: str = ""  # that separates it from the others, a clause

    @property
    def text(self) -> str:
        """What it is, how much it explains, and the experiment."""
        subject = self.name if self.joint is None else f"{self.name} of joint {self.joint}"
        if self.value is not None:
            subject = f"{subject} (then {self.value:.4g} {self.unit})"
        return f"{subject}, which would explain {100.0 * self.share:.3g} %: {self.experiment}"


Condition = Literal["alone", "others-free", "others-servoed"]
"""What the other joints do while one is driven: there are none, they are free, or servoed."""

CONDITIONS: Mapping[Condition, str] = {
    "alone": "on its own",
    "others-free": "the other joint free",
    "others-servoed": "the other joint servoed",
}
"""The same in words."""


@dataclass(frozen=True, slots=True)
class MotorResponse:
    """Motor torque to motor velocity in one record, of the rig and of the fitted arm."""

    experiment: str
    joint: int  # that is driven, from 1
    condition: Condition
    frequencies_hz: FloatArray  # (n_frequencies,)
    measured: ComplexArray  # (n_frequencies,) [rad/s per N m]
    fitted: ComplexArray  # (n_frequencies,) by the same estimate, of the simulated arm
    coherence: FloatArray  # (n_frequencies,) of the measured one
    anti_resonances_hz: tuple[float, ...]  # of the fitted arm, ascending
    resonances_hz: tuple[float, ...]


LinkSensor = Literal["accelerometer", "link-encoder", "gyro"]


@dataclass(frozen=True, slots=True)
class SensorGain:
    """What a link sensor that no record has would make of one parameter's interval."""

    sensor: LinkSensor
    link: int  # from 1, that it would sit on
    assumed: str  # its data sheet and place
    name: str
    joint: int | None  # from 1; None for the arm's own
    value: float
    std: float  # as it is
    predicted_std: float  # with the sensor in the same records

    @property
    def label(self) -> str:
        """Name with joint, as in the verdict."""
        return self.name if self.joint is None else f"{self.name} {self.joint}"

    @property
    def percent(self) -> float:
        """Half-width of the 95 % interval as it is, of the value."""
        return 196.0 * self.std / abs(self.value)

    @property
    def predicted_percent(self) -> float:
        """The same with the sensor."""
        return 196.0 * self.predicted_std / abs(self.value)


@dataclass(frozen=True, slots=True)
class ArmModel(Displayed):
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
    warnings: tuple[Diagnostic, ...] = ()
    criticism: Criticism | None = None
    gear_loads: tuple[TorqueHistogram, ...] = ()  # one per joint with an elastic gear
    at_bounds: tuple[tuple[str, int | None], ...] = ()  # ended at a range's end, or rest on such
    differences: tuple[StageDifference, ...] = ()  # from the rigid model, value by value
    agreement: tuple[AgreementTest, ...] = ()  # with it, of all these differences and of groups
    suspects: tuple[SuspectConstant, ...] = ()  # if the stages disagree, the likeliest first
    sensor_gains: tuple[SensorGain, ...] = ()  # of link sensors that are not there
