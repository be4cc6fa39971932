"""Sliding direction of a motor, and shape functions of the friction torque where it is unknown.

Coulomb friction is f sgn(dq) only while the motor slides. Around each reversal and at standstill,
the friction torque has any value in [-f, f] and is a separate unknown.
"""

from __future__ import annotations

from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from strainwave.domain import BoolArray, FloatArray, IntArray
from strainwave.numerics.linalg import Banded

# Share of the largest speed below which a motor creeps within its stiction: the friction of
# simulators and of bristles deflects before it slides, which a fine encoder resolves.
_MAX_CREEP = 1e-4

Value = TypeVar("Value", np.bool_, np.float64)


def sliding_direction(angle: FloatArray, resolution: float, standing: int) -> FloatArray:
    """Direction in which the motor certainly slides: +1, -1, or 0 if uncertain, (n_samples,).

    A direction is certain if the angle differs from the last and from the next turning point by
    more than the resolution. At least `standing` consecutive samples within the resolution are
    standstill.

    `angle` is the unfiltered measurement, because a filter shifts the times of reversal.
    `resolution` is an encoder count or a few standard deviations of the noise, in the unit of the
    angle.
    """
    direction = np.zeros(len(angle))
    for start, stop, sign in _find_monotone_runs(angle, resolution):
        run = sign * angle[start : stop + 1]
        inside = (run > run[0] + resolution) & (run < run[-1] - resolution)
        direction[start : stop + 1][inside] = sign
    width = max(2, standing)
    spread = running(np.maximum, angle, width) - running(np.minimum, angle, width)
    smallest = max(resolution, _MAX_CREEP * float(spread.max()))
    direction[running(np.logical_or, spread <= smallest, width)] = 0.0
    return direction


def _find_monotone_runs(angle: FloatArray, resolution: float) -> list[tuple[int, int, int]]:
    """(start, stop, sign) between turning points that differ by more than the resolution."""
    runs: list[tuple[int, int, int]] = []
    start, extreme, sign = 0, 0, 0
    low = high = 0
    steps = np.diff(angle)
    moving = np.flatnonzero(steps)
    reverses = np.diff(np.sign(steps[moving])) != 0.0
    turns = [0, *(moving[np.r_[reverses, True][: len(moving)]] + 1).tolist()]
    values = dict(zip(turns, angle[turns].tolist(), strict=True))
    for k, value in values.items():
        if sign == 0:
            low = k if value < values[low] else low
            high = k if value > values[high] else high
            if values[high] - values[low] > resolution:
                sign = 1 if high > low else -1
                start, extreme = (low, high) if sign > 0 else (high, low)
        elif sign * (value - values[extreme]) > 0.0:
            extreme = k
        elif sign * (values[extreme] - value) > resolution:
            runs.append((start, extreme, sign))
            start, extreme, sign = extreme, k, -sign
    if sign != 0:
        runs.append((start, extreme, sign))
    return runs


def running(extreme: np.ufunc, values: NDArray[Value], width: int) -> NDArray[Value]:
    """Running maximum or minimum over `width` values centred on each value, (n,).

    `extreme` is `np.maximum`, `np.minimum`, `np.logical_or` or `np.logical_and`. If the width is
    even, the window has one more value before than after. It is truncated at both ends.
    """
    result = np.pad(values, (width // 2, (width - 1) // 2), mode="edge")
    reach = 1  # current window width; two windows combine to up to twice the width
    while reach < width:
        step = min(reach, width - reach)
        result = extreme(result[:-step], result[step:])
        reach += step
    return result


def runs_of(at: BoolArray) -> IntArray:
    """Runs of True as (n_runs, 2): the first sample and the index after the last sample."""
    return np.flatnonzero(np.diff(np.r_[False, at, False].astype(np.int8))).reshape(-1, 2)


class Shapes(NamedTuple):
    """Constants and triangles 1 - slope |k - centre| at the samples k from `first` to `stop` - 1.

    One of each value per shape, (n_shapes,), ordered by the first and the last samples.
    """

    first: IntArray
    stop: IntArray
    centre: FloatArray  # [samples]
    slope: FloatArray  # per sample; zero if constant


def free_friction(direction: FloatArray, spacing: int) -> Shapes:
    """Shape functions of the friction torque at uncertain directions.

    A stretch shorter than `spacing` [samples] has one constant shape, because only its area affects
    the low-pass filtered torque. Longer stretches have overlapping triangles that sum to one, with
    centres about `spacing` apart. `direction`, (n_samples,), is from `sliding_direction`.
    """
    begin, end = runs_of(direction == 0.0).T
    length = end - begin
    n_knots = np.maximum(1, np.rint(length / spacing).astype(np.int64)) + (length > spacing)
    is_constant = n_knots == 1
    distance = np.where(is_constant, length, (length - 1) / np.maximum(1, n_knots - 1))
    stretch = np.repeat(np.arange(len(length)), n_knots)
    knot = np.arange(len(stretch)) - np.repeat(np.cumsum(n_knots) - n_knots, n_knots)
    start, length, distance = begin[stretch], length[stretch], distance[stretch]
    first = np.maximum(np.floor((knot - 1) * distance).astype(np.int64) + 1, 0)
    stop = np.minimum(np.ceil((knot + 1) * distance).astype(np.int64), length)
    slope = np.where(is_constant[stretch], 0.0, 1.0 / distance)
    return Shapes(start + first, start + stop, start + knot * distance, slope)


def responses(shapes: Shapes, rows: IntArray, kernel: FloatArray) -> Banded:
    """Responses of a filter to all shape functions at selected samples, (n_rows, n_shapes).

    `rows` are ascending sample indices, (n_rows,). `kernel`, (2 reach + 1,), is the impulse
    response centred on the impulse and must decay to zero at both ends. Each row of the banded
    result has the shapes within reach.
    """
    reach = len(kernel) // 2
    # Rows within reach of each shape, and shapes within reach of each row.
    low = np.searchsorted(rows, shapes.first - reach)
    high = np.searchsorted(rows, shapes.stop + reach)
    earliest = np.searchsorted(high, np.arange(len(rows)), side="right")
    past_last = np.searchsorted(low, np.arange(len(rows)), side="right")
    width = int(np.max(past_last - earliest, initial=0))
    entries = np.zeros((len(rows), width))
    # A shape is linear before and after its peak: sums of the kernel and of its first moment.
    peak = np.clip(np.floor(shapes.centre).astype(np.int64) + 1, shapes.first, shapes.stop)
    level = np.concatenate([[0.0], np.cumsum(kernel)])
    moment = np.concatenate([[0.0], np.cumsum(kernel * np.arange(-reach, reach + 1))])
    row, k = np.nonzero(np.arange(width) < (past_last - earliest)[:, None])
    shape, at_row = earliest[row] + k, rows[row]
    before, at, after = (
        np.clip(at_row + (reach + 1) - edge[shape], 0, len(kernel))
        for edge in (shapes.first, peak, shapes.stop)
    )
    slope = shapes.slope[shape]
    beyond = at_row - shapes.centre[shape]
    levels = level[before] + level[after] - 2.0 * level[at]
    moments = moment[before] + moment[after] - 2.0 * moment[at]
    entries[row, k] = level[before] - level[after] + slope * (beyond * levels - moments)
    return Banded(earliest, entries, len(shapes.first))
