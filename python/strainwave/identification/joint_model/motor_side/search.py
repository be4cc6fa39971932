"""Search for the gears that explain the motor velocities.

Grids of one joint at a time find the starting points of least squares over all joints.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from strainwave.domain import ComplexArray, FloatArray
from strainwave.domain.keys import JointIndex
from strainwave.errors import NotIdentifiable
from strainwave.identification.joint_model.motor_side.arms import (
    COORDINATES_PER_JOINT,
    NO_ARM,
    ConsistentArms,
    LinearisedArms,
    MotorMotion,
    Posture,
    posture_of,
)
from strainwave.identification.joint_model.motor_side.spectra import Piece
from strainwave.numerics.search import Choice, CoordinateSearch

# number of anti-resonances per joint on the grid, within the band of the records
_N_ANTI_RESONANCES = 14
_MOTOR_SHARES = (0.15, 0.35, 0.55, 0.75)  # motor's share of a joint's inertia on the grid
_DAMPING_RATIO = 0.05  # damping ratio of the anti-resonances on the grid
_N_INERTIAS = 10  # number of total inertias on the grid for a joint without a rigid model
_MAX_STARTS = 6  # number of grid points from which least squares start
_IMPROPER_COST = 1e9  # cost of a point without positive definite inertia matrix, above all others
_MIN_DISTANCE = 0.35  # difference of a coordinate above which two minima are distinct
# [rad/s] highest anti-resonance of a typical gear with its load
_MAX_ANTI_RESONANCE = 2.0 * np.pi * 80.0
# ratio to the least sum of squares of every motor up to which a point is an alternative
_MAX_COST_RATIO = 4.0
_MAX_DESCENTS = 8  # from alternatives; each usually corrects the stiffness of one joint
_ROBUST_SCALE = 0.02  # scale of the robust loss, as a share of the motor velocity
# bounds of least squares around the starting value: log k, log d_G, log odds of the share
_COORDINATE_BOUNDS = np.array([np.log(10.0), np.log(100.0), 4.0])
_N_BANDS = 10  # frequency bands of a piece with independent errors
# powers of frequency that change the weights, to measure the model error
_WEIGHT_POWERS = (-0.5, 0.5)
_DIFFERENCE_STEP = 1e-5  # step of a coordinate for central differences
# tolerance and maximum evaluations of least squares; a later fit refines the result
_TOLERANCE, _MAX_EVALUATIONS = 1e-4, 30


@dataclass(frozen=True, slots=True)
class GearMinimum:
    """A minimum, or an alternative point with a similar objective."""

    point: FloatArray  # (n_coordinates,)
    cost: float
    covariance: FloatArray  # (n_coordinates, n_coordinates); NaN except for the best
    fit_percent: FloatArray  # (n_joints,) of motor velocities; NaN: not compared


_PieceInPosture = tuple[Piece, Posture]
"""A piece of a record with the posture of the arm."""


def minima(
    family: ConsistentArms, pieces: Sequence[Piece], few_lines: Sequence[Piece]
) -> list[GearMinimum]:
    """Minima of the motor velocity error, the best first, then the alternatives.

    `few_lines` are the pieces with fewer lines, for the grid. Raises `NotIdentifiable` if the
    inertia matrix of no arm of the family is positive definite.
    """
    postures = [posture_of(family.arm, piece.link_angle) for piece in pieces]
    records = list(zip(pieces, postures, strict=True))
    distinct_minima: list[tuple[float, FloatArray]] = []
    for start in _starts(family, list(zip(few_lines, postures, strict=True))):
        point, least_cost = _minimize(family, start, records)
        if all(np.max(np.abs(point - other)) > _MIN_DISTANCE for _, other in distinct_minima):
            distinct_minima.append((least_cost, point))
    distinct_minima.sort(key=lambda each: each[0])
    (least_cost, best), *others = distinct_minima
    least_cost, best = _descend(family, least_cost, best, records)
    points = np.array([best, *(p for _, p in others), *_alternatives(family, best, records)])
    costs = _costs(family, points, records)
    is_near = np.all(costs <= _MAX_COST_RATIO * costs[0], axis=1)
    unknown = np.full((len(best), len(best)), np.nan)
    fits = _fits(costs, records)
    alternatives = [
        GearMinimum(points[k], float(costs[k].sum()), unknown, fits[k])
        for k in np.flatnonzero(is_near)[1:]
    ]
    covariance = _covariance(family, best, records)
    return [
        GearMinimum(best, least_cost, covariance, fits[0]),
        *sorted(alternatives, key=lambda each: each.cost),
    ]


def _descend(
    family: ConsistentArms, cost: float, point: FloatArray, records: Sequence[_PieceInPosture]
) -> tuple[float, FloatArray]:
    """Minimum from the alternative of least objective, as long as it is below that of the point."""
    for _ in range(_MAX_DESCENTS):
        alternatives = np.array(list(_alternatives(family, point, records)))
        objectives = _objectives(family, alternatives, records)
        if not objectives.size or objectives.min() >= cost:
            break
        point, cost = _minimize(family, alternatives[objectives.argmin()], records)
    return cost, point


def _alternatives(
    family: ConsistentArms, best: FloatArray, records: Sequence[_PieceInPosture]
) -> Iterator[FloatArray]:
    """The best point with other stiffnesses of one joint, over the whole band.

    If the motor contributes most of its joint's inertia, its velocity depends only weakly on the
    gear. The anti-resonance is then uncertain over a wide band.
    """
    line_frequencies = np.concatenate([piece.s.imag for piece, _ in records])
    link_inertia = family.parts(best)["link_inertia"]
    for i in range(family.n_joints):
        for ring in np.geomspace(
            1.2 * line_frequencies.min(),
            min(0.7 * line_frequencies.max(), _MAX_ANTI_RESONANCE),
            _N_ANTI_RESONANCES,
        ):
            point, at = best.copy(), COORDINATES_PER_JOINT * i
            point[at] = np.log(ring**2 * link_inertia[i])
            point[at + 1] = np.log(2.0 * _DAMPING_RATIO * ring * link_inertia[i])
            if abs(point[at] - best[at]) > _MIN_DISTANCE:
                yield point


def _starts(family: ConsistentArms, records: Sequence[_PieceInPosture]) -> list[FloatArray]:
    """Points from which least squares start, the best first.

    Anti-resonance, motor's share and, if unknown, total inertia of one joint are searched with the
    other joints at their current best. The starts are the minima over the anti-resonances of two
    neighbouring joints, with the other joints at their best.
    """
    grids = [_grid(family, [piece for piece, _ in records], i) for i in range(family.n_joints)]
    sizes = [grid.shape[1] for grid in grids]  # candidates per anti-resonance

    def points(choices: Sequence[Choice]) -> FloatArray:
        settings = [
            grid.reshape(-1, 3)[list(k)]
            for grid, k in zip(grids, zip(*choices, strict=True), strict=True)
        ]
        ring, share, total = np.moveaxis(np.stack(settings, axis=1), -1, 0)
        return family.point(ring, share, _DAMPING_RATIO, total)

    def cost_of(choices: Sequence[Choice]) -> FloatArray:
        arms = points(choices)
        inertia = family.least_inertia(arms)
        cost, proper = _IMPROPER_COST * (1.0 - inertia), inertia > 0.0
        if proper.any():
            cost[proper] = _costs(family, arms[proper], records).sum(axis=1)
        return np.asarray(cost)

    alike = [
        tuple(ring * size + min(other, size - 1) for size in sizes)
        for ring in range(_N_ANTI_RESONANCES)
        for other in range(max(sizes))
    ]
    search, counts = CoordinateSearch(cost_of), [_N_ANTI_RESONANCES * size for size in sizes]
    best, starts = search.minimise(alike, counts), []
    for first, choices in enumerate(search.pairs(best, [range(count) for count in counts])):
        shape = [n for size in sizes[first : first + 2] for n in (_N_ANTI_RESONANCES, size)]
        cost = np.reshape(search.evaluate(choices), shape)
        others = tuple(range(1, cost.ndim, 2))
        by_ring = cost.min(axis=others)
        around = sliding_window_view(
            np.pad(by_ring, 1, constant_values=np.inf), (3,) * by_ring.ndim
        )
        lowest = around.min(axis=tuple(range(by_ring.ndim, 2 * by_ring.ndim)))
        lowest = np.where(lowest < _IMPROPER_COST, lowest, -np.inf)
        starts += [choices[k] for k in np.flatnonzero(cost <= np.expand_dims(lowest, others))]
    if not starts:
        raise NotIdentifiable(NO_ARM)
    starts = sorted(dict.fromkeys(starts), key=search.costs.__getitem__)
    return list(points(starts[:_MAX_STARTS]))


def _grid(family: ConsistentArms, pieces: Sequence[Piece], i: int) -> FloatArray:
    """Anti-resonance, motor's share and total inertia of joint i: (n_rings, n_others, 3)."""
    line_frequencies = np.concatenate([piece.s.imag for piece in pieces])
    low, high = 1.2 * line_frequencies.min(), 0.7 * line_frequencies.max()
    known, rigid = family.known_share[i], family.total_inertia
    if rigid is None:  # candidates from the ratio of torque to acceleration
        ratios = [np.abs(p.torque[:, i] / (p.s * p.velocity[:, i])) for p in pieces]
        least, most = np.quantile(np.concatenate(ratios), (0.1, 0.9)).tolist()
        inertias = np.geomspace(0.5 * least, 2.0 * most, _N_INERTIAS)
    else:
        inertias = rigid[i : i + 1]
    axes = (
        np.geomspace(low, high, _N_ANTI_RESONANCES),
        _MOTOR_SHARES if np.isnan(known) else [known],
        inertias,
    )
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    return np.asarray(grid.reshape(_N_ANTI_RESONANCES, -1, len(axes)))


