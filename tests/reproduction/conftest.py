"""Shared comparisons of a short run."""

from __future__ import annotations

import pytest

from reproduction import ComparisonOptions, compare_seeds
from reproduction.records import Comparison, Tally

SEED = 1
SHORT = ComparisonOptions(amplitudes=(4.0, 10.0), payloads=(5, 3), records=2)


@pytest.fixture(scope="session")
def tallies() -> tuple[Tally, ...]:
    """Comparisons with default settings."""
    return compare_seeds([SEED], options=SHORT)


@pytest.fixture(scope="session")
def comparisons(tallies: tuple[Tally, ...]) -> dict[int, Comparison]:
    """Comparisons by figure."""
    return {tally.first.figure: tally.first for tally in tallies}
