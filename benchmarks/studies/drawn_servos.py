"""Intervals on drawn servos without torque: `python -m benchmarks.studies.drawn_servos`.

Each of `--servos` rigs of `benchmarks.families.servos` is simulated in MuJoCo, written as a study
folder, and identified by the command line. Printed are, per parameter and per class of rig, the
share of 95 % intervals that contain the true value, and errors over standard deviations; values
that are wrong in silence (identified, beyond `_MAX_STDS` standard deviations); and absolute values
of studies without a scale. `--halves` rigs are identified from each half of their records as well.
Delays that give the servo the same goals at all of its ticks count as equal.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from rich.table import Table

from benchmarks.console import Console, share_of
from benchmarks.families.servos import ServoRig, draw_servo, true_values, write_rig
from benchmarks.studies.arms import run_all
from strainwave.domain.keys import Values, label_of

_MAX_STDS = 4.0
_CLASSES = ("flavour", "output", "gear", "joints", "motion", "goal")
_TIMEOUT = 900.0  # [s] of a run
_SCALED = re.compile("N m|kg")  # units of values that need a scale
_MIN_OWN_VARIANCE = 1e-4  # of the variance, if all of it is of the model


def evaluate(seed: int, kept: Path | None, n_halves: int) -> dict[str, Any]:
    """Draw, simulate, identify and judge one rig; a failure is returned as a result."""
    rig = draw_servo(seed)
    head: dict[str, Any] = {"seed": seed, **rig.classes}
    with TemporaryDirectory() as temporary:
        folder = Path(temporary) if kept is None else kept / str(seed)
        folder.mkdir(parents=True, exist_ok=True)
        if not (folder / "truth.json").exists():
            write_rig(rig, folder)
        begin = time.perf_counter()
        result, message = identify(folder / "study.toml")
        head["seconds"] = time.perf_counter() - begin
        if result is None:
            return head | {"failure": message}
        if seed < n_halves and rig.motion == "rich":
            head["halves"] = compare_halves(folder)
    return head | judge(rig, result)


def identify(study: Path) -> tuple[dict[str, Any] | None, str]:
    """Result of a study, or None and the last line of the message."""
    out = study.with_suffix("")
    command = (sys.executable, "-m", "strainwave", "identify", str(study), "--out", str(out))
    try:
        run = subprocess.run(command, capture_output=True, text=True, timeout=_TIMEOUT, check=False)
    except subprocess.TimeoutExpired:
        return None, f"no result in {_TIMEOUT:.0f} s"
    file = out / "result.json"
    if run.returncode in (0, 3) and file.exists():
        return json.loads(file.read_text()), ""
    return None, f"exit {run.returncode}: {(run.stderr.strip().splitlines() or [''])[-1][:300]}"


def judge(rig: ServoRig, result: dict[str, Any]) -> dict[str, Any]:
    """Errors of all values with an interval, and values that need a scale which is not given."""
    has_scale = rig.states_scale or rig.flavour == "loaded"
    identified = set(result["verdict"]["identified"])
    rows, unscaled = [], []
    for p in result["parameters"]:
        label = label_of(p["name"], p["joint"])
        if p["value"] is None:
            continue
        if not has_scale and p.get("per") is None and _SCALED.search(p["unit"]):
            unscaled.append(label)
        true = _true_value(rig, true_values(rig), p)
        if true is None or not p["std"] or p["ci95"] is None:
            continue
        low, high = p["ci95"]
        rows.append(
            {
                "name": p["name"],
                "joint": p["joint"],
                "per": p.get("per"),
                "error": (p["value"] - true) / p["std"],
                "half_width": 0.5 * (high - low) / (abs(true) or 1.0),
                "inside": bool(low <= true <= high),
                "identified": bool({label, f"{p['name']} {p['joint']}"} & identified),
            }
        )
    return {
        "status": result["status"],
        "parameters": rows,
        "unscaled": unscaled,
        "null": [
            label_of(p["name"], p["joint"]) for p in result["parameters"] if p["value"] is None
        ],
        "warnings": sorted({w["code"] for w in result["warnings"]}),
    }


def _true_value(rig: ServoRig, values: Values, p: dict[str, Any]) -> float | None:
    """True value of a parameter, per gain where it is; the nearest of equal delays."""
    name, joint = p["name"], p["joint"]
    if name == "servo_delay":
        low, high = rig.equal_delays
        return float(np.clip(p["value"], low, high))
    true = values.get((name, joint))
    if true is None or p.get("per") is None:
        return true
    return true / rig.drives[(joint or 1) - 1].kp


def compare_halves(folder: Path) -> list[float]:
    """|z| of the values that both halves of the records have."""
    text = (folder / "study.toml").read_text()
    halves = []
    for second in (False, True):
        path = folder / f"half-{int(second)}.toml"
        path.write_text(_half(text, folder, second=second))
        halves.append(identify(path)[0])
    if any(half is None for half in halves):
        return []
    first, other = (
        {(p["name"], p["joint"]): p for p in half["parameters"]} for half in halves if half
    )
    pairs = [(first[key], other[key]) for key in first.keys() & other.keys()]
    return [
        abs(a["value"] - b["value"]) / (_own_variance(a) + _own_variance(b)) ** 0.5
        for a, b in pairs
        if a["value"] is not None and b["value"] is not None and a["std"] and b["std"]
        if a.get("per") == b.get("per")
    ]


def _own_variance(p: dict[str, Any]) -> float:
    """Variance without what the halves have in common."""
    variance: float = p["std"] ** 2
    return max(variance - (p.get("model_std") or 0.0) ** 2, _MIN_OWN_VARIANCE * variance)


def _half(text: str, folder: Path, *, second: bool) -> str:
    """Study whose fitted records end, or begin, in their middles."""

    def windowed(match: re.Match[str]) -> str:
        end = float((folder / match[1]).read_text().splitlines()[-1].partition(",")[0])
        return match[0] + (f"\nstart = {end / 2}" if second else f"\nstop = {end / 2}")

    fitted = r'file = "([^"]+)"(?=\nuse = "motion")'
    return re.sub(fitted, windowed, text)


def silently_wrong(row: dict[str, Any]) -> list[str]:
    """Identified values of a run that are beyond `_MAX_STDS`; none if the input is inconsistent."""
    if row.get("status") == "inconsistent-input":
        return []
    return [
        f"{label_of(p['name'], p['joint'])} {p['error']:+.1f} std"
        for p in row.get("parameters", [])
        if p["identified"] and abs(p["error"]) > _MAX_STDS
    ]


def tabulate(rows: Sequence[dict[str, Any]]) -> list[Table]:
    """Tables of rigs, parameters, classes and halves."""
    heads = ("servo", *_CLASSES, "status", "inside", "wrong")
    rigs = Table(*heads, "without scale", "time", box=None)
    for row in sorted(rows, key=lambda row: int(row["seed"])):
        inside = [p["inside"] for p in row.get("parameters", [])]
        rigs.add_row(
            str(row["seed"]),
            *(row[head] for head in _CLASSES),
            row.get("status") or row["failure"][:70],
            f"{sum(inside)}/{len(inside)}",
            "; ".join(silently_wrong(row)),
            ", ".join(row.get("unscaled", [])),
            f"{row.get('seconds', 0.0):.0f} s",
        )
    all_values = [p for row in rows for p in row.get("parameters", [])]
    parameters = Table(
        "parameter", "values", "inside", "rms error/std", "largest", "half-width", box=None
    )
    for name in sorted({p["name"] for p in all_values}):
        _add(parameters, name, [p for p in all_values if p["name"] == name])
    _add(parameters, "all", all_values)
    classes = Table("class", "servos", "verdicts", "inside", "rms", "wrong", "no scale", box=None)
    groups = {"all": list(rows)}
    for head in _CLASSES:
        for value in sorted({row[head] for row in rows}):
            groups[f"{head} {value}"] = [row for row in rows if row[head] == value]
    for name, group in groups.items():
        values = [p for row in group for p in row.get("parameters", [])]
        verdicts = Counter(row.get("status", "no result") for row in group)
        classes.add_row(
            name,
            str(len(group)),
            ", ".join(f"{n} {verdict}" for verdict, n in sorted(verdicts.items())),
            share_of([p["inside"] for p in values]),
            _rms([p["error"] for p in values]),
            str(sum(map(len, map(silently_wrong, group)))),
            str(sum(len(row.get("unscaled", [])) for row in group)),
        )
    halves = Table("halves of records", "pairs", "median |z|", box=None)
    z = [each for row in rows for each in row.get("halves", [])]
    if z:
        n = sum("halves" in row for row in rows)
        halves.add_row(f"{n} servos", str(len(z)), f"{np.median(z):.2f}")
    return [rigs, parameters, classes, halves]


def _add(table: Table, name: str, values: Sequence[dict[str, Any]]) -> None:
    if values:
        errors = [p["error"] for p in values]
        width = 100.0 * float(np.median([p["half_width"] for p in values]))
        cells = (_rms(errors), f"{np.abs(errors).max():.1f}", f"{width:.2g} %")
        table.add_row(name, str(len(values)), share_of([p["inside"] for p in values]), *cells)


def _rms(errors: Sequence[float]) -> str:
    return f"{np.sqrt(np.mean(np.square(errors))):.2f}" if errors else ""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--servos", type=int, default=200)
    parser.add_argument("--first", type=int, default=0, help="the first servo's number")
    parser.add_argument("--halves", type=int, default=0, help="servos below this number")
    parser.add_argument("--kept", type=Path, help="folder of the studies; left out: not kept")
    parser.add_argument("--at-once", type=int, default=os.cpu_count())
    parser.add_argument("--out", type=Path, default=Path("build/drawn-servos.jsonl"))
    options = parser.parse_args()
    options.out.parent.mkdir(parents=True, exist_ok=True)
    seeds = range(options.first, options.first + options.servos)
    work = partial(evaluate, kept=options.kept, n_halves=options.halves)
    rows, console = [], Console(width=180)
    for row in run_all(seeds, work, options.out, options.at_once):
        rows.append(row)
        console.print(f"{row['seed']}: {row.get('status') or row['failure']}")
    for table in tabulate(rows):
        console.print(table)


if __name__ == "__main__":
    main()
