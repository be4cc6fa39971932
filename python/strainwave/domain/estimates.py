"""Records that every stage can return: parameters, predictions, warnings and faults."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from strainwave.display import Displayed
from strainwave.domain.arrays import FloatArray
from strainwave.domain.corrections import Correction
from strainwave.domain.study import LINK_KINDS, channel_parts

CI95_STDS = 1.96
"""Half-width of a 95 % interval in standard deviations of a normal variable."""


@dataclass(frozen=True, slots=True)
class Diagnostic:
    """Warning about a result."""

    code: str  # stable, kebab-case; index of the troubleshooting page
    where: str  # file, experiment, joint or parameter
    message: str  # observation, consequence and remedy
    experiments: tuple[str, ...] = ()  # records affected, if there are several


@dataclass(frozen=True, slots=True, kw_only=True)
class Suspicion:
    """Possible cause of a contradiction between channels, or between a channel and the study."""

    code: str  # one of the input faults of docs/troubleshooting.md: "wrong-unit", "wrong-sign", ...
    where: str  # faulty channel, experiment or key of the study: "a1", "joint 2"
    message: str  # one sentence, with the measured value
    remedy: str  # line of study.toml, or action at the rig, that corrects it
    factor: float | None = None  # ratio of the data to the value that the study implies
    delay_s: float | None = None  # delay of the channel [s]
    corrections: tuple[Correction, ...] = ()  # machine-readable remedy; empty if unknown


@dataclass(frozen=True, slots=True)
class Consistency:
    """Result of the input check: faults suspected before any fit."""

    suspected: tuple[Suspicion, ...] = ()

    @property
    def motors_agree(self) -> bool:
        """Whether all suspected faults concern link sensors, their positions or the link length."""
        places = [each.strip() for found in self.suspected for each in found.where.split(",")]
        return all(
            channel_parts(place)[0] in LINK_KINDS
            or place.endswith(("accelerometer_distance", "link_length"))
            for place in places
        )


@dataclass(frozen=True, slots=True)
class Parameter:
    """Estimate of one physical parameter; value and uncertainty are None if not identified."""

    name: str  # as in docs/notation.md
    joint: int | None  # from 1; None for the whole arm
    value: float | None
    std: float | None
    unit: str
    stage: str
    ci95: tuple[float, float] | None = None

    @property
    def label(self) -> str:
        """Name and joint, as in the verdict: "gear_stiffness 1", or "beta" for the whole arm."""
        return self.name if self.joint is None else f"{self.name} {self.joint}"


@dataclass(frozen=True, slots=True)
class Prediction(Displayed):
    """Measured and predicted channels of one record."""

    experiment: str
    time: FloatArray  # (n_samples,) [s]
    channels: tuple[str, ...]
    measured: FloatArray  # (n_samples, n_channels)
    predicted: FloatArray  # (n_samples, n_channels)
    fit_percent: Mapping[str, float]  # channel -> 100 (1 - |y - yhat| / |y - mean y|)
    unfiltered_fit_percent: Mapping[str, float] = field(
        default_factory=dict
    )  # fit to the unfiltered channels
    stiffness_effect: Mapping[int, float] = field(default_factory=dict)
    """Joint -> largest change of a channel if the gear stiffness rises by 20 %.

    Relative to the standard deviation of the channel."""
    unexplained: Mapping[str, float] = field(default_factory=dict)
    """Channel -> prediction error in standard deviations, for channels that are not predicted.

    The standard deviation covers noise, friction, parameter covariance and residuals of the fit."""
    is_servo_at_fault: bool = False  # recorded voltages explain the motion, the servo does not
    warnings: tuple[Diagnostic, ...] = ()

    @property
    def of_drive(self) -> bool:
        """Whether the rigid model predicts drive signals from the motion."""
        return self.channels[0].startswith(("u", "torque"))
