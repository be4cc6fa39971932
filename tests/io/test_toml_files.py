"""TOML files of users."""

from __future__ import annotations

from pathlib import Path

import pytest

from strainwave.errors import InvalidInput
from strainwave.io.atomic_files import check_keys, parse_toml

PATH = Path("some.toml")


def test_valid_toml_is_parsed() -> None:
    assert parse_toml("a = [1, 2]", PATH) == {"a": [1, 2]}


@pytest.mark.parametrize("text", ["a = ", "[a", "a = 1\na = 2", "a = " + "[" * 5000])
def test_invalid_toml_is_refused(text: str) -> None:
    with pytest.raises(InvalidInput, match=r"some\.toml: is not valid TOML .*correct that line"):
        parse_toml(text, PATH)


def test_an_unknown_key_is_refused_with_the_nearest() -> None:
    check_keys({"class": 1}, ("class", "workers"), PATH)
    with pytest.raises(InvalidInput, match=r"unknown key 'worker'.*did you mean 'workers'"):
        check_keys({"worker": 1}, ("class", "workers"), PATH)


def test_a_path_of_windows_in_a_text(tmp_path: Path) -> None:
    path = tmp_path / "study.toml"
    with pytest.raises(InvalidInput, match=r"write paths with / instead of \\"):
        parse_toml('file = "C:\\logs\\a.csv"', path)
