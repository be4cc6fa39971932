"""Drifts and steps of a parameter over the visits of an arm, and their significance.

Model of estimates y_i with standard deviations s_i at times t_i and covariates x_i:

    y_i = x_i b + (shape at t_i) h + v_i + e_i,   v_i ~ N(0, tau^2),   e_i ~ N(0, s_i^2),

tau is the repeatability between visits, which single runs do not contain. A shape is a drift over
all visits, a step before one of them, or a drift that begins at one.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np

from strainwave.domain import FloatArray, IntArray
from strainwave.domain.results.distributions import student_tail

Kind = Literal["drift", "step", "drift since"]

MIN_VISITS = 4
"""Visits in addition to level and covariates that a test needs: Student's t with 3 degrees."""

_MIN_VISITS_BEFORE = 2  # a change; one visit alone cannot define the level
_COLLINEARITY = 1e-6  # share of a column's square outside the others; below it is redundant
_SAMPLES = 60  # directions drawn per shape: the p-value is accurate to some percent
_MAX_PRODUCTS = 2_000_000  # of shapes and samples at a time; limits memory to some 50 MB
_MAX_ITERATIONS = 50  # of Newton's method, which converges monotonically


@dataclass(frozen=True, slots=True, eq=False)
class ParameterSeries:
    """One parameter over the visits of an arm, by time."""

    time: FloatArray  # (n_visits,) [days]
    value: FloatArray  # (n_visits,)
    std: FloatArray  # (n_visits,) of each run
    covariates: FloatArray  # (n_visits, n_covariates)


@dataclass(frozen=True, slots=True, eq=False)
class DetectedChange:
    """The shape that explains a series best, and its significance."""

    kind: Kind
    first: int  # visit from 0: the first after a step, or the last before a drift
    size: float  # over the whole history
    size_std: float
    p: float  # probability that any shape is as significant if nothing changed
    drift: float  # of a straight line over all visits, per day
    drift_std: float
    drift_p: float
    level: float  # before the change, at mean covariates
    repeatability: float  # tau, with this shape in the model
    degrees: int  # of freedom of both standard deviations
    fitted: FloatArray  # (n_visits,) with covariates


def fit_change(series: ParameterSeries, rng: np.random.Generator) -> DetectedChange | None:
    """The shape that explains a series best; None if the series is too short for a test.

    Weights are 1/(s^2 + tau^2), with tau by moments without any shape. For each shape t^2 is the
    reduction of the weighted squares over the residual squares per degree of freedom, which is not
    less than the standard deviations of the runs give. Under the hypothesis of no change the
    direction of the residuals is uniform on a sphere, so the p-value of the largest t^2 is that of
    a union of caps (`cap_union_probability`), whatever tau is.
    """
    X = regressors(series)
    degrees = len(series.value) - X.shape[1] - 1
    if degrees < MIN_VISITS - 1:
        return None
    shapes, columns = _shapes(series.time)
    tau2 = estimate_visit_variance(series.value, series.std, X)
    space = _Whitened.of(series, X, tau2)
    directions, scale = space.directions(columns)
    usable = scale > 0.0
    if not usable[0]:
        return None  # covariates explain any line over time
    shapes = [shape for shape, is_usable in zip(shapes, usable, strict=True) if is_usable]
    columns, directions, scale = columns[:, usable], directions[:, usable], scale[usable]
    along = directions.T @ space.residual
    residual = np.maximum(space.residual @ space.residual - along**2, 0.0) / degrees
    variance = np.maximum(residual, space.min_variance)
    t2 = along**2 / variance
    best = int(np.argmax(t2))
    kind, first = shapes[best]
    p = cap_union_probability(t2[best] / (t2[best] + degrees), directions, space.free, rng)
    size, size_std = along / scale, np.sqrt(variance) / scale
    column = columns[:, best]
    tau2 = estimate_visit_variance(series.value, series.std, np.column_stack([X, column]))
    fitted = series.value - space.residual_of(series.value - size[best] * column)
    return DetectedChange(
        kind=kind,
        first=first,
        size=float(size[best]),
        size_std=float(size_std[best]),
        p=p,
        drift=float(size[0]) / float(np.ptp(series.time)),
        drift_std=float(size_std[0]) / float(np.ptp(series.time)),
        drift_p=student_tail(float(np.sqrt(t2[0])), degrees),
        level=space.level(series.value - size[best] * column),
        repeatability=float(np.sqrt(tau2)),
        degrees=degrees,
        fitted=fitted,
    )


