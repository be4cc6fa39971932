"""Ctrl-C: one line, exit code 130, soon, whatever runs; and nothing half-written."""

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
from strainwave.numerics.parallel import side_by_side, stop_if_asked
interrupt.listen()
def ready():
    print("ready", flush=True)
"""
EPILOGUE = """
except interrupt.Interrupted:
    interrupt.say()
    sys.exit(interrupt.STOPPED)
"""
GRACE = 5.0  # s; the promise is one, on a machine that has nothing else to do


@pytest.fixture(autouse=True)
def heard() -> Iterator[None]:
    """Ctrl-C counts in every child, even where the tests themselves run in the background."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


def communicate(process: subprocess.Popen[str]) -> tuple[str, str]:
    """What a process still says; one that does not end is ended."""
    try:
        return process.communicate(timeout=60.0)
    except subprocess.TimeoutExpired:
        process.kill()
        raise


def stopped(code: str, *, times: int = 1) -> tuple[int, str, float]:
    """Exit code, standard error and seconds of a program to which Ctrl-C is sent once it is ready."""
    body = "try:\n" + "".join(f"    {line}\n" for line in code.strip().splitlines())
    with subprocess.Popen(
        [sys.executable, "-c", PROLOGUE + body + EPILOGUE],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "ready\n"
        begin = time.monotonic()
        for _ in range(times):
            process.send_signal(signal.SIGINT)
            time.sleep(0.05)
        _, said = communicate(process)
        return process.returncode, said, time.monotonic() - begin


NOTHING = "strainwave: stopped; nothing was written\n"


def test_jobs_side_by_side_are_stopped() -> None:
    code = """
def endless():
    while True:
        stop_if_asked()
def first():
    ready()
    endless()
side_by_side([first, endless, endless])
"""
    code_, said, seconds = stopped(code)
    assert (code_, said) == (130, NOTHING)
    assert seconds < GRACE


@pytest.mark.parametrize("times", [1, 2])
def test_what_does_not_listen_is_cut_off(times: int) -> None:
    """Jobs that never look, as in a long call of compiled code; at once by a second Ctrl-C."""
    code = "side_by_side([lambda: ready() or time.sleep(100), lambda: time.sleep(100)])"
    code_, said, seconds = stopped(code, times=times)
    assert (code_, said) == (130, NOTHING)
    assert seconds < GRACE


def test_what_is_being_written_appears_whole_and_is_named(tmp_path: Path) -> None:
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
    code_, said, _ = stopped(code)
    assert (code_, said) == (
        130,
        f"strainwave: stopped; 2 file(s) had been written before, to {tmp_path}\n",
    )
    assert sorted(p.name for p in tmp_path.iterdir()) == ["one", "two"]


def test_a_command_is_stopped_while_it_starts(tmp_path: Path) -> None:
    with subprocess.Popen(
        [sys.executable, "-m", "strainwave", "demo", "--out", str(tmp_path / "demo")],
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        threads = Path(f"/proc/{process.pid}/task")
        if threads.exists():  # the thread that watches for the signal is the first to be started
            while process.poll() is None and len(list(threads.iterdir())) < 2:
                time.sleep(0.001)
            time.sleep(0.05)
        else:
            time.sleep(1.0)
        process.send_signal(signal.SIGINT)
        _, said = communicate(process)
    assert (process.returncode, said) == (130, NOTHING)
    assert not os.path.exists(tmp_path / "demo")


def test_a_process_in_the_background_ignores_it() -> None:
    """A shell starts those with the signal ignored, and it stays so."""
    code = """
import signal
signal.signal(signal.SIGINT, signal.SIG_IGN)
from strainwave.io import interrupt
interrupt.listen()
print(signal.getsignal(signal.SIGINT) is signal.SIG_IGN)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "True\n"
