"""Settings of recording and estimation for the comparisons."""

from __future__ import annotations

from dataclasses import dataclass, field

from strainwave.domain import LinearOptions, LinkOptions, Protocol, WholeArmOptions
from strainwave.domain.options import PUBLISHED_OPTIONS, EstimationMethod

CLASSICAL_METHOD: EstimationMethod = "moesp"
"""One of the weightings of MATLAB's n4sid. Feedback biases it."""


@dataclass(frozen=True, slots=True)
class Settings:
    """Settings from an experiment to a model."""

    protocol: Protocol
    sample_time: float  # [s] of the logs
    periods: int  # of the PRBS, 1023 clocks of 1 ms each
    links: LinkOptions = field(default_factory=LinkOptions)
    linear: LinearOptions = field(default_factory=LinearOptions)
    tuning: WholeArmOptions = field(default_factory=WholeArmOptions)
    records: int = 4  # of one period at each amplitude of Figs. 14 and 15


OWN_SETTINGS = Settings("own", sample_time=2.5e-4, periods=4)
"""Default settings of `identify`."""

PUBLISHED_SETTINGS = Settings(
    "as-published",
    sample_time=2.5e-5,
    periods=1,
    links=PUBLISHED_OPTIONS.links,
    linear=PUBLISHED_OPTIONS.statespace,
    tuning=PUBLISHED_OPTIONS.tuning,
    records=1,
)
"""Settings of the source: 0.025 ms, one period of 1.023 s, decimated to 2 ms, order 4."""
