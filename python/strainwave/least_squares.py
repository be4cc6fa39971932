"""Least squares with nuisance unknowns: robust weights, what cannot be told, honest deviations."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from strainwave.records import BoolArray, FloatArray, IntArray

HUBER = 4.0
"""Deviations beyond which a residual counts linearly: gross errors only, for the friction of real
drives has honest tails that a tighter limit would cut off on one side of each reversal."""

KNOWN = -1
"""Group of rows that state what is known beforehand, each divided by its own deviation."""

_NOISE_MARGIN = 3.0  # a singular value must stand this far above the regressor's own noise
_SHARE_OF_TORQUE = 0.3  # uncertainty, as a share of all torque, from which nothing is known
_TELLING = 0.2  # share of its error that a row must show to tell of the errors' size
_RIDGE = 1e-9  # of one, in a block's own share of what it says
_TAKES_PART = 0.1  # component of a unit vector from which a parameter takes part in it


@dataclass(frozen=True, slots=True)
class Equations:
    """shared @ x + local @ z = target + error, with z of zero mean and known deviation."""

    shared: FloatArray  # (n_rows, n_parameters)
    noise: FloatArray  # (n_parameters,) rms of the noise in each shared column
    local: FloatArray  # (n_rows, n_local)
    local_deviation: FloatArray  # (n_local,)
    target: FloatArray  # (n_rows,)
    group: IntArray  # (n_rows,) rows of one group have errors of one size; or KNOWN
    block: IntArray  # (n_rows,) rows of one block may have errors in common
    # where `local` is not zero, as (rows, columns); no two share either. Empty: everywhere
    patches: tuple[tuple[slice, slice], ...] = ()

    @property
    def local_patches(self) -> tuple[tuple[slice, slice], ...]:
        """`patches`, or one over everything."""
        return self.patches or ((slice(None), slice(None)),)


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
    from scipy.linalg import cho_factor, cho_solve, solve_triangular

    p = equations.shared.shape[1]
    X = equations.shared * root[:, None]
    scale = np.linalg.norm(X, axis=0)
    scale[scale == 0.0] = 1.0
    Xy = np.column_stack([X / scale, equations.target * root])
    taken = np.zeros((equations.local.shape[1], p + 1))
    left = Xy.copy()
    leverage = np.zeros(len(root))
    for rows, columns in equations.local_patches:
        Z = equations.local[rows, columns] * root[rows, None] * equations.local_deviation[columns]
        gram = Z.T @ Z
        gram[np.diag_indices_from(gram)] += 1.0
        lower, _ = chol = cho_factor(gram, lower=True)
        taken[columns] = cho_solve(chol, Z.T @ Xy[rows])
        left[rows] -= Z @ taken[columns]
        inner = solve_triangular(lower, Z.T, lower=True, check_finite=False)
        leverage[rows] += np.sum(inner**2, axis=0)
    Q, R = np.linalg.qr(np.vstack([left, -taken]))
    U, s, Vt = np.linalg.svd(R[:p, :p])
    noise = np.sqrt(Vt**2 @ (equations.noise * np.linalg.norm(root) / scale) ** 2)
    seen = s > np.maximum(_NOISE_MARGIN * noise, 1e-10 * s[0])
    x = Vt[seen].T @ ((U[:, seen].T @ R[:p, -1]) / s[seen])
    leverage += np.sum(Q[: len(root), :p] ** 2, axis=1)
    return Factor(
        root=root,
        value=x / scale,
        local=(taken[:, -1] - taken[:, :p] @ x) * equations.local_deviation,
        scale=scale,
        singular=s,
        directions=Vt,
        seen=seen,
        leverage=leverage,
    )


def residual_of(equations: Equations, factor: Factor) -> FloatArray:
    """What the equations leave unexplained: (n_rows,)."""
    explained = equations.shared @ factor.value + equations.local @ factor.local
    return equations.target - explained


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
    root = factor.root[:, None]
    A = np.hstack(
        [
            (equations.shared * root) @ (basis / factor.singular[factor.seen]),
            equations.local * (root * equations.local_deviation),
        ]
    )
    y = equations.target * factor.root
    k = basis.shape[1]
    gram = A.T @ A
    gram[range(k, len(gram)), range(k, len(gram))] += 1.0
    whole = np.linalg.inv(gram)
    left = y - A @ (whole @ (A.T @ y))
    inverse = whole[: k + n_local]
    shifts = []
    known = equations.group == KNOWN
    for label in np.unique(equations.block[~known]):
        part = (equations.block == label) & ~known
        # x_b - x = -G^-1 A_b' (1 - H)^-1 r_b, H = A_b G^-1 A_b': without block b, exactly. What
        # only this block tells is lost without it: the ridge keeps that from dividing by nothing
        reach = whole @ A[part].T
        hat = A[part] @ reach
        hat[np.diag_indices_from(hat)] -= 1.0 + _RIDGE
        shifts.append(reach[: k + n_local] @ np.linalg.solve(hat, left[part]))
    # the priors' share: an estimate leans towards them, in proportion to how little the data say
    lean = np.hstack([inverse[:, k:], inverse @ A[known].T])
    m = len(shifts)
    inner = (m - 1) / m * np.array(shifts).T @ np.array(shifts) + lean @ lean.T
    back = basis / factor.singular[factor.seen]
    covariance: FloatArray = back @ inner[:k, :k] @ back.T
    return covariance, np.diag(inner)[k:] * equations.local_deviation[:n_local] ** 2


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
