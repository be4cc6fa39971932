"""The table of results: summaries, tags, deletion, refused options, places in the queue."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

pytest.importorskip("starlette")

from strainwave.io import result_summaries as summaries
from strainwave.io import system
from strainwave.io.result_summaries import changed_options, toml_text
from strainwave.workbench import runs as runs_module
from strainwave.workbench.pages import estimate
from strainwave.workbench.run_record import Run
from strainwave.workbench.runs import Runs
from strainwave.workbench.supervisor import runs_ahead
from workbench_runs import add_run, result_of

if TYPE_CHECKING:
    from starlette.testclient import TestClient

STUDY = "arm/study.toml"
API = f"/api/estimate/{STUDY}"


@pytest.fixture(autouse=True)
def _time_to_read(monkeypatch: pytest.MonkeyPatch) -> None:
    """A busy machine reads all results as well."""
    monkeypatch.setattr(estimate, "_READING_TIME", 60.0)


def rows(client: TestClient, **query: Any) -> dict[str, Any]:
    table = client.get(API, params=query).json()
    return {run["name"]: run for run in table["runs"]} | {"": table}


def test_a_row_has_fits_key_parameters_and_what_is_not_the_default(
    client: TestClient, folder: Path
) -> None:
    first, second = result_of(6000.0, (98.0, None, 90.0)), result_of(6100.0)
    second["options"]["links"]["order"] = 1
    second["study"]["joint"][0]["gear_ratio"] = 0.02
    add_run(folder / STUDY, "one", first)
    add_run(folder / STUDY, "two", second, created="2026-11-02T10:00:00.000+00:00")
    shown = rows(client)
    assert shown[""]["columns"] == ["gear_stiffness 1"]
    assert shown[""]["units"] == {"gear_stiffness 1": "N m/rad", "alpha": "N m/rad"}
    assert [run["name"] for run in shown[""]["runs"]] == ["two", "one"]
    one, two = shown["one"], shown["two"]
    assert (one["worst"], one["mean"]) == (90.0, 94.0)
    assert one["options"] == one["rig"] == {}
    cell = one["cells"]["gear_stiffness 1"]
    assert (cell["value"], cell["text"], cell["half"]) == (6000.0, "6000", "12")
    assert two["options"] == {"links.order": "1"}
    assert two["rig"] == {"joint 1 gear_ratio": "0.02"}
    assert two["path"] == "arm/runs/two/result.json"
    assert rows(client, column="alpha")["two"]["cells"].keys() == {"alpha"}


@pytest.mark.parametrize(
    "text",
    ["{", "[]", '{"parameters": 3}', '{"parameters": [{}]}', "[" * 100_000, "\0", '{"a": NaN}'],
)
def test_a_damaged_result_is_one_line(client: TestClient, folder: Path, text: str) -> None:
    add_run(folder / STUDY, "one", text)
    add_run(folder / STUDY, "two", result_of())
    shown = rows(client)
    assert shown["one"]["message"] == "result.json is damaged"
    assert shown["one"]["path"] == ""
    assert shown["two"]["worst"] == 90.0


def test_huge_and_foreign_results_are_not_read(
    client: TestClient, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(summaries, "_MAX_BYTES", 100_000)
    add_run(folder / STUDY, "huge", result_of() | {"stages": ["x" * 200_000]})
    link = add_run(folder / STUDY, "link") / "result.json"
    link.symlink_to(folder / "arm" / "runs" / "huge" / "result.json")
    shown = rows(client)
    assert "has more than" in shown["huge"]["message"]
    assert shown["link"]["cells"] == {}


def test_results_are_read_once_and_for_a_limited_time(
    client: TestClient, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(estimate, "_READING_TIME", 0.0)
    for number in range(3):
        add_run(folder / STUDY, f"run-{number}", result_of())
    assert rows(client)[""]["pending"] == 2
    monkeypatch.setattr(estimate, "_READING_TIME", 60.0)
    assert rows(client)[""]["pending"] == 0
    monkeypatch.setattr(summaries, "read_small", None)  # a call would fail
    assert rows(client)["run-2"]["worst"] == 90.0


def test_the_newest_of_many_runs_are_listed(
    client: TestClient, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(runs_module, "MAX_LISTED", 2)
    for number in range(4):
        path = add_run(folder / STUDY, f"run-{number}", created=f"2026-11-0{number + 1}")
        os.utime(path / "run.json", (number, number))
    table = rows(client)[""]
    assert [run["name"] for run in table["runs"]] == ["run-3", "run-2"]
    assert table["total"] == 4


def test_tags_stay_in_the_record(client: TestClient, folder: Path) -> None:
    path = add_run(folder / STUDY, "one") / "run.json"
    body = {"names": ["one"], "tag": " warm "}
    assert client.post(f"/api/tag-runs/{STUDY}", json=body).status_code == 200
    client.post(f"/api/tag-runs/{STUDY}", json=body | {"tag": "payload 2 kg"})
    assert json.loads(path.read_bytes())["tags"] == ["warm", "payload 2 kg"]
    client.post(f"/api/tag-runs/{STUDY}", json=body | {"is_set": False})
    assert rows(client)["one"]["tags"] == ["payload 2 kg"]


@pytest.mark.parametrize("tag", ["", "../x", "a\nb", "x" * 200, "<b>"])
def test_a_text_that_is_no_tag_is_refused(client: TestClient, folder: Path, tag: str) -> None:
    add_run(folder / STUDY, "one")
    body = {"names": ["one"], "tag": tag}
    assert client.post(f"/api/tag-runs/{STUDY}", json=body).status_code == 400
    assert rows(client)["one"]["tags"] == []


def test_damaged_runs_have_no_tags(client: TestClient, folder: Path) -> None:
    path = add_run(folder / STUDY, "one") / "run.json"
    path.write_text("{")
    answer = client.post(f"/api/tag-runs/{STUDY}", json={"names": ["one"], "tag": "warm"})
    assert "run.json is damaged" in answer.json()["error"]
    assert path.read_text() == "{"


def test_runs_of_every_kind_are_deleted_at_once(client: TestClient, folder: Path) -> None:
    kinds = ("identify", "virtual", "excite", "tune", "compare")
    for kind in kinds:
        add_run(folder / STUDY, f"{kind}-1", kind=kind)
    body = {"names": ["no-such", "../arm", *(f"{kind}-1" for kind in kinds)]}
    answer = client.post(f"/api/remove-runs/{STUDY}", json=body)
    assert answer.status_code == 400
    assert "no-such" in answer.json()["error"]
    assert "../arm" in answer.json()["error"]
    assert Runs(folder / STUDY).all() == []


def test_the_field_of_a_refused_option_is_named(client: TestClient, folder: Path) -> None:
    client.post(f"/api/check/{STUDY}", json={})
    options = {"rigid.bandwidth_hz": "4.0", "links.order": "7"}
    answer = client.post(API, json={"options": options})
    assert answer.json()["where"] == "links.order"
    assert answer.json()["error"].startswith("links.order: 'order' is 7")
    assert "--set" not in answer.json()["error"]
    add_run(folder / STUDY, "one")
    assert client.post(API, json={"name": "one"}).json()["where"] == "name"
    assert [run.name for run in Runs(folder / STUDY).all()] == ["one"]


def test_the_last_message_of_a_failed_run_names_fields_of_the_page(
    client: TestClient, folder: Path
) -> None:
    path = add_run(folder / STUDY, "one", kind="excite", state="failed", status=None)
    (path / "log.txt").write_text("first\nstrainwave: --limit-angle=x: 'x' is not a number.\n\n")
    add_run(folder / STUDY, "two", state="failed", status=None)
    shown = rows(client)
    assert shown["one"]["message"] == "Largest link angle=x: 'x' is not a number."
    assert shown["two"]["message"].startswith("It ended without a message")


def test_options_of_a_run_without_result_are_those_of_its_command(
    client: TestClient, folder: Path
) -> None:
    command = ["identify", "study.toml", "--stages", "rigid", "--set", "links.order=1"]
    add_run(folder / STUDY, "one", commands=[command], state="cancelled", status=None)
    add_run(folder / STUDY, "two", commands=[["identify", "--set"]])
    shown = rows(client)
    assert (shown["one"]["options"], shown["one"]["stages"]) == ({"links.order": "1"}, "rigid")
    assert shown["two"]["options"] == {}


def test_options_are_toml() -> None:
    changed = changed_options({"tuning": {"ranges": {"a 1": [0.5, 2.0]}}, "accept": ["x"]})
    assert changed == {"tuning.ranges": '{"a 1" = [0.5, 2.0]}', "accept": '["x"]'}
    assert toml_text(True) == "true"


def test_durations_leave_out_the_wait() -> None:
    times = [f"2026-11-01T10:00:{second}.000+00:00" for second in ("00", "20", "50")]
    created, started, ended = times
    run = Run("a", "identify", (("identify", "x"),), created, "done", ended=ended)
    assert run.seconds == 50
    assert Run("a", "identify", (), created, "done", ended=ended, started=started).seconds == 30
    assert Run("a", "identify", (), "soon", "done", ended=ended).seconds is None


def test_a_waiting_run_has_a_place_in_the_queue(tmp_path: Path) -> None:
    slots = tmp_path / "runtime" / "strainwave"
    slots.mkdir(mode=0o700)
    held = [
        system.try_lock(slots / f"ticket-{number}.{group}") for number, group in ((2, 8), (3, 9))
    ]
    (slots / "ticket-1.7").touch()  # of a process that has ended
    (slots / "ticket-4.x").touch()
    assert [runs_ahead(group) for group in (7, 8, 9, None)] == [None, 0, 1, None]
    for lock in held:
        assert lock is not None
        system.unlock(lock)
    assert runs_ahead(9) is None


def test_files_of_one_run_are_listed(client: TestClient, folder: Path) -> None:
    add_run(folder / STUDY, "one", result_of())
    add_run(folder / STUDY, "two", kind="tune", created="2026-11-02T10:00:00.000+00:00")
    two, one = client.get(f"/api/files/{STUDY}", params={"run": "one"}).json()
    assert [file["name"] for file in one["files"]] == ["report.html", "result.json"]
    assert "files" not in two
