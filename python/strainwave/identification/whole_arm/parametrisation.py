"""What is searched for: parameters, their coordinates, where they start, what is known of them."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from strainwave.domain import BoolArray, FloatArray, Joint, JointModel, RigidModel
from strainwave.domain.gear_laws import STIFFNESS
from strainwave.domain.kinds import Row
from strainwave.domain.parameters import Values, unit_of
from strainwave.dynamics.arm import Arm
from strainwave.identification.whole_arm.starts import COULOMB, OFFSET, VISCOUS, Key, starts_of

__all__ = [
    "COULOMB",
    "OFFSET",
    "SETTLING",
    "SETTLING_START",
    "VISCOUS",
    "Key",
    "ParameterSpace",
    "Prior",
    "Unknown",
    "combination",
    "space_of",
    "with_curves",
    "with_settling",
]

_MISLED = {COULOMB: 0.03, OFFSET: 0.03}
_VISCOUS_MISLED, _BODY_MISLED = 0.3, 0.1
"""Shares of values by which lack of an effect may mislead the rigid step; offsets' of Coulomb's."""
_LEAST_MISLED = 1e-12  # [SI] of what is nothing

SETTLING = "friction_settling_time"
SETTLING_START = 1e-4
"""[s] where the search for it starts."""

_BASE = ("alpha", "beta", "gamma")
_LEAST_COULOMB = 0.01  # of the torque of the largest voltage, where none was found
_FAR = np.log(3.0)  # how far an inertia or a slope may go
_LOWEST, _HIGHEST = -0.8, 1.5  # shares of a value by which one step may change it
_TO_NOTHING = -0.99  # the same of a settling time, which may well be nothing
_VERY_FAR = np.log(30.0)  # and a friction, damping, or what else a gear has


@dataclass(frozen=True, slots=True)
class Unknown:
    """One parameter that is searched for, and its coordinate z, which is zero at the start.

    A positive parameter is scale exp(z), counted from the one that it lies above, as a second knee
    from the first; one that may be zero or have either sign is scale z + start.
    """

    name: str
    joint: int | None
    unit: str
    start: float
    scale: float
    signed: bool
    reach: float  # how far z may go, up and down
    limits: tuple[float, float] | None = None  # of z, where they are not its reach
    above: str | None = None  # the parameter of the same joint that it exceeds
    prior_std: float | None = None  # of its value about the start, before any record; None: none

    @property
    def key(self) -> Key:
        """What it is known by."""
        return self.name, self.joint

    def __str__(self) -> str:
        return self.name if self.joint is None else f"{self.name} of joint {self.joint}"


@dataclass(frozen=True, slots=True)
class Prior:
    """What the rigid step knows: linear combinations of the unknowns, with correlated errors.

    Whitened by deviations that have a least.
    """

    rows: FloatArray  # (n_rows, n_unknowns), whitened
    target: FloatArray  # (n_rows,), whitened
    errors: FloatArray  # (n_rows, n_rows) their covariance, less than one by what that least adds
    names: tuple[Key, ...] = ()  # (n_rows,) the rigid model's parameters
    factor: FloatArray = field(default_factory=lambda: np.zeros((0, 0)))
    """(n_rows, n_rows) what a whitened row is multiplied by to have the parameters' units."""
    mean: FloatArray = field(default_factory=lambda: np.zeros(0))  # (n_rows,) in those units
    before: tuple[FloatArray, FloatArray] | None = None
    """`factor` and `errors` before it was `loosened`; None if it is not."""

    def by_shifts(self, names: Collection[Key]) -> FloatArray:
        """Derivatives of the whitened rows by errors of some of the rigid model's parameters.

        Returns: (n_rows, n_shifts): Each per deviation that lack of an effect may make.
        """
        own = [k for k, name in enumerate(self.names) if name in names]
        units = np.eye(len(self.names))[:, own] * self._misled[own]
        return np.asarray(np.linalg.solve(self.factor, units))

    def loosened(self, names: Collection[Key]) -> Prior:
        """The same, knowing less of some of the rigid model's parameters, for lack of an effect."""
        own = [k for k, name in enumerate(self.names) if name in names]
        if not own:
            return self
        off = np.zeros((len(self.names), len(own)))
        off[own, range(len(own))] = self._misled[own]
        factor = np.asarray(np.linalg.cholesky(self.factor @ self.factor.T + off @ off.T))
        turn, misled = np.linalg.solve(factor, self.factor), np.linalg.solve(factor, off)
        return replace(
            self,
            rows=turn @ self.rows,
            target=turn @ self.target,
            errors=turn @ self.errors @ turn.T + misled @ misled.T,
            factor=factor,
            before=self.before or (self.factor, self.errors),
        )

    def tightened(self) -> Prior:
        """The same as the rigid step gave it."""
        if self.before is None:
            return self
        factor, errors = self.before
        turn = np.linalg.solve(factor, self.factor)
        rows, target = turn @ self.rows, turn @ self.target
        return replace(self, rows=rows, target=target, errors=errors, factor=factor, before=None)

    @property
    def _misled(self) -> FloatArray:
        """(n_rows,) by which the rigid model's parameters may be off for lack of an effect."""
        known = dict(zip(self.names, np.abs(self.mean).tolist(), strict=True))
        off = []
        for name, joint in self.names:
            size = known.get((COULOMB, joint), 0.0) if name == OFFSET else known[name, joint]
            usual = _VISCOUS_MISLED if "viscous" in name else _BODY_MISLED
            off.append(_MISLED.get(name, usual) * size)
        return np.asarray(np.maximum(off, _LEAST_MISLED))


