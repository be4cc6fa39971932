"""Symbols and descriptions of parameters agree with docs/notation.md and exist for all parameters."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from strainwave.domain.arm.effects import all_effects
from strainwave.domain.arm.link_sensors import optional_constants
from strainwave.domain.arm.parameter_table import family_of
from strainwave.domain.arm.parameters import parameter_descriptions

NOTATION = Path(__file__).parents[2] / "docs" / "notation.md"


def rows() -> list[tuple[list[str], list[str]]]:
    """Symbols and names in each row of the parameter table."""
    text = NOTATION.read_text(encoding="utf-8")
    table = text.split("## Parameters")[1].split("\n## ")[0]
    rows = []
    for line in table.splitlines()[4:]:
        if not line.startswith("|"):
            break
        symbols, names = (cell.strip() for cell in line.split("|")[1:3])
        rows.append(
            (symbols.split(", ") if symbols else [], complete_names(re.findall("`(.+?)`", names)))
        )
    return rows


def complete_names(names: list[str]) -> list[str]:
    """Complete names for abbreviations such as `_k2` after `gear_stiffness_k1`."""
    stem = names[0].rpartition("_")[0]
    return [stem + name if name.startswith("_") else name for name in names]


@pytest.mark.parametrize(("symbols", "names"), rows(), ids=str)
def test_symbols_match_the_notation(symbols: list[str], names: list[str]) -> None:
    given = [parameter_descriptions()[name].symbol for name in names if "..." not in name]
    if len(symbols) == len(given):
        assert given == symbols
    else:
        assert set(given) - {""} == set(symbols)


def test_the_notation_lists_every_parameter() -> None:
    page = {name for _, names in rows() for name in names}
    assert {name for name in parameter_descriptions() if not name.startswith("imu_")} <= page


def test_every_parameter_has_a_description() -> None:
    listed = {*optional_constants(), *(name for effect in all_effects() for name in effect.names)}
    assert listed <= set(parameter_descriptions())


def test_descriptions_are_unique_single_lines() -> None:
    texts = [words.description for words in parameter_descriptions().values()]
    assert all(text and "\n" not in text and not text.endswith(".") for text in texts)
    assert len(set(texts)) == len(texts)


@pytest.mark.parametrize(
    ("name", "family"),
    [
        ("gamma", "inertia"),
        ("gravity_torque_1", "gravity"),
        ("motor_coulomb_friction", "dry friction"),
        ("friction_offset", "dry friction"),
        ("total_viscous_friction", "damping"),
        ("gear_stiffness_k1", "stiffness"),
        ("gear_knee_t1", "other"),
        ("friction_change[swing]", "other"),
        ("imu_x", "other"),
    ],
)
def test_parameters_have_a_physical_meaning(name: str, family: str) -> None:
    assert family_of(name) == family
