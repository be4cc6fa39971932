"""Files that appear whole or not at all, and files that cannot be read, reported clearly."""

from __future__ import annotations

import difflib
import os
import tempfile
import threading
from collections.abc import Iterable, Mapping
from pathlib import Path

from strainwave.errors import InvalidInput

writing = threading.Lock()
"""Held while files are written; who ends the process waits for it."""
written: list[Path] = []
"""What this process has written, in order."""


def write_whole(folder: Path, contents: Mapping[str, bytes]) -> None:
    """Write several files into a folder: all are written aside first, then renamed.

    A reader sees the old file or the new one, never half of one.

    Parameters
    ----------
    folder : Path
        Made where it does not exist.
    contents : mapping of file name to bytes
        A name may begin with one folder inside, `figures/bode.svg`.

    Raises
    ------
    InvalidInput
        The folder cannot be made or written to.
    """
    with writing:
        _write_whole(folder, contents)
        written.extend(folder / name for name in contents)


def _write_whole(folder: Path, contents: Mapping[str, bytes]) -> None:
    aside: list[tuple[Path, Path]] = []
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for name, data in contents.items():
            final = folder / name
            final.parent.mkdir(exist_ok=True)
            handle, temporary = tempfile.mkstemp(prefix=f".{final.name}.", dir=final.parent)
            aside.append((Path(temporary), final))
            with os.fdopen(handle, "wb") as file:
                file.write(data)
            Path(temporary).chmod(0o666 & ~_umask())
        for temporary_path, final in aside:
            temporary_path.replace(final)
    except OSError as error:
        raise InvalidInput(
            f"cannot write there ({error.strerror or error})",
            where=str(folder),
            remedy="choose another --out directory or mend its permissions",
        ) from error
    finally:
        for temporary_path, _ in aside:
            temporary_path.unlink(missing_ok=True)


def _umask() -> int:
    """Permissions new files do not get; there is no way to read it without setting it."""
    mask = os.umask(0)
    os.umask(mask)
    return mask


def read_bytes(path: Path, what: str) -> bytes:
    """A file's bytes.

    Parameters
    ----------
    path : Path
    what : str
        What the file is, for the message.

    Returns
    -------
    bytes

    Raises
    ------
    InvalidInput
        There is no such file, or it cannot be read.
    """
    try:
        return path.read_bytes()
    except FileNotFoundError as error:
        near = nearest(path.name, [p.name for p in path.parent.glob("*")])
        raise InvalidInput(
            f"{what} does not exist", where=str(path), remedy=f"check the name{near}"
        ) from error
    except IsADirectoryError as error:
        raise InvalidInput(
            f"{what} is a directory", where=str(path), remedy="name a file in it"
        ) from error
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise InvalidInput(
            f"{what} cannot be read ({reason})", where=str(path), remedy="check its permissions"
        ) from error


def decode(data: bytes, path: Path) -> str:
    """Text of a UTF-8 file, with or without byte order mark.

    Parameters
    ----------
    data : bytes
    path : Path
        For the message.

    Returns
    -------
    str

    Raises
    ------
    InvalidInput
        The bytes are not UTF-8.
    """
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        raise InvalidInput(
            f"is not UTF-8: byte 0x{data[error.start]:02x}",
            where=f"{path}, line {line}",
            remedy="save the file as UTF-8",
        ) from error


def nearest(name: str, known: Iterable[str]) -> str:
    """A hint at the known name most like a mistyped one: `; did you mean '...'?`, or nothing.

    Parameters
    ----------
    name : str
    known : iterable of str

    Returns
    -------
    str
    """
    near = difflib.get_close_matches(name, list(known), n=1, cutoff=0.6)
    return f"; did you mean '{near[0]}'?" if near else ""
