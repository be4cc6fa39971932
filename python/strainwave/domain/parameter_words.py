"""Symbols and one-line descriptions of parameters.

Symbols are those of docs/notation.md in plain text: `m_M` is m with the index M.
"""

from __future__ import annotations

from collections.abc import Mapping

from strainwave.domain.link_sensors import SensorConstant, sensor_constants
from strainwave.domain.parameter_table import ParameterDescription, parameter_table


def parameter_descriptions() -> Mapping[str, ParameterDescription | SensorConstant]:
    """Parameters and sensor constants in results by name, with symbol and description."""
    return {
        **parameter_table(),
        **{name: c for name, c in sensor_constants().items() if c.description},
    }
