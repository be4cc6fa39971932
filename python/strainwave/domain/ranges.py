"""Physically possible values of parameters, and usual sizes of robot joints.

`is_physical` checks signs: inertias are not negative. `implausible_joints` checks sizes: gears and
motors of robots cover a known range, and a value outside it indicates a wrong unit in the study.
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from strainwave.domain.arm import ArmDescription, Joint
from strainwave.domain.estimates import Diagnostic, Parameter
from strainwave.domain.gear_laws import is_slope
from strainwave.domain.messages import Clause, Place
from strainwave.domain.parameter_table import Range, base_name, parameter_table


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


@dataclass(frozen=True, slots=True)
class PlausibleRange:
    """Sizes of one quantity over all revolute robot joints [SI]."""

    quantity: str
    minimum: float
    maximum: float
    power: int = 0  # of the gear ratio that the value is divided by, for its size at the link
    geared: bool = False  # whether it applies only to motors with a gear


MAX_GEARED_RATIO = 0.1
"""Largest gear ratio at which the ranges of geared motors apply: 10 to 1."""

_TABLES = tomllib.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8"))
PLAUSIBLE_RANGES = tuple(PlausibleRange(**table) for table in _TABLES["range"])
_QUANTITIES: dict[str, str] = _TABLES["quantities"]
_TORQUE_UNITS: Mapping[str, float] = _TABLES["units"]

_PER_ANGLE = ("link inertia", "motor inertia", "stiffness", "viscous friction")
_ANGLE_UNITS: Mapping[str, float] = {"turns": 2.0 * math.pi, "degrees": math.pi / 180.0}
"""Units of angle [rad] that are mistaken for rad."""


@dataclass(frozen=True, slots=True)
class SizedValue:
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

    @property
    def clause(self) -> Clause:
        """Value and range."""
        return Clause(
            "sized-value",
            label=self.label,
            value=self.value,
            unit=self.unit,
            minimum=self.minimum,
            maximum=self.maximum,
        )


@dataclass(frozen=True, slots=True)
class ImplausibleJoint:
    """Values of one joint outside the ranges of robot joints."""

    joint: int  # from 1
    values: tuple[SizedValue, ...]
    unit: str | None  # likely unit of the torque, or of the motor angle
    of_angle: bool = False  # whether `unit` is that of the angle
    torque_per_volt: float | None = None  # in N m/V, if it was given in that unit

    @property
    def warning(self) -> Diagnostic:
        """Observation and likely unit."""
        cause = "unit/constant"
        if self.unit is None:
            cause = "unit/unknown"
        elif self.of_angle or self.torque_per_volt is None:
            cause = "unit/angle" if self.of_angle else "unit/torque"
        constant = self.torque_per_volt
        remedy = Clause(cause, joint=self.joint, unit=self.unit, torque_per_volt=constant)
        values = tuple(value.clause for value in self.values)
        return Diagnostic("implausible-size", Place(joint=self.joint), values=values, remedy=remedy)


def implausible_joints(
    arm: ArmDescription, parameters: Iterable[Parameter]
) -> Iterator[ImplausibleJoint]:
    """Yield joints with values outside `PLAUSIBLE_RANGES`, each with the unit that explains them.

    Prismatic joints are omitted: micrometer stages and gantries have no common range. So are values
    whose interval contains zero: their size is not determined.
    """
    known = [
        p
        for p in parameters
        if p.value is not None and not (p.ci95 and p.ci95[0] <= 0.0 <= p.ci95[1])
    ]
    for number, joint in enumerate(arm.joints, start=1):
        if joint.motion == "prismatic":
            continue
        values = list(_pair_with_ranges(number, joint, [p for p in known if p.joint == number]))
        outside = tuple(value for value in values if not value.is_plausible())
        if outside:
            yield _explain_values(number, joint, values, outside)


def _pair_with_ranges(
    number: int, joint: Joint, parameters: Sequence[Parameter]
) -> Iterator[SizedValue]:
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
            for r in PLAUSIBLE_RANGES
            if r.quantity == quantity and (ratio <= MAX_GEARED_RATIO or not r.geared)
        ]
        if ranges:
            minimum = max(r.minimum * ratio**r.power for r in ranges)
            maximum = min(r.maximum * ratio**r.power for r in ranges)
            yield SizedValue(label, value, unit, minimum, maximum, quantity in _PER_ANGLE)


def _explain_values(
    number: int, joint: Joint, values: Sequence[SizedValue], outside: tuple[SizedValue, ...]
) -> ImplausibleJoint:
    """Find the first unit that brings every value of the joint into its range."""
    constant = joint.known_torque_per_volt
    for unit, factor in _TORQUE_UNITS.items():
        if all(value.is_plausible(factor) for value in values):
            corrected = None if constant is None else constant * factor
            return ImplausibleJoint(number, outside, unit, torque_per_volt=corrected)
    for unit, size in _ANGLE_UNITS.items():
        if all(value.is_plausible(1.0 / size if value.per_angle else 1.0) for value in values):
            return ImplausibleJoint(number, outside, unit, of_angle=True)
    return ImplausibleJoint(number, outside, None)
