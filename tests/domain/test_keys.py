"""Texts of keys."""

from __future__ import annotations

from strainwave.domain.keys import grouped_labels


def test_joints_of_a_name_are_in_one_label() -> None:
    keys = [("a", 2), ("b", 1), ("a", 4), ("a", 3), ("alpha", None), ("b", 3), ("b", 2), ("b", 7)]
    assert grouped_labels(keys) == ("a 2-4", "b 1-3,7", "alpha")
    assert grouped_labels([("a", 1), ("a", 2)]) == ("a 1,2",)
    assert grouped_labels([]) == ()
