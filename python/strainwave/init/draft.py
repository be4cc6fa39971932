"""Drafts of study files: tables with values that are TODO."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from strainwave.domain import ArmDescription
from strainwave.domain.arm import gear_laws
from strainwave.errors import InvalidInput
from strainwave.io.study.reader import Reader

TODO = "TODO"
"""What stands in place of a value that a draft cannot know."""

Place = tuple[str | int, ...]
"""Names of tables and keys, and positions in arrays of tables, from 0."""

_PLACING = ("origin", "axis", "motion", "name", "accelerometer_distance", "imu")  # keys of a joint
_ASSUMED_LENGTH = 1.0  # [m] of link 1 while its length is missing


def has_todo(value: Any) -> bool:
    """Whether a value, or a part of it, is TODO."""
    return next(todo_places(value, ()), None) is not None


def todo_places(value: Any, place: Place) -> Iterator[Place]:
    """Places of TODO values; a list of values is one."""
    if isinstance(value, Mapping):
        for key, each in value.items():
            yield from todo_places(each, (*place, key))
    elif isinstance(value, list) and any(isinstance(each, Mapping) for each in value):
        for index, each in enumerate(value):
            yield from todo_places(each, (*place, index))
    elif value == TODO or (isinstance(value, list) and TODO in value):
        yield place


def placed_arm(document: Mapping[str, Any], path: Path) -> tuple[ArmDescription, str]:
    """The arm as far as the study places it, and what its picture assumes.

    Raises InvalidInput if the kind is missing, or if a value that places a joint is wrong.
    """
    known, note = _known(document), ""
    arm, joints = known.get("arm"), known.get("joint")
    is_table = isinstance(joints, list) and all(isinstance(joint, dict) for joint in joints)
    if not isinstance(arm, dict) or not is_table:
        raise InvalidInput("there is no [arm] or [[joint]] table", where=str(path))
    if arm.get("kind") == "planar-two-link" and "link_length" not in arm:
        arm = {**arm, "link_length": _ASSUMED_LENGTH}
        note = f"Link 1 is drawn {_ASSUMED_LENGTH:g} m long: its length is missing."
    elif arm.get("kind") == "serial" and "urdf" not in arm:
        origins = [joint.get("origin") for joint in joints]
        placeless = [
            k for k, at in enumerate(origins, 1) if not isinstance(at, dict) or "xyz" not in at
        ]
        if placeless:
            note = f"No position is given of joint {', '.join(map(str, placeless))}: see Placement."
    placed = [{key: joint[key] for key in _PLACING if key in joint} for joint in joints]
    tables = [{"spring": gear_laws.RIGID, "gear_ratio": 1.0, **joint} for joint in placed]
    reader = Reader(path, "")
    return reader.study({"arm": arm, "joint": tables}, "", experiments_exist=False).arm, note


def _known(value: Any) -> Any:
    """A value without the tables' keys that are TODO; None if it is TODO."""
    if isinstance(value, dict):
        return {key: each for key, old in value.items() if (each := _known(old)) is not None}
    if isinstance(value, list) and all(isinstance(each, dict) for each in value):
        return [_known(each) for each in value]
    return None if has_todo(value) else value
