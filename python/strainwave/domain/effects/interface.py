"""What a further effect of a joint has to say of itself.

Its simulation is the core's; or it only changes what the core is given for a record.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from strainwave.domain.parameter_table import (
    ParameterDescription,
    base_name,
    of_record,
    parameter_table,
)

Values = dict[str, float]
"""An effect's parameters: name -> value."""


@dataclass(frozen=True, slots=True)
class KnownJoint:
    """What is known of a joint before its effects are fitted."""

    gear_ratio: float  # n, link turns per motor turn
    coulomb_friction: float  # [N m] at the motor
    stiffness: float  # [N m/rad] of the gear without torsion, at the link; infinite if rigid
    largest_torque: float  # [N m] that the gear bears in the records, at the link
    largest_voltage: float  # [V] that the records apply


class Effect(ABC):
    """What a joint may have beside its spring and dry friction.

    Effects hold no state. Their values come by name, without the joint's number.
    """

    name: str
    """As in `effects` of a study."""

    sizes: tuple[str, ...]
    """Parameters that are zero where the effect is absent; the first of the core's."""

    shapes: Mapping[str, float] = {}
    """The core's other parameters -> usual value; see `tested_shapes`."""

    defaults: Mapping[str, float] = {}
    """Shapes that values need not have -> what they are then."""

    needs_elastic_gear: bool = False
    """Whether a rigid gear cannot have it."""

    first_joint_only: bool = False
    """Whether only what bears the first joint can have it."""

    moves_link_encoder: bool = False
    """Whether the zero of an encoder on the link moves: it then reads no angle in space."""

    by_record: bool = False
    """Whether each record has sizes of its own, named by `of_record`."""

    misleads_inertias: bool = False
    """Whether its absence misleads the rigid step on inertias and gravity, not only on friction."""

    prior_std: float | None = None
    """Standard deviation of a size about zero, before any record; None: nothing is known."""

    description: str
    """What it is, in one line without a full stop."""

    consequence: str
    """What it does to the estimates of a model without it: a clause without a full stop."""

    experiment: str
    """What would confirm it: an order, without a full stop."""

    record: str
    """The record that its fit needs: a noun."""

    @property
    def core_name(self) -> str | None:
        """Name of the effect in the core that simulates it; None: the core does not know it."""
        return self.name

    @property
    def names(self) -> tuple[str, ...]:
        """Of the parameters, in the core's order, without those of records."""
        return (*self.sizes, *self.shapes)

    @property
    def required(self) -> tuple[str, ...]:
        """Parameters that values must have."""
        return tuple(name for name in self.names if name not in self.defaults)

    def sizes_in(self, records: Sequence[str]) -> tuple[str, ...]:
        """Names of its sizes where some records are fitted.

        `records`: Their names.
        """
        if not self.by_record:
            return self.sizes
        return tuple(of_record(name, record) for record in records for name in self.sizes)

    @property
    def warning_code(self) -> str:
        """Of the warning that the residuals speak for it."""
        return f"{self.name}-likely"

    @property
    def remedy(self) -> str:
        """What to do about that warning."""
        return f'Give the joint effects = ["{self.name}"], and {self.record}.'

    @property
    def absent(self) -> Values:
        """Sizes of zero, at the usual shapes."""
        return dict.fromkeys(self.sizes, 0.0) | dict(self.shapes)

    def described(self, name: str) -> ParameterDescription:
        """Symbol, units and range of a parameter.

        `name`: One of the effect's.
        """
        return parameter_table()[base_name(name)]

    def is_signed(self, name: str) -> bool:
        """Whether a parameter may have either sign.

        `name`: One of the effect's.
        """
        return self.described(name).range == "any"

    @abstractmethod
    def typical_sizes(self, joint: KnownJoint) -> Values:
        """Sizes that the effect has in such a joint, by order of magnitude.

        Sizes without sign start from here, signed ones from zero in steps of this.

        Returns: Size -> value above zero.
        """

    def tested_shapes(self, joint: KnownJoint) -> tuple[Values, ...]:
        """Sets of shapes at which a size of zero is tested, the first one always.

        Returns: At least one; each shape -> value.
        """
        return (dict(self.shapes),)

    def starts(self, joint: KnownJoint) -> Values:
        """Where a fit starts: at the first of the shapes that are tested.

        Returns: Name -> value, of every parameter.
        """
        typical = self.typical_sizes(joint)
        sizes = {name: 0.0 if self.is_signed(name) else typical[name] for name in self.sizes}
        return sizes | self.tested_shapes(joint)[0]


@dataclass(frozen=True, slots=True)
class Input:
    """A parameter or an initial state of a joint, as a record effect has it in one record."""

    name: str  # as the core has it
    value: float  # of a parameter; of an initial state what is added to it
    slopes: Mapping[str, float]  # derivatives by parameters of the joint, its own among them


class RecordEffect(Effect):
    """An effect that the core does not have: it changes what the core is given for a record.

    Derivatives by its sizes are combinations of those that the core has.
    """

    prior_std: float | None = 0.3

    needs: Mapping[str, float] = {}
    """Parameters of the core's effect that it acts through -> value where that is absent."""

    @property
    def core_name(self) -> str | None:
        """Name of the effect in the core that it acts through; None: of none."""
        return None

    @abstractmethod
    def inputs(self, values: Values, gear_ratio: float) -> tuple[Input, ...]:
        """What it changes in one record.

        `values`: Parameters of the joint without its number, the effect's sizes in this record
        without the record's name. `gear_ratio`: n, link turns per motor turn.
        """
