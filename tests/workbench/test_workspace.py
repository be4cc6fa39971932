"""Names of files and addresses of pages, as on any operating system."""

from __future__ import annotations

import os
import tomllib
from collections.abc import Iterator
from pathlib import Path, PureWindowsPath
from typing import Any

import pytest

from strainwave.workbench import workspace
from strainwave.workbench.pages.estimate import snapshot
from strainwave.workbench.workspace import Workspace


def test_addresses_of_studies_on_windows(monkeypatch: pytest.MonkeyPatch) -> None:
    folder: Any = PureWindowsPath(r"C:\rigs")

    def walk(_: Any) -> Iterator[tuple[str, list[str], list[str]]]:
        yield r"C:\rigs\arm", [], ["study.toml"]

    monkeypatch.setattr(workspace, "Path", PureWindowsPath)
    monkeypatch.setattr(workspace, "_is_study", lambda _: True)
    monkeypatch.setattr(os, "walk", walk)
    assert Workspace(folder, 1).studies() == ["arm/study.toml"]


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("logs/a.csv", "../../logs/a.csv"),
        (r"logs\a.csv", r"../../logs\a.csv"),
        (r"C:\logs\a.csv", r"C:\logs\a.csv"),
        (r"\logs\a.csv", r"\logs\a.csv"),
    ],
)
def test_the_copy_of_a_study_names_the_same_logs_on_windows(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, expected: str
) -> None:
    path = tmp_path / "study.toml"
    path.write_text(f"[[experiment]]\nfile = '{name}'\n")
    monkeypatch.setattr("strainwave.workbench.pages.estimate.Path", PureWindowsPath)
    assert tomllib.loads(snapshot(path))["experiment"][0]["file"] == expected
