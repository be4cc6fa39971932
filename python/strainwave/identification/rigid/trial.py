"""Fits of the rigid model at one bandwidth each, and the search for the best bandwidth."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from strainwave.domain import BoolArray, FloatArray, Signals
from strainwave.domain.arm.parameter_table import family_of, parameter_table
from strainwave.domain.results.distributions import student_quantile
from strainwave.dynamics.arm import Arm
from strainwave.errors import NotIdentifiable
from strainwave.identification.rigid.equations import (
    JACKKNIFE_BLOCKS,
    Estimate,
    FurtherTerm,
    MotorShares,
    anti_resonances,
    assemble,
    convert_estimate,
    estimate_of,
    mix_estimates,
    slides_both_ways,
)
from strainwave.identification.rigid.filtered_record import (
    FilteredRecord,
    count_rows,
    n_compliances,
    prepare,
)
from strainwave.numerics import least_squares as ls

MAX_ITERATIONS = 20
# change in standard deviations for white errors, which are smaller than those of the jackknife
_TOLERANCE = 0.02
_MIN_STEP_SHARE = 0.3  # smallest share of a step that an iteration takes
# Change of the logarithm of square roots of weights above which they are estimated again with the
# same equations, which costs less than another linearisation.
_WEIGHT_TOLERANCE = 0.01
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
        return np.sqrt(np.maximum(np.diag(self.covariance), 0.0))

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
    """Fit at one bandwidth, with the covariance. See `solve` for the arguments."""
    end = solve(arm, stretches, start, shares, candidates, weights)
    equations, factor, weighed = end.equations, end.factor, end.weighed
    covariance, common_variance = ls.jackknife(equations, factor)
    if weighed:
        covariance = covariance + end.weight_covariance
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
        estimate=end.estimate,
        common_deviation=np.sqrt(common_variance),
        equations=equations,
        factor=factor,
        covariance=covariance,
        determined=identified,
        candidates=tuple(candidates),
        last_move=float(np.max((end.last_change / standard_deviations)[identified], initial=0.0)),
        weighed=weighed,
    )


@dataclass(frozen=True, slots=True)
class Iterate:
    """End of the iterations of a fit."""

    estimate: Estimate
    equations: ls.Equations
    factor: ls.Factor
    last_change: FloatArray  # (n_parameters,) sizes
    weighed: tuple[int, ...]  # as in `Trial`
    weight_covariance: FloatArray  # of the weights of links, if any is assumed


def solve(
    arm: Arm,
    stretches: tuple[FilteredRecord, ...],
    start: Estimate | None,
    shares: MotorShares | None = None,
    candidates: Sequence[FurtherTerm] = (),
    weights: FloatArray | None = None,
) -> Iterate:
    """Iterate parameters, compliances and weights at one bandwidth to convergence.

    The share of each step is that of Aitken's relaxation (Irons and Tuck, International Journal for
    Numerical Methods in Engineering 1, 1969).

    `weights` (n_rows,) are square roots of weights to start from, if the rows are the same.
    """
    shares = shares or MotorShares.usual(arm)
    equations = assemble(arm, stretches, start, candidates)
    if not len(equations.target):
        raise NotIdentifiable("every sample is at an edge or in saturation; record for longer")
    root = ls.initial_weights(equations.target, equations.group)
    if weights is not None and weights.shape == root.shape:
        root = weights
    last_step, share = np.zeros(len(arm.rigid_columns)), 1.0
    for iteration in range(MAX_ITERATIONS):
        factor = ls.factorise(equations, root)
        root = ls.root_weights(equations, factor)
        if np.max(np.abs(np.log(root / factor.root))) > _WEIGHT_TOLERANCE:
            factor = ls.factorise(equations, root)
            # the mean, because weights may alternate between two values
            root = np.sqrt(root * ls.root_weights(equations, factor))
        previous = factor.value if start is None else start.solution
        change = factor.value - previous
        change_size = np.abs(change)
        deviation = factor.deviation  # zero for parameters that do not change
        step = np.divide(change, deviation, out=np.zeros_like(change), where=deviation > 0.0)
        has_converged = iteration > 1 and np.all(change_size <= _TOLERANCE * deviation)
        estimate = estimate_of(arm, stretches, equations, factor, shares)
        if last_step.any():  # full steps of some records oscillate
            decrease = last_step - step
            share *= float(last_step @ decrease) / max(float(decrease @ decrease), 1e-300)
            share = min(max(share, _MIN_STEP_SHARE), 1.0)
        if start is not None and not has_converged:
            estimate = mix_estimates(start, estimate, share)
        start, last_step = estimate, step
        if has_converged:
            break
        equations = assemble(arm, stretches, start, candidates, equations)
    assert start is not None
    change, covariance, weighed = _weights_of_links(arm, stretches, factor, start.solution)
    if weighed:
        start = replace(start, solution=start.solution + change)
    return Iterate(start, equations, factor, change_size, weighed, covariance)


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


_BANDWIDTH_RATIO = 2.0**0.5  # ratio of successive bandwidths; squared if no gear is elastic
# log of a significant ratio of standard deviations, the accuracy of the jackknife
_MIN_LOG_GAIN = np.log(1.1)
_NEAR_RATIOS = 0.45, 2.1  # range of neighbours: a factor of two and rounding of the steps
_MAX_BANDWIDTHS_WITHOUT_GAIN = 3  # successive bandwidths without improvement that end the search

Motion = tuple[Signals, float]
"""Signals of a record and their period in samples."""


def search_bandwidths(motions: Sequence[Motion], arm: Arm) -> list[Trial]:
    """Fit at increasing bandwidths while the estimates improve and the gears are nearly rigid.

    The first one has rows for blocks of sufficient length, if any has. Neighbours of the best
    below it start from its estimate, because short blocks do not determine a start.
    """
    is_rigid = n_compliances(arm) == 0
    bandwidths = list(bandwidths_of(motions, _BANDWIDTH_RATIO ** (2 if is_rigid else 1)))
    n_rows = [sum(count_rows(arm, s, each) for s, _ in motions) for each in bandwidths]
    n_least = _MIN_ROWS_PER_BLOCK * JACKKNIFE_BLOCKS
    first = next((k for k, count in enumerate(n_rows) if count >= n_least), 0)
    trials: list[Trial] = []
    least_spread, n_without_gain = np.full(len(arm.rigid_columns), np.inf), 0
    for bandwidth in bandwidths[first:]:
        limits = [trial.max_rigid_bandwidth for trial in trials[-2:]]
        if len(limits) > 1 and bandwidth > max(limits):  # a single trial may be unreliable
            break
        stretches = prepare_all(arm, motions, bandwidth)
        trial = _fit_next(arm, stretches, trials[-1] if trials else None)
        trials.append(trial)
        has_improved = bool(np.any(trial.spread < least_spread - _MIN_LOG_GAIN))
        n_without_gain = 0 if has_improved else n_without_gain + 1
        least_spread = np.minimum(least_spread, trial.spread)
        if n_without_gain >= _MAX_BANDWIDTHS_WITHOUT_GAIN:
            break
    best = select_bandwidth(trials)
    for bandwidth in reversed(bandwidths[:first]):
        if _is_near(bandwidth, best):
            stretches = prepare_all(arm, motions, bandwidth)
            trials.insert(0, _fit_next(arm, stretches, trials[0]))
    return trials


def _fit_next(arm: Arm, stretches: tuple[FilteredRecord, ...], last: Trial | None) -> Trial:
    """Fit from the estimate and the weights at the last bandwidth."""
    if last is None:
        return fit_trial(arm, stretches, None)
    joint = np.concatenate([s.joint for s in stretches])
    roots, group = last.factor.root, last.equations.group
    weights = np.zeros(len(joint))
    for i in np.unique(joint):
        weights[joint == i] = np.median(roots[group == i]) if np.any(group == i) else 0.0
    start = convert_estimate(last.estimate, last.stretches, stretches)
    return fit_trial(arm, stretches, start, weights=weights if weights.all() else None)


def bandwidths_of(motions: Sequence[Motion], step: float) -> Iterator[float]:
    """Yield bandwidths from that of 90 % of the motion's power to half the signals' bandwidth."""
    top = min(s.bandwidth_hz or 0.5 / s.sample_time for s, _ in motions) / 2.0
    shortest = min(period * s.sample_time for s, period in motions)
    bandwidth = max(8.0 / shortest, _motion_band([s for s, _ in motions]))
    bandwidth = min(bandwidth, top)
    while bandwidth <= top:
        yield bandwidth
        bandwidth *= step


def _motion_band(records: Sequence[Signals]) -> float:
    """Frequency [Hz] below which 90 % of the power of each velocity in the records lies."""
    frequencies, powers = [], []
    for signals in records:
        velocity, count = signals.motor_velocity, len(signals.time)
        centred_index = np.arange(count) - 0.5 * (count - 1)
        detrended = velocity - velocity.mean(axis=0)
        slope = centred_index @ detrended / (centred_index @ centred_index)
        detrended -= np.outer(centred_index, slope)
        frequencies.append(np.fft.rfftfreq(count, signals.sample_time))
        powers.append(np.abs(np.fft.rfft(detrended, axis=0)) ** 2 / count)
    frequency, power = np.concatenate(frequencies), np.concatenate(powers)
    order = np.argsort(frequency, kind="stable")
    cumulative = np.cumsum(power[order], axis=0)
    reached = [np.searchsorted(c, 0.9 * c[-1]) for c in cumulative.T if c[-1] > 0.0]
    return max((float(frequency[order[k]]) for k in reached), default=0.0)


def prepare_all(
    arm: Arm, motions: Sequence[Motion], bandwidth_hz: float
) -> tuple[FilteredRecord, ...]:
    """Filter all records for the equations of one bandwidth."""
    return tuple(prepare(arm, s, bandwidth_hz, period) for s, period in motions)


def select_bandwidth(trials: Sequence[Trial]) -> Trial:
    """Select the bandwidth at which all standard deviations are close to their minimum.

    The regret of a bandwidth is the largest ratio of a standard deviation to its minimum over the
    bandwidths. For elastic gears, the lowest bandwidth with a small regret is selected, because
    model error is largest at high frequencies. For rigid gears, the standard deviations include the
    model error, because noise of the acceleration or a delay biases inertias at high frequencies.
    Bandwidths with few rows count only if there are no others.
    """
    is_rigid = not n_compliances(trials[0].arm)
    trials = [t for t in trials if not t.has_short_blocks] or trials
    spread = np.array([trial.spread for trial in trials])
    for k, trial in enumerate(trials if is_rigid else ()):
        near = neighbours(trials, trial)
        below = [t for t in near if t.bandwidth_hz < trial.bandwidth_hz]
        others = [(t.solution, np.diag(t.covariance)) for t in below or near]
        excess = excess_variance(trial.solution, others)
        spread[k] = 0.5 * np.log(np.exp(2.0 * spread[k]) + excess)
    least_spread = spread.min(axis=0)
    identified = np.isfinite(least_spread)
    regret = np.max(spread[:, identified] - least_spread[identified], axis=1, initial=0.0)
    if is_rigid:
        return trials[int(np.argmin(regret))]
    return trials[int(np.argmax(regret <= regret.min() + _MIN_LOG_GAIN))]


def neighbours(trials: Sequence[Trial], best: Trial) -> list[Trial]:
    """Trials within about a factor of two of the best bandwidth."""
    return [t for t in trials if t is not best and _is_near(t.bandwidth_hz, best)]


def _is_near(bandwidth_hz: float, best: Trial) -> bool:
    lowest, highest = _NEAR_RATIOS
    return lowest <= bandwidth_hz / best.bandwidth_hz <= highest


def excess_variance(
    value: FloatArray | float, others: Sequence[tuple[FloatArray, FloatArray]]
) -> FloatArray:
    """Variance of the model error of an estimate, from its change with the bandwidth.

    With an exact model, the estimates at all bandwidths agree within their standard deviations. The
    excess is the median over neighbouring bandwidths, which is insensitive to uncertain trials at
    low bandwidths. `others` has estimates and variances at these.
    """
    excess = [np.clip((other - value) ** 2 - variance, 0.0, None) for other, variance in others]
    return np.asarray(np.median(excess, axis=0) if excess else np.zeros_like(value))
