"""Output-error fit of all segments: simulated closed loops against measured angles.

The initial state of each segment is eliminated from its rows, so that the search has the unknowns
of arm and servo alone (variable projection). Segments are weighted by their own residuals: beyond
the torque limit, errors of the model are larger than the resolution of the encoder.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from strainwave.domain import BoolArray, FloatArray, SearchEnd
from strainwave.domain.keys import Key, Values
from strainwave.errors import InvalidInput, NumericalFailure
from strainwave.identification.position_servo.loop import LIMIT, LoopInputs, ServoLoop
from strainwave.identification.position_servo.records import Segment
from strainwave.identification.position_servo.states import MIN_STATE_EFFECT
from strainwave.numerics.linalg import triangular_factor
from strainwave.numerics.parallel import run_parallel
from strainwave.numerics.search import Linearised, minimise

_STEP = 1e-3  # of differences, over the scale of an unknown
_TOLERANCE, _RELATIVE_TOLERANCE = 0.1, 1e-5  # of the cost: a third of a standard deviation
_MAX_EVALUATIONS = 25  # per pass; the weights change between passes


@dataclass(frozen=True, slots=True)
class Unknown:
    """An unknown of the fit, which may be the value of several keys, with its range."""

    keys: tuple[Key, ...]
    scale: float
    low: float = -np.inf
    high: float = np.inf


@dataclass(frozen=True, slots=True)
class Prior:
    """A combination of values with mean and standard deviation."""

    weights: tuple[tuple[Key, float], ...]
    mean: float
    std: float


@dataclass(frozen=True, slots=True, eq=False)
class SegmentRows:
    """Rows of one segment after elimination of its initial state, in standard deviations."""

    residual: FloatArray  # (n_rows,) predicted minus measured
    jacobian: FloatArray  # (n_rows, n_unknowns)
    # best change of the state per change of the unknowns, and, last, as it is
    to_state: FloatArray  # (n_states, n_unknowns + 1)
    of_state: FloatArray  # (n_rows, n_states) orthonormal: what the initial state explains
    saturated: BoolArray  # (n_joints,) whether the output reaches its limit


def cost_of(segments: Sequence[Segment], deviations: FloatArray) -> float:
    """Cost of residuals (n_segments, n_joints) [rad]; see `ServoFit.cost`."""
    counts = np.array([len(segment.time) for segment in segments])
    return float(np.sum(2.0 * counts[:, None] * np.log(deviations)))


@dataclass(frozen=True, slots=True, eq=False)
class ServoFit:
    """Values at the minimum, and the rows of all segments there."""

    loop: ServoLoop
    unknowns: tuple[Unknown, ...]
    priors: tuple[Prior, ...]
    values: Values
    segments: tuple[Segment, ...]
    states: tuple[FloatArray, ...]  # (n_states,) each
    rows: tuple[SegmentRows, ...]
    deviations: FloatArray  # (n_segments, n_joints) [rad] of the residuals
    resolution: float  # [rad] of the angles: the least deviation
    end: SearchEnd
    has_rival_effect: bool = False  # another effect of a gear explains a part of the residuals too
    rival_changes: tuple[Values, ...] = ()  # by other choices that explain as much

    @property
    def cost(self) -> float:
        """Minus twice the log-likelihood, up to a constant, with one variance per segment."""
        return cost_of(self.segments, self.deviations)

    @property
    def x(self) -> FloatArray:
        """Values of the unknowns."""
        return np.array([self.values[unknown.keys[0]] for unknown in self.unknowns])

    @property
    def misfit(self) -> float:
        """Median ratio of the residuals to the resolution of the angles; 1 or more."""
        return float(max(np.median(self.deviations) / self.resolution, 1.0))

    @property
    def saturated(self) -> BoolArray:
        """Whether the output of each joint reaches its limit in any segment."""
        return np.asarray(np.any([rows.saturated for rows in self.rows], axis=0))

    def rival_rows(self) -> FloatArray:
        """Changes of the unknowns by rivals, (n_rivals, n_unknowns)."""
        keys = [unknown.keys[0] for unknown in self.unknowns]
        rows = [[change.get(key, 0.0) for key in keys] for change in self.rival_changes]
        return np.array(rows).reshape(-1, len(keys))

    def as_guess(self) -> Guess:
        """Start of another fit of the same segments."""
        return Guess(self.values, self.segments, self.states, self.deviations)

    def prior_rows(self) -> FloatArray:
        """Rows of the priors, (n_priors, n_unknowns), in standard deviations."""
        return _prior_rows(self.priors, self.unknowns)


def _prior_rows(priors: Sequence[Prior], unknowns: Sequence[Unknown]) -> FloatArray:
    rows = np.zeros((len(priors), len(unknowns)))
    for row, prior in zip(rows, priors, strict=True):
        for key, weight in prior.weights:
            for k, unknown in enumerate(unknowns):
                if key in unknown.keys:
                    row[k] += weight / prior.std
    return rows


@dataclass
class _Problem:
    """Rows of all segments at a point, from the states of the best point so far."""

    loop: ServoLoop
    segments: Sequence[Segment]
    unknowns: Sequence[Unknown]
    priors: Sequence[Prior]
    fixed: Values
    deviations: FloatArray
    states: Sequence[FloatArray]
    at: FloatArray  # the point of `rows`
    rows: list[SegmentRows] = field(default_factory=list)
    best: float = np.inf

    def values(self, x: FloatArray) -> Values:
        pairs = zip(self.unknowns, x.tolist(), strict=True)
        return self.fixed | {key: value for unknown, value in pairs for key in unknown.keys}

    def linearise(self, x: FloatArray) -> Linearised | None:
        states = self._states(x)
        try:
            rows = self._rows(x, states)
        except (NumericalFailure, InvalidInput):
            return None
        tables = [np.column_stack([r.jacobian, r.residual]) for r in rows]
        priors = _prior_rows(self.priors, self.unknowns)
        tables.append(np.column_stack([priors, self._prior_residuals(x)]))
        table = np.vstack(tables)
        cost = float(np.sum(table[:, -1] ** 2))
        if cost < self.best:
            self.best, self.at, self.rows, self.states = cost, x, rows, states
        return Linearised(cost, triangular_factor(table))

    def simulate(self, x: FloatArray) -> float | None:
        """Cost at a point, of which the states explain as much as at the best point."""
        values, pieces = self.values(x), zip(self.segments, self._states(x), strict=True)
        try:
            inputs = {id(s.record): self.loop.prepare(values, s.record) for s in self.segments}
            jobs = [partial(self.loop.simulate, inputs[id(s.record)], *(s, x)) for s, x in pieces]
            angles = [run.angle for run in run_parallel(jobs)]
        except (NumericalFailure, InvalidInput):
            return None
        cost = float(np.sum(self._prior_residuals(x) ** 2))
        parts = zip(self.segments, self.rows, angles, self.deviations, strict=True)
        for segment, rows, angle, size in parts:
            residual = ((angle - segment.angle) / size).ravel()
            cost += float(np.sum((residual - rows.of_state @ (rows.of_state.T @ residual)) ** 2))
        return cost if np.isfinite(cost) else None

    def _states(self, x: FloatArray) -> list[FloatArray]:
        """Initial states (n_states,) that follow the values, as at the best point."""
        if not self.rows:
            return list(self.states)
        step = np.append(x - self.at, 1.0)
        moved = zip(self.states, self.rows, strict=True)
        return [state + rows.to_state @ step for state, rows in moved]

    def _prior_residuals(self, x: FloatArray) -> FloatArray:
        values = self.values(x)
        sums = [sum(w * values[key] for key, w in prior.weights) for prior in self.priors]
        pairs = zip(sums, self.priors, strict=True)
        return np.array([(value - prior.mean) / prior.std for value, prior in pairs])

    def _rows(self, x: FloatArray, states: Sequence[FloatArray]) -> list[SegmentRows]:
        """Rows of all segments; derivatives by values of the servo are differences."""
        values, loop = self.values(x), self.loop
        records = {id(s.record): s.record for s in self.segments}
        base = {k: loop.prepare(values, record) for k, record in records.items()}
        changed: dict[int, dict[int, LoopInputs]] = {}
        steps = {}
        for j, (unknown, value) in enumerate(zip(self.unknowns, x.tolist(), strict=True)):
            if loop.row(unknown.keys[0], next(iter(base.values()))) is None:
                step = _STEP * unknown.scale * (-1.0 if value + unknown.scale > unknown.high else 1)
                steps[j] = step
                other = values | dict.fromkeys(unknown.keys, value + step)
                changed[j] = {k: loop.prepare(other, r, base[k]) for k, r in records.items()}
        weights = {k: self._weights(inputs) for k, inputs in base.items()}
        jobs = []
        for k, segment in enumerate(self.segments):
            own = {j: each[id(segment.record)] for j, each in changed.items()}
            at = id(segment.record)
            jobs.append(partial(self._rows_of, k, base[at], weights[at], own, steps, states[k]))
        return run_parallel(jobs)

    def _weights(self, inputs: LoopInputs) -> dict[Key, FloatArray]:
        """Derivatives (n_unknowns,) of the core's parameters that depend on the unknowns."""
        weights: dict[Key, FloatArray] = {}
        for j, unknown in enumerate(self.unknowns):
            for key in unknown.keys:
                for part, weight in (self.loop.row(key, inputs) or {}).items():
                    if weight != 0.0:
                        weights.setdefault(part, np.zeros(len(self.unknowns)))[j] += weight
        return weights

    def _rows_of(
        self,
        k: int,
        inputs: LoopInputs,
        weights: dict[Key, FloatArray],
        changed: dict[int, LoopInputs],
        steps: dict[int, float],
        state: FloatArray,
    ) -> SegmentRows:
        loop, segment, size = self.loop, self.segments[k], self.deviations[k]
        run = loop.simulate(inputs, segment, state, list(weights))
        stacked = run.derivatives[..., : -loop.n_states] @ np.array(list(weights.values()))
        for j, other in changed.items():
            name, joint = self.unknowns[j].keys[0]
            if name == LIMIT and not run.saturated[(joint or 1) - 1]:
                continue
            angle = loop.simulate(other, segment, state).angle
            stacked[..., j] = (angle - run.angle) / steps[j]
        stacked /= size[:, None]
        of_state = (run.derivatives[..., -loop.n_states :] / size[:, None]).reshape(
            -1, loop.n_states
        )
        residual = ((run.angle - segment.angle) / size).reshape(-1, 1)
        right = np.hstack([stacked.reshape(len(residual), -1), residual])
        if not (np.isfinite(right).all() and np.isfinite(of_state).all()):
            raise NumericalFailure("the simulation of the servos diverges")
        Q, R = np.linalg.qr(of_state)
        onto = Q.T @ right
        to_state = -np.linalg.lstsq(R, onto, rcond=MIN_STATE_EFFECT)[0]
        right = right - Q @ onto
        return SegmentRows(right[:, -1], right[:, :-1], to_state, Q, run.saturated)


