"""Claims of the documentation: comparison, anchors, and the completeness of their table."""

from __future__ import annotations

import re
import tomllib
from functools import cache
from pathlib import Path

import pytest
from benchmarks.claims import (
    ROOT,
    TABLE,
    AnchorError,
    Comparison,
    agrees,
    cell_at,
    claims_of,
    figures_of,
    main,
    measure,
    runs_of,
)

PAGES = [ROOT / "README.md", ROOT / "CHANGELOG.md", *sorted(ROOT.glob("docs/**/*.md"))]
CLAIMS = """\
[[run]]
name = "short motions"
command = "python -m benchmarks.studies.short_motions --arms 1"
short = "python -m benchmarks.studies.short_motions --arms 1"
[[run.claims]]
document = "page.md"
section = "Arms"
rows = { "short | 6 s" = "0" }
figures = { suspected = ["count | suspected"] }
[[run.claims]]
document = "page.md"
text = 'Of (\\d+) arms without'
figures = { "" = ["count | 0 | arms without a fault"] }
"""
PAGE = """\
# Page
## Arms
| motion | time | suspected |
|---|---|---|
| long | 60 s | 7 |
| short | 6 s | 0 |

Of 1 arms
without a fault.
"""

measured = cache(measure)
"""Tables of a command, which runs once for all documents."""


@pytest.mark.parametrize(
    ("change", "code"),
    [
        (("", ""), 0),
        (("| 6 s | 0 |", "| 6 s | 1 |"), 1),
        (("Of 1 arms", "Of 2 arms"), 1),
        (("| short | 6 s | 0 |\n", ""), 1),
        (("suspected", "named"), 1),
        (("Of 1 arms", "Of one arm"), 1),
        (("| 6 s | 0 |", "| 6 s | 0 of 3, 1 |"), 1),
    ],
)
def test_a_changed_document_is_reported(
    change: tuple[str, str],
    code: int,
    tmp_path: Path,
    capfd: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("benchmarks.claims.measure", measured)
    (tmp_path / "claims.toml").write_text(CLAIMS)
    (tmp_path / "page.md").write_text(PAGE.replace(*change))
    assert main(["--short"], table=tmp_path / "claims.toml", root=tmp_path) == code
    assert "claims do not hold" in capfd.readouterr().out


def test_a_command_that_fails_is_reported(tmp_path: Path) -> None:
    (tmp_path / "claims.toml").write_text(CLAIMS.replace("--arms 1", "--no-such-option"))
    (tmp_path / "page.md").write_text(PAGE)
    assert main(["--short"], table=tmp_path / "claims.toml", root=tmp_path) == 1


def test_numbers_and_shares_are_read() -> None:
    figures = figures_of("0.02 %, 97.4 % of 1,993; K1 25 of 26 (16/16), -3e-2")
    assert [figure.value for figure in figures] == pytest.approx([0.02, 0.974, 25 / 26, 1.0, -0.03])
    assert [figure.count for figure in figures] == [None, 1993, 26, 16, None]
    assert figures[0].rounding == pytest.approx(0.005)
    assert figures[1].rounding == pytest.approx(0.0005)


@pytest.mark.parametrize(
    ("kind", "claimed", "measured", "holds", "holds_in_part"),
    [
        ("error", "0.02", "0.025", True, True),
        ("error", "0.02", "0.058", False, False),
        ("error", "0.02", "0.001", False, True),
        ("share", "90 % of 240", "93 % of 240", True, True),
        ("share", "98 % of 240", "90 % of 240", False, False),
        ("share", "98 % of 240", "97 % of 60", False, True),
        ("share", "25 of 26", "26/26", True, True),
        ("value", "9.32", "9.40", True, True),
        ("value", "9.32", "9.60", False, False),
        ("std", "0.36", "0.39", True, True),
        ("std", "0.36", "0.45", False, False),
        ("fit", "84.0", "84.4", True, True),
        ("fit", "84.0", "82.0", False, False),
        ("count", "8", "7", False, False),
        ("ratio", "1.25", "0.93", True, True),
        ("ratio", "1.25", "0.5", False, True),
    ],
)
def test_tolerances(
    kind: str, claimed: str, measured: str, holds: bool, holds_in_part: bool
) -> None:
    (one,), (other,) = figures_of(claimed), figures_of(measured)
    assert agrees(kind, one, other, is_part=False) == holds
    assert agrees(kind, one, other, is_part=True) == holds_in_part


def test_labels_of_a_row_are_in_the_order_of_its_cells() -> None:
    table = {"title": "t", "heads": ["n", "kind", "m"], "rows": [["2", "a", "3"], ["3", "a", "2"]]}
    assert cell_at([table], ["t", "2", "a", "m"]) == "3"
    assert cell_at([table], ["t", "4", "a", "m"]) == ""
    for ambiguous in (["0", "a", "m"], ["0", "2", "a", "no column"], ["1", "2", "a", "m"]):
        with pytest.raises(AnchorError):
            cell_at([table], ambiguous)


def test_every_claim_is_in_its_document() -> None:
    for run in runs_of(TABLE):
        claims = list(claims_of(run, ROOT))
        assert claims, run["name"]
        assert [claim for claim in claims if isinstance(claim, Comparison)] == [], run["name"]


def test_every_quoted_command_is_checked_or_has_a_reason() -> None:
    covered: set[str] = set()
    for run in runs_of(TABLE):
        covered |= set(run.get("quoted", [run["command"]]))
    reasons = tomllib.loads(TABLE.read_text(encoding="utf-8"))["unchecked"]
    assert all(len(reason) > 20 for reason in reasons.values())
    assert not covered & set(reasons)
    assert covered | set(reasons) == quoted_commands()


def quoted_commands() -> set[str]:
    """Commands of benchmarks on all pages, and all indented commands of docs/benchmarks.md."""
    commands = set()
    for page in PAGES:
        text = page.read_text(encoding="utf-8")
        commands |= set(re.findall(r"python -m benchmarks[^`\n#]*", text))
    text = (ROOT / "docs/benchmarks.md").read_text(encoding="utf-8")
    indented = re.findall(r"^ {4}([^#\n]*)", text, re.MULTILINE)
    return {command.strip() for command in [*commands, *indented]}
