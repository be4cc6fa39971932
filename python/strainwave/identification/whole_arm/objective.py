"""What records and prior say against parameters: weighted residuals, record by record.

Each record has unknowns of its own, the constants of its sensors and where it began, and is solved
for them on its own: they lead the columns of its least squares problem, and what its triangular
factor leaves below them is the problem of the parameters alone.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TypeVar

import numpy as np

from strainwave.domain import ComplexArray, FloatArray, IntArray
from strainwave.errors import InvalidInput, NumericalFailure
from strainwave.identification.whole_arm.dataset import Dataset
from strainwave.identification.whole_arm.parametrisation import ParameterSpace
from strainwave.identification.whole_arm.preparation import in_long_steps
from strainwave.numerics.linalg import triangular_factor
from strainwave.numerics.parallel import side_by_side
from strainwave.numerics.trust_region import Flat, Linearised, minimise

LEAST_ERROR = 1e-3
"""Of a channel's spread: no model is better than that."""

BLOCKS = 10
"""Stretches of a record whose errors count as independent of one another."""

_MOVES = 10.0  # times its noise: below that a fit would judge the sensor, not the model
_FIRST = 0.1  # of a channel's own spread: its errors' deviation before any is known
_ROBUST = 1.4826  # standard deviation of normal errors over their median magnitude

_ROUNDS = 6  # of robust weights in which a record's own unknowns are solved for
_STAYS = 1e-3  # deviations by which another round moves nothing that matters
_BEGUN = 0.1  # gain still predicted of moving a beginning, in units of the cost
ROUGH_BEGINNING = 0.2
"""The same as a share of the cost, where the beginning need only be known roughly."""
_BEGINNINGS = 12  # of a record that are tried for one point

LEAST_BEND = 0.5
"""Of the loss beside its weights: far from a minimum it hardly bends at all."""

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class Weights:
    """What a record's errors are measured by, channel by channel."""

    deviation: FloatArray  # (n_channels,) of its errors
    repeats: FloatArray  # (n_channels,) rows in succession that say the same thing


@dataclass(frozen=True, slots=True)
class Evaluated:
    """One record at one point: differences in the channels' units, with derivatives."""

    difference: FloatArray  # (n_rows, n_channels) simulated less measured
    columns: FloatArray  # (n_rows, n_channels, n_own + n_unknowns) by its own, then by the shared
    own: FloatArray  # (n_own,) where the record's own unknowns are

    @property
    def n_own(self) -> int:
        """Unknowns of the record alone."""
        return len(self.own)

    @property
    def local(self) -> FloatArray:
        """By the record's own unknowns: (n_rows, n_channels, n_own)."""
        return self.columns[..., : self.n_own]

    @property
    def shared(self) -> FloatArray:
        """By the coordinates: (n_rows, n_channels, n_unknowns)."""
        return self.columns[..., self.n_own :]

    def beginning(self, weights: Weights) -> Linearised:
        """The cost with its least squares problem in the record's own unknowns alone."""
        residual = self.difference / weights.deviation
        root = np.sqrt(_weight(residual, weights))
        table = np.concatenate(
            [self.local / weights.deviation[:, None], residual[..., None]], axis=2
        )
        table = table * root[..., None]
        factor = triangular_factor(table.reshape(-1, table.shape[2]))
        return Linearised(_loss(residual, weights), factor)

    def weighted(self, weights: Weights) -> Rows:
        """Divided by their deviations, the record's own unknowns at their best."""
        begun = self.difference / weights.deviation
        columns = (self.local / weights.deviation[:, None]).reshape(begun.size, -1)
        residual, weight = begun, _weight(begun, weights)
        step = np.zeros(self.n_own)
        apart = bool(self.n_own) and int(np.count_nonzero(columns, axis=1).max()) == 1
        for _ in range(_ROUNDS if self.n_own else 0):
            step = _solved(columns, -begun.ravel(), weight.ravel(), apart=apart)
            before, residual = residual, begun + (columns @ step).reshape(begun.shape)
            weight = _weight(residual, weights)
            if np.max(np.abs(residual - before)) < _STAYS:
                break
        return Rows(residual, np.sqrt(weight), self, weights.deviation, step)