@dataclass(frozen=True, slots=True)
class _Box:
    """Space of the unknowns."""

    low: FloatArray
    high: FloatArray
    reach: FloatArray  # of one step

    def move(self, x: FloatArray, step: FloatArray) -> FloatArray:
        return np.clip(x + step, self.low, self.high)

    def at_bounds(self, x: FloatArray, gradient: FloatArray) -> BoolArray:
        return ((x <= self.low) & (gradient > 0.0)) | ((x >= self.high) & (gradient < 0.0))

    def limit_step(self, x: FloatArray, step: FloatArray, share: float) -> FloatArray:
        reach = share * self.reach
        return np.clip(x + np.clip(step, -reach, reach), self.low, self.high) - x


@dataclass(frozen=True, slots=True, eq=False)
class Guess:
    """Where a fit starts: values, states and residuals of the segments."""

    values: Values
    segments: tuple[Segment, ...]
    states: tuple[FloatArray, ...]
    deviations: FloatArray  # (n_segments, n_joints) [rad]


def fit_segments(
    loop: ServoLoop,
    guess: Guess,
    unknowns: Sequence[Unknown],
    priors: Sequence[Prior],
    resolution: float,
    *,
    passes: int,
) -> ServoFit | None:
    """Fit the unknowns from a guess, which has the other values; None if the guess diverges.

    The weights of the segments follow from their residuals after each pass; a residual is at least
    `resolution` [rad].
    """
    x = np.array([guess.values[u.keys[0]] for u in unknowns])
    low, high = (np.array([getattr(u, end) for u in unknowns]) for end in ("low", "high"))
    box = _Box(low, high, np.array([u.scale for u in unknowns]))
    x, states, deviations = np.clip(x, low, high), guess.states, guess.deviations
    for _ in range(passes):
        problem = _Problem(
            loop, guess.segments, unknowns, priors, guess.values, deviations, states, x
        )
        minimum = minimise(
            problem.linearise,
            x,
            box,
            tolerance=_TOLERANCE,
            relative=_RELATIVE_TOLERANCE,
            max_evaluations=_MAX_EVALUATIONS,
            # derivatives of serial arms take as long as fifty simulations
            cost=None if loop.arm.has_planar_program else problem.simulate,
        )
        if minimum is None:
            return None
        x, end = problem.at, minimum.end
        states = tuple(
            state + rows.to_state[:, -1]
            for state, rows in zip(problem.states, problem.rows, strict=True)
        )
        sizes = [
            np.sqrt(np.mean(rows.residual.reshape(-1, loop.arm.n_joints) ** 2, axis=0))
            for rows in problem.rows
        ]
        deviations = np.maximum(deviations * np.array(sizes), resolution)
    return ServoFit(
        loop,
        tuple(unknowns),
        tuple(priors),
        problem.values(x),
        guess.segments,
        states,
        tuple(problem.rows),
        deviations,
        resolution,
        end,
    )
