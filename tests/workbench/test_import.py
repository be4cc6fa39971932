"""Page "Import logs": logs are stored whole under plain names, and become a draft."""

from __future__ import annotations

import os
import shutil
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from strainwave.errors import InvalidInput
from strainwave.init import start_study
from strainwave.io.study import read_study
from workbench_client import make_client

pytest.importorskip("starlette")

from strainwave.workbench import workspace
from strainwave.workbench.workspace import free_path

if TYPE_CHECKING:
    from starlette.testclient import TestClient


def put(client: TestClient, folder: str, name: str, content: bytes) -> Any:
    return client.put("/api/upload", params={"folder": folder, "name": name}, content=content)


def test_imported_logs_become_a_draft_with_the_guesses_of_init(
    client: TestClient, folder: Path, tmp_path: Path
) -> None:
    names = ["motion.parquet", "prbs-j1.parquet"]
    for name in names:
        data = (folder / "arm" / name).read_bytes()
        assert put(client, "new rig", name, data).json() == {"name": name, "size": len(data)}
        shutil.copy(folder / "arm" / name, tmp_path / name)
    listed = client.get("/api/logs", params={"folder": "new rig"}).json()
    assert listed["logs"] == names
    draft = client.post("/api/draft", json={"folder": "new rig", "logs": names}).json()
    wanted = start_study([tmp_path / name for name in names], tmp_path / "study.toml")
    assert draft == {"path": "new rig/study.toml", "notes": list(wanted.warnings)}
    text = (folder / "new rig" / "study.toml").read_text()
    assert text == (tmp_path / "study.toml").read_text() == wanted.text
    assert "TODO" in client.get("/api/study/new rig/study.toml").json()["error"]
    again = client.post("/api/draft", json={"folder": "new rig", "logs": names})
    assert "has a study already" in again.json()["error"]


def test_a_draft_takes_the_values_of_another_study(client: TestClient, folder: Path) -> None:
    shutil.copytree(folder / "arm", folder / "new")
    values = (folder / "new" / "study.toml").read_text()
    (folder / "new" / "study.toml").unlink()
    names = client.get("/api/logs", params={"folder": "new"}).json()["logs"]
    renamed = values.replace('file = "motion.parquet"', 'file = "other.parquet"')
    body = {"folder": "new", "logs": names, "values": renamed}
    client.post("/api/draft", json=body)
    study = folder / "new" / "study.toml"
    assert read_study(study).arm == read_study(folder / "arm" / "study.toml").arm
    assert "# link turns per motor turn" in study.read_text()  # it is the draft
    study.unlink()
    (folder / "new" / "arm.urdf").write_text("<robot/>")
    sheet = '[arm]\nurdf = "arm.urdf"\nlink_length = 0.5\n'  # no study, although the file exists
    client.post("/api/draft", json=body | {"values": sheet})
    assert "link_length = 0.5 " in study.read_text()
    study.unlink()
    client.post("/api/draft", json=body | {"values": values})  # it names these logs
    assert study.read_text() == values


def test_logs_that_cannot_be_read_are_left_out_with_the_reason(
    client: TestClient, folder: Path
) -> None:
    for name in ("motion.parquet", "prbs-j1.parquet"):
        put(client, "rig", name, (folder / "arm" / name).read_bytes())
    put(client, "rig", "bad.csv", b"t,x\n0,1\n1,oops\n")
    logs = ["bad.csv", "motion.parquet", "prbs-j1.parquet"]
    draft = client.post("/api/draft", json={"folder": "rig", "logs": logs}).json()
    assert [note for note in draft["notes"] if note.startswith("Left out: rig/bad.csv: ")]
    study = read_study_text(folder / "rig" / "study.toml")
    assert "bad.csv" not in study
    assert 'file = "motion.parquet"' in study


def read_study_text(path: Path) -> str:
    return "\n".join(line.split("#")[0] for line in path.read_text().split("\n"))


