"""Wrong input on drawn arms: `python -m benchmarks.studies.faults --arms 12 --faults 6`.

Each arm is simulated once. Then faults are drawn, kind and size, and put one at a time into its
logs or its study; every one goes through `identify` as a user's would. A fault is *named* where the
run says so with the right code, *refused* where it ends at once with a message, *harmless* where
nothing is said and every value published is within `_HARMLESS` of the truth or its interval holds
it, and *silent* otherwise. Arms without a fault count too: there every finding is a false alarm.
"""

from __future__ import annotations

import argparse
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks.studies import arms
from strainwave.domain.parameters import Values
from strainwave.errors import InvalidInput
from strainwave.io.logs import read_logs, write_log
from strainwave.io.study import read_study, write_study
from strainwave.pipeline import STAGES, identify
from strainwave.virtual.experiments import derived
from strainwave.virtual.families import catalogue
from strainwave.virtual.families.input_faults import Fault, drawn_faults

_HARMLESS = 0.03  # of a value
_SOURCES = {"rig": arms.rig, "catalogue": catalogue.drawn}


def tried(n_faults: int, seed: int, stages: tuple[str, ...], path: Path, values: Values) -> Any:
    """What `identify` says of one arm without a fault, and with each of some drawn ones."""
    study = read_study(path)
    logs = read_logs(study)
    truth = derived(values, study.arm)
    faults = [Fault("none", "", (), logs, study)]
    rng = np.random.default_rng([seed, len(logs[0]), int(1e6 * values["alpha", None])])
    for fault, _ in zip(drawn_faults(logs, study, rng), range(n_faults), strict=False):
        faults.append(fault)
    return {"faults": [_outcome(path.parent, fault, truth, stages) for fault in faults]}


def _outcome(folder: Path, fault: Fault, truth: Values, stages: tuple[str, ...]) -> dict[str, Any]:
    for log in fault.logs:
        write_log(folder / log.experiment.file, {"t": log.time, **log.channels})
    path = folder / "study-with-fault.toml"
    write_study(fault.study, path)
    said: dict[str, Any] = {"kind": fault.kind, "size": fault.size}
    try:
        found = identify(path, stages=stages)
    except InvalidInput as refusal:
        return said | {"class": "refused", "codes": [], "status": str(refusal)[-160:]}
    except Exception as failure:
        return said | {"class": "traceback", "codes": [], "status": f"{type(failure).__name__}"}
    codes = [each.code for each in found.suspected]
    worst, of = _worst(found.verdict.identified, found.parameters, truth)
    named = bool(codes) and (not fault.codes or set(codes) & set(fault.codes))
    kind = "named" if named else "other code" if codes else "silent"
    if not codes and (found.verdict.status != "determined" or worst < _HARMLESS):
        kind = "harmless" if worst < _HARMLESS else "not identified" if not of else "silent"
    return said | {
        "class": kind,
        "codes": codes,
        "status": found.verdict.status,
        "worst": worst,
        "of": of,
    }


def _worst(identified: Any, parameters: Any, truth: Values) -> tuple[float, str]:
    """Largest error of an identified value whose interval does not hold the truth."""
    worst, of = 0.0, ""
    for p in parameters:
        true = truth.get((p.name, p.joint))
        if p.label not in identified or p.value is None or not true or p.ci95 is None:
            continue
        if not p.ci95[0] <= true <= p.ci95[1] and abs(p.value / true - 1.0) > worst:
            worst, of = abs(p.value / true - 1.0), p.label
    return float(worst), of


def main() -> None:
    """Draw arms and faults, and print what was said of each."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--arms", type=int, default=8)
    parser.add_argument("--faults", type=int, default=6, help="per arm, of 14 kinds")
    parser.add_argument("--source", choices=sorted(_SOURCES), default="rig")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--stages", default=",".join(STAGES))
    parser.add_argument("--out", type=Path, help="keeps what was found as lines of JSON")
    args = parser.parse_args()
    work = partial(tried, args.faults, args.seed, tuple(args.stages.split(",")))
    run = partial(arms.with_logs, work=work, arm=_SOURCES[args.source])
    rows: dict[tuple[str, str], list[dict[str, Any]]] = {}
    for found in arms.each(args.arms, run, args.out):
        if "failure" in found:
            print(found["seed"], found["failure"])
        for each in found.get("faults", []):
            rows.setdefault((each["kind"], each["size"]), []).append(each)
    table = Table("fault", "size", "runs", "classes", "codes", "status", "worst wrong value")
    for (kind, size), each in sorted(rows.items()):
        worst = max(each, key=lambda one: one.get("worst", 0.0))
        table.add_row(
            kind,
            size,
            str(len(each)),
            _counted([one["class"] for one in each]),
            _counted([code for one in each for code in one["codes"]]),
            _counted([one["status"] for one in each]),
            f"{100.0 * worst.get('worst', 0.0):.1f} % {worst.get('of', '')}",
        )
    Console(width=160).print(table)


def _counted(names: list[str]) -> str:
    return ", ".join(f"{names.count(name)} {name}" for name in dict.fromkeys(names))


if __name__ == "__main__":
    main()
