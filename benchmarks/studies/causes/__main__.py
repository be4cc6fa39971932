"""Draw arms with causes, identify them and print which are named."""

from __future__ import annotations

import argparse
import json
from functools import partial
from pathlib import Path

from benchmarks.console import Console
from benchmarks.families.causes import NO_CAUSE
from benchmarks.studies.arms import run_all
from benchmarks.studies.causes.evaluation import Engine, evaluate_in_turn
from benchmarks.studies.causes.runs import causes
from benchmarks.studies.causes.stated_causes import STATED, evaluate_stated, stated_table
from benchmarks.studies.causes.tables import tables
from strainwave import __version__

_WIDTH = 200


def main() -> None:
    """Print tables; with `--out` write them and every run."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--arms", type=int, default=40, help="runs; the causes take turns")
    parser.add_argument("--engine", choices=("own", "mujoco"), default="own")
    parser.add_argument("--only", nargs="+", metavar="CAUSE")
    parser.add_argument("--clean", action="store_true", help="arms without a cause")
    parser.add_argument("--stated", action="store_true", help="causes of typical sizes")
    parser.add_argument("--plain", action="store_true", help="no fit with the cause in the study")
    parser.add_argument("--auto", action="store_true", help="also a fit that selects effects")
    parser.add_argument("--at-once", type=int, default=1)
    parser.add_argument("--seed", type=int, default=0, help="another seed draws other arms")
    parser.add_argument(
        "--out",
        type=Path,
        help="a .json file; tables go to .md, runs to .jsonl, from which a repeated run continues",
    )
    arguments = parser.parse_args()
    engine: Engine = arguments.engine
    available = causes(engine)
    names = (NO_CAUSE,) if arguments.clean else tuple(arguments.only or available)
    unknown = set(names) - {NO_CAUSE, *available}
    if unknown:
        parser.error(f"no such cause: {', '.join(sorted(unknown))}; known: {', '.join(available)}")
    options = {"engine": engine, "with_effect": not arguments.plain, "auto": arguments.auto}
    work = partial(evaluate_in_turn, names=names, series=arguments.seed, options=options)
    n_runs = arguments.arms
    if arguments.stated:
        work, n_runs = partial(evaluate_stated, engine=engine, series=arguments.seed), len(STATED)
    lines = arguments.out.with_suffix(".jsonl") if arguments.out else None
    console, results = Console(width=_WIDTH), []
    for run in run_all(range(n_runs), work, lines, arguments.at_once):
        if "failure" in run:
            console.print(f"{run['cause']} {run['number']}: {run['failure']}")
        else:
            results.append(run)
    printed = [stated_table(results)] if arguments.stated else tables(results)
    for table in printed:
        console.print(table.on_screen())
    if arguments.out:
        document = {
            "version": __version__,
            "options": options,
            "seed": arguments.seed,
            "causes": names,
            "runs": results,
        }
        arguments.out.write_text(json.dumps(document, indent=1) + "\n")
        text = "\n".join(table.markdown() for table in printed)
        arguments.out.with_suffix(".md").write_text(text)


if __name__ == "__main__":
    main()
