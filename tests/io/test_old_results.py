"""Result files of earlier versions are read; tests/data/results keeps one of each schema."""

from __future__ import annotations

import gzip
import json
import math
from pathlib import Path

import pytest

import strainwave as sw
from strainwave.io.parameters import read_parameters

FOLDER = Path(__file__).parents[1] / "data" / "results"
OLD = sorted(FOLDER.glob("*.json.gz"))


@pytest.fixture(params=OLD, ids=lambda path: path.name.split(".")[0])
def old(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    path = tmp_path / "result.json"
    path.write_bytes(gzip.decompress(request.param.read_bytes()))
    return path


def test_old_results_exist() -> None:
    assert OLD


def test_an_old_result_is_read(old: Path) -> None:
    document = json.loads(old.read_text())
    found = sw.read_result(old)
    assert len(document["parameters"]) == len(list(found.parameters))
    for one in document["parameters"]:
        parameter = found[one["name"], one["joint"]]
        assert (parameter.value, parameter.std) == (one["value"], one["std"])
        assert (parameter.ci95 is None) == (one["ci95"] is None)


def test_an_old_result_gives_parameter_values(old: Path) -> None:
    values = read_parameters(old)
    assert len(values) > 10
    assert all(math.isfinite(value) for value in values.values())


def test_an_old_result_is_saved_unchanged(old: Path, tmp_path: Path) -> None:
    sw.read_result(old).save(tmp_path / "again.json")
    again, before = (json.loads(path.read_text()) for path in (tmp_path / "again.json", old))
    assert again["parameters"] == before["parameters"]
    assert again["verdict"] == before["verdict"]
