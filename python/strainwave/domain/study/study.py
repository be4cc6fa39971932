"""A study: an arm and its experiments, and what checks, forms and documentation know of its keys.

`strainwave.io.study` checks the constraints of `annotated_types`. The ranges of the keys are wide:
they detect a wrong unit or an inverted ratio, not an unusual machine.
"""

from __future__ import annotations

import tomllib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from annotated_types import Ge, MinLen

from strainwave.domain.arm.consistent_links import standard_parameters
from strainwave.domain.arm.description import ArmDescription, Positive, Vector
from strainwave.domain.arm.link_sensors import link_channel_kinds
from strainwave.domain.keys import JointNumber
from strainwave.domain.study.options import Options

KeyKind = Literal["number", "numbers", "text", "choice"]


@dataclass(frozen=True, slots=True, kw_only=True)
class StudyKey:
    """One key of a table; `study_keys.toml` describes the fields."""

    key: str  # dotted for a table in the table: "imu.xyz"
    title: str = ""
    kind: KeyKind = "number"
    serial: bool | None = None
    unit: str = ""
    range: Sequence[float] | None = None  # smallest and largest
    other_unit: str = ""
    other_scale: float | None = None
    default: str = ""
    meaning: str = ""


@cache
def study_keys() -> dict[str, tuple[StudyKey, ...]]:
    """Keys by the name of their table."""
    text = Path(__file__).with_name("study_keys.toml").read_text(encoding="utf-8")
    tables = tomllib.loads(text)
    return {name: tuple(StudyKey(**entry) for entry in table) for name, table in tables.items()}


def accepted_range(name: str) -> tuple[float, float]:
    """Smallest and largest value of a key of [arm] or [[joint]]."""
    keys = (*study_keys()["joint"], *study_keys()["arm"])
    low, high = next(key.range for key in keys if key.key == name and key.range)
    return low, high


Use = Literal["motion", "frequency", "sweep", "tuning", "check"]
Control = Literal["open", "servo"]
Meaning = Literal["motor", "sensor", "without-gravity", "without-friction", "desired"]
"""What a torque channel measures: the motor, or a sensor behind the gear."""


@dataclass(frozen=True, slots=True)
class Channel:
    """Source of a channel in a table: value = scale * column + offset."""

    column: str
    scale: float = 1.0
    offset: float = 0.0
    meaning: Meaning = "motor"
    second_column: str | None = None  # of t: fractions of a second, or the time of day of a date

    @property
    def columns(self) -> tuple[str, ...]:
        """All columns of the channel."""
        return tuple(filter(None, (self.column, self.second_column)))


@dataclass(frozen=True, slots=True)
class TopicChannel:
    """Source of a channel in a bag: one number of each message of a topic."""

    topic: Annotated[str, MinLen(1)]
    field: Annotated[str, MinLen(1)]  # path in the message: "position", "data[0]", "a.b.c"
    name: str | None = None  # of the joint, if the field has one number per joint
    scale: float = 1.0
    offset: float = 0.0
    meaning: Meaning = "motor"

    @property
    def channel(self) -> Channel:
        """The channel with the column name that the bag's reader assigns."""
        joint = "" if self.name is None else f"[{self.name}]"
        return Channel(f"{self.topic}.{self.field}{joint}", self.scale, self.offset, self.meaning)


@dataclass(frozen=True, slots=True)
class Prbs:
    """Maximum-length pseudo-random binary sequence of `2**order - 1` clocks."""

    order: Annotated[int, Ge(2)]
    clock: Positive  # [s]
    periods: Annotated[int, Ge(1)]
    amplitude: Positive  # [V]


@dataclass(frozen=True, slots=True)
class Payload:
    """Known point mass on the last link of a chain."""

    mass: Positive  # [kg]
    xyz: Vector = (0.0, 0.0, 0.0)  # [m] centre of mass in the last link's frame

    @property
    def parameters(self) -> tuple[float, ...]:
        """Its ten standard parameters, in the order of the core."""
        return standard_parameters(self.mass, np.array(self.xyz), np.zeros((3, 3)))


@dataclass(frozen=True, slots=True)
class Experiment:
    """One log file and its use: `[[experiment]]`."""

    name: Annotated[str, MinLen(1)]
    # relative to the study file; "" if the data are passed in memory
    file: Annotated[str, MinLen(1)]
    use: Use
    control: tuple[Control, ...]  # one per joint
    joint: Annotated[JointNumber, Ge(1)] | None = None  # the excited joint
    prbs: Prbs | None = None
    start: float | None = None  # [s]
    stop: float | None = None  # [s]
    add: Mapping[str, str] = field(default_factory=dict)  # channel -> column added to it
    payload: Payload | None = None  # of serial arms

    def segment(self, number: int) -> Experiment:
        """One of several segments of the record, from 1."""
        return replace(self, name=f"{self.name}/{number}")


@dataclass(frozen=True, slots=True, kw_only=True)
class Study:
    """An arm and its experiments: a checked study file, or a study built in memory."""

    arm: ArmDescription
    experiments: tuple[Experiment, ...]
    channels: Mapping[str, Channel] = field(default_factory=dict)
    sample_rate: float | None = None  # [Hz] of logs without time stamps
    options: Options = field(default_factory=Options)  # `[options]`
    path: Path = Path("study")  # of the file; log paths are relative to its folder
    sha256: str = ""  # of the file

    def with_segments(self, experiments: Iterable[Experiment]) -> Study:
        """The study with the experiments of its logs: one per segment of a record with pauses."""
        return replace(self, experiments=tuple(experiments))

    def log_path(self, experiment: Experiment) -> Path:
        """Path of an experiment's log."""
        return self.path.parent / experiment.file


def channel_kinds() -> tuple[str, ...]:
    """Channels of each joint. The channel `t` belongs to the whole record."""
    return ("u", "torque", "theta_m", "omega_m", *link_channel_kinds(), "ref", "temperature")


def channel_names(count: int) -> tuple[str, ...]:
    """All channels that an arm of `count` joints can have."""
    return ("t", *(f"{name}{i}" for name in channel_kinds() for i in range(1, count + 1)))


def channel_parts(name: str) -> tuple[str, int]:
    """Kind and joint of a channel: ("theta_m", 2) of "theta_m2"; joint 0 of "t"."""
    kind = name.rstrip("0123456789")
    return kind, int(name[len(kind) :] or 0)
