"""Input faults on drawn arms: `python -m benchmarks.studies.faults --arms 12 --faults 6`.

With `--study STUDY.toml --joints 2,3`, every fault of a serial arm is put into that study, for each
of the joints, and the input check runs alone.

Each arm is simulated once. Faults of drawn kind and size are put into its logs or study one at a
time, and `identify` runs on each. A fault is *named* if the run reports its code, *refused* if it
ends with a message, *harmless* if nothing is reported and every value is within `_MAX_HARMLESS` of
the true value or its interval contains it, and *silent* otherwise. Each arm is also identified
without a fault; any suspicion is then a false alarm.
"""

from __future__ import annotations

import argparse
import time
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from rich.table import Table

from benchmarks.console import Console
from benchmarks.families import catalogue
from benchmarks.families.input_faults import INPUT_FAULTS, SERIAL_FAULTS, Fault
from benchmarks.studies import arms
from strainwave.domain.keys import Values
from strainwave.errors import InvalidInput
from strainwave.input_check import check_consistency
from strainwave.io.logs import read_logs, write_log
from strainwave.io.study import read_study, write_study
from strainwave.pipeline import STAGES, identify
from strainwave.virtual.experiments import derived

_MAX_HARMLESS = 0.03  # relative error of a value
_SOURCES = {"rig": arms.draw_rig, "catalogue": catalogue.drawn}


def evaluate(n_faults: int, seed: int, stages: tuple[str, ...], path: Path, values: Values) -> Any:
    """Outcomes of `identify` for one arm, without a fault and with each of the drawn faults."""
    study = read_study(path)
    logs = read_logs(study)
    true_values = derived(values, study.arm)
    faults = [Fault("none", "", (), logs, study)]
    rng = np.random.default_rng([seed, len(logs[0]), int(1e6 * values["alpha", None])])
    for kind in rng.permutation(list(INPUT_FAULTS)).tolist()[:n_faults]:
        joint = int(rng.integers(1, study.arm.n_joints + 1))
        faults.append(INPUT_FAULTS[kind](logs, study, joint, rng))
    return {"faults": [_outcome(path.parent, fault, true_values, stages) for fault in faults]}


def _outcome(
    folder: Path, fault: Fault, true_values: Values, stages: tuple[str, ...]
) -> dict[str, Any]:
    for log in fault.logs:
        write_log(folder / log.experiment.file, {"t": log.time, **log.channels})
    path = folder / "study-with-fault.toml"
    write_study(fault.study, path)
    head: dict[str, Any] = {"kind": fault.kind, "size": fault.size}
    try:
        result = identify(path, stages=stages)
    except InvalidInput as refusal:
        return head | {"class": "refused", "codes": [], "status": str(refusal)[-160:]}
    except Exception as failure:
        return head | {"class": "traceback", "codes": [], "status": f"{type(failure).__name__}"}
    codes = [suspicion.code for suspicion in result.suspected]
    worst, parameter = _largest_error(result.verdict.identified, result.parameters, true_values)
    named = bool(codes) and (not fault.codes or set(codes) & set(fault.codes))
    kind = "named" if named else "other code" if codes else "silent"
    if not codes and (result.verdict.status != "determined" or worst < _MAX_HARMLESS):
        kind = (
            "harmless" if worst < _MAX_HARMLESS else "not identified" if not parameter else "silent"
        )
    return head | {
        "class": kind,
        "codes": codes,
        "status": result.verdict.status,
        "worst": worst,
        "parameter": parameter,
    }


def _largest_error(identified: Any, parameters: Any, true_values: Values) -> tuple[float, str]:
    """Largest error of an identified value outside its interval, and the parameter."""
    largest, label = 0.0, ""
    for p in parameters:
        true = true_values.get(p.key)
        if p.key not in identified or p.value is None or not true or p.ci95 is None:
            continue
        if not p.ci95[0] <= true <= p.ci95[1] and abs(p.value / true - 1.0) > largest:
            largest, label = abs(p.value / true - 1.0), p.label
    return float(largest), label


def check_serial_faults(path: Path, joints: list[int], seed: int) -> Table:
    """Outcomes of the input check for every fault of a serial arm, one row each."""
    study = read_study(path)
    logs = tuple(read_logs(study))
    faults = [Fault("none", "", (), logs, study)]
    for inject in SERIAL_FAULTS.values():
        faults += [inject(logs, study, j, np.random.default_rng([seed, j])) for j in joints]
    table = Table("fault", "size", "class", "suspected", "s")
    for fault in faults:
        if fault.kind != "none" and fault.logs is logs and fault.study is study:
            continue  # the study has no such channel
        begin = time.perf_counter()
        suspected = check_consistency(fault.logs, fault.study).suspected
        seconds = time.perf_counter() - begin
        codes = {each.code for each in suspected}
        kind = "named" if codes & set(fault.codes) else "other code" if codes else "silent"
        if not fault.codes:
            kind = "false alarm" if codes else "consistent"
        found = "; ".join(f"{each.code} {each.where}" for each in suspected)
        table.add_row(fault.kind, fault.size, kind, found, f"{seconds:.1f}")
    return table


def main() -> None:
    """Draw arms and faults, and print their outcomes."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--arms", type=int, default=8)
    parser.add_argument("--faults", type=int, default=6, help="per arm, of 14 kinds")
    parser.add_argument("--source", choices=sorted(_SOURCES), default="rig")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--stages", default=",".join(STAGES))
    parser.add_argument("--out", type=Path, help="lines of JSON; a repeated run continues")
    parser.add_argument("--study", type=Path, help="study of a serial arm, instead of drawn arms")
    parser.add_argument("--joints", default="1", help="joints of the faults in --study: 2,3")
    options = parser.parse_args()
    if options.study is not None:
        joints = [int(joint) for joint in options.joints.split(",")]
        Console(width=160).print(check_serial_faults(options.study, joints, options.seed))
        return
    work = partial(evaluate, options.faults, options.seed, tuple(options.stages.split(",")))
    run = partial(arms.run_on_logs, work=work, arm=_SOURCES[options.source])
    rows: dict[tuple[str, str], list[dict[str, Any]]] = {}
    for result in arms.run_all(range(options.arms), run, options.out):
        if "failure" in result:
            print(result["seed"], result["failure"])
        for outcome in result.get("faults", []):
            rows.setdefault((outcome["kind"], outcome["size"]), []).append(outcome)
    table = Table("fault", "size", "runs", "classes", "codes", "status", "worst wrong value")
    for (kind, size), outcomes in sorted(rows.items()):
        worst = max(outcomes, key=lambda outcome: outcome.get("worst", 0.0))
        table.add_row(
            kind,
            size,
            str(len(outcomes)),
            _counts([outcome["class"] for outcome in outcomes]),
            _counts([code for outcome in outcomes for code in outcome["codes"]]),
            _counts([outcome["status"] for outcome in outcomes]),
            f"{100.0 * worst.get('worst', 0.0):.1f} % {worst.get('parameter', '')}",
        )
    Console(width=160).print(table)


def _counts(names: list[str]) -> str:
    return ", ".join(f"{names.count(name)} {name}" for name in dict.fromkeys(names))
