"""Page "Check": suspicion, remedy, override, and the gate of the estimate."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

pytest.importorskip("starlette")

if TYPE_CHECKING:
    from starlette.testclient import TestClient

from strainwave.init.changes import KeyChange, edit_study
from strainwave.workbench.pages.check import gate_of

API = "/api/check/arm/study.toml"


def post(client: TestClient, path: str, body: dict[str, Any] | None = None) -> Any:
    return client.post(path, json=body or {})


def test_a_consistent_study_opens_the_gate_and_a_change_closes_it(
    client: TestClient, folder: Path
) -> None:
    study = folder / "arm" / "study.toml"
    assert client.get(API).json()["state"] == "unchecked"
    assert post(client, "/api/estimate/arm/study.toml").status_code == 400
    checked = post(client, API).json()
    assert checked["state"] == "consistent"
    assert checked["is_open"]
    assert client.get(API).json()["state"] == "consistent"
    edit_study(study, [KeyChange(("joint", 0, "torque_per_volt"), 0.07)])
    assert client.get(API).json()["state"] == "unchecked"


def test_a_changed_log_closes_the_gate(client: TestClient, folder: Path) -> None:
    post(client, API)
    log = folder / "arm" / "motion.parquet"
    log.write_bytes((folder / "arm" / "motion-check.parquet").read_bytes())
    assert not gate_of(folder / "arm" / "study.toml").is_open


def test_a_wrong_unit_is_suspected_and_its_remedy_corrects_the_study(
    client: TestClient, folder: Path
) -> None:
    study = folder / "arm" / "study.toml"
    before = study.read_text()
    study.write_text(f"# my rig\n{before}")
    edit_study(
        study, [KeyChange(("channels", "theta_m1"), {"column": "theta_m1", "scale": 57.29578})]
    )
    suspected = post(client, API).json()
    assert suspected["state"] == "suspected"
    assert not suspected["is_open"]
    entries = suspected["document"]["suspected"]
    index = next(k for k, entry in enumerate(entries) if entry["lines"])
    assert any(place["channel"] for place in entries[index]["places"])
    corrected = post(client, "/api/apply-remedy/arm/study.toml", {"index": index}).json()
    assert corrected["state"] == "consistent"
    assert study.read_text().startswith("# my rig\n")


def test_an_override_opens_the_gate_until_the_next_change(client: TestClient, folder: Path) -> None:
    study = folder / "arm" / "study.toml"
    assert post(client, "/api/override-check/arm/study.toml").status_code == 400
    edit_study(study, [KeyChange(("joint", 0, "gear_ratio"), 0.013)])
    assert post(client, API).json()["state"] == "suspected"
    assert post(client, "/api/override-check/arm/study.toml").json()["state"] == "overridden"
    assert gate_of(study).is_open
    study.write_text(study.read_text() + "\n")
    assert gate_of(study).state == "unchecked"


def test_an_invalid_study_gives_the_message_of_the_command_line(
    client: TestClient, folder: Path
) -> None:
    edit_study(folder / "arm" / "study.toml", [KeyChange(("joint", 0, "gear_ratio"), 0.0)])
    gate = client.get(API).json()
    assert gate["state"] == "invalid"
    assert "gear_ratio" in gate["reason"]
    assert client.post(API, json={}).status_code == 400


def test_a_signal_is_decimated_and_has_its_unit(client: TestClient) -> None:
    query = {"channel": "a1", "experiment": "prbs-j1"}
    figure = client.get("/api/check-signal/arm/study.toml", params=query).json()
    assert len(figure["data"][0]["x"]) <= 1200
    assert figure["layout"]["yaxis"]["title"]["text"] == "a1 [m/s²]"
    query["channel"] = "a9"
    assert client.get("/api/check-signal/arm/study.toml", params=query).status_code == 400


def test_a_suspected_fault_has_evidence_and_fields_of_the_page_study(
    client: TestClient, folder: Path
) -> None:
    edit_study(folder / "arm" / "study.toml", [KeyChange(("joint", 0, "gear_ratio"), 0.013)])
    document = post(client, API).json()["document"]
    for entry in document["suspected"]:
        assert entry["fields"]
        assert entry["evidence"]
        assert not any(one["consistent"] for one in entry["evidence"])
        assert "[[joint]]" not in entry["remedy"]
    fields = [field for entry in document["suspected"] for field in entry["fields"]]
    assert "joint-0-gear_ratio" in fields
