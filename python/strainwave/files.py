"""Files that appear whole or not at all."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Mapping
from pathlib import Path

from strainwave.errors import InvalidInput


def write_whole(folder: Path, contents: Mapping[str, bytes]) -> None:
    """Write several files into a folder: all are written aside first, then renamed.

    A reader sees the old file or the new one, never half of one.

    Parameters
    ----------
    folder : Path
        Made where it does not exist.
    contents : mapping of file name to bytes

    Raises
    ------
    InvalidInput
        The folder cannot be made or written to.
    """
    aside: list[tuple[Path, Path]] = []
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for name, data in contents.items():
            handle, temporary = tempfile.mkstemp(prefix=f".{name}.", dir=folder)
            aside.append((Path(temporary), folder / name))
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
