"""Random changes of a study: `python -m benchmarks.studies.mutated --out DIR`.

Each copy of a virtual arm's study and logs has one random change: bytes, rows, columns, keys,
units. A campaign identifies all copies. None may end with a traceback (exit code 1), a crash or a
hang, and each refusal (2) must be one line. A repeated command continues where it stopped.
"""

from __future__ import annotations

import argparse
import os
import re
import sys
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from rich.table import Table

from benchmarks.console import Console
from benchmarks.studies import arms
from strainwave.fleet import campaign
from strainwave.fleet.campaign.store import read_runs
from strainwave.io.atomic_files import write_whole
from strainwave.virtual.experiments import simulate_study

_ENDS = {0: "determined", 2: "refused in one line", 3: "not all determined"}
_TIME_LIMIT = 120.0  # [s] of one study
_NUMBER = re.compile(r"(?<![\w.])-?\d+\.?\d*(?:e-?\d+)?(?![\w.])")
_UNITS = (1e3, 1e-3, 180.0 / np.pi, np.pi / 180.0, 2.0 * np.pi, 60.0, 9.81, -1.0, 0.0, 1e9)

Random = np.random.Generator


def main() -> None:
    """Write the studies, identify them and print how they end."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=0, help="another seed makes other changes")
    parser.add_argument("--stages", help="only the first stages, for example: rigid")
    parser.add_argument("--workers", type=int)
    parser.add_argument("--out", type=Path, required=True, help="folder of studies and store")
    options = parser.parse_args()
    folder: Path = options.out
    studies = write_studies(folder / "studies", options.runs, options.seed)
    settings = campaign.Settings(
        store=str(folder / "store"),
        stages=options.stages.split(",") if options.stages else None,
        workers=options.workers,
        limits=campaign.RunLimits(time_s=_TIME_LIMIT),
        display=sys.stderr.isatty(),
    )
    campaign.run([str(path) for path in studies], settings)
    runs = read_runs(str(folder / "store")).select(["study", "exit_code", "message"]).to_pylist()
    Console().print(summary(runs))
    bad = [run for run in runs if not ends_well(run)]
    for run in bad:
        print(f"{run['study']}: {run['exit_code']}: {run['message']}")
    raise SystemExit(1 if bad else 0)


def ends_well(run: dict[str, object]) -> bool:
    """Whether a run ends with a result or a refusal of one line."""
    return run["exit_code"] in _ENDS and "\n" not in str(run["message"] or "")


def summary(runs: Sequence[dict[str, object]]) -> Table:
    """Number of runs by kind of change and end."""
    table = Table(box=None)
    table.add_column("change")
    columns = [*_ENDS.values(), "traceback, crash or hang"]
    for column in columns:
        table.add_column(column, justify="right")
    count: Counter[tuple[str, str]] = Counter()
    for run in runs:
        change = Path(str(run["study"])).parent.name.partition("-")[2]
        end = _ENDS[int(str(run["exit_code"]))] if ends_well(run) else columns[-1]
        count[change, end] += 1
        count["all", end] += 1
    for change in [*sorted({name for name, _ in count} - {"all"}), "all"]:
        table.add_row(change, *(str(count[change, column]) for column in columns))
    return table


def write_studies(folder: Path, runs: int, seed: int) -> list[Path]:
    """Write study files with one change each, unless they exist."""
    base = folder / "base"
    if not (base / "study.toml").exists():
        _simulate(base)
    studies = []
    for number in range(runs):
        rng = np.random.default_rng([seed, number])
        name = list(_CHANGES)[number % len(_CHANGES)]
        copy = folder / f"{seed}.{number}-{name}"
        if not (copy / "study.toml").exists():
            _change(base, copy, name, rng)
        studies.append(copy / "study.toml")
    return studies


def _simulate(base: Path) -> None:
    rig = arms.draw_rig(0)
    study = replace(
        rig.study,
        experiments=tuple(
            replace(e, file=f"{e.name}.csv", prbs=e.prbs and replace(e.prbs, order=9))
            for e in rig.study.experiments
        ),
    )
    simulate_study(
        study, rig.values, base, seed=0, noise=rig.noise, as_recorded=False, sample_time=1e-3
    )


def _change(base: Path, copy: Path, name: str, rng: Random) -> None:
    """Copy a study's folder with one change; unchanged files are links. The study comes last."""
    kind, change = _CHANGES[name]
    files = sorted(path for path in base.iterdir() if path.suffix in (".csv", ".toml"))
    changed = files[int(rng.integers(len(files)))]
    if kind == "study":
        changed = base / "study.toml"
    elif kind == "log":
        logs = [path for path in files if path.suffix == ".csv"]
        changed = logs[int(rng.integers(len(logs)))]
    copy.mkdir(parents=True, exist_ok=True)
    for path in files:
        if path != changed and path.name != "study.toml":
            (copy / path.name).unlink(missing_ok=True)
            os.link(path, copy / path.name)
    contents = {changed.name: change(changed.read_bytes(), rng)}
    write_whole(copy, {"study.toml": (base / "study.toml").read_bytes()} | contents)


