"""Prior of the whole-arm fit: the estimates of the rigid step, with correlated errors."""

from __future__ import annotations

from collections.abc import Collection, Hashable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from strainwave.domain import FloatArray, RigidModel
from strainwave.domain.keys import Key, Row, Values
from strainwave.domain.parameter_table import (
    COULOMB,
    OFFSET,
    Family,
    base_name,
    family_of,
    parameter_table,
)
from strainwave.dynamics.arm import Arm

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
