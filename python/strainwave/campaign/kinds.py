"""Kinds of cases, and cases as plain JSON values."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from strainwave.campaign.cases import Case
from strainwave.campaign.drawn_arms import DrawnArm
from strainwave.campaign.study_files import StudyFile

KINDS: dict[str, type] = {StudyFile.kind: StudyFile, DrawnArm.kind: DrawnArm}
"""Class of each kind; a worker creates a case from its kind and its fields."""


def to_json(case: Case) -> dict[str, Any]:
    """A case as plain JSON values."""
    return {"kind": case.kind, **vars(case)}


def from_json(values: Mapping[str, Any]) -> Case:
    """The case of the values that `to_json` returns."""
    fields = dict(values)
    case: Case = KINDS[fields.pop("kind")](**fields)
    return case
