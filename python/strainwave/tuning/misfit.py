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

from strainwave.cores import side_by_side
from strainwave.errors import InvalidInput, NumericalFailure
from strainwave.records import FloatArray, IntArray
from strainwave.tuning.replayed import Replayed
from strainwave.tuning.trust_region import Linearised
from strainwave.tuning.unknowns import Search

BLOCKS = 10
"""Stretches of a record whose errors count as independent of one another."""

_FIRST = 0.1  # of a channel's own spread: its errors' deviation before any is known
_LEAST = 1e-3  # of it: no model is better than that
_NOISE_REPEATS = 2.0  # rows of low-passed white noise that say the same, four to a period
_ROBUST = 1.4826  # standard deviation of normal errors over their median magnitude

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class Rows:
    """One record's weighted rows at one point."""

    residual: FloatArray  # (n_rows, n_channels) in deviations
    root: FloatArray  # (n_rows, n_channels) square roots of the robust weights
    shared: FloatArray  # (n_rows, n_channels, n_unknowns)
    local: FloatArray  # (n_rows, n_channels, n_own)

    def factor(self) -> FloatArray:
        """R of [local shared residual], weighted."""
        parts = [self.local, self.shared, self.residual[..., None]]
        table = np.concatenate(parts, axis=2) * self.root[..., None]
        return np.asarray(np.linalg.qr(table.reshape(-1, table.shape[2]), mode="r"))


