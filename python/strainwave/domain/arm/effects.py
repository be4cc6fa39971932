"""Effects: optional terms of the joint model.

`effects.toml` has the effects, and the compiled core simulates them. A new effect needs an entry
there, and its equations in `rust/core/src/joint`. A `RecordEffect` changes parameters and initial
states of the core in a record instead. All other code loops over the effects.
"""

from __future__ import annotations

import math
import tomllib
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from strainwave.domain.arm.parameter_table import (
    ParameterDescription,
    base_name,
    of_record,
    parameter_table,
)
from strainwave.errors import entry_of

Values = dict[str, float]
"""An effect's parameters: name -> value."""

_ANTI_RESONANCE_HZ = 10.0  # typical; gives the link inertia from the gear's stiffness
_LINK_INERTIA_OF_RIGID_GEAR = 1.0  # [kg m^2] if no stiffness gives the link inertia
_COMPLIANCE_OF_RIGID_GEAR = 5e-5  # [rad/(N m)]

Scale = Literal[
    "coulomb_friction", "gear_compliance", "largest_torque", "largest_torsion", "link_inertia"
]
"""Property of a joint that gives the order of magnitude of an effect."""


@dataclass(frozen=True, slots=True)
class KnownJoint:
    """Properties of a joint that are known before its effects are fitted."""

    gear_ratio: float  # n, link turns per motor turn
    coulomb_friction: float  # [N m] motor side
    stiffness: float  # [N m/rad] at zero torsion, link side; infinite if rigid
    largest_torque: float  # [N m] of the gear in the records, link side
    largest_voltage: float  # [V] in the records

    @property
    def largest_torsion(self) -> float:
        """Torsion [rad] at the largest gear torque, link side."""
        return self.largest_torque / self.stiffness

    @property
    def gear_compliance(self) -> float:
        """Compliance [rad/(N m)] of the gear at zero torsion, or a typical one if it is rigid."""
        return 1.0 / self.stiffness if math.isfinite(self.stiffness) else _COMPLIANCE_OF_RIGID_GEAR

    @property
    def link_inertia(self) -> float:
        """Inertia [kg m^2] of the link, by the typical anti-resonance of joints."""
        inertia = self.stiffness / (math.tau * _ANTI_RESONANCE_HZ) ** 2
        return inertia if math.isfinite(inertia) else _LINK_INERTIA_OF_RIGID_GEAR


