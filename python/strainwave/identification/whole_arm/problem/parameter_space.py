"""Unknowns of the whole-arm fit: coordinates, starting values, ranges and prior."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from strainwave.domain import BoolArray, FloatArray, Joint, JointModel, RigidModel
from strainwave.domain.gear_laws import STIFFNESS
from strainwave.domain.keys import Key, Row, Values
from strainwave.domain.parameters import unit_of
from strainwave.dynamics.arm import Arm
from strainwave.identification.whole_arm.problem.starting_values import (
    COULOMB,
    OFFSET,
    VISCOUS,
    starts_of,
)

__all__ = [
    "COULOMB",
    "OFFSET",
    "SETTLING",
    "SETTLING_START",
    "VISCOUS",
    "ParameterSpace",
    "Prior",
    "Unknown",
    "add_settling_unknowns",
    "add_stiffness_curves",
    "combination",
    "space_of",
]

# relative errors of rigid-step estimates if the model lacks an effect, by parameter; that of the
# friction offset is relative to the Coulomb friction
_BIAS_SHARES = {COULOMB: 0.03, OFFSET: 0.03}
# the same of viscous friction, and of inertias and gravity torques
_VISCOUS_BIAS_SHARE, _BODY_BIAS_SHARE = 0.3, 0.1
_MIN_BIAS = 1e-12  # [SI] minimum error, for estimates of zero

SETTLING = "friction_settling_time"
SETTLING_START = 1e-4
"""Starting value [s] of a friction settling time."""

_BASE_PARAMETERS = ("alpha", "beta", "gamma")  # base parameters with the range of an inertia
# minimum starting Coulomb friction, as a share of the largest motor torque
_MIN_COULOMB_SHARE = 0.01
_INERTIA_LOG_RANGE = np.log(3.0)  # range of the logarithm of an inertia or a stiffness
# limits of the relative change of a positive value in one step
_MIN_RELATIVE_CHANGE, _MAX_RELATIVE_CHANGE = -0.8, 1.5
# lower limit of the relative change of a settling time, which may be zero
_MIN_SETTLING_CHANGE = -0.99
# range of the logarithm of friction, damping and other gear parameters
_FRICTION_LOG_RANGE = np.log(30.0)


@dataclass(frozen=True, slots=True)
class Unknown:
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

    @property
    def key(self) -> Key:
        """Name and joint."""
        return self.name, self.joint

    def __str__(self) -> str:
        return self.name if self.joint is None else f"{self.name} of joint {self.joint}"


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
    """`factor` and `errors` before `loosened`; None if that was not applied."""

    def by_shifts(self, names: Collection[Key]) -> FloatArray:
        """Derivatives (n_rows, n_shifts) of the whitened rows with respect to rigid-step errors.

        Each error is scaled by its typical size if the model lacks an effect.
        """
        places = [k for k, name in enumerate(self.names) if name in names]
        units = np.eye(len(self.names))[:, places] * self._typical_biases[places]
        return np.asarray(np.linalg.solve(self.factor, units))

    def relax(self, names: Collection[Key]) -> Prior:
        """Increase the variance of rigid-model parameters that a missing effect biases."""
        places = [k for k, name in enumerate(self.names) if name in names]
        if not places:
            return self
        added_errors = np.zeros((len(self.names), len(places)))
        added_errors[places, range(len(places))] = self._typical_biases[places]
        factor = np.asarray(
            np.linalg.cholesky(self.factor @ self.factor.T + added_errors @ added_errors.T)
        )
        transform, whitened_errors = (
            np.linalg.solve(factor, self.factor),
            np.linalg.solve(factor, added_errors),
        )
        return replace(
            self,
            rows=transform @ self.rows,
            target=transform @ self.target,
            errors=transform @ self.errors @ transform.T + whitened_errors @ whitened_errors.T,
            factor=factor,
            before=self.before or (self.factor, self.errors),
        )

    def restore(self) -> Prior:
        """Restore the prior before `loosened`."""
        if self.before is None:
            return self
        factor, errors = self.before
        transform = np.linalg.solve(factor, self.factor)
        rows, target = transform @ self.rows, transform @ self.target
        return replace(self, rows=rows, target=target, errors=errors, factor=factor, before=None)

    @property
    def _typical_biases(self) -> FloatArray:
        """Typical errors (n_rows,) of the rigid-model parameters if the model lacks an effect."""
        estimates = dict(zip(self.names, np.abs(self.mean).tolist(), strict=True))
        errors = []
        for name, joint in self.names:
            size = (
                estimates.get((COULOMB, joint), 0.0) if name == OFFSET else estimates[name, joint]
            )
            relative_error = _VISCOUS_BIAS_SHARE if "viscous" in name else _BODY_BIAS_SHARE
            errors.append(_BIAS_SHARES.get(name, relative_error) * size)
        return np.asarray(np.maximum(errors, _MIN_BIAS))


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

    def fix_values(self, values: Mapping[Key, float]) -> ParameterSpace:
        """Fix some of the unknowns at given values."""
        kept = [k for k, unknown in enumerate(self.unknowns) if unknown.key not in values]
        dropped = [k for k, unknown in enumerate(self.unknowns) if unknown.key in values]
        held_values = np.array([values[self.unknowns[k].key] for k in dropped])
        target = self.prior.target - self.prior.rows[:, dropped] @ held_values
        return ParameterSpace(
            tuple(self.unknowns[k] for k in kept),
            {**self.fixed, **values},
            replace(self.prior, rows=self.prior.rows[:, kept], target=target),
        )

    @property
    def _bound_pairs(self) -> list[tuple[int, int]]:
        """Index pairs (lower, upper) of unknowns of which the first bounds the second."""
        at = {key: k for k, key in enumerate(self.keys)}
        pairs = ((at.get((u.above, u.joint)), k) for k, u in enumerate(self.unknowns) if u.above)
        return [(lower, upper) for lower, upper in pairs if lower is not None]


def combination(names: Sequence[Key], parts: Row) -> FloatArray:
    """Weights (n_unknowns,) of a linear combination; parts that are not unknowns are ignored."""
    return np.array([parts.get(name, 0.0) for name in names])


def space_of(
    model: RigidModel | None,
    joints: Sequence[JointModel],
    arm: Arm,
    *,
    largest_voltage: Sequence[float],
    floor: float,
) -> ParameterSpace:
    """Unknowns with starting values from the decoupled step, and the prior of the rigid step.

    All gears are linear; `add_stiffness_curves` adds stiffness curves. `joints` has one model per
    joint;
    `model` may be None for a single joint without gravity. `largest_voltage` [V] of each joint sets
    the minimum Coulomb friction. `floor` is the minimum relative standard deviation of the prior.
    Raises `NotIdentifiable` if a starting value is missing.
    """
    start = starts_of(model, joints, arm).values
    unknowns = []
    pairs = zip(arm.joints, largest_voltage, strict=True)
    for i, (joint, voltage) in enumerate(pairs, start=1):
        torque = _MIN_COULOMB_SHARE * voltage * (joint.torque_per_volt or 1.0)
        start[COULOMB, i] = max(start[COULOMB, i], torque)
    for (name, number), value in start.items():
        scale = value
        if name == OFFSET:
            scale = start[COULOMB, number]
        signed = name == OFFSET or name.startswith("gravity")
        if signed and scale == 0.0:
            scale = 1.0
        reach = (
            _INERTIA_LOG_RANGE
            if "inertia" in name or name in (*_BASE_PARAMETERS, STIFFNESS)
            else _FRICTION_LOG_RANGE
        )
        unit = unit_of(name, None if number is None else arm.joints[number - 1])
        unknowns.append(Unknown(name, number, unit, value, abs(scale), signed, float(reach)))
    keys = [unknown.key for unknown in unknowns]
    return ParameterSpace(tuple(unknowns), {}, _prior(model, keys, arm, floor))


def add_stiffness_curves(
    space: ParameterSpace, arm: Arm, largest_torque: Sequence[float]
) -> ParameterSpace:
    """Replace the linear stiffness of each gear with a curve by the parameters of its law.

    `largest_torque` [N m] is that of each gear in the records.
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
    """Unknowns of a gear law, starting near the linear law."""
    start = joint.law.starts(stiffness.start, largest_torque)
    unknowns = []
    for p in joint.law.parameters:
        value, unit = start[p.name], unit_of(p.name, joint)
        reach = stiffness.reach if p.is_slope else float(_FRICTION_LOG_RANGE)
        positive = p.described.range == "positive"
        limits = (-1.0, float(np.exp(reach))) if p.described.range == "non-negative" else None
        scale = value - (start[p.above] if p.above is not None else 0.0)
        unknowns.append(
            Unknown(
                p.name, stiffness.joint, unit, value, scale, not positive, reach, limits, p.above
            )
        )
    return unknowns


def add_settling_unknowns(space: ParameterSpace) -> ParameterSpace:
    """Add the friction settling time of each joint."""
    joints = [unknown.joint for unknown in space.unknowns if unknown.name == COULOMB]
    settling_times = [
        Unknown(SETTLING, j, "s", SETTLING_START, SETTLING_START, False, _FRICTION_LOG_RANGE)
        for j in joints
    ]
    rows = np.pad(space.prior.rows, ((0, 0), (0, len(settling_times))))
    return ParameterSpace(
        (*space.unknowns, *settling_times), space.fixed, replace(space.prior, rows=rows)
    )


def _prior(model: RigidModel | None, keys: Sequence[Key], arm: Arm, floor: float) -> Prior:
    """Rigid-step estimates as whitened linear combinations of the unknowns."""
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
    whitened = np.asarray(np.linalg.solve(factor, rows))
    target = np.asarray(np.linalg.solve(factor, mean))
    return Prior(whitened, target, errors, tuple(names), factor, mean)
