"""Keys of a study file: what checks, forms and documentation know of each.

The ranges are wide: they detect a wrong unit or an inverted ratio, not an unusual machine.
"""

from __future__ import annotations

import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Literal

KeyKind = Literal["number", "numbers", "text", "choice"]


@dataclass(frozen=True, slots=True, kw_only=True)
class StudyKey:
    """One key of a table; `study_keys.toml` describes the fields."""

    key: str  # dotted for a table in the table: "imu.xyz"
    title: str = ""
    kind: KeyKind = "number"
    serial: bool | None = None
    unit: str = ""
    range: Sequence[float] | None = None  # smallest and largest
    other_unit: str = ""
    other_scale: float | None = None
    default: str = ""
    meaning: str = ""


@cache
def study_keys() -> dict[str, tuple[StudyKey, ...]]:
    """Keys by the name of their table."""
    text = Path(__file__).with_name("study_keys.toml").read_text(encoding="utf-8")
    tables = tomllib.loads(text)
    return {name: tuple(StudyKey(**entry) for entry in table) for name, table in tables.items()}


def accepted_range(name: str) -> tuple[float, float]:
    """Smallest and largest value of a key of [arm] or [[joint]]."""
    keys = (*study_keys()["joint"], *study_keys()["arm"])
    low, high = next(key.range for key in keys if key.key == name and key.range)
    return low, high
