"""Comparison of two visits: changes are named, and only changes."""

from __future__ import annotations

import pytest
from benchmarks.studies.visits import compare_visits


@pytest.mark.parametrize(
    ("changes", "named"), [({}, set()), ({"friction": 10.0}, {"motor_coulomb_friction 1"})]
)
def test_changes_between_two_visits_are_named(changes: dict[str, float], named: set[str]) -> None:
    comparison = compare_visits(0, changes=changes)
    assert comparison["status"] == ["determined", "determined"]
    assert named <= set(comparison["named"])
    assert comparison["differs"] == bool(named)
