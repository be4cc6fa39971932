"""Locks, processes, files and output as other operating systems have them, imitated."""

from __future__ import annotations

import ntpath
import os
import resource
import subprocess
import sys
from pathlib import Path, PureWindowsPath
from typing import Any

import pytest

from strainwave.errors import InvalidInput
from strainwave.io import system
from strainwave.io.atomic_files import write_whole

TESTS = Path(__file__).resolve().parents[1]

ON_WINDOWS = """
import sys
from pathlib import Path
import imitated_windows
kernel = imitated_windows.imitate()
from strainwave.io import system
"""


def on_windows(code: str, *arguments: str | Path) -> str:
    """Output of a program that finds what Windows has."""
    done = subprocess.run(
        [sys.executable, "-c", ON_WINDOWS + code, *map(str, arguments)],
        env=os.environ | {"PYTHONPATH": str(TESTS)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_every_module_is_imported_on_windows() -> None:
    names = on_windows("print(*imitated_windows.modules())").split()
    assert {"strainwave.workbench.runs", "strainwave.fleet.campaign.worker"} <= {*names}


def test_locks_and_processes_on_windows(tmp_path: Path) -> None:
    code = """
path = Path(sys.argv[1])
assert not system.is_locked(path)
lock = system.try_lock(path)
assert lock is not None and system.try_lock(path) is None and system.is_locked(path)
assert system.inheriting(lock)["startupinfo"].lpAttributeList == {"handle_list": [lock]}
assert kernel.inheritable == [lock]
system.unlock(lock)
assert not system.is_locked(path) and kernel.open == {}
assert system.OWN_GROUP["creationflags"] == 0x08000200
system.kill_group(7)
assert kernel.commands == [("taskkill", "/F", "/T", "/PID", "7")]
assert system.command_line(["a b", "c"]) == '"a b" c'
assert system.user_folder().is_dir() and system.resident_mib() == 0.0
try:
    system.limit_memory(100)
except OSError as error:
    print(error)
"""
    assert "cannot limit the memory" in on_windows(code, tmp_path / "lock")


@pytest.mark.parametrize("create", [True, False])
def test_a_lock_ends_with_the_last_process_that_inherits_it(tmp_path: Path, create: bool) -> None:
    path = tmp_path / "lock"
    path.touch()
    lock = system.try_lock(path, create=create)
    assert lock is not None
    command = [sys.executable, "-c", "input()"]
    with subprocess.Popen(command, stdin=subprocess.PIPE, **system.inheriting(lock)) as child:
        system.unlock(lock)
        assert system.is_locked(path)
        assert system.try_lock(path) is None
        child.communicate(b"\n")
    assert not system.is_locked(path)


def test_a_link_and_a_missing_file_are_not_locked(tmp_path: Path) -> None:
    (tmp_path / "link").symlink_to(tmp_path / "file")
    lock = system.try_lock(tmp_path / "file")
    assert lock is not None
    assert not system.is_locked(tmp_path / "link")
    assert not system.is_locked(tmp_path / "none")
    assert not (tmp_path / "none").exists()
    system.unlock(lock)


def test_memory_on_macos_is_in_bytes(monkeypatch: pytest.MonkeyPatch) -> None:
    def no_proc(*_: Any) -> None:
        raise FileNotFoundError

    monkeypatch.setattr("builtins.open", no_proc)
    monkeypatch.setattr(sys, "platform", "darwin")
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    assert system.resident_mib() == pytest.approx(peak / 2**20, rel=1e-3)
    with pytest.raises(OSError, match="cannot limit"):
        system.limit_memory(100)


def keep_open(monkeypatch: pytest.MonkeyPatch, times: int) -> list[Path]:
    """Refuse to replace files, as Windows while others have them open; returns the refusals."""
    replace, refused = Path.replace, list[Path]()

    def refuse(source: Path, target: Path) -> Path:
        if target.exists() and len(refused) < times:
            refused.append(target)
            raise PermissionError(13, "Access is denied", str(source), 5, str(target))
        return replace(source, target)

    monkeypatch.setattr(Path, "replace", refuse)
    return refused


def test_a_file_that_is_open_for_a_moment_is_replaced(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "x").write_bytes(b"old")
    refused = keep_open(monkeypatch, 3)
    write_whole(tmp_path, {"x": b"new"})
    assert len(refused) == 3
    assert (tmp_path / "x").read_bytes() == b"new"


def test_a_file_that_stays_open_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "x").write_bytes(b"old")
    keep_open(monkeypatch, 10**9)
    monkeypatch.setattr(system, "_BUSY_S", 0.1)
    with pytest.raises(InvalidInput, match="close the program that has the file open") as error:
        write_whole(tmp_path, {"y": b"new", "x": b"new"})
    assert str(tmp_path / "x") in str(error.value)
    assert (tmp_path / "x").read_bytes() == b"old"
    assert sorted(each.name for each in tmp_path.iterdir()) == ["x", "y"]


@pytest.mark.parametrize(
    ("path", "expected"),
    [
        (r"C:\rigs\logs\a.csv", "../logs/a.csv"),
        (r"C:\rigs\arm\a.csv", "a.csv"),
        (r"D:\logs\a.csv", "D:/logs/a.csv"),
    ],
)
def test_names_of_files_on_windows(
    monkeypatch: pytest.MonkeyPatch, path: str, expected: str
) -> None:
    monkeypatch.setattr(system, "Path", PureWindowsPath)
    monkeypatch.setattr(os.path, "relpath", ntpath.relpath)
    given: Any = PureWindowsPath(path), PureWindowsPath(r"C:\rigs\arm")
    assert system.relative_path(*given) == expected
