"""Where a motor certainly slides, which way, and what may be said where it may stand.

Coulomb friction is f sgn(dq) only while the motor slides. Around each reversal, and while it
stands, the friction torque is anywhere in [-f, f]: there it is an unknown of its own, not a sign.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from strainwave.domain import BoolArray, FloatArray, IntArray
from strainwave.numerics.banded import Banded

Value = TypeVar("Value", np.bool_, np.float64)


def sliding_direction(angle: FloatArray, resolution: float, standing: int) -> FloatArray:
    """Direction in which the motor certainly slides.

    A direction is certain once the angle has left its last extreme by more than the resolution;
    from there back to the extreme, and on the way into it, it is not. Stretches of at least
    `standing` samples within the resolution count as standing still.

    Parameters
    ----------
    angle : (n_samples,)
        As measured, not smoothed: smoothing moves the instants of reversal.
    resolution : float
        What the sensor resolves: an encoder count, or a few deviations of its noise.
    standing : int
        Samples.

    Returns
    -------
    (n_samples,)
        +1, -1, or 0 where it is uncertain.
    """
    direction = np.zeros(len(angle))
    for start, stop, sign in _monotone_runs(angle, resolution):
        run = sign * angle[start : stop + 1]
        inside = (run > run[0] + resolution) & (run < run[-1] - resolution)
        direction[start : stop + 1][inside] = sign
    direction[_stands(angle, resolution, standing)] = 0.0
    return direction


def _monotone_runs(angle: FloatArray, resolution: float) -> list[tuple[int, int, int]]:
    """(start, stop, sign) between turning points that are further apart than the resolution."""
    runs: list[tuple[int, int, int]] = []
    start, extreme, sign = 0, 0, 0
    low = high = 0
    turns = _turns(angle)
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


def _turns(angle: FloatArray) -> list[int]:
    """The first sample, the last that differs, and between them each that the angle turns at."""
    steps = np.diff(angle)
    moving = np.flatnonzero(steps)
    back = np.diff(np.sign(steps[moving])) != 0.0
    return [0, *(moving[np.r_[back, True][: len(moving)]] + 1).tolist()]


def _stands(angle: FloatArray, resolution: float, standing: int) -> BoolArray:
    """Samples inside a window of `standing` ones over which the angle keeps within resolution."""
    width = max(2, standing)
    spread = running(np.maximum, angle, width) - running(np.minimum, angle, width)
    return running(np.logical_or, spread <= resolution, width)


def running(extreme: np.ufunc, values: NDArray[Value], width: int) -> NDArray[Value]:
    """The largest, or the least, of `width` values about each one.

    Parameters
    ----------
    extreme : ufunc
        `np.maximum`, `np.minimum`, `np.logical_or` or `np.logical_and`.
    values : (n,)
    width : int
        Of an even number, one more lies before than behind; at the ends there are fewer.

    Returns
    -------
    (n,)
    """
    found = np.pad(values, (width // 2, (width - 1) // 2), mode="edge")
    reach = 1  # of each value found so far; two of them make one of up to twice the reach
    while reach < width:
        step = min(reach, width - reach)
        found = extreme(found[:-step], found[step:])
        reach += step
    return found


def runs_of(at: BoolArray) -> IntArray:
    """First sample and the one behind the last of each run of True.

    Parameters
    ----------
    at : (n_samples,)

    Returns
    -------
    (n_runs, 2)
    """
    return np.flatnonzero(np.diff(np.r_[False, at, False].astype(np.int8))).reshape(-1, 2)


def free_friction(direction: FloatArray, spacing: int) -> list[tuple[int, FloatArray]]:
    """Shapes that span the friction torque where the direction is uncertain.

    One shape a stretch that is shorter than the spacing: seen through the low-pass filter only its
    area matters. Longer stretches take overlapping triangles that sum to one.

    Parameters
    ----------
    direction : (n_samples,)
        From `sliding_direction`.
    spacing : int
        Samples between the triangles' centres.

    Returns
    -------
    list of (first sample, shape)
    """
    uncertain = np.r_[False, direction == 0.0, False]
    edges = np.flatnonzero(np.diff(uncertain.astype(np.int8)))
    shapes: list[tuple[int, FloatArray]] = []
    known: dict[int, list[tuple[int, FloatArray]]] = {}  # stretches of one length share theirs
    for first, stop in edges.reshape(-1, 2).tolist():
        length = stop - first
        if length not in known:
            known[length] = _shapes_of(length, spacing)
        shapes += [(first + start, shape) for start, shape in known[length]]
    return shapes


def _shapes_of(length: int, spacing: int) -> list[tuple[int, FloatArray]]:
    """(first sample, shape) of one stretch."""
    n_knots = max(1, round(length / spacing)) + (length > spacing)
    if n_knots == 1:
        return [(0, np.ones(length))]
    shapes = []
    position = np.arange(length) * ((n_knots - 1) / max(1, length - 1))
    for knot in range(n_knots):
        shape = np.clip(1.0 - np.abs(position - knot), 0.0, None)
        inside = np.flatnonzero(shape)
        shapes.append((int(inside[0]), shape[inside[0] : inside[-1] + 1]))
    return shapes


def responses(
    shapes: Sequence[tuple[int, FloatArray]], rows: IntArray, kernel: FloatArray
) -> Banded:
    """Each shape through a filter, at some samples.

    Parameters
    ----------
    shapes : sequence of (first sample, shape)
        As `free_friction` gives them: none begins or ends before the one before it.
    rows : (n_rows,)
        Samples wanted, in rising order.
    kernel : (2 reach + 1,)
        The filter's answer to an impulse at its middle; it must have died away at both ends.

    Returns
    -------
    Banded
        (n_rows, n_shapes): a row has the shapes within reach of it.
    """
    reach = len(kernel) // 2
    begin = np.array([first for first, _ in shapes], dtype=np.int64)
    length = np.array([len(shape) for _, shape in shapes], dtype=np.int64)
    distinct = {id(shape): shape for _, shape in shapes}  # stretches of one length share theirs
    constant = {name for name, shape in distinct.items() if shape.min() == 1.0}
    flat = np.array([id(shape) in constant for _, shape in shapes], dtype=bool)
    # the samples that a shape reaches, and the shapes that reach a row
    low = np.searchsorted(rows, begin - reach)
    high = np.searchsorted(rows, begin + length + reach)
    earliest = np.searchsorted(high, np.arange(len(rows)), side="right")
    behind = np.searchsorted(low, np.arange(len(rows)), side="right")
    width = int(np.max(behind - earliest, initial=0))
    entries = np.zeros((len(rows), width))
    answers: dict[int, FloatArray] = {}
    for c in np.flatnonzero(~flat).tolist():
        name = id(shapes[c][1])
        if name not in answers:
            answers[name] = np.convolve(shapes[c][1], kernel)
        response = answers[name]
        near = np.arange(low[c], high[c])
        entries[near, c - earliest[near]] = response[rows[near] - (begin[c] - reach)]
    # most shapes are constant: their answers are differences of the answer to a step
    step = np.concatenate([[0.0], np.cumsum(kernel)])
    for k in range(width if flat.any() else 0):
        near = np.flatnonzero(earliest + k < behind)
        shape = earliest[near] + k
        near, shape = near[flat[shape]], shape[flat[shape]]
        since = rows[near] + (reach + 1) - begin[shape]
        before = since - length[shape]
        entries[near, k] = step.take(since, mode="clip") - step.take(before, mode="clip")
    return Banded(earliest, entries, len(shapes))
