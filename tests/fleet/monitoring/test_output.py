"""Output functions for comparisons and trends."""

from __future__ import annotations

import io

import pytest
from rich.console import Console

from strainwave.fleet.monitoring import output
from strainwave.fleet.monitoring.significance import format_p
from strainwave.report.document.blocks import table


@pytest.mark.parametrize(
    ("p", "text"), [(1.0, "1"), (0.0312, "0.031"), (2.2e-6, "2e-06"), (0.0, "<1e-16")]
)
def test_p_values_as_text(p: float, text: str) -> None:
    assert format_p(p) == text


@pytest.mark.parametrize("width", [20, 60])
def test_tables_are_never_truncated(width: int) -> None:
    text = io.StringIO()
    rows = [("motor_viscous_friction 1", "1.234567e-04")]
    tables = table("Parameters", ("parameter", "value"), rows)
    output.print_tables(Console(file=text, width=width), tables)
    assert "motor_viscous_friction 1 1.234567e-04" in text.getvalue()