@pytest.mark.parametrize(
    ("name", "stored"),
    [
        ("log 1.csv", "log 1 (2).csv"),  # taken
        ('a "quoted" name.csv', "a -quoted- name.csv"),
        ("Mu\u0308ller.csv", "M\u00fcller.csv"),  # as macOS writes it
        ("day 1/run.csv.gz", "day 1-run.csv.gz"),
        ("../../etc/passwd.csv", "etc-passwd.csv"),
        (".hidden.csv", "hidden.csv"),
        ("#?*.csv", "log.csv"),
        ("C:\\logs\\a.csv", "C-logs-a.csv"),
        ("NUL.csv", "logs NUL.csv"),  # a device of Windows
        ("a\0b\n.parquet", "a-b.parquet"),
        (f"{'x' * 300}.csv", f"{'x' * 106}.csv"),
        ("\u65e5" * 100 + ".csv", "\u65e5" * 35 + ".csv"),  # of three bytes each
    ],
)
def test_names_are_repaired(client: TestClient, folder: Path, name: str, stored: str) -> None:
    (folder / "rig").mkdir()
    (folder / "rig" / "log 1.csv").write_bytes(b"old")
    assert put(client, "rig", name, b"new").json()["name"] == stored
    assert (folder / "rig" / stored).read_bytes() == b"new"
    assert (folder / "rig" / "log 1.csv").read_bytes() == b"old"


@pytest.mark.parametrize(
    ("name", "stored"), [("arm", "arm (2)"), ("runs", "logs runs"), ("_x/y", "x-y"), ("..", "log")]
)
def test_a_new_folder_gets_a_free_name(client: TestClient, name: str, stored: str) -> None:
    assert client.get("/api/free-folder", params={"name": name}).json()["folder"] == stored


def test_a_name_that_is_too_long_for_its_number_is_still_stored(folder: Path) -> None:
    for name in ("y" * 200, "y" * 200):
        free_path(folder, name).mkdir()
    assert [len(path.name) for path in sorted(folder.glob("y*"))] == [110, 114]


@pytest.mark.parametrize("target", ["../out", "arm/runs/one", ".git", "a/.b", "x\0y"])
def test_uploads_stay_in_folders_of_logs(client: TestClient, folder: Path, target: str) -> None:
    (folder / ".git").mkdir()
    before = sorted(folder.parent.rglob("*"))
    assert put(client, target, "a.csv", b"x").status_code == 400
    assert put(client, "arm", "evil.py", b"x").status_code == 400
    assert sorted(folder.parent.rglob("*")) == before


def test_uploads_are_bounded_and_leave_nothing(folder: Path) -> None:
    client = make_client(folder, max_upload_mib=1)
    answer = put(client, "big/bag", "a.csv", b"0" * (2 << 20))
    assert answer.status_code == 400
    assert "more than 1 MiB" in answer.json()["error"]
    assert not (folder / "big").exists()


def test_a_full_disk_is_a_sentence(
    client: TestClient, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "replace", fail)
    answer = put(client, "rig", "a.csv", b"x")
    assert answer.status_code == 507
    assert "No space left on device" in answer.json()["error"]
    assert not (folder / "rig").exists()


def test_an_upload_needs_no_hard_links(
    client: TestClient, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object) -> None:  # as on exFAT
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr(os, "link", refuse)
    assert put(client, "rig", "a.csv", b"x").status_code == 200
    assert {path.name: path.read_bytes() for path in (folder / "rig").iterdir()} == {"a.csv": b"x"}


def test_a_faster_upload_stays(
    client: TestClient, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    put(client, "rig", "a.csv", b"fast")
    monkeypatch.setattr(workspace, "free_path", Path.joinpath)  # which was free a moment ago
    assert put(client, "rig", "a.csv", b"slow").status_code == 400
    assert [path.read_bytes() for path in (folder / "rig").iterdir()] == [b"fast"]


def test_a_bad_log_gives_the_message_of_the_command_line(client: TestClient, folder: Path) -> None:
    put(client, "bad", "a.csv", b"t,x\n0,1\n1,oops\n")
    answer = client.post("/api/draft", json={"folder": "bad", "logs": ["a.csv"]})
    assert answer.status_code == 400
    (folder / "direct").mkdir()
    with pytest.raises(InvalidInput) as failure:
        start_study([folder / "bad" / "a.csv"], folder / "direct" / "study.toml")
    assert answer.json()["error"] == str(failure.value).replace(f"{folder}/", "")
    assert not (folder / "bad" / "study.toml").exists()
