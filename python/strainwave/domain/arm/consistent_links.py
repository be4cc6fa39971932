"""Physically consistent standard parameters of links: the set nearest to a prior.

A rigid body has ten standard parameters: mass, first moments and inertias. They belong to a body if
and only if its pseudo-inertia, a symmetric matrix (4, 4) that is linear in them, is positive
definite (Wensing, Kim and Slotine, 2018). Motion determines combinations only. Among the consistent
sets that have them, the one nearest to a prior in the entropic divergence is unique (Lee, Wensing
and Park, 2020). It is a representative, not an estimate.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cache

import numpy as np

from strainwave.domain.arm.description import ArmDescription, LinkPrior
from strainwave.domain.keys import FloatArray
from strainwave.errors import NumericalFailure

_MAX_STEPS = 50  # for one weight; usually 5 to 20
_TOLERANCE = 1e-12  # expected decrease of the cost
_MIN_DECREASE = 0.1  # of the cost in a step, relative to the decrease of its quadratic model
_MIN_SHARE = 1e-8  # of a step
# weights of the combinations: a full weight from the start leads along the border of the
# consistent sets
_FIRST_WEIGHT = 1e-5
_FACTOR = math.sqrt(10.0)  # from one weight to the next; smaller after a failure
_MIN_FACTOR = 1.02
INERTIA_ENTRIES = ((0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2))
"""Rows and columns of the inertias in the order of `LINK_PARAMETERS`."""
_GUESSED_MASS = 3.0  # [kg] of a link without prior
_GUESSED_LENGTH = 0.2  # [m] of a link that carries no joint
_GUESSED_RADIUS = 0.4  # radius of gyration over the link's length


def consistent_links(
    priors: Sequence[LinkPrior], rows: FloatArray, target: FloatArray
) -> FloatArray:
    """Standard parameters (10 n_links,) of bodies that agree with combinations of them.

    It minimises the divergence from `priors` plus half the squared residual rows @ p - target;
    `rows`, (n_rows, 10 n_links), and `target` are whitened by the covariance of the combinations.
    Each prior must belong to a body. Raises NumericalFailure if the search does not converge.
    """
    inverses = [np.asarray(np.linalg.inv(_pseudo_inertia(np.array(p)))) for p in priors]
    pull = np.concatenate(
        [np.asarray(np.einsum("ij,kji->k", inverse, _basis())) for inverse in inverses]
    )
    values = np.concatenate([np.array(prior) for prior in priors])
    reached, factor = _FIRST_WEIGHT / _FACTOR, _FACTOR
    while reached < 1.0:
        weight = min(1.0, factor * reached)
        minimum = _minimise(values, pull, weight * rows, weight * target)
        if minimum is not None:
            values, reached = minimum, weight
        elif (factor := math.sqrt(factor)) < _MIN_FACTOR:
            raise NumericalFailure("no physically consistent links agree with the base parameters")
    return values


def _minimise(
    values: FloatArray, pull: FloatArray, rows: FloatArray, target: FloatArray
) -> FloatArray | None:
    """Minimum of pull . p - log det P(p) + |rows p - target|^2/2 by Newton's method.

    None if it takes too many steps: from far away they lead along the border.
    """

    def cost(values: FloatArray) -> float:
        residual = rows @ values - target
        log_det = np.sum(np.linalg.slogdet(_pseudo_inertia(values.reshape(-1, 10)))[1])
        return float(pull @ values - log_det + 0.5 * residual @ residual)

    for _ in range(_MAX_STEPS):
        roots, gradient = _barrier(values)
        slope = pull + gradient
        # the step minimises |roots step + roots^-T slope|^2 + |rows step + residual|^2; with
        # roots step as unknown, links near the border of the consistent sets do not dominate
        table = np.vstack([rows, slope]).T.reshape(len(roots), 10, -1)
        *columns, force = np.linalg.solve(roots.mT, table).reshape(len(values), -1).T
        stacked = np.concatenate([np.eye(len(values)), columns])
        right = np.concatenate([-force, target - rows @ values])
        whitened = np.linalg.lstsq(stacked, right, rcond=None)[0]
        decrease = float(np.sum((stacked @ whitened) ** 2))
        step = np.linalg.solve(roots, whitened.reshape(-1, 10, 1)).ravel()
        if decrease < _TOLERANCE:
            return values
        share, before = min(1.0, _longest_step(values, step)), cost(values)
        while cost(values + share * step) > before - _MIN_DECREASE * share * decrease:
            share *= 0.5
            if share < _MIN_SHARE:
                return values  # rounding limits the cost
        values = values + share * step
    return None


def priors_of(arm: ArmDescription) -> tuple[LinkPrior, ...]:
    """Priors of the links: those of the URDF, and guesses where it has no consistent ones.

    The guess is a body along the line to the next joint.
    """
    ends = [*(np.array(joint.origin.xyz) for joint in arm.joints[1:]), np.zeros(3)]
    given = arm.urdf.priors if arm.urdf else (None,) * arm.n_joints
    priors = []
    for prior, end in zip(given, ends, strict=True):
        radius = _GUESSED_RADIUS * (float(np.linalg.norm(end)) or _GUESSED_LENGTH)
        inertia = _GUESSED_MASS * radius**2 * np.eye(3)
        guess = standard_parameters(_GUESSED_MASS, 0.5 * end, inertia)
        priors.append(prior if prior and is_consistent(prior) else guess)
    return tuple(priors)


def is_consistent(link: LinkPrior) -> bool:
    """Whether ten standard parameters belong to a body."""
    return bool(np.linalg.eigvalsh(_pseudo_inertia(np.array(link)))[0] > 0.0)


def principal_moments(link: LinkPrior) -> FloatArray:
    """Moments of inertia (3,) about the centre of mass, ascending; about the origin without mass.

    Each is less than the sum of the others for a body with a positive mass.
    """
    mass, first, about = link[0], np.array(link[1:4]), np.zeros((3, 3))
    for value, (row, column) in zip(link[4:], INERTIA_ENTRIES, strict=True):
        about[row, column] = about[column, row] = value
    if mass > 0.0:
        about -= (first @ first * np.eye(3) - np.outer(first, first)) / mass
    return np.asarray(np.linalg.eigvalsh(about))


def standard_parameters(mass: float, centre: FloatArray, inertia: FloatArray) -> LinkPrior:
    """Standard parameters of a body with an inertia (3, 3) about its centre of mass.

    The axes are those of the link's frame; the parameters are about its origin (Steiner).
    """
    about = inertia + mass * (centre @ centre * np.eye(3) - np.outer(centre, centre))
    entries = [float(about[entry]) for entry in INERTIA_ENTRIES]
    return (mass, *(mass * centre).tolist(), *entries)


@cache
def _basis() -> FloatArray:
    """Pseudo-inertia per standard parameter, (10, 4, 4).

    It is [trace(I)/2 E - I, h; h', m] with the inertia I, the first moments h and the mass m.
    """
    basis = np.zeros((10, 4, 4))
    basis[0, 3, 3] = 1.0
    for axis in range(3):
        basis[1 + axis, axis, 3] = basis[1 + axis, 3, axis] = 1.0
    for k, (row, column) in enumerate(INERTIA_ENTRIES, start=4):
        if row == column:
            basis[k, range(3), range(3)] = 0.5
            basis[k, row, row] = -0.5
        else:
            basis[k, row, column] = basis[k, column, row] = -1.0
    return basis


def _pseudo_inertia(links: FloatArray) -> FloatArray:
    """Pseudo-inertias (..., 4, 4) of standard parameters (..., 10)."""
    return (links @ _basis().reshape(10, 16)).reshape(*links.shape[:-1], 4, 4)


def _whitening(values: FloatArray) -> FloatArray:
    """Inverse Cholesky factor of each link's pseudo-inertia, (n_links, 4, 4)."""
    return np.asarray(np.linalg.inv(np.linalg.cholesky(_pseudo_inertia(values.reshape(-1, 10)))))


def _barrier(values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Root R of the Hessian R'R of -log det, one block (10, 10) per link, and its gradient."""
    inverse = _whitening(values)[:, None]
    whitened = inverse @ _basis() @ inverse.mT  # (n_links, 10, 4, 4); products are the Hessian
    roots = np.linalg.qr(whitened.reshape(-1, 10, 16).mT, mode="r")
    return np.asarray(roots), -np.trace(whitened, axis1=2, axis2=3).ravel()


def _longest_step(values: FloatArray, step: FloatArray) -> float:
    """Share of a step that keeps a tenth of the distance to the first inconsistent set."""
    inverse = _whitening(values)
    moved = inverse @ _pseudo_inertia(step.reshape(-1, 10)) @ inverse.mT
    lowest = float(np.linalg.eigvalsh(moved).min())
    return -0.9 / lowest if lowest < 0.0 else np.inf
