"""Invalid studies and logs, and how `identify` refuses them when many processes run at once."""

from __future__ import annotations

import gzip
import subprocess
import sys
import tempfile
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from strainwave.io.logs import write_log

STUDY = """\
[arm]
kind = "planar-two-link"
link_length = 0.35

[[joint]]
spring = "linear"
gear_ratio = 0.01
torque_per_volt = 0.08

[[joint]]
spring = "linear"
gear_ratio = 0.01
torque_per_volt = 0.03
"""
EXPERIMENT = (
    '[[experiment]]\nname = "{name}"\nfile = "{file}"\nuse = "motion"\ncontrol = {servos}\n'
)
RECORDS = 6
TIMEOUT = 120.0  # [s] of one run on a busy machine


@dataclass(frozen=True, slots=True)
class Refusal:
    """End of one run."""

    code: int
    lines: int  # on standard error
    has_output: bool  # files in the output folder
    message: str


def study_in(folder: Path, ending: str, samples: int) -> Path:
    """Write a study of several records in one file format; return the study file."""
    time = 1e-3 * np.arange(samples)
    text = STUDY
    for number in range(RECORDS):
        phase = 0.7 * number
        columns = {
            "t": time,
            "u1": np.sin(9.0 * time + phase),
            "u2": np.cos(7.0 * time + phase),
            "theta_m1": 10.0 * np.sin(3.0 * time + phase),
            "theta_m2": 10.0 * np.cos(4.0 * time + phase),
            "a1": np.cos(30.0 * time),
        }
        write_log(folder / f"log{number}{ending}", columns)
        text += EXPERIMENT.format(
            name=f"log{number}", file=f"log{number}{ending}", servos='["servo", "servo"]'
        )
    (folder / "study.toml").write_text(text)
    return folder / "study.toml"


# --- each fault changes a study's folder and returns further arguments of the command ------------


def _infinite(folder: Path) -> list[str]:
    _replace_value(folder / "log0.csv", b"inf")
    return []


def _text(folder: Path) -> list[str]:
    _replace_value(folder / "log0.csv", b"broken")
    return []


def _no_column(folder: Path) -> list[str]:
    path = folder / "log1.csv"
    path.write_bytes(path.read_bytes().replace(b"theta_m2", b"theta_x2", 1))
    return []


def _no_file(folder: Path) -> list[str]:
    (folder / "log2.csv").unlink()
    return []


def _cut_off(folder: Path) -> list[str]:
    path = folder / "log3.csv"
    path.write_bytes(path.read_bytes()[:-30])
    return []


def _empty(folder: Path) -> list[str]:
    (folder / "log4.csv").write_bytes(b"")
    return []


def _bad_key(folder: Path) -> list[str]:
    path = folder / "study.toml"
    path.write_text(path.read_text().replace("spring", "sprung", 1))
    return []


def _bad_option(_: Path) -> list[str]:
    return ["--stages", "frobnicate"]


def _damaged_middle(folder: Path) -> list[str]:
    path = next(folder.glob("log0.*"))
    data = bytearray(path.read_bytes())
    # 1e301 as float64; erased bytes (0xff) would be NaN, which counts as a missing value
    data[len(data) // 2 : len(data) // 2 + 200] = b"\x7e" * 200
    path.write_bytes(data)
    return []


def _damaged_end(folder: Path) -> list[str]:
    path = next(folder.glob("log0.*"))
    path.write_bytes(path.read_bytes()[:-100])
    return []


def _infinite_packed(folder: Path) -> list[str]:
    path = folder / "log0.csv.gz"
    data = gzip.decompress(path.read_bytes())
    path.write_bytes(gzip.compress(_with_value(data, b"inf")))
    return []


def _infinite_parquet(folder: Path) -> list[str]:
    import pyarrow.parquet

    table = pyarrow.parquet.read_table(folder / "log0.parquet")
    columns = {name: table[name].to_numpy().copy() for name in table.column_names}
    columns["u1"][len(columns["u1"]) // 2] = np.inf
    write_log(folder / "log0.parquet", columns)
    return []


def _replace_value(path: Path, text: bytes) -> None:
    path.write_bytes(_with_value(path.read_bytes(), text))


def _with_value(data: bytes, text: bytes) -> bytes:
    lines = data.split(b"\n")
    fields = lines[len(lines) // 2].split(b",")
    fields[1] = text
    lines[len(lines) // 2] = b",".join(fields)
    return b"\n".join(lines)


KINDS: dict[str, tuple[str, Callable[[Path], list[str]]]] = {
    "an infinite value in a CSV log": (".csv", _infinite),
    "text in a CSV log": (".csv", _text),
    "a missing column": (".csv", _no_column),
    "a missing log": (".csv", _no_file),
    "a CSV log cut off": (".csv", _cut_off),
    "an empty log": (".csv", _empty),
    "an unknown key": (".csv", _bad_key),
    "an unknown stage": (".csv", _bad_option),
    "an infinite value in a gzip log": (".csv.gz", _infinite_packed),
    "a damaged gzip log": (".csv.gz", _damaged_middle),
    "a gzip log cut off": (".csv.gz", _damaged_end),
    "an infinite value in a Parquet log": (".parquet", _infinite_parquet),
    "a damaged Parquet log": (".parquet", _damaged_middle),
    "a Parquet log cut off": (".parquet", _damaged_end),
}


def run(study: Path, arguments: list[str], number: int) -> Refusal:
    """Run `identify` once."""
    out = study.parent / f"out{number}"
    command = [sys.executable, "-m", "strainwave", "identify", str(study), "--out", str(out)]
    done = subprocess.run(
        [*command, *arguments], capture_output=True, text=True, check=False, timeout=TIMEOUT
    )
    return Refusal(done.returncode, done.stderr.count("\n"), out.exists(), done.stderr.strip())


def runs_of(kind: str, runs: int, at_once: int, samples: int) -> list[Refusal]:
    """Run `identify` several times at once on a study with one fault."""
    ending, damage = KINDS[kind]
    with tempfile.TemporaryDirectory() as name, ThreadPoolExecutor(at_once) as pool:
        study = study_in(Path(name), ending, samples)
        arguments = damage(study.parent)
        return list(pool.map(lambda number: run(study, arguments, number), range(runs)))