@dataclass(frozen=True, slots=True)
class ParameterSpace:
    """The unknowns together, and what stays as it is."""

    unknowns: tuple[Unknown, ...]
    fixed: Mapping[Key, float]
    prior: Prior

    @property
    def lower(self) -> FloatArray:
        """(n_unknowns,) the least z."""
        return np.array([u.limits[0] if u.limits else -u.reach for u in self.unknowns])

    @property
    def upper(self) -> FloatArray:
        """(n_unknowns,) the largest z."""
        return np.array([u.limits[1] if u.limits else u.reach for u in self.unknowns])

    @property
    def own_prior(self) -> tuple[FloatArray, FloatArray]:
        """What is known of unknowns one by one: (n_rows, n_unknowns) and (n_rows,), whitened."""
        own = [k for k, unknown in enumerate(self.unknowns) if unknown.prior_std is not None]
        std = np.array([self.unknowns[k].prior_std for k in own], dtype=float)
        start = np.array([self.unknowns[k].start for k in own])
        return np.eye(len(self.unknowns))[own] / std[:, None], start / std

    def beforehand(self, z: FloatArray) -> tuple[FloatArray, FloatArray]:
        """What is known beforehand, all of it, as rows of least squares at a point.

        `z` (n_unknowns,).

        Returns: `slope` (n_rows, n_unknowns); `residual` (n_rows,)
        """
        rows, target = self.own_prior
        rows = np.concatenate([self.prior.rows, rows])
        target = np.concatenate([self.prior.target, target])
        return rows @ self.slope(z), rows @ self.parameters(z) - target

    @property
    def keys(self) -> list[Key]:
        """What the unknowns are known by."""
        return [unknown.key for unknown in self.unknowns]

    def parameters(self, z: FloatArray) -> FloatArray:
        """The unknowns' values, (n_unknowns,)."""
        found: FloatArray = np.array(
            [
                u.start + u.scale * at if u.signed else u.scale * np.exp(at)
                for u, at in zip(self.unknowns, z, strict=True)
            ]
        )
        for lower, upper in self._stacked:
            found[upper] += found[lower]
        for k, unknown in enumerate(self.unknowns):
            if unknown.above is not None:
                found[k] += self.fixed.get((unknown.above, unknown.joint), 0.0)
        return found

    def slope(self, z: FloatArray) -> FloatArray:
        """Derivatives of the values with respect to the coordinates, (n_unknowns, n_unknowns)."""
        own = [
            u.scale if u.signed else u.scale * np.exp(at)
            for u, at in zip(self.unknowns, z, strict=True)
        ]
        found = np.diag(np.array(own))
        for lower, upper in self._stacked:
            found[upper] += found[lower]
        return np.asarray(found)

    def moved(self, z: FloatArray, step: FloatArray) -> FloatArray:
        """Where a step leads that is straight in the values, not in the coordinates: (n_unknowns,).

        What the data identify best are sums: of an inertia with a motor's, of a joint's two viscous
        frictions. Their valleys are straight among values and curved among logarithms.
        """
        end, positive = z + step, self._positive
        end[positive] = z[positive] + np.log1p(step[positive])
        return np.asarray(np.clip(end, self.lower, self.upper))

    def bounded(self, z: FloatArray, gradient: FloatArray) -> BoolArray:
        """Which unknowns stand at the end of their range and would go beyond: (n_unknowns,)."""
        low, high = (z <= self.lower) & (gradient > 0.0), (z >= self.upper) & (gradient < 0.0)
        return np.asarray(low | high)

    def trusted(self, z: FloatArray, step: FloatArray, share: float) -> FloatArray:
        """A step that stays in reach and changes no positive value by too much at once."""
        positive = self._positive
        down, up = self.lower - z, self.upper - z
        down[positive], up[positive] = np.expm1(down[positive]), np.expm1(up[positive])
        least = [_TO_NOTHING if u.name == SETTLING else _LOWEST for u in self.unknowns]
        down[positive] = np.maximum(down, share * np.array(least))[positive]
        up[positive] = np.minimum(up, share * _HIGHEST)[positive]
        return np.asarray(np.clip(step, np.minimum(down, 0.0), np.maximum(up, 0.0)))

    @property
    def _positive(self) -> BoolArray:
        return np.array([not unknown.signed for unknown in self.unknowns])

    def values(self, z: FloatArray) -> Values:
        """All that simulating the arm needs."""
        return {**self.fixed, **dict(zip(self.keys, self.parameters(z).tolist(), strict=True))}

    def coordinates(self, values: Values) -> FloatArray:
        """Where given values lie, within the bounds: (n_unknowns,)."""
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

    def holding(self, values: Mapping[Key, float]) -> ParameterSpace:
        """With some of the unknowns held at given values."""
        kept = [k for k, unknown in enumerate(self.unknowns) if unknown.key not in values]
        dropped = [k for k, unknown in enumerate(self.unknowns) if unknown.key in values]
        known = np.array([values[self.unknowns[k].key] for k in dropped])
        target = self.prior.target - self.prior.rows[:, dropped] @ known
        return ParameterSpace(
            tuple(self.unknowns[k] for k in kept),
            {**self.fixed, **values},
            replace(self.prior, rows=self.prior.rows[:, kept], target=target),
        )

    @property
    def _stacked(self) -> list[tuple[int, int]]:
        """Where pairs of unknowns stand of which the second lies above the first."""
        at = {key: k for k, key in enumerate(self.keys)}
        pairs = ((at.get((u.above, u.joint)), k) for k, u in enumerate(self.unknowns) if u.above)
        return [(lower, upper) for lower, upper in pairs if lower is not None]


