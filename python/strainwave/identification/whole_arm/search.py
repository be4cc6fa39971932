"""Searches for the minimum of the objective: reweighted least squares, and tuning as published.

A coarse search uses long integrator steps, a fine search short ones. Tuning as published compares
the velocity steps of the arm with those of its simulation under the same servo (Fig. 7). Here both
pass the same sensors and the same fusion (10), so that the error of the fusion cancels. There is no
prior, and the only weight of a record is the size of its step.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, replace
from functools import partial
from itertools import count

import numpy as np

from strainwave.domain import BoolArray, FloatArray, SearchEnd, WholeArmOptions
from strainwave.domain.keys import Values
from strainwave.domain.results.arm_model import MAX_RESIDUAL_NOISE
from strainwave.domain.results.estimates import physical_range
from strainwave.domain.results.identification import MAX_RELATIVE_RESIDUAL
from strainwave.dynamics.arm import Arm
from strainwave.errors import InvalidInput, NotIdentifiable, NumericalFailure
from strainwave.identification.whole_arm.problem.objective import Objective
from strainwave.identification.whole_arm.problem.parameter_space import ParameterSpace
from strainwave.identification.whole_arm.records.dataset import Dataset
from strainwave.numerics.parallel import run_parallel
from strainwave.numerics.search import Linearised, full_step, minimise
from strainwave.signals.link_motion import prepare_link_signals

# distance to a bound, relative to half the range, that counts as at the bound
_BOUND_TOLERANCE = 0.01
# predicted cost reduction at which a coarse search ends, absolute and relative to the cost
COARSE_TOLERANCE, COARSE_RELATIVE_TOLERANCE = 1.0, 2e-3
# the same: absolute for the fine search, relative for a search with initial weights
_FINE_TOLERANCE, _INITIAL_RELATIVE_TOLERANCE = 1e-2, 2e-2
_MAX_WEIGHT_UPDATES = 4  # maximum updates of the weights; the third rarely changes the result
_MAX_COARSE_UPDATES = 8  # maximum updates of the weights in the coarse search
# maximum change of log standard deviations at which the weights have converged
_WEIGHT_TOLERANCE = 0.2
# ratio of new to old standard deviations below which another search follows
_MAX_DECREASED_RATIO = 0.7
# Maximum evaluations with the same weights near the minimum. If the model lacks an effect, the cost
# is rough, and slow progress would use up the evaluations before the effect is found.
_MAX_EVALUATIONS_PER_WEIGHTS = 20
_MAX_CORRECTIONS_AHEAD = 4  # Gauss-Newton steps of a stalled search; one is usual
# decrease of the exact cost below which they end: a third of a parameter's standard deviation
_CORRECTED_TOLERANCE = 0.1
_NEAR_DAMPING = 1e-8  # initial damping near the minimum
_PUBLISHED_TOLERANCE = (
    1e-4  # relative change of cost or coordinates at which tuning as published ends
)
_DIFFERENCE_STEP = 1e-3  # of a coordinate, the logarithm of a positive parameter
_ROWS_PER_PERIOD = 8  # of the cut-off; closer samples have no further information

Progress = Callable[[int, int], None]
"""Callback with the number of the evaluation and the maximum number of evaluations."""
_progress: ContextVar[Progress] = ContextVar(
    "_progress", default=lambda _evaluation, _maximum: None
)
_MAX_UNDESCRIBED_SHARE = 0.25  # of the records: if more are not described, the model is wrong


@dataclass(frozen=True, eq=False)
class Fit:
    """Iterate of a search: its result, or the start of another one."""

    objective: Objective
    z: FloatArray  # (n_unknowns,)
    cost: float  # objective with the final weights; infinite before the first iteration
    iterations: int
    end: SearchEnd = SearchEnd.EVALUATION_LIMIT  # of the last search; no minimum before it

    @classmethod
    def at(cls, objective: Objective, z: FloatArray) -> Fit:
        """The start of a search at z (n_unknowns,)."""
        return cls(objective, z, np.inf, 0)

    def restart(self, objective: Objective, z: FloatArray) -> Fit:
        """The start of a search with another objective; its evaluations count from this fit."""
        return replace(self, objective=objective, z=z, cost=np.inf, end=SearchEnd.EVALUATION_LIMIT)

    def with_unknowns(self, space: ParameterSpace, starts: Values | None = None) -> Fit:
        """The start of a search with other unknowns, at `starts` and the values of this fit."""
        z = space.coordinates(self.values | (starts or {}))
        return self.restart(self.objective.replace_unknowns(space), z)

    @property
    def space(self) -> ParameterSpace:
        """Unknowns, fixed parameters and prior."""
        return self.objective.space

    @property
    def values(self) -> Values:
        """Values of all parameters, fixed ones included."""
        return self.space.values(self.z)

    @property
    def records(self) -> list[str]:
        """Names of the records."""
        return [record.log.name for record in self.objective.records]

    @property
    def at_bounds(self) -> BoolArray:
        """Unknowns (n_unknowns,) at a bound of their search range that is no physical zero."""
        at_upper = self._is_near(self.space.upper - self.z)
        return np.asarray((at_upper | self._is_near(self.z - self.space.lower)) & ~self.at_zero)

    @property
    def at_zero(self) -> BoolArray:
        """Unknowns (n_unknowns,) at the lower bound of a range that begins at zero."""
        may_vanish = [physical_range(name) == "non-negative" for name, _ in self.space.keys]
        return np.asarray(self._is_near(self.z - self.space.lower) & np.array(may_vanish))

    def _is_near(self, distance: FloatArray) -> BoolArray:
        margin = 0.5 * _BOUND_TOLERANCE * (self.space.upper - self.space.lower)
        return np.asarray(distance < margin)


@contextmanager
def report_progress(progress: Progress | None) -> Iterator[None]:
    """Report the progress of all searches in this context to `progress`."""
    token = _progress.set(progress or _progress.get())
    try:
        yield
    finally:
        _progress.reset(token)


def coarse_search(start: Fit, options: WholeArmOptions) -> Fit:
    """Search with initial weights, then with updated weights.

    Large initial errors give small weights, and with these a search may end too early. The weights
    are updated as long as the errors decrease markedly.
    """
    fit = search_minimum(start, options, relative=_INITIAL_RELATIVE_TOLERANCE)
    if not fit.end.is_minimum:
        return fit
    if fit.iterations >= options.max_iterations:
        return replace(fit, end=SearchEnd.EVALUATION_LIMIT)
    return _reweight(fit, options)


def resumed_coarse_search(start: Fit, options: WholeArmOptions) -> Fit:
    """Continue a coarse search after a change of records or unknowns."""
    return _reweight(search_minimum(start, options), options)


def _reweight(fit: Fit, options: WholeArmOptions) -> Fit:
    """Continue a coarse fit with updated weights as long as the errors decrease markedly.

    Where a search stalls, further weights hardly change its end, and the fine search continues.
    """
    fit = replace(fit, objective=fit.objective.update_weights(fit.z))
    for _ in range(_MAX_COARSE_UPDATES):
        fit = search_minimum(fit, options, relative=COARSE_RELATIVE_TOLERANCE)
        updated = fit.objective.update_weights(fit.z)
        is_finished = fit.end is not SearchEnd.CONVERGED or fit.iterations >= options.max_iterations
        changes = _changes(fit.objective, updated)
        if is_finished or all(np.min(one) >= _MAX_DECREASED_RATIO for one in changes):
            break
        fit = replace(fit, objective=updated)
    return fit


def fine_search(
    start: Fit, options: WholeArmOptions, extend: Callable[[Fit], Fit] = lambda fit: fit
) -> Fit:
    """Alternate least squares and weight updates until the weights converge.

    `start` is near the minimum. The step error of the integrator is corrected after the first
    search, where `extend` may add unknowns, and again near the minimum. Call `polish` to complete
    the search.
    """
    fit = search_minimum(
        start, options, tolerance=_FINE_TOLERANCE, relative=_INITIAL_RELATIVE_TOLERANCE
    )
    if start.iterations >= options.max_iterations:  # no evaluations are left; only the cost is new
        return replace(fit, iterations=start.iterations, end=SearchEnd.EVALUATION_LIMIT)
    for is_corrected in (False, True):
        if not fit.end.is_minimum:
            break
        if fit.iterations >= options.max_iterations:
            return replace(fit, end=SearchEnd.EVALUATION_LIMIT)
        uncorrected = fit.objective
        corrected = uncorrected.correct_step_error(fit.z)
        fit = replace(fit, objective=corrected.update_weights(fit.z))
        if not is_corrected:
            fit = extend(fit)
        fit.objective.free_ended(uncorrected, corrected)
        fit = refine(fit, options)
    return fit


def _refine_corrected_ahead(fit: Fit, options: WholeArmOptions) -> Fit:
    """Refine a stalled fit from its Gauss-Newton step, with the step error corrected there.

    The correction is exact only where it was computed. Where motors stick, the cost jumps around
    that point, and a search stalls there although the exact cost decreases.
    """
    for _ in range(_MAX_CORRECTIONS_AHEAD):
        if fit.end is not SearchEnd.STALLED:
            break
        at = fit.objective.linearise(fit.z)
        if at is None:
            break
        z = full_step(at, fit.z, fit.space)
        try:
            ahead = fit.objective.correct_step_error(z)
        except (InvalidInput, NumericalFailure):  # the step leads out of what can be simulated
            break
        cost = ahead.cost(z)
        fit = replace(fit, iterations=fit.iterations + 1)
        if cost is None or at.cost - cost < _CORRECTED_TOLERANCE:
            break
        if fit.iterations >= options.max_iterations:
            break
        ahead = ahead.update_weights(z)
        fit = refine(replace(fit, objective=ahead, z=z), options, _CORRECTED_TOLERANCE, rough=True)
    return fit


def refine(
    fit: Fit,
    options: WholeArmOptions,
    tolerance: float = COARSE_TOLERANCE,
    *,
    rough: bool = False,
) -> Fit:
    """Run the last rounds of `fine_search` from a point near the minimum.

    The step error correction is not updated. With the default tolerance the result is within one
    standard deviation of the minimum, which is sufficient for the model selection. See `minimise`
    for `rough`.
    """
    for _ in range(_MAX_WEIGHT_UPDATES):
        # weights hardly change within a standard deviation of the minimum
        fit = _search_near(fit, options, max(tolerance, COARSE_TOLERANCE), rough)
        updated = fit.objective.update_weights(fit.z)
        changes = [np.max(np.abs(np.log(one))) for one in _changes(fit.objective, updated)]
        if not fit.end.is_minimum or all(one < _WEIGHT_TOLERANCE for one in changes):
            break
        fit = replace(fit, objective=updated)
    if tolerance < COARSE_TOLERANCE and fit.end.is_minimum:
        fit = _search_near(fit, options, tolerance, rough)
    return fit


def _search_near(fit: Fit, options: WholeArmOptions, tolerance: float, rough: bool) -> Fit:
    """Search near the minimum with the same weights."""
    if fit.iterations >= options.max_iterations:
        return replace(fit, end=SearchEnd.EVALUATION_LIMIT)
    fit = search_minimum(
        fit,
        options,
        tolerance=tolerance,
        damping=_NEAR_DAMPING,
        near=True,
        rough=rough,
        max_evaluations=_MAX_EVALUATIONS_PER_WEIGHTS,
    )
    if fit.end is SearchEnd.EVALUATION_LIMIT and fit.iterations < options.max_iterations:
        fit = replace(fit, end=SearchEnd.STALLED)
    return fit


def polish(fit: Fit, options: WholeArmOptions) -> Fit:
    """Complete the search for the minimum with the weights of a refined fit.

    Its steps resolve the fastest mode of each record.
    """
    if not fit.end.is_minimum or fit.iterations >= options.max_iterations:
        return fit
    resolved = fit.objective.resolve_modes(fit.z)
    if resolved is not fit.objective:
        fit = refine(replace(fit, objective=resolved), options)
        if not fit.end.is_minimum or fit.iterations >= options.max_iterations:
            return fit
    fit = search_minimum(
        fit, options, tolerance=_FINE_TOLERANCE, damping=_NEAR_DAMPING, near=True, rough=True
    )
    return _refine_corrected_ahead(fit, options)


def search_minimum(
    start: Fit,
    options: WholeArmOptions,
    *,
    tolerance: float = COARSE_TOLERANCE,
    relative: float = 0.0,
    damping: float = 1e-3,
    near: bool = False,
    rough: bool = False,
    max_evaluations: int | None = None,
) -> Fit:
    """Minimise the objective of `start` with its current weights, from its iterate.

    `max_evaluations` limits the evaluations of this search. See `minimise` for the other arguments.
    Raises `NotIdentifiable` if the arm cannot be simulated at `start`.
    """
    n_remaining = options.max_iterations - start.iterations
    evaluation = count(start.iterations + 1)

    def linearise(x: FloatArray) -> Linearised | None:
        # a search that begins at the limit evaluates once more, for its cost
        number = min(next(evaluation), options.max_iterations)
        _progress.get()(number, options.max_iterations)
        return start.objective.linearise(x)

    minimum = minimise(
        linearise,
        start.z,
        start.space,
        tolerance=tolerance,
        relative=relative,
        damping=damping,
        near=near,
        rough=rough,
        max_evaluations=max(
            1, n_remaining if max_evaluations is None else min(n_remaining, max_evaluations)
        ),
        cost=start.objective.cost,
    )
    if minimum is None:
        raise NotIdentifiable("the whole-arm fit cannot simulate the arm at the start values")
    n_evaluations = start.iterations + minimum.evaluations
    return Fit(start.objective, minimum.x, minimum.at.cost, n_evaluations, minimum.end)


def _changes(old: Objective, new: Objective) -> list[FloatArray]:
    """Ratios of the errors of each record's channels."""
    return [b.stds / a.stds for a, b in zip(old.weights, new.weights, strict=True)]


