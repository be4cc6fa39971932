"""Blocks become HTML elements: empty tables vanish, figure keys are unique, text is escaped."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from jinja2 import UndefinedError

from strainwave.report.document.blocks import (
    Block,
    Callout,
    Cell,
    Facts,
    Fold,
    Plot,
    Row,
    RowGroup,
    Section,
    Span,
    document,
    fill_template,
    keyed,
    number,
    paragraph,
    read_figures,
    table,
    typeset,
)
from strainwave.report.figures import Axis, Figure, Panel
from strainwave.report.plotly_backend import plotly

FIGURES_START = '<script type="application/json" id="figures">'
EVIL = '</p><script>alert(1)</script>" onload="alert(1)'


def body(*sections: Section) -> str:
    page = document("title", "subtitle", sections)
    match = re.search(r"<main.*</main>", page, re.DOTALL)
    assert match is not None
    return re.sub(r"\s+", " ", match[0])


def test_a_table_without_rows_is_left_out() -> None:
    assert list(table("label", ("a",), [])) == []
    (result,) = table("label", ("a", number("b")), [("x", number("1"))])
    assert [cell.kind for cell in result.heads] == ["", "number"]


def test_sections_without_blocks_are_left_out() -> None:
    assert "<section" not in body(Section("empty", "Empty", ()))


def test_nested_figures_have_unique_keys() -> None:
    plot = Plot("a b", "label", Figure(Axis("x"), (Panel(Axis("y"), ()),)))
    inside = Fold("more", (Callout("", (Plot("A/b", "again", plot.figure),)),))
    result = keyed([Section("one", "One", (plot,)), Section("two", "Two", (inside,))])
    assert {key: one.label for key, one in result.items()} == {"a-b": "label", "a-b-2": "again"}


def test_each_kind_of_block_becomes_its_elements() -> None:
    cells = (Cell("7", "number", href="#there", mark="bad"), "plain")
    rows: list[Row | RowGroup] = [RowGroup("arm"), ("alpha", *cells)]
    page = body(
        Section(
            "there",
            "There",
            (
                paragraph(
                    Span("lead", strong=True, mark="good"), " and ", Span("on", href="#there")
                ),
                *table("numbers", ("name", number("value"), "else"), rows),
                Facts((("term", "fact"),)),
                Fold("more", (paragraph("inside"),)),
                Callout("doubt", (paragraph("careful"),)),
                paragraph(Span("Determined", kind="badge", mark="good")),
            ),
        )
    )
    for part in (
        '<p><strong class="good">lead</strong> and <a href="#there">on</a></p>',
        '<th scope="col" class="number">value</th>',
        '<th scope="rowgroup" colspan="3">arm</th>',
        '<th scope="row">alpha</th><td class="number bad"><a href="#there">7</a></td><td>plain</td>',
        "<dt>term</dt><dd>fact</dd>",
        "<summary>more</summary> <p>inside</p>",
        '<div class="verdict doubt"> <p>careful</p>',
        '<span class="badge good">Determined</span>',
    ):
        assert part in page, part


def test_every_text_is_escaped() -> None:
    blocks: tuple[Block, ...] = (
        paragraph(EVIL, Span(EVIL, strong=True)),
        *table(EVIL, (EVIL,), [RowGroup(EVIL), (EVIL,)]),
        Facts(((EVIL, EVIL),)),
        Fold(EVIL, (Plot(EVIL, EVIL, Figure(Axis("x"), (Panel(Axis("y"), ()),)), EVIL),)),
    )
    page = document(EVIL, EVIL, [Section("one", EVIL, blocks)], before=(paragraph(EVIL),))
    assert "<script>alert" not in page
    assert 'onload="' not in page


def test_the_figures_of_a_page_are_read_from_it(tmp_path: Path) -> None:
    plot = Plot("a", EVIL, Figure(Axis("x"), (Panel(Axis(EVIL), ()),)))
    path = tmp_path / "report.html"
    path.write_text(document(EVIL, EVIL, [Section("one", "One", (plot,))]), encoding="utf-8")
    assert read_figures(path) == {"a": {"title": EVIL, **plotly(plot.figure)}}


@pytest.mark.parametrize(
    "text", ["", "<html>", f"{FIGURES_START}{{", f"{FIGURES_START}[]", "\udcff"]
)
def test_a_damaged_page_has_no_figures(tmp_path: Path, text: str) -> None:
    path = tmp_path / "report.html"
    path.write_bytes(text.encode("utf-8", "surrogateescape"))
    assert read_figures(path) == {}
    assert read_figures(tmp_path / "missing.html") == {}


def test_a_missing_template_value_is_an_error() -> None:
    with pytest.raises(UndefinedError, match="tables"):
        fill_template("notebook/table", head="", columns=())


@pytest.mark.parametrize(
    ("symbol", "html"),
    [
        ("m_M", "m<sub>M</sub>"),
        ("K1", "K<sub>1</sub>"),
        ("alpha", "α"),  # noqa: RUF001
        ("delta_h", "δ<sub>h</sub>"),
        ("D", "D"),
        ("<", "&lt;"),
        ("", ""),
    ],
)
def test_symbols_are_typeset(symbol: str, html: str) -> None:
    assert str(typeset(symbol)) == html
