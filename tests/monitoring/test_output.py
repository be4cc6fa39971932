"""What a comparison and a trend share in their output."""

from __future__ import annotations

import pytest

from strainwave.monitoring import output


@pytest.mark.parametrize(
    ("p", "text"), [(1.0, "1"), (0.0312, "0.031"), (2.2e-6, "2e-06"), (0.0, "<1e-16")]
)
def test_probabilities_in_words(p: float, text: str) -> None:
    assert output.probability(p) == text
