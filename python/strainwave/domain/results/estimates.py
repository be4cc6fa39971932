"""Records that stages return: parameters, predictions, warnings, faults, ends of searches.

`is_physical` checks the signs of estimates: inertias are not negative. `size_warnings` checks their
sizes: gears and motors of robots cover a known range, and a value outside it indicates a wrong unit
in the study.
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path

from strainwave.display import Displayed
from strainwave.domain.arm.description import ArmDescription, Joint
from strainwave.domain.arm.gear_laws import is_slope
from strainwave.domain.arm.parameter_table import Range, base_name, parameter_table
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
    per: str | None = None  # "kp": the value is over the gain of the joint's servo

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


def physical_range(name: str) -> Range:
    """Sign that a parameter can have, by its name in docs/notation.md."""
    known = parameter_table().get(base_name(name))
    return "any" if known is None else known.range


def is_physical(name: str, value: float) -> bool:
    """Whether an arm can have this value [SI]; False if it is not finite."""
    if not abs(value) < math.inf:
        return False
    sign = physical_range(name)
    return sign == "any" or value > 0.0 or (value == 0.0 and sign == "non-negative")


_MAX_GEARED_RATIO = 0.1  # at which the ranges of geared motors apply: 10 to 1
_TABLES = tomllib.loads(Path(__file__).with_name("ranges.toml").read_text(encoding="utf-8"))
_QUANTITIES: dict[str, str] = _TABLES["quantities"]
_TORQUE_UNITS: Mapping[str, float] = _TABLES["units"]
_PER_ANGLE = ("link inertia", "motor inertia", "stiffness", "viscous friction")
# units of angle [rad] that are mistaken for rad
_ANGLE_UNITS: Mapping[str, float] = {"turns": 2.0 * math.pi, "degrees": math.pi / 180.0}


@dataclass(frozen=True, slots=True)
class _SizedValue:
    """A value and the range of robot joints, both on the side of the gear where it is given."""

    label: str  # "gear_stiffness 1", "torque_per_volt 1"
    value: float
    unit: str
    minimum: float
    maximum: float
    per_angle: bool  # whether it is a torque per angle, which depends on the unit of angle

    def is_plausible(self, factor: float = 1.0) -> bool:
        """Whether the value, times a factor, is in the range."""
        return self.minimum <= self.value * factor <= self.maximum


def size_warnings(arm: ArmDescription, parameters: Iterable[Parameter]) -> Iterator[Diagnostic]:
    """Yield a warning for each joint with values outside the ranges of robot joints.

    It names the unit that explains them. Prismatic joints are omitted: micrometer stages and
    gantries have no common range. So are values whose interval contains zero: their size is not
    determined.
    """
    known = [
        p
        for p in parameters
        if p.value is not None and not (p.ci95 and p.ci95[0] <= 0.0 <= p.ci95[1])
    ]
    for number, joint in enumerate(arm.joints, start=1):
        if joint.motion == "prismatic":
            continue
        sizes = list(_pair_with_ranges(number, joint, [p for p in known if p.joint == number]))
        outside = tuple(
            Clause(
                "sized-value",
                label=size.label,
                value=size.value,
                unit=size.unit,
                minimum=size.minimum,
                maximum=size.maximum,
            )
            for size in sizes
            if not size.is_plausible()
        )
        if outside:
            remedy = _likely_unit(number, joint.known_torque_per_volt, sizes)
            yield Diagnostic("implausible-size", Place(joint=number), values=outside, remedy=remedy)


def _pair_with_ranges(
    number: int, joint: Joint, parameters: Sequence[Parameter]
) -> Iterator[_SizedValue]:
    """Yield each value with the intersection of its ranges."""
    rows = []
    for p in parameters:
        quantity = _QUANTITIES.get(p.name, "stiffness" if is_slope(p.name) else None)
        rows.append((p.label, p.value or 0.0, p.unit, quantity))
    constant = joint.known_torque_per_volt
    if constant is not None:
        rows.insert(0, (f"torque_per_volt {number}", constant, "N m/V", "torque per volt"))
    ratio = abs(joint.gear_ratio)
    for label, value, unit, quantity in rows:
        ranges = [
            r
            for r in _TABLES["range"]
            if r["quantity"] == quantity and (ratio <= _MAX_GEARED_RATIO or not r.get("geared"))
        ]
        if ranges:
            minimum = max(r["minimum"] * ratio ** r.get("power", 0) for r in ranges)
            maximum = min(r["maximum"] * ratio ** r.get("power", 0) for r in ranges)
            yield _SizedValue(label, value, unit, minimum, maximum, quantity in _PER_ANGLE)


def _likely_unit(number: int, constant: float | None, sizes: Sequence[_SizedValue]) -> Clause:
    """The first unit that brings every value of the joint into its range.

    `constant` is the torque per volt of the study.
    """
    for unit, factor in _TORQUE_UNITS.items():
        if all(size.is_plausible(factor) for size in sizes):
            if constant is None:
                return Clause("unit/torque", joint=number, unit=unit)
            corrected = constant * factor
            return Clause("unit/constant", joint=number, unit=unit, torque_per_volt=corrected)
    for unit, angle in _ANGLE_UNITS.items():
        if all(size.is_plausible(1.0 / angle if size.per_angle else 1.0) for size in sizes):
            return Clause("unit/angle", joint=number, unit=unit)
    return Clause("unit/unknown", joint=number)
