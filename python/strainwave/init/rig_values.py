"""Values of a rig from the text of another study file or of a data sheet with the same tables."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path
from typing import Any

from strainwave.domain.steps import files_named
from strainwave.errors import InvalidInput
from strainwave.init.changes import (
    KeyChange,
    columns_of,
    parse_draft,
    table_of,
    tables_of,
)
from strainwave.init.draft import TODO

_TABLES = ("arm", "servo", "transmission")
_OWN = ("kind", "urdf", "held")  # keys of [arm] that follow from the logs and the URDF


def rig_changes(text: str, values: str, columns: Collection[str], path: Path) -> list[KeyChange]:
    """Changes of a study that give it the values of another, whose text is TOML or JSON.

    Values that are TODO, and channels whose `columns` no log has, are not taken. Raises
    InvalidInput if there are no values, or if they describe another number of joints.
    """
    document, source = parse_draft(text, path).unwrap(), _parse(values)
    joints, own = tables_of(source, "joint"), tables_of(document, "joint")
    if joints and len(joints) != len(own):
        raise InvalidInput(
            f"the values are those of {len(joints)} joint(s), and this arm has {len(own)}",
            remedy="choose the values of the same arm",
        )
    tables: list[tuple[Any, ...]] = [
        ((name,), table_of(source, name), table_of(document, name)) for name in _TABLES
    ]
    tables += [(("joint", k), *pair) for k, pair in enumerate(zip(joints, own, strict=False))]
    channels = {
        name: entry
        for name, entry in table_of(source, "channels").items()
        if name == "sample_rate" or set(columns).issuperset(columns_of(entry) or [""])
    }
    tables.append((("channels",), channels, table_of(document, "channels")))
    if not any(values for _, values, _ in tables):
        raise InvalidInput(
            "there are no values of a rig",
            remedy="use a study file, or a data sheet with the tables [arm], [[joint]], [servo]",
        )
    return [
        KeyChange((*place, key), value)
        for place, values, present in tables
        for key, value in values.items()
        if value not in (None, present.get(key)) and TODO not in str(value)
        if place != ("arm",) or key not in _OWN
    ]


def is_study_of(text: str, names: Collection[str]) -> bool:
    """Whether a text is a study file, and all files that it names are among `names`."""
    try:
        document = _parse(text)
    except InvalidInput:
        return False
    return bool(tables_of(document, "experiment")) and set(files_named(document)) <= set(names)


def _parse(text: str) -> dict[str, Any]:
    """The tables of a study file with TODO values, or of JSON."""
    from pydantic_core import from_json

    try:
        value = from_json(text) if text.lstrip().startswith("{") else None
    except ValueError as error:
        raise InvalidInput(f"the values are no valid JSON ({error})") from error
    return value if isinstance(value, dict) else parse_draft(text, Path("values")).unwrap()
