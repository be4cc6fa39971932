"""Physically possible values of parameters, and usual sizes of robot joints.

`is_physical` checks signs: inertias are not negative. `size_warnings` checks sizes: gears and
motors of robots cover a known range, and a value outside it indicates a wrong unit in the study.
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from strainwave.domain.arm.description import ArmDescription, Joint
from strainwave.domain.arm.gear_laws import is_slope
from strainwave.domain.arm.parameter_table import Range, base_name, parameter_table
from strainwave.domain.messages import Clause, Place
from strainwave.domain.results.estimates import Diagnostic, Parameter


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
_TABLES = tomllib.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8"))
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