@dataclass(frozen=True, slots=True)
class Rows:
    """One record's weighted rows."""

    residual: FloatArray  # (n_rows, n_channels) in deviations
    root: FloatArray  # (n_rows, n_channels) square roots of the robust weights
    evaluated: Evaluated
    deviation: FloatArray  # (n_channels,)
    step: FloatArray  # (n_own,) by which the record's own unknowns have moved

    @property
    def local(self) -> FloatArray:
        """By the record's own unknowns, in deviations: (n_rows, n_channels, n_own)."""
        return np.asarray(self.evaluated.local / self.deviation[:, None])

    @property
    def shared(self) -> FloatArray:
        """By the coordinates, in deviations: (n_rows, n_channels, n_unknowns)."""
        return np.asarray(self.evaluated.shared / self.deviation[:, None])

    def factor(self, least_bend: float) -> FloatArray:
        """R of [shared residual] in what the record's own unknowns cannot imitate.

        R stands for the loss's slope and for how it bends on the whole: by less than the weights
        (1 + r^2)^(-1/2) that give its slope, with which steps would be a third too short.
        """
        square = self.root**2
        bend = np.sum(square / (1.0 + self.residual**2), axis=0) / np.sum(square, axis=0)
        bend = np.sqrt(np.maximum(bend, least_bend))
        columns, n = self.evaluated.columns, len(self.step)
        table = np.empty((*self.residual.shape, columns.shape[2] + 1))
        scale = self.root * (bend / self.deviation)
        np.multiply(columns, scale[..., None], out=table[..., :-1])
        np.multiply(self.residual, self.root / bend, out=table[..., -1])
        return triangular_factor(table.reshape(-1, table.shape[2]))[n:, n:]

    def cost(self, weights: Weights) -> float:
        """The soft L1 loss."""
        return _loss(self.residual, weights)

    def costs(self, weights: Weights) -> FloatArray:
        """That of each channel, (n_channels,)."""
        return _losses(self.residual, weights)


@dataclass
class _Memory:
    """Where the records' own unknowns are, and the last point looked at, by the last weights."""

    own: list[FloatArray]
    last: tuple[bytes, list[Evaluated]] | None = None
    rows: tuple[bytes, tuple[Weights, ...], list[Rows]] | None = None
    long: tuple[bytes, tuple[Weights, ...], Objective] | None = None  # `in_long_steps`

    def shift(self, k: int, n_begin: int, best: FloatArray) -> None:
        """Begin the next search for a record's constants where the last one ended."""
        self.own[k] = np.concatenate([self.own[k][:n_begin], best[n_begin:]])


