"""The options of all stages as a form, and its values as arguments of the command line.

Singular values from which the order and the horizon of the state-space models are chosen.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Literal, get_args, get_origin, get_type_hints

import numpy as np

from strainwave import pipeline
from strainwave.domain import RecordModel
from strainwave.domain.options import Options, option_texts
from strainwave.errors import InvalidInput, NotIdentifiable
from strainwave.io.study import with_options
from strainwave.presentation.figures import DOTTED, Axis, Colour, Figure, Line, Panel, Upright
from strainwave.presentation.plotly_backend import plotly
from strainwave.workbench.signal_views import study_at


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


_MAX_SHOWN = 24  # singular values; those of the noise follow


def order_figures(path: Path) -> list[dict[str, Any]]:
    """Singular values of the subspace step of each record, with the order and horizon selected.

    Takes as long as the stages rigid and decoupled. Raises NotIdentifiable if no record excites a
    joint with link motion as second output.
    """
    study = study_at(path)
    options = replace(study.options.statespace, method="subspace")
    study = replace(study, options=replace(study.options, statespace=options))
    result = pipeline.identify(study, stages=("rigid", "decoupled"))
    shown = [_entry(record) for record in result.records if record.state_space is not None]
    if not shown:
        raise NotIdentifiable("no record excites a joint such that a state-space model exists")
    return shown


def _entry(record: RecordModel) -> dict[str, Any]:
    model = record.state_space
    assert model is not None
    values = np.asarray(model.singular_values, dtype=float)[:_MAX_SHOWN]
    index = np.arange(1.0, len(values) + 1.0)
    line = Line(index, values / values[0], "singular values", Colour.MEASURED, size=7.0)
    order = Upright(model.order + 0.5, f"order {model.order}", dash=DOTTED)
    axis = Axis("singular value / largest", log=True)
    figure = Figure(Axis("number", step=1.0), (Panel(axis, (line,)),), uprights=(order,))
    return {
        "experiment": record.signals.experiment.name,
        "joint": record.signals.joint,
        "order": model.order,
        "horizon": model.horizon,
        "figure": plotly(figure),
    }
