"""Values that an arm can have, and sizes that robot joints do have.

`is_physical` is about signs: no arm has a negative inertia. `implausible_joints` is about sizes:
gears and motors of robots cover a known range, and a value outside it points at a unit in the
study.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

from strainwave.domain.arm import ArmDescription, Joint
from strainwave.domain.estimates import Parameter
from strainwave.domain.gear_laws import is_slope
from strainwave.domain.parameter_table import Range, base_name, parameter_table


def physical_range(name: str) -> Range:
    """Sign that a parameter can have, by its name in docs/notation.md."""
    known = parameter_table().get(base_name(name))
    return "any" if known is None else known.range


def is_physical(name: str, value: float) -> bool:
    """Whether an arm can have this value [SI]; False if it is not finite."""
    if not abs(value) < math.inf:
        return False
    least = physical_range(name)
    return least == "any" or value > 0.0 or (value == 0.0 and least == "non-negative")


@dataclass(frozen=True, slots=True)
class PlausibleRange:
    """Sizes of one quantity over all revolute robot joints [SI]."""

    quantity: str
    least: float
    most: float
    power: int = 0  # of the gear ratio that the value is divided by, for its size at the link
    geared: bool = False  # whether it holds only for motors behind a gear


MAX_GEARED_RATIO = 0.1
"""Largest gear ratio of a motor that is small beside its joint: 10 to 1."""

PLAUSIBLE_RANGES = (
    # a finger of 1 g; axis 1 of a robot that carries 2 t at 3 m
    PlausibleRange("link inertia", 1e-7, 3e4),
    PlausibleRange("motor inertia", 1e-7, 1e4, power=2),
    # rotors of 5 mm to 300 mm in diameter
    PlausibleRange("motor inertia", 1e-10, 0.2, geared=True),
    # a torsion spring of the laboratory; cycloidal gears of 3 kN m per arc minute
    PlausibleRange("stiffness", 0.5, 1e7),
    # a tenth of a gear of size 8, the smallest of docs/theory.md, with ratio 50
    PlausibleRange("stiffness", 40.0, 1e7, geared=True),
    PlausibleRange("Coulomb friction", 0.0, 5e3, power=1),
    PlausibleRange("Coulomb friction", 0.0, 20.0, geared=True),
    PlausibleRange("viscous friction", 0.0, 1e5, power=2),
    # 1 mN m to 50 kN m at the joint for 10 V
    PlausibleRange("torque per volt", 1e-4, 5e3, power=1),
    # 0.1 mN m to 200 N m of a motor for 10 V
    PlausibleRange("torque per volt", 1e-5, 20.0, geared=True),
)
"""Of desktop arms to the largest industrial axes, with a factor of two and more to spare."""

_TORQUE_UNITS: Mapping[str, float] = {
    "mN m": 1e-3,
    "N cm": 1e-2,
    "oz in": 7.0616e-3,
    "kgf cm": 9.80665e-2,
    "lbf in": 0.112985,
    "kN m": 1e3,
}
"""Units of torque [N m] that are mistaken for N m, the most frequent first."""

_PER_ANGLE = ("link inertia", "motor inertia", "stiffness", "viscous friction")
_ANGLE_UNITS: Mapping[str, float] = {"turns": 2.0 * math.pi, "degrees": math.pi / 180.0}
"""Units of angle [rad] that are mistaken for rad."""


@dataclass(frozen=True, slots=True)
class SizedValue:
    """A value beside the range of robot joints, both at the place where the value is given."""

    label: str  # "gear_stiffness 1", "torque_per_volt 1"
    value: float
    unit: str
    least: float
    most: float
    per_angle: bool  # whether it is a torque per angle, and so falls as the angle's unit grows

    def is_plausible(self, factor: float = 1.0) -> bool:
        """Whether the value, times a factor, lies in the range."""
        return self.least <= self.value * factor <= self.most

    @property
    def text(self) -> str:
        """Value and range."""
        return (
            f"{self.label} = {self.value:.4g} {self.unit}"
            f" (robot joints: {self.least:.2g} to {self.most:.2g})"
        )


@dataclass(frozen=True, slots=True)
class ImplausibleJoint:
    """Values of one joint that no robot joint has."""

    joint: int  # from 1
    values: tuple[SizedValue, ...]
    unit: str | None  # the unit that the torque, or the motor angle, was likely given in
    of_angle: bool = False  # whether that is the angle's
    torque_per_volt: float | None = None  # in N m/V, if it was given in that unit

    @property
    def remedy(self) -> str:
        """What to change, a clause."""
        if self.unit is None:
            return (
                f"check the units of joint {self.joint}'s torque_per_volt, gear_ratio and columns"
            )
        if self.of_angle:
            return f"theta_m{self.joint} is likely in {self.unit}, and its column needs a scale"
        if self.torque_per_volt is None:
            return f"torque{self.joint} is likely in {self.unit}, and its column needs a scale"
        return (
            f"torque_per_volt is likely in {self.unit}/V and has to be written as"
            f" torque_per_volt = {self.torque_per_volt:.4g}"
        )

    @property
    def text(self) -> str:
        """What was observed, in one clause, with the likely unit."""
        listed = ", ".join(each.text for each in self.values)
        return f"{listed}: no robot joint is of this size, so {self.remedy}"


def implausible_joints(
    arm: ArmDescription, parameters: Iterable[Parameter]
) -> Iterator[ImplausibleJoint]:
    """Joints with values outside `PLAUSIBLE_RANGES`, each with the unit that explains them.

    Prismatic joints are left out: micrometer stages and gantries have nothing in common.
    """
    known = [p for p in parameters if p.value is not None]
    for number, joint in enumerate(arm.joints, start=1):
        if joint.motion == "prismatic":
            continue
        values = list(_sized(number, joint, [p for p in known if p.joint == number]))
        outside = tuple(each for each in values if not each.is_plausible())
        if outside:
            yield _explained(number, joint, values, outside)


def _sized(number: int, joint: Joint, parameters: Sequence[Parameter]) -> Iterator[SizedValue]:
    """Each value with its range, of several ranges what they have in common."""
    rows = [(p.label, p.value or 0.0, p.unit, _quantity(p.name)) for p in parameters]
    if joint.torque_per_volt is not None:
        constant = f"torque_per_volt {number}"
        rows.insert(0, (constant, joint.torque_per_volt, "N m/V", "torque per volt"))
    for label, value, unit, quantity in rows:
        ranges = [
            (r.least * joint.gear_ratio**r.power, r.most * joint.gear_ratio**r.power)
            for r in PLAUSIBLE_RANGES
            if r.quantity == quantity and (joint.gear_ratio <= MAX_GEARED_RATIO or not r.geared)
        ]
        if ranges:
            least, most = max(low for low, _ in ranges), min(high for _, high in ranges)
            yield SizedValue(label, value, unit, least, most, quantity in _PER_ANGLE)


def _quantity(name: str) -> str | None:
    """The row of `PLAUSIBLE_RANGES` that a parameter falls under."""
    if name in ("link_inertia", "rigid_inertia"):
        return "link inertia"
    if name in ("motor_inertia", "inertia"):
        return "motor inertia"
    if name == "motor_coulomb_friction":
        return "Coulomb friction"
    if name in ("motor_viscous_friction", "total_viscous_friction"):
        return "viscous friction"
    return "stiffness" if is_slope(name) else None


def _explained(
    number: int, joint: Joint, values: Sequence[SizedValue], outside: tuple[SizedValue, ...]
) -> ImplausibleJoint:
    """The first unit that brings every value of the joint into its range."""
    constant = joint.torque_per_volt
    for unit, factor in _TORQUE_UNITS.items():
        if all(each.is_plausible(factor) for each in values):
            right = None if constant is None else constant * factor
            return ImplausibleJoint(number, outside, unit, torque_per_volt=right)
    for unit, size in _ANGLE_UNITS.items():
        if all(each.is_plausible(1.0 / size if each.per_angle else 1.0) for each in values):
            return ImplausibleJoint(number, outside, unit, of_angle=True)
    return ImplausibleJoint(number, outside, None)
