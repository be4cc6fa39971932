"""Runs: process groups, cancel, recovery after the server's death, names."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from strainwave.errors import InvalidInput
from strainwave.io.system import user_folder
from strainwave.workbench.run_record import Run
from strainwave.workbench.runs import Runs
from strainwave.workbench.supervisor import CANCEL, CORES_PER_RUN, runs_ahead

PATIENCE = 120.0  # [s] on a loaded machine


def wait_for(runs: Runs, name: str, state: str) -> Run:
    limit = time.monotonic() + PATIENCE
    while (run := runs.get(name)).state != state:
        assert time.monotonic() < limit, (run, (runs.path(name) / "log.txt").read_text())
        time.sleep(0.05)
    return run


def start_identify(folder: Path, name: str, *arguments: str) -> Runs:
    return start(folder, name, "identify", "../../study.toml", "--out", ".", *arguments)


def start(folder: Path, name: str, *command: str) -> Runs:
    runs = Runs(folder / "arm" / "study.toml")
    runs.prepare(name)
    runs.start(name, "identify", [command])
    return runs


def is_alive(group: int | None) -> bool:
    assert group is not None
    try:
        os.killpg(group, 0)
    except ProcessLookupError:
        return False
    return True


def test_a_finished_run_has_its_result_and_command_line(folder: Path) -> None:
    runs = start_identify(folder, "one", "--stages", "rigid")
    run = wait_for(runs, "one", "done")
    assert run.exit_code == 0
    assert (runs.path("one") / "result.json").is_file()
    assert run.lines == ["strainwave identify ../../study.toml --out . --stages rigid"]
    assert [r.name for r in runs.all()] == ["one"]


def test_a_failed_run_keeps_the_message(folder: Path) -> None:
    runs = start_identify(folder, "one", "--set", "links.order=7")
    run = wait_for(runs, "one", "failed")
    assert run.exit_code == 2
    assert "links.order" in (runs.path("one") / "log.txt").read_text()


def test_cancel_ends_the_process_group(folder: Path) -> None:
    runs = start_identify(folder, "one")
    group = wait_for(runs, "one", "running").group
    assert is_alive(group)
    assert runs.cancel("one").state == "cancelled"
    limit = time.monotonic() + PATIENCE
    while is_alive(group):  # until the thread of the server has seen the end
        assert time.monotonic() < limit
        time.sleep(0.02)
    assert not (runs.path("one") / "result.json").exists()
    assert runs.get("one").state == "cancelled"


def test_a_failing_command_ends_a_run_of_several(folder: Path) -> None:
    runs = Runs(folder / "arm" / "study.toml")
    runs.prepare("two")
    commands = [("check", "no-such-study.toml"), ("identify", "../../study.toml", "--out", ".")]
    runs.start("two", "virtual", commands)
    assert wait_for(runs, "two", "failed").exit_code == 2
    assert not (runs.path("two") / "result.json").exists()


SERVER = """
import sys, time
from pathlib import Path
from strainwave.workbench.runs import Runs
runs = Runs(Path(sys.argv[1]))
runs.prepare("one")
commands = [("check", "../../study.toml"), ("identify", "../../study.toml", "--out", ".", "--stages", "rigid")]
runs.start("one", "virtual", commands)
print("started", flush=True)
time.sleep(1000)
"""


@pytest.fixture
def killed_server(folder: Path) -> Runs:
    """Runs whose server started two commands and was killed at once."""
    command = [sys.executable, "-c", SERVER, str(folder / "arm" / "study.toml")]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as server:
        assert server.stdout is not None
        assert server.stdout.readline() == "started\n"
        server.kill()
    return Runs(folder / "arm" / "study.toml")


def test_a_run_ends_with_all_its_commands_after_the_server_was_killed(killed_server: Runs) -> None:
    run = wait_for(killed_server, "one", "done")
    assert run.exit_code == 0
    assert run.status == "determined"
    assert (killed_server.path("one") / "result.json").is_file()


def test_a_run_that_was_killed_is_interrupted(killed_server: Runs) -> None:
    group = wait_for(killed_server, "one", "running").group
    assert group is not None
    os.killpg(group, signal.SIGKILL)
    assert wait_for(killed_server, "one", "interrupted").ended is not None
    assert Runs(killed_server.folder.parent / "study.toml").get("one").state == "interrupted"


def test_runs_wait_for_each_other_and_a_waiting_run_can_be_cancelled(folder: Path) -> None:
    runs = start_identify(folder, "first")
    wait_for(runs, "first", "running")
    slots = max(1, (os.cpu_count() or 1) // CORES_PER_RUN)
    for number in range(slots):
        start_identify(folder, f"next-{number}", "--stages", "rigid")
    last = f"next-{slots - 1}"
    limit = time.monotonic() + PATIENCE
    while (ahead := runs_ahead(runs.get(last).group)) is None:  # until its process waits
        assert time.monotonic() < limit
        time.sleep(0.02)
    assert ahead == 0
    assert runs.get(last).state == "waiting"
    assert runs.cancel(last).state == "cancelled"
    assert runs.get("first").state in ("running", "done")
    assert runs.cancel("first").state in ("cancelled", "done")
    assert not any(run.is_active for run in runs.all() if not run.name.startswith("next"))


def test_names_cannot_leave_the_folder(folder: Path) -> None:
    runs = Runs(folder / "arm" / "study.toml")
    for name in ("", "..", "../x", "a/b", ".hidden", "-x", "a" * 200, "a\0b"):
        with pytest.raises(InvalidInput):
            runs.prepare(name)
    runs.prepare("one")
    with pytest.raises(InvalidInput, match="already"):
        runs.prepare("one")
    assert runs.free_name("one") == "one-1"


def test_a_running_run_is_not_removed(folder: Path) -> None:
    runs = start_identify(folder, "one")
    with pytest.raises(InvalidInput, match="cancel it first"):
        runs.remove("one")
    runs.cancel("one")
    runs.remove("one")
    assert runs.all() == []


@pytest.mark.parametrize("record", ["{", "[]", '{"name": "one"}', "null", "\udcff"])
def test_a_damaged_record_is_marked_and_can_be_removed(folder: Path, record: str) -> None:
    runs = Runs(folder / "arm" / "study.toml")
    (runs.prepare("one") / "run.json").write_bytes(record.encode("utf-8", "surrogateescape"))
    (run,) = runs.all()
    assert (run.state, run.note) == ("failed", "run.json is damaged")
    runs.remove("one")
    assert runs.all() == []


def test_two_studies_of_one_folder_have_runs_of_their_own(folder: Path) -> None:
    other = folder / "arm" / "payload.toml"
    other.write_text((folder / "arm" / "study.toml").read_text())
    Runs(other).prepare("one")
    assert (folder / "arm" / "runs-payload" / "one").is_dir()
    runs = start(folder, "one", "identify", "--help")
    wait_for(runs, "one", "done")
    assert Runs(other).all() == []


@pytest.mark.parametrize("name", ["con", "NUL", "com1.csv", "aux .x", "one.", "one "])
def test_a_name_that_windows_cannot_have_is_refused(folder: Path, name: str) -> None:
    with pytest.raises(InvalidInput, match="name"):
        Runs(folder / "arm" / "study.toml").prepare(name)


def test_names_that_differ_by_capitals_are_one_where_the_files_are(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As on Windows and macOS."""
    make = Path.mkdir

    def make_once(path: Path, **options: bool) -> None:
        if path.parent.is_dir() and any(
            each.name.casefold() == path.name.casefold() for each in path.parent.iterdir()
        ):
            raise FileExistsError(path)
        make(path, **options)

    monkeypatch.setattr(Path, "mkdir", make_once)
    runs = Runs(folder / "arm" / "study.toml")
    runs.folder.mkdir()
    runs.prepare("A")
    with pytest.raises(InvalidInput, match="there is a run 'a' already"):
        runs.prepare("a")


