"""Fit of the rigid model at one bandwidth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from strainwave.domain import BoolArray, FloatArray
from strainwave.domain.arm.parameter_table import family_of, parameter_table
from strainwave.domain.results.distributions import student_quantile
from strainwave.dynamics.arm import Arm
from strainwave.errors import NotIdentifiable
from strainwave.identification.rigid.equations import (
    Estimate,
    FurtherTerm,
    MotorShares,
    anti_resonances,
    assemble,
    average_estimates,
    estimate_of,
    slides_both_ways,
)
from strainwave.identification.rigid.filtered_record import FilteredRecord, n_compliances
from strainwave.numerics import least_squares as ls

MAX_ITERATIONS = 20
# change in standard deviations for white errors, which are smaller than those of the jackknife
_TOLERANCE = 0.02
# share of the torque above which a fit is uncertain; 1e-4 to 1e-3 with enough motion in the band
_MAX_UNCERTAIN_TORQUE_SHARE = 0.003
# minimum rows of one joint per block: half a period of the cut-off, the correlation time of errors
_MIN_ROWS_PER_BLOCK = 2.0

RESONANCE_RATIO = 3.0
"""Minimum ratio of anti-resonance to bandwidth for the first-order compliance model."""


@dataclass(frozen=True, slots=True)
class Trial:
    """Fit at one bandwidth."""

    arm: Arm
    stretches: tuple[FilteredRecord, ...]  # one per record
    estimate: Estimate
    common_deviation: FloatArray  # (n_common,) of the compliances, then of terms of friction
    equations: ls.Equations
    factor: ls.Factor
    covariance: FloatArray
    determined: BoolArray
    candidates: tuple[FurtherTerm, ...]  # further terms of friction
    last_move: float  # largest change in the last iteration, in standard deviations
    weighed: tuple[int, ...] = ()  # joints whose `friction_offset` is assumed to be near zero

    @property
    def bandwidth_hz(self) -> float:
        """Bandwidth [Hz] of the equations' filter."""
        return self.stretches[0].bandwidth_hz

    @property
    def solution(self) -> FloatArray:
        """Estimates of the parameters, (n_parameters,)."""
        return self.estimate.solution

    @property
    def standard_deviations(self) -> FloatArray:
        """Standard deviations (n_parameters,) by the jackknife."""
        return np.sqrt(np.clip(np.diag(self.covariance), 0.0, None))

    @property
    def spread(self) -> FloatArray:
        """Log of the standard deviations; infinite for parameters that are not determined."""
        logs = np.log(np.maximum(self.standard_deviations, 1e-150))
        return np.where(self.determined, logs, np.inf)

    @property
    def n_blocks(self) -> int:
        """Number of blocks of the jackknife."""
        return len(np.unique(self.equations.block))

    @property
    def interval_half_width(self) -> float:
        """Half-width of a 95 % interval in standard deviations."""
        return student_quantile(0.975, max(1, self.n_blocks - 1))

    @property
    def is_uncertain(self) -> bool:
        """Whether a parameter is poorly determined or the standard deviations are unreliable.

        At low bandwidths, the effect of a poorly determined parameter may be attributed to
        compliance.
        """
        torque = float(np.linalg.norm(self.factor.root * self.equations.target))
        largest = float(np.max(self.standard_deviations * self.factor.scale))
        return largest / torque > _MAX_UNCERTAIN_TORQUE_SHARE or self.has_short_blocks

    @property
    def has_short_blocks(self) -> bool:
        """Whether blocks are shorter than the correlation time of the errors.

        The standard deviations of the jackknife are unreliable then.
        """
        n_rows = _MIN_ROWS_PER_BLOCK * self.n_blocks * self.arm.n_joints
        return len(self.equations.target) < n_rows

    @property
    def max_rigid_bandwidth(self) -> float:
        """Bandwidth [Hz] above which the first-order compliance model is not valid.

        Infinite if the trial is uncertain.
        """
        if not n_compliances(self.arm) or self.is_uncertain:
            return np.inf
        compliance = self.estimate.compliance - 2.0 * self.common_deviation
        lower_bound = replace(self.estimate, compliance=np.clip(compliance, 0.0, None))
        return float(np.min(anti_resonances(self.arm, lower_bound))) / RESONANCE_RATIO

    def implausible(self, variances: FloatArray) -> list[int]:
        """Parameters that are negative beyond their intervals although they must be positive."""
        upper = self.solution + self.interval_half_width * np.sqrt(variances)
        return [
            k
            for k, column in enumerate(self.arm.rigid_columns)
            if self.determined[k]
            and parameter_table()[column.name].range != "any"
            and upper[k] < 0.0
        ]

    @property
    def residual_power(self) -> float:
        """Sum of the squared residuals of all joints, each over its torque."""
        return float(sum(error**2 for error in self.torque_errors.values()))

    @property
    def torque_errors(self) -> dict[int, float]:
        """Joint -> residual over torque, rms values of its rows."""
        equations, errors = self.equations, dict[int, float]()
        residual = ls.residual_of(equations, self.factor)
        for i in range(self.arm.n_joints):
            rows = equations.group == i
            torque = float(np.linalg.norm(equations.target[rows]))
            if torque > 0.0:
                errors[i + 1] = float(np.linalg.norm(residual[rows])) / torque
        return errors


