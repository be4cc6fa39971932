"""Symbols and descriptions of parameters: those of the page of notation, and of every parameter."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from strainwave.domain.effects import all_effects
from strainwave.domain.parameter_words import all_words
from strainwave.domain.parameters import SENSOR_PARAMETERS

NOTATION = Path(__file__).parents[2] / "docs" / "notation.md"


def rows() -> list[tuple[list[str], list[str]]]:
    """Symbols and names of each row of the table of parameters."""
    text = NOTATION.read_text(encoding="utf-8")
    table = text.split("## Parameters")[1].split("\n## ")[0]
    found = []
    for line in table.splitlines()[4:]:
        if not line.startswith("|"):
            break
        symbols, names = (cell.strip() for cell in line.split("|")[1:3])
        found.append((symbols.split(", ") if symbols else [], whole(re.findall("`(.+?)`", names))))
    return found


def whole(names: list[str]) -> list[str]:
    """Names of which the page gives only the end, as `_k2` after `gear_stiffness_k1`."""
    stem = names[0].rpartition("_")[0]
    return [stem + name if name.startswith("_") else name for name in names]


@pytest.mark.parametrize(("symbols", "names"), rows(), ids=str)
def test_symbols_are_those_of_the_page(symbols: list[str], names: list[str]) -> None:
    given = [all_words()[name].symbol for name in names if "..." not in name]
    if len(symbols) == len(given):
        assert given == symbols
    else:
        assert set(given) - {""} == set(symbols)


def test_the_page_has_every_parameter() -> None:
    page = {name for _, names in rows() for name in names}
    assert {name for name in all_words() if not name.startswith("imu_")} <= page


def test_every_parameter_that_is_listed_elsewhere_has_words() -> None:
    listed = {*SENSOR_PARAMETERS, *(name for effect in all_effects() for name in effect.names)}
    assert listed <= set(all_words())


def test_descriptions_are_one_line_and_differ() -> None:
    texts = [words.description for words in all_words().values()]
    assert all(text and "\n" not in text and not text.endswith(".") for text in texts)
    assert len(set(texts)) == len(texts)
