"""The check on clean and faulty variants: `python -m benchmarks.studies.faults.shared STUDY...`.

A clean variant is *accused* if a fault is suspected. A fault is *named* if the code, and the joint
or record where it has one, stands among the first two suspicions, and *missed* if nothing is
suspected. With `--obey`, the printed corrections are applied, and the check runs again.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path

import numpy as np

from benchmarks.studies.faults.inputs import Case, Input, clean_variants, faults
from strainwave.domain import Suspicion, channel_parts
from strainwave.errors import InvalidInput
from strainwave.pipeline.inputs import check_input


def outcome_of(case: Case, suspected: tuple[Suspicion, ...]) -> str:
    """Class of the answer of the check."""
    if not case.codes:
        return "accused" if suspected else "ok"
    if not suspected:
        return "missed"
    names = [each for each in suspected[:2] if each.code in case.codes and _is_there(case, each)]
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


def main() -> None:
    """Print a line per case."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("studies", type=Path, nargs="+")
    parser.add_argument("--joint", type=int, default=2)
    parser.add_argument("--only", default="", help="part of the name of the cases")
    parser.add_argument("--kind", choices=("clean", "faults", "all"), default="all")
    parser.add_argument("--obey", action="store_true")
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    for path in options.studies:
        given = Input.read(path)
        rng = np.random.default_rng(0)
        cases: list[Case] = []
        if options.kind != "faults":
            cases += clean_variants(given, rng)
        if options.kind != "clean":
            cases += faults(given, min(options.joint, given.study.arm.n_joints))
        for case in cases:
            if options.only in case.name:
                _report(path.parent.name, case, options.obey, options.out)


def _report(study: str, case: Case, obey: bool, out: Path | None) -> None:
    begin = time.process_time()
    after = ""
    suspected: tuple[Suspicion, ...] = ()
    try:
        check = check_input(case.given.study, data=case.given.tables)
        suspected = check.suspected
        outcome = outcome_of(case, suspected)
        if obey and suspected and (changes := suspected[0].corrections):
            again = case.given.obeyed(changes)
            after = check_input(again.study, data=again.tables).status
    except InvalidInput as refusal:
        outcome, after = "refused", str(refusal)[:120]
    except Exception as failure:
        outcome, after = "crash", repr(failure)[:120]
    text = "; ".join(f"{e.code} {e.where[:60]} [{e.remedy[:90]}]" for e in suspected[:3])
    seconds = time.process_time() - begin
    print(f"{study:22s} {case.name:32s} {outcome:8s} {seconds:5.1f} {text} {after}", flush=True)
    if out is not None:
        with out.open("a") as lines:
            lines.write(json.dumps([study, case.name, outcome, text, after]) + "\n")


if __name__ == "__main__":
    main()