@dataclass(frozen=True, eq=False, kw_only=True)
class Effect:
    """An optional term of the joint model, in addition to spring and dry friction.

    `effects.toml` has the effects. Values are passed by name, without the joint's number.
    """

    name: str  # in `effects` of a study
    core_name: str | None  # of the core's effect that simulates it; None: the core has no such one
    # parameters that are zero if the effect is absent; they come first in the core
    sizes: tuple[str, ...]
    # Typical positive size by order of magnitude, as a multiple of `relative_to`. A fit starts
    # unsigned sizes at this value. It starts signed sizes at zero and uses this value as the scale.
    typical_size: float = math.nan
    relative_to: Scale | None = None  # to which a size is proportional; None: equal in all joints
    shapes: Mapping[str, float] = field(default_factory=dict)  # other parameters, usual values
    # Values of a shape that the score test tries in addition to the usual one. An effect of one
    # shape must not correlate with that of another shape.
    tested: Mapping[str, Sequence[float]] = field(default_factory=dict)
    # Shapes from which a fit starts, if not from the usual ones that the score test needs. A fit
    # converges to a mode from a lightly damped one.
    starting_shapes: Mapping[str, float] = field(default_factory=dict)
    defaults: Mapping[str, float] = field(default_factory=dict)  # of parameters that may be omitted
    # gear law in place of the linear one whose parameters are the sizes; None: an effect adds to
    # any law
    tested_law: str | None = None
    fitted_law: str | None = None  # gear law in a fit with the effect; None: the law stays
    needs_elastic_gear: bool = False  # whether only elastic gears can have the effect
    first_joint_only: bool = False  # whether only the first joint can have the effect
    moves_link_encoder: bool = False  # moves its zero, so that it measures no absolute angle
    by_record: bool = False  # whether each record has its own sizes, named by `of_record`
    # whether variational equations, in place of dual numbers, differentiate it at any size
    is_of_drive: bool = False
    is_part_of_link: bool = False  # size is an inertia that slow motion does not show apart
    # whether a rigid step without it biases inertias and gravity, not only friction
    misleads_inertias: bool = False
    prior_std: float | None = None  # of a size around zero; None: no prior
    description: str  # noun phrase that describes the effect
    consequence: str  # clause on the error of a model without the effect
    experiment: str  # imperative clause: the experiment that confirms the effect
    record: str  # noun phrase: the record that a fit of the effect needs
    stated_by: str = ""  # setting of a joint's table; "": its entry in `effects`

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters in the order of the core; records are not part of the names."""
        return (*self.sizes, *self.shapes)

    @property
    def required(self) -> tuple[str, ...]:
        """Parameters that values must contain."""
        return tuple(name for name in self.names if name not in self.defaults)

    @property
    def needs_dual_numbers(self) -> bool:
        """Whether the core differentiates it by dual numbers, which take ten times as long."""
        return self.core_name is not None and not (self.is_of_drive or self.by_record)

    def sizes_in(self, records: Sequence[str]) -> tuple[str, ...]:
        """Names of the sizes in a fit of the records with these names."""
        if not self.by_record:
            return self.sizes
        return tuple(of_record(name, record) for record in records for name in self.sizes)

    @property
    def warning_code(self) -> str:
        """Code of the warning that the residuals support the effect."""
        return f"{self.name}-likely"

    @property
    def setting(self) -> str:
        """Setting of the joint in a study with which a fit has the effect."""
        return self.stated_by or f'effects = ["{self.name}"] or "auto"'

    @property
    def remedy(self) -> str:
        """Remedy of that warning."""
        return f"Set {self.setting} for the joint and add {self.record}."

    @property
    def absent(self) -> Values:
        """Sizes of zero with the usual shapes."""
        return dict.fromkeys(self.sizes, 0.0) | dict(self.shapes)

    def described(self, name: str) -> ParameterDescription:
        """Symbol, units and range of a parameter of the effect."""
        return parameter_table()[base_name(name)]

    def is_signed(self, name: str) -> bool:
        """Whether a parameter of the effect may be negative."""
        return self.described(name).range == "any"

    def typical_sizes(self, joint: KnownJoint) -> Values:
        """Typical positive sizes in such a joint, by order of magnitude."""
        scale = 1.0 if self.relative_to is None else getattr(joint, self.relative_to)
        return dict.fromkeys(self.sizes, self.typical_size * scale)

    def tested_shapes(self, joint: KnownJoint) -> tuple[Values, ...]:
        """Shapes at which the score test evaluates a size of zero: at least one set."""
        others = [{name: value} for name, values in self.tested.items() for value in values]
        return tuple({**self.shapes, **other} for other in ({}, *others))

    def starts(self, joint: KnownJoint) -> Values:
        """Starting value of every parameter, at the first tested shape."""
        typical = self.typical_sizes(joint)
        sizes = {name: 0.0 if self.is_signed(name) else typical[name] for name in self.sizes}
        return sizes | self.tested_shapes(joint)[0] | dict(self.starting_shapes)


@dataclass(frozen=True, slots=True)
class Input:
    """A parameter or an initial state of a joint that a record effect changes in one record."""

    name: str  # in the core
    value: float  # new value of a parameter; increment of an initial state
    slopes: Mapping[str, float]  # derivatives with respect to the joint's parameters


class RecordEffect(Effect, ABC):
    """An effect that changes parameters or initial states of the core, separately in each record.

    The core's derivatives give the derivatives with respect to its sizes by the chain rule.
    `core_name` is the core's effect that it acts through, if any.
    """

    @abstractmethod
    def inputs(self, values: Values, gear_ratio: float) -> tuple[Input, ...]:
        """Changes in one record, from the joint's parameters and the effect's sizes in this record.

        Names carry neither joint nor record. `gear_ratio` is n, link turns per motor turn.
        """


_TWIST_SHARE = 0.1  # of the largest torsion; gears of the catalogue have 0.05 to 0.15
_TESTED_LIMIT_SHARES = (0.9, 0.75, 0.6)  # of the largest recorded voltage
_COULOMB, _FRICTION_CHANGE = "motor_coulomb_friction", "friction_change"
_GAIN, _GAIN_CHANGE = "drive_gain", "drive_gain_change"


class Hysteresis(Effect):
    """Hysteresis of the gear torque over the torsion."""

    def tested_shapes(self, joint: KnownJoint) -> tuple[Values, ...]:
        """The usual twist, or that of a soft gear: a tenth of its largest torsion."""
        ((name, usual),) = self.shapes.items()
        return ({name: max(usual, _TWIST_SHARE * joint.largest_torsion)},)


class DriveLimit(Effect):
    """A drive gain that falls above a voltage."""

    def tested_shapes(self, joint: KnownJoint) -> tuple[Values, ...]:
        """Limits below the largest recorded voltage."""
        if not joint.largest_voltage > 0.0:
            return super().tested_shapes(joint)
        (name,) = self.shapes
        return tuple({name: share * joint.largest_voltage} for share in _TESTED_LIMIT_SHARES)


class FrictionByRecord(RecordEffect):
    """Coulomb friction that differs from record to record."""

    def inputs(self, values: Values, gear_ratio: float) -> tuple[Input, ...]:
        """Coulomb friction times (1 + phi_r)."""
        friction, factor = values[_COULOMB], 1.0 + values[_FRICTION_CHANGE]
        slopes = {_COULOMB: factor, _FRICTION_CHANGE: friction}
        return (Input(_COULOMB, factor * friction, slopes),)


class DriveGainByRecord(RecordEffect):
    """A torque per volt that differs from record to record."""

    def inputs(self, values: Values, gear_ratio: float) -> tuple[Input, ...]:
        """drive_gain = (1 + g_u) (1 + g_r) - 1."""
        gain, factor = 1.0 + values.get(_GAIN, 0.0), 1.0 + values[_GAIN_CHANGE]
        return (Input(_GAIN, gain * factor - 1.0, {_GAIN: factor, _GAIN_CHANGE: gain}),)


class EncoderZero(RecordEffect):
    """A constant error of the joint angle."""

    def inputs(self, values: Values, gear_ratio: float) -> tuple[Input, ...]:
        """Shift of both initial angles; the fit compares velocities, which have no zero."""
        zero = values["encoder_zero"]
        motor = Input("initial_motor_angle", zero / gear_ratio, {"encoder_zero": 1.0 / gear_ratio})
        return motor, Input("initial_link_angle", zero, {"encoder_zero": 1.0})


SUBCLASSES: dict[str, type[Effect]] = {
    "hysteresis": Hysteresis,
    "drive-limit": DriveLimit,
    "friction-by-record": FrictionByRecord,
    "drive-gain-by-record": DriveGainByRecord,
    "encoder-zero": EncoderZero,
}
"""By name; all other effects are an `Effect`."""


_TABLES = tomllib.loads(Path(__file__).with_name("effects.toml").read_text(encoding="utf-8"))


def _effects(group: str) -> tuple[Effect, ...]:
    effects = []
    for name, table in _TABLES[group].items():
        core_name = name if group == "core" else table.pop("core_name", None)
        kind, sizes = SUBCLASSES.get(name, Effect), tuple(table.pop("sizes"))
        effects.append(kind(name=name, core_name=core_name, sizes=sizes, **table))
    return tuple(effects)


EFFECTS = {effect.name: effect for effect in (*_effects("core"), *_effects("record"))}
"""Effects of elastic and of rigid joints by name."""

RIGID_ONLY = _effects("rigid")
"""Effects that studies can name for rigid joints only."""

OF_RIGID_JOINTS = (
    "stribeck",
    "power-friction",
    "load-friction",
    "load-speed-friction",
    "direction-friction",
    "ground-spring",
    "encoder-zero",
    "torque-delay",
    "gear-torsion",
)
"""Names of the effects of which the rigid step has equations."""

(STIFFNESS_CURVE,) = _effects("gear-law")
"""The rival of all effects of an elastic gear with one stiffness. A study cannot name it."""


def effect_named(name: str) -> Effect:
    """The effect with a name. Raises InvalidInput if there is none."""
    further = {effect.name: effect for effect in (STIFFNESS_CURVE, *RIGID_ONLY)}
    return further.get(name) or entry_of(EFFECTS, name, "effect", "effects")


def study_names() -> tuple[str, ...]:
    """Names that studies can use: those of all effects, and of the effects of rigid joints."""
    return (*names(), *(effect.name for effect in RIGID_ONLY))


def possible_causes() -> tuple[Effect, ...]:
    """Everything that a model of a joint may lack: all effects, and a curve of its stiffness."""
    return (STIFFNESS_CURVE, *EFFECTS.values())


def names() -> tuple[str, ...]:
    """Names of all effects."""
    return tuple(EFFECTS)


def all_effects() -> tuple[Effect, ...]:
    """All effects."""
    return tuple(EFFECTS.values())
