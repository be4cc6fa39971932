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
    _, _, _, _, R = _reduced(equations, factor.root, changes)
    basis = factor.directions[factor.seen].T
    # R'R = V s^2 V', so that R^-1 = V s^-2 V' R'
    inverse = basis / factor.singular[factor.seen] ** 2 @ basis.T @ R[:p, :p].T
    return np.asarray(inverse @ R[:p, p:] / factor.scale[:, None])


def _reduced(
    equations: Equations, root: FloatArray, targets: FloatArray
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
        found, Xy[part.rows], lent[part.rows] = _eliminated(Z, Xy[part.rows])
        taken.append(found)
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
    root = factor.root[:, None]
    normal = _Normal.of(equations, factor, (equations.shared * root) @ back)
    known = equations.group == KNOWN
    shifts = []
    whole = normal.solution(n_local)
    for label in np.unique(equations.block[~known]):
        left_out = (equations.block == label) & ~known
        shifts.append(normal.without(left_out).solution(n_local) - whole)
    lean = normal.lean(n_local, known)
    m = len(shifts)
    inner = (m - 1) / m * np.array(shifts).T @ np.array(shifts) + lean @ lean.T
    k = back.shape[1]
    covariance: FloatArray = back @ inner[:k, :k] @ back.T
    return covariance, np.diag(inner)[k:] * equations.local_deviation[:n_local] ** 2


def _taken(Z: FloatArray, A: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
    """A' Z (Z'Z + I)^-1 Z' [A, y], and that without A' Z."""
    both = np.column_stack([A, y])
    found, left, _ = _eliminated(Z, both, leverage=False)
    return A.T @ (both - left), found


@dataclass(frozen=True, slots=True)
class _Normal:
    """Normal equations of w and of the nuisance unknowns, part by part, all of unit size."""

    A: FloatArray  # (n_rows, k) columns of w
    y: FloatArray  # (n_rows,)
    rows: tuple[IntArray, ...]
    Z: tuple[FloatArray, ...]  # one a part
    gram: FloatArray  # (k, k)
    right: FloatArray  # (k,)
    taken: tuple[FloatArray, ...]  # (k, k + 1) by which a part's unknowns lower [gram, right]
    eliminated: tuple[FloatArray, ...]  # a part's unknowns per w, and their values at w = 0

    @staticmethod
    def of(equations: Equations, factor: Factor, A: FloatArray) -> _Normal:
        y = equations.target * factor.root
        rows, Z, taken, eliminated = [], [], [], []
        for part, deviation in _parts(equations):
            rows.append(part.rows)
            Z.append(part.columns * (factor.root[part.rows, None] * deviation))
            lower, found = _taken(Z[-1], A[part.rows], y[part.rows])
            taken.append(lower)
            eliminated.append(found)
        return _Normal(
            A=A,
            y=y,
            rows=tuple(rows),
            Z=tuple(Z),
            gram=A.T @ A,
            right=A.T @ y,
            taken=tuple(taken),
            eliminated=tuple(eliminated),
        )

    def without(self, left_out: BoolArray) -> _Normal:
        """The same with some rows left out; parts that have none of them stay as they are."""
        gram = self.gram - self.A[left_out].T @ self.A[left_out]
        # what only these rows tell is lost without them: the ridge keeps that at its whole-data
        # size instead of dividing by nothing
        gram[np.diag_indices_from(gram)] += 1e-9
        taken, eliminated = list(self.taken), list(self.eliminated)
        for i, rows in enumerate(self.rows):
            stay = ~left_out[rows]
            if not stay.all():
                kept = rows[stay]
                taken[i], eliminated[i] = _taken(self.Z[i][stay], self.A[kept], self.y[kept])
        return replace(
            self,
            gram=gram,
            right=self.right - self.A[left_out].T @ self.y[left_out],
            taken=tuple(taken),
            eliminated=tuple(eliminated),
        )

    def solution(self, n_local: int) -> FloatArray:
        """w, then the first nuisance unknowns."""
        k = len(self.gram)
        left, right = self.gram.copy(), self.right.copy()
        for lower in self.taken:
            left -= lower[:, :k]
            right -= lower[:, k]
        w = np.linalg.solve(left, right)
        z = [e[:, k] - e[:, :k] @ w for e in self.eliminated] if n_local else []
        return np.concatenate([w, *z])[: k + n_local]

    def lean(self, n_local: int, known: BoolArray) -> FloatArray:
        """How far the estimate follows the priors' unit errors: it leans towards them.

        Columns of the inverse: of the nuisance unknowns' priors, then of what is known beforehand.
        """
        k = len(self.gram)
        W = [e[:, :k] for e in self.eliminated]
        left = self.gram - sum((lower[:, :k] for lower in self.taken), np.zeros((k, k)))
        S = np.linalg.inv(left)
        below = np.concatenate([np.zeros((0, k)), *W])
        shared = np.hstack([-S @ below.T, S @ self.A[known].T])
        if not n_local:
            return np.asarray(shared)
        first = below[:n_local]
        own = np.zeros((n_local, len(below)))
        at = 0
        for Z in self.Z:
            n = Z.shape[1]
            wanted = np.arange(at, min(at + n, n_local)) - at
            if len(wanted):
                gram = Z.T @ Z + np.eye(n)
                own[at + wanted, at : at + n] = np.linalg.inv(gram)[wanted]
            at += n
        own += first @ S @ below.T
        return np.vstack([shared, np.hstack([own, -first @ S @ self.A[known].T])])


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
