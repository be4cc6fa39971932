"""Files that experiments of a study name, before the study is checked."""

from __future__ import annotations

from typing import Any

import pytest

from strainwave.domain.steps import files_of

MERGE = {"kind": "merge", "file": "b.csv"}


@pytest.mark.parametrize(
    ("table", "files"),
    [
        ({"file": "a.csv"}, ["a.csv"]),
        ({"file": "a.csv", "steps": [{"kind": "lowpass"}, MERGE]}, ["a.csv", "b.csv"]),
        ({"steps": [MERGE, 3, {"file": 4}, {"file": ""}]}, ["b.csv"]),
        ({"file": ["a.csv"], "steps": "b.csv"}, []),
    ],
)
def test_files_of_a_table_are_listed_whatever_its_faults(
    table: dict[str, Any], files: list[str]
) -> None:
    assert files_of(table) == files
