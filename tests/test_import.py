"""Importing is cheap, and all files state the same version."""

from __future__ import annotations

import json
import subprocess
import sys
import tomllib
from pathlib import Path

import strainwave

ROOT = Path(__file__).resolve().parents[1]

HEAVY = ["numpy", "scipy", "pyarrow", "pydantic", "plotly", "jinja2", "rich", "h5py", "rosbags"]


def modules_after(statement: str) -> set[str]:
    code = f"{statement}; import json, sys; print(json.dumps(sorted(sys.modules)))"
    process = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    )
    return set(json.loads(process.stdout))


def test_the_package_imports_nothing_heavy() -> None:
    assert not modules_after("import strainwave") & set(HEAVY)


def test_the_stages_import_nothing_heavy_but_numpy() -> None:
    loaded = modules_after("import strainwave.pipeline, strainwave.cli")
    assert loaded & set(HEAVY) <= {"numpy", "rich"}  # rich comes with typer


def test_one_version_everywhere() -> None:
    cargo = tomllib.loads((ROOT / "Cargo.toml").read_text())
    assert cargo["workspace"]["package"]["version"] == strainwave.__version__
    citation = (ROOT / "CITATION.cff").read_text()
    assert f'version: "{strainwave.__version__}"' in citation or (
        f"version: {strainwave.__version__}" in citation
    )
