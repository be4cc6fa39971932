"""Differences between operating systems: locks, groups of processes, memory, paths, output.

A lock belongs to an open file. Processes inherit it, and it ends with the last of them. POSIX
systems lock the file; Windows opens it such that no one else can open it.
"""

from __future__ import annotations

import io
import os
import shlex
import signal
import stat
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path
from typing import Any

if sys.platform == "win32":
    import _winapi
else:
    import fcntl
    import resource

OWN_GROUP: dict[str, Any] = {"start_new_session": True}
"""Arguments of `Popen` for a process in a group of its own, which Ctrl-C does not reach."""
if sys.platform == "win32":
    OWN_GROUP["creationflags"] = subprocess.CREATE_NEW_PROCESS_GROUP | subprocess.CREATE_NO_WINDOW

_BUSY_S = 1.0  # [s] that another process may have a file open that is replaced


def try_lock(path: Path, *, create: bool = True) -> int | None:
    """Lock a file; None if it is locked. OSError if it cannot be opened or locked."""
    if sys.platform == "win32":
        access = _winapi.GENERIC_READ | _winapi.GENERIC_WRITE
        how = 4 if create else 3  # OPEN_ALWAYS, OPEN_EXISTING
        try:
            return _winapi.CreateFile(str(path), access, 0, 0, how, 0, 0)
        except OSError as error:
            if error.winerror == 32:  # ERROR_SHARING_VIOLATION
                return None
            raise
    else:
        file = os.open(path, os.O_RDWR | (os.O_CREAT if create else os.O_NOFOLLOW), 0o644)
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            os.close(file)
            if isinstance(error, BlockingIOError):
                return None
            raise
        return file


def unlock(lock: int) -> None:
    """Close a lock in this process."""
    if sys.platform == "win32":
        _winapi.CloseHandle(lock)
    else:
        os.close(lock)


def is_locked(path: Path) -> bool:
    """Whether a process holds a lock on a file; a file that cannot be opened is not locked."""
    try:
        lock = try_lock(path, create=False)
    except OSError:
        return False
    if lock is not None:
        unlock(lock)
    return lock is None


def inheriting(lock: int) -> dict[str, Any]:
    """Arguments of `Popen` for a process that inherits a lock, which has the same number."""
    if sys.platform == "win32":
        os.set_handle_inheritable(lock, True)
        return {"startupinfo": subprocess.STARTUPINFO(lpAttributeList={"handle_list": [lock]})}
    else:
        return {"pass_fds": (lock,)}


def command_line(arguments: Iterable[str]) -> str:
    """Arguments as a user types them."""
    return (subprocess.list2cmdline if sys.platform == "win32" else shlex.join)(arguments)


def ask_to_end(command: subprocess.Popen[bytes]) -> None:
    """Ask the group of this process, which started a command, to end; on Windows, the command."""
    if sys.platform == "win32":
        command.terminate()
    else:
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
        os.killpg(0, signal.SIGTERM)


def kill_group(leader: int) -> None:
    """Kill the processes of a group; on Windows, a process and those that it started."""
    if sys.platform == "win32":
        command = ("taskkill", "/F", "/T", "/PID", str(leader))
        subprocess.run(command, capture_output=True, check=False)
    else:
        with suppress(ProcessLookupError):
            os.killpg(leader, signal.SIGKILL)


def limit_memory(mib: int) -> None:
    """Limit the memory of this process; OSError if the system cannot."""
    if sys.platform == "win32" or sys.platform == "darwin":
        raise OSError("this system cannot limit the memory of a process")
    else:
        resource.setrlimit(resource.RLIMIT_AS, (mib * 2**20, mib * 2**20))


def resident_mib() -> float:
    """Memory of this process [MiB]; on macOS the highest so far, on Windows 0: unknown."""
    if sys.platform == "win32":
        return 0.0
    else:
        try:
            with open("/proc/self/statm", "rb") as file:
                return int(file.read().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 2**20
        except OSError:
            peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
            return peak / (2**20 if sys.platform == "darwin" else 2**10)


def user_folder() -> Path:
    """A folder of this user's runtime files; nobody else can write there."""
    runtime, name = os.environ.get("XDG_RUNTIME_DIR"), "strainwave"
    if sys.platform != "win32" and not runtime:  # on Windows, temporary files are the user's
        name += f"-{os.getuid()}"
    folder = Path(runtime or tempfile.gettempdir()) / name
    folder.mkdir(mode=0o700, exist_ok=True)
    status = folder.lstat()
    is_own = sys.platform == "win32" or status.st_uid == os.getuid()
    if not stat.S_ISDIR(status.st_mode) or not is_own:
        raise OSError(f"{folder} belongs to another user: delete it")
    return folder


def replace_file(temporary: Path, final: Path) -> None:
    """Rename a file. Windows refuses while the old one is open: tries again for `_BUSY_S`."""
    limit = time.monotonic() + _BUSY_S
    while True:
        try:
            temporary.replace(final)
            return
        except PermissionError:
            if not final.is_file() or time.monotonic() > limit:
                raise
        time.sleep(0.02)


def relative_path(path: Path, folder: Path) -> str:
    """A path as a file in `folder` names it, with `/`; absolute if it is on another drive."""
    try:
        return Path(os.path.relpath(path, folder)).as_posix()
    except ValueError:
        return path.as_posix()


def print_any_letter() -> None:
    """Print a question mark for each letter that the standard output cannot encode."""
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="replace")
