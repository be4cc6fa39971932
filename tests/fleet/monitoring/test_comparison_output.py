"""Files and terminal output of a comparison."""

from __future__ import annotations

import io
import json
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from compared_results import NAMES, covariance, drawn, estimates
from strainwave.fleet.monitoring import comparison_output as output
from strainwave.fleet.monitoring.comparison import (
    DIFFERS,
    ResultComparison,
    compare,
    print_comparison,
)
from strainwave.report.figures import Markers


def made(factor: float, others: int = 1) -> ResultComparison:
    rng = np.random.default_rng(5)
    results = [estimates(drawn(rng, covariance(rng)), "<january>")]
    for k in range(others):
        changed = {"gear_stiffness 1": factor}
        results.append(estimates(drawn(rng, covariance(rng), changed), f"visit {k}"))
    return compare(results)


def printed(found: ResultComparison, folder: Path | None = None) -> str:
    text = io.StringIO()
    print_comparison(found, folder, console=Console(file=text, width=100, highlight=False))
    return text.getvalue()


def test_the_document_contains_every_test(tmp_path: Path) -> None:
    comparison = made(0.98, others=2)
    output.write(comparison, tmp_path)
    document = json.loads((tmp_path / "comparison.json").read_text())
    assert document["schema"] == "strainwave/comparison/1"
    assert document["differs"] is True
    assert [one["label"] for one in document["results"]] == ["<january>", "visit 0", "visit 1"]
    first = document["pairs"][0]["parameters"][1]
    assert (first["name"], first["joint"], first["verdict"]) == ("gear_stiffness", 1, DIFFERS)
    assert first["z"] == pytest.approx(first["change"] / first["change_std"])
    assert document["pairs"][1]["joint_test"]["rank"] == 4
    assert document["homogeneity"]["degrees_of_freedom"] is None


def test_the_page_escapes_names_and_lists_differences() -> None:
    page = output.render(made(0.98))
    assert "<january>" not in page
    assert "&lt;january&gt;" in page
    assert "The results differ at the level of 5 %: gear_stiffness 1." in page
    for name in NAMES:
        assert name.replace("_", "_<wbr>") in page
    assert "No difference at the level of 5 %." in output.render(made(1.0))


def test_the_terminal_has_a_row_per_parameter_and_the_verdict() -> None:
    text = printed(made(0.98), Path("out"))
    rows = {line[:24].strip(): line for line in text.splitlines()}
    assert rows["gear_stiffness 1"].split()[-1] == DIFFERS
    assert rows["beta"].split()[-1] == "agrees"
    assert "all parameters together:" in text
    assert "verdict: the results differ at the level of 5 %: gear_stiffness 1" in text
    assert "written: out/comparison.html" in text
    assert "verdict: no difference at the level of 5 %" in printed(made(1.0, others=2))


def test_the_figure_shows_all_differences() -> None:
    comparison = made(0.5)
    figure = output.change_figure(comparison, comparison.pairs[0])
    assert figure is not None
    upper, lower = figure.panels
    assert [getattr(mark, "name", "") for mark in upper.marks] == [DIFFERS, "agrees"]
    assert upper.axis.range is not None
    assert upper.axis.range[1] > 50.0
    mark = lower.marks[0]
    assert isinstance(mark, Markers)
    assert mark.x == ("gear_stiffness 1",)
    assert mark.error is not None
    assert mark.error[0] == 1.96
