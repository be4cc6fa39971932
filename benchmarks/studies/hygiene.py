"""Detection of sensor defects: `python -m benchmarks.studies.hygiene --runs 100`.

Defects of drawn kind, place and size are put into clean logs of FOLDERS one at a time. Printed are
the share of detected defects, and false alarms in the clean logs and on drawn virtual arms. With
`--identify` all stages run on some of them, with and without the correction; printed is the change
of inertias and stiffness relative to the clean logs.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
from rich.table import Table

from benchmarks.console import Console
from benchmarks.families import catalogue
from benchmarks.families.sensor_defects import DEFECT_SIZES, Injected, injected
from benchmarks.studies import arms
from strainwave.domain import Identification, Log, Study
from strainwave.domain.keys import Values
from strainwave.dynamics.arm import Arm
from strainwave.io.logs import read_logs
from strainwave.io.study import read_study
from strainwave.pipeline import identify
from strainwave.signals import hygiene

_OF_INTEREST = ("inertia", "alpha", "beta", "gamma", "gear_stiffness")
_MAX_CHANGE = 0.01  # harmless relative change of a value
_HARM = {
    (False, False): "",
    (True, False): "corrected",
    (True, True): "not corrected",
    (False, True): "by the correction",
}
"""Harm by whether values change without and with the correction."""
_SOURCES = {"rig": arms.draw_rig, "catalogue": catalogue.drawn}


@dataclass(frozen=True, slots=True)
class Clean:
    """A study and its logs without defects."""

    study: Study
    logs: tuple[Log, ...]

    @property
    def arm(self) -> Arm:
        """The arm with its equations."""
        return Arm.of(self.study.arm)


def main() -> None:
    """Print detected defects, false alarms, and changes of parameters."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "folders", type=Path, nargs="*", help="folders of studies; default: all of --lab"
    )
    parser.add_argument("--lab", type=Path, default=Path("../shared/data/lab"))
    parser.add_argument("--runs", type=int, default=100, help="defects of each kind and size")
    parser.add_argument("--arms", type=int, default=0, help="drawn arms without defects")
    parser.add_argument("--identify", type=int, default=0, help="defects of each kind and size")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    paths = [f / "study.toml" for f in options.folders] or sorted(options.lab.glob("*/study.toml"))
    studies = [Clean(study, read_logs(study)) for study in map(read_study, paths)]
    console = Console(width=140)
    for path, clean in zip(paths, studies, strict=True):
        alarms = sum(map(len, hygiene.detect_defects(clean.logs, clean.arm)))
        console.print(f"{path.parent.name}: {alarms} false alarms")
    for name, source in _SOURCES.items() if options.arms else ():
        run = partial(arms.run_on_logs, work=false_alarms, arm=source)
        results = list(arms.run_all(range(options.arms), run, None))
        alarmed = [result for result in results if result.get("alarms") or "failure" in result]
        console.print(f"{name}: {len(alarmed)} of {len(results)} arms with false alarms", alarmed)
    if options.runs:
        console.print(_detection_table(studies, options.runs, options.seed))
    if options.identify:
        print("defect | size | where | largest change without, with correction [%] | named | harm")
    for row in _changes(studies, options.identify, options.seed) if options.identify else ():
        print(" | ".join(row), flush=True)


def false_alarms(path: Path, _: Values) -> dict[str, Any]:
    """Defects reported in the logs of a virtual arm, which has none."""
    study = read_study(path)
    warnings = hygiene.repair_records(read_logs(study), Arm.of(study.arm))[1]
    return {"alarms": [f"{warning.code}, {warning.where}" for warning in warnings]}


def _inject(studies: Sequence[Clean], runs: int, seed: int) -> Iterator[tuple[Clean, Injected]]:
    """Defects of every kind and size, each in one of the studies."""
    for kind, (_, sizes) in DEFECT_SIZES.items():
        for size in sizes:
            for run in range(runs):
                rng = np.random.default_rng([seed, run, int(1000 * size)])
                clean = studies[run % len(studies)]
                defect = injected(clean.logs, clean.arm, kind, size, rng)
                if defect is not None:
                    yield clean, defect


def _detection_table(studies: Sequence[Clean], runs: int, seed: int) -> Table:
    counts: dict[tuple[str, float], list[bool]] = {}
    for clean, defect in _inject(studies, runs, seed):
        counts.setdefault((defect.kind, defect.size), []).append(_is_detected(defect, clean.arm))
    table = Table("defect", "size", "", "drawn", "named %", box=None)
    for (kind, size), detected in counts.items():
        share = f"{100.0 * np.mean(detected):.0f}"
        table.add_row(kind, f"{size:g}", DEFECT_SIZES[kind][0], str(len(detected)), share)  # type: ignore[index]
    return table


def _is_detected(defect: Injected, arm: Arm) -> bool:
    """Whether the defect is detected in its place; hum, in any record."""
    if defect.kind == "mains-hum":
        return any(
            defect.named(detections) for detections in hygiene.detect_defects(defect.logs, arm)
        )
    logs = [log for log in defect.logs if log.name == defect.record]
    return defect.named(hygiene.detect_defects(logs, arm)[0])


def _changes(studies: Sequence[Clean], runs: int, seed: int) -> Iterator[tuple[str, ...]]:
    """Largest changes of inertias and stiffness, without and with the correction."""
    values = {id(clean): _values(_identify(clean, clean.logs)) for clean in studies}
    for clean, defect in _inject(studies, runs, seed):
        clean_values = values[id(clean)]
        with patch.object(hygiene, "repair_records", lambda logs, _: (tuple(logs), ())):
            without, harms_without = _largest_change(clean_values, _identify(clean, defect.logs))
        corrected, harms_with = _largest_change(clean_values, _identify(clean, defect.logs))
        yield (
            defect.kind,
            f"{defect.size:g} {DEFECT_SIZES[defect.kind][0]}",
            f"{clean.study.path.parent.name}, {defect.record}, {defect.channel}",
            without,
            corrected,
            "named" if _is_detected(defect, clean.arm) else "not named",
            _HARM[harms_without, harms_with],
        )


def _identify(clean: Clean, logs: Sequence[Log]) -> Identification | None:
    data = {log.name: {"t": log.time, **log.channels} for log in logs}
    try:
        return identify(clean.study, data=data)
    except Exception:
        return None


def _values(result: Identification | None) -> dict[tuple[str, int | None], tuple[float, float]]:
    """Value and 95 % half-width of each identified parameter."""
    return {
        (p.name, p.joint): (p.value, 0.5 * (p.ci95[1] - p.ci95[0]))
        for p in (result.parameters if result else ())
        if p.value is not None and p.ci95 is not None and any(k in p.name for k in _OF_INTEREST)
    }


def _largest_change(
    clean: dict[tuple[str, int | None], tuple[float, float]], result: Identification | None
) -> tuple[str, bool]:
    """Largest relative change [%], and whether any exceeds 1 % and the clean interval."""
    values = _values(result)
    missing = [key for key in clean if key not in values]
    changes = {
        key: abs(values[key][0] / value - 1.0) for key, (value, _) in clean.items() if key in values
    }
    beyond = any(
        change > max(_MAX_CHANGE, clean[key][1] / abs(clean[key][0]))
        for key, change in changes.items()
    )
    text = f"{100.0 * max(changes.values()):.2g}" if changes else ""
    if missing:
        text += f" (no {', '.join(f'{name} {joint}' for name, joint in missing)})"
    return text, beyond or bool(missing)


if __name__ == "__main__":
    main()