def regressors(series: ParameterSeries) -> FloatArray:
    """Columns of the level and of the linearly independent covariates, (n_visits, 1 + n).

    Covariates have zero mean and unit standard deviation.
    """
    n = len(series.value)
    X = np.ones((n, 1))
    for column in series.covariates.T:
        centred = column - column.mean()
        spread = float(np.sqrt(np.mean(centred**2)))
        if not spread > _COLLINEARITY * max(1.0, float(np.abs(column).max())):
            continue
        centred = centred / spread
        residual = centred - X @ np.linalg.lstsq(X, centred)[0]
        if np.mean(residual**2) > _COLLINEARITY:
            X = np.column_stack([X, centred])
    return np.asarray(X)


def estimate_visit_variance(value: FloatArray, std: FloatArray, X: FloatArray) -> float:
    """tau^2, the variance between visits, by the method of moments (Paule and Mandel, 1982).

    It makes the sum of r_i^2/(s_i^2 + tau^2) equal to n - p, with r the weighted least-squares
    residuals for the regressors X, (n, p); zero if the sum is smaller. The sum is decreasing and
    convex in tau^2, so Newton's method from zero does not overshoot.
    """
    n, p = X.shape
    if n <= p:
        return 0.0
    tau2 = 0.0
    for _ in range(_MAX_ITERATIONS):
        w = 1.0 / (std**2 + tau2)
        root = np.sqrt(w)
        Q = np.linalg.qr(X * root[:, None])[0]
        r = value * root
        r = r - Q @ (Q.T @ r)
        excess = float(r @ r) - (n - p)
        if excess <= 1e-9 * n:
            break
        tau2 += excess / float(np.sum(w * r * r))
    return tau2


