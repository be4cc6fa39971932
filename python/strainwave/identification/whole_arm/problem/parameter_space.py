"""Unknowns of the whole-arm fit: coordinates, ranges and values."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from strainwave.domain import BoolArray, FloatArray
from strainwave.domain.keys import Key, Keyed, Values
from strainwave.domain.parameter_table import SETTLING
from strainwave.identification.whole_arm.problem.prior import Prior

# limits of the relative change of a positive value in one step
_MIN_RELATIVE_CHANGE, _MAX_RELATIVE_CHANGE = -0.8, 1.5
# lower limit of the relative change of a settling time, which may be zero
_MIN_SETTLING_CHANGE = -0.99


@dataclass(frozen=True, slots=True)
class Unknown(Keyed):
    """An unknown parameter and its coordinate z, which is zero at the start.

    The value of a positive parameter is scale exp(z), plus that of its lower bound `above` if there
    is one, such as the first knee for the second. That of a signed parameter is start + scale z.
    """

    name: str
    joint: int | None
    unit: str
    start: float
    scale: float
    signed: bool
    reach: float  # largest |z|
    limits: tuple[float, float] | None = None  # bounds of z that replace its reach
    above: str | None = None  # name of a parameter of the same joint that is a lower bound
    prior_std: float | None = None  # of a normal prior centred at the start; None for no prior

    def __str__(self) -> str:
        return self.name if self.joint is None else f"{self.name} of joint {self.joint}"


@dataclass(frozen=True, slots=True)
class ParameterSpace:
    """Unknowns, fixed parameters and prior of a fit."""

    unknowns: tuple[Unknown, ...]
    fixed: Mapping[Key, float]
    prior: Prior

    @property
    def lower(self) -> FloatArray:
        """Lower bounds of z, (n_unknowns,)."""
        return np.array([u.limits[0] if u.limits else -u.reach for u in self.unknowns])

    @property
    def upper(self) -> FloatArray:
        """Upper bounds of z, (n_unknowns,)."""
        return np.array([u.limits[1] if u.limits else u.reach for u in self.unknowns])

    @property
    def own_prior(self) -> tuple[FloatArray, FloatArray]:
        """Whitened rows (n_rows, n_unknowns) and targets (n_rows,) of priors of single unknowns."""
        places = [k for k, unknown in enumerate(self.unknowns) if unknown.prior_std is not None]
        std = np.array([self.unknowns[k].prior_std for k in places], dtype=float)
        start = np.array([self.unknowns[k].start for k in places])
        return np.eye(len(self.unknowns))[places] / std[:, None], start / std

    def linearise_prior(self, z: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Jacobian (n_rows, n_unknowns) and residual (n_rows,) of all priors at z (n_unknowns,)."""
        rows, target = self.own_prior
        rows = np.concatenate([self.prior.rows, rows])
        target = np.concatenate([self.prior.target, target])
        return rows @ self.slope(z), rows @ self.parameters(z) - target

    @property
    def keys(self) -> list[Key]:
        """Names and joints of the unknowns."""
        return [unknown.key for unknown in self.unknowns]

    def parameters(self, z: FloatArray) -> FloatArray:
        """Values of the unknowns, (n_unknowns,)."""
        values: FloatArray = np.array(
            [
                u.start + u.scale * at if u.signed else u.scale * np.exp(at)
                for u, at in zip(self.unknowns, z, strict=True)
            ]
        )
        for lower, upper in self._bound_pairs:
            values[upper] += values[lower]
        for k, unknown in enumerate(self.unknowns):
            if unknown.above is not None:
                values[k] += self.fixed.get((unknown.above, unknown.joint), 0.0)
        return values

    def slope(self, z: FloatArray) -> FloatArray:
        """Derivatives of the values with respect to the coordinates, (n_unknowns, n_unknowns)."""
        scales = [
            u.scale if u.signed else u.scale * np.exp(at)
            for u, at in zip(self.unknowns, z, strict=True)
        ]
        jacobian = np.diag(np.array(scales))
        for lower, upper in self._bound_pairs:
            jacobian[upper] += jacobian[lower]
        return np.asarray(jacobian)

    def move(self, z: FloatArray, step: FloatArray) -> FloatArray:
        """Apply a step that is linear in the values instead of the coordinates: (n_unknowns,).

        The data determine sums best, such as link inertia plus motor inertia, or the total viscous
        friction. The valleys of the cost are then straight in values and curved in logarithms.
        """
        moved, positive = z + step, self._is_positive
        moved[positive] = z[positive] + np.log1p(step[positive])
        return np.asarray(np.clip(moved, self.lower, self.upper))

    def at_bounds(self, z: FloatArray, gradient: FloatArray) -> BoolArray:
        """Which unknowns (n_unknowns,) are at a bound that a descent step would cross."""
        low, high = (z <= self.lower) & (gradient > 0.0), (z >= self.upper) & (gradient < 0.0)
        return np.asarray(low | high)

    def limit_step(self, z: FloatArray, step: FloatArray, share: float) -> FloatArray:
        """Limit a step to the bounds and to a maximum relative change of positive values.

        `share` scales the maximum relative change.
        """
        positive = self._is_positive
        down, up = self.lower - z, self.upper - z
        down[positive], up[positive] = np.expm1(down[positive]), np.expm1(up[positive])
        lower_change = [
            _MIN_SETTLING_CHANGE if u.name == SETTLING else _MIN_RELATIVE_CHANGE
            for u in self.unknowns
        ]
        down[positive] = np.maximum(down, share * np.array(lower_change))[positive]
        up[positive] = np.minimum(up, share * _MAX_RELATIVE_CHANGE)[positive]
        return np.asarray(np.clip(step, np.minimum(down, 0.0), np.maximum(up, 0.0)))

    @property
    def _is_positive(self) -> BoolArray:
        """Which unknowns (n_unknowns,) have logarithmic coordinates."""
        return np.array([not unknown.signed for unknown in self.unknowns])

    def values(self, z: FloatArray) -> Values:
        """Values of all parameters for the simulation, fixed ones included."""
        return {**self.fixed, **dict(zip(self.keys, self.parameters(z).tolist(), strict=True))}

    @property
    def start_values(self) -> Values:
        """Values of all parameters at the starts of the unknowns, fixed ones included."""
        return self.values(np.zeros(len(self.unknowns)))

    def coordinates(self, values: Values) -> FloatArray:
        """Coordinates of values, clipped to the bounds: (n_unknowns,)."""
        z = []
        for unknown in self.unknowns:
            value = values[unknown.key]
            if unknown.above is not None:
                value -= values[unknown.above, unknown.joint]
            if unknown.signed:
                z.append((value - unknown.start) / unknown.scale)
            else:
                z.append(np.log(max(value / unknown.scale, 1e-12)))
        return np.asarray(np.clip(np.array(z), self.lower, self.upper))

    def recentre(self, z: FloatArray, chosen: Collection[int]) -> ParameterSpace:
        """Centre the ranges of unknowns with logarithmic coordinates at their values at z."""
        values = self.parameters(z).tolist()
        unknowns = tuple(
            replace(u, start=value, scale=u.scale * float(np.exp(at))) if k in chosen else u
            for k, (u, value, at) in enumerate(zip(self.unknowns, values, z.tolist(), strict=True))
        )
        return replace(self, unknowns=unknowns)

    def add(
        self, unknowns: Iterable[Unknown], columns: Iterable[FloatArray] | None = None
    ) -> ParameterSpace:
        """Add unknowns, with their columns (n_prior,) in the rigid prior; zero by default."""
        added = (*self.unknowns, *unknowns)
        zero = [np.zeros(len(self.prior.rows))] * (len(added) - len(self.unknowns))
        rows = np.column_stack([self.prior.rows, *(zero if columns is None else columns)])
        return replace(self, unknowns=added, prior=replace(self.prior, rows=rows))

    def select(self, kept: Sequence[int]) -> ParameterSpace:
        """Remove the unknowns at other places than `kept`."""
        prior = replace(self.prior, rows=self.prior.rows[:, kept])
        return replace(self, unknowns=tuple(self.unknowns[k] for k in kept), prior=prior)

    def fix_values(self, values: Mapping[Key, float]) -> ParameterSpace:
        """Fix some of the unknowns at given values."""
        held = [values.get(key, 0.0) if key in values else 0.0 for key in self.keys]
        target = self.prior.target - self.prior.rows @ np.array(held)
        kept = self.select([k for k, key in enumerate(self.keys) if key not in values])
        prior = replace(kept.prior, target=target)
        return replace(kept, fixed={**self.fixed, **values}, prior=prior)

    @property
    def _bound_pairs(self) -> list[tuple[int, int]]:
        """Index pairs (lower, upper) of unknowns of which the first bounds the second."""
        at = {key: k for k, key in enumerate(self.keys)}
        pairs = ((at.get((u.above, u.joint)), k) for k, u in enumerate(self.unknowns) if u.above)
        return [(lower, upper) for lower, upper in pairs if lower is not None]
