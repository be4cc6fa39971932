"""After kill -9 of a worker or of the driver the same command continues."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path

import psutil
import pytest

import strainwave as sw
from campaign_commands import COUNT, campaign, records_by_study, running, wait_for, workers_of
from campaign_rigs import rigs


@pytest.fixture(scope="module")
def studies(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return rigs(tmp_path_factory.mktemp("studies"), COUNT)


def test_a_killed_worker_is_one_failed_study(studies: Path, tmp_path: Path) -> None:
    with running(studies, "--out", tmp_path, "--workers", "2") as driver:
        wait_for(tmp_path, 4, driver)
        workers_of(driver)[0].kill()
        stdout, _ = driver.communicate()
    rows = sw.read_runs(tmp_path).to_pylist()
    assert set(records_by_study(tmp_path).values()) == {1}
    assert len(rows) == COUNT
    failed = [row for row in rows if row["status"] == "failed"]
    # none, if it is killed between two studies
    assert len(failed) <= 1
    for row in failed:
        assert row["exit_code"] == 137
        assert "SIGKILL" in row["message"]
    assert driver.returncode == (3 if failed else 0)
    assert f"{COUNT} of {COUNT} studies" in stdout


def test_a_killed_driver_loses_nothing(studies: Path, tmp_path: Path) -> None:
    with running(studies, "--out", tmp_path, "--workers", "2") as driver:
        wait_for(tmp_path, 4, driver)
        workers = workers_of(driver)
        driver.kill()
        driver.wait()
    _, alive = psutil.wait_procs(workers, timeout=20.0)
    assert alive == []  # each ended after its study
    first = {row["run"]: row["started"] for row in sw.read_runs(tmp_path).to_pylist()}
    assert 4 <= len(first) < COUNT
    again = campaign(studies, "--out", tmp_path)
    assert again.returncode == 0, again.stderr
    assert f"{len(first)} of them recorded before" in again.stdout
    found = {row["run"]: row["started"] for row in sw.read_runs(tmp_path).to_pylist()}
    assert len(found) == COUNT
    assert {run: found[run] for run in first} == first  # none of them was run twice


@pytest.fixture
def interrupts_reach_children() -> Iterator[None]:
    """A child of a process in the background would ignore the signal."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.usefixtures("interrupts_reach_children")
def test_ctrl_c_ends_the_workers_and_keeps_finished_runs(studies: Path, tmp_path: Path) -> None:
    with running(studies, "--out", tmp_path, "--workers", "2") as driver:
        wait_for(tmp_path, 4, driver)
        workers = workers_of(driver)
        start = time.monotonic()
        driver.send_signal(signal.SIGINT)
        _, stderr = driver.communicate()
        assert time.monotonic() - start < 30.0  # on a busy machine
    assert driver.returncode == 130
    assert "stopped" in stderr
    assert "runs" in stderr
    _, alive = psutil.wait_procs(workers, timeout=5.0)
    assert alive == []
    rows = sw.read_runs(tmp_path).to_pylist()
    assert 4 <= len(rows) < COUNT
    assert {row["status"] for row in rows} == {"determined"}
    assert campaign(studies, "--out", tmp_path).returncode == 0
    assert records_by_study(tmp_path).total() == COUNT


def test_two_campaigns_into_one_store(studies: Path, tmp_path: Path) -> None:
    with (
        running(studies, "--out", tmp_path, "--workers", "1") as one,
        running(studies, "--out", tmp_path, "--workers", "1") as other,
    ):
        for driver in (one, other):
            _, errors = driver.communicate()
            assert (driver.returncode, errors) == (0, "")
    assert records_by_study(tmp_path).total() == COUNT
    assert set(records_by_study(tmp_path).values()) == {1}


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """A file system of half a megabyte."""
    folder = tmp_path / "disk"
    folder.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=512k", "tmpfs", str(folder)]
    if os.geteuid() != 0 or shutil.which("mount") is None:
        pytest.skip("only root mounts a small disk")
    if subprocess.run(mount, capture_output=True, check=False).returncode != 0:
        pytest.skip("nothing can be mounted here")
    yield folder
    subprocess.run(["umount", str(folder)], check=True)


def test_a_campaign_continues_after_a_full_disk(studies: Path, small_disk: Path) -> None:
    filler = small_disk / "filler"
    filler.write_bytes(bytes(350_000))
    done = campaign(studies, "--out", small_disk / "store")
    assert done.returncode == 3
    assert done.stderr.count("\n") == 1
    assert "No space left on device" in done.stderr
    recorded = sw.read_runs(small_disk / "store").num_rows
    assert 0 < recorded < COUNT
    assert f"{recorded} of {COUNT} studies are recorded" in done.stderr
    filler.unlink()
    subprocess.run(["mount", "-o", "remount,size=64m", str(small_disk)], check=True)
    done = campaign(studies, "--out", small_disk / "store")
    assert done.returncode == 0, done.stderr
    assert records_by_study(small_disk / "store").total() == COUNT
