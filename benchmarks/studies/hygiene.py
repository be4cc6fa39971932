"""Defects of sensors in logs of known arms: `python -m benchmarks.studies.hygiene --runs 100`.

Defects of every kind are drawn, place and size, and put one at a time into clean logs of
FOLDERS. Counted is how many are named; and, of the logs as they are and of drawn virtual arms, how
many are named where there are none. With `--identify` some of them go through all stages, with
what is done about them and without: printed is by how much inertias and stiffness move from those
of the clean logs.
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
from rich.console import Console
from rich.table import Table

from benchmarks.studies import arms
from strainwave.domain import Identification, Log, Study
from strainwave.domain.parameters import Values
from strainwave.dynamics.arm import Arm
from strainwave.io.logs import read_logs
from strainwave.io.study import read_study
from strainwave.pipeline import identify
from strainwave.signals import hygiene
from strainwave.virtual.families import catalogue
from strainwave.virtual.families.sensor_defects import SIZES, Injected, injected

_OF_INTEREST = ("inertia", "alpha", "beta", "gamma", "gear_stiffness")
_SMALL = 0.01  # of a value, up to which it may move
_HARM = {
    (False, False): "",
    (True, False): "not any more",
    (True, True): "still",
    (False, True): "by mending",
}
_SOURCES = {"rig": arms.rig, "catalogue": catalogue.drawn}


@dataclass(frozen=True, slots=True)
class Clean:
    """A study and its logs without defects."""

    study: Study
    logs: tuple[Log, ...]

    @property
    def arm(self) -> Arm:
        """With its equations."""
        return Arm.of(self.study.arm)


def main() -> None:
    """Print what is named, what should not be, and what it does to parameters."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folders", type=Path, nargs="*", help="of studies; all with --lab")
    parser.add_argument("--lab", type=Path, default=Path("../shared/data/lab"))
    parser.add_argument("--runs", type=int, default=100, help="of each kind and size")
    parser.add_argument("--arms", type=int, default=0, help="drawn, without defects")
    parser.add_argument("--identify", type=int, default=0, help="of each kind and size")
    parser.add_argument("--seed", type=int, default=0)
    chosen = parser.parse_args()
    paths = [f / "study.toml" for f in chosen.folders] or sorted(chosen.lab.glob("*/study.toml"))
    studies = [Clean(study, read_logs(study)) for study in map(read_study, paths)]
    console = Console(width=140)
    for path, own in zip(paths, studies, strict=True):
        alarms = sum(map(len, hygiene.defects(own.logs, own.arm)))
        console.print(f"{path.parent.name}: {alarms} named, of none")
    for name, source in _SOURCES.items() if chosen.arms else ():
        run = partial(arms.with_logs, work=false_alarms, arm=source)
        found = list(arms.each(chosen.arms, run, None))
        alarmed = [each for each in found if each.get("alarms") or "failure" in each]
        console.print(f"{name}: {len(alarmed)} of {len(found)} drawn arms without any", alarmed)
    if chosen.runs:
        console.print(_detected(studies, chosen.runs, chosen.seed))
    if chosen.identify:
        print("defect | size | where | largest change before, after [%] | named | harm")
    for row in _moved(studies, chosen.identify, chosen.seed) if chosen.identify else ():
        print(" | ".join(row), flush=True)


def false_alarms(path: Path, _: Values) -> dict[str, Any]:
    """What is named in the logs of a virtual arm, which has no defects."""
    study = read_study(path)
    warnings = hygiene.without_defects(read_logs(study), Arm.of(study.arm))[1]
    return {"alarms": [f"{each.code}, {each.where}" for each in warnings]}


def _drawn(studies: Sequence[Clean], runs: int, seed: int) -> Iterator[tuple[Clean, Injected]]:
    """Of every kind and size so many defects, each in one of the studies."""
    for kind, (_, sizes) in SIZES.items():
        for size in sizes:
            for run in range(runs):
                rng = np.random.default_rng([seed, run, int(1000 * size)])
                clean = studies[run % len(studies)]
                found = injected(clean.logs, clean.arm, kind, size, rng)
                if found is not None:
                    yield clean, found


def _detected(studies: Sequence[Clean], runs: int, seed: int) -> Table:
    counts: dict[tuple[str, float], list[bool]] = {}
    for clean, each in _drawn(studies, runs, seed):
        counts.setdefault((each.kind, each.size), []).append(_is_named(each, clean.arm))
    table = Table("defect", "size", "", "drawn", "named %", box=None)
    for (kind, size), named in counts.items():
        share = f"{100.0 * np.mean(named):.0f}"
        table.add_row(kind, f"{size:g}", SIZES[kind][0], str(len(named)), share)  # type: ignore[index]
    return table


def _is_named(each: Injected, arm: Arm) -> bool:
    """Whether the defect is found where it is; hum, in any record."""
    if each.kind == "mains-hum":
        return any(each.named(own) for own in hygiene.defects(each.logs, arm))
    logs = [log for log in each.logs if log.name == each.record]
    return each.named(hygiene.defects(logs, arm)[0])


def _moved(studies: Sequence[Clean], runs: int, seed: int) -> Iterator[tuple[str, ...]]:
    """Largest changes of inertias and stiffness, with nothing done about a defect and with."""
    known_of = {id(clean): _values(_identified(clean, clean.logs)) for clean in studies}
    for clean, each in _drawn(studies, runs, seed):
        known = known_of[id(clean)]
        with patch.object(hygiene, "without_defects", lambda logs, _: (tuple(logs), ())):
            before, harmed = _largest(known, _identified(clean, each.logs))
        after, still = _largest(known, _identified(clean, each.logs))
        yield (
            each.kind,
            f"{each.size:g} {SIZES[each.kind][0]}",
            f"{clean.study.path.parent.name}, {each.record}, {each.channel}",
            before,
            after,
            "named" if _is_named(each, clean.arm) else "not named",
            _HARM[harmed, still],
        )


def _identified(clean: Clean, logs: Sequence[Log]) -> Identification | None:
    data = {log.name: {"t": log.time, **log.channels} for log in logs}
    try:
        return identify(clean.study, data=data)
    except Exception:
        return None


def _values(found: Identification | None) -> dict[tuple[str, int | None], tuple[float, float]]:
    """Value and 95 % half-width of what is identified."""
    return {
        (p.name, p.joint): (p.value, 0.5 * (p.ci95[1] - p.ci95[0]))
        for p in (found.parameters if found else ())
        if p.value is not None and p.ci95 is not None and any(k in p.name for k in _OF_INTEREST)
    }


def _largest(
    known: dict[tuple[str, int | None], tuple[float, float]], found: Identification | None
) -> tuple[str, bool]:
    """Largest relative change [%], and whether any is beyond 1 % and the clean interval."""
    values = _values(found)
    lost = [key for key in known if key not in values]
    changes = {
        key: abs(values[key][0] / own[0] - 1.0) for key, own in known.items() if key in values
    }
    beyond = any(
        change > max(_SMALL, known[key][1] / abs(known[key][0])) for key, change in changes.items()
    )
    said = f"{100.0 * max(changes.values()):.2g}" if changes else ""
    if lost:
        said += f" (no {', '.join(f'{name} {joint}' for name, joint in lost)})"
    return said, beyond or bool(lost)


if __name__ == "__main__":
    main()