def _errors(
    family: ConsistentArms, points: FloatArray, records: Sequence[_PieceInPosture]
) -> Iterator[tuple[Piece, int, ComplexArray]]:
    """Yield the velocity error of each motor, from 0, in each piece, over the norm of the velocity.

    The errors are (..., n_lines) for the arms of the points.
    """
    for piece, posture in records:
        arm = family.linear(points, posture)
        for i in piece.rows:
            motion = _motion(family, arm, piece, i)
            error = motion.error
            if family.coulomb is None:
                response, friction = _friction(motion, piece)
                error = error - friction * response
            yield piece, i, np.asarray(error / np.linalg.norm(piece.velocity[:, i]))


def _motion(
    family: ConsistentArms, arm: LinearisedArms, piece: Piece, i: JointIndex
) -> MotorMotion:
    """Motion of motor i with its known Coulomb friction."""
    drive = piece.torque[:, i]
    if family.coulomb is not None:
        drive = drive - family.coulomb[i] * piece.direction[:, i]
    return arm.motor(piece.s, drive, piece.velocity, i)


def _friction(motion: MotorMotion, piece: Piece) -> tuple[ComplexArray, FloatArray]:
    """Velocity per Coulomb friction, and minus the friction that fits the piece best."""
    response = piece.direction[:, motion.row] / motion.impedance
    friction = np.sum((np.conj(response) * motion.error).real, axis=-1, keepdims=True)
    friction = friction / np.sum(np.abs(response) ** 2, axis=-1, keepdims=True)
    return response, np.minimum(friction, 0.0)


