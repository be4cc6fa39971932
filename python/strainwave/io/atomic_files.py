"""Files that are written completely or not at all, and read with clear messages.

TOML documents that a user writes.
"""

from __future__ import annotations

import errno
import json
import os
import re
import stat
import tempfile
import threading
import tomllib
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from strainwave.errors import InvalidInput, suggest_name
from strainwave.io.system import replace_file

FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
"""Errors of a disk that is full, or of a limit of this user."""
# dotted keys, for which the parser takes a time that grows with the square of their length
_LONG_KEY = re.compile(r"""(?<![\w-])(?:(?:[\w-]++|"[^"\n]*+"|'[^'\n]*+')[ \t]*+\.[ \t]*+){100}""")
writing = threading.Lock()
"""Held while files are written; a thread that ends the process acquires it first."""
written: list[Path] = []
"""Files that this process has written, in order."""


def write_whole(folder: Path, contents: Mapping[str, bytes]) -> None:
    """Write files into a folder: temporary files first, then one rename each.

    A reader sees the old file or the new one, never a part. The folder is created if necessary; it
    remains only with files. A name may contain subfolders: `figures/bode.svg`. Raises
    `InvalidInput` if the folder cannot be created or written to.
    """
    with writing:
        _write_whole(folder, contents)
        written.extend(folder / name for name in contents)


def _write_whole(folder: Path, contents: Mapping[str, bytes]) -> None:
    pending: list[tuple[Path, Path]] = []
    is_new = not os.path.lexists(folder)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for name, data in contents.items():
            final = folder / name
            final.parent.mkdir(parents=True, exist_ok=True)
            handle, temporary = tempfile.mkstemp(prefix=f".{final.name}.", dir=final.parent)
            pending.append((Path(temporary), final))
            with os.fdopen(handle, "wb") as file:
                file.write(data)
            mask = os.umask(0)
            os.umask(mask)
            Path(temporary).chmod(0o666 & ~mask)
        for temporary_path, final in pending:
            replace_file(temporary_path, final)
    except OSError as error:
        locked = error.filename2 if isinstance(error, PermissionError) else None
        remedy = "choose another --out directory or change its permissions"
        if error.errno in FULL:
            remedy = "make space on the disk"
        elif locked:
            remedy = "close the program that has the file open, or choose another --out directory"
        problem = f"cannot write there ({error.strerror or error})"
        raise InvalidInput(problem, where=str(locked or folder), remedy=remedy) from error
    finally:
        for temporary_path, _ in pending:
            temporary_path.unlink(missing_ok=True)
        if is_new:
            with suppress(OSError):  # it has the files
                folder.rmdir()


def read_bytes(path: Path, description: str) -> bytes:
    """A file's bytes; `description` names the file in the message of `InvalidInput`."""
    try:
        mode = path.stat().st_mode
        if not (stat.S_ISREG(mode) or stat.S_ISDIR(mode)):
            raise InvalidInput(  # a pipe or a device may never end
                f"{description} is not a regular file",
                where=str(path),
                remedy="copy it to a file on a disk",
            )
        return path.read_bytes()
    except FileNotFoundError as error:
        hint = suggest_name(path.name, [p.name for p in path.parent.glob("*")])
        raise InvalidInput(
            f"{description} does not exist", where=str(path), remedy=f"check the name{hint}"
        ) from error
    except IsADirectoryError as error:
        raise InvalidInput(
            f"{description} is a directory", where=str(path), remedy="use the path of a file in it"
        ) from error
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise InvalidInput(
            f"{description} cannot be read ({reason})",
            where=str(path),
            remedy="check its permissions",
        ) from error


def read_small(path: Path, description: str, max_bytes: int) -> bytes:
    """A file's bytes, as `read_bytes`; raises InvalidInput also if it exceeds the limit."""
    with suppress(OSError, ValueError):  # `read_bytes` reports the fault
        if path.stat().st_size > max_bytes:
            raise InvalidInput(
                f"{description} has more than {max_bytes >> 10} KiB",
                where=str(path),
                remedy="use a smaller file",
            )
    return read_bytes(path, description)


def decode(data: bytes, path: Path) -> str:
    """UTF-8 text, with or without byte order mark; `InvalidInput` names path and line."""
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        raise InvalidInput(
            f"is not UTF-8: byte 0x{data[error.start]:02x}",
            where=f"{path}, line {line}",
            remedy="save the file as UTF-8",
        ) from error


def parse_toml(text: str, path: Path) -> dict[str, Any]:
    """The parsed text; `InvalidInput` naming `path` if it is not valid TOML."""
    try:
        if _LONG_KEY.search(text):
            raise ValueError("a key has more than 100 parts")
        return tomllib.loads(text)
    except (ValueError, RecursionError) as error:  # also a number of more than 4,300 digits
        is_path = "Unescaped" in str(error)  # as in "C:\\logs"
        remedy = "write paths with / instead of \\" if is_path else "correct that line"
        problem = f"is not valid TOML ({error})"
        raise InvalidInput(problem, where=str(path), remedy=remedy) from error


def read_json(path: Path, description: str, remedy: str) -> Any:
    """The parsed file; `InvalidInput` with `remedy` if it is not JSON."""
    text = decode(read_bytes(path, description), path)
    try:
        return json.loads(text)
    except (ValueError, RecursionError) as error:  # also a number of more than 4,300 digits
        raise InvalidInput(f"is not JSON ({error})", where=str(path), remedy=remedy) from error


def check_keys(document: dict[str, Any], known: Sequence[str], path: Path) -> None:
    """Raise `InvalidInput` if the document has an unknown key."""
    for key in document:
        if key not in known:
            raise InvalidInput(
                f"unknown key '{key}'",
                where=str(path),
                remedy=f"use {', '.join(known)}{suggest_name(key, known)}",
            )
