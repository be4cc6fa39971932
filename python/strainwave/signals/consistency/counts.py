"""The step of a quantised motor angle, which is one count of its encoder."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from strainwave.domain import FloatArray

_FEWEST = 40  # small steps that must agree
_MOST_COUNTS = 12.0  # between samples, beyond which a written log's digits blur the count
_NEAR = 0.12  # of a count
_SHARE = 0.97  # of the steps that lie near whole counts
_MOST_SAMPLES = 40_000


def count_of(angles: Sequence[FloatArray]) -> float | None:
    """One count of the encoder behind a motor angle.

    The smallest step between neighbours, if nearly all small steps are whole multiples of it.

    Parameters
    ----------
    angles : sequence of (n_samples,)
        The same channel in several records.

    Returns
    -------
    float or None
        In the channel's unit; None: the angle shows no counts.
    """
    steps = np.concatenate([np.abs(np.diff(angle[:_MOST_SAMPLES])) for angle in angles])
    largest = steps.max(initial=0.0)
    steps = steps[steps > 1e-9 * largest]
    if len(steps) < _FEWEST:
        return None
    ordered = np.sort(steps)
    smallest = ordered[: max(1, len(ordered) // 1000) + 4]
    least = float(np.median(smallest))
    if least == 0.0:
        return None
    count = float(np.median(ordered[ordered < 1.5 * least]))
    near = ordered[ordered < _MOST_COUNTS * count]
    if len(near) < _FEWEST or len(near) < 0.001 * len(ordered):
        return None
    number = np.round(near / count)
    if number.min() < 1.0:
        return None
    count = float(number @ near / (number @ number))
    off = np.abs(near / count - number)
    distinct = len(np.unique(number))
    return count if np.mean(off < _NEAR) > _SHARE and distinct > 1 else None
