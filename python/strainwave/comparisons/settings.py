"""How experiments of a comparison are recorded and their models estimated."""

from __future__ import annotations

from dataclasses import dataclass, field

from strainwave.records import LinearOptions, LinkOptions, Protocol, TuningOptions
from strainwave.records.options import EstimationMethod

CLASSICAL: EstimationMethod = "moesp"
"""Of the weights among which MATLAB's n4sid chooses; feedback biases it."""


@dataclass(frozen=True, slots=True)
class Settings:
    """One way from an experiment to a model."""

    protocol: Protocol
    sample_time: float  # [s] of the logs
    periods: int  # of the PRBS, 1023 clocks of 1 ms each
    links: LinkOptions = field(default_factory=LinkOptions)
    linear: LinearOptions = field(default_factory=LinearOptions)
    tuning: TuningOptions = field(default_factory=TuningOptions)


OWN = Settings("own", sample_time=2.5e-4, periods=4)
"""What `identify` does unless it is set otherwise."""
