"""Steps of encoders: lost counts, a reset by the index, a counter that wraps."""

from __future__ import annotations

import numpy as np

from strainwave.domain import Log
from strainwave.dynamics.arm import Arm
from strainwave.signals.hygiene.defects import ENCODERS, Defect, count_of, of_kinds
from strainwave.signals.hygiene.frozen import ends_a_freeze
from strainwave.signals.hygiene.isolated import Jump, spikes_and_steps
from strainwave.signals.standstill import runs_of

_WRAP = 0.02  # of a counter's range, by which its wraps may differ


def detect(log: Log, arm: Arm) -> list[Defect]:
    """Increments of an angle that stay, and that the motion on either side does not explain."""
    found = []
    for name, x in of_kinds(log, ENCODERS).items():
        _, alone = spikes_and_steps(x, count_of(name, arm))
        still = runs_of(np.diff(x) == 0.0)
        steps = [jump for jump in alone if not ends_a_freeze(x, jump, still)]
        wraps = _are_wraps(steps)
        words = "the counter wraps" if wraps else "a step that no motion explains"
        found += [
            Defect("encoder-steps", name, j.sample, j.sample + 1, j.size, words, wraps)
            for j in steps
        ]
    return found


def _are_wraps(steps: list[Jump]) -> bool:
    """Whether there are several, all of one size."""
    size = np.abs([step.size for step in steps])
    return len(size) > 1 and bool(np.ptp(size) < _WRAP * size.max())
