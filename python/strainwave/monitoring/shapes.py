"""How a parameter may leave its level over its visits: drifts and steps, and how likely by chance.

Estimates y_i with standard deviations s_i at times t_i, after covariates x_i are taken out:

    y_i = x_i b + (shape at t_i) h + v_i + e_i,   v_i ~ N(0, tau^2),   e_i ~ N(0, s_i^2),

tau the repeatability between visits, which no single run can know. A shape is a drift over all
visits, a step before one of them, or a drift that begins at one.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np

from strainwave.domain import FloatArray, IntArray

Kind = Literal["drift", "step", "drift since"]

FEWEST = 4
"""Visits beyond the number of covariates and the level, from which a change can be tested."""

_BEFORE = 2  # visits before a change, at least
_COLLINEAR = 1e-6  # share of a column's square that others leave, below which it says nothing new
_SAMPLES = 60  # directions drawn of each shape
_MOST = 2_000_000  # products of shapes and samples at a time
_ITERATIONS = 50  # of Newton's, which converges from one side


@dataclass(frozen=True, slots=True, eq=False)
class Series:
    """One parameter over the visits of an arm, in the order of time."""

    time: FloatArray  # (n_visits,) [days]
    value: FloatArray  # (n_visits,)
    std: FloatArray  # (n_visits,) of each run
    covariates: FloatArray  # (n_visits, n_covariates)


@dataclass(frozen=True, slots=True)
class Shape:
    """One way to leave the level."""

    kind: Kind
    first: int  # visit, from 0, that is first after a step, or last before a drift


@dataclass(frozen=True, slots=True, eq=False)
class Change:
    """The shape that explains a series best, and the probability that chance does."""

    shape: Shape
    size: float  # over the whole history
    size_std: float
    p: float  # of any shape as clear as this one, if nothing changed
    drift: float  # of a straight line over all visits, per day
    drift_std: float
    drift_p: float
    level: float  # before the change, at mean covariates
    repeatability: float  # tau, beside this shape
    degrees: int  # of Student's t behind both deviations
    fitted: FloatArray  # (n_visits,) with covariates


def change_of(series: Series, rng: np.random.Generator) -> Change | None:
    """Look for the shape that explains a series best.

    Weights 1 / (s^2 + tau^2), tau by moments without any shape. For each shape t^2 is the fall of
    the weighted squares over the residual squares per degree of freedom, taken for no less than
    the runs' own s^2 make. Beyond weights nothing is known: the residuals' direction is uniform on
    a sphere, and the probability that any shape comes out as clear as the best is that of a union
    of caps (`union_of_caps`), whatever tau is.

    Parameters
    ----------
    series : Series
    rng : numpy Generator

    Returns
    -------
    Change or None
        None with fewer than `FEWEST` visits beyond the columns of level and covariates, or where
        all are of one time.
    """
    X = regressors(series)
    degrees = len(series.value) - X.shape[1] - 1
    if degrees < FEWEST - 1:
        return None
    shapes, columns = _shapes(series.time)
    tau2 = moment_variance(series.value, series.std, X)
    space = _Whitened.of(series, X, tau2)
    directions, scale = space.directions(columns)
    kept = scale > 0.0
    if not kept[0]:
        return None  # no line over time that covariates do not explain
    shapes = [shape for shape, keep in zip(shapes, kept, strict=True) if keep]
    columns, directions, scale = columns[:, kept], directions[:, kept], scale[kept]
    along = directions.T @ space.residual
    left = np.maximum(space.residual @ space.residual - along**2, 0.0) / degrees
    variance = np.maximum(left, space.least)
    t2 = along**2 / variance
    best = int(np.argmax(t2))
    p = union_of_caps(t2[best] / (t2[best] + degrees), directions, space.free, rng)
    size, size_std = along / scale, np.sqrt(variance) / scale
    column = columns[:, best]
    beside = moment_variance(series.value, series.std, np.column_stack([X, column]))
    fitted = series.value - space.left(series.value - size[best] * column)
    return Change(
        shape=shapes[best],
        size=float(size[best]),
        size_std=float(size_std[best]),
        p=p,
        drift=float(size[0]) / float(np.ptp(series.time)),
        drift_std=float(size_std[0]) / float(np.ptp(series.time)),
        drift_p=student_tails(float(t2[0]), degrees),
        level=space.level(series.value - size[best] * column),
        repeatability=float(np.sqrt(beside)),
        degrees=degrees,
        fitted=fitted,
    )


def regressors(series: Series) -> FloatArray:
    """Columns of the level and of those covariates that say something new.

    Parameters
    ----------
    series : Series

    Returns
    -------
    (n_visits, 1 + n_kept)
        Covariates have zero mean and unit spread.
    """
    n = len(series.value)
    found = np.ones((n, 1))
    for column in series.covariates.T:
        centred = column - column.mean()
        spread = float(np.sqrt(np.mean(centred**2)))
        if not spread > _COLLINEAR * max(1.0, float(np.abs(column).max())):
            continue
        centred = centred / spread
        left = centred - found @ np.linalg.lstsq(found, centred)[0]
        if np.mean(left**2) > _COLLINEAR:
            found = np.column_stack([found, centred])
    return np.asarray(found)


def moment_variance(value: FloatArray, std: FloatArray, X: FloatArray) -> float:
    """tau^2, the variance between visits, by moments (Paule and Mandel, 1982).

    Where sum of r_i^2 / (s_i^2 + tau^2) is n - p, r the weighted least-squares residuals; zero
    where the runs' own deviations explain them. The sum falls and bends upward, so Newton's steps
    from zero never go too far.

    Parameters
    ----------
    value, std : (n,)
    X : (n, p)

    Returns
    -------
    float
    """
    n, p = X.shape
    if n <= p:
        return 0.0
    tau2 = 0.0
    for _ in range(_ITERATIONS):
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


def student_tails(t2: float, degrees: int) -> float:
    """Probability that the square of Student's t exceeds a value.

    Parameters
    ----------
    t2 : float
    degrees : int

    Returns
    -------
    float
    """
    from scipy.special import stdtr

    return float(2.0 * stdtr(degrees, -np.sqrt(t2)))


def union_of_caps(
    share: float, directions: FloatArray, free: FloatArray, rng: np.random.Generator
) -> float:
    """Probability that any of several directions has such a share of a random vector's square.

    Of u uniform on the sphere of the space that `free` spans, and directions a_k in it: P(max
    (u'a_k)^2 > share) = sum_k P_1 E_k[1 / N(u)], with P_1 that of one direction, from the beta
    distribution, E_k over those u in the k-th cap, and N the number of caps that u is in (Naiman
    and Priebe, 2001). It is as precise for p = 1e-9 as for 0.1.

    Parameters
    ----------
    share : float
        From 0 to 1.
    directions : (n, n_directions)
        Of unit length.
    free : (n, m)
        An orthonormal basis of the space.
    rng : numpy Generator

    Returns
    -------
    float
    """
    from scipy.special import betainc, betaincinv

    n_directions, m = directions.shape[1], free.shape[1]
    half = 0.5 * (m - 1)
    one = float(betainc(half, 0.5, 1.0 - share))
    if one == 0.0:
        return 0.0
    A = free.T @ directions
    G = A.T @ A
    samples = max(8, min(_SAMPLES, _MOST // n_directions**2))
    Z = rng.normal(size=(samples, m))
    C = Z @ A  # (samples, n_directions)
    across = np.sqrt(np.sum(Z * Z, axis=1)[:, None] - C * C)  # length beside the k-th direction
    rest = betaincinv(half, 0.5, one * rng.uniform(size=(samples, n_directions)))
    height, width = np.sqrt(1.0 - rest), np.sqrt(rest) / across
    inverse = np.empty((samples, n_directions))
    for k in range(n_directions):
        u = height[:, k, None] * G[k] + width[:, k, None] * (C - C[:, k, None] * G[k])
        inside = u * u > share
        inside[:, k] = True
        inverse[:, k] = 1.0 / inside.sum(axis=1)
    return float(min(1.0, one * inverse.mean(axis=0).sum()))


@dataclass(frozen=True, slots=True, eq=False)
class _Whitened:
    """Where rows have unit variance, and the space that level and covariates leave."""

    root: FloatArray  # (n,) square roots of the weights
    X: FloatArray  # (n, p)
    Q: FloatArray  # (n, p) orthonormal basis of the whitened regressors
    free: FloatArray  # (n, n - p) of the rest
    residual: FloatArray  # (n,) of the values
    least: float  # variance that the runs' own deviations make

    @classmethod
    def of(cls, series: Series, X: FloatArray, tau2: float) -> _Whitened:
        w = 1.0 / (series.std**2 + tau2)
        root = np.sqrt(w)
        whole = np.linalg.qr(X * root[:, None], mode="complete")[0]
        p = X.shape[1]
        Q, free = whole[:, :p], whole[:, p:]
        own = series.value * root
        residual = own - Q @ (Q.T @ own)
        return cls(root, X, Q, free, residual, float(np.mean(w * series.std**2)))

    def directions(self, columns: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Unit vectors of columns beside the regressors, and their lengths; zero: there is none."""
        white = columns * self.root[:, None]
        beside = white - self.Q @ (self.Q.T @ white)
        length = np.sqrt(np.sum(beside**2, axis=0))
        length[length**2 < _COLLINEAR * np.sum(white**2, axis=0)] = 0.0
        return beside / np.where(length > 0.0, length, 1.0), length

    def left(self, value: FloatArray) -> FloatArray:
        """What level and covariates leave of values, in their own unit."""
        own = value * self.root
        return np.asarray((own - self.Q @ (self.Q.T @ own)) / self.root)

    def level(self, value: FloatArray) -> float:
        """Level of values at mean covariates."""
        return float(np.linalg.lstsq(self.X * self.root[:, None], value * self.root)[0][0])


def _shapes(time: FloatArray) -> tuple[list[Shape], FloatArray]:
    """All shapes, the drift over all visits first, and their columns, which end at one."""
    n = len(time)
    span = max(float(np.ptp(time)), np.finfo(float).tiny)
    shapes = [Shape("drift", 0)]
    columns = [(time - time[0]) / span]
    for k in _places(time):
        shapes.append(Shape("step", int(k)))
        columns.append((np.arange(n) >= k).astype(np.float64))
    for k in _places(time):
        start = time[k - 1]
        if start > time[0] and time[-1] > time[k]:
            shapes.append(Shape("drift since", int(k) - 1))
            columns.append(np.maximum(time - start, 0.0) / (time[-1] - start))
    return shapes, np.column_stack(columns)


def _places(time: FloatArray) -> IntArray:
    """Visits before which something may change: later than the one before."""
    later = np.flatnonzero(np.diff(time) > 0.0) + 1
    return np.asarray(later[later >= _BEFORE])


def fitted_line(change: Change, series: Series) -> Iterator[tuple[float, float]]:
    """Points of the shape over time, at mean covariates, for a plot.

    Parameters
    ----------
    change : Change
    series : Series

    Yields
    ------
    time, value : float
    """
    t, k = series.time, change.shape.first
    after = change.level + change.size
    yield float(t[0]), change.level
    if change.shape.kind == "step":
        middle = 0.5 * float(t[k - 1] + t[k])
        yield middle, change.level
        yield middle, after
    elif change.shape.kind == "drift since":
        yield float(t[k]), change.level
    yield float(t[-1]), after
