"""result.json: the contract's keys, only JSON numbers, nothing invented."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from results import identification
from strainwave import pipeline, result
from strainwave.errors import InvalidInput
from strainwave.records import Parameter, RigidModel


def rigid(model: RigidModel | None) -> RigidModel:
    assert model is not None
    return model


def test_the_contract_s_keys() -> None:
    document = json.loads(result.to_json(identification()))
    assert document["schema"] == "strainwave/result/1"
    assert {"version", "study", "created", "parameters", "stages", "checks", "warnings"} <= set(
        document
    )
    assert set(document["study"]) == {"path", "sha256"}
    assert set(document["parameters"][0]) == {
        "name",
        "joint",
        "value",
        "std",
        "ci95",
        "unit",
        "stage",
    }
    assert set(document["stages"]) == {"rigid"}
    stage = document["stages"]["rigid"]
    assert stage["parameters"] == document["parameters"]
    assert stage["fit_percent"] == {"motion": {"torque1": 97.5}}
    assert stage["condition_number"] == 12.5
    assert document["checks"] == [
        {"experiment": "check", "fit_percent": {"torque1": 91.25, "torque2": None}}
    ]
    assert document["status"] == "determined"


def test_what_is_not_finite_is_null() -> None:
    one = identification()
    model = replace(rigid(one.rigid), condition_number=np.inf)
    unknown = Parameter("gamma", None, None, None, "kg m^2", "rigid")
    text = result.to_json(replace(one, rigid=replace(model, parameters=(unknown,)))).decode()
    assert "Infinity" not in text
    assert "NaN" not in text
    document = json.loads(text)
    assert document["stages"]["rigid"]["condition_number"] is None
    assert document["parameters"][0]["value"] is None
    assert document["parameters"][0]["ci95"] is None


def test_numpy_numbers_become_numbers() -> None:
    one = identification()
    model = replace(rigid(one.rigid), condition_number=float(np.float64(3.5)))
    document = json.loads(result.to_json(replace(one, rigid=model)))
    assert document["stages"]["rigid"]["condition_number"] == 3.5


def test_both_files_or_none(tmp_path: Path) -> None:
    pipeline.write(identification(), tmp_path / "out")
    assert sorted(p.name for p in (tmp_path / "out").iterdir()) == ["report.html", "result.json"]
    document = json.loads((tmp_path / "out" / "result.json").read_text())
    assert document["timing_s"]["report"] > 0.0
    (tmp_path / "file").write_text("")
    with pytest.raises(InvalidInput, match="cannot write"):
        pipeline.write(identification(), tmp_path / "file")
    assert (tmp_path / "file").read_text() == ""


def test_stages_are_a_beginning_of_all() -> None:
    assert pipeline.check_stages(["rigid"]) == ("rigid",)
    for wrong in ([], ["tuned"], ["rigid", "rigid"]):
        with pytest.raises(InvalidInput, match="--stages"):
            pipeline.check_stages(wrong)
