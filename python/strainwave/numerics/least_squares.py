"""Least squares with nuisance parameters, robust weights, identifiability and block jackknife."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from strainwave import _core
from strainwave.domain import BoolArray, FloatArray, IntArray
from strainwave.domain.results.distributions import STD_PER_MEDIAN
from strainwave.numerics.linalg import Banded, singular_values

HUBER_LIMIT_STDS = 4.0
"""Huber limit, in standard deviations. It reduces the influence of gross errors only. A lower limit
would cut the heavy tails of friction residuals on one side of each velocity reversal."""

MAX_STD_SHARE_OF_TORQUE = 0.3
"""Largest standard deviation of an identifiable parameter, as a share of the total torque."""

PRIOR_GROUP = -1
"""Group of rows with prior knowledge, each divided by its standard deviation."""

# smallest ratio of a singular value to the noise of the regressor
_MIN_SINGULAR_VALUE_TO_NOISE = 3.0
# Smallest share of its error that remains in a residual used for the scale estimate.
_MIN_RESIDUAL_SHARE = 0.2
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

    `root` (n_rows,): Square roots of the weights.
    """
    rows, n = rows_of(equations, root, equations.target[:, None]), equations.common.shape[1]
    R, scale, stop = rows.factor, rows.scale, n + len(rows.scale)
    U, s, Vt = singular_values(R[n:stop, n:stop])
    noise = np.sqrt(Vt**2 @ (equations.noise * np.linalg.norm(root) / scale) ** 2)
    is_identifiable = s > np.maximum(_MIN_SINGULAR_VALUE_TO_NOISE * noise, 1e-10 * s[0])
    projection = U[:, is_identifiable].T @ R[n:stop, -1]
    x = Vt[is_identifiable].T @ (projection / s[is_identifiable])
    common = np.linalg.solve(R[:n, :n], R[:n, -1] - R[:n, n:-1] @ x)
    shared = np.concatenate([common, x])
    local = rows.below[:, -1] - rows.below[:, :-1] @ shared
    return Factor(
        root=root,
        value=x / scale,
        common=np.asarray(common * equations.common_deviation),
        local=np.asarray(local * equations.local_deviation),
        scale=scale,
        singular=s,
        directions=Vt,
        is_resolved=is_identifiable,
        leverage=rows.leverage,
        residual=(rows.own[:, -1] - rows.own[:, :-1] @ shared) / root,
    )


def moves(equations: Equations, factor: Factor, changes: FloatArray) -> FloatArray:
    """Changes of the parameters for changes of the target.

    `changes` (n_rows, n_changes). Returns (n_parameters, n_changes).
    """
    rows, n = rows_of(equations, factor.root, changes), equations.common.shape[1]
    R, parameters = rows.factor, slice(n, n + len(rows.scale))
    basis = factor.directions[factor.is_resolved].T
    # R'R = V s^2 V', so R^-1 = V s^-2 V' R'
    inverse = basis / factor.singular[factor.is_resolved] ** 2 @ basis.T
    right = R[parameters, parameters].T @ R[parameters, parameters.stop :]
    return np.asarray(inverse @ right / factor.scale[:, None])


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


def rows_of(equations: Equations, root: FloatArray, targets: FloatArray) -> ReducedRows:
    """Eliminate the local parameters part by part, and factorise the remaining rows."""
    common = equations.common * equations.common_deviation
    table = np.concatenate([common, equations.shared, targets], axis=1)
    return _reduced(equations, root, table, (common.shape[1], equations.shared.shape[1]))


def _reduced(
    equations: Equations, root: FloatArray, table: FloatArray, sizes: tuple[int, int]
) -> ReducedRows:
    """Eliminate the local parameters of rows with other columns, the first of given numbers."""
    parts = [
        (part.rows, part.columns.first, part.columns.entries, part.columns.n_columns)
        for part in equations.local
    ]
    return ReducedRows(*_core.reduce(table, root, *sizes, parts, equations.local_deviation))


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


