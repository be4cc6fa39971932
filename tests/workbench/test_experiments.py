"""Page "Study": experiments, the signals of their logs, and rig values of other studies."""

from __future__ import annotations

import shutil
import time
import tracemalloc
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from strainwave.init import start_study
from strainwave.io.logs import columns as log_columns
from strainwave.io.logs.tables import write_table
from strainwave.io.study import read_study

pytest.importorskip("starlette")

from strainwave.workbench.pages import overview

if TYPE_CHECKING:
    from starlette.testclient import TestClient

API = "/api/study/arm/study.toml"


def test_dropped_logs_become_experiments_by_the_rules_of_init(
    client: TestClient, folder: Path, tmp_path: Path
) -> None:
    study = folder / "arm" / "study.toml"
    draft = start_study(sorted((folder / "arm").glob("*j1*.parquet")), tmp_path / "study.toml")
    uses = {each.split('"')[0]: each for each in draft.text.split('name = "')}
    shutil.copy(folder / "arm" / "prbs-j1.parquet", folder / "arm" / "it's 1.parquet")
    shutil.copy(folder / "arm" / "motion.parquet", folder / "arm" / "motion.x.parquet")
    (folder / "arm" / "bad.csv").write_text("x\n1\n")
    logs = ["it's 1.parquet", "motion.x.parquet", "bad.csv"]
    answer = client.post("/api/experiments/arm/study.toml", json={"logs": logs}).json()
    assert answer["notes"][:2] == ["it's 1 (frequency)", "motion (2) (motion)"]
    assert answer["notes"][2].startswith("bad (motion, not guessed: arm/bad.csv: ")
    state = client.get(API).json()
    body = {"sha256": state["sha256"], "changes": answer["changes"][:2]}
    assert client.post(API, json=body).json()["error"] is None
    assert study.read_text().startswith(state["text"].rstrip("\n"))
    known = read_study(study).experiments[-2:]
    assert [e.file for e in known] == ["it's 1.parquet", "motion.x.parquet"]
    assert known[0].prbs is not None
    assert "# likely: the input of joint 1 is a pseudo-random" in study.read_text()
    assert "pseudo-random" in uses["prbs-j1"]


def test_a_log_of_another_folder_becomes_an_experiment(client: TestClient, folder: Path) -> None:
    (folder / "bad.csv").write_text("x\n1\n")
    answer = client.post("/api/experiments/arm/study.toml", json={"logs": ["../bad.csv"]})
    assert 'file = "../bad.csv"' in answer.json()["changes"][0]["value"]


def test_an_experiment_is_duplicated_with_its_comments(client: TestClient, folder: Path) -> None:
    state = client.get(API).json()
    row = state["experiments"][0]
    place = ["experiment", 1]
    changes = [
        {"place": place, "kind": "text", "value": row["text"]},
        {"place": [*place, "name"], "kind": "text", "value": "again"},
        {"place": [*place, "start"], "kind": "number", "value": "1.5"},
    ]
    answer = client.post(API, json={"sha256": state["sha256"], "changes": changes}).json()
    assert answer["error"] is None
    first, second = read_study(folder / "arm" / "study.toml").experiments[:2]
    assert (second.name, second.file, second.start) == ("again", first.file, 1.5)


def test_rig_values_of_another_study_are_taken_without_its_comments(
    client: TestClient, folder: Path
) -> None:
    shutil.copytree(folder / "arm", folder / "new")
    (folder / "new" / "study.toml").unlink()
    logs = sorted((folder / "new").glob("*.parquet"))
    draft = start_study(logs, folder / "new" / "study.toml")
    assert draft.n_todos > 10
    api = "/api/rig-values/new/study.toml"
    changes = client.post(api, json={"study": "arm/study.toml"}).json()["changes"]
    state = client.get("/api/study/new/study.toml").json()
    body = {"sha256": state["sha256"], "changes": changes}
    assert client.post("/api/study/new/study.toml", json=body).json()["error"] is None
    study = folder / "new" / "study.toml"
    assert read_study(study).arm == read_study(folder / "arm" / "study.toml").arm
    kept = [line for line in draft.text.split("\n") if line.startswith("#")]
    assert [line for line in study.read_text().split("\n") if line.startswith("#")] == kept
    assert client.post(api, json={"study": "arm/study.toml"}).json()["changes"] == []


def rows_of(client: TestClient, study: str, experiment: str) -> dict[str, Any]:
    answer = client.get(f"/api/overview/{study}", params={"experiment": experiment})
    assert answer.status_code == 200, answer.text
    return {row["column"]: row for row in answer.json()["rows"]}


def test_a_draft_shows_every_column_with_its_channel_and_unit(
    client: TestClient, folder: Path
) -> None:
    time_s = np.arange(2000) * 1e-3
    columns = {"time": time_s, "pos": np.sin(time_s), "flag": np.zeros(2000), "q": np.sin(time_s)}
    columns["q"][5] = np.nan
    (folder / "rig").mkdir()
    write_table(folder / "rig" / "a.csv", columns)
    (folder / "rig" / "study.toml").write_text(
        '[arm]\nkind = TODO\n[[joint]]\ngear_ratio = TODO\n[channels]\nt = "time"\n'
        'theta_m1 = { column = "pos", scale = -2.0, offset = 1.0 }\nu1 = { column = "q", scale ='
        ' TODO }\n[[experiment]]\nname = "a"\nfile = "a.csv"\n'
    )
    rows = rows_of(client, "rig/study.toml", "a")
    assert list(rows) == ["time", "q", "pos", "flag"]
    assert (rows["pos"]["channel"], rows["pos"]["unit"]) == ("theta_m1", "rad")
    assert rows["pos"]["low"] == pytest.approx(1.0 - 2.0 * np.sin(time_s).max())
    assert rows["pos"]["is_reversed"]
    assert (rows["q"]["channel"], rows["q"]["unit"]) == ("u1", "")  # the scale is missing
    assert (rows["flag"]["channel"], rows["flag"]["low"], rows["flag"]["high"]) == ("", 0.0, 0.0)
    answer = client.get("/api/overview/rig/study.toml", params={"experiment": "a"}).json()
    assert (answer["file"], answer["seconds"]) == ("a.csv", pytest.approx(1.999))
    missing = client.get("/api/overview/rig/study.toml", params={"experiment": "b"})
    assert missing.status_code == 400


def test_a_long_log_is_read_quickly_and_a_few_columns_at_a_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    n, columns = 1_000_000, 12
    rng = np.random.default_rng(2)
    write_table(
        tmp_path / "long.parquet", {f"c{k}": rng.standard_normal(n) for k in range(columns)}
    )
    monkeypatch.setattr(log_columns, "_MAX_BATCH_BYTES", 2 * 8 * n)  # two columns
    tracemalloc.start()
    begin = time.monotonic()
    lines = overview.outlines(tmp_path / "long.parquet")
    seconds, (_, peak) = time.monotonic() - begin, tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert list(lines) == [f"c{k}" for k in range(columns)]
    assert seconds < 10.0  # 0.3 s on a machine that is not busy
    assert peak < (tmp_path / "long.parquet").stat().st_size + 6 * 8 * n
    overview.outlines(tmp_path / "long.parquet")
    assert overview.outlines(tmp_path / "long.parquet") is lines  # kept until the file changes
