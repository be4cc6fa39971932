"""A drawn arm with its sensors, before any fault."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from strainwave.domain import Control, Experiment, Prbs, Spring, Study, Use
from strainwave.domain.keys import Values
from strainwave.dynamics.simulation import SensorNoise

_SWEEP_SHARE = 0.4  # of the full amplitude


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


def rig_experiments(
    spring: Spring, prbs: Prbs, control: tuple[Control, Control] = ("open", "open")
) -> tuple[Experiment, ...]:
    """A motion and, for each joint, a PRBS under `control` and a step.

    Joints with three-slope springs have a sweep at lower amplitude as well.
    """
    both: tuple[Control, Control] = ("servo", "servo")
    experiments = [Experiment("motion", "motion.parquet", "motion", both)]
    weak = replace(prbs, amplitude=_SWEEP_SHARE * prbs.amplitude)
    uses: list[tuple[str, Use, Prbs]] = [("prbs", "frequency", prbs)]
    if spring == "three-slope":
        uses.append(("sweep", "sweep", weak))
    for joint in (1, 2):
        for prefix, use, excitation in uses:
            name = f"{prefix}-j{joint}"
            file = f"{name}.parquet"
            experiments.append(Experiment(name, file, use, control, joint, prbs=excitation))
        name = f"step-j{joint}"
        experiments.append(Experiment(name, f"{name}.parquet", "tuning", both, joint))
    return tuple(experiments)
