"""Faults of logs for tests of the input check."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from strainwave.domain import Log, Study

Input = tuple[tuple[Log, ...], Study]


def changed(given: Input, **factors: float) -> Input:
    """Logs with scaled channels."""
    logs, study = given
    return tuple(
        replace(log, channels={k: factors.get(k, 1.0) * v for k, v in log.channels.items()})
        for log in logs
    ), study


def delayed(given: Input, names: tuple[str, ...], delay: float, fast: float) -> Input:
    """Logs with delayed channels, or with a fast sensor clock."""
    logs, study = given
    changed_logs = []
    for log in logs:
        time = log.time - log.time[0]
        at = time * (1.0 + fast) - delay
        late = {k: np.interp(at, time, v) for k, v in log.channels.items() if k in names}
        changed_logs.append(replace(log, channels={**log.channels, **late}))
    return tuple(changed_logs), study
