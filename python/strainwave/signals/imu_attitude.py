"""Place and attitude of an IMU that explain what its axes read: a search from all sides.

What the axes read is linear in signals of their link, and their factors are products of the place
and of a rotation. From many turns a few steps of least squares go to a minimum
nearby, and the lowest counts.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import product

import numpy as np

from strainwave.domain import FloatArray
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.mounting import (
    BEARING,
    FROM_AXIS,
    PLACE,
    START,
    TURN,
    Axis,
    attitude_of,
    factors,
    slopes,
    unknowns_of,
)
from strainwave.dynamics.rotations import angles, attitude

Key = tuple[str, int | None]

_TRIED = 16  # of the turns, the best, from which a search goes on
_STEPS = 120  # of each search
_DAMPING = 1e-3  # of its first step
_ENOUGH = 1e-9  # relative gain below which it ends
_ALIKE = 0.01  # relative difference of what two minima leave that are one
_RIDGE = 1e-9  # of the information, for what nothing shows
_BEARINGS = 8
_NOTHING = 1e-9  # of the largest column, below which one is nothing
_LONGEST = 0.7  # [rad, or m] of a step


def imu_starts(axes: Sequence[Axis], tables: Sequence[FloatArray], arm: Arm) -> dict[Key, float]:
    """The unknowns of an IMU's mounting that fit best what its axes read.

    Parameters
    ----------
    axes : sequence of Axis
        Of one link.
    tables : sequence of (n_rows, n_quantities + 1)
        Of each axis, what it reads a combination of and, last, what it reads.
    arm : Arm

    Returns
    -------
    dict
        (name, joint) -> value, of `strainwave.dynamics.mounting.unknowns_of` and of the attitude
        that the turn starts from.
    """
    return imu_candidates(axes, tables, arm)[0]


def imu_candidates(
    axes: Sequence[Axis], tables: Sequence[FloatArray], arm: Arm, *, flat: bool = False
) -> list[dict[Key, float]]:
    """Mountings that fit what an IMU's axes read, each at a minimum of its own.

    Parameters
    ----------
    axes, tables, arm
        As of `imu_starts`.
    flat : bool
        Whether its x and y axes lie in the plane of motion.

    Returns
    -------
    list of dict
        The best first.
    """
    wanted = [_Wanted.of(axis, table) for axis, table in zip(axes, tables, strict=True)]
    found: list[tuple[float, dict[Key, float]]] = []
    for cost, values in _searched(wanted, axes, arm, flat=flat):
        apart = (abs(cost - known) > _ALIKE * max(cost, known) for known, _ in found)
        if all(apart):
            found.append((cost, values))
    return [_outward(values, axes[0].joint) for _, values in found]


def _outward(values: dict[Key, float], joint: int) -> dict[Key, float]:
    """The same mounting with a positive distance: half a turn about the axis."""
    distance = values.get((FROM_AXIS, joint), 1.0)
    if distance >= 0.0:
        return values
    start = np.diag([-1.0, -1.0, 1.0]) @ attitude_of(values, joint)
    found = {**values, (FROM_AXIS, joint): -distance}
    found |= {(name, joint): 0.0 for name in TURN if (name, joint) in found}
    found |= {(name, joint): at for name, at in zip(START, angles(start).tolist(), strict=True)}
    if (BEARING, joint) in found:
        found[BEARING, joint] += np.pi
    return found


def in_mirror(values: Mapping[Key, float], joint: int) -> dict[Key, float]:
    """The mounting on the other side of the link: its axes count f_y and alpha as they did.

    What changes sign, the shares of f_x and w^2, shows in quick or wide motions only.

    Parameters
    ----------
    values : dict
        Of a mounting with a turn.
    joint : int
        From 1.

    Returns
    -------
    dict
    """
    found = dict(values)
    start = np.diag([-1.0, 1.0, -1.0]) @ attitude_of(values, joint)
    found |= {(name, joint): 0.0 for name in TURN if (name, joint) in found}
    found |= {(name, joint): at for name, at in zip(START, angles(start).tolist(), strict=True)}
    for name in (PLACE[1], BEARING):
        if (name, joint) in found:
            found[name, joint] = -found[name, joint]
    return found


class _Wanted:
    """One axis's factors by linear least squares, with how surely each is known."""

    def __init__(self, axis: Axis, root: FloatArray, target: FloatArray) -> None:
        self.axis, self.root, self.target = axis, root, target

    @classmethod
    def of(cls, axis: Axis, rows: FloatArray) -> _Wanted:
        """R and Q'y of the rows, so that |R f - Q'y|^2 is what factors f leave, but a constant."""
        n = rows.shape[1] - 1
        ridge = _RIDGE * max(float(np.linalg.norm(rows[:, :-1])), 1e-150) * np.eye(n, n + 1)
        triangle = np.asarray(np.linalg.qr(np.concatenate([rows, ridge]), mode="r"))
        return cls(axis, triangle[:, :-1], triangle[:, -1])