@dataclass(frozen=True)
class Objective:
    """Weighted differences between simulated and measured channels of all records."""

    space: ParameterSpace
    records: tuple[Dataset, ...]
    weights: tuple[Weights, ...]
    memory: _Memory = field(repr=False)
    guessed: bool = False  # whether the weights know nothing of the errors yet
    # share of a record's cost that a better beginning may still gain where its search ends
    beginning_tolerance: float = 0.0

    @classmethod
    def of(cls, space: ParameterSpace, records: Sequence[Dataset]) -> Objective:
        """Before anything is known of the errors: a tenth of what each channel shows."""
        weights = []
        for record in records:
            spread = _FIRST * np.std(record.measured, axis=0)
            size = np.maximum(spread, record.noise)
            weights.append(Weights(size, np.ones(len(size))))
        own = [np.concatenate([r.start(), np.zeros(_shifts(r).shape[1])]) for r in records]
        return cls(space, tuple(records), tuple(weights), _Memory(own), guessed=True)

    def linearise(self, z: FloatArray) -> Linearised | None:
        """The cost with its least squares problem in the unknowns; None where no arm can be."""
        least = 1.0 if self.guessed else LEAST_BEND

        def linearised(k: int, evaluated: Evaluated) -> tuple[Rows, Linearised]:
            rows = evaluated.weighted(self.weights[k])
            self.memory.shift(k, len(self.records[k].local), evaluated.own + rows.step)
            return rows, Linearised(rows.cost(self.weights[k]), rows.factor(least))

        try:
            found = self._at(z, linearised)
        except (InvalidInput, NumericalFailure):
            return None
        self.memory.rows = z.tobytes(), self.weights, [rows for rows, _ in found]
        parts = [part for _, part in found]
        cost = sum(part.cost for part in parts)
        slope, prior = self.space.beforehand(z)
        stacked = np.concatenate([*(p.factor for p in parts), np.column_stack([slope, prior])])
        if not np.isfinite(stacked).all():  # a candidate so stiff that its derivatives overflow
            return None
        return Linearised(float(cost + np.sum(prior**2)), triangular_factor(stacked))

    def rows(self, z: FloatArray) -> list[Rows]:
        """Every record's rows, its own unknowns at their best for z."""
        at, known = z.tobytes(), self.memory.rows
        if known is not None and known[0] == at and known[1] is self.weights:
            return known[2]
        rows = self._at(z, lambda k, evaluated: evaluated.weighted(self.weights[k]))
        self.memory.rows = at, self.weights, rows
        return rows

    def evaluate(self, z: FloatArray) -> list[Evaluated]:
        """Every record at z."""
        return self._at(z, lambda _, evaluated: evaluated)

    def reweighted(self, z: FloatArray) -> Objective:
        """With deviations and repetitions as the residuals at z show them."""
        weights = []
        for record, rows, old in zip(self.records, self.rows(z), self.weights, strict=True):
            errors = rows.residual * old.deviation
            least = np.maximum(record.noise, LEAST_ERROR * np.std(record.measured, axis=0))
            size = np.maximum(_size(errors), least)
            weights.append(Weights(size, np.array([repeats_of(column) for column in errors.T])))
        return replace(self, weights=tuple(weights), guessed=False)

    def for_unknowns(self, space: ParameterSpace) -> Objective:
        """The same records and weights for other unknowns."""
        return replace(self, space=space, memory=_Memory(list(self.memory.own)))

    def only(self, k: int) -> Objective:
        """One of the records by itself."""
        memory = _Memory([self.memory.own[k]])
        return replace(
            self, records=self.records[k : k + 1], weights=self.weights[k : k + 1], memory=memory
        )

    def in_motion(self, k: int, own: FloatArray | None = None) -> Objective:
        """One of the records begun in motion, at a first guess or where its own unknowns are."""
        record, known = replace(self.records[k], moving=True), list(self.memory.own)
        constants = known[k][len(self.records[k].local) :]
        known[k] = np.concatenate([record.start(), constants]) if own is None else own
        records = (*self.records[:k], record, *self.records[k + 1 :])
        return replace(self, records=records, memory=_Memory(known))

    def corrected(self, z: FloatArray) -> Objective:
        """With the error of the integrator's step made good as it is at z."""
        evaluated, values = self.evaluate(z), self.space.values(z)

        def corrected(k: int, record: Dataset) -> Dataset:
            return record.corrected(values, self.memory.own[k][: len(record.local)])

        records = tuple(self._each(corrected))
        pairs = zip(evaluated, records, self.records, strict=True)
        moved = [replace(e, difference=e.difference + n.lacking - o.lacking) for e, n, o in pairs]
        memory = _Memory(list(self.memory.own), (z.tobytes(), moved))
        return replace(self, records=records, memory=memory)

    def in_long_steps(self, z: FloatArray) -> Objective:
        """The same rows, weights and residuals at z, with arms simulated in longer steps.

        The difference between the steps at z is a constant of each row, so near z only the
        derivatives have the error of the longer steps. The result is the objective itself where
        such steps are too long for the arm.
        """
        known = self.memory.long
        if known is not None and known[0] == z.tobytes() and known[1] is self.weights:
            return known[2]
        rows = self.rows(z)
        owns = [each.evaluated.own + each.step for each in rows]

        def lengthened(k: int, record: Dataset) -> tuple[Dataset, Evaluated]:
            long = in_long_steps(record)
            n_rows = len(long.time)
            residual = (rows[k].residual * self.weights[k].deviation)[:n_rows]
            counted = None if record.counted is None else record.counted[:n_rows]
            long = replace(long, lacking=np.zeros_like(residual), counted=counted)
            there = self._begun(long, z, owns[k])
            if not np.isfinite(there.columns).all():
                raise NumericalFailure("the derivatives overflow in long steps")
            long = replace(long, lacking=residual - there.difference)
            return long, replace(there, difference=residual)

        try:
            pairs = self._each(lengthened)
        except (InvalidInput, NumericalFailure):
            return self
        records = tuple(record for record, _ in pairs)
        memory = _Memory(owns, (z.tobytes(), [there for _, there in pairs]))
        long = replace(self, records=records, memory=memory)
        self.memory.long = z.tobytes(), self.weights, long
        return long

    def with_step_errors(self, z: FloatArray) -> Objective:
        """The same residuals, ready for `corrected` elsewhere: they are correct at z."""
        values = self.space.values(z)

        def known(k: int, record: Dataset) -> Dataset:
            return record.with_step_error(values, self.memory.own[k][: len(record.local)])

        return replace(self, records=tuple(self._each(known)))

    def seen_by(self, records: Sequence[Dataset]) -> Objective:
        """The same weights and beginnings for other rows of the same records."""
        return replace(self, records=tuple(records), memory=_Memory(list(self.memory.own)))

    def blocks(self) -> list[IntArray]:
        """The stretch that each row of a record belongs to, counted through all records."""
        found = []
        for k, record in enumerate(self.records):
            n = len(record.time)
            found.append(k * BLOCKS + np.arange(n) * BLOCKS // n)
        return found

    def noise_shares(self, z: FloatArray) -> list[float]:
        """Of each record, the share of its errors' variance at z that its sensors' noise makes.

        A channel that errs by less than that, as one at standstill does, makes up for no other.
        """
        found = []
        every = zip(self.records, self.weights, self.rows(z), strict=True)
        for record, weights, rows in every:
            size = np.maximum(_size(rows.residual * weights.deviation), record.noise)
            repeats = repetitions_of(record)
            share = np.divide(record.noise, size, out=np.ones_like(size), where=size > 0.0) ** 2
            share = np.minimum(1.0, share * repeats / weights.repeats)
            found.append(float(np.mean(share)))
        return found

    def fits(self, z: FloatArray) -> dict[str, dict[str, float]]:
        """By record and channel, 100 (1 - |difference| / |measured - mean|); NaN if it rests."""
        found = {}
        for record, rows, weights in zip(self.records, self.rows(z), self.weights, strict=True):
            difference = np.linalg.norm(rows.residual * weights.deviation, axis=0)
            spread = np.linalg.norm(record.measured - record.measured.mean(axis=0), axis=0)
            still = spread < _MOVES * record.noise * np.sqrt(len(record.time))
            fits = 100.0 * (1.0 - difference / np.where(still, np.nan, spread))
            names = [channel.name.replace("theta", "omega") for channel in record.channels]
            found[record.log.name] = dict(zip(names, fits.tolist(), strict=True))
        return found

    def _at(self, z: FloatArray, work: Callable[[int, Evaluated], T]) -> list[T]:
        """Work on every record at z; what was looked at last is remembered."""
        at, last = z.tobytes(), self.memory.last
        known = last[1] if last is not None and last[0] == at else None

        def both(k: int, record: Dataset) -> tuple[Evaluated, T]:
            evaluated = known[k] if known is not None else self._evaluated(k, record, z)
            return evaluated, work(k, evaluated)

        found = self._each(both)
        self.memory.last = at, [evaluated for evaluated, _ in found]
        return [made for _, made in found]

    def _evaluated(self, k: int, record: Dataset, z: FloatArray) -> Evaluated:
        """A record at z; if it begins in motion, begun where it fits best."""
        if not record.moving:
            return self._begun(record, z, self.memory.own[k])
        seen: dict[bytes, Evaluated] = {}

        def linearise(own: FloatArray) -> Linearised | None:
            try:
                seen[own.tobytes()] = self._begun(record, z, own)
            except (InvalidInput, NumericalFailure):
                return None
            return seen[own.tobytes()].beginning(self.weights[k])

        own = self.memory.own[k]
        found = minimise(
            linearise,
            own,
            Flat(),
            tolerance=_BEGUN,
            relative=self.beginning_tolerance,
            max_evaluations=_BEGINNINGS,
        )
        if found is None:
            raise NumericalFailure(f"{record.log.name} cannot be simulated from where it begins")
        self.memory.own[k] = found.x
        return seen[found.x.tobytes()]

    def _begun(self, record: Dataset, z: FloatArray, own: FloatArray) -> Evaluated:
        n_begin, n = len(record.local), len(self.space.unknowns)
        values = self.space.values(z)
        seen, tangent = record.linearised(values, own[:n_begin], self.space.keys)
        shifts = _shifts(record)
        columns = np.empty((*seen.shape, len(own) + n))
        columns[..., :n_begin] = tangent[..., n:]
        columns[..., n_begin : len(own)] = shifts
        columns[..., len(own) :] = tangent[..., :n] @ self.space.slope(z)
        difference = seen + shifts @ own[n_begin:] - record.observed(values)
        if record.counted is not None:  # rows of zeros say nothing
            difference = difference * record.counted
            columns *= record.counted[..., None]
        return Evaluated(difference, columns, own.copy())

    def simulated(self, z: FloatArray) -> list[FloatArray]:
        """What every record's sensors would read at z without scales and constants of their own.

        (n_rows, n_channels) each.
        """
        values = self.space.values(z)
        found = []
        for one, record in zip(self.evaluate(z), self.records, strict=True):
            shift = _shifts(record) @ one.own[len(record.local) :]
            read = one.difference - shift + record.observed(values) - record.drifts(values)
            found.append(read / record.sensor_scales(values))
        return found

    def bordered(
        self,
        z: FloatArray,
        n_more: int,
        more: Callable[[int, Evaluated], FloatArray],
        beforehand: FloatArray | None = None,
    ) -> FloatArray:
        """R of [unknowns more residual], the records' own unknowns at their best.

        `z` (n_unknowns,): Where a search ended.
        `n_more`: Columns of parameters that are no unknowns.
        `more`: Of a record's number and its evaluation, those columns: (n_rows, n_channels,
            n_more).
        `beforehand` (n_prior, n_more): The same of what the rigid step knows; zero without.

        Returns: (n_unknowns + n_more + 1,): From row n_unknowns on it is that of [more residual] in
        what the unknowns cannot imitate.
        """
        evaluated = self.evaluate(z)

        def factor(k: int, _: Dataset) -> FloatArray:
            columns = np.concatenate([evaluated[k].columns, more(k, evaluated[k])], axis=2)
            whole = replace(evaluated[k], columns=columns)
            return whole.weighted(self.weights[k]).factor(LEAST_BEND)

        known, off = self.space.beforehand(z)
        border = np.zeros((len(known), n_more))
        if beforehand is not None:
            border[: len(beforehand)] = beforehand
        stacked = np.concatenate([*self._each(factor), np.column_stack([known, border, off])])
        return np.asarray(np.linalg.qr(stacked, mode="r"))

    def _each(self, work: Callable[[int, Dataset], T]) -> list[T]:
        """Work on every record, side by side: simulations run without the interpreter's lock."""
        return side_by_side([partial(work, k, record) for k, record in enumerate(self.records)])


def _solved(
    columns: FloatArray, target: FloatArray, weight: FloatArray, *, apart: bool
) -> FloatArray:
    """Weighted least squares; of columns that no row has two of, each is a weighted mean."""
    if not apart:
        root = np.sqrt(weight)
        return np.asarray(np.linalg.lstsq(columns * root[:, None], target * root)[0])
    weighed = columns * weight[:, None]
    return np.asarray((target @ weighed) / np.einsum("ij,ij->j", columns, weighed))


def _loss(residual: FloatArray, weights: Weights) -> float:
    """Sum of 2 (sqrt(1 + r^2) - 1), over the repetitions."""
    return float(np.sum(_losses(residual, weights)))


def _losses(residual: FloatArray, weights: Weights) -> FloatArray:
    """The same of each channel, (n_channels,)."""
    loss = np.sum(2.0 * (np.sqrt(1.0 + residual**2) - 1.0), axis=0)
    return np.asarray(loss / weights.repeats)


def _weight(residual: FloatArray, weights: Weights) -> FloatArray:
    """Weights (1 + r^2)^(-1/2) of the soft L1 loss, over the repetitions."""
    return np.asarray(1.0 / (np.sqrt(1.0 + residual**2) * weights.repeats))


def _shifts(record: Dataset) -> FloatArray:
    """Columns of the unknown constants, alike in every row: (n_channels, n_constants)."""
    own = [k for k, channel in enumerate(record.channels) if channel.shifted]
    columns = np.zeros((len(record.channels), len(own)))
    columns[own, range(len(own))] = 1.0
    return columns


def _size(errors: FloatArray) -> FloatArray:
    """Standard deviations without a few large errors, of (n_rows, n_channels): (n_channels,)."""
    typical = _ROBUST * np.median(np.abs(errors), axis=0)
    return np.asarray(np.maximum(typical, 0.5 * np.std(errors, axis=0)))


def repeats_of(column: FloatArray) -> float:
    """How many errors in succession say the same thing.

    `column` (n_rows,).
    """
    return repetitions(lagged_products(column)[1][: len(column) // 2])


def lagged_products(column: FloatArray) -> tuple[ComplexArray, FloatArray]:
    """The spectrum of a series with as many zeros behind it, and its autocovariances.

    `column` (n,).

    Returns: `spectrum` (n + 1,): Without the mean. `autocovariance` (n,): Times n, from lag zero
    on.
    """
    n = len(column)
    spectrum = np.asarray(np.fft.rfft(column - column.mean(), 2 * n))
    return spectrum, np.fft.irfft(np.abs(spectrum) ** 2, 2 * n)[:n]


def lagged(taps: FloatArray, step: int) -> FloatArray:
    """Autocovariances, row by row, of white noise of deviation one behind a filter.

    `taps` (n_taps,).
    `step`: Samples from row to row.

    Returns: (n_lags,): From lag zero on.
    """
    return np.array([taps[: len(taps) - k] @ taps[k:] for k in range(0, len(taps), step)])


def repetitions_of(record: Dataset) -> FloatArray:
    """How many rows in succession say the same thing of white noise behind each channel's low-pass.

    Returns: (n_channels,).
    """
    kernels = [record.kernels.taps(rate=channel.rate) for channel in record.channels]
    return np.array([repetitions(lagged(k, record.kernels.step)) for k in kernels])


def repetitions(covariance: FloatArray) -> float:
    """1 + 2 sum of the autocorrelations up to the first negative one.

    `covariance` (n_lags,): From lag zero on.
    """
    if covariance[0] <= 0.0:
        return 1.0
    correlation = covariance / covariance[0]
    negative = np.flatnonzero(correlation < 0.0)
    until = negative[0] if negative.size else len(correlation)
    return float(1.0 + 2.0 * np.sum(correlation[1:until]))
