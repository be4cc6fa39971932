"""Wrong input on drawn arms: `python -m benchmarks.studies.faults --arms 12 --faults 6`.

Each arm is simulated once. Then faults are drawn, kind and size, and put one at a time into its
logs or its study; every one goes through `identify` as a user's would. A fault is *named* where the
run says so with the right code, *refused* where it ends at once with a message, *harmless* where
nothing is said and every value published is within `_HARMLESS` of the truth or its interval holds
it, and *silent* otherwise. Arms without a fault count too: there every finding is a false alarm.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks.studies import arms, catalogue
from strainwave.domain import FloatArray, Log, Study
from strainwave.domain.parameters import Values
from strainwave.errors import InvalidInput
from strainwave.io.logs import read_logs, write_log
from strainwave.io.study import read_study, write_study
from strainwave.pipeline import STAGES, identify
from strainwave.virtual.experiments import derived

_HARMLESS = 0.03  # of a value
_SOURCES = {"rig": arms.rig, "catalogue": catalogue.drawn}


@dataclass(frozen=True, slots=True)
class Fault:
    """Something wrong with the input."""

    kind: str
    size: str
    codes: tuple[str, ...]  # that name it; empty: it is to be corrected or noticed without harm
    logs: tuple[Log, ...]
    study: Study


def drawn_faults(logs: tuple[Log, ...], study: Study, rng: np.random.Generator) -> Iterator[Fault]:
    """Every kind of fault once, in random order, its joint and size by chance."""
    kinds: list[Callable[[tuple[Log, ...], Study, int, np.random.Generator], Fault]] = [
        _time_unit,
        _time_scale,
        _angle_unit,
        _angle_sign,
        _accelerometer_unit,
        _accelerometer_sign,
        _voltage_sign,
        _swapped,
        _gear_ratio,
        _distance,
        _torque_constant,
        _late,
        _drift,
        _clipped,
    ]
    for k in rng.permutation(len(kinds)).tolist():
        yield kinds[k](logs, study, int(rng.integers(1, study.arm.n_joints + 1)), rng)


def _changed(
    logs: tuple[Log, ...], change: Callable[[Log, dict[str, FloatArray]], None]
) -> tuple[Log, ...]:
    found = []
    for log in logs:
        channels = dict(log.channels)
        change(log, channels)
        found.append(replace(log, channels=channels))
    return tuple(found)


def _times(logs: tuple[Log, ...], name: str, factor: float) -> tuple[Log, ...]:
    def change(_: Log, channels: dict[str, FloatArray]) -> None:
        channels[name] = factor * channels[name]

    return _changed(logs, change)


def _timed(logs: tuple[Log, ...], factor: float) -> tuple[Log, ...]:
    return tuple(
        replace(log, time=factor * log.time, sample_time=factor * log.sample_time) for log in logs
    )


def _time_unit(logs: Any, study: Study, _: int, rng: np.random.Generator) -> Fault:
    factor, unit = [(1e3, "ms"), (1e6, "us")][int(rng.integers(2))]
    return Fault("time unit", unit, ("wrong-unit",), _timed(logs, factor), study)


def _time_scale(logs: Any, study: Study, _: int, rng: np.random.Generator) -> Fault:
    factor = 1.0 + float(rng.choice([-1.0, 1.0]) * rng.uniform(0.005, 0.05))
    return Fault(
        "all stamps fast or slow", f"{factor:.3f}", ("clock-drift",), _timed(logs, factor), study
    )


def _angle_unit(logs: Any, study: Study, joint: int, rng: np.random.Generator) -> Fault:
    counts = float(study.arm.joints[joint - 1].encoder_counts or 8192.0)
    units = {"degrees": 180.0 / np.pi, "counts": counts / (2 * np.pi), "turns": 0.5 / np.pi}
    unit = str(rng.choice(list(units)))
    changed = _times(logs, f"theta_m{joint}", units[unit])
    return Fault("motor angle's unit", unit, ("wrong-unit",), changed, study)


def _angle_sign(logs: Any, study: Study, joint: int, _: np.random.Generator) -> Fault:
    changed = _times(logs, f"theta_m{joint}", -1.0)
    return Fault("motor angle's sign", "-1", ("wrong-sign",), changed, study)


def _accelerometer_unit(logs: Any, study: Study, joint: int, _: np.random.Generator) -> Fault:
    changed = _times(logs, f"a{joint}", 1.0 / 9.80665)
    return Fault("accelerometer's unit", "g", ("wrong-unit",), changed, study)


def _accelerometer_sign(logs: Any, study: Study, joint: int, _: np.random.Generator) -> Fault:
    changed = _times(logs, f"a{joint}", -1.0)
    return Fault("accelerometer's sign", "-1", ("wrong-sign",), changed, study)


def _voltage_sign(logs: Any, study: Study, joint: int, _: np.random.Generator) -> Fault:
    return Fault("voltage's sign", "-1", ("wrong-sign",), _times(logs, f"u{joint}", -1.0), study)


def _swapped(logs: Any, study: Study, _: int, rng: np.random.Generator) -> Fault:
    kind = str(rng.choice(["a", "u", "theta_m"]))

    def change(_: Log, channels: dict[str, FloatArray]) -> None:
        channels[f"{kind}1"], channels[f"{kind}2"] = channels[f"{kind}2"], channels[f"{kind}1"]

    return Fault("swapped joints", kind, ("swapped-channels",), _changed(logs, change), study)


def _with_joint(study: Study, joint: int, **keys: Any) -> Study:
    joints = list(study.arm.joints)
    joints[joint - 1] = replace(joints[joint - 1], **keys)
    return replace(study, arm=replace(study.arm, joints=tuple(joints)))


def _gear_ratio(logs: Any, study: Study, joint: int, rng: np.random.Generator) -> Fault:
    n = study.arm.joints[joint - 1].gear_ratio
    wrong, size = [(1.0, "left at 1"), (2.0 * n, "doubled"), (0.5 * n, "halved")][
        int(rng.integers(3))
    ]
    changed = _with_joint(study, joint, gear_ratio=wrong)
    return Fault("gear ratio", size, ("wrong-gear-ratio",), logs, changed)


def _distance(logs: Any, study: Study, joint: int, _: np.random.Generator) -> Fault:
    distance = float(study.arm.joints[joint - 1].accelerometer_distance or 0.0)
    length = float(study.arm.link_length or 0.0)
    changed = _with_joint(study, joint, accelerometer_distance=distance + length)
    size = f"x {1.0 + length / distance:.2f}"
    return Fault("distance from the wrong axis", size, ("wrong-geometry",), logs, changed)


def _torque_constant(logs: Any, study: Study, joint: int, rng: np.random.Generator) -> Fault:
    factor = float(rng.choice([0.9, 1.1]))
    e = float(study.arm.joints[joint - 1].torque_per_volt or 1.0)
    changed = _with_joint(study, joint, torque_per_volt=factor * e)
    return Fault("torque constant", f"x {factor}", ("wrong-torque-constant",), logs, changed)


def _warped(logs: Any, delay: float, fast: float) -> tuple[Log, ...]:
    def change(log: Log, channels: dict[str, FloatArray]) -> None:
        time = log.time - log.time[0]
        at = time * (1.0 + fast) - delay
        link = {name: v for name, v in channels.items() if name.startswith(("a", "gyro"))}
        channels.update({name: np.interp(at, time, values) for name, values in link.items()})

    return _changed(logs, change)


def _late(logs: Any, study: Study, _: int, rng: np.random.Generator) -> Fault:
    delay = float(rng.choice([1e-3, 2e-2]))
    codes = () if delay < 5e-3 else ("misaligned",)
    changed = _warped(logs, delay, 0.0)
    return Fault("link sensors late", f"{1e3 * delay:g} ms", codes, changed, study)


def _drift(logs: Any, study: Study, _: int, __: np.random.Generator) -> Fault:
    return Fault(
        "link sensors' clock fast", "0.1 %", ("clock-drift",), _warped(logs, 0.0, 1e-3), study
    )


def _clipped(logs: Any, study: Study, joint: int, rng: np.random.Generator) -> Fault:
    share = float(rng.uniform(0.4, 0.7))
    name = f"a{joint}"
    limit = share * max(float(np.abs(log.channels[name]).max()) for log in logs)

    def change(_: Log, channels: dict[str, FloatArray]) -> None:
        channels[name] = np.clip(channels[name], -limit, limit)

    return Fault("clipped sensor", f"at {share:.2f}", ("clipped",), _changed(logs, change), study)


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
