"""Two visits to one arm: what changed is named, and nothing where nothing did."""

from __future__ import annotations

import pytest
from benchmarks.studies.visits import compared


@pytest.mark.parametrize(
    ("changes", "named"), [({}, set()), ({"friction": 10.0}, {"motor_coulomb_friction 1"})]
)
def test_what_changed_between_two_visits_is_named(
    changes: dict[str, float], named: set[str]
) -> None:
    found = compared(0, changes=changes)
    assert found["status"] == ["determined", "determined"]
    assert named <= set(found["named"])
    assert found["differs"] == bool(named)
