"""A drawn arm with its sensors, before any fault."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from strainwave.domain import Study
from strainwave.domain.keys import Values
from strainwave.dynamics.simulation import SensorNoise


@dataclass(frozen=True, slots=True)
class Rig:
    """A drawn arm with sensor noise and sample time."""

    study: Study
    values: Values
    noise: SensorNoise = field(default_factory=SensorNoise)
    sample_time: float = 2.5e-4  # [s] of records that excite the gears
    classes: dict[str, str] = field(default_factory=dict)  # groups of the statistics


def between(rng: np.random.Generator, low: float, high: float) -> float:
    """Log-uniform random number."""
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))
