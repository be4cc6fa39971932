"""The gears that explain motor velocities best: a grid over all of them, then least squares."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from strainwave.domain import ComplexArray, FloatArray
from strainwave.errors import NotIdentifiable
from strainwave.identification.joint_model.motor_side.arms import (
    PER_JOINT,
    Family,
    Posture,
    posture_of,
)
from strainwave.identification.joint_model.motor_side.impedance import velocities
from strainwave.identification.joint_model.motor_side.spectra import Piece

_RINGS = 14  # anti-resonances of a joint that are tried, in the band of the records
_SHARES = (0.15, 0.35, 0.55, 0.75)  # of a joint's inertia that may be the motor's
_DAMPING = 0.05  # ratio of every anti-resonance on the grid
_INERTIAS = 10  # on the whole that are tried of a joint of which nothing is known
_STARTS = 6  # points of the grid from which least squares go on
_APART = 0.35  # in a coordinate: minima that are not the same
_HIGHEST = 2.0 * np.pi * 80.0  # [rad/s] anti-resonance of an ordinary gear under its load
_OPEN = 4.0  # times the least sum of squares, up to which a point is still in question
_ROBUST = 0.02  # residual, as a share of the motor's velocity, from which one counts less
_REACH = np.array([np.log(10.0), np.log(100.0), 4.0])  # of least squares around a start
_BLOCKS = 10  # bands of a piece whose errors count as independent of one another
_TILTS = (-0.5, 0.5)  # powers of frequency that weigh lines otherwise, to show the model's error
_DIFFERENCE = 1e-5  # of a coordinate
_SETTLED, _EVALUATIONS = 1e-4, 30  # of least squares: what follows starts from it


@dataclass(frozen=True, slots=True)
class Found:
    """One minimum, or another point that explains nearly as much."""

    point: FloatArray  # (n_coordinates,)
    cost: float
    covariance: FloatArray  # (n_coordinates, n_coordinates); NaN of all but the best
    fit_percent: FloatArray  # (n_joints,) of the motors' velocities; NaN where none was compared


_Seen = tuple[Piece, Posture]
"""A piece of a record, and the arm's posture in it."""


def minima(family: Family, pieces: Sequence[Piece], few_lines: Sequence[Piece]) -> list[Found]:
    """Where motor velocities are explained best, the best first, and what is still in question.

    `few_lines`: The same with fewer lines, for the grid.

    Raises `NotIdentifiable`: no arm of the family explains anything.
    """
    postures = [posture_of(family.arm, piece.link_angle) for piece in pieces]
    records = list(zip(pieces, postures, strict=True))
    coarse = list(zip(few_lines, postures, strict=True))
    grid = _grid(family, few_lines)
    proper = family.proper(grid)
    if not np.any(proper):
        raise NotIdentifiable(
            "the inertias of the rigid model belong to no arm: whatever part of joint 1's is the"
            " motor's, the links' inertia matrix is not positive definite"
        )
    cost = np.full(len(grid), np.inf)
    cost[proper] = sum((_costs(family, grid[proper], each) for each in coarse), 0.0)
    found: list[tuple[float, FloatArray]] = []
    for start in _valleys(grid, cost, family.n_joints):
        point, least = _polished(family, start, records)
        if all(np.max(np.abs(point - other)) > _APART for _, other in found):
            found.append((least, point))
    found.sort(key=lambda each: each[0])
    (least, best), *others = found
    points = np.array([best, *(point for _, point in others), *_beside(family, best, few_lines)])
    cost = sum((_costs(family, points, each) for each in records), np.zeros(len(points)))
    unknown = np.full((len(best), len(best)), np.nan)
    rest = [
        Found(point, float(own), unknown, _fits(family, point, records))
        for own, point in zip(cost[1:], points[1:], strict=True)
        if own < _OPEN * cost[0]
    ]
    return [_judged(family, best, least, records), *sorted(rest, key=lambda each: each.cost)]


def _beside(family: Family, best: FloatArray, records: Sequence[Piece]) -> Iterator[FloatArray]:
    """The best point with another stiffness of one joint, all over the band.

    A motor that carries most of its joint's inertia hardly feels the gear: its anti-resonance may
    then lie anywhere in a wide band, and the minimum anywhere in that.
    """
    lines = np.concatenate([piece.s.imag for piece in records])
    load = family.parts(best)["link_inertia"]
    for i in range(family.n_joints):
        for ring in np.geomspace(1.2 * lines.min(), min(0.7 * lines.max(), _HIGHEST), _RINGS):
            point = best.copy()
            point[PER_JOINT * i] = np.log(ring**2 * load[i])
            point[PER_JOINT * i + 1] = np.log(2.0 * _DAMPING * ring * load[i])
            if abs(point[PER_JOINT * i] - best[PER_JOINT * i]) > _APART:
                yield point


