"""Data of messages: places, and clauses with their values; `domain.messages` renders them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Place:
    """Place that a warning or a suspected fault concerns; decisions read its fields."""

    experiments: tuple[str, ...] = ()
    channel: str | None = None
    joint: int | None = None  # from 1
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
class Span:
    """Smallest and largest value of one number in merged warnings."""

    low: float
    high: float

    def __format__(self, spec: str) -> str:
        """The number, or "a to b" if the two differ in this format."""
        low, high = format(self.low, spec), format(self.high, spec)
        return low if low == high else f"{low} to {high}"


@dataclass(frozen=True, slots=True, init=False)
class Clause:
    """A clause or a message: its template in `domain.messages`, and the values in it.

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


Value = float | int | str | Place | Span | Clause | tuple["Value", ...] | None


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
        return Span(min(numbers), max(numbers))
    if isinstance(first, tuple):
        rows = [value for value in values if isinstance(value, tuple)]
        return tuple(map(_merge, zip(*rows, strict=True)))
    if isinstance(first, Clause):
        return merge_clauses([value for value in values if isinstance(value, Clause)])
    return first


STATE_SPACE_MODEL = Place(part="state-space model")
WHOLE_ARM_FIT = Place(part="tuning")
