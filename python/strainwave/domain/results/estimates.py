"""Records that stages return: parameters, predictions, warnings, faults, ends of searches."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum

from strainwave.display import Displayed
from strainwave.domain.keys import FloatArray, JointNumber, Key, Keyed
from strainwave.domain.messages import (
    Clause,
    Place,
    Value,
    observation_of,
    places_text,
    text_of,
)
from strainwave.domain.results.distributions import CI95_STDS
from strainwave.domain.study import Stage, channel_parts


class SearchEnd(StrEnum):
    """Why a search ended; the values are the words of the result file."""

    CONVERGED = "converged"  # the predicted decrease is below the tolerance
    STALLED = "stalled"  # a decrease is predicted, but no step achieves it
    NO_DESCENT = "no-descent"  # the same, and the predicted decrease is large
    EVALUATION_LIMIT = "iteration-limit"
    BOUND = "at-bounds"  # at a minimum, with an unknown at a limit of its range

    @property
    def is_minimum(self) -> bool:
        """Whether the last point is a minimum within the accuracy of a rough objective."""
        return self in (SearchEnd.CONVERGED, SearchEnd.STALLED, SearchEnd.BOUND)


@dataclass(frozen=True, slots=True, init=False)
class Diagnostic:
    """Warning about a result."""

    code: str  # stable, kebab-case; index of the troubleshooting page
    places: tuple[Place, ...]
    clause: Clause  # observation, consequence and remedy, as data

    def __init__(
        self, code: str, place: Place | tuple[Place, ...], variant: str = "", /, **values: Value
    ) -> None:
        """Take the values of the template `code`, or of "code/variant", in `domain.messages`."""
        template = f"{code}/{variant}" if variant else code
        self._set(code, place, Clause(template, **values))

    @classmethod
    def of(cls, code: str, place: Place | tuple[Place, ...], clause: Clause) -> Diagnostic:
        """Warning with a given clause."""
        warning = cls.__new__(cls)
        warning._set(code, place, clause)
        return warning

    def _set(self, code: str, place: Place | tuple[Place, ...], clause: Clause) -> None:
        places = (place,) if isinstance(place, Place) else place
        for name, value in (("code", code), ("places", places), ("clause", clause)):
            object.__setattr__(self, name, value)

    @property
    def place(self) -> Place | None:
        """The place; None if there are several."""
        return self.places[0] if len(self.places) == 1 else None

    @property
    def experiments(self) -> tuple[str, ...]:
        """Records that the warning concerns."""
        return tuple(dict.fromkeys(name for place in self.places for name in place.experiments))

    def at(self, place: Place) -> Diagnostic:
        """The same warning about another place."""
        return Diagnostic.of(self.code, place, self.clause)

    @property
    def where(self) -> str:
        """Text of the places."""
        return places_text(self.places)

    @property
    def message(self) -> str:
        """Observation, consequence and remedy."""
        return text_of(self.clause, record=self.experiments)

    @property
    def observation(self) -> str:
        """The first part of the message."""
        return observation_of(self.clause, record=self.experiments)


@dataclass(frozen=True, slots=True)
class PublishedWarning:
    """Warning as text, as a result file has it."""

    code: str
    where: str
    message: str
    experiments: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Parameter(Keyed):
    """Estimate of one physical parameter; value and uncertainty are None if not identified."""

    name: str  # as in docs/notation.md
    joint: JointNumber | None  # None for the whole arm
    value: float | None
    std: float | None
    unit: str
    stage: Stage
    ci95: tuple[float, float] | None = None
    model_std: float | None = None  # part of `std` that comes from the choice of the model

    @classmethod
    def estimated(
        cls, key: Key, value: float, std: float, unit: str, stage: Stage, width: float = CI95_STDS
    ) -> Parameter:
        """Estimate with its 95 % interval, of the half-width `width` in standard deviations."""
        interval = (value - width * std, value + width * std)
        return cls(*key, value, std, unit, stage, interval)

    @classmethod
    def at_zero(cls, key: Key, upper: float, unit: str, stage: Stage) -> Parameter:
        """Estimate at the physical bound of zero, with the one-sided 95 % interval [0, upper]."""
        return cls(*key, 0.0, upper / CI95_STDS, unit, stage, (0.0, upper))


@dataclass(frozen=True, slots=True)
class Prediction(Displayed):
    """Measured and predicted channels of one record."""

    experiment: str
    time: FloatArray  # (n_samples,) [s]
    channels: tuple[str, ...]
    measured: FloatArray  # (n_samples, n_channels)
    predicted: FloatArray  # (n_samples, n_channels)
    fit_percent: Mapping[str, float]  # channel -> 100 (1 - |y - yhat| / |y - mean y|)
    stiffness_effect: Mapping[int, Mapping[str, float]] = field(default_factory=dict)
    """Joint -> channel with a fit -> change if the gear stiffness rises by 20 %.

    Relative to the standard deviation of the channel."""
    unexplained: Mapping[str, float] = field(default_factory=dict)
    """Channel -> prediction error in standard deviations, for channels that are not predicted.

    The standard deviation covers noise, friction, parameter covariance and residuals of the fit."""
    is_servo_at_fault: bool = False  # recorded voltages explain the motion, the servo does not

    @property
    def of_drive(self) -> bool:
        """Whether the rigid model predicts drive signals from the motion."""
        return channel_parts(self.channels[0])[0] in ("u", "torque")
