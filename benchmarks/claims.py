"""Compare the numbers of the documentation with those that their commands make now.

`python -m benchmarks.claims [--short] [--only NAME]` reads `claims.toml`, whose head explains it.
Printed are document, measurement and verdict. The exit code is 1 if a number differs, a claim is
not in its document, or a command fails. `--short` runs only short commands, with fewer arms.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import shlex
import subprocess
import sys
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from rich.table import Table

from benchmarks.console import TABLES_VARIABLE, Console

ROOT = Path(__file__).resolve().parents[1]
TABLE = Path(__file__).with_suffix(".toml")
SHARED_DATA = "../shared/data"  # as commands name it: logs that are not part of the project
FRESH = "FRESH"  # in commands: a new file for results

# largest ratio of document and measurement, and largest difference in the unit of the figure
_MAX_RATIOS = {"error": 1.5, "median": 1.5, "ratio": 2.0, "std": 1.1, "value": 1.02}
_MAX_DIFFERENCES = {"fit": 0.5, "count": 0.0}
_MAX_SHARE_STDS = 2.0  # binomial standard deviations between two shares
_KINDS_OF_PARTS = ("error", "share")  # that fewer arms than those of the document can contradict
_FIGURE = re.compile(
    r"(?<![\w.])(-?\d[\d,]*(?:\.\d+)?(?:e[-+]?\d+)?)(?:\s*(%?)\s*(?:of|/)\s*(\d[\d,]*))?"
)

Content = Mapping[str, Any]
"""A table as written by `console`: title, heads, rows."""


class AnchorError(LookupError):
    """A claim is not in its document, or a figure is not in the tables of its command."""


@dataclass(frozen=True, slots=True)
class Figure:
    """A number as written, or a share of a count."""

    text: str
    value: float  # a share is a fraction
    rounding: float  # half a unit of the last digit
    count: int | None  # of a share


@dataclass(frozen=True, slots=True)
class Comparison:
    """One claim and its measurement."""

    claim: str
    document: str
    measured: str
    verdict: str

    @property
    def fails(self) -> bool:
        """Whether the document is not supported."""
        return not self.verdict.startswith(("agrees", "not measured"))


def figures_of(text: str) -> list[Figure]:
    """All numbers and shares ("90 % of 240", "25 of 26", "25/26") of a text."""
    figures = []
    for match in _FIGURE.finditer(text):
        number, percent, count = match.groups()
        value = float(number.replace(",", ""))
        rounding = 0.5 * 10.0 ** -len(number.partition(".")[2])
        n = int(count.replace(",", "")) if count else None
        scale = 1.0 if n is None else 0.01 if percent else 1.0 / n
        is_whole = n is not None and not percent  # a number of intervals is not rounded
        rounding = 0.0 if is_whole else scale * rounding
        figures.append(Figure(match[0], scale * value, rounding, n))
    return figures


def agrees(kind: str, claimed: Figure, measured: Figure, *, is_part: bool) -> bool:
    """Whether a measurement supports a claim within rounding and the tolerance of its kind.

    If only a part of the arms is measured, its largest error may be smaller.
    """
    if kind == "share":
        if claimed.count is None or measured.count is None:
            return False
        n = measured.count
        p = (claimed.value * n + 1.0) / (n + 2.0)  # not 0 or 1, where the deviation would be zero
        tolerance = _MAX_SHARE_STDS * (p * (1.0 - p) / n) ** 0.5 + claimed.rounding
        has_count = is_part or n == claimed.count
        return has_count and abs(measured.value - claimed.value) <= tolerance
    if kind in _MAX_DIFFERENCES:
        tolerance = _MAX_DIFFERENCES[kind] + claimed.rounding
        return abs(measured.value - claimed.value) <= tolerance
    sizes = abs(claimed.value), abs(measured.value)
    low, high = (sizes[0] + claimed.rounding * sign for sign in (-1.0, 1.0))
    is_large = is_part or sizes[1] >= low / _MAX_RATIOS[kind]
    return is_large and sizes[1] <= high * _MAX_RATIOS[kind]


@dataclass(frozen=True, slots=True)
class Claim:
    """A number of a document and the place of its measurement."""

    name: str
    kind: str
    figure: Figure
    path: Sequence[str]


def claims_of(run: Mapping[str, Any], root: Path) -> Iterator[Claim | Comparison]:
    """The claims of a run; a failed comparison for each that is not in its document."""
    for each in run["claims"]:
        text = (root / each["document"]).read_text(encoding="utf-8")
        for row, labels in each.get("rows", {each.get("text"): ""}).items():
            name = f"{each['document']}: {row}"
            try:
                cells = _row(text, each, row) if "rows" in each else {"": _groups(text, row)}
                for head, sources in each["figures"].items():
                    if head not in cells:
                        raise AnchorError(f"no column '{head}'")
                    figures = figures_of(cells[head])
                    kinds = [sources] if isinstance(sources, str) else sources
                    if figures and len(figures) != len(kinds):
                        raise AnchorError(f"{len(kinds)} figures for '{cells[head]}' of '{head}'")
                    for figure, source in zip(figures, kinds, strict=False):
                        kind, *path = source.split(" | ")
                        path = [*filter(None, labels.split(" | ")), *path]
                        yield Claim(f"{name}: {head}", kind, figure, path)
            except AnchorError as error:
                yield Comparison(name, "", "", str(error))


def check(
    run: Mapping[str, Any], tables: Sequence[Content], root: Path, *, is_part: bool
) -> Iterator[Comparison]:
    """Compare all claims of a run with the tables of its command."""
    for claim in claims_of(run, root):
        if isinstance(claim, Comparison):
            yield claim
        elif not is_part or claim.kind in _KINDS_OF_PARTS:
            try:
                cell = cell_at(tables, claim.path)
            except AnchorError as error:
                yield Comparison(claim.name, claim.figure.text, "", str(error))
                continue
            measured = next(iter(figures_of(cell)), None)
            if measured is not None:
                holds = agrees(claim.kind, claim.figure, measured, is_part=is_part)
                verdict = "agrees" if holds else "differs"
                yield Comparison(claim.name, claim.figure.text, measured.text, verdict)
            elif not is_part:  # a part may have no arm of this row
                yield Comparison(claim.name, claim.figure.text, "", f"no number at {claim.path}")


def _row(text: str, claim: Mapping[str, Any], row: str) -> dict[str, str]:
    """Cells by head of the row of a document's table whose cells contain the texts of `row`.

    An empty first cell repeats the one above.
    """
    found, heads, first, previous = [], list[str](), "", ""
    sections = re.split(r"^#+ (.*)$", text, flags=re.MULTILINE)
    titles = dict(zip(sections[1::2], sections[2::2], strict=True))
    for line in titles.get(claim["section"], "").splitlines():
        cells = [cell.strip() for cell in line.strip().strip("|").split("|")]
        if line.startswith("|---"):
            heads = [cell.strip() for cell in previous.strip().strip("|").split("|")]
        elif line.startswith("|") and heads:
            first = cells[0] = cells[0] or first
            if all(any(part in cell for cell in cells) for part in row.split(" | ")):
                found.append(dict(zip(heads, cells, strict=True)))
        elif not line.startswith("|"):
            heads = []
        previous = line
    if len(found) != 1:
        raise AnchorError(f"{len(found)} rows in section '{claim['section']}'")
    return found[0]


def _groups(text: str, pattern: str) -> str:
    """The groups of a pattern, in which a space is any white space."""
    found = re.findall(pattern.replace(" ", r"\s+"), text)
    if len(found) != 1:
        raise AnchorError(f"{len(found)} texts")
    return "; ".join([found[0]] if isinstance(found[0], str) else found[0])


def cell_at(tables: Sequence[Content], path: Sequence[str]) -> str:
    """Cell at [number or title of the table, labels of the row, ..., head of the column].

    Empty if the table has no such row.
    """
    which, *labels, head = path
    chosen = [t for k, t in enumerate(tables) if which in (str(k), t["title"])]
    if len(chosen) != 1 or head not in chosen[0]["heads"]:
        raise AnchorError(f"{len(chosen)} tables of the command have a column at {path}")
    rows = [row for row in chosen[0]["rows"] if _in_order(labels, row)]
    if len(rows) > 1:
        raise AnchorError(f"{len(rows)} rows of the command's table at {path}")
    return str(rows[0][chosen[0]["heads"].index(head)]) if rows else ""


def _in_order(labels: Sequence[str], row: Sequence[str]) -> bool:
    """Whether cells of a row are the labels, in their order."""
    cells = iter(row)
    return all(label in cells for label in labels)


def measure(command: str) -> list[Content]:
    """Tables that a command prints. Raises `subprocess.CalledProcessError` if it fails."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "tables.jsonl"
        path.touch()
        fresh = command.replace(FRESH, str(Path(folder) / "results.jsonl"))
        words = [sys.executable if word == "python" else word for word in shlex.split(fresh)]
        environment = {**os.environ, TABLES_VARIABLE: str(path), "OPENBLAS_NUM_THREADS": "1"}
        subprocess.run(words, check=True, cwd=ROOT, env=environment, stdout=subprocess.DEVNULL)
        return [json.loads(line) for line in path.read_text().splitlines()]