def test_a_file_cancels_a_run(folder: Path) -> None:
    runs = start_identify(folder, "one")
    wait_for(runs, "one", "running")
    (runs.path("one") / CANCEL).touch()
    run = wait_for(runs, "one", "cancelled")
    assert run.exit_code is None
    assert runs.cancel("one") == run  # as often as one likes
    assert not (runs.path("one") / CANCEL).exists()


def test_a_run_without_space_for_the_file_is_killed(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    runs = start_identify(folder, "one")
    wait_for(runs, "one", "running")

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "touch", full)
    monkeypatch.setattr("strainwave.workbench.runs.PATIENCE", 0.1)
    assert runs.cancel("one").state == "cancelled"


def test_a_dead_ticket_holds_nobody_up(folder: Path) -> None:
    """Its process was killed, and another one may have its number."""
    queue = user_folder()
    (queue / f"ticket-1.{os.getpid()}").touch()
    assert runs_ahead(os.getpid()) is None
    runs = start(folder, "one", "identify", "--help")
    wait_for(runs, "one", "done")


def test_a_command_line_is_that_of_the_system(monkeypatch: pytest.MonkeyPatch) -> None:
    run = Run("one", "identify", (("identify", "my study.toml"),), "")
    assert run.lines == ["strainwave identify 'my study.toml'"]
    monkeypatch.setattr(sys, "platform", "win32")
    assert run.lines == ['strainwave identify "my study.toml"']
