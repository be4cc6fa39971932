"""Whatever a request or a file of the folder contains, the answer is a page or a sentence."""

from __future__ import annotations

import json
import resource
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
import tomlkit
from hypothesis import given, settings
from hypothesis import strategies as st

pytest.importorskip("starlette")

from starlette.routing import Route
from starlette.testclient import TestClient

import strainwave as sw
from strainwave.workbench.app import ROUTES
from strainwave.workbench.pages.check import run_check
from strainwave.workbench.runs import Runs
from workbench_client import make_client

START_PROCESS = Runs._start
STUDY = "arm/study.toml"
START, OTHER = "arm/runs/one/result.json", "arm/runs/other/result.json"
QUERY = {"experiment": "motion", "record": "motion", "channel": "u1", "run": "one", "name": "one"}
VALUES = [{"name": "motor_inertia", "joint": 1, "value": 1e-4}]
BODIES: dict[str, dict[str, Any]] = {
    "study": {"changes": [{"place": ["joint", 0, "gear_ratio"], "kind": "number", "value": "1"}]},
    "experiments": {"logs": ["step-j1.parquet"]},
    "rig-values": {"values": '{"arm": {"link_length": 0.3}, "joint": [{}, {"gyro_hz": 5}]}'},
    "apply-remedy": {"index": 0},
    "compare": {"paths": [START, OTHER]},
    "compare-joint": {"paths": [START, OTHER], "joint": 1},
    "by-hand-begin": {"start": START, "experiment": "motion"},
    "by-hand": {"start": START, "experiment": "motion", "values": VALUES, "channels": ["u1"]},
    "by-hand-save": {"name": "mine", "values": VALUES},
    "by-hand-fit": {"values": VALUES, "held": ["motor_inertia"]},
    "window": {"experiment": "motion", "start": 0, "stop": 1},
    "steps": {"experiment": "motion", "steps": [{"kind": "lowpass", "cutoff_hz": 60.0}]},
    "cancel-run": {"name": "one"},
    "remove-runs": {"names": ["two"]},
    "tag-runs": {"names": ["one"], "tag": "warm"},
    "export": {"name": "one", "format": "json"},
    "design": {"kind": "tune", "parameters": START, "options": {"seed": "1"}},
    "estimate": {"name": "two", "stages": "rigid", "options": {"statespace.order": "4"}},
}
ODD: st.SearchStrategy[Any] = st.sampled_from(
    [None, "", 0, -1, 99, 1e300, "x", "a\0", "../..", [], [1], ["a"], [[]], [None], {}, {"a": 1}]
)
SLOW = ("events", "orders", "joint-spectrum")


@pytest.fixture(scope="module")
def served(tmp_path_factory: pytest.TempPathFactory, arm_folder: Path) -> Iterator[TestClient]:
    """A client of a folder with one study and one run; runs do not start processes."""
    folder = tmp_path_factory.mktemp("served")
    shutil.copytree(arm_folder, folder / "arm")
    run = Runs(folder / STUDY).prepare("one")
    record = {"name": "one", "kind": "identify", "commands": [["identify", "study.toml"]]}
    (run / "run.json").write_text(json.dumps(record | {"created": "", "state": "done"}))
    result = sw.identify(folder / STUDY, stages=("rigid", "decoupled"))
    result.save(run / "result.json")
    shutil.copytree(run, run.with_name("other"))

    run_check(folder / STUDY)  # opens the gate before an estimate
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Runs, "_start", lambda _, run: run)
        with make_client(folder) as client:  # one event loop for all requests
            yield client


def workspace(client: TestClient) -> Path:
    folder: Path = client.app.state.workspace.folder  # type: ignore[attr-defined]
    return folder


def study_file(client: TestClient) -> Path:
    return workspace(client) / STUDY


def contents(folder: Path) -> dict[Path, bytes]:
    return {path: path.read_bytes() if path.is_file() else b"" for path in folder.rglob("*")}


@contextmanager
def restored(folder: Path) -> Iterator[None]:
    """Files and subfolders of a folder are the same at the end as at the beginning."""
    before = contents(folder)
    folders = {path for path in before if path.is_dir()}
    try:
        yield
    finally:
        for path in sorted(folders):
            path.mkdir(exist_ok=True)
        after = contents(folder)
        for path in sorted(after.keys() - before.keys(), reverse=True):
            path.rmdir() if path.is_dir() else path.unlink()
        for path in before.keys() - folders:
            if after.get(path) != before[path]:
                path.write_bytes(before[path])


