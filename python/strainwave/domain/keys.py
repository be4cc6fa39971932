"""Keys of parameters, and mappings over them."""

from __future__ import annotations

from collections.abc import Mapping

Key = tuple[str, int | None]
"""Name of a parameter and its joint, from 1; None for parameters of the whole arm."""

Values = dict[Key, float]
"""Parameter values."""

Row = Mapping[Key, float]
"""Weights of a linear combination of parameters."""
