from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from strainwave.domain.messages import UNKNOWN, plus_minus


@pytest.mark.parametrize(
    ("value", "std", "expected"),
    [
        (25010.3, 31.2, ("25010", "31")),
        (0.0613, 0.00042, ("0.06130", "0.00042")),
        (1.5023e-4, 1.2e-6, ("1.502e-04", "0.012e-04")),
        (3.0, 0.0, ("3", "0")),
        (3.0, None, ("3", UNKNOWN)),
        (None, 1.0, (UNKNOWN, UNKNOWN)),
        (math.nan, 1.0, (UNKNOWN, UNKNOWN)),
    ],
)
def test_digits_match_the_standard_deviation(
    value: float | None, std: float | None, expected: tuple[str, str]
) -> None:
    assert plus_minus(value, std) == expected


@given(st.floats(-1e12, 1e12), st.floats(1e-12, 1e6))
def test_the_text_is_accurate_to_a_tenth_of_the_standard_deviation(
    value: float, std: float
) -> None:
    written_value, written_std = plus_minus(value, std)
    assert abs(float(written_value) - value) <= 0.1 * std + 1e-15 * abs(value)
    assert float(written_std) == pytest.approx(std, rel=0.06)
