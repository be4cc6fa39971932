"""Kinds of cases, and a case as plain JSON values, from which any process makes it again."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from strainwave.campaign.cases import Case
from strainwave.campaign.drawn_arms import DrawnArm
from strainwave.campaign.study_files import StudyFile

KINDS: dict[str, type] = {StudyFile.kind: StudyFile, DrawnArm.kind: DrawnArm}
"""Kinds of cases by name; a worker makes a case again from its kind and its fields."""


def to_json(case: Case) -> dict[str, Any]:
    """A case as plain JSON values.

    Parameters
    ----------
    case : Case

    Returns
    -------
    dict
    """
    return {"kind": case.kind, **case.fields()}


def from_json(values: Mapping[str, Any]) -> Case:
    """The case that `to_json` was given.

    Parameters
    ----------
    values : mapping

    Returns
    -------
    Case
    """
    own = dict(values)
    case: Case = KINDS[own.pop("kind")](**own)
    return case
