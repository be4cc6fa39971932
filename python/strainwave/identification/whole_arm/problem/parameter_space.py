"""Unknowns of the whole-arm fit: coordinates, ranges, values, prior and restrictions by options.

The prior is that of the rigid step: its estimates, with correlated errors.
"""

from __future__ import annotations

from collections.abc import Collection, Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from strainwave.domain import BoolArray, FloatArray, RigidModel, WholeArmOptions
from strainwave.domain.arm.gear_laws import STIFFNESS, is_slope
from strainwave.domain.arm.link_sensors import constant_of
from strainwave.domain.arm.parameter_table import (
    COULOMB,
    OFFSET,
    SETTLING,
    Family,
    base_name,
    family_of,
    parameter_table,
)
from strainwave.domain.keys import Key, Keyed, Row, Values
from strainwave.domain.study import PUBLISHED_RANGE
from strainwave.dynamics.arm import Arm
from strainwave.errors import InvalidInput

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


# relative errors of rigid-step estimates if the model lacks an effect
_BIAS_SHARES: Mapping[Family, float] = {
    "inertia": 0.1,
    "gravity": 0.1,
    "damping": 0.3,
    "dry friction": 0.03,
}
_MIN_BIAS = 1e-12  # [SI] minimum error, for estimates of zero


@dataclass(frozen=True, slots=True)
class Prior:
    """Prior of the rigid step: linear combinations of the unknowns, with correlated errors.

    The rows are whitened by the covariance of the rigid step plus a minimum variance.
    """

    rows: FloatArray  # (n_rows, n_unknowns), whitened
    target: FloatArray  # (n_rows,), whitened
    errors: FloatArray  # (n_rows, n_rows) covariance of the whitened rows without minimum variance
    names: tuple[Key, ...] = ()  # (n_rows,) parameters of the rigid model
    factor: FloatArray = field(default_factory=lambda: np.zeros((0, 0)))
    """(n_rows, n_rows) factor from whitened rows to parameter units."""
    mean: FloatArray = field(default_factory=lambda: np.zeros(0))  # (n_rows,) estimates
    before: tuple[FloatArray, FloatArray] | None = None
    """`factor` and `errors` before `relax`; None if that was not applied."""

    @classmethod
    def empty(cls, n_unknowns: int) -> Prior:
        """No prior knowledge."""
        return cls(np.zeros((0, n_unknowns)), np.zeros(0), np.zeros((0, 0)))

    def by_shifts(self, names: Collection[Key]) -> FloatArray:
        """Derivatives (n_rows, n_shifts) of the whitened rows with respect to rigid-step errors.

        Each error is scaled by its typical size if the model lacks an effect.
        """
        places = [k for k, name in enumerate(self.names) if name in names]
        units = np.eye(len(self.names))[:, places] * self.typical_biases[places]
        return np.asarray(np.linalg.solve(self.factor, units))

    def relax(self, names: Collection[Key]) -> Prior:
        """Increase the variance of rigid-model parameters that a missing effect biases."""
        places = [k for k, name in enumerate(self.names) if name in names]
        if not places:
            return self
        added_errors = np.zeros((len(self.names), len(places)))
        added_errors[places, range(len(places))] = self.typical_biases[places]
        factor = np.asarray(
            np.linalg.cholesky(self.factor @ self.factor.T + added_errors @ added_errors.T)
        )
        transform = np.linalg.solve(factor, self.factor)
        whitened_errors = np.linalg.solve(factor, added_errors)
        return replace(
            self,
            rows=transform @ self.rows,
            target=transform @ self.target,
            errors=transform @ self.errors @ transform.T + whitened_errors @ whitened_errors.T,
            factor=factor,
            before=self.before or (self.factor, self.errors),
        )

    def restore(self) -> Prior:
        """Restore the prior before `relax`."""
        if self.before is None:
            return self
        factor, errors = self.before
        transform = np.linalg.solve(factor, self.factor)
        rows, target = transform @ self.rows, transform @ self.target
        return replace(self, rows=rows, target=target, errors=errors, factor=factor, before=None)

    @property
    def typical_biases(self) -> FloatArray:
        """Typical errors (n_rows,) of the rigid-model parameters if the model lacks an effect."""
        sizes = reference_sizes(dict(zip(self.names, self.mean.tolist(), strict=True)))
        errors = [_BIAS_SHARES[family_of(name)] * size for (name, _), size in sizes.items()]
        return np.asarray(np.maximum(errors, _MIN_BIAS))


def combination(names: Sequence[Key], parts: Row) -> FloatArray:
    """Weights (n_unknowns,) of a linear combination; parts that are not unknowns are ignored."""
    return np.array([parts.get(name, 0.0) for name in names])


