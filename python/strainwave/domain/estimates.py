"""What any stage may answer: parameters, predictions, and what is said beside the numbers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from strainwave.display import Displayed
from strainwave.domain.arrays import FloatArray
from strainwave.domain.corrections import Correction
from strainwave.domain.study import LINK_KINDS, channel_parts


@dataclass(frozen=True, slots=True)
class Diagnostic:
    """Something the reader must know to trust, or not trust, an answer."""

    code: str  # kebab-case, stable: the troubleshooting page is indexed by it
    where: str  # file, experiment, joint or parameter
    message: str  # what, and what to do about it
    experiments: tuple[str, ...] = ()  # the records, where one cause shows in several


@dataclass(frozen=True, slots=True, kw_only=True)
class Suspicion:
    """One cause that would explain why the channels contradict one another or the study."""

    code: str  # one of the input faults of docs/troubleshooting.md: "wrong-unit", "wrong-sign", ...
    where: str  # channel, experiment or key of the study that is at fault: "a1", "joint 2"
    message: str  # in one sentence, with the number found
    remedy: str  # the line of study.toml, or the step at the rig, that would mend it
    factor: float | None = None  # by which the data differ from what the study implies
    delay_s: float | None = None  # by which the channel lags [s]
    corrections: tuple[Correction, ...] = ()  # the remedy as data; (): none is known


@dataclass(frozen=True, slots=True)
class Consistency:
    """Whether a study's channels agree with one another and with the study, before any estimate."""

    suspected: tuple[Suspicion, ...] = ()

    @property
    def motors_agree(self) -> bool:
        """Whether only link sensors, their places or the link length are suspected."""
        places = [each.strip() for found in self.suspected for each in found.where.split(",")]
        return all(
            channel_parts(place)[0] in LINK_KINDS
            or place.endswith(("accelerometer_distance", "link_length"))
            for place in places
        )


@dataclass(frozen=True, slots=True)
class Parameter:
    """One physical parameter with its uncertainty; `None` is what was not identified."""

    name: str  # as in docs/notation.md
    joint: int | None  # from 1; None for the arm's own
    value: float | None
    std: float | None
    unit: str
    stage: str
    ci95: tuple[float, float] | None = None

    @property
    def label(self) -> str:
        """Name with joint, as in the verdict: "gear_stiffness 1"; "beta" of the arm."""
        return self.name if self.joint is None else f"{self.name} {self.joint}"


@dataclass(frozen=True, slots=True)
class Prediction(Displayed):
    """What a model says a record's channels should have been."""

    experiment: str
    time: FloatArray  # (n_samples,) [s]
    channels: tuple[str, ...]
    measured: FloatArray  # (n_samples, n_channels)
    predicted: FloatArray  # (n_samples, n_channels)
    fit_percent: Mapping[str, float]  # channel -> 100 (1 - |y - yhat| / |y - mean y|)
    unfiltered_fit_percent: Mapping[str, float] = field(default_factory=dict)  # with y as logged
    stiffness_effect: Mapping[int, float] = field(default_factory=dict)
    """Joint -> largest change that a fifth more gear stiffness makes, in spreads of a channel."""
    unexplained: Mapping[str, float] = field(default_factory=dict)
    """Of each channel that is not predicted: its error, in standard deviations of what noise,
    friction, the parameters' covariance and the fit's own residuals explain."""
    is_servo_at_fault: bool = False  # the recorded voltages explain what the study's servo does not
    warnings: tuple[Diagnostic, ...] = ()

    @property
    def of_drive(self) -> bool:
        """Whether drive signals are predicted from the motion, by the rigid model."""
        return self.channels[0].startswith(("u", "torque"))
