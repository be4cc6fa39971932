"""Page, file and command of the published figures: complete, escaped and offline."""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from dataclasses import replace
from html.parser import HTMLParser
from io import StringIO
from pathlib import Path

import numpy as np
import pytest
import typer
from rich.console import Console
from typer.testing import CliRunner

import reproduction as package
from reproduction import Settings, run
from reproduction import __main__ as command
from reproduction.page import render_comparisons
from reproduction.records import Comparison, Criterion, Evidence, Tally
from reproduction.run import print_comparisons
from results import identification
from strainwave.domain import Diagnostic, Place
from strainwave.report.figures import curves
from strainwave.report.matplotlib_backend import draw

DOCS = Path(__file__).resolve().parents[2] / "docs"
SEED = 1  # of the comparisons in the fixture
ByFigure = dict[int, Comparison]
Tallies = tuple[Tally, ...]


class ElementParser(HTMLParser):
    """Collects open elements and external references of a page."""

    VOID = ("meta", "link", "br", "img", "wbr")

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.external: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.external += [v for k, v in attrs if k in ("src", "href") and v and v[0] not in "#d"]
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


def test_the_page_is_complete_and_offline(tallies: Tallies) -> None:
    page = render_comparisons(tallies, arm="an arm")
    parser = ElementParser()
    parser.feed(page)
    assert (parser.open, parser.external) == ([], [])
    for tally in tallies:
        assert f'id="fig-{tally.first.figure}"' in page
        assert all(e.name in page for e in tally.first.evidence)
    figures = re.search(r'id="figures">(.*?)</script>', page, re.DOTALL)
    assert figures is not None
    assert len(json.loads(figures[1])) == sum(len(tally.first.plots) for tally in tallies)


def test_every_figure_can_be_drawn_without_a_browser(comparisons: ByFigure) -> None:
    pytest.importorskip("matplotlib", reason="the extra 'plot' is not installed")
    for c in comparisons.values():
        for plot in c.plots:
            axes = draw(plot).axes
            assert len(axes) == len(plot.panels)


def test_names_are_escaped(comparisons: ByFigure) -> None:
    script = "</script><script>alert(1)</script>"
    x = np.arange(2.0)
    plot = curves.lines([curves.Series(script, x, x)], script, script, script)
    comparison = replace(
        comparisons[4],
        title=script,
        claim=script,
        message=script,
        criteria=(Criterion(script, 1.0, "at most", 0.0, script, script),),
        evidence=(
            Evidence(
                script,
                script,
                "converged",
                warnings=(Diagnostic("modes-failed", Place(part=script), reason=script),),
            ),
        ),
        plots=(plot,),
    )
    page = render_comparisons([Tally((comparison,))], arm=script)
    assert script not in page
    assert "0 of 1" in page
    assert "does not hold" in page


def test_the_file_has_every_number(tallies: Tallies) -> None:
    first = tallies[1].first
    without_value = replace(first, criteria=(replace(first.criteria[0], value=float("nan")),))
    document = package.document_of([Tally((first, without_value)), *tallies[2:]], seeds=(3, 4))
    document = json.loads(package.to_json(document))
    assert document["seeds"] == [3, 4]
    entry, *rest = document["claims"]
    assert entry["outcomes"] == ["shown", "does-not-hold"]
    assert [c["values"][1] for c in entry["criteria"]] == [None] * len(first.criteria)
    assert [c["passed"][0] for c in entry["criteria"]] == [True] * len(first.criteria)
    for entry, tally in zip(rest, tallies[2:], strict=True):
        assert entry["outcomes"] == [tally.first.outcome]
        assert entry["values"].keys() == tally.first.values.keys()
        statuses = {model["name"]: model["status"] for model in entry["models"]}
        assert statuses == {e.name: [e.status] for e in tally.first.evidence}