def _searched(
    wanted: Sequence[_Wanted], axes: Sequence[Axis], arm: Arm, *, flat: bool
) -> list[tuple[float, dict[Key, float]]]:
    """Minima by what they leave, least first, and the mountings there."""
    joint, keys = axes[0].joint, unknowns_of(axes, arm)
    turns = any(key[0] in TURN for key in keys)
    if flat:
        keys = [key for key in keys if key[0] not in TURN[:2]]
    bears = (BEARING, joint) in keys
    starts = []
    for turned in _turns(flat=flat) if turns else [np.eye(3)]:
        for k in range(_BEARINGS if bears else 1):
            values = dict.fromkeys(keys, 0.0)
            if turns:
                rpy = angles(turned).tolist()
                values |= {(name, joint): at for name, at in zip(START, rpy, strict=True)}
            if bears:
                values[BEARING, joint] = 2.0 * np.pi * k / _BEARINGS
            placed = _placed(wanted, values, keys, arm)
            starts.append((_cost(wanted, placed, arm), placed))
    starts.sort(key=lambda one: one[0])
    found = [_minimum(wanted, values, keys, arm) for _, values in starts[:_TRIED]]
    return sorted(found, key=lambda one: one[0])


def _turns(*, flat: bool) -> Iterator[FloatArray]:
    """All rotations by right angles, and twice as many between; or those in a plane."""
    if flat:
        for k, side in product(range(8), (1.0, -1.0)):
            c, s = np.cos(k * np.pi / 4.0), np.sin(k * np.pi / 4.0)
            yield np.array([[c, -s * side, 0.0], [s, c * side, 0.0], [0.0, 0.0, side]])
        return
    between = [attitude(rpy) for rpy in ((0.5, 0.6, 0.7), (-0.7, 0.5, -0.6))]
    for order in ((0, 1, 2), (1, 2, 0), (2, 0, 1), (0, 2, 1), (2, 1, 0), (1, 0, 2)):
        for signs in product((1.0, -1.0), repeat=3):
            matrix = np.eye(3)[:, order] * np.array(signs)
            if np.linalg.det(matrix) > 0.0:
                yield matrix
                yield from (matrix @ own for own in between)


def _residual(wanted: Sequence[_Wanted], values: dict[Key, float], arm: Arm) -> FloatArray:
    parts = [one.root @ factors(one.axis, arm, values) - one.target for one in wanted]
    return np.concatenate(parts)


def _cost(wanted: Sequence[_Wanted], values: dict[Key, float], arm: Arm) -> float:
    return float(np.sum(_residual(wanted, values, arm) ** 2))


def _jacobian(
    wanted: Sequence[_Wanted], values: dict[Key, float], keys: Sequence[Key], arm: Arm
) -> FloatArray:
    return np.concatenate([one.root @ slopes(one.axis, arm, values, keys) for one in wanted])


def _placed(
    wanted: Sequence[_Wanted], values: dict[Key, float], keys: Sequence[Key], arm: Arm
) -> dict[Key, float]:
    """With the best place, and gyros' shares, for an attitude: the readings are linear in them."""
    linear = [key for key in keys if key[0] in (FROM_AXIS, *PLACE) or key[0].endswith("_z")]
    linear = [key for key in linear if key[0] not in TURN]
    if not linear:
        return values
    table = _jacobian(wanted, values, linear, arm)
    best = np.linalg.lstsq(table, -_residual(wanted, values, arm))[0]
    placed = {**values, **dict(zip(linear, best.tolist(), strict=True))}
    joint = linear[0][1]
    if placed.get((FROM_AXIS, joint), 1.0) < 0.0:  # the other way round
        placed[FROM_AXIS, joint] = 0.0
    return placed


def _minimum(
    wanted: Sequence[_Wanted], values: dict[Key, float], keys: Sequence[Key], arm: Arm
) -> tuple[float, dict[Key, float]]:
    """Levenberg and Marquardt's steps to the minimum near a mounting, and what is left there."""
    cost, damping = _cost(wanted, values, arm), _DAMPING
    for _ in range(_STEPS):
        table, off = _jacobian(wanted, values, keys, arm), _residual(wanted, values, arm)
        size = np.linalg.norm(table, axis=0)
        size = np.maximum(size, _NOTHING * max(float(size.max()), 1e-300))
        rows = np.concatenate([table / size, np.sqrt(damping) * np.eye(len(keys))])
        step = np.linalg.lstsq(rows, np.concatenate([-off, np.zeros(len(keys))]))[0] / size
        moved = dict(values)
        step *= min(1.0, _LONGEST / max(float(np.max(np.abs(step))), 1e-300))
        for key, by in zip(keys, step.tolist(), strict=True):
            moved[key] += by
        now = _cost(wanted, moved, arm)
        if now < cost:
            gain, cost, values, damping = cost - now, now, moved, 0.2 * damping
            if gain < _ENOUGH * cost:
                break
        else:
            damping *= 5.0
            if damping > 1e6:
                break
    return cost, values
