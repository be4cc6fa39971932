"""Least squares with local unknowns: robust weights, what cannot be told, honest deviations."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from strainwave.records import BoolArray, FloatArray

HUBER = 2.5
"""Deviations beyond which a residual counts linearly; 1 % of Gaussian ones lie there."""

_ITERATIONS = 8
_NOISE_MARGIN = 3.0  # a singular value must stand this far above the regressor's own noise
_SHARE_OF_TORQUE = 0.3  # uncertainty, as a share of all torque, from which nothing is known


@dataclass(frozen=True, slots=True)
class Equations:
    """Weighted linear equations shared @ x + local @ z = target + error, z of zero-mean prior."""

    shared: FloatArray  # (n_rows, n_parameters)
    noise: FloatArray  # (n_parameters,) rms of the noise in each shared column
    local: FloatArray  # (n_rows, n_local) columns of nuisance unknowns
    local_deviation: FloatArray  # (n_local,) of the prior
    target: FloatArray  # (n_rows,)
    group: FloatArray  # (n_rows,) rows of one group have one error deviation
    block: FloatArray  # (n_rows,) rows of one block may have errors in common


@dataclass(frozen=True, slots=True)
class Solution:
    """Estimate, covariance and what the data could not tell."""

    value: FloatArray  # (n_parameters,)
    covariance: FloatArray  # (n_parameters, n_parameters)
    determined: BoolArray  # (n_parameters,)
    blind: FloatArray  # (n_blind, n_parameters) directions the data are blind to, column-scaled
    condition_number: float
    deviation: FloatArray  # (n_groups,) of the residuals
    residual: FloatArray  # (n_rows,)
    n_blocks: int


def solve(equations: Equations) -> Solution:
    """Iteratively reweighted least squares (Huber within each group's own deviation).

    The covariance is the delete-one-block jackknife's,

        V = (m - 1)/m sum_b (x_b - x)(x_b - x)',

    with x_b the estimate without block b: it holds for errors of any colour within a block, and
    takes in model error as far as that differs from block to block.

    Parameters
    ----------
    equations : Equations

    Returns
    -------
    Solution
    """
    groups = equations.group.astype(int)
    deviation = _group_rms(equations.target, groups)
    weight = np.ones(len(groups))
    for _ in range(_ITERATIONS):
        root = np.sqrt(weight) / deviation[groups]
        factor = _Factor.of(equations, root)
        residual = equations.target - equations.shared @ factor.value - equations.local @ factor.local
        previous, deviation = deviation, _group_scale(residual, groups, deviation)
        weight = huber_weights(residual / deviation[groups])
        if np.allclose(previous, deviation, rtol=1e-3):
            break
    covariance, n_blocks = _jackknife(equations, root, factor)
    torque = np.linalg.norm(root * equations.target)
    share = np.sqrt(np.clip(np.diag(covariance), 0.0, None)) * factor.scale / torque
    determined = factor.visible & (share < _SHARE_OF_TORQUE)
    return Solution(
        value=factor.value,
        covariance=covariance,
        determined=determined,
        blind=factor.blind,
        condition_number=factor.condition_number,
        deviation=deviation,
        residual=residual,
        n_blocks=n_blocks,
    )


def huber_weights(standardised: FloatArray) -> FloatArray:
    """Weights min(1, HUBER / |r|) of Huber's loss, for residuals in their own deviations."""
    return np.asarray(HUBER / np.maximum(np.abs(standardised), HUBER))


@dataclass(frozen=True, slots=True)
class _Factor:
    """One weighted solve, and what its singular values say."""

    value: FloatArray
    local: FloatArray
    scale: FloatArray  # (n_parameters,) column norms
    basis: FloatArray  # (n_parameters, n_visible) scaled directions the data see
    blind: FloatArray
    visible: BoolArray
    condition_number: float

    @staticmethod
    def of(equations: Equations, root: FloatArray) -> _Factor:
        """Solve by QR with the local unknowns first: what is left of R is free of them."""
        shared, target = equations.shared * root[:, None], equations.target * root
        scale = np.linalg.norm(shared, axis=0)
        scale[scale == 0.0] = 1.0
        n_local = equations.local.shape[1]
        stacked = np.block(
            [
                [equations.local * root[:, None], shared / scale, target[:, None]],
                [np.diag(1.0 / equations.local_deviation), np.zeros((n_local, len(scale) + 1))],
            ]
        )
        R = np.linalg.qr(stacked, mode="r")
        p = len(scale)
        inner = R[n_local : n_local + p, n_local : n_local + p]
        right = R[n_local : n_local + p, -1]
        U, s, Vt = np.linalg.svd(inner)
        # noise of the columns along each direction, in the same scaled units as s
        noise = np.sqrt((Vt**2) @ (equations.noise * np.linalg.norm(root) / scale) ** 2)
        seen = s > np.maximum(_NOISE_MARGIN * noise, 1e-10 * max(s[0], 1e-300))
        x = Vt[seen].T @ ((U[:, seen].T @ right) / s[seen])
        local = np.zeros(n_local)
        if n_local:
            rest = R[:n_local, -1] - R[:n_local, n_local : n_local + p] @ x
            from scipy.linalg import solve_triangular

            local = solve_triangular(R[:n_local, :n_local], rest)
        blind = Vt[~seen]
        visible = (np.abs(blind) < 0.1).all(axis=0)
        condition = float(s[0] / s[-1]) if s[-1] > 0.0 else np.inf
        return _Factor(x / scale, local, scale, Vt[seen].T, blind, visible, condition)


def _jackknife(
    equations: Equations, root: FloatArray, factor: _Factor
) -> tuple[FloatArray, int]:
    """Covariance of the shared unknowns by leaving out one block at a time."""
    A = np.hstack([equations.shared * root[:, None] @ np.diag(1 / factor.scale) @ factor.basis,
                   equations.local * root[:, None]])
    y = equations.target * root
    k = factor.basis.shape[1]
    prior = np.r_[np.zeros(k), 1.0 / equations.local_deviation**2]
    gram, right = A.T @ A + np.diag(prior), A.T @ y
    labels = np.unique(equations.block)
    whole = np.linalg.solve(gram, right)[:k]
    shifts = []
    for label in labels:
        part = equations.block == label
        g, b = gram - A[part].T @ A[part], right - A[part].T @ y[part]
        shifts.append(np.linalg.lstsq(g, b, rcond=1e-12)[0][:k] - whole)
    spread = np.array(shifts) @ factor.basis.T / factor.scale
    m = len(labels)
    return (m - 1) / m * spread.T @ spread, m


def _group_rms(values: FloatArray, groups: np.ndarray[tuple[int], np.dtype[np.int_]]) -> FloatArray:
    count = np.bincount(groups)
    rms = np.sqrt(np.bincount(groups, values**2) / np.maximum(count, 1))
    return np.where(rms > 0.0, rms, 1.0)


def _group_scale(
    residual: FloatArray,
    groups: np.ndarray[tuple[int], np.dtype[np.int_]],
    previous: FloatArray,
) -> FloatArray:
    """Robust deviation of each group, never quite zero."""
    found = np.array(
        [1.4826 * np.median(np.abs(residual[groups == g])) for g in range(len(previous))]
    )
    return np.maximum(found, 1e-9 * previous)