def _weighted_parts(equations: Equations, root: FloatArray) -> Iterator[tuple[Local, Banded]]:
    """Each local part with its regressors for parameters of unit standard deviation."""
    for part, own in _parts(equations):
        yield part, part.columns.scaled(root[part.rows], equations.local_deviation[own])


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

    with the leverage h.
    """
    root, sizes = np.ones_like(factor.residual), np.abs(factor.residual)
    shares = np.maximum(1.0 - factor.leverage, _MIN_RESIDUAL_SHARE)
    corrected, is_informative = sizes / np.sqrt(shares), shares > _MIN_RESIDUAL_SHARE
    for g in np.unique(equations.group).tolist():
        if g == PRIOR_GROUP:
            continue
        rows = equations.group == g
        informative = corrected[rows & is_informative]
        ordered = np.sort(informative if len(informative) else corrected[rows])
        median = 0.5 * float(ordered[(len(ordered) - 1) // 2] + ordered[len(ordered) // 2])
        # for an exact model, the residuals are rounding errors: keep the weights finite
        target = equations.target[rows]
        rms = math.sqrt(target @ target / len(target))
        std = max(STD_PER_MEDIAN * median, 1e-6 * rms, 1e-300)
        limit = HUBER_LIMIT_STDS * std
        root[rows] = np.sqrt(limit / np.maximum(sizes[rows], limit)) / std
    return root


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
    gram, block_grams, priors = _normal_equations(equations, factor.root, to_parameters)
    reference = np.linalg.solve(gram[:, :-1], gram[:, -1])
    # a small ridge keeps a direction that only one block determines at a finite value
    rest = gram - block_grams + 1e-9 * np.eye(*gram.shape)
    shifts = np.linalg.solve(rest[:, :, :-1], rest[:, :, -1:])[:, :, 0] - reference
    m = len(shifts)
    inverse = np.linalg.inv(gram[:, :-1])
    of_priors = inverse @ priors @ inverse
    inner_covariance = (m - 1) / m * shifts.T @ shifts + of_priors
    k = to_parameters.shape[1]
    covariance: FloatArray = to_parameters @ inner_covariance[:k, :k] @ to_parameters.T
    return covariance, np.asarray(np.diag(inner_covariance)[k:] * equations.common_deviation**2)


def _normal_equations(
    equations: Equations, root: FloatArray, back: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Normal equations of w and the common nuisance parameters, without the local parameters.

    The parameters are x = `back @ w`. Returns the matrix (k, k + 1), whose last column is the
    right-hand side, the contributions of the blocks to it, (n_blocks, k, k + 1), and that of the
    errors of the priors, of unit variance, (k, k).
    """
    common = equations.common * equations.common_deviation
    columns = [equations.shared @ back, common, equations.target]
    table = np.column_stack(columns)
    below = _reduced(equations, root, table, (0, 0)).below
    rows, n = table * root[:, None], table.shape[1]
    gram, priors = np.zeros((n, n)), np.zeros((n, n))
    has_no_local = equations.group != PRIOR_GROUP
    labels, block = np.unique(equations.block, return_inverse=True)
    block_grams = np.zeros((len(labels), n, n))
    for part, Z in _weighted_parts(equations, root):
        if not Z.entries.size:
            continue
        part_gram, without = _without_blocks(Z, rows[part.rows], block[part.rows], len(labels))
        gram += part_gram
        block_grams += part_gram - without
        has_no_local[part.rows] = False
    for label in np.unique(block[has_no_local]).tolist():
        block_rows = rows[has_no_local & (block == label)]
        block_grams[label] += block_rows.T @ block_rows
        gram += block_rows.T @ block_rows
    n_own = n - 1 - common.shape[1]
    priors += below.T @ below
    prior_rows = np.vstack([rows[equations.group == PRIOR_GROUP], np.eye(n)[n_own:-1]])
    gram += prior_rows.T @ prior_rows
    priors += prior_rows.T @ prior_rows
    has_rows = np.zeros(len(labels), dtype=bool)
    has_rows[block[equations.group != PRIOR_GROUP]] = True
    return gram[:-1], block_grams[has_rows, :-1], priors[:-1, :-1]


def _without_blocks(
    Z: Banded, right: FloatArray, block: IntArray, n_blocks: int
) -> tuple[FloatArray, FloatArray]:
    """Matrix right' (I + Z Z')^-1 right for all rows, and without each block, (n_blocks, ...)."""
    order = np.argsort(block, kind="stable")
    stops = [0, *np.cumsum(np.bincount(block, minlength=n_blocks)).tolist()]
    Z = Z.rows(order)
    right = np.ascontiguousarray(right[order])
    full, *without = _core.residual_products_without_blocks(
        Z.first, Z.entries, Z.n_columns, right, stops
    )
    return full, np.array(without)


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
