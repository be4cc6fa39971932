"""What may be wrong with logs, for the tests of the consistency stage."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from strainwave.domain import Log, Study

Input = tuple[tuple[Log, ...], Study]


def changed(given: Input, **factors: float) -> Input:
    """With channels multiplied."""
    logs, study = given
    return tuple(
        replace(log, channels={k: factors.get(k, 1.0) * v for k, v in log.channels.items()})
        for log in logs
    ), study


def delayed(given: Input, names: tuple[str, ...], delay: float, fast: float) -> Input:
    """With channels late, or sampled by a fast clock."""
    logs, study = given
    found = []
    for log in logs:
        time = log.time - log.time[0]
        at = time * (1.0 + fast) - delay
        late = {k: np.interp(at, time, v) for k, v in log.channels.items() if k in names}
        found.append(replace(log, channels={**log.channels, **late}))
    return tuple(found), study
