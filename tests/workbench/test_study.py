"""Pages "Study" and "Import logs": the form and the command line share one file."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from strainwave.errors import InvalidInput
from strainwave.init import start_study
from strainwave.io.study import read_study
from workbench_client import make_client

pytest.importorskip("starlette")

from strainwave.workbench.pages.study import field_groups, value_of
from strainwave.workbench.study_edit import KeyChange, changed_text, edit_study, parse_draft

if TYPE_CHECKING:
    from starlette.testclient import TestClient

API = "/api/study/arm/study.toml"
DRAFT = """# my rig
[arm]
kind = "planar-two-link"  # TODO is a word in a comment
link_length = TODO        # [m] measured

[[joint]]
spring = "linear"
gear_ratio = TODO
[[joint]]
spring = "linear"
gear_ratio = 0.01

[servo]
kp = [TODO, TODO]  # gains
"""


def saved(client: TestClient, *changes: dict[str, Any], sha256: str | None = None) -> Any:
    state = client.get(API).json()
    body = {"sha256": sha256 or state["sha256"], "changes": list(changes)}
    return client.post(API, json=body)


def change(place: list[str | int], value: str, kind: str = "number") -> dict[str, Any]:
    return {"place": place, "kind": kind, "value": value}


def test_a_change_keeps_comments_and_is_read_by_the_command_line(
    client: TestClient, folder: Path
) -> None:
    study = folder / "arm" / "study.toml"
    study.write_text("# measured in May\n" + study.read_text())
    answer = saved(client, change(["joint", 0, "torque_per_volt"], "0.075"))
    assert answer.json()["error"] is None
    assert study.read_text().startswith("# measured in May\n")
    assert read_study(study).arm.joints[0].torque_per_volt == 0.075


def test_a_file_of_the_command_line_is_shown(client: TestClient, folder: Path) -> None:
    edit_study(folder / "arm" / "study.toml", [KeyChange(("joint", 1, "gear_ratio"), 0.0125)])
    groups = client.get(API).json()["groups"]
    (joint,) = [group for group in groups if group["title"] == "Joint 2"]
    (field,) = [f for f in joint["fields"] if f["key"]["key"] == "gear_ratio"]
    assert field["value"] == "0.0125"
    assert field["key"]["range"] == [1e-4, 1.0]


def test_a_file_that_changed_in_the_meantime_is_not_overwritten(
    client: TestClient, folder: Path
) -> None:
    before = client.get(API).json()["sha256"]
    study = folder / "arm" / "study.toml"
    study.write_text(study.read_text() + "# by hand\n")
    answer = saved(client, change(["joint", 0, "gear_ratio"], "0.02"), sha256=before)
    assert answer.status_code == 400
    assert "changed in the meantime" in answer.json()["error"]
    assert study.read_text().endswith("# by hand\n")


def test_an_error_of_the_study_names_the_key_and_the_file_stays_editable(
    client: TestClient,
) -> None:
    wrong = saved(client, change(["joint", 0, "gear_ratio"], "100")).json()
    assert "gear_ratio" in wrong["error"]
    assert "/served/" not in wrong["error"]
    assert saved(client, change(["joint", 0, "gear_ratio"], "0.01")).json()["error"] is None


def test_the_text_is_saved_whole_or_not_at_all(client: TestClient, folder: Path) -> None:
    study = folder / "arm" / "study.toml"
    state = client.get(API).json()
    text = state["text"].replace('kind = "planar-two-link"', 'kind = "planar-two-link"  # ours')
    good = client.post(API, json={"sha256": state["sha256"], "text": text})
    assert good.status_code == 200
    assert "# ours" in study.read_text()
    bad = client.post(API, json={"sha256": good.json()["sha256"], "text": "[arm"})
    assert bad.status_code == 400
    assert "# ours" in study.read_text()


def test_a_column_is_mapped_scaled_and_removed(client: TestClient, folder: Path) -> None:
    study = folder / "arm" / "study.toml"
    saved(client, change(["channels", "a1", "column"], "a1", "text"))
    saved(client, change(["channels", "a1", "scale"], "9.81"))
    assert read_study(study).channels["a1"].scale == 9.81
    query = {"experiment": "motion", "channel": "a1", "column": "a1", "scale": "2", "offset": "1"}
    figure = client.get("/api/preview/arm/study.toml", params=query).json()
    assert figure["layout"]["yaxis"]["title"]["text"] == "a1 [m/s²]"
    saved(client, change(["channels", "a1"], "", "text"))
    assert "a1" not in read_study(study).channels


def test_todo_values_are_marked_and_survive_other_changes() -> None:
    document = parse_draft(DRAFT, Path("study.toml"))
    groups = field_groups(document)
    missing = [f.place for fields in groups.values() for f in fields if f.is_todo]
    assert missing == [("arm", "link_length"), ("joint", 0, "gear_ratio"), ("servo", "kp")]
    reasons = {f.key.key: f.reason for f in groups["Arm"]}
    assert reasons["link_length"] == "[m] measured"
    text = changed_text(DRAFT, [KeyChange(("arm", "link_length"), 0.35)], Path("study.toml"))
    assert text == DRAFT.replace("link_length = TODO", "link_length = 0.35")


@pytest.mark.parametrize(
    ("text", "kind", "value"),
    [
        ("", "number", None),
        ("8192", "number", 8192),
        ("1e3", "number", 1000.0),
        ("unknown", "number", "unknown"),
        ("0, 0, -9.81", "numbers", [0, 0, -9.81]),
        ("[1, 0], [0.2, 1]", "numbers", [[1, 0], [0.2, 1]]),
        ("[[1, 0], [0.2, 1]]", "numbers", [[1, 0], [0.2, 1]]),
        ("[1.5, 2]", "numbers", [1.5, 2]),
        ("three-slope", "choice", "three-slope"),
    ],
)
def test_values_of_fields(text: str, kind: Any, value: object) -> None:
    assert value_of(text, kind) == value


@pytest.mark.parametrize("text", ["0,5x", "1 2", "true", "[1, [2]]"])
def test_wrong_numbers_are_refused(text: str) -> None:
    for kind in ("number", "numbers"):
        with pytest.raises(InvalidInput):
            value_of(text, kind)


def test_imported_logs_become_a_draft_with_the_guesses_of_init(
    client: TestClient, folder: Path, tmp_path: Path
) -> None:
    names = ["motion.parquet", "prbs-j1.parquet"]
    for name in names:
        data = (folder / "arm" / name).read_bytes()
        assert client.put(f"/api/upload/new rig/{name}", content=data).json()["size"] == len(data)
        shutil.copy(folder / "arm" / name, tmp_path / name)
    listed = client.get("/api/logs", params={"folder": "new rig"}).json()
    assert listed["logs"] == names
    draft = client.post("/api/draft", json={"folder": "new rig", "logs": names}).json()
    wanted = start_study([tmp_path / name for name in names], tmp_path / "study.toml")
    assert (draft["n_todos"], tuple(draft["channels"])) == (wanted.n_todos, wanted.channels)
    text = (folder / "new rig" / "study.toml").read_text()
    assert text == (tmp_path / "study.toml").read_text()
    state = client.get("/api/study/new rig/study.toml").json()
    assert state["todos"] > 0
    assert "TODO" in state["error"]


def test_uploads_do_not_overwrite_and_have_plain_names(client: TestClient, folder: Path) -> None:
    before = (folder / "arm" / "motion.parquet").read_bytes()
    answer = client.put("/api/upload/arm/motion.parquet", content=b"new")
    assert answer.status_code == 400
    assert (folder / "arm" / "motion.parquet").read_bytes() == before
    for path in ("arm/evil.py", "..%2Farm/a.csv", "arm/..%2Fa.csv", ".hidden/a.csv"):
        assert client.put(f"/api/upload/{path}", content=b"x").status_code in (400, 404)


def test_uploads_are_bounded_and_leave_nothing(folder: Path) -> None:
    client = make_client(folder, max_upload_mib=1)
    answer = client.put("/api/upload/big/a.csv", content=b"0" * (2 << 20))
    assert answer.status_code == 400
    assert "more than 1 MiB" in answer.json()["error"]
    assert not (folder / "big").exists()


def test_a_bad_log_gives_the_message_of_the_command_line(client: TestClient, folder: Path) -> None:
    client.put("/api/upload/bad/a.csv", content=b"t,x\n0,1\n1,oops\n")
    answer = client.post("/api/draft", json={"folder": "bad", "logs": ["a.csv"]})
    assert answer.status_code == 400
    (folder / "direct").mkdir()
    with pytest.raises(InvalidInput) as failure:
        start_study([folder / "bad" / "a.csv"], folder / "direct" / "study.toml")
    assert answer.json()["error"] == str(failure.value).replace(f"{folder}/", "")
    assert not (folder / "bad" / "study.toml").exists()


def test_the_list_of_studies_names_arms_errors_and_verdicts(
    client: TestClient, folder: Path
) -> None:
    (folder / "broken").mkdir()
    (folder / "broken" / "study.toml").write_text('[arm]\nkind = "cube"\n')
    page = client.get("/").text
    assert "planar two link, 2 joints" in page
    assert "there is no [[joint]] table" in page


@pytest.mark.parametrize("name", ["ä rig #1", "100 % + more", "a&b=c", "quote's"])
def test_unusual_names_of_folders_work(client: TestClient, folder: Path, name: str) -> None:
    from urllib.parse import quote

    shutil.copytree(folder / "arm", folder / name)
    path = quote(f"{name}/study.toml")
    assert path in client.get("/").text
    assert client.get(f"/signals/{path}").status_code == 200
    assert client.get(f"/api/study/{path}").json()["error"] is None