def places(value: Any, at: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Every place in nested tables and lists."""
    yield at
    if isinstance(value, dict | list):
        for key in value if isinstance(value, dict) else range(len(value)):
            yield from places(value[key], (*at, key))


def replaced(document: Any, place: tuple[Any, ...], value: Any) -> Any:
    if not place:
        return value
    copy = json.loads(json.dumps(document))
    table = copy
    for key in place[:-1]:
        table = table[key]
    table[place[-1]] = value
    return copy


@pytest.mark.parametrize("route", ["by-hand-fit", "estimate"])
def test_the_bodies_before_a_change_start_a_run(served: TestClient, route: str) -> None:
    with restored(workspace(served)):
        answer = served.post(f"/api/{route}/{STUDY}", json=BODIES[route])
        assert answer.status_code == 200, answer.text


@settings(max_examples=100)
@given(data=st.data())
def test_any_body_gets_an_answer(served: TestClient, data: st.DataObject) -> None:
    route = data.draw(st.sampled_from(sorted(BODIES)))
    body = replaced(
        BODIES[route], data.draw(st.sampled_from(list(places(BODIES[route])))), data.draw(ODD)
    )
    with restored(workspace(served)):
        if route == "study" and isinstance(body, dict):
            body["sha256"] = served.get(f"/api/study/{STUDY}").json()["sha256"]
        answer = served.post(f"/api/{route}/{STUDY}", json=body)
        assert answer.status_code in (200, 400, 422)
        assert served.get(f"/api/study/{STUDY}").status_code == 200


@settings(max_examples=50)
@given(
    route=st.sampled_from(
        [r.path for r in ROUTES if isinstance(r, Route) and r.methods and "GET" in r.methods]
    ),
    name=st.sampled_from(
        ["experiment", "channels", "run", "file", "column", "scale", "from", "to"]
    ),
    value=st.sampled_from(
        ["", "x", "-1", "1e300", "nan", "a\0", "..", "/", "a,b", "unknown", "[1"]
    ),
)
def test_any_query_gets_an_answer(served: TestClient, route: str, name: str, value: str) -> None:
    if not any(part in route for part in SLOW):
        path = route.replace("{study:path}", STUDY)
        answer = served.get(path, params=QUERY | {name: value})
        assert answer.status_code in (200, 400, 422)


@settings(max_examples=100)
@given(data=st.data())
def test_any_study_file_is_shown_with_its_error(served: TestClient, data: st.DataObject) -> None:
    study = study_file(served)
    document = tomlkit.parse(study.read_text()).unwrap()
    place = data.draw(st.sampled_from([at for at in places(document) if at]))
    value = data.draw(ODD.filter(lambda value: value not in (None, [None])))
    query = {"experiment": "motion", "column": "u1", "channel": "u1"}
    with restored(workspace(served)):
        study.write_text(tomlkit.dumps(replaced(document, place, value)))
        for path in ("/", f"/api/study/{STUDY}", f"/api/preview/{STUDY}", f"/signals/{STUDY}"):
            assert served.get(path, params=query).status_code in (200, 400, 422)


@contextmanager
def full_disk() -> Iterator[None]:
    """No file of this process grows: the system refuses each write."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (0, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


UNLINK = Path.unlink


def unlink_closed(path: Path, missing_ok: bool = False) -> None:
    """As Windows, delete only a file that this process has closed."""
    for handle in Path("/proc/self/fd").glob("*"):
        if handle.exists() and path.exists() and handle.samefile(path):
            raise PermissionError(13, "Access is denied", str(path))
    UNLINK(path, missing_ok)


WRITING = "study window check by-hand-save by-hand-fit estimate design export save-comparison"


@pytest.mark.parametrize("route", [*WRITING.split(), "virtual", "draft", "upload", "zip"])
def test_a_full_disk_is_a_sentence_and_changes_nothing(
    served: TestClient, route: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    monkeypatch.setattr(Path, "unlink", unlink_closed)
    monkeypatch.setattr(Runs, "_start", START_PROCESS)  # its first write fails
    folder = workspace(served)
    body = dict(BODIES["compare"] if route == "save-comparison" else BODIES.get(route, {}))
    body["sha256"] = served.get(f"/api/study/{STUDY}").json()["sha256"]
    body |= {"folder": "draft", "logs": ["log.parquet"]} if route == "draft" else {}
    (folder / "draft").mkdir(exist_ok=True)
    shutil.copyfile(folder / "arm" / "motion.parquet", folder / "draft" / "log.parquet")
    before = contents(folder)
    with full_disk():
        if route == "upload":
            answer = served.put("/api/upload?folder=new&name=log.csv", content=b"t,u1\n0,1\n")
        elif route == "zip":
            answer = served.get(f"/zip/{STUDY}?run=one")
        else:
            of_study = "" if route in ("virtual", "draft") else f"/{STUDY}"
            answer = served.post(f"/api/{route}{of_study}", json=body)
    assert (answer.status_code, answer.json()["error"].count("make space on the disk")) == (507, 1)
    assert contents(folder) == before
    assert not list(tmp_path.glob("*.zip"))


@pytest.mark.parametrize("name", ["result.json", "report.html", "run.json", "../.check.json"])
@pytest.mark.parametrize("content", [b"", b"{", b"[]", b"null", b"\xff", b"{}", b'{"schema": 1}'])
def test_a_damaged_file_of_a_run_is_no_internal_error(
    served: TestClient, name: str, content: bytes
) -> None:
    file = Runs(study_file(served)).path("one") / name
    with restored(workspace(served)):
        file.write_bytes(content)
        for page in ("api/estimate", "api/files", "api/check"):
            assert served.get(f"/{page}/{STUDY}").status_code == 200
        assert served.get("/").status_code == 200
        answer = served.post(f"/api/compare/{STUDY}", json={"paths": [START, OTHER]})
        assert answer.status_code == (400 if name == "result.json" else 200)
