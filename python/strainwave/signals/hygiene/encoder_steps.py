"""Detection of encoder steps: lost counts, a reset by the index pulse, a counter overflow."""

from __future__ import annotations

import numpy as np

from strainwave.domain import Log
from strainwave.dynamics.arm import Arm
from strainwave.signals.hygiene.defects import Defect, count_of, encoder_kinds, of_kinds
from strainwave.signals.hygiene.frozen import find_frozen_before
from strainwave.signals.hygiene.isolated import classify_jumps
from strainwave.signals.standstill import runs_of

_MAX_OVERFLOW_SPREAD = 0.02  # maximum spread of overflow steps, relative to the largest one


def detect(log: Log, arm: Arm) -> list[Defect]:
    """Detect permanent steps of an angle that are inconsistent with the motion around them.

    A reading that is repeated once is not a step: the log is written faster than the encoder is
    read, and the angle is late by up to one sample.
    """
    detections = []
    for name, x in of_kinds(log, encoder_kinds()).items():
        _, isolated_steps = classify_jumps(x, count_of(name, arm))
        rest_runs = runs_of(np.diff(x) == 0.0)
        steps = [
            jump
            for jump in isolated_steps
            if x[jump.sample] != x[jump.sample - 1] and not find_frozen_before(x, jump, rest_runs)
        ]
        size = np.abs([step.size for step in steps])
        wraps = len(size) > 1 and bool(np.ptp(size) < _MAX_OVERFLOW_SPREAD * size.max())
        detections += [
            Defect("encoder-steps", name, step.sample, step.sample + 1, step.size, wraps=wraps)
            for step in steps
        ]
    return detections
