"""The constructor of compiled arms refuses what no program serves."""

from typing import Any

import pytest

from serial_chains import Joint, chain

JOINTS: list[Joint] = [
    ("revolute", [0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 1.0]),
    ("revolute", [0.35, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 1.0]),
]


@pytest.mark.parametrize(
    ("program", "base"),
    [("serial", "link_mass"), ("planar-two-link", "alpha")],
)
def test_each_program_has_its_parameters(program: str, base: str) -> None:
    assert chain(JOINTS, program=program).parameter_names[0][0] == base


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"program": "delta"}, 'unknown arm kind "delta"'),
        ({"program": "planar-two-link", "transmission": [[1.0, 0.0], [0.5, 1.0]]}, "only serial"),
        ({"program": "single-joint"}, "expected 1 joints, got 2"),
        ({"gear_ratio": [0.01]}, "gear_ratio: expected 2 values, got 1"),
    ],
)
def test_impossible_arms_are_refused(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        chain(JOINTS, **changes)


def test_unknown_keywords_are_refused() -> None:
    with pytest.raises(TypeError, match="link_length"):
        chain(JOINTS, link_length=0.35)


def test_long_chains_are_refused() -> None:
    with pytest.raises(ValueError, match="1 to 7 joints, got 8"):
        chain(JOINTS * 4)
