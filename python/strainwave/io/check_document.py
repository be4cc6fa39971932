"""An input check as plain JSON values."""

from __future__ import annotations

from typing import Any

from strainwave import __version__
from strainwave.domain import InputCheck
from strainwave.io.results import plain, suspicion_entries


def check_document(check: InputCheck) -> dict[str, Any]:
    """An input check as plain JSON values, in the layout of docs/result.md."""
    relations = [
        {
            "relation": each.kind,
            "where": each.where,
            "measured": each.measured,
            "std": each.std,
            "expected": each.expected,
            "accuracy": each.accuracy,
            "bound": each.bound,
            "consistent": each.is_consistent,
        }
        for each in check.relations
    ]
    document = {
        "schema": "strainwave/check/1",
        "version": __version__,
        "study": {"path": str(check.study.path), "sha256": check.study.sha256},
        "status": check.status,
        "relations": relations,
        "suspected": suspicion_entries(check.suspected),
        "unchecked": check.unchecked,
        "warnings": check.warnings,
        "seconds": check.seconds,
    }
    values: dict[str, Any] = plain(document)
    return values
