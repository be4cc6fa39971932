"""Ctrl-C prints one line and exits with 130 within a second; files are complete or absent."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="no such signal to send")

PROLOGUE = """
import sys, threading, time
from pathlib import Path
from strainwave.io import atomic_files, interrupt
from strainwave.numerics.parallel import run_parallel, raise_if_stopped
interrupt.listen()
def ready():
    print("ready", flush=True)
"""
EPILOGUE = """
except interrupt.Interrupted:
    interrupt.report()
    sys.exit(interrupt.EXIT_CODE)
"""
MAX_STOP_S = 5.0  # [s] on a busy machine; 1 s is documented for an idle one


@pytest.fixture(autouse=True)
def interrupts_reach_children() -> Iterator[None]:
    """A child of a process in the background would ignore the signal."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


def communicate(process: subprocess.Popen[str]) -> tuple[str, str]:
    """Remaining output of a process, which is killed after a minute."""
    try:
        return process.communicate(timeout=60.0)
    except subprocess.TimeoutExpired:
        process.kill()
        raise


def stopped(code: str, *, times: int = 1) -> tuple[int, str, float]:
    """Exit code, standard error and duration of a program that receives Ctrl-C when it is ready."""
    body = "try:\n" + "".join(f"    {line}\n" for line in code.strip().splitlines())
    with subprocess.Popen(
        [sys.executable, "-c", PROLOGUE + body + EPILOGUE],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "ready\n"
        start = time.monotonic()
        for _ in range(times):
            process.send_signal(signal.SIGINT)
            time.sleep(0.05)
        _, stderr = communicate(process)
        return process.returncode, stderr, time.monotonic() - start


NOTHING = "strainwave: stopped; nothing was written\n"


def test_parallel_jobs_stop() -> None:
    code = """
def endless():
    while True:
        raise_if_stopped()
def first():
    ready()
    endless()
run_parallel([first, endless, endless])
"""
    exit_code, stderr, seconds = stopped(code)
    assert (exit_code, stderr) == (130, NOTHING)
    assert seconds < MAX_STOP_S


@pytest.mark.parametrize("times", [1, 2])
def test_compiled_code_is_ended(times: int) -> None:
    """Jobs that never check for the signal end after the grace period, or at a second Ctrl-C."""
    code = "run_parallel([lambda: ready() or time.sleep(100), lambda: time.sleep(100)])"
    exit_code, stderr, seconds = stopped(code, times=times)
    assert (exit_code, stderr) == (130, NOTHING)
    assert seconds < MAX_STOP_S


def test_files_being_written_are_completed_and_named(tmp_path: Path) -> None:
    code = f"""
real = Path.replace
def slow(*each):
    ready()
    time.sleep(1.0)
    return real(*each)
Path.replace = slow
atomic_files.write_whole(Path({str(tmp_path)!r}), dict(one=b"1", two=b"2"))
time.sleep(100)
"""
    exit_code, stderr, _ = stopped(code)
    assert (exit_code, stderr) == (
        130,
        f"strainwave: stopped; 2 file(s) had been written to {tmp_path}\n",
    )
    assert sorted(p.name for p in tmp_path.iterdir()) == ["one", "two"]


def test_a_command_stops_during_start_up(tmp_path: Path) -> None:
    with subprocess.Popen(
        [sys.executable, "-m", "strainwave", "demo", "--out", str(tmp_path / "demo")],
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        threads = Path(f"/proc/{process.pid}/task")
        if threads.exists():  # the watching thread is the first thread to start
            while process.poll() is None and len(list(threads.iterdir())) < 2:
                time.sleep(0.001)
            time.sleep(0.05)
        else:
            time.sleep(1.0)
        process.send_signal(signal.SIGINT)
        _, stderr = communicate(process)
    assert (process.returncode, stderr) == (130, NOTHING)
    assert not os.path.exists(tmp_path / "demo")


def test_a_background_process_ignores_ctrl_c() -> None:
    """A shell starts background processes with SIGINT ignored."""
    code = """
import signal
signal.signal(signal.SIGINT, signal.SIG_IGN)
from strainwave.io import interrupt
interrupt.listen()
print(signal.getsignal(signal.SIGINT) is signal.SIG_IGN)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "True\n"