def _error_derivatives(
    family: ConsistentArms, point: FloatArray, records: Sequence[_PieceInPosture]
) -> Iterator[tuple[Piece, ComplexArray]]:
    """Yield the derivatives (n_coordinates, n_lines) of the errors of `_errors` at one point."""
    steps = _DIFFERENCE_STEP * np.eye(len(point))
    for piece, posture in records:
        arm = family.linear(point, posture)
        above, below = (family.linear(point + sign * steps, posture) for sign in (1.0, -1.0))
        changes = arm.derivative(above, below, _DIFFERENCE_STEP)
        for i in piece.rows:
            motion = _motion(family, arm, piece, i)
            error, impedance = motion.derivatives(changes)
            if family.coulomb is None:
                response, friction = _friction(motion, piece)
                of_response = -response * impedance / motion.impedance
                residual = motion.error - friction * response
                gradient = np.conj(of_response) * residual + np.conj(response) * (
                    error - friction * of_response
                )
                of_friction = gradient.real.sum(axis=-1, keepdims=True)
                of_friction = of_friction / np.sum(np.abs(response) ** 2)
                error = error - friction * of_response - (friction < 0.0) * of_friction * response
            yield piece, np.asarray(error / np.linalg.norm(piece.velocity[:, i]))


def _costs(
    family: ConsistentArms, points: FloatArray, records: Sequence[_PieceInPosture]
) -> FloatArray:
    """Sums of squared errors of each motor over all pieces, (n_points, n_joints)."""
    costs = np.zeros((len(points), family.n_joints))
    for _, i, error in _errors(family, points, records):
        costs[:, i] += np.sum(np.abs(error) ** 2, axis=-1)
    return costs


def _fits(costs: FloatArray, records: Sequence[_PieceInPosture]) -> FloatArray:
    """Fit of each motor velocity over all pieces, 100 (1 - |error| / |velocity|).

    From the costs (n_points, n_joints), whose errors are relative to the velocity of each piece.
    """
    n_pieces = [sum(i in piece.rows for piece, _ in records) for i in range(costs.shape[1])]
    with np.errstate(invalid="ignore"):
        return np.asarray(100.0 * (1.0 - np.sqrt(costs / np.where(n_pieces, n_pieces, np.nan))))


def _objectives(
    family: ConsistentArms, points: FloatArray, records: Sequence[_PieceInPosture]
) -> FloatArray:
    """Objectives of `_minimize`, (n_points,)."""
    residuals = [_prior_residuals(family, points)]
    for _, _, error in _errors(family, points, records):
        residuals += [error.real, error.imag]
    losses = [np.sum(np.sqrt(1.0 + (x / _ROBUST_SCALE) ** 2) - 1.0, axis=-1) for x in residuals]
    return np.asarray(_ROBUST_SCALE**2 * sum(losses, np.zeros(len(points))))


