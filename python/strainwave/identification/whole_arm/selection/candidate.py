"""Candidate models: test a further unknown, add it, fit, keep or drop it.

Scores of held-out folds compare models of different numbers of unknowns; see `numerics.held_out`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace

import numpy as np

from strainwave.domain import FloatArray, IntArray, LawChoice, WholeArmOptions
from strainwave.dynamics.arm import Arm
from strainwave.errors import NotIdentifiable
from strainwave.identification.whole_arm.problem.objective import BLOCKS_PER_RECORD
from strainwave.identification.whole_arm.problem.weighted_rows import Rows
from strainwave.identification.whole_arm.search import (
    COARSE_RELATIVE_TOLERANCE,
    Fit,
    search_minimum,
)
from strainwave.numerics.held_out import (
    MIN_CORRELATION_TIMES,
    MIN_WEIGHT,
    log_density,
    weight_over,
)
from strainwave.numerics.linalg import triangular_factor
from strainwave.numerics.spectra import estimate_rows_per_error

MIN_SIGNIFICANCE_STDS = 3.0
"""Standard deviations from which a settling time, an effect or another curve is significant.

The minimum cost reduction is its square.
"""
MAX_CANDIDATE_EVALUATIONS = 10
"""Maximum evaluations of the trial fit of a candidate."""

_MIN_FOLDS = 2  # of a record; the other folds estimate the variance of a channel


@dataclass
class Selection:
    """Arm, options and evaluation budget of a model selection, and its choices of gear laws."""

    arm: Arm
    options: WholeArmOptions  # `max_iterations` grows when a candidate is granted evaluations
    budget: int = field(init=False)  # evaluations that the user allows for one fit
    # of the joints whose gear law the fit selects; `arm` has the laws
    law_choices: dict[int, LawChoice] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.budget = self.options.max_iterations

    def is_budget_exhausted(self, fit: Fit) -> bool:
        """Whether no evaluations are left after those of `fit`."""
        return fit.iterations >= self.options.max_iterations

    def allow(self, evaluations: int) -> None:
        """Raise the maximum total number of evaluations, if it is lower."""
        max_iterations = max(self.options.max_iterations, evaluations)
        self.options = replace(self.options, max_iterations=max_iterations)

    def renew(self, fit: Fit) -> None:
        """Allow the full budget again, counted from the evaluations of `fit`."""
        self.allow(fit.iterations + self.budget)


@dataclass(frozen=True, slots=True)
class Candidate:
    """A change of the model: further unknowns, fewer ones, or other starting values.

    `change` tests a fit, by statistics or by short searches. It returns the start of a search with
    the changed model, or None if the data do not support a change.
    """

    change: Callable[[Fit, Selection], Fit | None]
    search: Callable[[Fit, WholeArmOptions], Fit]
    is_addition: bool = True  # is tried only while evaluations are left
    is_repeated: bool = False  # until the data support no further change

    def __call__(self, fit: Fit, selection: Selection) -> Fit:
        """The fit of the changed model if the data support it, otherwise the fit itself."""
        while not (self.is_addition and selection.is_budget_exhausted(fit)):
            start = self.change(fit, selection)
            if start is None:
                break
            fit = self.search(start, selection.options)
            if not self.is_repeated:
                break
        return fit


def run_trial(start: Fit, selection: Selection, max_evaluations: int | None) -> Fit:
    """Run a coarse search of another model.

    `max_evaluations` limits the evaluations of the trial; None allows all remaining ones. Raises
    `NotIdentifiable` if the arm cannot be simulated at `start`.
    """
    return search_minimum(
        start,
        selection.options,
        relative=COARSE_RELATIVE_TOLERANCE,
        max_evaluations=max_evaluations,
    )


def best_trial(starts: Iterable[Fit], search: Callable[[Fit], Fit]) -> Fit | None:
    """The search of least cost from several starts; None if the arm can be simulated at none."""
    trials = []
    for start in starts:
        with suppress(NotIdentifiable):
            trials.append(search(start))
    return min(trials, key=lambda trial: trial.cost, default=None)


def select_better(fit: Fit, other: Fit) -> Fit:
    """Return `other` if it reduces the cost significantly, otherwise `fit` with its evaluations."""
    is_significant = fit.cost - other.cost > MIN_SIGNIFICANCE_STDS**2
    return other if is_significant else replace(fit, iterations=other.iterations)


def held_out_scores(fits: Sequence[Fit]) -> FloatArray:
    """Log predictive densities of fits of the same records, (n_fits, n_folds).

    The density of `log_density` is summed over the channels of the fold; the number of independent
    errors is that of the rows over kappa, the rows per independent residual, the largest of the
    fits. The parameters without a fold are one Gauss-Newton step from the fit: the least squares
    solution of the factors of the other folds, stacked. Unknowns at a bound stay there.
    """
    rows = [fit.objective.rows(fit.z) for fit in fits]
    # long integrator steps may end a row earlier
    n_rows = [min(len(one.residual) for one in of_record) for of_record in zip(*rows, strict=True)]
    correlation = [
        np.max([[estimate_rows_per_error(e) for e in one.errors.T] for one in of_record], axis=0)
        for of_record in zip(*rows, strict=True)
    ]
    folds = [_folds(n, float(np.max(kappa))) for n, kappa in zip(n_rows, correlation, strict=True)]
    return np.array(
        [_scores(fit, own, folds, correlation) for fit, own in zip(fits, rows, strict=True)]
    )


def simplest_model(fits: Sequence[Fit]) -> int:
    """Place of the fit with the fewest unknowns, unless one with more predicts better."""
    scores = held_out_scores(fits)
    chosen, *others = sorted(
        range(len(fits)), key=lambda k: (len(fits[k].z), -float(np.sum(scores[k])))
    )
    for k in others:
        if weight_over(scores[k], scores[chosen], np.random.default_rng(0)) > MIN_WEIGHT:
            chosen = k
    return chosen


def _folds(n_rows: int, rows_per_error: float) -> IntArray:
    """Number of the fold of each row of a record, (n_rows,)."""
    n_folds = int(n_rows / (MIN_CORRELATION_TIMES * rows_per_error))
    n_folds = min(max(n_folds, _MIN_FOLDS), BLOCKS_PER_RECORD)
    return np.arange(n_rows) * n_folds // n_rows


def _scores(
    fit: Fit, rows: Sequence[Rows], folds: Sequence[IntArray], correlation: Sequence[FloatArray]
) -> FloatArray:
    """Log predictive densities of the folds of all records, (n_folds,)."""
    # derivatives of the residuals in standard deviations
    columns = [
        (one.shared_columns / one.root[..., None])[: len(f)]
        for one, f in zip(rows, folds, strict=True)
    ]
    residuals = [one.residual[: len(f)] for one, f in zip(rows, folds, strict=True)]
    roots = [one.root[: len(f)] for one, f in zip(rows, folds, strict=True)]
    parts = [
        (k, fold == number) for k, fold in enumerate(folds) for number in range(int(fold[-1]) + 1)
    ]
    factors = []
    for k, held in parts:
        weighted = columns[k][held] * roots[k][held][..., None]
        residual = (residuals[k] * roots[k])[held][..., None]
        table = np.concatenate([weighted, residual], axis=2)
        factors.append(triangular_factor(table.reshape(-1, table.shape[2])))
    prior = np.column_stack(fit.space.linearise_prior(fit.z))
    free = np.flatnonzero(~(fit.at_bounds | fit.at_zero))
    predicted = [np.zeros_like(residual) for residual in residuals]
    for number, (k, held) in enumerate(parts):
        others = np.concatenate([prior, *factors[:number], *factors[number + 1 :]])
        step = np.linalg.lstsq(others[:, free], -others[:, -1])[0]
        change = columns[k][held][..., free] @ step
        predicted[k][held] = (residuals[k][held] + change) * rows[k].stds
    scores = []
    for k, held in parts:
        squares = predicted[k] ** 2
        held_out, variance = np.mean(squares[held], axis=0), np.mean(squares[~held], axis=0)
        count, others = np.sum(held) / correlation[k], np.sum(~held) / correlation[k]
        scores.append(float(np.sum(log_density(held_out, variance, count, others))))
    return np.array(scores)