def combination(names: Sequence[Key], parts: Row) -> FloatArray:
    """A weighted sum of the unknowns as a row: (n_unknowns,).

    `parts`: Weights; those of what is no unknown are left out.

    Returns: (n_unknowns,).
    """
    return np.array([parts.get(name, 0.0) for name in names])


def space_of(
    model: RigidModel | None,
    joints: Sequence[JointModel],
    arm: Arm,
    *,
    largest_voltage: Sequence[float],
    floor: float,
) -> ParameterSpace:
    """Unknowns with their starts from the decoupled models, and what the rigid model knows.

    A gear with a curve starts as a linear one: see `with_curves`.

    `model`: Dispensable for a single joint without gravity.
    `joints`: One per joint.
    `largest_voltage` [V]: Applied to each joint, for the scale of its friction.
    `floor`: Least deviation of what the rigid model knows, as a share of its value.

    Raises `NotIdentifiable`: A start is missing or impossible.
    """
    start = starts_of(model, joints, arm).values
    unknowns = []
    pairs = zip(arm.joints, largest_voltage, strict=True)
    for i, (joint, voltage) in enumerate(pairs, start=1):
        torque = _LEAST_COULOMB * voltage * (joint.torque_per_volt or 1.0)
        start[COULOMB, i] = max(start[COULOMB, i], torque)
    for (name, number), value in start.items():
        scale = value
        if name == OFFSET:
            scale = start[COULOMB, number]
        signed = name == OFFSET or name.startswith("gravity")
        if signed and scale == 0.0:
            scale = 1.0
        far = _FAR if "inertia" in name or name in (*_BASE, STIFFNESS) else _VERY_FAR
        unit = unit_of(name, None if number is None else arm.joints[number - 1])
        unknowns.append(Unknown(name, number, unit, value, abs(scale), signed, float(far)))
    keys = [unknown.key for unknown in unknowns]
    return ParameterSpace(tuple(unknowns), {}, _prior(model, keys, arm, floor))