def _bytes(data: bytes, rng: Random) -> bytes:
    """Cut out, double or overwrite up to three intervals."""
    for _ in range(int(rng.integers(1, 4))):
        at, length = int(rng.integers(len(data) + 1)), int(rng.integers(40))
        new = (b"", data[at : at + length] * 2, rng.bytes(length))[int(rng.integers(3))]
        data = data[:at] + new + data[at + length :]
    return data


def _cut(data: bytes, rng: Random) -> bytes:
    return data[: int(rng.integers(len(data)))]


def _number(data: bytes, rng: Random) -> bytes:
    """Change one number by a factor of units, its sign, or an absurd factor."""
    text = data.decode()
    numbers = list(_NUMBER.finditer(text))
    number = numbers[int(rng.integers(len(numbers)))]
    value = float(number[0]) * float(rng.choice(_UNITS))
    return f"{text[: number.start()]}{value!r}{text[number.end() :]}".encode()


def _lines(data: bytes, rng: Random) -> bytes:
    """Remove, double or move a line."""
    lines = data.splitlines(keepends=True)
    line = lines.pop(int(rng.integers(len(lines))))
    for _ in range(int(rng.integers(3))):
        lines.insert(int(rng.integers(len(lines) + 1)), line)
    return b"".join(lines)


def _key(data: bytes, rng: Random) -> bytes:
    """Misspell a key."""
    lines = data.decode().splitlines()
    places = [k for k, line in enumerate(lines) if "=" in line]
    k = places[int(rng.integers(len(places)))]
    key, _, value = lines[k].partition("=")
    at = int(rng.integers(len(key.strip()) + 1))
    lines[k] = f"{key.strip()[:at]}x{key.strip()[at:]} = {value}"
    return "\n".join(lines).encode()


def _column(data: bytes, rng: Random) -> bytes:
    """Scale a channel, swap it with another, remove it or make it constant."""
    head, rows = _table(data)
    k, other = (int(rng.integers(len(head))) for _ in range(2))
    match int(rng.integers(4)):
        case 0:
            rows[:, k] *= float(rng.choice(_UNITS))
        case 1:
            rows[:, [k, other]] = rows[:, [other, k]]
        case 2:
            head, rows = [*head[:k], *head[k + 1 :]], np.delete(rows, k, axis=1)
        case _:
            rows[:, k] = rows[0, k]
    return _text(head, rows)


def _rows(data: bytes, rng: Random) -> bytes:
    """Remove, double or permute rows, or replace their numbers."""
    head, rows = _table(data)
    start = int(rng.integers(len(rows)))
    stop = start + int(rng.integers(1, len(rows)))
    match int(rng.integers(4)):
        case 0:
            rows = np.delete(rows, slice(start, stop), axis=0)
        case 1:
            rows = np.concatenate([rows[:stop], rows[start:]])
        case 2:
            rows[start:stop] = rng.permutation(rows[start:stop])
        case _:
            rows[start:stop, int(rng.integers(len(head)))] = float(
                rng.choice([np.nan, np.inf, 1e300])
            )
    return _text(head, rows)


def _table(data: bytes) -> tuple[list[str], np.ndarray]:
    first, _, rest = data.decode().partition("\n")
    return first.split(","), np.loadtxt(rest.splitlines(), delimiter=",", ndmin=2)


def _text(head: Sequence[str], rows: np.ndarray) -> bytes:
    lines = (",".join(map(repr, row)) for row in rows.tolist())
    return "\n".join([",".join(head), *lines, ""]).encode()


_CHANGES: dict[str, tuple[str, Callable[[bytes, Random], bytes]]] = {
    "bytes-of-study": ("study", _bytes),
    "bytes-of-log": ("log", _bytes),
    "cut-short": ("any", _cut),
    "number-of-study": ("study", _number),
    "lines-of-study": ("study", _lines),
    "key-of-study": ("study", _key),
    "lines-of-log": ("log", _lines),
    "column-of-log": ("log", _column),
    "rows-of-log": ("log", _rows),
}

if __name__ == "__main__":
    main()
