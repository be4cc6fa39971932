"""Mutated studies through all of `identify`: `python -m benchmarks.studies.mutated --out DIR`.

A virtual arm's study and logs are copied many times, and each copy has one thing changed by
chance: bytes, rows, columns, keys, units. A campaign identifies them all, so what the command makes
of each is recorded: nothing may end by a traceback (1), a crash or a hang, and whatever is refused
(2) is refused in one line. The same command goes on where it was stopped.
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
from rich.console import Console
from rich.table import Table

from benchmarks.studies import arms
from strainwave import campaign
from strainwave.campaign.store import read_runs
from strainwave.io.atomic_files import write_whole
from strainwave.virtual.experiments import simulate_study

_KINDS = {0: "determined", 2: "refused in one line", 3: "not all determined"}
_LONGEST = 120.0  # [s] of one study
_NUMBER = re.compile(r"(?<![\w.])-?\d+\.?\d*(?:e-?\d+)?(?![\w.])")
_UNITS = (1e3, 1e-3, 180.0 / np.pi, np.pi / 180.0, 2.0 * np.pi, 60.0, 9.81, -1.0, 0.0, 1e9)

Random = np.random.Generator


def main() -> None:
    """Make the studies, identify them and print how they ended."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=0, help="another changes all anew")
    parser.add_argument("--stages", help="only the first stages, for example: rigid")
    parser.add_argument("--workers", type=int)
    parser.add_argument("--out", type=Path, required=True, help="folder of studies and store")
    chosen = parser.parse_args()
    folder: Path = chosen.out
    studies = made(folder / "studies", chosen.runs, chosen.seed)
    settings = campaign.Settings(
        store=str(folder / "store"),
        stages=chosen.stages.split(",") if chosen.stages else None,
        workers=chosen.workers,
        limits=campaign.Limits(time_s=_LONGEST),
        display=sys.stderr.isatty(),
    )
    campaign.run([str(path) for path in studies], settings)
    runs = read_runs(str(folder / "store")).select(["study", "exit_code", "message"]).to_pylist()
    Console().print(counted(runs))
    bad = [run for run in runs if not well_ended(run)]
    for run in bad:
        print(f"{run['study']}: {run['exit_code']}: {run['message']}")
    raise SystemExit(1 if bad else 0)


def well_ended(run: dict[str, object]) -> bool:
    """Whether a run ended by an answer or by a refusal of one line."""
    return run["exit_code"] in _KINDS and "\n" not in str(run["message"] or "")


def counted(runs: Sequence[dict[str, object]]) -> Table:
    """How often each change ended how."""
    table = Table(box=None)
    table.add_column("changed")
    columns = [*_KINDS.values(), "a bug, a crash or a hang"]
    for column in columns:
        table.add_column(column, justify="right")
    count: Counter[tuple[str, str]] = Counter()
    for run in runs:
        changed = Path(str(run["study"])).parent.name.partition("-")[2]
        ended = _KINDS[int(str(run["exit_code"]))] if well_ended(run) else columns[-1]
        count[changed, ended] += 1
        count["all", ended] += 1
    for changed in [*sorted({name for name, _ in count} - {"all"}), "all"]:
        table.add_row(changed, *(str(count[changed, column]) for column in columns))
    return table


def made(folder: Path, runs: int, seed: int) -> list[Path]:
    """Study files with one thing changed each, made where they are not there yet."""
    base = folder / "base"
    if not (base / "study.toml").exists():
        _simulate(base)
    found = []
    for number in range(runs):
        rng = np.random.default_rng([seed, number])
        name = list(_CHANGES)[number % len(_CHANGES)]
        own = folder / f"{seed}.{number}-{name}"
        if not (own / "study.toml").exists():
            _change(base, own, name, rng)
        found.append(own / "study.toml")
    return found


def _simulate(base: Path) -> None:
    rig = arms.rig(0)
    study = replace(
        rig.study,
        experiments=tuple(
            replace(each, file=f"{each.name}.csv", prbs=each.prbs and replace(each.prbs, order=9))
            for each in rig.study.experiments
        ),
    )
    simulate_study(
        study, rig.values, base, seed=0, noise=rig.noise, as_recorded=False, sample_time=1e-3
    )


def _change(base: Path, own: Path, name: str, rng: Random) -> None:
    """A copy of a study's folder; what is not changed is the same file. The study comes last."""
    kind, change = _CHANGES[name]
    files = sorted(path for path in base.iterdir() if path.suffix in (".csv", ".toml"))
    chosen = files[int(rng.integers(len(files)))]
    if kind == "study":
        chosen = base / "study.toml"
    elif kind == "log":
        logs = [path for path in files if path.suffix == ".csv"]
        chosen = logs[int(rng.integers(len(logs)))]
    own.mkdir(parents=True, exist_ok=True)
    for path in files:
        if path != chosen and path.name != "study.toml":
            (own / path.name).unlink(missing_ok=True)
            os.link(path, own / path.name)
    changed = {chosen.name: change(chosen.read_bytes(), rng)}
    write_whole(own, {"study.toml": (base / "study.toml").read_bytes()} | changed)


def _bytes(data: bytes, rng: Random) -> bytes:
    """A few stretches are cut out, doubled or overwritten."""
    for _ in range(int(rng.integers(1, 4))):
        at, length = int(rng.integers(len(data) + 1)), int(rng.integers(40))
        new = (b"", data[at : at + length] * 2, rng.bytes(length))[int(rng.integers(3))]
        data = data[:at] + new + data[at + length :]
    return data


def _cut(data: bytes, rng: Random) -> bytes:
    return data[: int(rng.integers(len(data)))]


def _number(data: bytes, rng: Random) -> bytes:
    """One number in another unit, of another sign, or absurd."""
    text = data.decode()
    found = list(_NUMBER.finditer(text))
    one = found[int(rng.integers(len(found)))]
    value = float(one[0]) * float(rng.choice(_UNITS))
    return f"{text[: one.start()]}{value!r}{text[one.end() :]}".encode()


def _lines(data: bytes, rng: Random) -> bytes:
    """A line is missing, doubled or elsewhere."""
    lines = data.splitlines(keepends=True)
    one = lines.pop(int(rng.integers(len(lines))))
    for _ in range(int(rng.integers(3))):
        lines.insert(int(rng.integers(len(lines) + 1)), one)
    return b"".join(lines)


def _key(data: bytes, rng: Random) -> bytes:
    """A key is written wrongly."""
    lines = data.decode().splitlines()
    places = [k for k, line in enumerate(lines) if "=" in line]
    k = places[int(rng.integers(len(places)))]
    key, _, value = lines[k].partition("=")
    at = int(rng.integers(len(key.strip()) + 1))
    lines[k] = f"{key.strip()[:at]}x{key.strip()[at:]} = {value}"
    return "\n".join(lines).encode()


def _column(data: bytes, rng: Random) -> bytes:
    """A channel is scaled, swapped with another, missing or constant."""
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
    """Rows are missing, doubled, in disorder, or not numbers."""
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
