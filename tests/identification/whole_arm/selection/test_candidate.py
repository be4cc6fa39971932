"""Held-out scores of linear models: identical to those of refits without each fold."""

from __future__ import annotations

from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from strainwave.domain import FloatArray, IntArray
from strainwave.identification.whole_arm.problem.objective import Objective
from strainwave.identification.whole_arm.problem.weighted_rows import Evaluation, Rows
from strainwave.identification.whole_arm.search import Fit
from strainwave.identification.whole_arm.selection.candidate import held_out_scores
from strainwave.numerics.statistics import model_weights

N_ROWS, N_FOLDS = 400, 10
RNG = np.random.default_rng(3)
TIME = np.linspace(-1.0, 1.0, N_ROWS)
MEASURED = 1.0 + 2.0 * TIME + 0.1 * RNG.normal(size=N_ROWS)


def fit_of(columns: FloatArray) -> Fit:
    """Least squares fit of one record with one channel, with unit weights."""
    z: FloatArray = np.asarray(np.linalg.lstsq(columns, MEASURED)[0], dtype=np.float64)
    residual = (columns @ z - MEASURED)[:, None]
    evaluated = Evaluation(residual, columns[:, None, :], np.zeros(0), ())
    rows = Rows(residual, np.ones_like(residual), evaluated, np.ones(1), np.zeros(0))
    prior = (np.zeros((0, columns.shape[1])), np.zeros(0))
    names = [(f"x{k}", None) for k in range(columns.shape[1])]
    space = SimpleNamespace(
        linearise_prior=lambda _: prior, keys=names, lower=-1e6 + 0.0 * z, upper=1e6 + 0.0 * z
    )
    objective = SimpleNamespace(
        rows=lambda _: [rows], map_rows=lambda _, work: [work(0, rows)], space=space
    )
    return Fit.at(cast(Objective, objective), z)


def test_one_step_without_a_fold_is_a_refit_without_it() -> None:
    columns = np.column_stack([np.ones(N_ROWS), TIME])
    (scores,) = held_out_scores([fit_of(columns)])
    assert len(scores) == N_FOLDS
    fold = np.arange(N_ROWS) * N_FOLDS // N_ROWS
    errors = np.empty(N_ROWS)
    for k in range(N_FOLDS):
        z = np.linalg.lstsq(columns[fold != k], MEASURED[fold != k])[0]
        errors[fold == k] = columns[fold == k] @ z - MEASURED[fold == k]
    kappa = _kappa(scores, errors, fold)
    assert np.ptp(kappa) < 1e-9 * kappa[0]  # one correlation time explains all scores
    assert kappa[0] == pytest.approx(1.0, rel=0.2)  # white noise


def _kappa(scores: FloatArray, errors: FloatArray, fold: IntArray) -> FloatArray:
    """Rows per independent error for which refits have these scores."""
    kappas = []
    for k, score in enumerate(scores):
        held, n = errors[fold == k] ** 2, np.sum(fold == k)
        variance = np.mean(errors[fold != k] ** 2)
        ratio = np.sum(held) / np.sum(errors[fold != k] ** 2)
        density = n * np.log(variance) + len(errors) * np.log1p(ratio)  # Student's t
        kappas.append(-0.5 * density / score)
    return np.array(kappas)


def test_the_true_model_predicts_best() -> None:
    """A missing slope costs much; superfluous powers of time gain nothing."""
    powers = [np.column_stack([TIME**p for p in range(n)]) for n in (1, 2, 9)]
    constant, line, polynomial = held_out_scores([fit_of(X) for X in powers])
    rng = np.random.default_rng(0)
    weights = model_weights(np.array([line, constant, polynomial]), rng)
    assert weights[0] > 0.95
    assert weights.sum() == pytest.approx(1.0)


def test_one_fold_does_not_decide() -> None:
    same = np.zeros(10)
    equal = model_weights(np.array([same, same]), np.random.default_rng(0))
    assert equal.tolist() == [0.5, 0.5]
    outlier = np.array([*np.full(9, -2.0), 30.0])
    weights = model_weights(np.array([outlier, same]), np.random.default_rng(0))
    assert weights[0] < 0.8  # the sum favours it by 12
