"""The small arm of the repository, simulated by MuJoCo, and its identification."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import strainwave as sw

FOLDER = Path(__file__).parent / "data" / "small-arm"
STUDY = FOLDER / "study.toml"


@cache
def whole() -> sw.Result:
    """Result of all stages, computed once per process."""
    return sw.identify(STUDY, threads=3)
