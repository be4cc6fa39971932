"""Objective of the whole-arm fit: weighted residuals of all records, and the prior.

Each record has its own unknowns, the record parameters: initial states and sensor biases. They are
eliminated record by record (variable projection).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from strainwave.domain import FloatArray, IntArray
from strainwave.domain.keys import Key, Values
from strainwave.domain.results.distributions import STD_PER_MEDIAN
from strainwave.dynamics.rigid_prediction import fit_percent
from strainwave.dynamics.simulation import simulate_runs
from strainwave.errors import InvalidInput, NumericalFailure
from strainwave.identification.closed_loop import MIN_SIGNAL_TO_NOISE
from strainwave.identification.whole_arm.problem.parameter_space import ParameterSpace
from strainwave.identification.whole_arm.problem.weighted_rows import Evaluation, Rows, Weights
from strainwave.identification.whole_arm.records.dataset import Dataset, Motion
from strainwave.identification.whole_arm.records.preparation import lengthen_steps
from strainwave.numerics.linalg import triangular_factor
from strainwave.numerics.parallel import current_cluster, run_parallel
from strainwave.numerics.search import Flat, Linearised, minimise
from strainwave.numerics.spectra import estimate_rows_per_error

if TYPE_CHECKING:
    from strainwave.numerics.dask_cluster import Cluster

MIN_ERROR_SHARE = 1e-3
"""Minimum standard deviation of residuals, as a share of a channel's standard deviation.

