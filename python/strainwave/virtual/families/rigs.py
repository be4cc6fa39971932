"""A drawn arm with its sensors, before any fault."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from strainwave.domain import Study
from strainwave.domain.parameters import Values
from strainwave.dynamics.simulation import SensorNoise


@dataclass(frozen=True, slots=True)
class Rig:
    """A drawn arm, its sensors' noise and how fast it is sampled."""

    study: Study
    values: Values
    noise: SensorNoise = field(default_factory=SensorNoise)
    sample_time: float = 2.5e-4  # [s] of records that excite the gears
    classes: dict[str, str] = field(default_factory=dict)  # what it is counted under


def between(rng: np.random.Generator, low: float, high: float) -> float:
    """Drawn evenly among logarithms."""
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))
