"""Page "By hand": simulation of measured records with the values of sliders."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

import strainwave as sw
from strainwave.dynamics.simulation import SensorNoise
from strainwave.identification.trial_values import starting_values
from strainwave.io.parameters import parameter_file, read_parameters
from strainwave.virtual import scara
from strainwave.virtual.experiments import simulate_study

pytest.importorskip("starlette")

from strainwave.io.kept_files import study_at
from strainwave.workbench.pages.by_hand import Shown, simulate

if TYPE_CHECKING:
    from starlette.testclient import TestClient

STUDY = "arm/study.toml"
SETTING = {"experiment": "step-j1", "start": "arm/truth.json", "from": None}


@pytest.fixture
def begun(client: TestClient, folder: Path) -> Any:
    (folder / "arm" / "truth.json").write_bytes(parameter_file(scara.STIFF.parameters()))
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


@pytest.fixture(scope="module")
def rigid(arm_folder: Path) -> sw.Result:
    """Result of the rigid stage only."""
    return sw.identify(arm_folder / "study.toml", stages=("rigid",))


@pytest.fixture
def partial(folder: Path, rigid: sw.Result) -> dict[str, Any]:
    """The result of the rigid stage as a run of the study."""
    path = folder / "arm/runs/rigid/result.json"
    path.parent.mkdir(parents=True)
    rigid.save(path)
    document: dict[str, Any] = json.loads(path.read_bytes())
    return document


def test_a_rigid_result_is_simulated_with_marked_values(
    client: TestClient, partial: dict[str, Any]
) -> None:
    setting = SETTING | {"start": "arm/runs/rigid/result.json"}
    answer = client.post(f"/api/by-hand-begin/{STUDY}", json=setting)
    reasons = {one["label"]: one["reason"] for one in answer.json()["sliders"]}
    assert "usual value of a gear" in reasons["gear_stiffness 1"]
    assert not reasons["beta"]
    values = values_of(answer.json())
    shown = client.post(f"/api/by-hand/{STUDY}", json=setting | {"values": values})
    assert min(shown.json()["fits"].values()) > 30.0


def test_every_parameter_of_a_result_may_be_null(partial: dict[str, Any], folder: Path) -> None:
    true: list[dict[str, Any]] = [
        {"name": name, "joint": joint, "value": value, "unit": "", "std": None, "stage": "tuned"}
        for (name, joint), value in scara.STIFF.parameters().items()
    ]
    file, study = folder / "arm/runs/rigid/result.json", study_at(folder / STUDY).arm
    for parameters in (true, partial["parameters"]):
        for entry in parameters:
            value, entry["value"] = entry["value"], None
            file.write_text(json.dumps(partial | {"parameters": parameters}))
            entry["value"] = value
            start = starting_values(study, file)
            shown = simulate(Shown(folder / STUDY, "step-j1", (0.0, 1.0)), start.values)
            assert len(shown.channels) == 4
            label = (entry["name"], entry["joint"])
            assert label in start.reasons or start.values.get(label, 0.0) == 0.0


def test_an_estimate_of_an_earlier_stage_is_preferred(
    partial: dict[str, Any], folder: Path
) -> None:
    file = folder / "arm/runs/rigid/result.json"
    for entry in partial["parameters"]:
        entry["value"] = None
    file.write_text(json.dumps(partial))
    start = starting_values(study_at(folder / STUDY).arm, file)
    beta = next(p["value"] for p in partial["stages"]["rigid"]["parameters"] if p["name"] == "beta")
    assert start.values["beta", None] == beta
    assert "does not confirm" in start.reasons["beta", None]


def test_rigid_gears_show_the_torques_of_the_motion(tmp_path: Path) -> None:
    study, values = scara.STIFF.study(tmp_path, "rigid"), scara.STIFF.parameters(0, "rigid")
    simulate_study(study, values, tmp_path, noise=SensorNoise(), as_recorded=False)
    shown = Shown(tmp_path / "study.toml", "motion", (0.0, 5.0))
    true = simulate(shown, values)
    wrong = simulate(shown, values | {("beta", None): 2.0 * values["beta", None]})
    assert min(true.fit_percent.values()) > 90.0
    assert wrong.fit_percent["u2"] < true.fit_percent["u2"] - 3.0


def test_only_channels_of_the_joint_are_simulated(client: TestClient, begun: Any) -> None:
    more = {"joint": 2, "channels": ["omega_m2", "a2"]}
    assert set(update(client, values_of(begun), **more).json()["fits"]) == {"omega_m2", "a2"}


@pytest.mark.parametrize("value", ["NaN", "Infinity", '"text"', "null", "true"])
def test_no_number_gives_a_sentence(client: TestClient, begun: Any, value: str) -> None:
    text = json.dumps(SETTING | {"values": values_of(begun)})
    text = text.replace(json.dumps(begun["sliders"][0]["value"]), value, 1)
    answer = client.post(f"/api/by-hand/{STUDY}", content=text)
    assert answer.status_code == 400
    assert answer.json()["error"]


@pytest.mark.parametrize(
    "stages", [3, {"rigid": 3}, {"rigid": [1]}, {"joints": [3]}, {"tuned": "x"}, {"responses": 3}]
)
def test_a_faulty_result_gives_a_sentence_or_no_values(
    client: TestClient, folder: Path, stages: object
) -> None:
    path = folder / "arm/runs/odd/result.json"
    path.parent.mkdir(parents=True)
    beta = {"name": "beta", "joint": None, "value": 0.6}
    path.write_text(json.dumps({"parameters": [beta], "stages": stages}))
    setting = SETTING | {"start": "arm/runs/odd/result.json"}
    answer = client.post(f"/api/by-hand-begin/{STUDY}", json=setting)
    values = {"values": values_of(answer.json()), "joint": 1} if answer.status_code == 200 else {}
    update = client.post(f"/api/by-hand/{STUDY}", json=setting | values)
    assert {answer.status_code, update.status_code} <= {200, 400}


def test_values_of_one_record_have_sliders_in_that_record_only(
    client: TestClient, begun: Any, folder: Path
) -> None:
    values = scara.STIFF.parameters() | {
        ("friction_change[step-j1]", 1): 0.5,
        ("friction_change[step-j2]", 1): 0.1,
        ("accelerometer_delay", 1): 1e-3,
    }
    (folder / "arm" / "truth.json").write_bytes(parameter_file(values))
    shown = client.post(f"/api/by-hand-begin/{STUDY}", json=SETTING).json()
    labels = {one["label"] for one in shown["sliders"]}
    assert {"friction_change[step-j1] 1", "accelerometer_delay 1"} <= labels
    assert "friction_change[step-j2] 1" not in labels
    plain, changed = (update(client, values_of(each)).json()["fits"] for each in (begun, shown))
    assert changed["omega_m1"] < plain["omega_m1"] - 0.5  # of the friction
    assert changed["a1"] < plain["a1"] - 0.5  # of the delay as well