def test_the_markdown_has_counts_and_reasons(tallies: Tallies) -> None:
    good = next(t.first for t in tallies if t.first.outcome == "shown")
    bad = replace(good, criteria=tuple(replace(c, value=float("nan")) for c in good.criteria))
    text = package.to_markdown(package.document_of([Tally((good, good, bad))], seeds=(0, 1, 2)))
    assert "shown 2/3, does not hold 1/3" in text
    assert f"| {good.figure} | {good.claim} |" in text
    assert "2/3 |" in text
    assert f"does not hold in 1: {good.criteria[0].name} none, expected" in text


def test_the_committed_page_follows_from_its_data() -> None:
    document = json.loads((DOCS / "comparisons.json").read_text(encoding="utf-8"))
    assert package.to_markdown(document) == (DOCS / "comparisons.md").read_text(encoding="utf-8")
    assert len(document["seeds"]) == 10
    assert {claim["protocol"] for claim in document["claims"]} == {"own", "as-published"}
    assert {claim["figure"] for claim in document["claims"]} == {2, *range(4, 16)}


def test_the_committed_data_agree_with_this_version(comparisons: ByFigure) -> None:
    """Figures that do not need the whole-arm fit have the committed verdicts and numbers."""
    document = json.loads((DOCS / "comparisons.json").read_text(encoding="utf-8"))
    committed = {c["figure"]: c for c in document["claims"] if c["protocol"] == "own"}
    index = document["seeds"].index(SEED)
    for figure in (4, 5, 8, 10, 12):
        comparison, stored = comparisons[figure], committed[figure]
        assert stored["outcomes"][index] == comparison.outcome, "run make comparisons"
        for criterion in stored["criteria"]:
            value = next(c.value for c in comparison.criteria if c.name == criterion["name"])
            # a tenth of the limit exceeds the effect of compilers and small changes of an estimator
            margin = 0.1 * abs(criterion["limit"] or criterion["values"][index])
            if criterion["values"][index] < 2.0 * criterion["limit"]:
                assert value == pytest.approx(criterion["values"][index], abs=margin)


def test_the_terminal_has_one_line_per_figure(tallies: Tallies) -> None:
    text = StringIO()
    good = tallies[1].first
    bad = replace(good, criteria=(replace(good.criteria[0], value=9.0),))
    shown = [Tally((bad,)), Tally((good,))]
    print_comparisons(shown, Path("out"), console=Console(file=text, highlight=False))
    lines = text.getvalue().splitlines()
    assert lines[0].startswith("Fig.  4: ")
    assert "does not hold: 2 levels" in lines[0]
    assert lines[1].strip() == "levels 9, expected at most 2"
    assert " shown: " in lines[2]
    names = [f"written: out/comparisons.{ending}" for ending in ("html", "json", "md")]
    assert lines[3:] == names


def test_quick_omits_the_comparisons(
    tallies: Tallies, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls: list[tuple[object, ...]] = []

    def compare(
        seeds: Sequence[int], *, whole_arm: object, settings: Sequence[Settings], **_: object
    ) -> Tallies:
        calls.append((list(seeds), whole_arm, [how.protocol for how in settings]))
        return tuple(Tally(tally.runs * len(seeds)) for tally in tallies)

    monkeypatch.setattr(run, "compare_seeds", compare)
    monkeypatch.setattr(command, "demonstrate", lambda *_, **__: (identification(), {}))
    app = typer.Typer()
    app.command()(command.reproduce)
    written = {f"comparisons.{ending}" for ending in ("html", "json", "md")}
    for arguments, expected in (
        (["--quick"], set()),
        (["--seeds", "3", "--seed", "5"], written),
        (["--as-published"], written),
    ):
        result = CliRunner().invoke(app, ["--out", str(tmp_path), *arguments])
        assert result.exit_code == identification().verdict.exit_code, result.output
        assert {path.name for path in tmp_path.iterdir()} == expected
        assert ("Fig. 15" in result.output) == bool(expected)
    assert calls == [([5, 6, 7], None, ["own"]), ([0], None, ["own", "as-published"])]
