"""Figures of a report file, which has them as JSON."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

_MAX_BYTES = 64 << 20  # of a report


def report_figures(path: Path) -> dict[str, dict[str, Any]]:
    """`title`, `data` and `layout` of the figures of a report, by key.

    Empty if the file is missing, damaged or no report. Reports of earlier versions have no titles.
    """
    try:
        text = path.read_text(encoding="utf-8") if path.stat().st_size <= _MAX_BYTES else ""
        json_text = text.partition(' id="figures">')[2].partition("</script>")[0]
        figures: dict[str, dict[str, Any]] = json.loads(json_text or "{}")
    except (OSError, ValueError):
        return {}
    return {
        key: {"title": key} | figure
        for key, figure in figures.items()
        if isinstance(figure, dict) and isinstance(figure.get("data"), list)
    }