def compare(run: Mapping[str, Any], root: Path, *, short: bool) -> Iterator[Comparison]:
    """Run a command and compare its claims; only short commands if `short`."""
    command = run.get("short") if short else run["command"]
    if command is None:
        return
    if SHARED_DATA in command and not (ROOT / SHARED_DATA).is_dir():
        yield Comparison(run["name"], "", "", f"not measured: no {SHARED_DATA}")
        return
    try:
        tables = measure(command)
    except subprocess.CalledProcessError as failure:
        yield Comparison(run["name"], "", "", f"exit code {failure.returncode}: {command}")
        return
    comparisons = list(check(run, tables, root, is_part=command != run["command"]))
    yield from comparisons or [Comparison(run["name"], "", "", "nothing is compared")]


def runs_of(table: Path) -> list[dict[str, Any]]:
    """Runs of a table of claims, with the named figures in their claims."""
    content = tomllib.loads(table.read_text(encoding="utf-8"))
    for run in content["run"]:
        for claim in run["claims"]:
            if isinstance(claim["figures"], str):
                claim["figures"] = content["figures"][claim["figures"]]
    return list(content["run"])


def main(arguments: Sequence[str] | None = None, *, table: Path = TABLE, root: Path = ROOT) -> int:
    """Compare the claims of a table with the documents in the folder `root`."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--short", action="store_true", help="only commands of a minute or two")
    parser.add_argument("--only", default="", help="part of the names of the runs")
    options = parser.parse_args(arguments)
    console, failed = Console(width=160), 0
    summary = Table("claim", "document says", "measured", "verdict", box=None)
    for run in runs_of(table):
        if options.only in run["name"]:
            for one in compare(run, root, short=options.short):
                summary.add_row(one.claim, one.document, one.measured, one.verdict)
                failed += one.fails
    console.print(summary)
    console.print(f"{failed} of {summary.row_count} claims do not hold")
    return 1 if failed or not summary.row_count else 0


if __name__ == "__main__":
    sys.exit(main())
