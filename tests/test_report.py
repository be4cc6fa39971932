"""The report: whole without a network, safe against names, figures that lose no peak."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np

from results import arm_model, identification, prediction
from strainwave.records import Parameter
from strainwave.report import figures, render
from strainwave.summary import print_summary


def figures_of(page: str) -> dict[str, figures.Figure]:
    found = re.search(r'id="figures">(.*?)</script>', page, re.DOTALL)
    assert found is not None
    document: dict[str, figures.Figure] = json.loads(found[1].replace("\\u003c", "<"))
    return document


class Balance(HTMLParser):
    """Every element that is opened is closed, and nothing is fetched."""

    VOID = ("meta", "link", "br", "img")

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.fetched: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.fetched += [v for k, v in attrs if k in ("src", "href") and v and v[:5] != "data:"]
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


def test_the_page_is_whole_and_fetches_nothing() -> None:
    balance = Balance()
    balance.feed(render(identification()))
    assert balance.open == []
    assert balance.fetched == []


def test_it_says_what_was_found_and_what_was_not() -> None:
    page = render(identification())
    for text in ("0.02010", "not known", "saturated", "91.2 %", "97.5 %"):
        assert text in page, text
    doubtful = render(replace(identification(), reason="nothing moved"))
    assert "Not everything could be told" in doubtful
    assert "nothing moved" in doubtful


def test_a_check_without_a_fit_is_not_the_worst() -> None:
    page = render(identification())
    assert "at least 91.2 %" in page
    assert "nan" not in re.sub(r"<script>.*?</script>", "", page, flags=re.DOTALL).lower()


def test_names_cannot_leave_their_place() -> None:
    evil = "</script><script>alert(1)</script>"
    one = identification(evil)
    page = render(replace(one, checks=(prediction(evil, 90.0),)))
    assert evil not in page
    figures_of(page)


def test_a_figure_for_each_channel() -> None:
    drawn = figures_of(render(identification()))
    assert len(drawn) == 3
    names = [[trace["name"] for trace in figure["data"]] for figure in drawn.values()]
    assert names == [["measured", "model", "difference"]] * 3


def test_what_a_fit_leaves_is_shown_and_what_might_explain_it() -> None:
    parameters = (Parameter("motor_inertia", 1, 1e-4, 1e-6, "kg m^2", "tuned", (0.9e-4, 1.1e-4)),)
    tuned = arm_model(parameters, np.array([[1e-12]]))
    page = render(replace(identification(), tuned=tuned))
    for text in ("22 Hz", "p &lt; 0.001", "6 ms behind", "torque 2.10 ± 0.10", "30 %", "likely"):
        assert text in page, text
    drawn = [f for f in figures_of(page).values() if f["data"][0]["name"] == "left"]
    assert len(drawn) == 1
    # no frequency is zero on a logarithmic axis
    assert min(drawn[0]["data"][0]["x"]) > 0.0
    assert "What the fit leaves" not in render(identification())


def test_thinning_keeps_every_peak() -> None:
    long = prediction("motion", 90.0)
    long.measured[3333, 0] = 50.0
    long.measured[4444, 0] = -50.0
    drawn = figures.time_fit(long, 0)["data"][0]
    assert max(drawn["y"]) == 50.0
    assert min(drawn["y"]) == -50.0
    assert len(drawn["x"]) <= figures.MOST_POINTS


def test_gaps_stay_gaps() -> None:
    gappy = prediction("motion", 90.0)
    gappy.measured[100:200] = np.nan
    assert None in figures.time_fit(gappy, 0)["data"][0]["y"]


def test_the_summary_names_all() -> None:
    from io import StringIO
    from pathlib import Path

    from rich.console import Console

    text = StringIO()
    console = Console(file=text, width=80, highlight=False)
    print_summary(identification(), Path("out"), truth={("inertia", 1): 0.02}, console=console)
    printed = text.getvalue()
    for said in (
        "inertia",
        "0.02010",
        "0.00020",
        "+0.50",
        "91.2 %",
        "saturated",
        "out/result.json",
    ):
        assert said in printed, said
    assert max(len(line) for line in printed.splitlines()) <= 80
