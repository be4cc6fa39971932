"""Page, file and command: whole, escaped, without a network, and left out on demand."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from html.parser import HTMLParser
from io import StringIO
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console
from typer.testing import CliRunner

from results import identification
from strainwave import cli, virtual
from strainwave import comparisons as package
from strainwave.drawing import draw
from strainwave.records import Comparison
from strainwave.report import curves, render_comparisons
from strainwave.summary import print_comparisons

Found = dict[int, Comparison]


class Outside(HTMLParser):
    """What a page would fetch, and whether its elements are closed."""

    VOID = ("meta", "link", "br", "img")

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.fetched: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.fetched += [v for k, v in attrs if k in ("src", "href") and v and v[0] not in "#d"]
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


def test_the_page_is_whole_and_fetches_nothing(comparisons: Found) -> None:
    page = render_comparisons(list(comparisons.values()), arm="an arm")
    outside = Outside()
    outside.feed(page)
    assert (outside.open, outside.fetched) == ([], [])
    for c in comparisons.values():
        assert f'id="fig-{c.figure}"' in page
    drawn = re.search(r'id="figures">(.*?)</script>', page, re.DOTALL)
    assert drawn is not None
    assert len(json.loads(drawn[1])) == sum(len(c.plots) for c in comparisons.values())


def test_every_figure_can_be_drawn_without_a_browser(comparisons: Found) -> None:
    pytest.importorskip("matplotlib", reason="the extra 'plot' is not installed")
    for c in comparisons.values():
        for plot in c.plots:
            axes = draw(plot).axes
            assert len(axes) == sum(name.startswith("yaxis") for name in plot["layout"])


def test_names_cannot_leave_their_place(comparisons: Found) -> None:
    evil = "</script><script>alert(1)</script>"
    plot = {"data": [{"name": evil}], "layout": {"meta": evil}}
    one = replace(comparisons[4], title=evil, claim=evil, message=evil, holds=False, plots=(plot,))
    page = render_comparisons([one], arm=evil)
    assert evil not in page
    assert "0 of 1" in page
    assert "does not hold" in page


def test_the_file_holds_every_number(comparisons: Found) -> None:
    empty = replace(comparisons[4], values={"x": float("nan")})
    document = json.loads(package.to_json([empty, *list(comparisons.values())[1:]], seed=3))
    assert document["seed"] == 3
    first, *rest = document["comparisons"]
    assert first["values"] == {"x": None}
    for entry in rest:
        assert entry["holds"] == comparisons[entry["figure"]].holds
        assert entry["values"].keys() == comparisons[entry["figure"]].values.keys()


def test_one_line_a_figure(comparisons: Found) -> None:
    text = StringIO()
    shown = [replace(comparisons[4], holds=False), comparisons[5]]
    print_comparisons(shown, Path("out"), console=Console(file=text, highlight=False))
    lines = text.getvalue().splitlines()
    assert lines[0].startswith("Fig.  4: ")
    assert "Does not hold: 2 levels" in lines[0]
    assert "Holds: " in lines[1]
    assert lines[2:] == ["written: out/comparisons.html", "written: out/comparisons.json"]


def test_quick_leaves_the_comparisons_out(
    comparisons: Found, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    given: list[object] = []

    def compare(tuned: object, **_: object) -> tuple[Comparison, ...]:
        given.append(tuned)
        return tuple(comparisons.values())

    monkeypatch.setattr(package, "compare", compare)
    monkeypatch.setattr(virtual, "demonstrate", lambda *_, **__: (identification(), {}))
    for arguments, expected in (
        (["--quick"], set()),
        ([], {"comparisons.html", "comparisons.json"}),
    ):
        done = CliRunner().invoke(cli.app, ["demo", "--out", str(tmp_path), *arguments])
        assert done.exit_code == 0, done.output
        assert {path.name for path in tmp_path.iterdir()} == expected
        assert ("Fig. 15" in done.output) == bool(expected)
    assert given == [None]


def test_bode_has_bands_and_a_phase_from_the_middle() -> None:
    f = np.geomspace(1.0, 100.0, 50)
    response = (1.0 / (2j * np.pi * f)).astype(np.complex128)
    size = np.abs(response)
    drawn = curves.bode(
        [
            curves.Curve("truth", f, response, true=True),
            curves.Curve("model", f, response, 0.1 * size, np.full(50, 0.1)),
        ],
        "caption",
    )
    fills = [trace for trace in drawn["data"] if trace.get("fill")]
    assert [trace.get("yaxis") for trace in fills] == ["y", "y2"]
    assert len(fills[0]["x"]) == len(fills[0]["y"]) == 100
    top = 20.0 * np.log10(1.196 * size[-1])
    assert fills[0]["y"][50] == pytest.approx(top, abs=1e-3)
    shown = [trace for trace in drawn["data"] if trace.get("showlegend", True)]
    assert [trace["name"] for trace in shown] == ["truth", "model"]
    assert shown[0]["line"]["color"] == curves.TRUTH
    phases = [t["y"] for t in drawn["data"] if t.get("yaxis") == "y2" and not t.get("fill")]
    assert phases[0] == pytest.approx([-90.0] * 50)
    assert drawn["layout"]["meta"] == "caption"


def test_no_two_lines_look_alike() -> None:
    x = np.arange(3.0)
    many = [curves.Series(f"{k}", x, x) for k in range(6)]
    drawn = curves.lines(many, "t", "y", "caption")["data"]
    assert len({t["line"]["color"] for t in drawn}) == len({t["line"]["dash"] for t in drawn}) == 6


def test_points_have_bars_and_bounds_have_none() -> None:
    x = np.array([2.0, 10.0])
    drawn = curves.scatter(
        [curves.Points("model", x, x, np.ones(2)), curves.Points("bound", x, x)],
        "amplitude",
        "square",
        "caption",
    )["data"]
    assert drawn[0]["error_y"]["array"] == [1.96, 1.96]
    assert "error_y" not in drawn[1]
    assert drawn[1]["mode"] == "lines"


def test_a_spectrum_is_in_decibels_of_power() -> None:
    one = curves.Series("a", np.array([0.0, 1.0, 10.0]), np.array([5.0, 1.0, 100.0]))
    drawn = curves.spectrum([one], "V²/Hz", "caption")
    assert drawn["data"][0]["x"] == [1.0, 10.0]
    assert drawn["data"][0]["y"] == [0.0, 20.0]


def test_a_pair_shows_its_difference() -> None:
    t = np.arange(4.0)
    drawn = curves.pair(
        curves.Series("arm", t, t), curves.Series("model", t, 0.5 * t), "v", "caption"
    )
    assert drawn["data"][2]["y"] == [0.0, 0.5, 1.0, 1.5]