The error of the best models is about as large.
"""

BLOCKS_PER_RECORD = 10
"""Blocks per record whose errors are assumed independent."""

_INITIAL_ERROR_SHARE = 0.1  # initial standard deviation of residuals, as a share of the channel's

# predicted cost reduction at which the search for initial states ends
_INITIAL_STATE_TOLERANCE = 0.1
ROUGH_INITIAL_STATE_TOLERANCE = 0.2
"""Relative cost reduction at which an approximate search for initial states ends."""
_MAX_INITIAL_STATE_EVALUATIONS = 12  # maximum evaluations of a search for initial states

MIN_CURVATURE_RATIO = 0.5
"""Minimum curvature of the loss relative to its weights, which is near zero far from a minimum."""

_MAX_CACHED_BYTES = 2**28  # of derivatives; those of seven joints with IMUs have a gigabyte

T = TypeVar("T")

Motions = list[Motion | None]
"""Motion of each record; None where it is not known."""


@dataclass
class _EvaluationCache:
    """Record parameters, and cached evaluations at the last point with the last weights.

    Large evaluations are cached without derivatives.
    """

    record_parameters: list[FloatArray]
    last: tuple[bytes, list[Evaluation]] | None = None
    rows: tuple[bytes, tuple[Weights, ...], list[Rows]] | None = None
    long_steps: tuple[bytes, tuple[Weights, ...], Objective] | None = None
    corrected_at: bytes | None = None  # point of the last correction of the step error
    # fetches the rows at the last point from the workers of a cluster
    remote: tuple[bytes, tuple[Weights, ...], Callable[[], list[Rows]]] | None = None


@dataclass(frozen=True, slots=True)
class AbsentEffect:
    """The arm without one of its effects, for derivatives that the effect hardly changes."""

    absent: Values  # of the effect's parameters
    size: Key
    whole: Key | None  # inertia that then includes the size

    def remove_from(self, values: Values) -> Values:
        """Values of the arm without the effect."""
        changed = values | self.absent
        if self.whole is not None:
            changed[self.whole] += values[self.size]
        return changed


@dataclass(frozen=True)
class Objective:
    """Weighted residuals of all records as a function of the unknowns."""

    space: ParameterSpace
    records: tuple[Dataset, ...]
    weights: tuple[Weights, ...]
    memory: _EvaluationCache = field(repr=False)
    has_initial_weights: bool = False  # True for initial weights, before any residuals are known
    # relative cost reduction at which the search for initial states ends
    initial_state_tolerance: float = 0.0
    # Effect without which all derivatives but those by its parameters are computed. Residuals stay
    # exact, so a search finds nearly the same minimum in a tenth of the time: with the effect, the
    # core would need dual numbers.
    without: AbsentEffect | None = None

    @classmethod
    def of(cls, space: ParameterSpace, records: Sequence[Dataset]) -> Objective:
        """Create an objective with initial weights: 1/10 of each channel's standard deviation."""
        weights = []
        for record in records:
            spread = _INITIAL_ERROR_SHARE * np.std(record.measured, axis=0)
            size = np.maximum(spread, record.noise)
            weights.append(Weights(size, np.ones(len(size))))
        record_parameters = [np.concatenate([r.start(), np.zeros(len(r.biased))]) for r in records]
        return cls(
            space,
            tuple(records),
            tuple(weights),
            _EvaluationCache(record_parameters),
            has_initial_weights=True,
        )

    def initial_states(self, k: int) -> FloatArray:
        """Current initial states (n_initial,) of record k."""
        return self.memory.record_parameters[k][: len(self.records[k].initial_states)]

    def linearise(self, z: FloatArray) -> Linearised | None:
        """Cost and least squares problem in the unknowns at z; None if the simulation fails."""
        return self._linearise(z, self._cluster)

    def _linearise(
        self, z: FloatArray, cluster: Cluster | None, motions: Motions | None = None
    ) -> Linearised | None:
        try:
            if cluster is None:
                pairs = self._map_evaluated(z, self._linearised_record, motions=motions)
                self.memory.rows = z.tobytes(), self.weights, [rows for _, rows in pairs]
                parts = [part for part, _ in pairs]
            else:
                parts = self._map_on_cluster(cluster, z, Objective._linearised_record)
        except (InvalidInput, NumericalFailure):
            return None
        cost = sum(part.cost for part in parts)
        slope, prior = self.space.linearise_prior(z)
        stacked = np.concatenate([*(p.factor for p in parts), np.column_stack([slope, prior])])
        if not np.isfinite(stacked).all():  # the derivatives of very stiff candidates overflow
            return None
        return Linearised(float(cost + np.sum(prior**2)), triangular_factor(stacked))

    def _linearised_record(self, k: int, evaluated: Evaluation) -> tuple[Linearised, Rows]:
        """Cost, factor and weighted rows of record k; its biases start the next search."""
        rows, begin = evaluated.weigh(self.weights[k]), self.initial_states(k)
        biases = rows.record_parameters[len(begin) :]
        self.memory.record_parameters[k] = np.concatenate([begin, biases])
        min_curvature_ratio = 1.0 if self.has_initial_weights else MIN_CURVATURE_RATIO
        part = Linearised(rows.cost(self.weights[k]), rows.factor(min_curvature_ratio))
        return part, replace(rows, evaluated=self._cached(evaluated))

    def _weighed_record(self, k: int, evaluated: Evaluation) -> tuple[None, Rows]:
        rows = evaluated.weigh(self.weights[k])
        return None, replace(rows, evaluated=self._cached(evaluated))

    def cost(self, z: FloatArray) -> float | None:
        """Cost at z, by simulations without derivatives if it is not cached; None if one fails."""
        if self._cached_at(z) is not None:
            costs = [rows.cost(one) for rows, one in zip(self.rows(z), self.weights, strict=True)]
            return float(sum(costs) + np.sum(self.space.linearise_prior(z)[1] ** 2))
        return self._plain_cost(z, self._without_unknowns(z))

    def _without_unknowns(self, z: FloatArray) -> Objective:
        """The objective with all values fixed to those at z."""
        keys, parameters = self.space.keys, self.space.parameters(z).tolist()
        return self.replace_unknowns(
            self.space.fix_values(dict(zip(keys, parameters, strict=True)))
        )

    def _plain_cost(
        self, z: FloatArray, known: Objective, motions: Motions | None = None
    ) -> float | None:
        """Cost at z of the objective `known`, which has these values fixed."""
        plain = known._linearise(np.zeros(0), self._cluster, motions)
        if plain is None:
            return None
        _, prior = self.space.linearise_prior(z)
        _, contained = known.space.linearise_prior(np.zeros(0))
        return float(plain.cost + np.sum(prior**2) - np.sum(contained**2))

    def rows(self, z: FloatArray) -> list[Rows]:
        """Weighted residuals of every record at z, with optimal record parameters.

        Derivatives of large problems are missing; `map_rows` has them.
        """
        self._fetch(z)
        point, cached = z.tobytes(), self.memory.rows
        if cached is not None and cached[0] == point and cached[1] is self.weights:
            return cached[2]
        pairs = self._map_evaluated(z, self._weighed_record, differentiated=False)
        rows = [row for _, row in pairs]
        self.memory.rows = point, self.weights, rows
        return rows

    def map_rows(self, z: FloatArray, work: Callable[[int, Rows], T]) -> list[T]:
        """Apply `work` to number and weighted rows of each record at z, with their derivatives.

        The derivatives of a large problem exist for as long as `work` runs.
        """
        return self._map_evaluated(
            z, lambda k, evaluated: work(k, evaluated.weigh(self.weights[k]))
        )

    def evaluate(self, z: FloatArray) -> list[Evaluation]:
        """Unweighted residuals of every record at z; derivatives of large problems are missing."""
        self._fetch(z)
        return self._map_evaluated(
            z, lambda _, evaluated: self._cached(evaluated), differentiated=False
        )

    def _cached(self, evaluated: Evaluation) -> Evaluation:
        """An evaluation as it is cached: without derivatives, if those of all records are large."""
        return evaluated.without_derivatives() if self._is_large else evaluated

    @property
    def _is_large(self) -> bool:
        """Whether the derivatives of all records are too large to be cached."""
        n_entries = sum(len(r.time) * len(r.channels) for r in self.records)
        n_bytes = n_entries * len(self.space.unknowns) * np.dtype(float).itemsize
        return n_bytes > _MAX_CACHED_BYTES

    def update_weights(self, z: FloatArray) -> Objective:
        """Update the weights from the residuals at z."""
        weights = []
        for record, rows in zip(self.records, self.rows(z), strict=True):
            minimum = np.maximum(record.noise, MIN_ERROR_SHARE * np.std(record.measured, axis=0))
            robust = STD_PER_MEDIAN * np.median(np.abs(rows.errors), axis=0)
            stds = np.maximum(np.maximum(robust, 0.5 * np.std(rows.errors, axis=0)), minimum)
            repeats = [estimate_rows_per_error(column) for column in rows.errors.T]
            weights.append(Weights(stds, np.array(repeats)))
        return replace(self, weights=tuple(weights), has_initial_weights=False)

    def forget(self) -> None:
        """Free the cached evaluations, of which arms of many joints have hundreds of megabytes."""
        self.memory.last = self.memory.rows = None
        self.memory.long_steps = self.memory.remote = None

    def free_ended(self, *ended: Objective) -> None:
        """Free the caches of objectives whose searches have ended, unless this one shares them."""
        for one in ended:
            if one.memory is not self.memory:
                one.forget()

    def replace_unknowns(self, space: ParameterSpace) -> Objective:
        """Replace the shared unknowns."""
        return replace(
            self, space=space, memory=_EvaluationCache(list(self.memory.record_parameters))
        )

    def select_records(self, *chosen: int) -> Objective:
        """Restrict the objective to some records, by their indices."""
        memory = _EvaluationCache([self.memory.record_parameters[k] for k in chosen])
        return replace(
            self,
            records=tuple(self.records[k] for k in chosen),
            weights=tuple(self.weights[k] for k in chosen),
            memory=memory,
        )

    def add_initial_states(self, k: int, start: FloatArray | None = None) -> Objective:
        """Add initial states to record k, starting at `start` or at default values."""
        record = replace(self.records[k], begins_in_motion=True)
        record_parameters = list(self.memory.record_parameters)
        biases = record_parameters[k][len(self.initial_states(k)) :]
        record_parameters[k] = np.concatenate([record.start(), biases]) if start is None else start
        records = (*self.records[:k], record, *self.records[k + 1 :])
        return replace(self, records=records, memory=_EvaluationCache(record_parameters))

    def initial_state_problem(self, k: int, z: FloatArray) -> Linearised:
        """Cost and least squares problem in the current record parameters of record k at z.

        Raises `InvalidInput` or `NumericalFailure` if the record cannot be simulated from there.
        """
        start = self.memory.record_parameters[k]
        evaluated = self._evaluate_from(self.records[k], z, start)
        return evaluated.initial_state_problem(self.weights[k])

    def correct_step_error(self, z: FloatArray) -> Objective:
        """Correct the integrator step error of all records at z."""
        if self.memory.corrected_at == z.tobytes():
            return self
        cache = replace(self.memory, record_parameters=list(self.memory.record_parameters))
        at = replace(self, memory=cache)  # what is cached of another point stays
        evaluated, values, simulated = at.evaluate(z), self.space.values(z), at.simulate(z)
        exact = at._exact_motions(values)

        def corrected(k: int, record: Dataset) -> Dataset:
            begin = at.initial_states(k)
            return record.correct_step_error(values, begin, exact[k], simulated[k])

        records = tuple(self._map_records(corrected))
        pairs = zip(evaluated, records, self.records, strict=True)
        shifted = [
            replace(e, difference=e.difference + n.step_error_correction - o.step_error_correction)
            for e, n, o in pairs
        ]
        point = z.tobytes()
        memory = _EvaluationCache(cache.record_parameters, (point, shifted), corrected_at=point)
        return replace(self, records=records, memory=memory)

    def _exact_motions(self, values: Values) -> list[Motion]:
        """Motion of every record in short steps."""
        plans = self._map_records(lambda k, one: one.plan_exact(values, self.initial_states(k)))
        return [*simulate_runs(plans)]

    def resolve_modes(self, z: FloatArray) -> Objective:
        """Shorten the steps of records to those that resolve the fastest mode at z.

        Returns the objective itself if those of all records are short enough.
        """
        values = self.space.values(z)
        records = [record.resolve_modes(values) for record in self.records]
        if all(new is old for new, old in zip(records, self.records, strict=True)):
            return self
        return self.replace_records(records).correct_step_error(z)

    def lengthen_steps(self, z: FloatArray) -> Objective:
        """Lengthen the integrator steps, with the same rows, weights and residuals at z.

        The step error at z is subtracted from each row, so near z only the derivatives have the
        error of the longer steps. Returns the objective itself if the arm cannot be simulated in
        longer steps.
        """
        cached = self.memory.long_steps
        if cached is not None and cached[0] == z.tobytes() and cached[1] is self.weights:
            return cached[2]
        rows = self.rows(z)
        record_parameters = [row.record_parameters for row in rows]
        known = self.replace_unknowns(self.space.fix_values(self.space.values(z)))

        def in_long_steps(k: int, record: Dataset) -> Dataset:
            long = lengthen_steps(record)
            n_rows = len(long.time)
            counted = None if record.is_counted is None else record.is_counted[:n_rows]
            none = np.zeros((n_rows, len(long.channels)))
            return replace(long, step_error_correction=none, is_counted=counted)

        def lengthened(k: int, long: Dataset) -> tuple[Dataset, Evaluation]:
            plain = known._evaluate_from(long, z[:0], record_parameters[k], motions[k])
            residual = rows[k].errors[: len(long.time)]
            long = replace(long, step_error_correction=residual - plain.difference)
            return long, replace(plain.without_derivatives(), difference=residual)

        try:
            longs = replace(known, records=tuple(self._map_records(in_long_steps)))
            motions = longs._plain_motions(z[:0])
            pairs = longs._map_records(lengthened)
        except (InvalidInput, NumericalFailure):
            return self
        records = tuple(record for record, _ in pairs)
        memory = _EvaluationCache(
            record_parameters, (z.tobytes(), [evaluated for _, evaluated in pairs])
        )
        long = replace(self, records=records, memory=memory)
        self.memory.long_steps = z.tobytes(), self.weights, long
        return long

    def store_step_errors(self, z: FloatArray) -> Objective:
        """Store the step errors at z, where the residuals are exact, for a later `corrected`."""
        values, simulated = self.space.values(z), self.simulate(z)
        exact = self._exact_motions(values)

        def stored(k: int, record: Dataset) -> Dataset:
            return replace(record, step_error=record.step_errors(values, exact[k], simulated[k]))

        return replace(self, records=tuple(self._map_records(stored)))

    def replace_records(self, records: Sequence[Dataset]) -> Objective:
        """Replace the rows of the records; weights and record parameters stay."""
        return replace(
            self,
            records=tuple(records),
            memory=_EvaluationCache(list(self.memory.record_parameters)),
        )

    def blocks(self) -> list[IntArray]:
        """Block number of each row, one array (n_rows,) per record, counted over all records."""
        n_rows = [len(record.time) for record in self.records]
        return [
            k * BLOCKS_PER_RECORD + np.arange(n) * BLOCKS_PER_RECORD // n
            for k, n in enumerate(n_rows)
        ]

    def fit_percentages(self, z: FloatArray) -> dict[str, dict[str, float]]:
        """Fit percentage by record and channel, 100 (1 - |y - yhat| / |y - mean(y)|).

        It is NaN for a channel that hardly exceeds its noise.
        """
        percentages = {}
        for record, rows in zip(self.records, self.rows(z), strict=True):
            fits = fit_percent(record.measured, record.measured + rows.errors)
            std = np.std(record.measured, axis=0)
            fits[std < MIN_SIGNAL_TO_NOISE * record.noise] = np.nan
            names = record.channel_names
            percentages[record.log.name] = dict(zip(names, fits.tolist(), strict=True))
        return percentages

    def _map_evaluated(
        self,
        z: FloatArray,
        work: Callable[[int, Evaluation], T],
        *,
        differentiated: bool = True,
        motions: Motions | None = None,
    ) -> list[T]:
        """Apply `work` to the evaluation of every record at z, which is cached.

        Missing derivatives are computed again if the work requires them to be `differentiated`.
        `motions` are those of the records, if they are known.
        """
        point, cached = z.tobytes(), self._cached_at(z)
        motions = motions or (self._plain_motions(z) if cached is None else [])

        def evaluate_and_apply(k: int, record: Dataset) -> tuple[Evaluation, T]:
            if cached is None:
                evaluated = self._evaluate_record(k, record, z, motions[k])
            elif cached[k].is_differentiated or not differentiated:
                evaluated = cached[k]
            else:
                evaluated = self._evaluate_from(record, z, cached[k].record_parameters)
            return self._cached(evaluated), work(k, evaluated)

        if cached is None:  # the old columns need not stay while the new ones are computed
            self.memory.last = self.memory.rows = None
        results = self._map_records(evaluate_and_apply)
        self.memory.last = point, [evaluated for evaluated, _ in results]
        return [result for _, result in results]

    def _cached_at(self, z: FloatArray) -> list[Evaluation] | None:
        """Cached evaluations at z, fetched if they are on a cluster."""
        memory, point = self.memory, z.tobytes()
        if memory.remote is not None and memory.remote[0] == point:
            _, weights, fetch = memory.remote
            memory.rows = point, weights, fetch()
            memory.last = point, [row.evaluated for row in memory.rows[2]]
        memory.remote = None
        return memory.last[1] if memory.last is not None and memory.last[0] == point else None

    @property
    def _cluster(self) -> Cluster | None:
        """The cluster on whose workers the records are evaluated, if there is one.

        A small problem takes no longer on this machine.
        """
        return current_cluster() if self._is_large else None

    def _map_on_cluster(
        self,
        cluster: Cluster,
        z: FloatArray,
        work: Callable[[Objective, int, Evaluation], tuple[T, Rows]],
    ) -> list[T]:
        """Apply `work` to the evaluation of every record at z on the workers of a cluster.

        The rows stay there until they are needed, the derivatives only as long as `work` runs.
        """
        point, cached, jobs = z.tobytes(), self._cached_at(z), []
        for k in range(len(self.records)):
            one = self.select_records(k)
            one.memory.last = None if cached is None else (point, [cached[k]])
            jobs.append((replace(one, records=()), z, work))
        if cached is None:
            self.memory.last = self.memory.rows = None
        results, fetch = cluster.map(evaluate_on_worker, self.records, jobs)
        for k, (_, record_parameters) in enumerate(results):
            self.memory.record_parameters[k] = record_parameters
        self.memory.remote = point, self.weights, fetch
        return [result for result, _ in results]

    def _fetch(self, z: FloatArray) -> None:
        """Evaluate and fetch what is not cached, if there is a cluster."""
        if (cluster := self._cluster) is not None and self._cached_at(z) is None:
            self._map_on_cluster(cluster, z, Objective._weighed_record)
            self._cached_at(z)

    def _plain_motions(self, z: FloatArray) -> Motions:
        """Motions of all records at z where there is nothing to differentiate by, else None."""
        if self.space.unknowns:
            return [None] * len(self.records)
        return _motions_of([self])[0]

    def _evaluate_record(
        self, k: int, record: Dataset, z: FloatArray, motion: Motion | None
    ) -> Evaluation:
        """Evaluate record k at z, with optimal initial states if it begins in motion."""
        if not record.begins_in_motion:
            return self._evaluate_from(record, z, self.memory.record_parameters[k], motion)
        results: dict[bytes, Evaluation] = {}

        def linearise(x: FloatArray) -> Linearised | None:
            try:
                results[x.tobytes()] = self._evaluate_from(record, z, x)
            except (InvalidInput, NumericalFailure):
                return None
            return results[x.tobytes()].initial_state_problem(self.weights[k])

        minimum = minimise(
            linearise,
            self.memory.record_parameters[k],
            Flat(),
            tolerance=_INITIAL_STATE_TOLERANCE,
            relative=self.initial_state_tolerance,
            max_evaluations=_MAX_INITIAL_STATE_EVALUATIONS,
        )
        if minimum is None:
            raise NumericalFailure(f"{record.log.name} cannot be simulated from its initial state")
        self.memory.record_parameters[k] = minimum.x
        return results[minimum.x.tobytes()]

    def _evaluate_from(
        self,
        record: Dataset,
        z: FloatArray,
        record_parameters: FloatArray,
        motion: Motion | None = None,
    ) -> Evaluation:
        """Evaluate a record at z with given record parameters (n_own,), and perhaps its motion."""
        values = self.space.values(z)
        begin = record_parameters[: len(record.initial_states)]
        channels, columns = self._linearise_motion(record, z, begin, motion)
        biases = _spread(record_parameters[len(begin) :], record)
        difference = channels + biases - record.advance_measured(values)
        if record.is_counted is not None:  # zero rows carry no information
            difference = difference * record.is_counted
            columns *= record.is_counted[..., None]
        return Evaluation(
            difference, columns, record_parameters.copy(), record.biased, record.is_counted
        )

    def _linearise_motion(
        self, record: Dataset, z: FloatArray, initial: FloatArray, motion: Motion | None
    ) -> tuple[FloatArray, FloatArray]:
        """`Dataset.linearise` by the unknowns, most of them perhaps `without`."""
        keys, without = self.space.keys, self.without
        values, slope = self.space.values(z), self.space.slope(z)
        of_effect = np.array([without is not None and key in without.absent for key in keys])
        if without is None or not of_effect.any():
            return record.linearise(values, initial, keys, motion, slope=slope)
        effect, others = ([keys[k] for k in np.flatnonzero(one)] for one in (of_effect, ~of_effect))
        channels, columns = record.linearise(values, initial, effect, slope=slope[of_effect])
        by_others = record.linearise(
            without.remove_from(values), initial, others, slope=slope[~of_effect]
        )[1]
        columns[..., len(initial) :] += by_others[..., len(initial) :]
        return channels, columns

    def simulate(self, z: FloatArray) -> list[FloatArray]:
        """Simulated channels (n_rows, n_channels) of every record at z.

        They exclude scale factors, biases and drifts.
        """
        values = self.space.values(z)
        simulated = []
        for evaluated, record in zip(self.evaluate(z), self.records, strict=True):
            shift = evaluated.record_parameters[len(record.initial_states) :]
            measured = record.advance_measured(values)
            channels = (
                evaluated.difference - _spread(shift, record) + measured - record.drifts(values)
            )
            simulated.append(channels / record.sensor_scales(values))
        return simulated

    def factor_with_columns(
        self,
        z: FloatArray,
        n_columns: int,
        columns_of: Callable[[int, Evaluation], Sequence[FloatArray]],
        prior_rows: FloatArray | None = None,
    ) -> FloatArray:
        """R of [unknowns, additional columns, residual], with optimal record parameters.

        `z` (n_unknowns,) is the end of a search. `columns_of` returns the first of the additional
        columns, arrays (n_rows, n_channels, ...), for a record number and its evaluation; the
        others are zero in the records. `prior_rows` (n_prior, n_columns) are the rows of these
        columns in the prior, zero by default.

        R has n_unknowns + n_columns + 1 columns.
        """

        def factor(k: int, evaluated: Evaluation) -> FloatArray:
            rows = evaluated.weigh(self.weights[k])
            R = rows.factor(MIN_CURVATURE_RATIO, columns_of(k, evaluated))
            missing = np.zeros((len(R), len(self.space.unknowns) + n_columns + 1 - R.shape[1]))
            return np.concatenate([R[:, :-1], missing, R[:, -1:]], axis=1)

        prior_columns, prior_residual = self.space.linearise_prior(z)
        border = np.zeros((len(prior_columns), n_columns))
        if prior_rows is not None:
            border[: len(prior_rows)] = prior_rows
        stacked = np.concatenate(
            [
                *self._map_evaluated(z, factor),
                np.column_stack([prior_columns, border, prior_residual]),
            ]
        )
        return np.asarray(np.linalg.qr(stacked, mode="r"))

    def project_columns(
        self,
        z: FloatArray,
        n_columns: int,
        columns_of: Callable[[int, Evaluation], Sequence[FloatArray]],
    ) -> tuple[FloatArray, FloatArray]:
        """R of [additional columns, residual] after elimination of the unknowns.

        The arguments are those of `factor_with_columns`. Returns the columns (n_rows, n_columns)
        and the residual (n_rows,).
        """
        n = len(self.space.unknowns)
        factor = self.factor_with_columns(z, n_columns, columns_of)[n:, n:]
        return factor[:, :-1], factor[:, -1]

    def _map_records(self, work: Callable[[int, Dataset], T]) -> list[T]:
        """Apply `work` to every record in parallel threads; simulations release the GIL."""
        return run_parallel([partial(work, k, record) for k, record in enumerate(self.records)])


