"""Ctrl-C ends the process within a second, whatever runs, with a line on what was written."""

from __future__ import annotations

import os
import signal
import socket
import sys
import threading
from contextlib import suppress
from types import FrameType

from strainwave.io import atomic_files

STOPPED = 130
"""The exit code, as shells give it to what Ctrl-C ended."""
_GRACE = 0.7  # s, in which threads may come to their end by themselves
_SHOW_CURSOR = "\r\x1b[2K\x1b[?25h"  # what a progress line had hidden, and the line itself

_said = threading.Lock()


class Interrupted(BaseException):
    """Ctrl-C was pressed. Not a KeyboardInterrupt, which the command line's library swallows."""


def listen() -> None:
    """From now on, Ctrl-C ends this process; called once, in the main thread.

    The main thread gets `Interrupted` as soon as it runs Python again, and threads beside it end
    at their next `stop_if_asked`. Who does not, in compiled code for instance, is cut off after
    the grace, by a thread that the signal itself wakes; or at once by a second Ctrl-C. Files that
    are just being written are finished first.
    """
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:  # as begun in the background
        return
    ears, mouth = socket.socketpair()
    mouth.setblocking(False)
    signal.set_wakeup_fd(mouth.fileno(), warn_on_full_buffer=False)
    signal.signal(signal.SIGINT, _interrupt)
    threading.Thread(target=_watch, args=(ears, mouth), daemon=True).start()


def say() -> None:
    """Print what Ctrl-C leaves, once however many threads come to say it."""
    if not _said.acquire(blocking=False):
        return
    cursor = _SHOW_CURSOR if sys.stderr.isatty() else ""
    print(f"{cursor}strainwave: stopped; {_left()}", file=sys.stderr, flush=True)


def _left() -> str:
    """Which files the run had written."""
    if not atomic_files.written:
        return "nothing was written"
    folders = sorted({str(path.parent) for path in atomic_files.written})
    return f"{len(atomic_files.written)} file(s) had been written before, to {', '.join(folders)}"


def _interrupt(_number: int, _frame: FrameType | None) -> None:
    signal.signal(signal.SIGINT, _again)
    # what is being written appears whole; the watch ends the rest
    if not atomic_files.writing.locked():
        raise Interrupted


def _again(_number: int, _frame: FrameType | None) -> None:
    """The watch hears it as well, and ends the process; here it would only spoil the ending."""


def _watch(ears: socket.socket, _mouth: socket.socket) -> None:
    """Wait for the signal, and then for the end. The other socket lives as long as this thread."""
    while signal.SIGINT not in ears.recv(64):
        pass
    ears.settimeout(_GRACE)
    with suppress(TimeoutError):
        ears.recv(64)
    with atomic_files.writing:
        say()
        os._exit(STOPPED)
