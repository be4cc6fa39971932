"""What an elastic law of a gear has to say of itself; its simulation is the core's."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from strainwave.domain.arrays import FloatArray
from strainwave.domain.formatting import plus_minus
from strainwave.domain.parameter_table import ParameterDescription, parameter_table

STIFFNESS = "gear_stiffness"
"""The one stiffness [N m/rad] by which the joint models describe any elastic gear."""

Values = dict[str, float]
"""A law's parameters: name -> value."""

_SPREAD = 1e-6  # share of a torsion over which slopes are differentiated
_HALVINGS = 60  # of an interval that holds a torsion: to rounding
_DOUBLINGS = 200


@dataclass(frozen=True, slots=True)
class GearParameter:
    """One parameter of a law. The same name means the same in every law."""

    name: str  # one of the core's
    is_slope: bool = False  # a stiffness, of the size of the joint model's
    by_load: bool = False  # shows only where a record loads the gear far enough
    above: str | None = None  # a parameter of the same law that it exceeds

    @property
    def described(self) -> ParameterDescription:
        """Its symbol, units and range."""
        return parameter_table()[self.name]


class GearLaw(ABC):
    """An elastic law T(delta): torque over torsion at the link, odd and rising.

    Laws hold no state. Their values come by name, without the joint's number.
    """

    name: str
    """As `spring` in a study file."""

    parameters: tuple[GearParameter, ...] = ()
    """In the order of the core; `gear_damping` is every elastic gear's, and none of the law's."""

    elastic: bool = True
    """Whether the gear gives way at all."""

    simpler: str | None = None
    """Name of the law that stands for this one while none of its own parameters is known."""

    linearised_by: str = STIFFNESS
    """Parameter that a linear model of the joint takes for its stiffness."""

    linearised_note: str = "its gear has a curve; the linear model has one stiffness"
    """What a linear model of the joint leaves out of a curve."""

    equivalent_note: str = "between its lowest and its highest"
    """Where the joint model's one stiffness lies, which stands for a curve."""

    lists: Mapping[str, tuple[str, ...]] = {}
    """Keys of a parameter file that take a list of values -> the parameters listed."""

    @property
    def core_name(self) -> str:
        """Name of the law in the core that simulates it."""
        return self.name

    @property
    def names(self) -> tuple[str, ...]:
        """Of the parameters, in the core's order."""
        return tuple(parameter.name for parameter in self.parameters)

    @property
    def slopes(self) -> tuple[str, ...]:
        """Of those that are stiffnesses."""
        return tuple(parameter.name for parameter in self.parameters if parameter.is_slope)

    @property
    def may_vanish(self) -> tuple[str, ...]:
        """Of those that are zero where the gear is of the simpler law."""
        return tuple(p.name for p in self.parameters if p.described.range == "non-negative")

    @property
    def is_curved(self) -> bool:
        """Whether it takes more than one stiffness to describe."""
        return self.elastic and self.names != (STIFFNESS,)

    def of_joint(self, values: Mapping[tuple[str, int | None], float], joint: int) -> Values:
        """The law's values among those of an arm.

        `values`: (name, joint) -> value. `joint`: From 1. Returns: Name -> value of those that are
        there.
        """
        return {name: values[name, joint] for name in self.names if (name, joint) in values}

    @abstractmethod
    def torque(self, values: Mapping[str, float], torsion: FloatArray) -> FloatArray:
        """T(delta).

        `values`: Name -> value. `torsion` (n,) [rad]. Returns (n,) [N m].
        """

    @abstractmethod
    def stiffness(self, values: Mapping[str, float], torsion: FloatArray) -> FloatArray:
        """dT/ddelta.

        `values`: Name -> value. `torsion` (n,) [rad]. Returns (n,) [N m/rad].
        """

    @abstractmethod
    def jacobian(self, values: Mapping[str, float], torsion: FloatArray) -> FloatArray:
        """Derivatives of the torque at a torsion by the parameters.

        `values`: Name -> value. `torsion` (n,) [rad]. Returns (n, n_values): In the order of the
        law's parameters, those that have values.
        """

    def stiffness_jacobian(self, values: Mapping[str, float], torsion: FloatArray) -> FloatArray:
        """Derivatives of the stiffness at a torsion by the parameters.

        `values`: Name -> value. `torsion` (n,) [rad]. Returns (n, n_values).
        """
        off = np.maximum(_SPREAD * np.abs(torsion), np.finfo(float).tiny ** 0.25)
        ends = (self.jacobian(values, torsion + side * off) for side in (1.0, -1.0))
        high, low = ends
        return np.asarray((high - low) / (2.0 * off[:, None]))

    def torsion(self, values: Mapping[str, float], torque: FloatArray) -> FloatArray:
        """Torsion under a torque, the inverse of T(delta).

        `values`: Name -> value. `torque` (n,) [N m]. Returns (n,) [rad].
        """
        wanted = np.abs(torque)
        high = wanted / self.stiffness(values, np.zeros_like(wanted))
        for _ in range(_DOUBLINGS):
            short = self.torque(values, high) < wanted
            if not short.any():
                break
            high = np.where(short, 2.0 * high, high)
        low = np.zeros_like(high)
        for _ in range(_HALVINGS):
            middle = 0.5 * (low + high)
            short = self.torque(values, middle) < wanted
            low, high = np.where(short, middle, low), np.where(short, high, middle)
        return np.asarray(np.copysign(0.5 * (low + high), torque))

    def straight(self, stiffness: float) -> Values:
        """Parameters by which the law is a linear one.

        `stiffness` [N m/rad]. Returns: Name -> value.
        """
        return {p.name: stiffness if p.is_slope else 0.0 for p in self.parameters}

    def starts(self, stiffness: float, largest_torque: float) -> Values:
        """Where a fit starts that knows one stiffness.

        `stiffness` [N m/rad]: Of the joint's model. `largest_torque` [N m]: That the gear carries
        in the records. Returns: Name -> value, none of them zero.
        """
        return self.straight(stiffness)

    def restarts(self, values: Mapping[str, float], largest_torque: float) -> Iterator[Values]:
        """Other curves to start from, near one that no derivative would bring away.

        `values`: Name -> value, where a search ended. `largest_torque` [N m]: That the gear carries
        in the records. Returns: Name -> value; nothing where the curve is all that it can be.
        """
        yield from ()

    def identified(
        self, values: Mapping[str, float], covariance: FloatArray, largest_torque: float
    ) -> Mapping[str, str | None]:
        """Which parameters the records show, by which estimate each is known.

        `values`: Name -> value of all parameters. `covariance` (n_parameters, n_parameters): In
        their order. `largest_torque` [N m]: That the gear carries in the records. Returns: Name ->
        name of the estimate that counts for it; None: no record reaches it. Those that are left out
        are known by their own.
        """
        return {}

    def drawn(self, known: Collection[str]) -> tuple[str, ...]:
        """Which of the parameters that are identified make a curve.

        `known`: Names. Returns: In the law's order; empty: there is none.
        """
        return self.names if self.names and set(self.names) <= set(known) else ()

    def knees(self, values: Mapping[str, float]) -> tuple[float, ...]:
        """Torques [N m] at which the stiffness changes at once, and beyond which to excite a gear.

        `values`: Name -> value. Returns: Ascending.
        """
        return ()

    def stiffness_range(self, values: Mapping[str, float]) -> tuple[float, float]:
        """The lowest and the highest stiffness [N m/rad] of the curve, as far as it has ends.

        `values`: Name -> value. Raises `KeyError`: A slope is not there.
        """
        found = [values[name] for name in self.slopes]
        return min(found), max(found)

    def parallel_springs(
        self, need: Callable[[str], float]
    ) -> tuple[tuple[float, float], ...] | None:
        """The law as linear springs side by side, each of which acts beyond some torsion.

        `need`: Gives the value of a parameter. Returns [N m/rad]: To be added up; None: the law is
        no such sum.
        """
        return None if self.is_curved else ((need(self.linearised_by), 0.0),)

    def sentence(
        self, values: Mapping[str, float], std: Sequence[float], *, is_straight: bool
    ) -> str:
        """A curve in words: its slopes, then what else it has.

        `values`: Name -> value of those that make the curve. `std` (n_values,). `is_straight`: Of a
        prismatic joint. Returns: Without a full stop.
        """
        units = {p.name: p.described.units[is_straight] for p in self.parameters}
        said = {
            name: " ± ".join(plus_minus(value, s))
            for (name, value), s in zip(values.items(), std, strict=True)
        }
        slopes = [said[name] for name in self.slopes if name in said]
        text = f"Slope {', then '.join(slopes)} {units[self.slopes[0]]}"
        others = [p for p in self.parameters if p.name in said and not p.is_slope]
        return ", ".join(
            [text, *(f"{p.described.symbol} {said[p.name]} {units[p.name]}" for p in others)]
        )
