"""Least squares with nuisance unknowns: robust weights, identifiability, honest deviations."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from strainwave import _core
from strainwave.domain import BoolArray, FloatArray, IntArray
from strainwave.numerics.banded import Banded

HUBER = 4.0
"""Deviations beyond which a residual counts linearly: gross errors only, for the friction of real
drives has honest tails that a tighter limit would cut off on one side of each reversal."""

KNOWN = -1
"""Group of rows that state what is known beforehand, each divided by its own deviation."""

_NOISE_MARGIN = 3.0  # a singular value must stand this far above the regressor's own noise
_SHARE_OF_TORQUE = 0.3  # uncertainty, as a share of all torque, from which nothing is known
_INFORMATIVE = 0.2  # share of its error that a row must show to speak of the errors' size
_TAKES_PART = 0.1  # component of a unit vector from which a parameter takes part in it


@dataclass(frozen=True, slots=True)
class Local:
    """Nuisance unknowns that only some rows have: those of one record, say."""

    rows: IntArray  # (n,) in which they occur; no other `Local` has any of them
    columns: Banded  # (n, n_unknowns)


@dataclass(frozen=True, slots=True)
class Equations:
    """shared @ x + common @ c + local @ z = target + error.

    The nuisance unknowns c and z have zero mean and known deviations.
    """

    shared: FloatArray  # (n_rows, n_parameters)
    noise: FloatArray  # (n_parameters,) rms of the noise in each shared column
    common: FloatArray  # (n_rows, n_common) of nuisance unknowns that all rows may have
    common_deviation: FloatArray  # (n_common,)
    local: tuple[Local, ...]  # z, part by part
    local_deviation: FloatArray  # (n_local,)
    target: FloatArray  # (n_rows,)
    group: IntArray  # (n_rows,) rows of one group have errors of one size; or KNOWN
    block: IntArray  # (n_rows,) rows of one block may have errors in common


@dataclass(frozen=True, slots=True)
class Factor:
    """One weighted solve, and what its singular values say."""

    root: FloatArray  # (n_rows,) square roots of the weights
    value: FloatArray  # (n_parameters,) of least norm in the scaled unknowns where not unique
    common: FloatArray  # (n_common,)
    local: FloatArray  # (n_local,)
    scale: FloatArray  # (n_parameters,) norms of the weighted columns
    singular: FloatArray  # (n_parameters,)
    directions: FloatArray  # (n_parameters, n_parameters) rows, in scaled unknowns
    seen: BoolArray  # (n_parameters,) which directions stand out of the noise
    leverage: FloatArray  # (n_rows,) share of each row's error that the fit takes up

    @property
    def deviation(self) -> FloatArray:
        """Of each unknown if the errors were white: a yardstick for convergence."""
        spread = self.directions[self.seen] / self.singular[self.seen, None]
        return np.asarray(np.sqrt(np.sum(spread**2, axis=0)) / self.scale)

    @property
    def condition_number(self) -> float:
        """Of the weighted, column-scaled regressor, nuisance unknowns taken out."""
        smallest = float(self.singular[-1])
        return float(self.singular[0]) / smallest if smallest > 0.0 else np.inf


def factorise(equations: Equations, root: FloatArray) -> Factor:
    """Weighted least squares, the nuisance unknowns projected out, by QR and SVD.

    With the prior's rows below, [Z; I] z + [X; 0] x = [y; 0]. Projecting [X; 0] and [y; 0] off the
    columns of [Z; I] leaves equations in x alone, solved by QR; nothing in x is squared. The
    common nuisance unknowns come before x in that QR, each with its prior's row. The SVD of x's
    part of R shows which directions the data see: those whose singular value exceeds what the
    regressor's own noise would make of it.

    `root` (n_rows,): Square roots of the weights.
    """
    reduced = _reduced(equations, root, equations.target[:, None])
    scale, own, right = reduced.scale, reduced.own, reduced.right[:, 0]
    U, s, Vt = np.linalg.svd(own)
    noise = np.sqrt(Vt**2 @ (equations.noise * np.linalg.norm(root) / scale) ** 2)
    seen = s > np.maximum(_NOISE_MARGIN * noise, 1e-10 * s[0])
    x = Vt[seen].T @ ((U[:, seen].T @ right) / s[seen])
    common, local = reduced.nuisance(x)
    return Factor(
        root=root,
        value=x / scale,
        common=common * equations.common_deviation,
        local=local * equations.local_deviation,
        scale=scale,
        singular=s,
        directions=Vt,
        seen=seen,
        leverage=reduced.leverage,
    )


def moves(equations: Equations, factor: Factor, changes: FloatArray) -> FloatArray:
    """How far changes of the target move the shared unknowns.

    `changes` (n_rows, n_changes).

    Returns: (n_parameters, n_changes).
    """
    reduced = _reduced(equations, factor.root, changes, leverage=False)
    basis = factor.directions[factor.seen].T
    # R'R = V s^2 V', so that R^-1 = V s^-2 V' R'
    inverse = basis / factor.singular[factor.seen] ** 2 @ basis.T @ reduced.own.T
    return np.asarray(inverse @ reduced.right / factor.scale[:, None])


@dataclass(frozen=True, slots=True)
class _Reduced:
    """Equations without their local unknowns, and the triangle that QR makes of them.

    Its columns are those of the common nuisance unknowns, the parameters and the targets.
    """

    scale: FloatArray  # (n_parameters,) norms of the weighted columns
    n_common: int
    triangle: FloatArray
    below: FloatArray  # (n_local, n_columns) what each local unknown takes of a column
    leverage: FloatArray  # (n_rows,)

    @property
    def own(self) -> FloatArray:
        """The parameters' part of the triangle."""
        n, stop = self.n_common, self.n_common + len(self.scale)
        return self.triangle[n:stop, n:stop]

    @property
    def right(self) -> FloatArray:
        """The targets beside it."""
        n, stop = self.n_common, self.n_common + len(self.scale)
        return self.triangle[n:stop, stop:]

    def nuisance(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Common and local unknowns that belong to scaled parameters and the one target."""
        n = self.n_common
        above = self.triangle[:n, -1] - self.triangle[:n, n:-1] @ x
        common = np.asarray(np.linalg.solve(self.triangle[:n, :n], above))
        local = self.below[:, -1] - self.below[:, :-1] @ np.concatenate([common, x])
        return common, np.asarray(local)


def _reduced(
    equations: Equations, root: FloatArray, targets: FloatArray, *, leverage: bool = True
) -> _Reduced:
    """The local unknowns eliminated part by part, then a QR of what is left."""
    X = equations.shared * root[:, None]
    scale = np.linalg.norm(X, axis=0)
    scale[scale == 0.0] = 1.0
    common = equations.common * root[:, None] * equations.common_deviation
    columns = np.column_stack([common, X / scale, targets * root[:, None]])
    n_common, n_shown = common.shape[1], common.shape[1] + len(scale)
    lent = np.zeros(len(root))
    taken: list[FloatArray] = [np.zeros((0, columns.shape[1]))]
    for part, Z in _weighted_parts(equations, root):
        found, columns[part.rows], lever = _eliminated(Z, columns[part.rows], leverage=leverage)
        taken.append(found)
        if leverage:
            lent[part.rows] = lever
    below = np.concatenate(taken)
    priors = np.eye(n_common, columns.shape[1])
    Q, R = np.linalg.qr(np.vstack([columns, -below, priors]))
    return _Reduced(
        scale=scale,
        n_common=n_common,
        triangle=R,
        below=below,
        leverage=np.sum(Q[: len(root), :n_shown] ** 2, axis=1) + lent,
    )


def _eliminated(
    Z: Banded, right: FloatArray, *, leverage: bool = True
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """(Z'Z + I)^-1 Z' right, right less Z times that, and the diagonal of Z (Z'Z + I)^-1 Z'."""
    if not Z.entries.size:
        return np.zeros((Z.n_columns, right.shape[1])), right, np.zeros(len(right))
    right = np.ascontiguousarray(right)
    return _core.eliminate(Z.first, Z.entries, Z.n_columns, right, leverage)


def _weighted_parts(equations: Equations, root: FloatArray) -> Iterator[tuple[Local, Banded]]:
    """Each part, and its columns per unknown of unit deviation."""
    first = 0
    for part in equations.local:
        n = part.columns.n_columns
        deviation = equations.local_deviation[first : first + n]
        yield part, part.columns.scaled(root[part.rows], deviation)
        first += n


def residual_of(equations: Equations, factor: Factor) -> FloatArray:
    """What the equations leave unexplained: (n_rows,)."""
    residual = equations.target - equations.shared @ factor.value
    residual -= equations.common @ factor.common
    first = 0
    for part in equations.local:
        n = part.columns.n_columns
        residual[part.rows] -= part.columns @ factor.local[first : first + n]
        first += n
    return np.asarray(residual)


def root_weights(equations: Equations, factor: Factor) -> FloatArray:
    """Square roots of the next weights: Huber's, within each group's own robust deviation.

    w = min(1, HUBER / |r / s|) / s^2,  s = 1.4826 median |r / sqrt(1 - h)|, h the leverage

    Returns: (n_rows,).
    """
    residual = residual_of(equations, factor)
    free = 1.0 - factor.leverage
    root = np.ones_like(residual)
    for g in np.unique(equations.group[equations.group != KNOWN]):
        rows = equations.group == g
        telling = rows & (free > _INFORMATIVE)
        telling = telling if telling.any() else rows
        size = np.abs(residual[telling]) / np.sqrt(np.clip(free[telling], _INFORMATIVE, None))
        # where the model is exact the bulk is rounding: keep the weights finite
        rms = float(np.sqrt(np.mean(equations.target[rows] ** 2)))
        deviation = max(1.4826 * float(np.median(size)), 1e-6 * rms, 1e-300)
        standard = np.abs(residual[rows]) / deviation
        root[rows] = np.sqrt(HUBER / np.maximum(standard, HUBER)) / deviation
    return root


def first_weights(target: FloatArray, group: IntArray) -> FloatArray:
    """Square roots of the weights before any residual is known: one over each group's rms."""
    root = np.ones_like(target)
    for g in np.unique(group[group != KNOWN]):
        rms = float(np.sqrt(np.mean(target[group == g] ** 2)))
        root[group == g] = 1.0 / rms if rms > 0.0 else 1.0
    return root


def jackknife(equations: Equations, factor: Factor) -> tuple[FloatArray, FloatArray]:
    """Covariance of the shared unknowns by leaving out one block at a time.

    V = (m - 1)/m sum_b (x_b - x)(x_b - x)', x_b the estimate without block b, m blocks. It holds
    for errors of any colour within the blocks, and counts model error as far as that differs from
    block to block. What the estimate leans towards the nuisance unknowns' priors comes on top.

    Returns: (n_parameters, n_parameters): Covariance within the directions that the data see.
    (n_common,): Variances of the common nuisance unknowns.
    """
    basis = factor.directions[factor.seen].T / factor.scale[:, None]
    back = basis / factor.singular[factor.seen]
    normal = _Normal.of(equations, factor.root, back)
    whole = normal.solution()
    shifts = [normal.without(label) - whole for label in normal.lost]
    m = len(shifts)
    inner = (m - 1) / m * np.array(shifts).T @ np.array(shifts) + normal.lean()
    k = back.shape[1]
    covariance: FloatArray = back @ inner[:k, :k] @ back.T
    return covariance, np.asarray(np.diag(inner)[k:] * equations.common_deviation**2)


@dataclass(frozen=True, slots=True)
class _Normal:
    """Normal equations of w and the common nuisance unknowns, the local ones eliminated."""

    gram: FloatArray  # (k, k + 1) with the right side behind
    lost: dict[int, FloatArray]  # of each label, what the gram lacks without its rows
    priors: FloatArray  # (k, k) sum of squares of what the priors' unit errors come with

    @staticmethod
    def of(equations: Equations, root: FloatArray, back: FloatArray) -> _Normal:
        """With the shared unknowns `back @ w`."""
        common = equations.common * equations.common_deviation
        columns = [equations.shared @ back, common, equations.target]
        both = np.column_stack(columns) * root[:, None]
        n = both.shape[1]
        gram, priors = np.zeros((n, n)), np.zeros((n, n))
        lone = equations.group != KNOWN
        lost: dict[int, FloatArray] = {}
        for part, Z in _weighted_parts(equations, root):
            if not Z.entries.size:
                continue
            found, _, _ = _eliminated(Z, both[part.rows], leverage=False)
            whole, without = _without_blocks(Z, both[part.rows], equations.block[part.rows])
            gram += whole
            priors += found.T @ found
            for label, left in without.items():
                lost[label] = lost.get(label, 0.0) + whole - left
            lone[part.rows] = False
        for label in np.unique(equations.block[lone]).tolist():
            own = both[lone & (equations.block == label)]
            lost[label] = lost.get(label, 0.0) + own.T @ own
            gram += own.T @ own
        at = n - 1 - common.shape[1]
        known = np.vstack([both[equations.group == KNOWN], np.eye(n)[at:-1]])
        gram += known.T @ known
        priors += known.T @ known
        return _Normal(gram[:-1], lost, priors[:-1, :-1])

    def solution(self) -> FloatArray:
        """w, then the common nuisance unknowns."""
        return np.asarray(np.linalg.solve(self.gram[:, :-1], self.gram[:, -1]))

    def without(self, label: int) -> FloatArray:
        """The solution with the rows of one block left out.

        What only these rows identify is lost without them: a ridge keeps that at its whole-data
        size instead of dividing by nothing.
        """
        gram = self.gram - self.lost[label][:-1]
        gram[np.diag_indices(len(gram))] += 1e-9
        return np.asarray(np.linalg.solve(gram[:, :-1], gram[:, -1]))

    def lean(self) -> FloatArray:
        """Covariance from what is known beforehand, whose unit errors the estimate follows."""
        S = np.linalg.inv(self.gram[:, :-1])
        return np.asarray(S @ self.priors @ S)


def _without_blocks(
    Z: Banded, right: FloatArray, block: IntArray
) -> tuple[FloatArray, dict[int, FloatArray]]:
    """Right' (I + Z Z')^-1 right of all rows, and without those of each label."""
    order = np.argsort(block, kind="stable")
    present, counts = np.unique(block, return_counts=True)
    stops = [0, *np.cumsum(counts).tolist()]
    Z = Z.rows(order)
    right = np.ascontiguousarray(right[order])
    whole, *without = _core.leave_out(Z.first, Z.entries, Z.n_columns, right, stops)
    return whole, dict(zip(present.tolist(), without, strict=True))


def determined(equations: Equations, factor: Factor, covariance: FloatArray) -> BoolArray:
    """Which unknowns the data identify.

    Not those that take part in a direction lost in noise, nor those whose uncertainty, times how
    much they were exercised, is a good part of all the torque there was.

    `covariance` (n_parameters, n_parameters).

    Returns: (n_parameters,).
    """
    blind = np.abs(factor.directions[~factor.seen])
    visible = (blind < _TAKES_PART).all(axis=0)
    torque = np.linalg.norm(factor.root * equations.target)
    uncertain = np.sqrt(np.clip(np.diag(covariance), 0.0, None)) * factor.scale
    return np.asarray(visible & (uncertain < _SHARE_OF_TORQUE * torque))


def companions(factor: Factor, unknown: int) -> list[int]:
    """Unknowns with which one is confounded, from the weakest direction it takes part in."""
    part = np.abs(factor.directions[:, unknown]) > _TAKES_PART
    weakest = factor.directions[np.flatnonzero(part)[-1]]
    return [int(k) for k in np.flatnonzero(np.abs(weakest) > _TAKES_PART) if k != unknown]
