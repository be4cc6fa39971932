"""Least squares with nuisance unknowns: robust weights, what cannot be told, honest deviations."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from strainwave import _core
from strainwave.records import BoolArray, FloatArray, IntArray

HUBER = 4.0
"""Deviations beyond which a residual counts linearly: gross errors only, for the friction of real
drives has honest tails that a tighter limit would cut off on one side of each reversal."""

KNOWN = -1
"""Group of rows that state what is known beforehand, each divided by its own deviation."""

_NOISE_MARGIN = 3.0  # a singular value must stand this far above the regressor's own noise
_SHARE_OF_TORQUE = 0.3  # uncertainty, as a share of all torque, from which nothing is known
_TELLING = 0.2  # share of its error that a row must show to tell of the errors' size
_TRACE = 1e-12  # of a unit error: what rounding leaves of one that the unknowns follow
_TAKES_PART = 0.1  # component of a unit vector from which a parameter takes part in it


@dataclass(frozen=True, slots=True)
class Local:
    """Nuisance unknowns that only some rows have: those of one record, say."""

    rows: IntArray  # (n,) in which they occur; no other `Local` has any of them
    columns: FloatArray  # (n, n_unknowns)


@dataclass(frozen=True, slots=True)
class Equations:
    """shared @ x + local @ z = target + error, with z of zero mean and known deviation."""

    shared: FloatArray  # (n_rows, n_parameters)
    noise: FloatArray  # (n_parameters,) rms of the noise in each shared column
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
    columns of [Z; I] leaves equations in x alone, solved by QR; nothing in x is squared. The SVD
    of R tells which directions the data see: those whose singular value exceeds what the
    regressor's own noise would make of it.

    Parameters
    ----------
    equations : Equations
    root : (n_rows,)
        Square roots of the weights.

    Returns
    -------
    Factor
    """
    p = equations.shared.shape[1]
    scale, below, lent, Q, R = _reduced(equations, root, equations.target[:, None])
    U, s, Vt = np.linalg.svd(R[:p, :p])
    noise = np.sqrt(Vt**2 @ (equations.noise * np.linalg.norm(root) / scale) ** 2)
    seen = s > np.maximum(_NOISE_MARGIN * noise, 1e-10 * s[0])
    x = Vt[seen].T @ ((U[:, seen].T @ R[:p, -1]) / s[seen])
    return Factor(
        root=root,
        value=x / scale,
        local=(below[:, -1] - below[:, :p] @ x) * equations.local_deviation,
        scale=scale,
        singular=s,
        directions=Vt,
        seen=seen,
        leverage=np.sum(Q[: len(root), :p] ** 2, axis=1) + lent,
    )


def moves(equations: Equations, factor: Factor, changes: FloatArray) -> FloatArray:
    """How far changes of the target move the shared unknowns.

    Parameters
    ----------
    equations : Equations
    factor : Factor
    changes : (n_rows, n_changes)

    Returns
    -------
    (n_parameters, n_changes)
    """
    p = equations.shared.shape[1]
    _, _, _, _, R = _reduced(equations, factor.root, changes, leverage=False)
    basis = factor.directions[factor.seen].T
    # R'R = V s^2 V', so that R^-1 = V s^-2 V' R'
    inverse = basis / factor.singular[factor.seen] ** 2 @ basis.T @ R[:p, :p].T
    return np.asarray(inverse @ R[:p, p:] / factor.scale[:, None])


