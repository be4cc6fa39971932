"""Ctrl-C ends the process within a second and reports the files that were written."""

from __future__ import annotations

import os
import signal
import socket
import sys
import threading
from contextlib import suppress
from types import FrameType

from strainwave.io import atomic_files

EXIT_CODE = 130
"""Exit code after Ctrl-C: 128 + SIGINT, as shells report it."""
_GRACE_S = 0.7  # [s] for threads to end by themselves; the whole stop takes less than a second
_RESTORE_CURSOR = "\r\x1b[2K\x1b[?25h"  # clears the progress line and shows the cursor again

_reported = threading.Lock()


class Interrupted(BaseException):
    """Ctrl-C was pressed; not a KeyboardInterrupt, which Typer catches."""


def listen() -> None:
    """Let Ctrl-C end this process; call once, in the main thread.

    The main thread raises `Interrupted` when it next runs Python code. A watching thread, which
    the signal wakes through a socket, ends the process after `_GRACE_S` if compiled code still
    runs, and at once after a second Ctrl-C. Files that are being written are finished first.
    """
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:  # started in the background
        return
    receiver, sender = socket.socketpair()
    sender.setblocking(False)
    signal.set_wakeup_fd(sender.fileno(), warn_on_full_buffer=False)
    signal.signal(signal.SIGINT, _interrupt)
    threading.Thread(target=_watch, args=(receiver, sender), daemon=True).start()


def report() -> None:
    """Print which files remain; only the first call of any thread prints."""
    if not _reported.acquire(blocking=False):
        return
    cursor = _RESTORE_CURSOR if sys.stderr.isatty() else ""
    print(f"{cursor}strainwave: stopped; {_files_written()}", file=sys.stderr, flush=True)


def _files_written() -> str:
    if not atomic_files.written:
        return "nothing was written"
    folders = sorted({str(path.parent) for path in atomic_files.written})
    return f"{len(atomic_files.written)} file(s) had been written to {', '.join(folders)}"


def _interrupt(_number: int, _frame: FrameType | None) -> None:
    signal.signal(signal.SIGINT, _ignore)
    # the watching thread ends the process when the files are complete
    if not atomic_files.writing.locked():
        raise Interrupted


def _ignore(_number: int, _frame: FrameType | None) -> None:
    """Second Ctrl-C: the watching thread receives it too and ends the process."""


def _watch(receiver: socket.socket, _sender: socket.socket) -> None:
    """Wait for SIGINT, then for the grace period; `_sender` stays open as long as this thread."""
    while signal.SIGINT not in receiver.recv(64):
        pass
    receiver.settimeout(_GRACE_S)
    with suppress(TimeoutError):
        receiver.recv(64)
    with atomic_files.writing:
        report()
        os._exit(EXIT_CODE)
