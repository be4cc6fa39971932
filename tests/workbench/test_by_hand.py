"""Page "By hand": simulation of measured records with the values of sliders."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from strainwave.io.parameters import read_parameters
from strainwave.virtual import scara

pytest.importorskip("starlette")

from strainwave.workbench.pages.by_hand import parameter_document

if TYPE_CHECKING:
    from starlette.testclient import TestClient

STUDY = "arm/study.toml"
SETTING = {"experiment": "step-j1", "start": "arm/truth.json", "from": None}


@pytest.fixture
def begun(client: TestClient, folder: Path) -> Any:
    (folder / "arm" / "truth.json").write_text(
        json.dumps(parameter_document(scara.STIFF.parameters()))
    )
    return client.post(f"/api/by-hand-begin/{STUDY}", json=SETTING).json()


def values_of(begun: Any, **factors: float) -> list[dict[str, Any]]:
    return [
        {
            "name": one["name"],
            "joint": one["joint"],
            "value": one["value"] * factors.get(one["name"], 1.0),
        }
        for one in begun["sliders"]
    ]


def update(client: TestClient, values: list[dict[str, Any]], **more: Any) -> Any:
    return client.post(f"/api/by-hand/{STUDY}", json=SETTING | {"values": values} | more)


def test_the_true_values_explain_the_record(client: TestClient, begun: Any) -> None:
    fits = update(client, values_of(begun)).json()["fits"]
    assert set(fits) == {"omega_m1", "omega_m2", "a1", "a2"}
    assert min(fits["omega_m1"], fits["omega_m2"]) > 98.0


def test_half_the_stiffness_explains_less(client: TestClient, begun: Any) -> None:
    changed = values_of(begun, gear_stiffness_k1=0.5, gear_stiffness_k2=0.5, gear_stiffness_k3=0.5)
    good, bad = (update(client, v).json()["fits"] for v in (values_of(begun), changed))
    assert all(bad[name] < good[name] - 1.0 for name in good)


def test_the_bode_plot_follows_the_sliders(client: TestClient, begun: Any) -> None:
    changed = values_of(begun, gear_stiffness_k2=4.0)
    shown = [update(client, v, joint=1).json()["bode"] for v in (values_of(begun), changed)]
    lines = [one["data"][0] for one in shown]  # magnitude; above 5 Hz the largest is the resonance
    peaks = [max((y, x) for x, y in zip(d["x"], d["y"], strict=True) if x > 5.0)[1] for d in lines]
    assert peaks[1] == pytest.approx(2.0 * peaks[0], rel=0.1)


def test_sliders_start_at_the_values_and_have_units(begun: Any) -> None:
    one = next(s for s in begun["sliders"] if s["label"] == "gear_damping 1")
    assert one["unit"] == "N m s/rad"
    assert one["low"] < one["value"] == scara.STIFF.parameters()["gear_damping", 1] < one["high"]


def test_impossible_values_give_a_sentence(client: TestClient, begun: Any) -> None:
    answer = update(client, values_of(begun, motor_inertia=-1.0))
    assert answer.status_code == 422
    assert "cannot be simulated" in answer.json()["error"]


@pytest.mark.parametrize(
    "entry", [{"name": "mass", "joint": 1, "value": 1.0}, {"name": "alpha", "joint": None}, 3]
)
def test_unknown_parameters_are_refused(client: TestClient, begun: Any, entry: object) -> None:
    assert update(client, [entry]).status_code == 400  # type: ignore[list-item]


def test_values_are_saved_as_a_parameter_file(client: TestClient, begun: Any, folder: Path) -> None:
    body = {"name": "mine", "values": values_of(begun)}
    assert client.post(f"/api/by-hand-save/{STUDY}", json=body).json() == {"file": "mine.json"}
    assert read_parameters(folder / "arm" / "mine.json") == scara.STIFF.parameters()
    assert client.post(f"/api/by-hand-save/{STUDY}", json=body).status_code == 400


def test_a_fit_starts_at_the_values(client: TestClient, begun: Any, folder: Path) -> None:
    body = {"values": values_of(begun), "held": ["gear_damping 1"]}
    assert client.post(f"/api/by-hand-fit/{STUDY}", json=body).status_code == 400  # unchecked
    client.post(f"/api/check/{STUDY}", json={})
    run = client.post(f"/api/by-hand-fit/{STUDY}", json=body).json()
    client.get(f"/api/run-events/{STUDY}", params={"name": run["name"]})  # ends with the run
    result = json.loads((folder / "arm/runs/identify-1/result.json").read_bytes())
    assert result["options"]["tuning"]["hold"] == ["gear_damping 1"]
    assert "--start start.json" in run["lines"][0]
