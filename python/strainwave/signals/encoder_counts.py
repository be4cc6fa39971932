"""Encoder resolution estimated from the steps of a quantised motor angle."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from strainwave.domain import FloatArray

# Minimum number of steps for an estimate.
_MIN_STEPS = 40
# Maximum step in counts. Rounding of the logged digits hides the count in larger steps.
_MAX_STEP_COUNTS = 12.0
# Maximum distance of a step from a whole number of counts, in counts.
_MAX_COUNT_DISTANCE = 0.12
# Minimum share of the steps within `_MAX_COUNT_DISTANCE` of a whole number of counts.
_MIN_WHOLE_SHARE = 0.97
# Minimum share of the steps that are odd multiples of a count.
_MIN_ODD_SHARE = 0.25
# Maximum number of samples evaluated per record.
_MAX_SAMPLES = 40_000


def estimate_encoder_count(angles: Sequence[FloatArray]) -> float | None:
    """Size of one encoder count of a motor angle, in the unit of the channel.

    The count is the smallest step between consecutive samples, provided that nearly all small
    steps are whole multiples of it. `angles` holds the same channel of several records, each of
    shape (n_samples,). Returns None if the angle shows no quantisation.
    """
    used = [angle[:_MAX_SAMPLES] for angle in angles]
    # interpolation, as of a shifted log, divides a step, but not that between two held readings
    held = [angle[1:][angle[1:] == angle[:-1]] for angle in used]
    steps = _nonzero_steps(held)
    if len(steps) < _MIN_STEPS:
        steps = _nonzero_steps(used)
    if len(steps) < _MIN_STEPS:
        return None
    sorted_steps = np.sort(steps)
    smallest = sorted_steps[: max(1, len(sorted_steps) // 1000) + 4]
    min_step = float(np.median(smallest))
    if min_step == 0.0:
        return None
    count = float(np.median(sorted_steps[sorted_steps < 1.5 * min_step]))
    small_steps = sorted_steps[sorted_steps < _MAX_STEP_COUNTS * count]
    if len(small_steps) < _MIN_STEPS or len(small_steps) < 0.001 * len(sorted_steps):
        return None
    multiples = np.round(small_steps / count)
    if multiples.min() < 1.0:
        return None
    if np.mean(multiples % 2.0 == 1.0) < _MIN_ODD_SHARE:  # interpolated samples halve a count
        count, multiples = 2.0 * count, 0.5 * multiples
        whole = multiples % 1.0 == 0.0
        small_steps, multiples = small_steps[whole], multiples[whole]
    count = float(multiples @ small_steps / (multiples @ multiples))
    distance = np.abs(small_steps / count - multiples)
    distinct = len(np.unique(multiples))
    return (
        count
        if np.mean(distance < _MAX_COUNT_DISTANCE) > _MIN_WHOLE_SHARE and distinct > 1
        else None
    )


def _nonzero_steps(angles: Sequence[FloatArray]) -> FloatArray:
    steps = np.concatenate([np.zeros(0), *(np.abs(np.diff(angle)) for angle in angles)])
    return np.asarray(steps[steps > 1e-9 * steps.max(initial=0.0)])
