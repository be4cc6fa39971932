"""Figures of a report file, which has them as JSON, with their titles."""

from __future__ import annotations

import json
from dataclasses import dataclass
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

_PREFIX = "figure-"  # of the ids of figures
_MAX_BYTES = 64 << 20  # of a report


@dataclass(frozen=True, slots=True)
class ReportFigure:
    """A figure of a report."""

    title: str
    figure: dict[str, Any]  # `data` and `layout`


class _Reader(HTMLParser):
    """Collects titles of figures, and the text of the script element with their data."""

    def __init__(self) -> None:
        super().__init__()
        self.titles: dict[str, str] = {}
        self.json: list[str] = []
        self._reads_json = False

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        values = dict(attrs)
        name = values.get("id") or ""
        if tag == "div" and name.startswith(_PREFIX):
            label = values.get("aria-label") or name
            self.titles[name.removeprefix(_PREFIX)] = label.split(". ")[0]
        self._reads_json = tag == "script" and name == "figures"

    def handle_endtag(self, tag: str) -> None:
        self._reads_json = False

    def handle_data(self, data: str) -> None:
        if self._reads_json:
            self.json.append(data)


def report_figures(path: Path) -> dict[str, ReportFigure]:
    """Figures of a report by key; empty if the file is missing, damaged or no report."""
    try:
        if path.stat().st_size > _MAX_BYTES:
            return {}
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError):
        return {}
    reader = _Reader()
    reader.feed(_without_scripts(text))
    try:
        figures = json.loads("".join(reader.json) or "{}")
    except ValueError:
        return {}
    return {
        key: ReportFigure(reader.titles.get(key, key), figure)
        for key, figure in figures.items()
        if isinstance(figure, dict) and isinstance(figure.get("data"), list)
    }


def _without_scripts(text: str) -> str:
    """The page up to the end of the figures; the scripts behind them are megabytes."""
    start = text.find('id="figures"')
    end = text.find("</script>", start)
    return text[: end + len("</script>")] if start >= 0 and end >= 0 else text
