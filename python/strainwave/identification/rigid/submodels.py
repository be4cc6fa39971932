"""Fits of a trial with any of several further terms, with all blocks and without each of them.

All models have the parameters of the arm, so these are eliminated once; a term then costs the
solution of a few small triangular systems.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from strainwave.domain import BoolArray, FloatArray, IntArray
from strainwave.identification.rigid.equations import blocks_of
from strainwave.identification.rigid.trial import Trial
from strainwave.numerics import least_squares as ls
from strainwave.numerics.linalg import triangular_factor
from strainwave.numerics.spectra import estimate_rows_per_error
from strainwave.numerics.statistics import MIN_CORRELATION_TIMES, log_density

# weight of a prior that keeps directions finite which only the left out block determines, relative
# to the information of all blocks
_RIDGE = 3e-5
_MIN_FOLDS = 2  # the other folds estimate the variance of a joint
# share of the torque of a term that the parameters of the arm must leave unexplained; the zero of
# the last joint of a chain, which turns the centre of mass, leaves errors of the torsion
_MIN_UNEXPLAINED_SHARE = 1e-3


@dataclass(frozen=True)
class Submodels:
    """Least squares over parameters and subsets of the common unknowns, linearised at a trial."""

    trial: Trial
    equations: ls.Equations  # with all terms

    @cached_property
    def _rows(self) -> FloatArray:
        """Rows over parameters, terms and target: (n, k + m + 1), with those of local priors.

        The k columns of the parameters are orthonormal if the trial has no terms.
        """
        equations, factor = self.equations, self.trial.factor
        rows = ls.rows_of(equations, factor.root)
        table = np.vstack([rows.own, -rows.below])
        m, stop = equations.common.shape[1], equations.common.shape[1] + len(rows.scale)
        shared = table[:, m:stop] * rows.scale @ self._back
        return np.hstack([shared, table[:, :m], table[:, stop:]])

    @cached_property
    def _back(self) -> FloatArray:
        """Parameters per unknown of the rows: (n_parameters, k)."""
        factor = self.trial.factor
        resolved = factor.is_resolved
        basis = factor.directions[resolved].T / factor.scale[:, None] / factor.singular[resolved]
        return np.asarray(basis)

    @cached_property
    def is_visible(self) -> BoolArray:
        """Whether each term has a torque that the parameters do not have as well, (m,)."""
        k = self._back.shape[1]
        own, terms = np.linalg.qr(self._rows[:, :k])[0], self._rows[:, k:-1]
        left = terms - own @ (own.T @ terms)
        sizes = np.linalg.norm(terms, axis=0)
        return np.asarray(np.linalg.norm(left, axis=0) > _MIN_UNEXPLAINED_SHARE * sizes)

    @cached_property
    def _equation(self) -> IntArray:
        """Equation of each row; priors belong to one in which their unknown occurs."""
        equations = self.equations
        return np.concatenate([np.arange(len(equations.target)), ls.rows_of_local(equations)])

    @cached_property
    def _of_row(self) -> tuple[IntArray, IntArray]:
        """Fold and joint, from 0, of each row."""
        return self.folds[self._equation], self.equations.group[self._equation]

    @cached_property
    def rows_per_error(self) -> FloatArray:
        """Rows per independent error of each joint, (n_joints,)."""
        residual = ls.residual_of(self.trial.equations, self.trial.factor) * self.trial.factor.root
        group = self.trial.equations.group
        joints = range(self.trial.arm.n_joints)
        own = (residual[group == i] for i in joints)
        return np.array([estimate_rows_per_error(each) if len(each) else 1.0 for each in own])

    @cached_property
    def folds(self) -> IntArray:
        """Fold of each row: blocks, joined until they exceed ten correlation times."""
        block, group = self.equations.block, self.equations.group
        n_blocks = int(block.max()) + 1
        counts = np.array(
            [
                np.bincount(block[group == i], minlength=n_blocks)
                for i in range(self.trial.arm.n_joints)
            ]
        )
        errors = np.max(counts / self.rows_per_error[:, None], axis=0)
        fold, total, number = np.zeros(n_blocks, dtype=np.int64), 0.0, 0
        for b in range(n_blocks):
            fold[b] = number
            total += float(errors[b])
            if total >= MIN_CORRELATION_TIMES:
                number, total = number + 1, 0.0
        if total and number:
            fold[fold == number] = number - 1
        if fold[-1] < _MIN_FOLDS - 1:
            fold = np.arange(n_blocks) * _MIN_FOLDS // n_blocks
        return fold[block]

    @cached_property
    def _without_folds(self) -> list[_Reduced]:
        return self._without(self._of_row[0])

    @cached_property
    def _without_blocks(self) -> list[_Reduced]:
        return self._without(self.equations.block[self._equation])

    def _without(self, label: IntArray) -> list[_Reduced]:
        """Solutions without the rows of each label."""
        factors = [triangular_factor(self._rows[label == j]) for j in range(int(label.max()) + 1)]
        return [
            self._reduce(np.concatenate([*factors[:j], *factors[j + 1 :]]))
            for j in range(len(factors))
        ]

    @cached_property
    def _whole(self) -> _Reduced:
        return self._reduce(triangular_factor(self._rows))

    def _reduce(self, rows: FloatArray) -> _Reduced:
        k = self._back.shape[1]
        ridge = _RIDGE * np.eye(k, rows.shape[1])
        R = triangular_factor(np.concatenate([rows, ridge]))
        solved = np.linalg.solve(R[:k, :k], R[:k, k:])
        plain, per_term, triangle = (
            np.asarray(x, dtype=np.float64) for x in (solved[:, -1], solved[:, :-1], R[k:, k:])
        )
        return _Reduced(plain, per_term, triangle)

    @cached_property
    def _held(self) -> tuple[FloatArray, list[FloatArray]]:
        """Errors of rows held out without terms, and their change per term, by fold."""
        fold, rows, k = self._of_row[0], self._rows, self._back.shape[1]
        parts = []
        for j, reduced in enumerate(self._without_folds):
            own = rows[fold == j]
            mapped = np.column_stack([reduced.per_term, reduced.plain])
            parts.append(own[:, k:] - own[:, :k] @ mapped)
        return np.concatenate([np.flatnonzero(fold == j) for j in range(len(parts))]), parts

    def scores(self, terms: Sequence[int]) -> FloatArray:
        """Held-out log predictive densities of the model with some terms, (n_folds,)."""
        (order, parts), (fold, joint) = self._held, self._of_row
        errors = np.concatenate(
            [
                part[:, -1] - part[:, list(terms)] @ reduced.terms(terms)
                for part, reduced in zip(parts, self._without_folds, strict=True)
            ]
        )
        n_folds, n_joints = len(parts), self.trial.arm.n_joints
        at = (fold * n_joints + joint)[order]
        squares = np.bincount(at, errors**2, n_folds * n_joints).reshape(n_folds, n_joints)
        own = self.folds * n_joints + self.equations.group
        count = np.bincount(own, minlength=n_folds * n_joints).reshape(n_folds, n_joints)
        others = np.maximum(count.sum(axis=0) - count, 1)
        variance = (squares.sum(axis=0) - squares) / others
        mean, kappa = squares / np.maximum(count, 1), self.rows_per_error
        density = log_density(mean, variance, count / kappa, others / kappa)
        return np.asarray(density.sum(axis=1))

    def sizes(self, terms: Sequence[int]) -> FloatArray:
        """Estimates of some terms in a model with these."""
        return self._whole.terms(terms) * self.equations.common_deviation[list(terms)]

    def size_stds(self, terms: Sequence[int]) -> FloatArray:
        """Jackknife standard deviations of these estimates."""
        moved = np.array([one.terms(terms) for one in self._without_blocks])
        moved -= self._whole.terms(terms)
        scale = (len(moved) - 1) / len(moved)
        return np.asarray(
            np.sqrt(scale * np.sum(moved**2, axis=0)) * self.equations.common_deviation[list(terms)]
        )

    def solution(self, terms: Sequence[int]) -> FloatArray:
        """Parameters (n_parameters,) of the model with some terms."""
        return np.asarray(self._back @ self._whole.unknowns(terms))

    def shifts(self, terms: Sequence[int]) -> FloatArray:
        """Changes of the parameters without each block, (n_blocks, n_parameters)."""
        unknowns = np.array([one.unknowns(terms) for one in self._without_blocks])
        return np.asarray((unknowns - self._whole.unknowns(terms)) @ self._back.T)

    def noise_share(self, terms: Sequence[int]) -> FloatArray:
        """Share (n_parameters,) of the variances that differs between repetitions of the motion.

        What repeats with the motion is model error. The errors of the periods are taken as a whole,
        and part by part, which has more degrees of freedom; the larger variance counts. Blocks that
        are not repeated count entirely.
        """
        at, rows = self._equation, self._rows
        fold = self.equations.block[at]
        k = self._back.shape[1]
        columns = [*range(k), *(k + term for term in terms)]
        priors = np.eye(len(terms), len(columns), k)
        Q, R = np.linalg.qr(np.vstack([rows[:, columns], priors]))
        padded = np.append(rows[:, -1], np.zeros(len(terms)))
        error = (padded - Q @ (Q.T @ padded))[: len(rows)]
        to_parameters = self._back @ np.linalg.inv(R)[:k]
        _, label = np.unique(
            np.column_stack([fold, self.equations.repetition[at]]), axis=0, return_inverse=True
        )
        label = label.ravel()
        change = np.zeros((label.max() + 1, len(to_parameters)))
        np.add.at(change, label, (Q[: len(rows)] * error[:, None]) @ to_parameters.T)
        first = np.unique(label, return_index=True)[1]
        block, repetition = fold[first], self.equations.repetition[at][first]
        stretches = self.trial.stretches
        record = np.repeat(np.arange(len(stretches)), blocks_of(stretches))[block]
        parts = _scatter(change, block)
        periods, number = np.unique(
            np.column_stack([record, repetition]), axis=0, return_inverse=True
        )
        whole = np.zeros((len(periods), change.shape[1]))
        np.add.at(whole, number.ravel(), change)
        is_repeated = np.bincount(periods[:, 0])[periods[:, 0]] > 1
        single = ~is_repeated[number.ravel()]
        together = _scatter(whole[is_repeated], periods[is_repeated, 0])
        together += _scatter(change[single], block[single])
        of_blocks = np.zeros((block.max() + 1, change.shape[1]))
        np.add.at(of_blocks, block, change)
        total = np.maximum(np.sum(of_blocks**2, axis=0), np.finfo(float).tiny)
        return np.asarray(np.minimum(np.maximum(parts, together) / total, 1.0))


def _scatter(changes: FloatArray, label: IntArray) -> FloatArray:
    """Variance of the sum of changes (n, n_columns) from their scatter about the mean by label.

    A change that has its label alone counts entirely.
    """
    total = np.zeros(changes.shape[1])
    for each in np.unique(label):
        own = changes[label == each]
        n = len(own)
        mean = own.mean(axis=0) if n > 1 else 0.0
        total += np.sum((own - mean) ** 2, axis=0) * (n / (n - 1) if n > 1 else 1.0)
    return total


@dataclass(frozen=True, slots=True)
class _Reduced:
    """Normal equations after elimination of the parameters."""

    plain: FloatArray  # (k,) unknowns of the parameters without terms
    per_term: FloatArray  # (k, m) their decrease per term
    triangle: FloatArray  # (m + 1, m + 1) of the terms and the target

    def terms(self, terms: Sequence[int]) -> FloatArray:
        """Estimates of some terms, in units of their priors."""
        n = len(terms)
        left = np.vstack([self.triangle[:, list(terms)], np.eye(n)])
        right = np.append(self.triangle[:, -1], np.zeros(n))
        return np.asarray(np.linalg.lstsq(left, right)[0])

    def unknowns(self, terms: Sequence[int]) -> FloatArray:
        """Unknowns of the parameters in the model with some terms."""
        return np.asarray(self.plain - self.per_term[:, list(terms)] @ self.terms(terms))