def reference_sizes(values: Mapping[Key, float]) -> Values:
    """Size of each value for relative errors.

    That of a friction offset is the Coulomb friction, that of an inertial value of either sign the
    largest of its kind: products of inertia and first moments may be zero.
    """
    descriptions = {key: parameter_table().get(base_name(key[0])) for key in values}
    kinds = {
        key: described.units
        for key, described in descriptions.items()
        if described and described.family == "inertia" and described.range == "any"
    }
    return {
        key: abs(values.get((COULOMB, key[1]), value) if key[0] == OFFSET else value)
        for key, value in values.items()
    } | largest_of_kind(values, kinds)


def largest_of_kind(values: Mapping[Key, float], kinds: Mapping[Key, Hashable]) -> Values:
    """For each key with a kind, the size of the largest value of that kind."""
    return {
        key: max(abs(values[other]) for other in kinds if kinds[other] == kind)
        for key, kind in kinds.items()
    }


def rigid_prior(model: RigidModel | None, keys: Sequence[Key], arm: Arm, floor: float) -> Prior:
    """Rigid-step estimates as whitened linear combinations of the unknowns."""
    identified = [
        k
        for k, p in enumerate(model.parameters if model is not None else ())
        if p.value is not None and np.isfinite(model.covariance[k, k] if model else np.nan)
    ]
    if model is None or not identified:
        return Prior.empty(len(keys))
    names = [(model.parameters[k].name, model.parameters[k].joint) for k in identified]
    parts = {column.key: column.parts for column in arm.rigid_columns}
    rows = np.array([combination(keys, parts[name]) for name in names])
    mean = model.solution[identified]
    covariance = model.covariance[np.ix_(identified, identified)]
    factor = np.asarray(np.linalg.cholesky(covariance + np.diag((floor * np.abs(mean)) ** 2)))
    errors = np.linalg.solve(factor, np.linalg.solve(factor, covariance).T)
    whitened = np.asarray(np.linalg.solve(factor, rows))
    target = np.asarray(np.linalg.solve(factor, mean))
    return Prior(whitened, target, errors, tuple(names), factor, mean)


def restrict_space(
    space: ParameterSpace, options: WholeArmOptions, z: FloatArray
) -> ParameterSpace:
    """Hold parameters and limit the ranges of the others, as the options require.

    `z` (n_unknowns,) is the start of the fit: it fixes the held values and the centres of the
    ranges. Raises `InvalidInput` if all parameters are held.
    """
    if options.as_published:  # the published method has no prior
        space = replace(space, prior=Prior.empty(len(z)))
    values = space.values(z)
    held = {key: values[key] for key in space.keys if is_held(key, options)}
    if len(held) == len(space.unknowns):
        raise InvalidInput(
            "every parameter is held",
            where="[options] tuning.hold",
            remedy="remove at least one parameter from the list",
        )
    limited = tuple(
        limit_unknown(unknown, options, at)
        for unknown, at in zip(space.unknowns, z.tolist(), strict=True)
    )
    return replace(space, unknowns=limited).fix_values(held)


def is_held(key: Key, options: WholeArmOptions) -> bool:
    """Whether the options hold a parameter at its start."""
    return bool(set(_names(key)) & set(options.hold))


def _names(key: Key) -> list[str]:
    """Names of a parameter in the options, the most specific first."""
    name, joint = key
    base_names = dict.fromkeys((name, base_name(name)))  # for one record, then for all records
    names = [
        full_name
        for n in base_names
        for full_name in ([n] if joint is None else [f"{n} {joint}", n])
    ]
    if name != STIFFNESS and is_slope(name):  # one name covers all slopes of a gear
        names += [f"{STIFFNESS} {joint}", STIFFNESS]
    return names


def limit_unknown(unknown: Unknown, options: WholeArmOptions, at: float) -> Unknown:
    """Limit an unknown to the options' factors of its value at coordinate `at`, unless it is 0."""
    factors = next((options.ranges[n] for n in _names(unknown.key) if n in options.ranges), None)
    if factors is None and options.as_published and not constant_of(unknown.key):
        factors = PUBLISHED_RANGE
    if factors is None:
        return unknown
    if not unknown.signed:
        low, high = (at + float(np.log(factor)) for factor in factors)
        return replace(unknown, limits=(low, high))
    value = unknown.start + unknown.scale * at
    if value == 0.0:
        return unknown
    ends = sorted((factor * value - unknown.start) / unknown.scale for factor in factors)
    return replace(unknown, limits=(ends[0], ends[1]))
