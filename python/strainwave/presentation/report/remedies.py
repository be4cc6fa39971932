"""Meaning and remedy of each warning code, and the order of their severity."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from typing import NamedTuple

from strainwave.domain import Diagnostic
from strainwave.domain.effects import possible_causes
from strainwave.domain.messages import catalogue, short_place
from strainwave.presentation.report.blocks import Block, Cell, Span, paragraph, prose, table

TROUBLESHOOTING_PAGE = "docs/troubleshooting.md"
"""The page with a section for each code."""


class Advice(NamedTuple):
    """Meaning of a warning for the result, and remedy."""

    meaning: str
    remedy: str


def advice() -> Mapping[str, Advice]:
    """Meaning and remedy by code, the most serious first."""
    advice = {
        code: Advice(_plain(entry["meaning"]), _plain(entry["remedy"]))
        for code, entry in catalogue().items()
    }
    effects = {
        effect.warning_code: Advice(f"Without this effect, {effect.consequence}.", effect.remedy)
        for effect in possible_causes()
    }
    of_result = [c for c, entry in catalogue().items() if entry["severity"] == "result"]
    return {code: advice[code] for code in of_result} | effects | advice


def is_note(code: str) -> bool:
    """Whether a warning requires no action."""
    entry = catalogue().get(code, {})
    return bool(entry.get("is_note", entry.get("severity") == "scope"))


def _plain(markdown: str) -> str:
    """Text without the marks of code and links."""
    return re.sub(r"\[([^]]*)\]\([^)]*\)", r"\1", markdown).replace("`", "")


def most_serious(warnings: Iterable[Diagnostic]) -> Diagnostic:
    """The first of the most serious warnings; there must be at least one."""
    return by_severity(warnings)[0]


def by_severity(warnings: Iterable[Diagnostic]) -> list[Diagnostic]:
    """The most serious first; of equal severity in their order."""
    codes = list(advice())
    return sorted(warnings, key=lambda warning: codes.index(warning.code))


def warnings_table(warnings: Iterable[Diagnostic]) -> Iterator[Block]:
    """Observation, meaning and remedy of every warning, the most serious first."""
    codes = advice()
    ordered = by_severity(warnings)
    rows = [
        (
            prose(place_of(w)),
            prose(sentence(w.message)),
            prose(codes[w.code].meaning),
            prose(codes[w.code].remedy),
            Cell(w.code, "code"),
        )
        for w in ordered
    ]
    heads = ("where", "observed", "meaning", "what to do", "code")
    yield from table("Warnings", heads, rows, heading=False)
    if rows:
        yield paragraph("Each code has a section in ", Span(TROUBLESHOOTING_PAGE, kind="code"), ".")


def sentence(text: str) -> str:
    """Text with a capital letter and a full stop; a name at the beginning stays as it is."""
    first = text.split(" ", 1)[0]
    is_word = first.isalpha() and first.islower()
    text = text[:1].upper() + text[1:] if is_word else text
    return text if text.endswith((".", "?", "!")) else f"{text}."


def place_of(warning: Diagnostic) -> str:
    """The place of a warning; a file by its name, since its folder is at the end of the page."""
    return short_place(warning.places)