def _grid(family: Family, records: Sequence[Piece]) -> FloatArray:
    """Points (n_points, n_coordinates) over gears, motors' shares and, if unknown, inertias."""
    lines = np.concatenate([piece.s.imag for piece in records])
    rings = np.geomspace(1.2 * lines.min(), 0.7 * lines.max(), _RINGS)
    shares = [_SHARES if np.isnan(known) else (known,) for known in family.known_share.tolist()]
    n, rigid = family.n_joints, family.total_inertia
    if rigid is None:
        totals = [_inertias(records, i) for i in range(n)]
    else:
        totals = [np.array([known]) for known in rigid]
    points = []
    for own in product(*([rings] * n), *shares, *totals):
        ring, share, total = (np.array(own[k * n : (k + 1) * n]) for k in range(3))
        points.append(family.point(ring, share, _DAMPING, None if rigid is not None else total))
    return np.array(points)


def _inertias(records: Sequence[Piece], i: int) -> FloatArray:
    """Inertias that a joint may have by how much torque its acceleration takes."""
    ratio = np.concatenate([np.abs(p.torque[:, i] / (p.s * p.velocity[:, i])) for p in records])
    low, high = np.quantile(ratio, (0.1, 0.9)).tolist()
    return np.geomspace(0.5 * low, 2.0 * high, _INERTIAS)


def _errors(
    family: Family, points: FloatArray, seen: _Seen
) -> Iterator[tuple[ComplexArray, FloatArray]]:
    """Of every motor that a piece shows, shares of its velocity: (..., n_lines), (n_lines,).

    What the arms of the points leave, and the velocity itself.
    """
    piece, posture = seen
    Z = family.linear(points, posture).impedance(piece.s)
    for i in piece.rows:
        size = np.sqrt(np.mean(np.abs(piece.velocity[:, i]) ** 2) * len(piece.s))
        drive, dry = piece.torque[:, i], piece.direction[:, i]
        if family.coulomb is not None:
            drive = drive - family.coulomb[i] * dry
        left = piece.velocity[:, i] - velocities(Z, drive, piece.velocity, i)
        if family.coulomb is None:  # the dry friction that explains most
            share = dry / Z[..., i, i]
            along = np.sum((np.conj(share) * left).real, axis=-1, keepdims=True)
            along = along / np.sum(np.abs(share) ** 2, axis=-1, keepdims=True)
            left = left - np.minimum(along, 0.0) * share
        yield left / size, np.abs(piece.velocity[:, i]) / size


def _costs(family: Family, points: FloatArray, seen: _Seen) -> FloatArray:
    """Sums of squares: (n_points,)."""
    parts = [np.sum(np.abs(left) ** 2, axis=-1) for left, _ in _errors(family, points, seen)]
    return np.asarray(sum(parts, np.zeros(len(points))))


def _valleys(grid: FloatArray, cost: FloatArray, n_joints: int) -> list[FloatArray]:
    """Of anti-resonances that explain more than those beside them, the best few.

    What else varies on the grid is at its best for each; neighbours lead to the same minimum, and
    where one joint's anti-resonance shows little, they would be all that is tried.
    """
    shape = (_RINGS,) * n_joints
    by_ring = cost.reshape(_RINGS**n_joints, -1)
    own = np.argmin(by_ring, axis=1)
    least = np.min(by_ring, axis=1).reshape(shape)
    around = np.pad(least, 1, constant_values=np.inf)
    lowest = np.isfinite(least)
    for step in product((0, 1, 2), repeat=n_joints):
        lowest &= least <= around[tuple(slice(k, k + _RINGS) for k in step)]
    points = grid.reshape(_RINGS**n_joints, by_ring.shape[1], -1)
    chosen = np.flatnonzero(lowest)
    chosen = chosen[np.argsort(least.ravel()[chosen], kind="stable")][:_STARTS]
    return [points[k, own[k]] for k in chosen]


