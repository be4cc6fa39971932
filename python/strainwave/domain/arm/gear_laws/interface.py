"""Interface of an elastic law of a gear. The compiled core simulates the laws."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from strainwave.domain.arm.parameter_table import ParameterDescription, parameter_table
from strainwave.domain.keys import FloatArray, JointNumber
from strainwave.domain.messages import plus_minus

STIFFNESS = "gear_stiffness"
"""Equivalent linear stiffness [N m/rad] of an elastic gear in the joint models."""

Values = dict[str, float]
"""A law's parameters: name -> value."""

_RELATIVE_STEP = 1e-6  # of the torsion, for central differences of the jacobian
_N_BISECTIONS = 60  # shrink a bracket to rounding error
_MAX_DOUBLINGS = 200  # of the upper end of a bracket


@dataclass(frozen=True, slots=True)
class GearParameter:
    """One parameter of a law. A name has the same meaning in every law."""

    name: str  # in the core
    is_slope: bool = False  # a stiffness of the order of the equivalent linear one
    by_load: bool = False  # identifiable only if a record loads the gear far enough
    above: str | None = None  # parameter of the same law that is a lower bound

    @property
    def described(self) -> ParameterDescription:
        """Symbol, units and range."""
        return parameter_table()[self.name]


class GearLaw(ABC):
    """An elastic law T(delta): gear torque over torsion, link side, odd and increasing.

    Laws are stateless. Values are passed by name, without the joint's number. Arrays of torsions
    [rad] and torques [N m] have shape (n,).
    """

    name: str  # value of `spring` in a study file
    # in the order of the core. `gear_damping` belongs to every elastic gear, not to a law
    parameters: tuple[GearParameter, ...] = ()
    elastic: bool = True  # whether the gear has torsion
    # name of the law to use if none of this law's own parameters is known
    simpler: str | None = None
    # parameter that a linear model of the joint uses as its stiffness
    linearised_by: str = STIFFNESS
    # note on a linear model of a joint with this law
    linearised_note: str = "the gear is nonlinear; the linear model has one stiffness"
    # position of the equivalent linear stiffness relative to the law's own
    equivalent_note: str = "between the lowest and the highest stiffness"
    # keys of a parameter file that accept a list, with the names of the listed parameters
    lists: Mapping[str, tuple[str, ...]] = {}

    @property
    def core_name(self) -> str:
        """Name of the law in the core that simulates it."""
        return self.name

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters in the order of the core."""
        return tuple(parameter.name for parameter in self.parameters)

    @property
    def slopes(self) -> tuple[str, ...]:
        """Names of the parameters that are stiffnesses."""
        return tuple(parameter.name for parameter in self.parameters if parameter.is_slope)

    @property
    def may_vanish(self) -> tuple[str, ...]:
        """Names of the parameters that are zero if the gear follows the simpler law."""
        return tuple(p.name for p in self.parameters if p.described.range == "non-negative")

    @property
    def is_curved(self) -> bool:
        """Whether the law needs more than one stiffness."""
        return self.elastic and self.names != (STIFFNESS,)

    def of_joint(
        self, values: Mapping[tuple[str, int | None], float], joint: JointNumber
    ) -> Values:
        """Values of the law's parameters of a joint among those of an arm; by name."""
        return {name: values[name, joint] for name in self.names if (name, joint) in values}

    @abstractmethod
    def torque(self, values: Mapping[str, float], torsion: FloatArray) -> FloatArray:
        """T(delta)."""

    @abstractmethod
    def stiffness(self, values: Mapping[str, float], torsion: FloatArray) -> FloatArray:
        """dT/ddelta [N m/rad]."""

    @abstractmethod
    def jacobian(self, values: Mapping[str, float], torsion: FloatArray) -> FloatArray:
        """Derivatives of the torque with respect to the known parameters: (n, n_values)."""

    def stiffness_jacobian(self, values: Mapping[str, float], torsion: FloatArray) -> FloatArray:
        """Derivatives of the stiffness with respect to the known parameters: (n, n_values)."""
        step = np.maximum(_RELATIVE_STEP * np.abs(torsion), np.finfo(float).tiny ** 0.25)
        ends = (self.jacobian(values, torsion + side * step) for side in (1.0, -1.0))
        high, low = ends
        return np.asarray((high - low) / (2.0 * step[:, None]))

    def torsion(self, values: Mapping[str, float], torque: FloatArray) -> FloatArray:
        """Inverse of T(delta), by bisection."""
        magnitude = np.abs(torque)
        high = magnitude / self.stiffness(values, np.zeros_like(magnitude))
        for _ in range(_MAX_DOUBLINGS):
            short = self.torque(values, high) < magnitude
            if not short.any():
                break
            high = np.where(short, 2.0 * high, high)
        low = np.zeros_like(high)
        for _ in range(_N_BISECTIONS):
            middle = 0.5 * (low + high)
            short = self.torque(values, middle) < magnitude
            low, high = np.where(short, middle, low), np.where(short, high, middle)
        return np.asarray(np.copysign(0.5 * (low + high), torque))

    def straight(self, stiffness: float) -> Values:
        """Parameters for which the law is linear with this stiffness [N m/rad]."""
        return {p.name: stiffness if p.is_slope else 0.0 for p in self.parameters}

    def starts(self, stiffness: float, largest_torque: float) -> Values:
        """Starting values of a fit from one stiffness [N m/rad]; all are nonzero.

        `largest_torque` [N m] is the largest gear torque of the records.
        """
        return self.straight(stiffness)

    def restarts(self, values: Mapping[str, float], largest_torque: float) -> Iterator[Values]:
        """Further starting values near the result of a search that a gradient cannot leave.

        `largest_torque` [N m] is the largest gear torque of the records. Yields nothing if there
        are none.
        """
        yield from ()

    def identified(
        self, values: Mapping[str, float], covariance: FloatArray, largest_torque: float
    ) -> Mapping[str, str | None]:
        """Estimate that represents each parameter, by name; None if no record determines it.

        `covariance` (n_parameters, n_parameters) has the order of `values`, `largest_torque` [N m]
        is the largest gear torque of the records. Parameters that are not in the result represent
        themselves.
        """
        return {}

    def drawn(self, known: Collection[str]) -> tuple[str, ...]:
        """Names of the identified parameters that make a curve, in the law's order.

        Empty if they make none.
        """
        return self.names if self.names and set(self.names) <= set(known) else ()

    def knees(self, values: Mapping[str, float]) -> tuple[float, ...]:
        """Torques [N m], ascending, at which the stiffness jumps. Excitation should exceed them."""
        return ()

    def stiffness_range(self, values: Mapping[str, float]) -> tuple[float, float]:
        """Lowest and highest stiffness [N m/rad] of the curve.

        Raises KeyError if a slope is unknown.
        """
        slopes = [values[name] for name in self.slopes]
        return min(slopes), max(slopes)

    def parallel_springs(
        self, need: Callable[[str], float]
    ) -> tuple[tuple[float, float], ...] | None:
        """Linear springs in parallel whose sum is the law; None if there is no such sum.

        Each is a stiffness [N m/rad] and the torsion [rad] beyond which the spring acts.
        """
        return None if self.is_curved else ((need(self.linearised_by), 0.0),)

    def polynomial(self, need: Callable[[str], float]) -> tuple[float, ...] | None:
        """Torque per torsion, its square and its cube, if the law is this sum and curved."""
        return None

    def sentence(
        self, values: Mapping[str, float], std: Sequence[float], *, is_straight: bool
    ) -> str:
        """Text of a curve without a full stop: its slopes, then the other parameters.

        `std` (n_values,) has the order of `values`. `is_straight` is true for prismatic joints.
        """
        units = {p.name: p.described.units[is_straight] for p in self.parameters}
        texts = {
            name: " ± ".join(plus_minus(value, s))
            for (name, value), s in zip(values.items(), std, strict=True)
        }
        slopes = [texts[name] for name in self.slopes if name in texts]
        text = f"Slope {', then '.join(slopes)} {units[self.slopes[0]]}"
        others = [p for p in self.parameters if p.name in texts and not p.is_slope]
        return ", ".join(
            [text, *(f"{p.described.symbol} {texts[p.name]} {units[p.name]}" for p in others)]
        )
