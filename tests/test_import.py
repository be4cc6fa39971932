"""Importing is cheap."""

from __future__ import annotations

import json
import subprocess
import sys

HEAVY = [
    *("numpy", "scipy", "pyarrow", "pydantic", "plotly", "jinja2", "rich", "h5py", "rosbags"),
    "distributed",
]


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
