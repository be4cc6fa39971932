"""The report: self-contained, escaped, complete, and accessible by keyboard and screen reader."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from html import escape
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from elastic_results import elastic_identification
from results import arm_model, identification, prediction
from strainwave.domain import Diagnostic, Identification, Parameter, Place
from strainwave.domain.arm.parameters import parameter_descriptions
from strainwave.report.document import figures_of, render
from strainwave.report.document.blocks import read_template
from strainwave.report.document.verdict import TROUBLESHOOTING_PAGE, advice
from strainwave.report.terminal import print_summary

MOST_BYTES = 8_000_000
ROOT = Path(__file__).parents[3]


def figures_in(page: str) -> dict[str, dict[str, Any]]:
    match = re.search(r'id="figures">(.*?)</script>', page, re.DOTALL)
    assert match is not None
    document: dict[str, dict[str, Any]] = json.loads(match[1].replace("\\u003c", "<"))
    return document


def sections(page: str) -> list[str]:
    return re.findall(r'<section id="([^"]+)"', page)


class Outline(HTMLParser):
    """Open elements, requests, ids and links of a page."""

    VOID = ("meta", "link", "br", "img", "wbr")

    def __init__(self, page: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.fetched: list[str] = []
        self.linked: list[str] = []
        self.ids: list[str] = []
        self.elements: list[tuple[str, dict[str, str | None]]] = []
        self.feed(page)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        attributes = dict(attrs)
        self.elements.append((tag, attributes))
        for key in ("src", "href"):
            value = attributes.get(key) or ""
            if value.startswith("#"):
                self.linked.append(value[1:])
            elif value and not value.startswith("data:"):
                self.fetched.append(value)
        if attributes.get("id"):
            self.ids.append(str(attributes["id"]))
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def of(self, tag: str) -> list[dict[str, str | None]]:
        return [attributes for name, attributes in self.elements if name == tag]


@pytest.mark.parametrize("result", [identification(), elastic_identification()])
def test_the_page_is_complete_and_requests_nothing(result: Identification) -> None:
    page = render(result)
    outline = Outline(page)
    assert outline.open == []
    assert outline.fetched == []
    policy = next(attributes for attributes in outline.of("meta") if "http-equiv" in attributes)
    assert str(policy["content"]).startswith("default-src 'none'")
    assert len(page.encode()) < MOST_BYTES


def test_keyboard_and_screen_readers_can_navigate() -> None:
    outline = Outline(render(elastic_identification()))
    assert len(set(outline.ids)) == len(outline.ids)
    assert set(outline.linked) <= set(outline.ids)
    first = next(attributes for tag, attributes in outline.elements if tag == "a")
    assert (first["class"], first["href"]) == ("skip", "#main")
    assert len(outline.of("main")) == len(outline.of("nav")) == 1
    named = {attributes["aria-labelledby"] for attributes in outline.of("section")}
    assert named <= set(outline.ids)
    for attributes in outline.of("div"):
        if attributes.get("class") == "wide":
            assert attributes["tabindex"] == "0"
            assert attributes["aria-label"]
        if attributes.get("class") == "plot":
            assert attributes["role"] == "img"
            assert attributes["aria-label"]
    for attributes in outline.of("th"):
        assert attributes["scope"] in ("col", "row", "rowgroup")


def test_the_sections_have_their_order() -> None:
    page = render(elastic_identification())
    assert sections(page) == [
        "verdict",
        "rig",
        "parameters",
        "responses",
        "poles",
        "gears",
        "predictions",
        "residuals",
        "interaction",
        "correlations",
        "recordings",
        "warnings",
        "making",
    ]
    contents = re.search(r"<nav.*?</nav>", page, re.DOTALL)
    assert contents is not None
    assert re.findall(r'href="#([^"]+)"', contents[0]) == sections(page)


def test_empty_sections_are_left_out() -> None:
    bare = replace(identification(), stage_warnings=(), checks=(), fitted=())
    assert sections(render(bare)) == ["verdict", "rig", "parameters", "making"]
    assert figures_of(bare) == {}
    assert "<script>" not in render(replace(bare, rigid=None))


def test_page_and_figure_files_have_the_same_figures() -> None:
    one = elastic_identification()
    figures = figures_in(render(one))
    assert list(figures) == list(figures_of(one))
    assert {
        "bode-joint-1",
        "poles-joint-1",
        "record-prbs-j1",
        "correlation-prbs-j1",
        "check-check",
        "tuning-step-j1",
        "fitted-motion",
        "interaction-joint-1-time",
        "interaction-joint-1-spectrum",
        "gear-joint-1-slope",
        "gear-joint-1-torsion",
        "residuals-a1",
        "correlations",
    } == set(figures)
    assert all(re.fullmatch(r"[a-z0-9-]+", name) for name in figures)


def test_every_figure_has_a_unique_name() -> None:
    twice = replace(identification(), checks=(prediction("a b", 90.0), prediction("A/b", 80.0)))
    assert list(figures_of(twice)) == ["check-a-b", "check-a-b-2", "fitted-motion"]


def test_values_intervals_fits_and_missing_values_are_shown() -> None:
    page = render(identification())
    for text in ("0.02010", "0.01970 … 0.02050", "not identified", "saturated", "91.2 %", "97.5 %"):
        assert text in page, text
    assert "nan" not in re.sub(r"<script.*?</script>", "", page, flags=re.DOTALL).lower().replace(
        "provenance", ""
    )


def test_a_value_without_an_interval_is_marked() -> None:
    one = identification()
    assert one.rigid is not None
    bare = Parameter("motor_inertia", 1, 1.5e-4, None, "kg m^2", "rigid")
    page = render(replace(one, rigid=replace(one.rigid, parameters=(bare,))))
    row = re.search(r"<tr><th[^>]*><a[^>]*>motor_<wbr>inertia</a>.*?</tr>", page)
    assert row is not None
    assert "not known" in row[0]


def test_names_are_escaped() -> None:
    evil = '</script><script>alert(1)</script>" onload="alert(1)'
    one = replace(identification(evil), checks=(prediction(evil, 90.0),))
    page = render(one)
    assert evil not in page
    assert "onload" not in {name for _, attributes in Outline(page).elements for name in attributes}
    figures_in(page)


def test_a_name_with_a_hash_is_not_a_link() -> None:
    warning = Diagnostic("no-rigid-model", Place(file="#1.csv"), reason="#2 is at its limit")
    page = render(replace(identification(), stage_warnings=(warning,)))
    assert (
        '<th scope="row" class="text">#1.csv</th><td class="text">#2 is at its limit.</td>' in page
    )


def test_long_records_are_decimated() -> None:
    many = tuple(prediction(f"r{k}", *([90.0] * 8)) for k in range(30))
    page = render(replace(identification(), checks=many))
    assert len(page.encode()) < MOST_BYTES


def test_residual_tests_and_likely_effects_are_shown() -> None:
    parameters = (Parameter("motor_inertia", 1, 1e-4, 1e-6, "kg m^2", "tuned", (0.9e-4, 1.1e-4)),)
    whole_arm = arm_model(parameters, np.array([[1e-12]]))
    page = render(replace(identification(), whole_arm=whole_arm))
    for text in (
        "22 Hz",
        "p &lt; 0.001",
        "delay 6 ms",
        "torque 2.10 ± 0.10",
        "30 %",
        "likely",
        "hysteresis of the gear torque over the torsion",
    ):
        assert text in page, text
    drawn = figures_in(page)["residuals-a1"]
    assert drawn["data"][0]["name"] == "residuals"
    # a logarithmic axis has no zero
    assert min(drawn["data"][0]["x"]) > 0.0
    assert "largest residuals" not in render(identification())


def test_fits_before_and_after_the_fit_are_shown() -> None:
    whole_arm = replace(arm_model((), np.zeros((0, 0))), criticism=None)
    page = render(replace(identification(), whole_arm=whole_arm))
    assert "80.0 % → 99.0 %" in page
    assert "converged, 7 evaluations" in page


def test_the_terminal_summary_has_every_part() -> None:
    from io import StringIO
    from pathlib import Path

    from rich.console import Console

    output = StringIO()
    console = Console(file=output, width=80, highlight=False)
    truth: dict[tuple[str, int | None], float] = {("inertia", 1): 0.02}
    print_summary(identification(), Path("out"), truth=truth, figures=True, console=console)
    printed = output.getvalue()
    for text in (
        "inertia",
        "0.02010",
        "0.00020",
        "+0.50",
        "91.2 %",
        "saturated",
        "out/result.json",
        "out/figures",
    ):
        assert text in printed, text
    assert max(len(line) for line in printed.splitlines()) <= 80


def test_every_parameter_has_its_symbol_and_description() -> None:
    page = render(elastic_identification())
    outline = Outline(page)
    tips = {
        attributes["href"]: attributes["title"]
        for attributes in outline.of("a")
        if attributes.get("title")
    }
    for name in {p.name for p in elastic_identification().parameters}:
        description = parameter_descriptions()[name].description
        assert tips[f"#parameter-{name}"] == description
        assert f"parameter-{name}" in outline.ids
        assert escape(description) in page
    assert "<var>m<sub>M</sub></var>" in page


def test_an_unknown_parameter_has_a_row() -> None:
    page = render(identification("own_name"))
    row = re.search(r"<tr><th[^>]*>own_name</th>.*?</tr>", page)
    assert row is not None
    assert "0.02010" in row[0]


def test_warning_codes_name_their_section_of_the_documentation() -> None:
    page = render(identification())
    assert "<code>saturated</code>" in page
    assert f"<code>{TROUBLESHOOTING_PAGE}</code>" in page
    sections = (ROOT / TROUBLESHOOTING_PAGE).read_text(encoding="utf-8")
    assert [code for code in advice() if f"\n### `{code}`\n" not in sections] == []


def test_sections_are_open_and_fitted_records_are_folded() -> None:
    outline = Outline(render(elastic_identification()))
    folds = outline.of("details")
    closed = [attributes for attributes in folds if "open" not in attributes]
    assert len(folds) - len(closed) == len(outline.of("section"))
    page = render(elastic_identification())
    fitted = re.search(r"<details><summary>Fitted records.*?</details>", page, re.DOTALL)
    assert fitted is not None
    assert re.findall(r'id="figure-([^"]+)"', fitted[0]) == ["tuning-step-j1", "fitted-motion"]


def luminance(colour: str) -> float:
    """Relative luminance by WCAG 2.2."""
    parts = [int(colour[k : k + 2], 16) / 255.0 for k in (1, 3, 5)]
    linear = [p / 12.92 if p <= 0.04045 else ((p + 0.055) / 1.055) ** 2.4 for p in parts]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


def test_status_colours_have_contrast_in_both_themes() -> None:
    """At least 4.5 : 1 (WCAG 2.2, AA) for text on a badge and for coloured text."""
    themes = re.findall(r":root \{(.*?)\}", read_template("document/page.css"), re.DOTALL)
    assert len(themes) == 2
    for theme in themes:
        colours = dict(re.findall(r"--(\w+): (#\w{6})", theme))
        for status in ("good", "doubt", "bad", "ink", "faint"):
            for ground in ("paper", "panel"):
                low, high = sorted(luminance(colours[one]) for one in (status, ground))
                assert (high + 0.05) / (low + 0.05) >= 4.5, (status, ground)