def costs_of(objectives: Sequence[Objective], z: FloatArray) -> list[float | None]:
    """Costs of several objectives at z, by simulations that share registers; None if one fails."""
    known = [one._without_unknowns(z) for one in objectives]
    motions: list[Motions | None] = [None] * len(known)
    if not any(one._cluster for one in objectives):
        with suppress(InvalidInput, NumericalFailure):  # each alone then, as some do not fail
            motions = [*_motions_of(known)]
    jobs = zip(objectives, known, motions, strict=True)
    return [one._plain_cost(z, fixed, own) for one, fixed, own in jobs]


def _motions_of(objectives: Sequence[Objective]) -> list[Motions]:
    """Motions of the records of objectives without unknowns.

    None for a record that begins in motion.
    """
    motions: list[Motions] = [[None] * len(one.records) for one in objectives]
    places = [
        (i, k)
        for i, one in enumerate(objectives)
        for k, record in enumerate(one.records)
        if not record.initial_states
    ]
    if len(places) < 2:
        return motions
    none = np.zeros(0)
    values = [one.space.values(none) for one in objectives]
    plans = [partial(objectives[i].records[k].plan, values[i], none) for i, k in places]
    for (i, k), motion in zip(places, simulate_runs(run_parallel(plans)), strict=True):
        motions[i][k] = motion
    return motions


def evaluate_on_worker(
    record: Dataset, job: tuple[Objective, FloatArray, Callable[..., tuple[T, Rows]]]
) -> tuple[tuple[T, FloatArray], Rows]:
    """Work of `_map_on_cluster` on one record and its objective, without derivatives."""
    objective, z, work = job
    one = replace(objective, records=(record,))
    ((result, rows),) = one._map_evaluated(z, partial(work, one))
    rows = replace(rows, evaluated=rows.evaluated.without_derivatives())
    return (result, one.memory.record_parameters[0]), rows


def _spread(biases: FloatArray, record: Dataset) -> FloatArray:
    """Biases (n_channels,), zero where a sensor has none."""
    spread = np.zeros(len(record.channels))
    spread[list(record.biased)] = biases
    return spread
