"""Least squares with nuisance parameters against plain least squares over all parameters."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from strainwave.domain import FloatArray
from strainwave.numerics import least_squares as ls
from strainwave.numerics.linalg import Banded

N_ROWS, N_LOCAL, N_COMMON = 60, 20, 2


def problem() -> tuple[ls.Equations, FloatArray]:
    """Equations with 3 parameters, 2 common and 20 local nuisance parameters, and root weights."""
    rng = np.random.default_rng(3)
    entries = np.zeros((N_ROWS, 4))
    entries[:-10] = rng.normal(size=(N_ROWS - 10, 4))
    first = np.minimum(np.arange(N_ROWS) * (N_LOCAL - 4) // (N_ROWS - 10), N_LOCAL - 4)
    local = Banded(first, entries, N_LOCAL)
    equations = ls.Equations(
        shared=rng.normal(size=(N_ROWS, 3)),
        noise=np.zeros(3),
        common=rng.normal(size=(N_ROWS, N_COMMON)),
        common_deviation=rng.uniform(0.5, 2.0, N_COMMON),
        local=(ls.Local(np.arange(N_ROWS), local),),
        local_deviation=rng.uniform(0.5, 2.0, N_LOCAL),
        target=rng.normal(size=N_ROWS),
        group=np.zeros(N_ROWS, dtype=np.intp),
        block=np.arange(N_ROWS) // 6,
    )
    return equations, rng.uniform(0.5, 2.0, N_ROWS)


def plain(equations: ls.Equations, root: FloatArray) -> FloatArray:
    """Least squares over all rows and parameters, with the priors as additional rows."""
    local = equations.local[0].columns.dense()
    columns = np.hstack([equations.shared, equations.common, local]) * root[:, None]
    std = np.concatenate([equations.common_deviation, equations.local_deviation])
    priors = np.hstack([np.zeros((len(std), 3)), np.diag(1.0 / std)])
    target = np.concatenate([equations.target * root, np.zeros(len(std))])
    return np.asarray(np.linalg.lstsq(np.vstack([columns, priors]), target)[0])


def test_all_unknowns_at_once_give_the_same() -> None:
    equations, root = problem()
    factor = ls.factorise(equations, root)
    # rounding times a condition number of about 50
    estimate = np.concatenate([factor.value, factor.common, factor.local])
    np.testing.assert_allclose(estimate, plain(equations, root), rtol=1e-10, atol=1e-12)


def test_leverage_is_how_a_fit_follows_its_target() -> None:
    equations, root = problem()
    factor = ls.factorise(equations, root)
    before = ls.residual_of(equations, factor)
    for row in (0, 17, N_ROWS - 1):
        raised = equations.target + np.eye(N_ROWS)[row]
        moved = replace(equations, target=raised)
        after = ls.residual_of(moved, ls.factorise(moved, root))
        np.testing.assert_allclose(after[row] - before[row], 1.0 - factor.leverage[row], atol=1e-12)


def test_moves_are_those_of_a_new_solve() -> None:
    equations, root = problem()
    factor = ls.factorise(equations, root)
    changes = np.random.default_rng(4).normal(size=(N_ROWS, 2))
    for move, change in zip(ls.moves(equations, factor, changes).T, changes.T, strict=True):
        moved = replace(equations, target=equations.target + change)
        expected = ls.factorise(moved, root).value - factor.value
        np.testing.assert_allclose(move, expected, rtol=1e-10, atol=1e-12)


def test_the_jackknife_leaves_out_block_by_block() -> None:
    equations, root = problem()
    factor = ls.factorise(equations, root)
    covariance, _ = ls.jackknife(equations, factor)
    solution = plain(equations, root)[:3]
    shifts = [plain(equations, root * (equations.block != b))[:3] - solution for b in range(10)]
    scatter = 0.9 * np.array(shifts).T @ np.array(shifts)
    # the jackknife adds the variance from the priors
    assert (np.linalg.eigvalsh(covariance - scatter) > -1e-6 * np.trace(scatter)).all()
    assert np.trace(covariance) < 2.0 * np.trace(scatter)


def test_the_jackknife_follows_common_nuisance_unknowns() -> None:
    equations, root = problem()
    n = 3 + N_COMMON
    _, variance = ls.jackknife(equations, ls.factorise(equations, root))
    solution = plain(equations, root)[3:n]
    shifts = [plain(equations, root * (equations.block != b))[3:n] - solution for b in range(10)]
    scatter = 0.9 * np.sum(np.square(shifts), axis=0)
    # the jackknife adds the variance from the priors, which is at most the prior variance
    assert (variance > scatter * (1.0 - 1e-6)).all()
    assert (variance < scatter + equations.common_deviation**2).all()


def test_leaving_out_rows_of_no_nuisance_unknown() -> None:
    equations, root = problem()
    part = equations.local[0]
    has_local = np.arange(N_ROWS) < N_ROWS - 10  # the last rows contain no local parameter
    separate = replace(
        equations, local=(ls.Local(part.rows[has_local], part.columns.rows(has_local)),)
    )
    covariance, expected = (
        ls.jackknife(each, ls.factorise(each, root))[0] for each in (separate, equations)
    )
    np.testing.assert_allclose(covariance, expected, rtol=1e-8)
