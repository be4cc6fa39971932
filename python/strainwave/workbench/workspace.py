"""The served folder: its studies, and paths that cannot leave it."""

from __future__ import annotations

import os
import re
import tempfile
from collections.abc import AsyncIterator, Iterator
from dataclasses import dataclass
from pathlib import Path

from strainwave.errors import InvalidInput

_RUNS = "runs"

_MAX_DEPTH = 3  # of folders in which studies are searched
_MAX_STUDIES = 500  # listed
_MAX_STUDY_BYTES = 1 << 20
_STUDY = re.compile(rb"^\s*\[(arm|\[experiment\])\]", re.MULTILINE)
_NAME = re.compile(r"[^\W.][\w .()+=@,-]*", re.UNICODE)


@dataclass(frozen=True, slots=True)
class Workspace:
    """A folder with studies."""

    folder: Path  # resolved
    max_upload_bytes: int

    def studies(self) -> list[str]:
        """Paths of the study files, relative to the folder, sorted."""
        return sorted(str(p.relative_to(self.folder)) for p in self._study_files())

    def _study_files(self) -> Iterator[Path]:
        count = 0
        for root, folders, files in os.walk(self.folder):
            depth = len(Path(root).relative_to(self.folder).parts)
            is_last = depth >= _MAX_DEPTH
            folders[:] = [
                f for f in folders if not is_last and not is_runs_folder(f) and f[0] not in "._"
            ]
            for name in files:
                if name.endswith(".toml") and _is_study(Path(root) / name):
                    yield Path(root) / name
                    count += 1
                    if count == _MAX_STUDIES:
                        return

    def resolve(self, relative: str) -> Path:
        """The path of a file or folder inside the folder.

        Raises InvalidInput if the path leads outside, also by a symbolic link.
        """
        if "\0" in relative:
            raise InvalidInput("a path must not contain a null character", where="path")
        path = (self.folder / relative).resolve()
        if not path.is_relative_to(self.folder):
            raise InvalidInput(
                "leads out of the served folder",
                where=relative,
                remedy="copy the file into the folder",
            )
        return path

    def study(self, relative: str) -> Path:
        """The path of an existing study file; raises InvalidInput if there is none."""
        path = self.resolve(relative)
        if path.suffix != ".toml" or not path.is_file():
            raise InvalidInput("there is no such study", where=relative)
        return path

    def relative(self, path: Path) -> str:
        """The name of a path in addresses."""
        return path.relative_to(self.folder).as_posix()

    async def receive(self, folder: str, name: str, chunks: AsyncIterator[bytes]) -> Path:
        """Store an uploaded file whole or not at all, and return its path.

        Raises InvalidInput if the name is not that of a file, if the file exists already, or if it
        exceeds the limit.
        """
        check_name(name)
        target = self.resolve(folder) / name
        if target.exists():
            raise InvalidInput("exists already", where=name, remedy="rename the file")
        target.parent.mkdir(parents=True, exist_ok=True)
        handle, temporary = tempfile.mkstemp(prefix=".upload-", dir=target.parent)
        try:
            size = 0
            with os.fdopen(handle, "wb") as file:
                async for chunk in chunks:
                    size += len(chunk)
                    if size > self.max_upload_bytes:
                        limit = self.max_upload_bytes >> 20
                        raise InvalidInput(
                            f"has more than {limit} MiB",
                            where=name,
                            remedy="copy it into the folder, or raise --max-upload",
                        )
                    file.write(chunk)
            os.link(temporary, target)  # fails if another upload was faster
        except FileExistsError as error:
            raise InvalidInput("exists already", where=name, remedy="rename it") from error
        finally:
            os.unlink(temporary)
        return target


def _is_study(path: Path) -> bool:
    try:
        return path.stat().st_size < _MAX_STUDY_BYTES and bool(_STUDY.search(path.read_bytes()))
    except OSError:  # a broken link, or no permission
        return False


def runs_folder(study: Path) -> Path:
    """Folder of the runs of a study file: `runs`, or `runs-NAME` next to NAME.toml."""
    return study.parent / (_RUNS if study.stem == "study" else f"{_RUNS}-{study.stem}")


def is_runs_folder(name: str) -> bool:
    """Whether a folder has the runs of a study, by its name."""
    return name == _RUNS or name.startswith(f"{_RUNS}-")


def check_name(name: str) -> None:
    """Raise InvalidInput unless the text is a plain file or run name."""
    if not _NAME.fullmatch(name) or len(name) > 120:
        raise InvalidInput(
            f"{name!r} cannot be a name here",
            remedy="begin with a letter or digit, and use letters, digits, spaces and .,_-()+=@",
        )