def _reduced(
    equations: Equations, root: FloatArray, targets: FloatArray, *, leverage: bool = True
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
    """Column norms; what the nuisance unknowns take, and their leverage; QR of what is left."""
    X = equations.shared * root[:, None]
    scale = np.linalg.norm(X, axis=0)
    scale[scale == 0.0] = 1.0
    Xy = np.column_stack([X / scale, targets * root[:, None]])
    lent = np.zeros(len(root))
    taken: list[FloatArray] = [np.zeros((0, Xy.shape[1]))]
    for part, deviation in _parts(equations):
        Z = part.columns * (root[part.rows, None] * deviation)
        found, Xy[part.rows], lever = _eliminated(Z, Xy[part.rows], leverage=leverage)
        taken.append(found)
        if leverage:
            lent[part.rows] = lever
    below = np.concatenate(taken)
    Q, R = np.linalg.qr(np.vstack([Xy, -below]))
    return scale, below, lent, Q, R


def _eliminated(
    Z: FloatArray, right: FloatArray, *, leverage: bool = True
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """(Z'Z + I)^-1 Z' right, right less Z times that, and the diagonal of Z (Z'Z + I)^-1 Z'."""
    if not Z.size:
        return np.zeros((Z.shape[1], right.shape[1])), right, np.zeros(len(Z))
    return _core.eliminate(np.ascontiguousarray(Z), np.ascontiguousarray(right), leverage)


def _parts(equations: Equations) -> Iterator[tuple[Local, FloatArray]]:
    """Each part with its unknowns' deviations."""
    first = 0
    for part in equations.local:
        n = part.columns.shape[1]
        yield part, equations.local_deviation[first : first + n]
        first += n


def residual_of(equations: Equations, factor: Factor) -> FloatArray:
    """What the equations leave unexplained: (n_rows,)."""
    residual = equations.target - equations.shared @ factor.value
    first = 0
    for part in equations.local:
        n = part.columns.shape[1]
        residual[part.rows] -= part.columns @ factor.local[first : first + n]
        first += n
    return np.asarray(residual)


def root_weights(equations: Equations, factor: Factor) -> FloatArray:
    """Square roots of the next weights: Huber's, within each group's own robust deviation.

    w = min(1, HUBER / |r / s|) / s^2,  s = 1.4826 median |r / sqrt(1 - h)|, h the leverage

    Parameters
    ----------
    equations : Equations
    factor : Factor

    Returns
    -------
    (n_rows,)
    """
    residual = residual_of(equations, factor)
    free = 1.0 - factor.leverage
    root = np.ones_like(residual)
    for g in np.unique(equations.group[equations.group != KNOWN]):
        rows = equations.group == g
        telling = rows & (free > _TELLING)
        telling = telling if telling.any() else rows
        size = np.abs(residual[telling]) / np.sqrt(np.clip(free[telling], _TELLING, None))
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


def jackknife(
    equations: Equations, factor: Factor, n_local: int = 0
) -> tuple[FloatArray, FloatArray]:
    """Covariance of the shared unknowns by leaving out one block at a time.

    V = (m - 1)/m sum_b (x_b - x)(x_b - x)', x_b the estimate without block b, m blocks. It holds
    for errors of any colour within the blocks, and counts model error as far as that differs from
    block to block.

    Parameters
    ----------
    equations : Equations
    factor : Factor
    n_local : int
        How many of the first nuisance unknowns are of interest too.

    Returns
    -------
    (n_parameters, n_parameters)
        Covariance within the directions that the data see.
    (n_local,)
        Variances of the first nuisance unknowns.
    """
    basis = factor.directions[factor.seen].T / factor.scale[:, None]
    back = basis / factor.singular[factor.seen]
    known = equations.group == KNOWN
    normal = _Normal.of(equations, factor.root, back, n_local)
    whole = normal.solution()
    labels = np.unique(equations.block[~known]).tolist()
    shifts = [normal.without(label).solution() - whole for label in labels]
    lean = normal.lean(known)
    m = len(shifts)
    inner = (m - 1) / m * np.array(shifts).T @ np.array(shifts) + lean @ lean.T
    k = back.shape[1]
    covariance: FloatArray = back @ inner[:k, :k] @ back.T
    return covariance, np.diag(inner)[k:] * equations.local_deviation[:n_local] ** 2


@dataclass(frozen=True, slots=True)
class _Block:
    """Some rows of a part, which may be left out at once."""

    rows: IntArray  # (m,) of the equations
    Z: FloatArray  # (m, n_unknowns)
    remains: FloatArray  # (m, m) of unit errors in these rows, once the part's unknowns follow


@dataclass(frozen=True, slots=True)
class _Part:
    """Rows with nuisance unknowns of their own, all of unit size."""

    found: FloatArray  # (n_unknowns, k + 1) by each w, and by the target
    first: FloatArray  # (n_first, n_unknowns) of the inverse of Z'Z + I: unknowns of interest
    blocks: dict[int, _Block]  # by label

    @staticmethod
    def of(
        Z: FloatArray, rows: IntArray, labels: IntArray, found: FloatArray, n_first: int
    ) -> _Part:
        order = np.argsort(labels, kind="stable")
        Z, rows = np.ascontiguousarray(Z[order]), rows[order]
        present, counts = np.unique(labels, return_counts=True)
        stops = np.cumsum(counts).tolist()
        places = [slice(start, stop) for start, stop in zip([0, *stops], stops, strict=False)]
        remains = _core.remainders(Z, stops)
        blocks = {
            label: _Block(rows[place], Z[place], left)
            for label, place, left in zip(present.tolist(), places, remains, strict=True)
        }
        first = np.zeros((0, Z.shape[1]))
        if n_first:
            first = np.asarray(np.linalg.inv(Z.T @ Z + np.eye(Z.shape[1]))[:n_first])
        return _Part(found, first, blocks)


@dataclass(frozen=True, slots=True)
class _Normal:
    """Normal equations of w, the nuisance unknowns eliminated part by part."""

    left: FloatArray  # (n_rows, k + 1) columns of w and the target, without what the unknowns take
    gram: FloatArray  # (k, k + 1) with the right side behind
    first: FloatArray  # (n_local, k + 1) the nuisance unknowns of interest: by each w, and at none
    parts: tuple[_Part, ...]
    loose: dict[int, IntArray]  # of each label, the rows that are in no part

    @staticmethod
    def of(equations: Equations, root: FloatArray, back: FloatArray, n_local: int) -> _Normal:
        """With the shared unknowns `back @ w`."""
        both = np.column_stack([equations.shared @ back, equations.target]) * root[:, None]
        left, parts = both.copy(), []
        lone = equations.group != KNOWN
        at = 0
        for part, deviation in _parts(equations):
            rows, n = part.rows, part.columns.shape[1]
            if not n:
                continue
            Z = part.columns * (root[rows, None] * deviation)
            found, left[rows], _ = _eliminated(Z, both[rows], leverage=False)
            n_first = min(n, max(0, n_local - at))
            parts.append(_Part.of(Z, rows, equations.block[rows], found, n_first))
            lone[rows] = False
            at += n
        labels = np.unique(equations.block[lone]).tolist()
        found = np.concatenate([np.zeros((0, both.shape[1])), *(p.found for p in parts)])
        return _Normal(
            left=left,
            gram=both[:, :-1].T @ left,
            first=found[:n_local],
            parts=tuple(parts),
            loose={label: np.flatnonzero(lone & (equations.block == label)) for label in labels},
        )

    def without(self, label: int) -> _Normal:
        """The same with the rows of one block left out.

        P = (I + Z Z')^-1 weighs a part's rows once its unknowns follow. Without some of them it is
        that of the others less P_kb P_bb^-1 P_bk, so that [A y]' P [A y] lacks the share of
        P_bb^-1 in the block's rows of P [A y].
        """
        gram, first = self.gram.copy(), self.first.copy()
        at = 0
        for part in self.parts:
            n = len(part.first)
            if label in part.blocks:
                block = part.blocks[label]
                own = self.left[block.rows]
                # the ridge is far below what any row leaves that tells of w
                share = np.linalg.solve(block.remains + _TRACE * np.eye(len(own)), own)
                gram -= own[:, :-1].T @ share
                first[at : at + n] -= part.first @ (block.Z.T @ share)
            at += n
        if label in self.loose:
            own = self.left[self.loose[label]]
            gram -= own[:, :-1].T @ own
        # what only these rows tell is lost without them: the ridge keeps that at its whole-data
        # size instead of dividing by nothing
        gram[np.diag_indices(len(gram))] += 1e-9
        return replace(self, gram=gram, first=first)

    def solution(self) -> FloatArray:
        """w, then the nuisance unknowns of interest."""
        w = np.linalg.solve(self.gram[:, :-1], self.gram[:, -1])
        return np.concatenate([w, self.first[:, -1] - self.first[:, :-1] @ w])

    def lean(self, known: BoolArray) -> FloatArray:
        """How far the estimate follows the priors' unit errors: it leans towards them.

        Columns of the inverse: of the nuisance unknowns' priors, then of what is known beforehand.
        """
        k = len(self.gram)
        S = np.linalg.inv(self.gram[:, :-1])
        below = np.concatenate([np.zeros((0, k)), *(part.found[:, :-1] for part in self.parts)])
        beforehand = S @ self.left[known, :-1].T
        shared = np.hstack([-S @ below.T, beforehand])
        first = self.first[:, :-1]
        own = first @ S @ below.T
        row = column = 0
        for part in self.parts:
            n_first, n = part.first.shape
            own[row : row + n_first, column : column + n] += part.first
            row, column = row + n_first, column + n
        return np.vstack([shared, np.hstack([own, -first @ beforehand])])


def determined(equations: Equations, factor: Factor, covariance: FloatArray) -> BoolArray:
    """Which unknowns the data tell.

    Not those that take part in a direction lost in noise, nor those whose uncertainty, times how
    much they were exercised, is a good part of all the torque there was.

    Parameters
    ----------
    equations : Equations
    factor : Factor
    covariance : (n_parameters, n_parameters)

    Returns
    -------
    (n_parameters,)
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
