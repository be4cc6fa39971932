"""Least squares with nuisance parameters, robust weights, identifiability and block jackknife."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from strainwave import _core
from strainwave.domain import BoolArray, FloatArray, IntArray
from strainwave.domain.results.distributions import STD_PER_MEDIAN
from strainwave.numerics.linalg import Banded

MAX_STD_SHARE_OF_TORQUE = 0.3
"""Largest standard deviation of an identifiable parameter, as a share of the total torque."""

PRIOR_GROUP = -1
"""Group of rows with prior knowledge, each divided by its standard deviation."""

# Smallest component of a unit vector for which a parameter belongs to a direction.
_MIN_DIRECTION_COMPONENT = 0.1


@dataclass(frozen=True, slots=True)
class Local:
    """Nuisance parameters that occur in some rows only, for example those of one record."""

    rows: IntArray  # (n,) rows in which they occur, disjoint from those of other `Local`
    columns: Banded  # (n, n_unknowns)


@dataclass(frozen=True, slots=True)
class Equations:
    """Linear equations shared @ x + common @ c + local @ z = target + error.

    The nuisance parameters c and z have zero mean and known standard deviations.
    """

    shared: FloatArray  # (n_rows, n_parameters)
    noise: FloatArray  # (n_parameters,) rms noise of each column of `shared`
    common: FloatArray  # (n_rows, n_common) regressors of the nuisance parameters c
    common_deviation: FloatArray  # (n_common,) standard deviations of c
    local: tuple[Local, ...]  # regressors of the nuisance parameters z, part by part
    local_deviation: FloatArray  # (n_local,) standard deviations of z
    target: FloatArray  # (n_rows,)
    group: IntArray  # (n_rows,) rows of a group have errors of one variance; or PRIOR_GROUP
    block: IntArray  # (n_rows,) rows of a block may have correlated errors
    # (n_rows,) rows of a block with different numbers repeat the same motion; empty: none do
    repetition: IntArray = field(default_factory=lambda: np.zeros(0, dtype=np.int64))


@dataclass(frozen=True, slots=True)
class Factor:
    """Solution of one weighted least-squares problem, and its singular value decomposition."""

    root: FloatArray  # (n_rows,) square roots of the weights
    value: FloatArray  # (n_parameters,) minimum norm in the scaled parameters if not unique
    common: FloatArray  # (n_common,)
    local: FloatArray  # (n_local,)
    scale: FloatArray  # (n_parameters,) norms of the weighted columns
    singular: FloatArray  # (n_parameters,) singular values, in descending order
    directions: FloatArray  # (n_parameters, n_parameters) rows, in scaled parameters
    is_resolved: BoolArray  # (n_parameters,) whether a direction exceeds the regressor noise
    leverage: FloatArray  # (n_rows,) diagonal of the hat matrix
    residual: FloatArray  # (n_rows,) of the equations

    @property
    def deviation(self) -> FloatArray:
        """Standard deviations of the parameters for white errors of unit variance."""
        scaled = self.directions[self.is_resolved] / self.singular[self.is_resolved, None]
        return np.asarray(np.linalg.norm(scaled, axis=0) / self.scale)

    @property
    def condition_number(self) -> float:
        """Condition number of the weighted, column-scaled regressor without nuisance parameters."""
        smallest = float(self.singular[-1])
        return float(self.singular[0]) / smallest if smallest > 0.0 else np.inf


def factorise(equations: Equations, root: FloatArray) -> Factor:
    """Solve weighted least squares with the nuisance parameters projected out, by QR and SVD.

    With the priors as additional rows, the equations are [Z; I] z + [X; 0] x = [y; 0]. Projecting
    [X; 0] and [y; 0] onto the orthogonal complement of [Z; I] leaves equations in x alone, solved
    by QR without forming X'X. The common nuisance parameters precede x in this QR decomposition.
    The SVD of the block of x in R gives the identifiable directions: their singular values exceed
    those of the regressor noise.

    `root` (n_rows,): Square roots of the weights. Raises LinAlgError where a value is not finite.
    """
    weighted = _weighted(equations, root, equations.target[:, None])
    try:
        solution = _core.solve(weighted, equations.noise)
    except ValueError as error:
        raise np.linalg.LinAlgError(str(error)) from error
    value, common, local, residual, scale, singular, directions, is_resolved, leverage = solution
    return Factor(
        root=root,
        value=value[:, 0],
        common=common[:, 0],
        local=local[:, 0],
        scale=scale,
        singular=singular,
        directions=directions,
        is_resolved=is_resolved,
        leverage=leverage,
        residual=residual[:, 0],
    )


def moves(equations: Equations, factor: Factor, changes: FloatArray) -> FloatArray:
    """Changes of the parameters for changes of the target.

    `changes` (n_rows, n_changes). Returns (n_parameters, n_changes).
    """
    return _core.solve(_weighted(equations, factor.root, changes), equations.noise)[0]


@dataclass(frozen=True, slots=True)
class ReducedRows:
    """Weighted rows after elimination of the local parameters.

    The columns are those of the common nuisance parameters, in units of their priors, of the scaled
    parameters, and of the targets. The squares of `own` and `below` add up to those of the errors,
    less what the local parameters explain with their priors.
    """

    scale: FloatArray  # (n_parameters,) norms of the weighted columns
    own: FloatArray  # (n_rows, n_columns)
    below: FloatArray  # (n_local, n_columns) regression of each column on the local regressors
    leverage: FloatArray  # (n_rows,) diagonal of the hat matrix of all unknowns
    # (n_columns, n_columns) of their QR decomposition with the priors of the common parameters
    factor: FloatArray


def rows_of(equations: Equations, root: FloatArray) -> ReducedRows:
    """Eliminate the local parameters part by part, and factorise the remaining rows."""
    return ReducedRows(*_core.reduce(_weighted(equations, root, equations.target[:, None])))


def _weighted(
    equations: Equations, root: FloatArray, targets: FloatArray
) -> _core._WeightedEquations:
    """Weighted equations for several targets (n_rows, n_targets), as the core reads them."""
    parts = [
        (part.rows, part.columns.first, part.columns.entries, part.columns.n_columns)
        for part in equations.local
    ]
    common, shared, targets = map(
        np.ascontiguousarray, (equations.common, equations.shared, targets)
    )
    stds = equations.common_deviation, equations.local_deviation
    return common, stds[0], shared, targets, root, parts, stds[1]


def rows_of_local(equations: Equations) -> IntArray:
    """A row in which each local parameter occurs, (n_local,)."""
    rows = []
    for part, _ in _parts(equations):
        first = np.searchsorted(part.columns.first, np.arange(part.columns.n_columns))
        rows.append(part.rows[np.minimum(first, len(part.rows) - 1)])
    return np.concatenate(rows) if rows else np.zeros(0, dtype=np.int64)


def _parts(equations: Equations) -> Iterator[tuple[Local, slice]]:
    """Each local part with its nuisance parameters."""
    first = 0
    for part in equations.local:
        yield part, slice(first, first := first + part.columns.n_columns)


def residual_of(equations: Equations, factor: Factor) -> FloatArray:
    """Residual (n_rows,) of the equations."""
    residual = equations.target - equations.shared @ factor.value
    residual -= equations.common @ factor.common
    for part, own in _parts(equations):
        residual[part.rows] -= part.columns @ factor.local[own]
    return np.asarray(residual)


def root_weights(equations: Equations, factor: Factor) -> FloatArray:
    """Square roots (n_rows,) of Huber's weights with a robust standard deviation for each group.

    w = min(1, HUBER_LIMIT_STDS / |r / s|) / s^2,   s = STD_PER_MEDIAN median |r / sqrt(1 - h)|

    with the leverage h and HUBER_LIMIT_STDS = 4.
    """
    residuals = factor.residual, factor.leverage, equations.target
    return _core.huber_roots(*residuals, equations.group, STD_PER_MEDIAN)


def initial_weights(target: FloatArray, group: IntArray) -> FloatArray:
    """Square roots of the initial weights: the reciprocal rms of the target in each group."""
    root = np.ones_like(target)
    for g in np.unique(group[group != PRIOR_GROUP]):
        rms = float(np.sqrt(np.mean(target[group == g] ** 2)))
        root[group == g] = 1.0 / rms if rms > 0.0 else 1.0
    return root


def jackknife(equations: Equations, factor: Factor) -> tuple[FloatArray, FloatArray]:
    """Covariance of the parameters by the delete-one-block jackknife.

        V = (m - 1)/m sum_b (x_b - x)(x_b - x)'

    x_b is the estimate without block b, and m is the number of blocks. The covariance is valid for
    any correlation of the errors within blocks, and includes model errors that vary between blocks.
    The variance from the priors of the nuisance parameters is added.

    Returns the covariance (n_parameters, n_parameters) within the identifiable directions, and the
    variances (n_common,) of the common nuisance parameters.
    """
    basis = factor.directions[factor.is_resolved].T / factor.scale[:, None]
    to_parameters = basis / factor.singular[factor.is_resolved]
    is_data = equations.group != PRIOR_GROUP
    block = np.full(len(is_data), -1, dtype=np.int64)
    labels, block[is_data] = np.unique(equations.block[is_data], return_inverse=True)
    inner = replace(equations, shared=equations.shared @ to_parameters)
    weighted = _weighted(inner, factor.root, equations.target[:, None])
    total, of_blocks, priors = _core.block_products(weighted, block, len(labels))
    m, gram = len(labels), total[:-1]
    reference = np.linalg.solve(gram[:, :-1], gram[:, -1])
    # a small ridge keeps a direction that only one block determines at a finite value
    rest = gram - of_blocks[:, :-1] + 1e-9 * np.eye(*gram.shape)
    shifts = np.linalg.solve(rest[:, :, :-1], rest[:, :, -1:])[:, :, 0] - reference
    inverse = np.linalg.inv(gram[:, :-1])
    of_priors = inverse @ priors[:-1, :-1] @ inverse
    inner_covariance = (m - 1) / m * shifts.T @ shifts + of_priors
    n = len(equations.common_deviation)
    covariance: FloatArray = to_parameters @ inner_covariance[n:, n:] @ to_parameters.T
    return covariance, np.asarray(np.diag(inner_covariance)[:n] * equations.common_deviation**2)


def determined(equations: Equations, factor: Factor, covariance: FloatArray) -> BoolArray:
    """Which parameters (n_parameters,) the data identify.

    A parameter is not identifiable if it belongs to a direction below the regressor noise, or if
    its standard deviation, multiplied by the norm of its regressor, exceeds a share of the total
    torque.

    `covariance` (n_parameters, n_parameters).
    """
    unidentifiable = np.abs(factor.directions[~factor.is_resolved])
    is_identifiable = (unidentifiable < _MIN_DIRECTION_COMPONENT).all(axis=0)
    torque = np.linalg.norm(factor.root * equations.target)
    torque_std = np.sqrt(np.clip(np.diag(covariance), 0.0, None)) * factor.scale
    return np.asarray(is_identifiable & (torque_std < MAX_STD_SHARE_OF_TORQUE * torque))


def companions(factor: Factor, unknown: int) -> list[int]:
    """Parameters that are correlated with one parameter in the weakest direction it belongs to."""
    belongs = np.abs(factor.directions[:, unknown]) > _MIN_DIRECTION_COMPONENT
    weakest = factor.directions[np.flatnonzero(belongs)[-1]]
    correlated = np.flatnonzero(np.abs(weakest) > _MIN_DIRECTION_COMPONENT).tolist()
    return [k for k in correlated if k != unknown]
