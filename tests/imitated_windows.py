"""Imitates Windows in a process of its own: call `imitate` before strainwave is imported again."""

from __future__ import annotations

import importlib
import os
import pkgutil
import signal
import subprocess
import sys
from types import ModuleType, SimpleNamespace
from typing import Any

MISSING_MODULES = ("fcntl", "grp", "pwd", "resource", "termios")
MISSING = (
    (signal, ("SIGHUP", "SIGKILL", "SIGUSR1", "SIGUSR2")),
    (os, ("O_NOFOLLOW", "WNOHANG", "fork", "getuid", "killpg", "setsid", "sysconf", "uname")),
)
NEW_GROUP, NO_WINDOW = 0x200, 0x08000000


class Kernel(ModuleType):
    """Opens files as `_winapi`: a file that is open without sharing cannot be opened again."""

    GENERIC_READ, GENERIC_WRITE = 0x80000000, 0x40000000

    def __init__(self) -> None:
        super().__init__("_winapi")
        self.open: dict[int, str] = {}
        self.inheritable: list[int] = []
        self.commands: list[tuple[str, ...]] = []

    def CreateFile(  # noqa: N802
        self, path: str, access: int, share: int, _security: int, how: int, *_: int
    ) -> int:
        assert (access, share) == (0xC0000000, 0)
        if path in self.open.values():
            raise windows_error(13, 32)
        if how == 3 and not os.path.exists(path):
            raise windows_error(2, 2)
        with open(path, "ab"):
            self.open[handle := 1000 + len(self.open)] = path
        return handle

    def CloseHandle(self, handle: int) -> None:  # noqa: N802
        del self.open[handle]


def windows_error(number: int, winerror: int) -> OSError:
    error = OSError(number, "denied")
    error.winerror = winerror  # type: ignore[attr-defined]
    return error


def modules() -> list[str]:
    """Names of all modules of the package."""
    import strainwave

    found = pkgutil.walk_packages(strainwave.__path__, "strainwave.")
    return [each.name for each in found if each.name != "strainwave._core"]


def imitate() -> Kernel:
    """Take away what Windows lacks, and import every module again."""
    names = modules()
    for name in names:  # so that other packages are imported as on this system
        importlib.import_module(name)
    for name in list(sys.modules):
        if name.startswith("strainwave") and name != "strainwave._core":
            del sys.modules[name]
    kernel = Kernel()
    blocked: dict[str, Any] = dict.fromkeys(MISSING_MODULES)
    sys.modules.update(blocked | {"_winapi": kernel})
    for module, attributes in MISSING:
        for attribute in attributes:
            delattr(module, attribute)
    added: tuple[tuple[ModuleType, str, Any], ...] = (
        (subprocess, "CREATE_NEW_PROCESS_GROUP", NEW_GROUP),
        (subprocess, "CREATE_NO_WINDOW", NO_WINDOW),
        (subprocess, "STARTUPINFO", SimpleNamespace),
        (subprocess, "run", lambda command, **_: kernel.commands.append(command)),
        (os, "set_handle_inheritable", lambda handle, _: kernel.inheritable.append(handle)),
    )
    for module, name, value in added:
        setattr(module, name, value)
    sys.platform = "win32"
    for name in names:
        importlib.import_module(name)
    return kernel
