"""Comparison of two visits: changes are named, and only changes."""

from __future__ import annotations

from typing import Any

import pytest
from benchmarks.studies import visits
from benchmarks.studies.visits import compare_visits

visit, first_visits = visits._visit, dict[tuple[int, ...], Any]()


@pytest.fixture(autouse=True)
def _one_first_visit(monkeypatch: pytest.MonkeyPatch) -> None:
    """Both pairs of visits have the same first one, before any change: it is identified once."""

    def visited(rig: Any, values: Any, seed: list[int]) -> Any:
        if seed[1] != 1:
            return visit(rig, values, seed)
        if tuple(seed) not in first_visits:
            first_visits[tuple(seed)] = visit(rig, values, seed)
        return first_visits[tuple(seed)]

    monkeypatch.setattr(visits, "_visit", visited)


@pytest.mark.parametrize(
    ("changes", "named"), [({}, set()), ({"friction": 10.0}, {"motor_coulomb_friction 1"})]
)
def test_changes_between_two_visits_are_named(changes: dict[str, float], named: set[str]) -> None:
    comparison = compare_visits(0, changes=changes)
    assert comparison["status"] == ["determined", "determined"]
    assert named <= set(comparison["named"])
    assert comparison["differs"] == bool(named)