def with_curves(space: ParameterSpace, arm: Arm, largest_torque: Sequence[float]) -> ParameterSpace:
    """The parameters of its law in place of the one stiffness of each gear with a curve.

    `largest_torque` [N m]: That each gear carries in the records.
    """
    unknowns: list[Unknown] = []
    columns: list[FloatArray] = []
    for k, unknown in enumerate(space.unknowns):
        joint = arm.joints[(unknown.joint or 1) - 1]
        column = space.prior.rows[:, k]
        if unknown.name != STIFFNESS or not joint.law.is_curved:
            unknowns.append(unknown)
            columns.append(column)
            continue
        curve = _curve(unknown, joint, largest_torque[(unknown.joint or 1) - 1])
        unknowns += curve
        columns += [np.zeros_like(column)] * len(curve)
    prior = replace(space.prior, rows=np.column_stack(columns))
    return ParameterSpace(tuple(unknowns), space.fixed, prior)


def _curve(stiffness: Unknown, joint: Joint, largest_torque: float) -> list[Unknown]:
    """The unknowns of a gear's law, near a linear one."""
    start = joint.law.starts(stiffness.start, largest_torque)
    found = []
    for p in joint.law.parameters:
        value, unit = start[p.name], unit_of(p.name, joint)
        far = stiffness.reach if p.is_slope else float(_VERY_FAR)
        positive = p.described.range == "positive"
        limits = (-1.0, float(np.exp(far))) if p.described.range == "non-negative" else None
        scale = value - (start[p.above] if p.above is not None else 0.0)
        found.append(
            Unknown(p.name, stiffness.joint, unit, value, scale, not positive, far, limits, p.above)
        )
    return found


def with_settling(space: ParameterSpace) -> ParameterSpace:
    """With a settling time of each joint's friction."""
    joints = [unknown.joint for unknown in space.unknowns if unknown.name == COULOMB]
    more = [
        Unknown(SETTLING, j, "s", SETTLING_START, SETTLING_START, False, _VERY_FAR) for j in joints
    ]
    rows = np.pad(space.prior.rows, ((0, 0), (0, len(more))))
    return ParameterSpace((*space.unknowns, *more), space.fixed, replace(space.prior, rows=rows))


def _prior(model: RigidModel | None, keys: Sequence[Key], arm: Arm, floor: float) -> Prior:
    """The rigid model's parameters as combinations of the unknowns, divided by their errors."""
    identified = [
        k
        for k, p in enumerate(model.parameters if model is not None else ())
        if p.value is not None and np.isfinite(model.covariance[k, k] if model else np.nan)
    ]
    if model is None or not identified:
        return Prior(np.zeros((0, len(keys))), np.zeros(0), np.zeros((0, 0)))
    names = [(model.parameters[k].name, model.parameters[k].joint) for k in identified]
    parts = {column.key: column.parts for column in arm.rigid_columns}
    rows = np.array([combination(keys, parts[name]) for name in names])
    mean = model.solution[identified]
    covariance = model.covariance[np.ix_(identified, identified)]
    factor = np.asarray(np.linalg.cholesky(covariance + np.diag((floor * np.abs(mean)) ** 2)))
    errors = np.linalg.solve(factor, np.linalg.solve(factor, covariance).T)
    white = np.asarray(np.linalg.solve(factor, rows))
    target = np.asarray(np.linalg.solve(factor, mean))
    return Prior(white, target, errors, tuple(names), factor, mean)
