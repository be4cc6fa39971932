"""Commands on consoles that cannot encode every letter, and processes that are spawned."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from campaign_rigs import STUDY, inertia_of, rig, rigs

LETTERS = "Bewegung-\u0394\u03b8\u0308\u2192\u6a5f"  # of no eight-bit code


@pytest.fixture(scope="module")
def study(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp(LETTERS)
    path = rig(folder)
    path.write_text(STUDY.replace('"motion"\nfile', f'"{LETTERS}"\nfile', 1), encoding="utf-8")
    return path


def run(encoding: str, *arguments: str | Path) -> subprocess.CompletedProcess[bytes]:
    return subprocess.run(
        [sys.executable, "-m", "strainwave", *map(str, arguments)],
        env=os.environ | {"PYTHONIOENCODING": encoding},
        capture_output=True,
        check=False,
    )


@pytest.mark.parametrize(
    ("encoding", "arguments"),
    [
        ("ascii", ("--help",)),
        ("cp1252", ("identify", "--help")),
        ("ascii", ("check", "STUDY")),
        ("ascii", ("identify", "STUDY", "--stages", "rigid", "--out", "OUT")),
        ("cp1252", ("identify", "STUDY", "--stages", "rigid", "--out", "OUT")),
        ("cp1252", ("campaign", "STUDY", "--stages", "rigid", "--out", "OUT")),
    ],
)
def test_output_is_encoded(
    study: Path, tmp_path: Path, encoding: str, arguments: tuple[str, ...]
) -> None:
    places = {"STUDY": study, "OUT": tmp_path / LETTERS}
    done = run(encoding, *(places.get(each, each) for each in arguments))
    assert (done.returncode, done.stderr) == (0, b"")
    assert done.stdout.decode(encoding)
    if "OUT" in arguments and arguments[0] == "identify":
        assert b"Bewegung-??" in done.stdout
        assert (tmp_path / LETTERS / "result.json").is_file()


def test_a_document_on_standard_output_is_utf_8(study: Path) -> None:
    done = run("cp1252", "check", study, "--json")
    assert (done.returncode, done.stderr) == (0, b"")
    assert json.loads(done.stdout.decode())["status"] == "consistent"
    assert LETTERS in done.stdout.decode()


SPAWNED = """
import multiprocessing, sys
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path
import strainwave as sw
from strainwave.fleet.campaign import Settings, run

if __name__ == "__main__":
    multiprocessing.set_start_method("spawn")
    studies = sorted(Path(sys.argv[1]).glob("*/study.toml"))
    with ProcessPoolExecutor(1) as pool:
        for result in pool.map(partial(sw.identify, stages=("rigid",)), studies):
            print(result["inertia", 1].value)
    settings = Settings(store=sys.argv[2], stages=("rigid",), workers=1)
    print(run([sys.argv[1]], settings).exit_code)
"""


def test_studies_are_identified_in_spawned_processes(tmp_path: Path) -> None:
    script = tmp_path / "script.py"
    script.write_text(SPAWNED)
    rigs(tmp_path / "rigs", 2)
    done = subprocess.run(
        [sys.executable, script, tmp_path / "rigs", tmp_path / "store"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    *values, exit_code = map(float, done.stdout.split())
    assert values == pytest.approx([inertia_of(0), inertia_of(1)], rel=0.01)
    assert exit_code == 0
