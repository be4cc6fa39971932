"""Page "Study": experiments, the signals of their logs, and rig values of other studies."""

from __future__ import annotations

import json
import shutil
import time
import tracemalloc
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from strainwave.errors import InvalidInput
from strainwave.init import start_study
from strainwave.io.logs import columns as log_columns
from strainwave.io.logs.tables import write_table
from strainwave.io.study import read_study

pytest.importorskip("starlette")

from strainwave.workbench.pages import overview
from strainwave.workbench.rig_values import rig_changes
from strainwave.workbench.study_edit import KeyChange, changed_text

if TYPE_CHECKING:
    from starlette.testclient import TestClient

API = "/api/study/arm/study.toml"
TEXT = """# rig
[arm]
kind = "x"

# of all experiments

[[experiment]]
name = "a"  # first
file = "a.csv"
# start = 10

# validation
[[experiment]]
name = "b"
[experiment.prbs]
order = 3

[options]
x = '''
[[experiment]]
'''
"""


def edited(text: str, index: int, value: str | None) -> str:
    return changed_text(text, [KeyChange(("experiment", index), value)], Path("study.toml"))


def test_tables_are_inserted_and_removed_and_all_other_lines_stay() -> None:
    text = TEXT.replace("\n[[experiment]]\n'''", "'''")
    first = '[[experiment]]\nname = "a"  # first\nfile = "a.csv"\n# start = 10\n\n'
    second = '[[experiment]]\nname = "b"\n[experiment.prbs]\norder = 3\n\n'
    assert edited(text, 0, None) == text.replace(first, "")
    assert edited(text, 1, None) == text.replace(second, "")
    new = '[[experiment]]\nname = "c"  # mine\nfile = TODO\n\n'
    body = 'name = "c"  # mine\nfile = TODO'
    assert edited(text, 0, body) == text.replace(first, new + first)
    assert edited(text, 1, body) == text.replace(first, first + new)
    assert edited(text, 2, body) == text.replace(second, second + new)
    for index in range(3):
        assert edited(edited(text, index, body), index, None) == text
    assert edited("[arm]\r\n", 0, 'name = "c"') == '[arm]\r\n\n[[experiment]]\nname = "c"\n'


@pytest.mark.parametrize(
    ("text", "index", "value"),
    [
        (TEXT, 0, None),  # a text of several lines looks like a table
        (TEXT.replace("\n[[experiment]]\n'''", "'''"), 2, None),
        (TEXT.replace("\n[[experiment]]\n'''", "'''"), 3, "name = 1"),
        ('experiment = [{ name = "a" }]', 0, None),
        ("[experiment]", 0, "name = 1"),
        ("[arm]", 0, "name = "),
    ],
)
def test_tables_that_cannot_be_changed_are_refused(text: str, index: int, value: str) -> None:
    with pytest.raises(InvalidInput):
        edited(text, index, value)


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


def test_a_data_sheet_is_a_table_of_values_in_toml_or_json() -> None:
    draft = (
        "[arm]\nlink_length = TODO  # [m]\n[[joint]]\n[[joint]]\ngear_ratio = TODO\n[channels]\n"
    )
    sheet = {
        "arm": {"link_length": 0.35, "kind": "serial", "gravity": None},
        "joint": [{"imu": {"xyz": [0, 0, 1]}}, {"gear_ratio": "TODO", "name": 'a"b'}],
        "channels": {"a1": {"column": "acc", "scale": 9.81}, "a2": "missing"},
    }
    changes = rig_changes(draft, json.dumps(sheet), ["acc"], Path("study.toml"))
    text = changed_text(draft, changes, Path("study.toml"))
    assert text == (
        "[arm]\nlink_length = 0.35  # [m]\n[[joint]]\nimu = {xyz = [0, 0, 1]}\n[[joint]]\n"
        'gear_ratio = TODO\nname = "a\\"b"\n[channels]\na1 = {column = "acc", scale = 9.81}\n'
    )
    toml = '[arm]\nlink_length = 0.35\n[channels]\na1 = { topic = "/a", field = "b", name = "c" }'
    columns = ["/a.b[c]"]
    assert len(rig_changes(draft, toml, columns, Path("study.toml"))) == 2


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ("[[joint]]\n", "1 joint(s), and this arm has 2"),
        ("x = 1\n", "no values of a rig"),
        ('{"arm": [}', "no valid JSON"),
        ("[arm", "Remedy"),
        ('{"arm": {"gravity": [null]}}', "a value that TOML does not have"),
    ],
)
def test_values_that_cannot_be_taken_are_refused(values: str, message: str) -> None:
    draft = "[arm]\n[[joint]]\n[[joint]]\n"
    with pytest.raises(InvalidInput, match=message.replace("(", r"\(").replace(")", r"\)")):
        changed_text(draft, rig_changes(draft, values, [], Path("s")), Path("s"))


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
