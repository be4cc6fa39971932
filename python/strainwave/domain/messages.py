"""Messages: clauses with their values and places, and their text by the template of a code.

`warnings.toml` has all that a reader learns of a warning: messages, meaning and remedy;
`faults.toml` has that of a suspected fault. A template is a format string, whose fields are values
or `[parts]` that templates share. Conversions: `!p` per cent, `!m` thousandths, `!u` millionths,
`!a` a list with commas and "and", `!o` with ", or ", `!e` with ", and ", and `!s` with semicolons.
`|` ends the observation of a warning and is not part of the text.

`plus_minus` and `percent` are the number formats of texts.
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path, PurePath
from string import Formatter
from typing import Any

from strainwave.domain.keys import JointNumber


@dataclass(frozen=True, slots=True)
class Place:
    """Place that a warning or a suspected fault concerns; decisions read its fields."""

    experiments: tuple[str, ...] = ()
    channel: str | None = None
    joint: JointNumber | None = None
    parameter: str | None = None  # name of an estimated parameter
    key: str | None = None  # key of the study file
    file: str | None = None  # path or name of a file
    part: str | None = None  # "arm", "tuning" or a model, if nothing above applies

    @classmethod
    def in_records(cls, *experiments: str, joint: int | None = None) -> Place:
        """Place of one or more records, or of one joint in them."""
        return cls(experiments=experiments, joint=joint)

    @property
    def is_one_record(self) -> bool:
        """Whether the place is one record, or one joint in one record."""
        return len(self.experiments) == 1 and self == Place(self.experiments, joint=self.joint)


@dataclass(frozen=True, slots=True)
class ValueRange:
    """Smallest and largest value of one number in merged warnings."""

    low: float
    high: float

    def __format__(self, spec: str) -> str:
        """The number, or "a to b" if the two differ in this format."""
        low, high = format(self.low, spec), format(self.high, spec)
        return low if low == high else f"{low} to {high}"


@dataclass(frozen=True, slots=True, init=False)
class Clause:
    """A clause or a message: its template, and the values in it.

    A float is a measurement; an int is a number of a joint or a count. A clause as a value is
    rendered in place, a tuple as a list, and None as nothing.
    """

    template: str
    values: tuple[tuple[str, Value], ...]

    def __init__(self, template: str, /, **values: Value) -> None:
        object.__setattr__(self, "template", template)
        object.__setattr__(self, "values", tuple(values.items()))

    @property
    def shape(self) -> Clause:
        """The clause without its measurements; clauses of equal shape can be merged."""
        return Clause(self.template, **{k: _shape_of(v) for k, v in self.values})


Value = float | int | str | Place | ValueRange | Clause | tuple["Value", ...] | None


def _shape_of(value: Value) -> Value:
    if isinstance(value, float):
        return None
    if isinstance(value, Clause):
        return value.shape
    return tuple(map(_shape_of, value)) if isinstance(value, tuple) else value


def merge_clauses(clauses: Sequence[Clause]) -> Clause:
    """Merge clauses of one shape: each measurement becomes its span."""
    columns = zip(*(clause.values for clause in clauses), strict=True)
    merged = {column[0][0]: _merge([value for _, value in column]) for column in columns}
    return Clause(clauses[0].template, **merged)


def _merge(values: Sequence[Value]) -> Value:
    first = values[0]
    if isinstance(first, float):
        numbers = [value for value in values if isinstance(value, float)]
        return ValueRange(min(numbers), max(numbers))
    if isinstance(first, tuple):
        rows = [value for value in values if isinstance(value, tuple)]
        return tuple(map(_merge, zip(*rows, strict=True)))
    if isinstance(first, Clause):
        return merge_clauses([value for value in values if isinstance(value, Clause)])
    return first


STATE_SPACE_MODEL = Place(part="state-space model")
WHOLE_ARM_FIT = Place(part="tuning")


@cache
def catalogue() -> dict[str, dict[str, Any]]:
    """Every warning by its code, as `warnings.toml` has it, the most serious first."""
    warnings: dict[str, dict[str, Any]] = _tables("warnings")["warnings"]
    return warnings


@cache
def fault_codes() -> tuple[str, ...]:
    """Codes of suspected faults of the input."""
    return tuple(_tables("faults")["codes"])


@cache
def templates() -> dict[str, str]:
    """Templates by code, "code/variant", clause or "clause/variant"."""
    of_warnings = {
        f"{code}/{variant}" if variant else code: template
        for code, entry in catalogue().items()
        for variant, template in entry["message"].items()
    }
    return {**of_warnings, **_tables("warnings")["clauses"], **_tables("faults")["templates"]}


@cache
def _tables(name: str) -> dict[str, Any]:
    return tomllib.loads(Path(__file__).with_name(f"{name}.toml").read_text(encoding="utf-8"))


_LINKS = {"a": (", ", " and "), "o": (", or ",) * 2, "e": (", and ",) * 2, "s": ("; ",) * 2}
_SCALES = {"p": 100.0, "m": 1e3, "u": 1e6}


def text_of(clause: Clause, **more: Value) -> str:
    """Text of a clause or a message; `more` has values that it may lack."""
    return _render(templates()[clause.template], more | dict(clause.values))


def observation_of(clause: Clause, **more: Value) -> str:
    """The part of a warning's message that says what was observed."""
    observation = templates()[clause.template].partition("|")[0]
    return _render(observation, more | dict(clause.values))