def fit_trial(
    arm: Arm,
    stretches: tuple[FilteredRecord, ...],
    start: Estimate | None,
    shares: MotorShares | None = None,
    candidates: Sequence[FurtherTerm] = (),
    weights: FloatArray | None = None,
) -> Trial:
    """Fit at one bandwidth: iterate parameters, compliances and weights to convergence.

    `weights` (n_rows,) are square roots of weights to start from, if the rows are the same.
    """
    shares = shares or MotorShares.usual(arm)
    equations = assemble(arm, stretches, start, candidates)
    if not len(equations.target):
        raise NotIdentifiable("every sample is at an edge or in saturation; record for longer")
    root = ls.initial_weights(equations.target, equations.group)
    if weights is not None and weights.shape == root.shape:
        root = weights
    last_step = np.zeros(len(arm.rigid_columns))
    for iteration in range(MAX_ITERATIONS):
        factor = ls.factorise(equations, root)
        previous = factor.value if start is None else start.solution
        change = factor.value - previous
        change_size = np.abs(change)
        known = factor.deviation > 0.0  # other parameters do not change
        step = np.divide(change, factor.deviation, out=np.zeros_like(change), where=known)
        has_converged = iteration > 1 and np.all(change_size <= _TOLERANCE * factor.deviation)
        estimate = estimate_of(arm, stretches, equations, factor, shares)
        if start is not None and step @ last_step < 0.0 and not has_converged:  # oscillates
            estimate = average_estimates(start, estimate)
        start, last_step = estimate, step
        if has_converged:
            break
        root = ls.root_weights(equations, factor)
        equations = assemble(arm, stretches, start, candidates)
    covariance, common_variance = ls.jackknife(equations, factor)
    assert start is not None
    change, variance, weighed = _weights_of_links(arm, stretches, factor, start.solution)
    if weighed:
        start = replace(start, solution=start.solution + change)
        covariance = covariance + variance
    resolved = replace(factor, is_resolved=factor.is_resolved | bool(weighed))
    identified = ls.determined(equations, resolved, covariance)
    # the apparent information on dry friction of a joint that never slides in both directions comes
    # from the prior of the stiction torque, not from data
    is_two_way = slides_both_ways(stretches)
    for k, column in enumerate(arm.rigid_columns):
        if column.joint is not None and family_of(column.name) == "dry friction":
            identified[k] &= is_two_way[column.joint - 1]
    standard_deviations = np.sqrt(np.clip(np.diag(covariance), 1e-300, None))
    return Trial(
        arm=arm,
        stretches=stretches,
        estimate=start,
        common_deviation=np.sqrt(common_variance),
        equations=equations,
        factor=factor,
        covariance=covariance,
        determined=identified,
        candidates=tuple(candidates),
        last_move=float(np.max((change_size / standard_deviations)[identified], initial=0.0)),
        weighed=weighed,
    )


def _weights_of_links(
    arm: Arm, stretches: Sequence[FilteredRecord], factor: ls.Factor, solution: FloatArray
) -> tuple[FloatArray, FloatArray, tuple[int, ...]]:
    """Change of a solution that gives the weights of links to gravity; its covariance; the joints.

    The weight of what a vertical prismatic joint carries is constant, as `friction_offset` is. That
    is taken as zero, with the Coulomb friction as its standard deviation. No joints if the data
    resolve all directions, or if this leaves another one.
    """
    directions = factor.directions[~factor.is_resolved] / factor.scale
    is_two_way, offsets = slides_both_ways(stretches), dict[int, int]()
    for k, column in enumerate(arm.rigid_columns):
        joint = column.joint if column.name == "friction_offset" else None
        if joint and arm.joints[joint - 1].motion == "prismatic" and is_two_way[joint - 1]:
            offsets |= {joint: k} if np.any(directions[:, k]) else {}
    at, joints = list(offsets.values()), np.array(list(offsets), dtype=int)
    sizes = np.abs(arm.joint_friction(solution)[joints - 1, 1]) + np.finfo(float).eps
    rows = directions[:, at].T / sizes[:, None]
    if not len(directions) or np.linalg.matrix_rank(rows) < len(directions):
        return np.zeros_like(solution), np.zeros((0, 0)), ()
    change = np.linalg.lstsq(rows, -solution[at] / sizes)[0] @ directions
    variance = directions.T @ np.linalg.inv(rows.T @ rows) @ directions
    return change, variance, tuple(offsets)
