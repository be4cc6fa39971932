"""The options of all stages as a form, and its values as arguments of the command line."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, Literal, get_args, get_origin, get_type_hints

from strainwave.domain.options import Options, option_texts
from strainwave.errors import InvalidInput
from strainwave.io.study import with_options
from strainwave.workbench.cached_files import study_at


@dataclass(frozen=True, slots=True)
class OptionRow:
    """One option of the form."""

    name: str  # "links.order"
    text: Mapping[str, str]  # `meaning`, `default` and `reason`
    choices: tuple[str, ...]  # TOML values to choose from; empty: any value
    value: str  # of the study, if it differs from the default


@dataclass(frozen=True, slots=True)
class OptionGroup:
    """The options of one stage."""

    title: str
    rows: tuple[OptionRow, ...]


def option_groups(options: Options) -> list[OptionGroup]:
    """The form of all options, with the values of a study."""
    defaults = asdict(Options())
    groups = []
    for stage, texts in option_texts().items():
        record = getattr(options, stage)
        hints = get_type_hints(type(record), include_extras=False)
        rows = []
        for key, text in texts["options"].items():
            is_default = asdict(options)[stage][key] == defaults[stage][key]
            shown = "" if is_default else _toml(getattr(record, key))
            plain = {kind: words.replace("`", "") for kind, words in text.items()}
            rows.append(OptionRow(f"{stage}.{key}", plain, _choices(hints[key]), shown))
        groups.append(OptionGroup(texts["title"], tuple(rows)))
    return groups


def option_arguments(values: Mapping[str, Any], study_path: Any) -> list[str]:
    """Arguments `--set` of a form's values; empty values are left out.

    Raises InvalidInput if an option is unknown or its value invalid.
    """
    flags = []
    names = {f"{stage}.{key}" for stage, each in option_texts().items() for key in each["options"]}
    for name, value in values.items():
        if name not in names or not isinstance(value, str):
            raise InvalidInput(f"there is no option {name!r}", where="options")
        if value.strip():
            flags.append(f"{name}={value.strip()}")
    with_options(study_at(study_path), flags)
    return [part for flag in flags for part in ("--set", flag)]


def _choices(hint: Any) -> tuple[str, ...]:
    """The values of a literal or of a truth value."""
    parts = get_args(hint) if get_origin(hint) is not Literal else (hint,)
    if hint is bool or bool in parts:
        return ("true", "false")
    for part in (hint, *parts):
        if get_origin(part) is Literal:
            return tuple(str(value) for value in get_args(part))
    return ()


def _toml(value: Any) -> str:
    import tomlkit

    item = tomlkit.item(list(value) if isinstance(value, tuple) else value)
    return str(item.as_string())