def place_text(place: Place) -> str:
    """Text of a place: "prbs-j1, joint 1", "beta", "gear_stiffness of joint 1"."""
    name = place.parameter or place.part
    if name is not None:
        return name if place.joint is None else f"{name} of joint {place.joint}"
    records = () if place.channel and len(place.experiments) > 1 else place.experiments
    parts = [place.file, *records, place.channel, place.joint and f"joint {place.joint}"]
    text = ", ".join(str(part) for part in parts if part)
    return f"{text} {place.key or ''}".strip()


def places_text(places: Sequence[Place]) -> str:
    """Text of one or several places."""
    if len(places) > 1 and all(place.parameter for place in places):
        return " and ".join(map(place_text, places))
    if len(places) > 1 and all(place == Place(joint=place.joint) for place in places):
        return f"joint {', '.join(str(place.joint) for place in places)}"
    if len(places) > 1 and all(place.is_one_record for place in places):
        joints = ["" if p.joint is None else f" (joint {p.joint})" for p in places]
        return ", ".join(p.experiments[0] + j for p, j in zip(places, joints, strict=True))
    return ", ".join(map(place_text, places))


def short_place(places: Sequence[Place]) -> str:
    """Text of the places, a file by its name."""
    files = [PurePath(place.file).name for place in places if place.file]
    return ", ".join(files) or places_text(places)


def _render(template: str, values: Mapping[str, Value]) -> str:
    return _Rendering().vformat(template.replace("|", ""), (), values)


class _Rendering(Formatter):
    """Format strings whose values are clauses, places and lists of these."""

    def get_value(self, key: int | str, args: Sequence[Any], kwargs: Mapping[str, Any]) -> Any:
        part = _tables("faults")["parts"].get(key)
        return _render(part, kwargs) if part else super().get_value(key, args, kwargs)

    def convert_field(self, value: Value, conversion: str | None) -> Value | _List:
        if conversion in _LINKS:
            items = value if isinstance(value, tuple) else (value,)
            return _List(items, *_LINKS[conversion])
        scale = _SCALES.get(conversion or "", 1.0)
        if isinstance(value, ValueRange):
            return ValueRange(scale * value.low, scale * value.high)
        return scale * value if conversion and isinstance(value, float | int) else value

    def format_field(self, value: Value | _List, format_spec: str) -> str:
        if isinstance(value, tuple):
            value = _List(value)
        if isinstance(value, _List):
            texts = [self.format_field(item, format_spec) for item in value.items]
            return value.last_link.join(filter(None, [value.link.join(texts[:-1]), *texts[-1:]]))
        if isinstance(value, Clause):
            return text_of(value)
        if isinstance(value, Place):
            return place_text(value)
        return "" if value is None else format(value, format_spec)


@dataclass(frozen=True, slots=True)
class _List:
    items: tuple[Value, ...]
    link: str = ", "
    last_link: str = ", "


UNKNOWN = "not known"


def plus_minus(value: float | None, std: float | None) -> tuple[str, str]:
    """Text of a value and its standard deviation, to the second digit of the standard deviation.

    None and non-finite numbers give `UNKNOWN`. Large and small numbers share one exponent, as in
    ("1.502e-04", "0.012e-04").
    """
    if value is None or not math.isfinite(value):
        return UNKNOWN, UNKNOWN
    if std is None or not math.isfinite(std) or std <= 0.0:
        return f"{value:.4g}", UNKNOWN if std is None or not math.isfinite(std) else "0"
    last = math.floor(math.log10(std)) - 1  # decimal place of std's second digit
    top = max(math.floor(math.log10(max(abs(value), std))), last)
    exponent = top if top < -3 or last > 3 else 0
    digits = max(0, exponent - last)
    suffix = f"e{exponent:+03d}" if exponent else ""
    scale = 10.0**exponent
    return f"{value / scale:.{digits}f}{suffix}", f"{std / scale:.{digits}f}{suffix}"


def percent(fit: float) -> str:
    """A fit [%] with one decimal; `UNKNOWN` if it is not finite."""
    return f"{fit:.1f} %" if math.isfinite(fit) else UNKNOWN
