"""One short round of all comparisons for every test."""

from __future__ import annotations

import pytest

from strainwave.comparisons import ComparisonOptions, compare
from strainwave.records import Comparison

SHORT = ComparisonOptions(amplitudes=(4.0, 10.0), payloads=(5, 3), records=2)


@pytest.fixture(scope="session")
def comparisons() -> dict[int, Comparison]:
    """By figure."""
    return {c.figure: c for c in compare(seed=1, options=SHORT)}