def _residual(
    family: ConsistentArms, point: FloatArray, records: Sequence[_PieceInPosture], tilt: float = 0.0
) -> FloatArray:
    """Real and imaginary errors of all pieces, then the residuals of known motor inertias."""
    parts = []
    for piece, _, error in _errors(family, point, records):
        weighted = error * _line_weights(piece, tilt)
        parts += [weighted.real, weighted.imag]
    return np.concatenate([*parts, _prior_residuals(family, point)])


def _line_weights(piece: Piece, tilt: float) -> FloatArray:
    """Weights (n_lines,) of the lines, a power of the frequency."""
    weight = np.abs(piece.s) ** tilt
    return np.asarray(weight / np.sqrt(np.mean(weight**2)))


def _prior_residuals(family: ConsistentArms, point: FloatArray) -> FloatArray:
    """Residuals (..., n_known) of known motor inertias at points (..., n_coordinates).

    The rigid model gives these inertias. The residuals are scaled like the velocity errors.
    """
    identified = np.flatnonzero(~np.isnan(family.known_share))
    if not identified.size or family.total_inertia is None:
        return np.zeros((*point.shape[:-1], 0))
    motor = family.parts(point)["motor_inertia"][..., identified]
    known_inertia = family.known_share[identified] * family.total_inertia[identified]
    return np.asarray(
        _ROBUST_SCALE * np.log(motor / known_inertia) / family.known_deviation[identified]
    )


def _minimize(
    family: ConsistentArms, start: FloatArray, records: Sequence[_PieceInPosture], tilt: float = 0.0
) -> tuple[FloatArray, float]:
    """Minimum near a point, and its objective."""
    from scipy.optimize import least_squares

    bound = np.full(len(start), np.log(10.0))
    bound[: COORDINATES_PER_JOINT * family.n_joints] = np.tile(_COORDINATE_BOUNDS, family.n_joints)
    solution = least_squares(
        lambda point: _residual(family, point, records, tilt),
        start,
        jac=lambda point: _jacobian(family, point, records, tilt),
        bounds=(start - bound, start + bound),
        loss="soft_l1",
        f_scale=_ROBUST_SCALE,
        ftol=_TOLERANCE,
        xtol=_TOLERANCE,
        max_nfev=_MAX_EVALUATIONS,
    )
    return np.asarray(solution.x), float(solution.cost)


def _jacobian(
    family: ConsistentArms, point: FloatArray, records: Sequence[_PieceInPosture], tilt: float = 0.0
) -> FloatArray:
    """Jacobian (n_rows, n_coordinates) of the residuals."""
    parts = []
    for piece, change in _error_derivatives(family, point, records):
        weighted = change * _line_weights(piece, tilt)
        parts += [weighted.real.T, weighted.imag.T]
    steps = _DIFFERENCE_STEP * np.eye(len(point))
    prior = _prior_residuals(family, point + steps) - _prior_residuals(family, point - steps)
    return np.concatenate([*parts, prior.T / (2.0 * _DIFFERENCE_STEP)])


def _covariance(
    family: ConsistentArms, point: FloatArray, records: Sequence[_PieceInPosture]
) -> FloatArray:
    """Covariance: scatter of the gradient over frequency bands, and the model error.

    The model error is the change of the estimates with other frequency weights.
    """
    residual, J = _residual(family, point, records), _jacobian(family, point, records)
    weight = 1.0 / np.sqrt(1.0 + (residual / _ROBUST_SCALE) ** 2)
    bread = np.linalg.pinv((J * weight[:, None]).T @ J, hermitian=True)
    gradient = J * (weight * residual)[:, None]
    n_lines = [len(piece.s) for piece, _ in records for _ in piece.rows]
    bands = [_N_BANDS * k + np.arange(n) * _N_BANDS // n for k, n in enumerate(n_lines)]
    of_priors = -1 - np.arange(len(_prior_residuals(family, point)))
    # real and imaginary parts of each motor in each piece, then the priors, one by one
    labels = np.concatenate([*(np.tile(band, 2) for band in bands), of_priors])
    sums = np.array([gradient[labels == label].sum(axis=0) for label in np.unique(labels)])
    changes = [_minimize(family, point, records, tilt)[0] - point for tilt in _WEIGHT_POWERS]
    model_error = np.mean([np.outer(move, move) for move in changes], axis=0)
    return np.asarray(bread @ sums.T @ sums @ bread + model_error)