def find_undescribed(fit: Fit) -> list[int]:
    """Indices of records with residuals that are large relative to a channel and to its noise.

    Whether a motor breaks away from stiction has no derivative. If it sticks in the simulation of a
    record and slides in the log, or the reverse, a search may end far from the minimum, to which
    the other records lead.
    """
    undescribed = []
    for k, (record, rows) in enumerate(
        zip(fit.objective.records, fit.objective.rows(fit.z), strict=True)
    ):
        size = np.sqrt(np.mean(rows.errors**2, axis=0))
        signal = np.std(record.measured, axis=0)
        is_large = (size > MAX_RELATIVE_RESIDUAL * signal) & (
            size > MAX_RESIDUAL_NOISE * record.noise
        )
        if is_large.any():
            undescribed.append(k)
    return undescribed


def are_exceptions(undescribed: list[int], fit: Fit) -> bool:
    """Whether some, but few, records are not described."""
    return 0 < len(undescribed) <= _MAX_UNDESCRIBED_SHARE * len(fit.objective.records)


def published_search(start: Fit, records: Sequence[Dataset], arm: Arm, budget: int) -> Fit:
    """Minimise the squared differences of link velocities within the ranges of the unknowns.

    `arm` has the sensors of `records`; of a record with an excited joint that of its link is
    compared. `budget` is the maximum number of evaluations of the derivatives.
    """
    from scipy.optimize import least_squares

    space = start.space
    measured = [_velocities(record, {}, arm) for record in records]

    def residual(z: FloatArray) -> FloatArray:
        values = space.values(z)
        parts = []
        for record, velocity in zip(records, measured, strict=True):
            motion = record.run(values, record.start(), record.quantities())
            readings = {axis.channel: axis.reading(motion, values) for axis in record.channels}
            difference = _velocities(record, readings, arm) - velocity
            parts.append((difference / np.std(velocity, axis=0)).ravel())
        return np.concatenate(parts)

    def jacobian(z: FloatArray) -> FloatArray:
        steps = np.where(z < space.upper - _DIFFERENCE_STEP, _DIFFERENCE_STEP, -_DIFFERENCE_STEP)
        points = [z, *(z + np.diag(steps))]
        at, *shifted = run_parallel([partial(residual, point) for point in points])
        return np.column_stack(
            [(one - at) / step for one, step in zip(shifted, steps, strict=True)]
        )

    search = least_squares(
        residual,
        np.clip(start.z, space.lower, space.upper),
        jacobian,
        (space.lower, space.upper),
        ftol=_PUBLISHED_TOLERANCE,
        xtol=_PUBLISHED_TOLERANCE,
        max_nfev=budget,
    )
    end = SearchEnd.CONVERGED if search.status > 0 else SearchEnd.EVALUATION_LIMIT
    objective = start.objective.replace_records(records).update_weights(search.x)
    linearised = objective.linearise(search.x)
    cost = np.inf if linearised is None else linearised.cost
    return replace(
        start, objective=objective, z=search.x, cost=cost, iterations=search.nfev, end=end
    )


def _velocities(record: Dataset, readings: Mapping[str, FloatArray], arm: Arm) -> FloatArray:
    """Velocities (n_rows, n_links) by (10) of a record with other `readings` of its sensors."""
    log = replace(record.log, channels={**record.log.channels, **readings})
    joint = log.experiment.joint
    links = slice(None) if joint is None else slice(joint - 1, joint)
    every = max(1, int(1.0 / (_ROWS_PER_PERIOD * record.cutoff_hz * log.sample_time)))
    return np.asarray(prepare_link_signals(log, arm).link_velocity[::every, links])
