"""Files are written completely or not at all."""

from __future__ import annotations

from pathlib import Path

import pytest

from strainwave.errors import InvalidInput
from strainwave.io.atomic_files import write_whole


def test_all_files_are_written_without_temporary_files(tmp_path: Path) -> None:
    write_whole(tmp_path / "a" / "b", {"x": b"1", "y": b"2"})
    assert {p.name: p.read_bytes() for p in (tmp_path / "a" / "b").iterdir()} == {
        "x": b"1",
        "y": b"2",
    }


def test_a_failed_write_keeps_the_old_files(tmp_path: Path) -> None:
    (tmp_path / "x").write_bytes(b"old")
    (tmp_path / "y").mkdir()  # a directory cannot be replaced by a file
    with pytest.raises(InvalidInput, match="cannot write there"):
        write_whole(tmp_path, {"y": b"new", "x": b"new"})
    assert (tmp_path / "x").read_bytes() == b"old"
    assert sorted(p.name for p in tmp_path.iterdir()) == ["x", "y"]


def test_a_file_with_the_name_of_the_folder_is_refused(tmp_path: Path) -> None:
    (tmp_path / "out").write_bytes(b"")
    with pytest.raises(InvalidInput, match="--out"):
        write_whole(tmp_path / "out", {"x": b""})