def cap_union_probability(
    share: float, directions: FloatArray, free: FloatArray, rng: np.random.Generator
) -> float:
    """Probability that a random direction has such a share of its square along any of `directions`.

    For u uniform on the sphere of the space that `free` spans, (n, m) with orthonormal columns,
    and unit vectors a_k, the columns of `directions`: P(max (u'a_k)^2 > share) = sum_k P_1
    E_k[1/N(u)], with P_1 the probability of one direction, from the beta distribution, E_k the
    mean over u in the k-th cap, and N the number of caps that contain u (Naiman and Priebe, 2001).
    The relative accuracy is the same for p = 1e-9 as for 0.1.
    """
    from scipy.special import betainc, betaincinv

    n_directions, m = directions.shape[1], free.shape[1]
    half = 0.5 * (m - 1)
    cap_probability = float(betainc(half, 0.5, 1.0 - share))
    if cap_probability == 0.0:
        return 0.0
    A = free.T @ directions
    G = A.T @ A
    samples = max(8, min(_SAMPLES, _MAX_PRODUCTS // n_directions**2))
    Z = rng.normal(size=(samples, m))
    C = Z @ A  # (samples, n_directions)
    across = np.sqrt(np.sum(Z * Z, axis=1)[:, None] - C * C)  # orthogonal to the k-th direction
    rest = betaincinv(half, 0.5, cap_probability * rng.uniform(size=(samples, n_directions)))
    height, width = np.sqrt(1.0 - rest), np.sqrt(rest) / across
    inverse = np.empty((samples, n_directions))
    for k in range(n_directions):
        u = height[:, k, None] * G[k] + width[:, k, None] * (C - C[:, k, None] * G[k])
        inside = u * u > share
        inside[:, k] = True
        inverse[:, k] = 1.0 / inside.sum(axis=1)
    return float(min(1.0, cap_probability * inverse.mean(axis=0).sum()))


@dataclass(frozen=True, slots=True, eq=False)
class _Whitened:
    """Coordinates in which rows have unit variance, and the complement of level and covariates."""

    root: FloatArray  # (n,) square roots of the weights
    X: FloatArray  # (n, p)
    Q: FloatArray  # (n, p) orthonormal basis of the whitened regressors
    free: FloatArray  # (n, n - p) orthonormal basis of the complement
    residual: FloatArray  # (n,) of the values, whitened
    min_variance: float  # from the standard deviations of the runs alone

    @classmethod
    def of(cls, series: ParameterSeries, X: FloatArray, tau2: float) -> _Whitened:
        w = 1.0 / (series.std**2 + tau2)
        root = np.sqrt(w)
        basis = np.linalg.qr(X * root[:, None], mode="complete")[0]
        p = X.shape[1]
        Q, free = basis[:, :p], basis[:, p:]
        white = series.value * root
        residual = white - Q @ (Q.T @ white)
        return cls(root, X, Q, free, residual, float(np.mean(w * series.std**2)))

    def directions(self, columns: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Unit vectors of columns orthogonal to the regressors, and lengths; zero: dependent."""
        white = columns * self.root[:, None]
        orthogonal = white - self.Q @ (self.Q.T @ white)
        length = np.sqrt(np.sum(orthogonal**2, axis=0))
        length[length**2 < _COLLINEARITY * np.sum(white**2, axis=0)] = 0.0
        return orthogonal / np.where(length > 0.0, length, 1.0), length

    def residual_of(self, value: FloatArray) -> FloatArray:
        """Residual of values after level and covariates, in their unit."""
        white = value * self.root
        return np.asarray((white - self.Q @ (self.Q.T @ white)) / self.root)

    def level(self, value: FloatArray) -> float:
        """Level of values at mean covariates."""
        return float(np.linalg.lstsq(self.X * self.root[:, None], value * self.root)[0][0])


def _shapes(time: FloatArray) -> tuple[list[tuple[Kind, int]], FloatArray]:
    """All shapes, first the drift over all visits, and their columns, which end at one.

    A shape is its kind and `DetectedChange.first`.
    """
    n = len(time)
    span = max(float(np.ptp(time)), np.finfo(float).tiny)
    shapes: list[tuple[Kind, int]] = [("drift", 0)]
    columns = [(time - time[0]) / span]
    for k in _change_visits(time):
        shapes.append(("step", int(k)))
        columns.append((np.arange(n) >= k).astype(np.float64))
    for k in _change_visits(time):
        start = time[k - 1]
        if start > time[0] and time[-1] > time[k]:
            shapes.append(("drift since", int(k) - 1))
            columns.append(np.maximum(time - start, 0.0) / (time[-1] - start))
    return shapes, np.column_stack(columns)


def _change_visits(time: FloatArray) -> IntArray:
    """Visits before which a change may occur: later than the visit before."""
    later = np.flatnonzero(np.diff(time) > 0.0) + 1
    return np.asarray(later[later >= _MIN_VISITS_BEFORE])


def fitted_line(change: DetectedChange, series: ParameterSeries) -> Iterator[tuple[float, float]]:
    """Points (time, value) of the fitted shape at mean covariates, for a plot."""
    t, k = series.time, change.first
    after = change.level + change.size
    yield float(t[0]), change.level
    if change.kind == "step":
        middle = 0.5 * float(t[k - 1] + t[k])
        yield middle, change.level
        yield middle, after
    elif change.kind == "drift since":
        yield float(t[k]), change.level
    yield float(t[-1]), after
