"""Identify drawn arms as a campaign: `python -m benchmarks.families FAMILY.toml --out STORE`."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from benchmarks.families import family_of
from benchmarks.families.drawn_arms import arms_of
from strainwave.errors import InvalidInput
from strainwave.fleet import campaign
from strainwave.fleet.campaign.study_files import CaseSelection
from strainwave.io.atomic_files import check_keys, decode, parse_toml, read_bytes


def cases_of(path: Path) -> CaseSelection:
    """The arms of the `[family]` in a file; raises InvalidInput if it is at fault."""
    text = decode(read_bytes(path, "the family"), path)
    document = parse_toml(text, path)
    check_keys(document, ("family",), path)
    if not isinstance(document.get("family"), dict):
        raise InvalidInput("has no table [family]", where=str(path), remedy="give [family]")
    return CaseSelection(arms_of(family_of(document["family"], path, text), path))


def main() -> int:
    """Run the campaign; print the tally, and return its exit code."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("family", type=Path)
    parser.add_argument("--out", required=True, help="store")
    parser.add_argument("--workers", type=int)
    parser.add_argument("--stages", help="a prefix of the stages, separated by commas")
    arguments = parser.parse_args()
    settings = campaign.Settings(
        store=arguments.out,
        stages=arguments.stages and arguments.stages.split(","),
        workers=arguments.workers,
        display=sys.stderr.isatty(),
    )
    try:
        summary = campaign.run(cases_of(arguments.family), settings)
    except InvalidInput as error:
        print(error, file=sys.stderr)
        return 2
    print(summary.tally.line())
    return summary.exit_code


if __name__ == "__main__":
    sys.exit(main())
