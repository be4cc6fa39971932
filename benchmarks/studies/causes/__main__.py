"""Draw arms with causes, identify them and count what is named."""

from __future__ import annotations

import argparse
import json
from functools import partial
from pathlib import Path

from rich.console import Console

from benchmarks.studies.arms import each
from benchmarks.studies.causes.drawn import causes
from benchmarks.studies.causes.judged import Engine, taking_turns
from benchmarks.studies.causes.stated import STATED, before_and_after, tried
from benchmarks.studies.causes.tables import tables
from strainwave import __version__
from strainwave.virtual.families.causes import NOTHING

_WIDTH = 200


def main() -> None:
    """Print tables; with `--out` keep them and every run."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--arms", type=int, default=40, help="runs, the causes taking turns")
    parser.add_argument("--engine", choices=("own", "mujoco"), default="own")
    parser.add_argument("--only", nargs="+", metavar="CAUSE")
    parser.add_argument("--clean", action="store_true", help="arms without a cause")
    parser.add_argument("--stated", action="store_true", help="causes of sizes that rigs have")
    parser.add_argument("--plain", action="store_true", help="no fit with the cause named")
    parser.add_argument("--auto", action="store_true", help="a fit that selects effects as well")
    parser.add_argument("--at-once", type=int, default=1)
    parser.add_argument("--seed", type=int, default=0, help="another draws all anew")
    parser.add_argument(
        "--out",
        type=Path,
        help="a .json file; beside it tables as .md and lines as .jsonl, from which a run goes on",
    )
    chosen = parser.parse_args()
    engine: Engine = chosen.engine
    known = causes(engine)
    names = (NOTHING,) if chosen.clean else tuple(chosen.only or known)
    unknown = set(names) - {NOTHING, *known}
    if unknown:
        parser.error(f"no such cause: {', '.join(sorted(unknown))}; known: {', '.join(known)}")
    options = {"engine": engine, "named": not chosen.plain, "auto": chosen.auto}
    work = partial(taking_turns, names=names, series=chosen.seed, options=options)
    n_runs = chosen.arms
    if chosen.stated:
        work, n_runs = partial(tried, engine=engine, series=chosen.seed), len(STATED)
    lines = chosen.out.with_suffix(".jsonl") if chosen.out else None
    console, found = Console(width=_WIDTH), []
    for run in each(n_runs, work, lines, chosen.at_once):
        if "failure" in run:
            console.print(f"{run['cause']} {run['number']}: {run['failure']}")
        else:
            found.append(run)
    made = [before_and_after(found)] if chosen.stated else tables(found)
    for table in made:
        console.print(table.on_screen())
    if chosen.out:
        document = {
            "version": __version__,
            "options": options,
            "seed": chosen.seed,
            "causes": names,
            "runs": found,
        }
        chosen.out.write_text(json.dumps(document, indent=1) + "\n")
        text = "\n".join(table.markdown() for table in made)
        chosen.out.with_suffix(".md").write_text(text)


if __name__ == "__main__":
    main()