@dataclass(frozen=True)
class Misfit:
    """Weighted differences between simulated and measured channels of all records.

    What each record has of its own is found again at every point: `own` keeps where it was last.
    """

    search: Search
    records: tuple[Replayed, ...]
    # a record: (n_channels,), deviation of its errors
    deviations: tuple[FloatArray, ...] = ()
    # and how many rows in succession say the same thing
    repeats: tuple[FloatArray, ...] = ()
    own: dict[int, FloatArray] = field(default_factory=dict)

    def cost(self, z: FloatArray) -> float:
        """Robust sum of squares, without derivatives; infinite where no arm can be simulated.

        The records' own unknowns are where the last linearisation left them, moved along with z.
        """
        try:
            parts = self._each(lambda k, record: self._cost_of(k, record, z))
        except (InvalidInput, NumericalFailure):
            return np.inf
        prior = self.search.prior.rows @ self.search.parameters(z) - self.search.prior.target
        return float(sum(parts) + np.sum(prior**2))

    def linearise(self, z: FloatArray) -> Linearised:
        """The cost with its least squares problem in the unknowns alone."""
        rows = self.rows(z)
        factors = [record.factor() for record in rows]
        costs = [self._robust(k, record.residual) for k, record in enumerate(rows)]
        below = [
            f[n:, n:] for f, n in zip(factors, map(self._n_own, range(len(rows))), strict=True)
        ]
        prior = self.search.prior.rows @ self.search.parameters(z) - self.search.prior.target
        prior_rows = np.column_stack([self.search.prior.rows @ self.search.slope(z), prior])
        stacked = np.linalg.qr(np.concatenate([*below, prior_rows]), mode="r")
        return Linearised(float(sum(costs) + np.sum(prior**2)), np.asarray(stacked))

    def rows(self, z: FloatArray) -> list[Rows]:
        """Every record's rows, its own unknowns at their best for z."""
        return self._each(lambda k, record: self._rows_of(k, record, z))

    def reweighted(self, z: FloatArray) -> Misfit:
        """With deviations and repetitions as the residuals at z show them."""
        deviations, repeats = [], []
        for record, rows, old in zip(self.records, self.rows(z), self._deviations(), strict=True):
            errors = rows.residual * old
            size = _ROBUST * np.median(np.abs(errors), axis=0)
            least = np.maximum(record.noise, _LEAST * np.std(record.measured, axis=0))
            deviations.append(np.maximum(np.maximum(size, 0.5 * np.std(errors, axis=0)), least))
            repeats.append(np.array([_repeats(column) for column in errors.T]))
        return replace(self, deviations=tuple(deviations), repeats=tuple(repeats))

    def with_search(self, search: Search) -> Misfit:
        """The same records and weights for other unknowns."""
        return replace(self, search=search)

    def blocks(self) -> list[IntArray]:
        """The stretch that each row of a record belongs to, counted through all records."""
        found = []
        for k, record in enumerate(self.records):
            n = len(record.time)
            found.append(k * BLOCKS + np.arange(n) * BLOCKS // n)
        return found

    def noise_shares(self) -> list[float]:
        """Of each record, the share of its errors' variance that its sensors' noise makes.

        Both behind the low-pass, whose rows repeat white noise by `_NOISE_REPEATS`.
        """
        found = []
        for k, record in enumerate(self.records):
            variance = self.deviation_of_rows()[k] ** 2 * self._repeated(k)
            share = _NOISE_REPEATS * record.noise**2 / variance
            found.append(float(np.clip(np.mean(share), 0.0, 1.0)))
        return found

    def _cost_of(self, k: int, record: Replayed, z: FloatArray) -> float:
        seen = record.simulated(self.search.values(z), self._begun(k, record))
        deviation = self._deviations()[k]
        residual = (self._shifted(k, record, seen) - record.measured) / deviation
        step = self._step(k, residual, _shifts(record) / deviation[:, None])
        return self._robust(k, residual + _shifts(record)[0] @ step / deviation)

    def _rows_of(self, k: int, record: Replayed, z: FloatArray) -> Rows:
        values = self.search.values(z)
        seen, tangent = record.linearised(values, self._begun(k, record), self.search.keys)
        n = len(self.search.unknowns)
        deviation = self._deviations()[k]
        shared = tangent[..., :n] @ self.search.slope(z) / deviation[:, None]
        local = np.concatenate([tangent[..., n:], _shifts(record)], axis=2) / deviation[:, None]
        residual = (self._shifted(k, record, seen) - record.measured) / deviation
        # the record's own unknowns are nearly linear: one step from where they were
        step = self._step(k, residual, local)
        self.own[k] = self._own(k, record) + step
        residual = residual + local @ step
        return Rows(residual, self._root(k, residual), shared, local)

    def _step(self, k: int, residual: FloatArray, columns: FloatArray) -> FloatArray:
        """Where a record's own unknowns go from where they are: (n_own,)."""
        root = self._root(k, residual)
        weighted = (columns * root[..., None]).reshape(residual.size, -1)
        return np.asarray(np.linalg.lstsq(weighted, -(residual * root).ravel())[0])

    def _own(self, k: int, record: Replayed) -> FloatArray:
        if k not in self.own:
            self.own[k] = np.concatenate([record.start(), np.zeros(_shifts(record).shape[2])])
        return self.own[k]

    def _n_own(self, k: int) -> int:
        return len(self._own(k, self.records[k]))

    def _begun(self, k: int, record: Replayed) -> FloatArray:
        return self._own(k, record)[: len(record.local)]

    def _shifted(self, k: int, record: Replayed, seen: FloatArray) -> FloatArray:
        constants = self._own(k, record)[len(record.local) :]
        return np.asarray(seen + _shifts(record)[0] @ constants)

    def deviation_of_rows(self) -> Sequence[FloatArray]:
        """What each channel of each record is divided by."""
        return self._deviations()

    def _deviations(self) -> Sequence[FloatArray]:
        if self.deviations:
            return self.deviations
        return [
            np.maximum(_FIRST * np.std(record.measured, axis=0), record.noise)
            for record in self.records
        ]

    def _root(self, k: int, residual: FloatArray) -> FloatArray:
        """Roots of the weights (1 + r^2)^(-1/2) of the soft L1 loss, over the repetitions."""
        return np.asarray((1.0 + residual**2) ** -0.25 / np.sqrt(self._repeated(k)))

    def _robust(self, k: int, residual: FloatArray) -> float:
        return float(np.sum(2.0 * (np.sqrt(1.0 + residual**2) - 1.0) / self._repeated(k)))

    def _repeated(self, k: int) -> FloatArray | float:
        return self.repeats[k] if self.repeats else 1.0

    def _each(self, work: Callable[[int, Replayed], T]) -> list[T]:
        """Work on every record, side by side: simulations run without the interpreter's lock."""
        return side_by_side([partial(work, k, record) for k, record in enumerate(self.records)])


def _shifts(record: Replayed) -> FloatArray:
    """Columns of the unknown constants: (1, n_channels, n_constants), the same in every row."""
    own = [k for k, channel in enumerate(record.channels) if channel.shifted]
    columns = np.zeros((len(record.channels), len(own)))
    columns[own, range(len(own))] = 1.0
    return np.broadcast_to(columns, (len(record.time), *columns.shape))


def _repeats(column: FloatArray) -> float:
    """1 + 2 sum of the autocorrelations up to the first negative one."""
    n = len(column)
    spectrum = np.fft.rfft(column - column.mean(), 2 * n)
    correlation = np.fft.irfft(np.abs(spectrum) ** 2)[: n // 2]
    if correlation[0] <= 0.0:
        return 1.0
    correlation /= correlation[0]
    negative = np.flatnonzero(correlation < 0.0)
    until = negative[0] if negative.size else len(correlation)
    return float(1.0 + 2.0 * np.sum(correlation[1:until]))
