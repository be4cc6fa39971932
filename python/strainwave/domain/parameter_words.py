"""Symbols and one-line descriptions of parameters.

Symbols are those of docs/notation.md in plain text: `m_M` is m with the index M.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from strainwave.domain.link_sensors import sensor_constants
from strainwave.domain.parameter_table import parameter_table


@dataclass(frozen=True, slots=True)
class ParameterText:
    """Symbol and one-line description of a parameter."""

    symbol: str  # empty: no symbol
    description: str


def parameter_descriptions() -> Mapping[str, ParameterText]:
    """Symbols and descriptions of all parameters in results, by name."""
    words = {p.name: ParameterText(p.symbol, p.description) for p in parameter_table().values()}
    constants = sensor_constants().items()
    return words | {
        n: ParameterText(c.symbol, c.description) for n, c in constants if c.description
    }
