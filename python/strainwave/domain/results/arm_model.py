"""Result of the whole-arm fit, with the analysis of its residuals."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from strainwave.display import Displayed
from strainwave.domain.arm.description import EffectName
from strainwave.domain.keys import ComplexArray, FloatArray, JointNumber, Key, Keyed
from strainwave.domain.messages import Clause
from strainwave.domain.results.distributions import chi_square_tail
from strainwave.domain.results.estimates import Diagnostic, Parameter, Prediction, SearchEnd


@dataclass(frozen=True, slots=True)
class ResidualCorrelation:
    """Normalised autocorrelation of a residual, and its cross-correlation with the inputs."""

    lag_time: float  # [s] between lags
    n_samples: int
    autocorrelation: FloatArray  # (n_lags + 1,) from lag 0
    cross_correlation: FloatArray  # (2 n_lags + 1, n_inputs), at input lags -n_lags..n_lags
    cross_std: FloatArray  # (n_inputs,) of each value under independence


MAX_RESIDUAL_NOISE = 10.0
"""Ratio of standard deviations of residual and sensor noise that counts as far above noise."""


@dataclass(frozen=True, slots=True)
class ResidualTest:
    """Residual of one channel in one record, compared with the sensor noise."""

    experiment: str
    channel: str
    deviation: float  # standard deviation of the residual, in the channel's unit
    noise: float  # standard deviation of the sensor noise after the same low-pass
    frequency_hz: FloatArray  # (n_frequencies,)
    density: FloatArray  # (n_frequencies,) one-sided, of the residual [unit^2/Hz]
    noise_density: FloatArray  # (n_frequencies,)
    worst_hz: float  # frequency of the largest ratio density / noise_density
    whiteness: float  # p-value: the residual has the spectrum of the sensor noise
    input_joint: JointNumber  # joint whose input correlates most
    input_correlation: float  # with that input
    input_delay: float  # [s] of the residual relative to that input
    input_probability: float  # p-value: residual and input are independent
    correlation: ResidualCorrelation | None = None
    sample_noise: float = 0.0  # standard deviation of the noise of a sample, without the low-pass

    @property
    def is_far_above_noise(self) -> bool:
        """Whether the residual exceeds the sensor noise by a factor of `MAX_RESIDUAL_NOISE`."""
        return self.deviation > MAX_RESIDUAL_NOISE * self.noise > 0.0


@dataclass(frozen=True, slots=True)
class ParameterShift(Keyed):
    """Shift of a parameter if one more effect is added to the model."""

    name: str
    joint: JointNumber | None  # None for the whole arm
    without: float  # value without the effect
    shift: float  # value with the effect minus value without it
    deviations: float  # shift in standard deviations of the fit without the effect


@dataclass(frozen=True, slots=True)
class Cause:
    """Effect that the model includes, or that a plausible model has in addition."""

    joint: JointNumber
    effect: EffectName
    parameters: tuple[Parameter, ...]  # of the effect, with confidence intervals
    gain: float  # decrease of the objective
    share: float  # of the objective that the effect explains
    shifts: tuple[ParameterShift, ...]  # of all other parameters, most significant first
    weight: float = 0.0  # by held-out scores, against the model without the effect
    is_included: bool = False
    is_linearised: bool = False  # one step from the fit without the effect


@dataclass(frozen=True, slots=True)
class Criticism:
    """Residual analysis of a fit: residual tests and likely effects."""

    residuals: tuple[ResidualTest, ...]
    causes: tuple[Cause, ...] = ()  # included, then plausible, most likely first


@dataclass(frozen=True, slots=True)
class LawMargin:
    """Held-out score of the selected gear law minus that of another one."""

    law: str
    difference: float  # of log predictive densities
    weight: float  # of the selected law against the other one, from 0 to 1


@dataclass(frozen=True, slots=True)
class LawChoice:
    """Gear law that the data support, of a joint with `spring = "auto"`.

    Without margins, the score test of a curve decided: no curve was fitted.
    """

    joint: JointNumber
    law: str
    margins: tuple[LawMargin, ...] = ()  # over the other laws
    gain: float = 0.0  # decrease of the objective by the linear step of a curve
    limit: float = math.inf  # chi-square limit of that gain
    largest_torque: float = 0.0  # [N m] of the gear in the records; the law holds up to it


@dataclass(frozen=True, slots=True)
class TorqueHistogram:
    """Histogram of the absolute gear torque in the records, by the model."""

    joint: JointNumber
    edges: FloatArray  # (n_bins + 1,) [N m], link side, from zero
    share: FloatArray  # (n_bins,) of all samples


@dataclass(frozen=True, slots=True)
class StageDifference(Keyed):
    """Difference of one parameter between the rigid step and the whole-arm fit.

    The rigid model is a prior of the whole-arm fit, which correlates the two values. The standard
    deviation of the difference includes this correlation.
    """

    name: str
    joint: JointNumber | None  # None for the whole arm
    rigid: float
    whole_arm: float
    std: float  # of the difference
    unit: str

    @property
    def deviations(self) -> float:
        """Difference in standard deviations."""
        return (self.whole_arm - self.rigid) / self.std


MIN_RELATIVE_DIFFERENCE = 0.01
"""Relative difference of two stages below which the difference is of no practical importance."""

MIN_AGREEMENT_PROBABILITY = 1e-3
"""Chi-square probability below which the stages disagree."""


@dataclass(frozen=True, slots=True)
class AgreementTest:
    """Chi-square test of the differences between rigid step and whole-arm fit in several values."""

    scope: Literal["all", "inertias", "friction"]  # "inertias" includes gravity torques
    joint: JointNumber | None  # for "friction"; else None
    chi_square: float
    degrees: int
    deviations: float  # two-sided normal quantile of the same p-value
    largest: float = math.inf  # largest relative difference

    @property
    def disagrees(self) -> bool:
        """Whether the difference is significant and of practical importance."""
        probability = chi_square_tail(self.chi_square, self.degrees)
        return probability < MIN_AGREEMENT_PROBABILITY and self.largest >= MIN_RELATIVE_DIFFERENCE

    @property
    def subject(self) -> Clause:
        """Compared values."""
        return Clause(f"subject/{self.scope}", joint=self.joint)


Condition = Literal["alone", "others-free", "others-servoed"]
"""State of the other joints while one is driven: no other joint, free, or servo-controlled."""

CONDITION_TEXTS: Mapping[Condition, str] = {
    "alone": "on its own",
    "others-free": "the other joints free",
    "others-servoed": "the other joints servoed",
}
"""Description of each condition."""


@dataclass(frozen=True, slots=True)
class MotorResponse:
    """Frequency response from motor torque to motor velocity in one record, measured and fitted."""

    experiment: str
    joint: JointNumber  # driven joint
    condition: Condition
    frequencies_hz: FloatArray  # (n_frequencies,)
    measured: ComplexArray  # (n_frequencies,) [rad/s per N m]
    fitted: ComplexArray  # (n_frequencies,) same estimator, simulated arm
    coherence: FloatArray  # (n_frequencies,) of the measured response
    anti_resonances_hz: tuple[float, ...]  # of the fitted arm, ascending
    resonances_hz: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class SensorGain(Keyed):
    """Predicted standard deviation of one parameter with an additional link sensor."""

    sensor: str  # type of link sensor
    link: JointNumber  # whose link carries the sensor
    assumed: str  # assumed noise and position
    name: str
    joint: JointNumber | None  # None for the whole arm
    value: float
    std: float  # without the sensor
    predicted_std: float  # with the sensor, same records

    @property
    def percent(self) -> float:
        """Relative half-width of the 95 % confidence interval without the sensor."""
        return 196.0 * self.std / abs(self.value) if self.value else math.inf

    @property
    def predicted_percent(self) -> float:
        """Relative half-width of the 95 % confidence interval with the sensor."""
        return 196.0 * self.predicted_std / abs(self.value) if self.value else math.inf


@dataclass(frozen=True, slots=True)
class ArmModel(Displayed):
    """Whole-arm fit: all parameters, fitted to all records that excite the gears."""

    parameters: tuple[Parameter, ...]
    values: Mapping[Key, float]  # all values that the simulation requires
    covariance: FloatArray  # (n_parameters, n_parameters), of `parameters`
    fit_percent: Mapping[str, Mapping[str, float]]  # experiment -> channel -> fit
    initial_fit_percent: Mapping[str, Mapping[str, float]]  # at the starting values
    simulated: tuple[Prediction, ...]  # the fitted model on its records
    initial: tuple[Prediction, ...]  # at the starting values
    iterations: int
    end: SearchEnd  # of the last search
    warnings: tuple[Diagnostic, ...] = ()
    criticism: Criticism | None = None
    gear_loads: tuple[TorqueHistogram, ...] = ()  # one per joint with an elastic gear
    at_bounds: tuple[Key, ...] = ()  # at a bound, or derived from such a parameter
    agreement: tuple[AgreementTest, ...] = ()  # with the rigid model, all values and groups
    sensor_gains: tuple[SensorGain, ...] = ()  # of link sensors that the rig does not have
    gear_laws: tuple[LawChoice, ...] = ()  # of joints whose law the fit selected

    @property
    def contradictions(self) -> tuple[AgreementTest, ...]:
        """Disagreements of the stages in inertias that no error of the model explains.

        A model that lacks an effect leaves residuals far above the noise. Its stages differ, and
        the intervals contain the difference. Frictions differ if the law or the state of friction
        does.
        """
        residuals = self.criticism.residuals if self.criticism else ()
        if any(test.is_far_above_noise for test in residuals):
            return ()
        failed = [test for test in self.agreement if test.disagrees]
        return tuple(test for test in failed if test.scope == "inertias")

    @property
    def status(self) -> SearchEnd:
        """`end`, but converged if the search stalled at a minimum of a rough objective."""
        return SearchEnd.CONVERGED if self.end is SearchEnd.STALLED else self.end
