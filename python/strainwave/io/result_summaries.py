"""What a table of runs shows of a result.json.

A file is read once while it stays as it is, and a damaged one affects its own row only.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass, field
from functools import cache, lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from strainwave.domain import Parameter
from strainwave.domain.study import Options
from strainwave.errors import InvalidInput
from strainwave.io.atomic_files import read_small
from strainwave.io.result_entries import CheckEntry

if TYPE_CHECKING:
    from pydantic import TypeAdapter

_MAX_BYTES = 64 << 20  # of a result; those of large arms have some 10 MiB
_MAX_KEPT = 2000  # summaries
_MAX_COLUMNS = 4  # of several parameters, unless the reader chooses more
_KEY_PARAMETERS = (
    *("gear_stiffness", "link_inertia", "inertia"),
    *("motor_coulomb_friction", "rigid_inertia", "motor_viscous_friction"),
)
"""The first of these that results have are the columns of a table."""


@dataclass(frozen=True, slots=True)
class Summary:
    """A result in one row."""

    parameters: Mapping[str, Parameter] = field(default_factory=dict)  # by label
    worst_fit: float | None = None  # [%], of all channels of the check records
    mean_fit: float | None = None
    options: Mapping[str, str] = field(default_factory=dict)  # TOML values, not the defaults
    rig: Mapping[str, str] = field(default_factory=dict)  # TOML values of the study, by place
    fault: str = ""  # why the result has no summary


@dataclass(frozen=True, slots=True)
class _Result:
    parameters: tuple[Parameter, ...]
    checks: tuple[CheckEntry, ...] = ()
    options: dict[str, Any] = field(default_factory=dict)
    study: dict[str, Any] = field(default_factory=dict)


def summary_of(result: Path) -> Summary:
    """The summary of a result.json; an empty one if there is none, or if it is a link."""
    try:
        status = result.lstat()
    except OSError:
        return Summary()
    return Summary() if result.is_symlink() else _read(result, status.st_size, status.st_mtime_ns)


@lru_cache(maxsize=_MAX_KEPT)
def _read(path: Path, _size: int, _time: int) -> Summary:
    try:
        result = _adapter().validate_json(read_small(path, path.name, _MAX_BYTES))
        fits = [
            fit for check in result.checks for fit in check.fit_percent.values() if fit is not None
        ]
        return Summary(
            {one.label: one for one in result.parameters},
            min(fits, default=None),
            sum(fits) / len(fits) if fits else None,
            changed_options(result.options),
            {
                place: text
                for table in ("arm", "joint", "transmission", "servo")
                for place, text in _values(result.study.get(table), table)
            },
        )
    except InvalidInput as error:
        return Summary(fault=f"{path.name} {error.problem.removeprefix(path.name).strip()}")
    except (ValueError, RecursionError):
        return Summary(fault=f"{path.name} is damaged")


def key_parameters(parameters: Iterable[Parameter]) -> list[str]:
    """Labels of the first of the key parameters, each with all joints."""
    known = {each.label: each.name for each in parameters}
    columns: list[str] = []
    for name in _KEY_PARAMETERS:
        group = [label for label, own in known.items() if own == name]
        if not columns or len(columns) + len(group) <= _MAX_COLUMNS:
            columns += group
    return columns


def changed_options(options: Mapping[str, Any]) -> dict[str, str]:
    """TOML values of the options that differ from the defaults, by name: "links.order"."""
    defaults = dict(_named(json.loads(json.dumps(asdict(Options())))))
    named = _named(json.loads(json.dumps(options)))
    return {name: toml_text(value) for name, value in named if value != defaults.get(name, value)}


def _named(options: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    for stage, table in options.items():
        if isinstance(table, dict):
            yield from ((f"{stage}.{key}", value) for key, value in table.items())
        else:
            yield stage, table


def toml_text(value: Any) -> str:
    """A TOML value; those of JSON are the same except for tables."""
    if isinstance(value, Mapping):
        return f"{{{', '.join(f'{json.dumps(k)} = {toml_text(v)}' for k, v in value.items())}}}"
    return json.dumps(value)


def _values(value: object, place: str) -> Iterator[tuple[str, str]]:
    """Values of nested tables by place; tables in a list have numbers: "joint 1 gear_ratio"."""
    if isinstance(value, dict):
        for key, each in value.items():
            yield from _values(each, f"{place} {key}")
    elif isinstance(value, list) and all(isinstance(each, dict) for each in value):
        for number, each in enumerate(value, start=1):
            yield from _values(each, f"{place} {number}")
    else:
        yield place, toml_text(value)


@cache
def _adapter() -> TypeAdapter[_Result]:
    from pydantic import TypeAdapter

    return TypeAdapter(_Result)
