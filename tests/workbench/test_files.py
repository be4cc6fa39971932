"""Page "Files": downloads, exports, and the script that repeats a run."""

from __future__ import annotations

import io
import json
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

pytest.importorskip("starlette")

from strainwave.workbench.pages.runs import EXPORT_FILES, python_script
from strainwave.workbench.run_record import Run
from workbench_client import make_client
from workbench_runs import add_run

if TYPE_CHECKING:
    from starlette.testclient import TestClient

STUDY = "arm/study.toml"


@pytest.fixture(scope="module")
def finished(arm_folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A served folder with a finished run of the joint models with an option."""
    served = tmp_path_factory.mktemp("served")
    shutil.copytree(arm_folder, served / "arm")
    client = make_client(served)
    client.post(f"/api/check/{STUDY}", json={})
    body = {"name": "one", "stages": "rigid,decoupled", "options": {"links.order": "1"}}
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_RUNTIME_DIR", str(tmp_path_factory.mktemp("runtime")))
        client.post(f"/api/estimate/{STUDY}", json=body)
        client.get(f"/api/run-events/{STUDY}", params={"name": "one"})  # ends with the run
    return served


@pytest.fixture
def run(finished: Path, folder: Path, client: TestClient) -> dict[str, Any]:
    """A copy of the finished run in the folder of the client."""
    shutil.rmtree(folder)
    shutil.copytree(finished, folder)
    (shown,) = client.get(f"/api/files/{STUDY}").json()
    assert shown["state"] == "done"
    return dict(shown)


def test_the_script_repeats_the_run(run: dict[str, Any], folder: Path) -> None:
    place = folder / "arm" / "runs" / "one"
    (place / "repeat.py").write_text(run["script"])
    subprocess.run([sys.executable, "repeat.py"], cwd=place, check=True, capture_output=True)
    first, second = (
        json.loads((place / name).read_bytes()) for name in ("result.json", "repeated.json")
    )
    assert first["parameters"] == second["parameters"]
    assert first["options"] == second["options"]
    assert (place / "repeated.xml").is_file()


def test_every_format_is_exported_or_gives_the_message_of_the_command_line(
    client: TestClient, run: dict[str, Any]
) -> None:
    for form, file in EXPORT_FILES.items():
        body = {"name": run["name"], "format": form}
        answer = client.post(f"/api/export/{STUDY}", json=body)
        assert answer.status_code == 200, (form, answer.json())
        query = {"run": "one", "file": f"exports/{file}"}
        downloaded = client.get(f"/download/{STUDY}", params=query)
        assert downloaded.headers["content-disposition"].startswith("attachment")
    body = {"name": "one", "format": "exe"}
    assert client.post(f"/api/export/{STUDY}", json=body).status_code == 400


def test_the_archive_has_all_files(client: TestClient, run: dict[str, Any]) -> None:
    data = client.get(f"/zip/{STUDY}", params={"run": "one"}).content
    names = zipfile.ZipFile(io.BytesIO(data)).namelist()
    assert {"one/result.json", "one/report.html", "one/study.toml"} <= set(names)


@pytest.mark.parametrize(
    "file", ["../../study.toml", "/etc/passwd", "no-such", "../one/../../study.toml"]
)
def test_other_files_are_refused(client: TestClient, run: dict[str, Any], file: str) -> None:
    query = {"run": "one", "file": file}
    assert client.get(f"/download/{STUDY}", params=query).status_code == 400


def test_the_script_has_stages_options_and_start() -> None:
    options = ("--set", "links.order=1", "--set", 'tuning.hold=["a b"]', "--start", "start.json")
    command = ("identify", "study.toml", "--out", ".", "--stages", "rigid", *options)
    script = python_script(Run("x", "identify", (command,), "2026"))
    assert "stages=['rigid']" in script
    assert """options=['links.order=1', 'tuning.hold=["a b"]']""" in script
    assert "start='start.json'" in script
    compile(script, "script", "exec")


def test_the_script_of_a_run_of_any_letters_is_downloaded(client: TestClient, folder: Path) -> None:
    add_run(folder / STUDY, "größer 大", commands=[["identify", "study.toml", "--out", "."]])
    answer = client.get(f"/script/{STUDY}", params={"run": "größer 大"})
    assert answer.status_code == 200
    assert "sw.identify" in answer.text
    assert "gr%C3%B6%C3%9Fer%20%E5%A4%A7.py" in answer.headers["content-disposition"]
