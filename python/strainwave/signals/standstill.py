"""Sliding direction of a motor, and shape functions of the friction torque where it is unknown.

Coulomb friction is f sgn(dq) only while the motor slides. Around each reversal and at standstill,
the friction torque has any value in [-f, f] and is a separate unknown.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TypeVar

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


def free_friction(direction: FloatArray, spacing: int) -> list[tuple[int, FloatArray]]:
    """Shape functions, as (first sample, shape), of the friction torque at uncertain directions.

    A stretch shorter than `spacing` [samples] has one constant shape, because only its area affects
    the low-pass filtered torque. Longer stretches have overlapping triangles that sum to one, with
    centres about `spacing` apart. `direction`, (n_samples,), is from `sliding_direction`.
    """
    shapes: list[tuple[int, FloatArray]] = []
    # Stretches of equal length share their shapes.
    shapes_by_length: dict[int, list[tuple[int, FloatArray]]] = {}
    for first, stop in runs_of(direction == 0.0).tolist():
        length = stop - first
        if length not in shapes_by_length:
            shapes_by_length[length] = _stretch_shapes(length, spacing)
        shapes += [(first + start, shape) for start, shape in shapes_by_length[length]]
    return shapes


def _stretch_shapes(length: int, spacing: int) -> list[tuple[int, FloatArray]]:
    """Shape functions, as (first sample, shape), of one stretch."""
    n_knots = max(1, round(length / spacing)) + (length > spacing)
    if n_knots == 1:
        return [(0, np.ones(length))]
    distance = (length - 1) / (n_knots - 1)  # of two centres [samples]
    shapes = []
    for knot in range(n_knots):
        first = max(math.floor((knot - 1) * distance) + 1, 0)
        stop = min(math.ceil((knot + 1) * distance), length)
        shapes.append((first, 1.0 - np.abs(np.arange(first, stop) / distance - knot)))
    return shapes


def responses(
    shapes: Sequence[tuple[int, FloatArray]], rows: IntArray, kernel: FloatArray
) -> Banded:
    """Responses of a filter to all shape functions at selected samples, (n_rows, n_shapes).

    `shapes` are from `free_friction`, ordered by their first and last samples. `rows` are ascending
    sample indices, (n_rows,). `kernel`, (2 reach + 1,), is the impulse response centred on the
    impulse and must decay to zero at both ends. Each row of the banded result has the shapes within
    reach.
    """
    reach = len(kernel) // 2
    begin = np.array([first for first, _ in shapes], dtype=np.int64)
    length = np.array([len(shape) for _, shape in shapes], dtype=np.int64)
    distinct = {id(shape): shape for _, shape in shapes}  # stretches of equal length share shapes
    constant = {name for name, shape in distinct.items() if shape.min() == 1.0}
    is_constant = np.array([id(shape) in constant for _, shape in shapes], dtype=bool)
    # Rows within reach of each shape, and shapes within reach of each row.
    low = np.searchsorted(rows, begin - reach)
    high = np.searchsorted(rows, begin + length + reach)
    earliest = np.searchsorted(high, np.arange(len(rows)), side="right")
    past_last = np.searchsorted(low, np.arange(len(rows)), side="right")
    width = int(np.max(past_last - earliest, initial=0))
    entries = np.zeros((len(rows), width))
    response_by_shape: dict[int, FloatArray] = {}
    for c in np.flatnonzero(~is_constant).tolist():
        name = id(shapes[c][1])
        if name not in response_by_shape:
            response_by_shape[name] = np.convolve(shapes[c][1], kernel)
        response = response_by_shape[name]
        reached = np.arange(low[c], high[c])
        entries[reached, c - earliest[reached]] = response[rows[reached] - (begin[c] - reach)]
    # Most shapes are constant: their responses are differences of the step response.
    step = np.concatenate([[0.0], np.cumsum(kernel)])
    for k in range(width if is_constant.any() else 0):
        reached = np.flatnonzero(earliest + k < past_last)
        shape = earliest[reached] + k
        reached, shape = reached[is_constant[shape]], shape[is_constant[shape]]
        since_start = rows[reached] + (reach + 1) - begin[shape]
        since_end = since_start - length[shape]
        entries[reached, k] = step.take(since_start, mode="clip") - step.take(
            since_end, mode="clip"
        )
    return Banded(earliest, entries, len(shapes))
