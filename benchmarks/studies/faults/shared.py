"""The check on clean and faulty variants: `python -m benchmarks.studies.faults.shared STUDY...`.

A clean variant is *accused* if a fault is suspected or the input refused. A fault is *named* if the
code, and the joint or record where it has one, stands among the first two suspicions, or if a
refusal names the channel; *wrong* if other faults are suspected, and *missed* if none is. A row of
the table of relations that contradicts itself is printed behind "table:".

With `--obey`, the printed corrections are applied, and the check runs again, up to four times. The
remedy is *right* if the check is content and all constants and channels equal those without the
fault (ratios within 0.5 %, delays within 2 ms, zeros within 0.02 rad, lengths within 2 %); it
*objects* if the check still suspects a fault, is *wrong* if it is content with other values, a
*no-op* if a correction changes nothing, and *none* if no correction is printed.

With `--identify`, `identify` runs on the faults that are missed or whose remedy is wrong; a fault
is *silent* if a result is "determined" and a value is outside its interval by more than 3 %.
"""

from __future__ import annotations

import argparse
import json
import re
import time
from collections import Counter
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from benchmarks.studies.faults.cases import faults
from benchmarks.studies.faults.clean import clean_variants
from benchmarks.studies.faults.identified import Interval, true_intervals, wrong_values
from benchmarks.studies.faults.inputs import Case, Input
from benchmarks.studies.faults.remedies import obey
from strainwave.domain import InputCheck, Relation, Suspicion, channel_parts
from strainwave.domain.keys import Key
from strainwave.errors import InvalidInput
from strainwave.pipeline.inputs import check_input


@dataclass(frozen=True, slots=True)
class Row:
    """Answer of the check to one case."""

    study: str
    case: str
    is_fault: bool
    outcome: str
    remedy: str = ""
    silent: str = ""
    seconds: float = 0.0
    text: str = ""

    def __str__(self) -> str:
        classes = f"{self.outcome:8s} {self.remedy:8s} {self.seconds:5.1f}"
        return f"{self.study:22s} {self.case:34s} {classes} {self.silent} {self.text}"


def outcome_of(case: Case, check: InputCheck) -> str:
    """Class of the answer of the check."""
    if not case.codes:
        return "accused" if check.suspected else "ok"
    if case.unchecked in check.unchecked:
        return "named"
    if not check.suspected:
        return "missed"
    first = check.suspected[:2]
    names = [each for each in first if each.code in case.codes and _is_there(case, each)]
    return "named" if names else "wrong"


def _is_there(case: Case, each: Suspicion) -> bool:
    joints = {
        joint
        for place in each.places
        for joint in (place.joint, channel_parts(place.channel)[1] if place.channel else None)
        if joint
    }
    records = {record for place in each.places for record in place.experiments}
    is_joint = not case.joints or bool(joints & set(case.joints))
    return is_joint and (not case.records or bool(records & set(case.records)))


def _refusal_outcome(case: Case, refusal: InvalidInput) -> str:
    """Class of a refusal: an error names the fault if it names a channel of its joint."""
    if not case.codes:
        return "accused"
    joints = {int(number) for number in re.findall(r"'[a-z_]+(\d)'", str(refusal)[:100])}
    return "named" if joints & set(case.joints) else "wrong"


def contradicts_itself(relation: Relation) -> bool:
    """Whether the verdict on a relation does not follow from its values."""
    if relation.expected is None:
        is_met = relation.measured > -relation.accuracy
    else:
        excess = relation.measured - relation.expected
        bounds = {"equal": abs(excess), "least": -excess, "most": excess}
        is_met = bounds[relation.bound] <= relation.accuracy
    return bool(is_met != relation.is_consistent)


def answer(
    study: str, case: Case, *, obeys: bool, truth: Mapping[Key, Interval] | None = None
) -> Row:
    """Check a case, obey its remedies and identify its values, as far as asked for."""
    begin = time.process_time()
    remedy, silent, given = "", "", case.given
    try:
        check = check_input(given.study, data=given.tables)
    except InvalidInput as refusal:
        seconds = time.process_time() - begin
        outcome, text = _refusal_outcome(case, refusal), f"refused: {refusal}"[:160]
        return Row(study, case.name, bool(case.codes), outcome, "", "", seconds, text)
    seconds, suspected = time.process_time() - begin, check.suspected
    outcome = outcome_of(case, check)
    text = "; ".join(f"{e.code} {e.where[:60]} [{e.remedy[:90]}]" for e in suspected[:3])
    text += "".join(f" table: {r.kind} {r.where}" for r in check.relations if contradicts_itself(r))
    if obeys and case.codes and suspected:
        obedience = obey(case, suspected)
        remedy, given = obedience.remedy, obedience.given
        text += f" after: {', '.join(obedience.differing[:4])}" if obedience.differing else ""
    if truth is not None and case.codes and (outcome == "missed" or remedy in ("wrong", "no-op")):
        wrong = wrong_values(given, truth)
        silent = f"silent: {', '.join(wrong[:3])}" if wrong else "not silent"
    return Row(study, case.name, bool(case.codes), outcome, remedy, silent, seconds, text)


def summary(study: str, rows: list[Row]) -> str:
    """Counts of the classes of one study."""
    clean = Counter(row.outcome for row in rows if not row.is_fault)
    faulty = [row for row in rows if row.is_fault]
    outcomes = Counter(row.outcome for row in faulty)
    remedies = Counter(row.remedy for row in faulty)
    silent = sum(row.silent.startswith("silent") for row in faulty)
    return (
        f"{study}: clean accused {clean['accused']} of {clean.total()}; "
        f"named {outcomes['named']} of {len(faulty)}, wrong {outcomes['wrong']}, "
        f"missed {outcomes['missed']}; obeyed right {remedies['right']}, "
        f"objects {remedies['objects']}, wrong {remedies['wrong']}, no-op {remedies['no-op']}, "
        f"none {remedies['none']}; silent {silent}"
    )


def main() -> None:
    """Print a line per case, and a summary per study."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("studies", type=Path, nargs="+")
    parser.add_argument("--joint", type=int, default=2)
    parser.add_argument("--only", default="", help="part of the name of the cases")
    parser.add_argument("--kind", choices=("clean", "faults", "all"), default="all")
    parser.add_argument("--obey", action="store_true")
    parser.add_argument("--identify", action="store_true")
    parser.add_argument("--out", type=Path, help="lines of JSON")
    options = parser.parse_args()
    for path in options.studies:
        given = Input.read(path)
        truth = true_intervals(path, given) if options.identify else None
        cases: list[Case] = []
        if options.kind != "faults":
            cases += clean_variants(given, np.random.default_rng(0))
        if options.kind != "clean":
            cases += faults(given, min(options.joint, given.study.arm.n_joints))
        rows = []
        for case in cases:
            if options.only not in case.name:
                continue
            row = answer(path.parent.name, case, obeys=options.obey, truth=truth)
            rows.append(row)
            print(row, flush=True)
            if options.out is not None:
                with options.out.open("a") as lines:
                    lines.write(json.dumps(asdict(row)) + "\n")
        print(summary(path.parent.name, rows), flush=True)


if __name__ == "__main__":
    main()