def _residual(
    family: Family, point: FloatArray, records: Sequence[_Seen], tilt: float = 0.0
) -> FloatArray:
    """All pieces' errors, real and imaginary, then what the rigid model knows of motors."""
    found = []
    for seen in records:
        piece = seen[0]
        weight = np.abs(piece.s) ** tilt
        weight = weight / np.sqrt(np.mean(weight**2))
        for left, _ in _errors(family, point, seen):
            found += [(left * weight).real, (left * weight).imag]
    return np.concatenate([*found, _known(family, point)])


def _known(family: Family, point: FloatArray) -> FloatArray:
    """Motor inertias beside those that the rigid model has apart, in units of robust residuals."""
    identified = np.flatnonzero(~np.isnan(family.known_share))
    if not identified.size or family.total_inertia is None:
        return np.zeros(0)
    motor = family.parts(point)["motor_inertia"][identified]
    aim = family.known_share[identified] * family.total_inertia[identified]
    return np.asarray(_ROBUST * np.log(motor / aim) / family.known_deviation[identified])


def _polished(
    family: Family, start: FloatArray, records: Sequence[_Seen], tilt: float = 0.0
) -> tuple[FloatArray, float]:
    """The minimum near a point, and its cost."""
    from scipy.optimize import least_squares

    reach = np.full(len(start), np.log(10.0))
    reach[: PER_JOINT * family.n_joints] = np.tile(_REACH, family.n_joints)
    found = least_squares(
        lambda point: _residual(family, point, records, tilt),
        start,
        jac=lambda point: _slopes(family, point, records, tilt),
        bounds=(start - reach, start + reach),
        loss="soft_l1",
        f_scale=_ROBUST,
        ftol=_SETTLED,
        xtol=_SETTLED,
        max_nfev=_EVALUATIONS,
    )
    return np.asarray(found.x), float(found.cost)


def _slopes(
    family: Family, point: FloatArray, records: Sequence[_Seen], tilt: float = 0.0
) -> FloatArray:
    """Derivatives of the residuals by central differences: (n_rows, n_coordinates)."""
    steps = _DIFFERENCE * np.eye(len(point))
    return np.column_stack(
        [
            _residual(family, point + step, records, tilt)
            - _residual(family, point - step, records, tilt)
            for step in steps
        ]
    ) / (2.0 * _DIFFERENCE)


def _judged(family: Family, point: FloatArray, cost: float, records: Sequence[_Seen]) -> Found:
    """With deviations by how the errors scatter from band to band, and by other weights."""
    residual, slopes = _residual(family, point, records), _slopes(family, point, records)
    weight = 1.0 / np.sqrt(1.0 + (residual / _ROBUST) ** 2)
    bread = np.linalg.pinv((slopes * weight[:, None]).T @ slopes, hermitian=True)
    gradient = slopes * (weight * residual)[:, None]
    labels = np.concatenate([*_bands(records), -1 - np.arange(len(_known(family, point)))])
    meat = np.zeros_like(bread)
    for label in np.unique(labels):
        part = gradient[labels == label].sum(axis=0)
        meat += np.outer(part, part)
    covariance = bread @ meat @ bread
    moves = [_polished(family, point, records, tilt)[0] - point for tilt in _TILTS]
    covariance = covariance + np.mean([np.outer(move, move) for move in moves], axis=0)
    return Found(point, cost, covariance, _fits(family, point, records))


def _bands(records: Sequence[_Seen]) -> Iterator[FloatArray]:
    """The band that each row of the residual belongs to, counted through all pieces."""
    count = 0
    for piece, _ in records:
        n = len(piece.s)
        for _ in piece.rows:
            own = count + np.arange(n) * _BLOCKS // n
            yield np.concatenate([own, own]).astype(float)
            count += _BLOCKS


def _fits(family: Family, point: FloatArray, records: Sequence[_Seen]) -> FloatArray:
    """100 (1 - |error| / |velocity|) of each motor over all its pieces."""
    left, whole = np.zeros(family.n_joints), np.zeros(family.n_joints)
    for seen in records:
        for i, (error, own) in zip(seen[0].rows, _errors(family, point, seen), strict=True):
            left[i] += np.sum(np.abs(error) ** 2)
            whole[i] += np.sum(own**2)
    with np.errstate(invalid="ignore"):
        return np.asarray(100.0 * (1.0 - np.sqrt(left / np.where(whole > 0.0, whole, np.nan))))
