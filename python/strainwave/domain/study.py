"""What was measured, on what arm, and how; `strainwave.io.study` checks the `annotated_types`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

from annotated_types import Ge, MinLen

from strainwave.domain.arm import ArmDescription, Positive
from strainwave.domain.options import Options

Use = Literal["motion", "frequency", "sweep", "tuning", "check"]
Control = Literal["open", "servo"]


@dataclass(frozen=True, slots=True)
class Channel:
    """Where a channel comes from: value = scale * column + offset."""

    column: str
    scale: float = 1.0
    offset: float = 0.0


@dataclass(frozen=True, slots=True)
class TopicChannel:
    """Where a channel comes from in a bag: a number in each message of a topic."""

    topic: Annotated[str, MinLen(1)]
    field: Annotated[str, MinLen(1)]  # as in a message: "position", "data[0]", "a.b.c"
    name: str | None = None  # of the joint, where the field has one number a joint
    scale: float = 1.0
    offset: float = 0.0

    @property
    def channel(self) -> Channel:
        """The same, with the name that the bag's reader gives to the column."""
        at = "" if self.name is None else f"[{self.name}]"
        return Channel(f"{self.topic}.{self.field}{at}", self.scale, self.offset)


@dataclass(frozen=True, slots=True)
class Prbs:
    """A maximum-length binary sequence, `2**order - 1` clocks long."""

    order: Annotated[int, Ge(2)]
    clock: Positive  # [s]
    periods: Annotated[int, Ge(1)]
    amplitude: Positive  # [V]


@dataclass(frozen=True, slots=True)
class Experiment:
    """One log file and what it is for: `[[experiment]]`."""

    name: Annotated[str, MinLen(1)]
    file: Annotated[str, MinLen(1)]  # beside the study file; "" in code that gives the data
    use: Use
    control: tuple[Control, ...]  # one per joint
    joint: Annotated[int, Ge(1)] | None = None  # the excited joint, from 1
    prbs: Prbs | None = None
    start: float | None = None  # [s]
    stop: float | None = None  # [s]
    add: Mapping[str, str] = field(default_factory=dict)  # channel -> column added to it


@dataclass(frozen=True, slots=True, kw_only=True)
class Study:
    """An arm and its experiments: a whole study file, checked, or what a program puts together."""

    arm: ArmDescription
    experiments: tuple[Experiment, ...]
    channels: Mapping[str, Channel] = field(default_factory=dict)
    options: Options = field(default_factory=Options)  # of the stages: `[options]`
    path: Path = Path("study")  # of the file, beside which the logs lie
    sha256: str = ""  # of the file

    def log_path(self, experiment: Experiment) -> Path:
        """Where an experiment's log lies: beside the study file."""
        return self.path.parent / experiment.file


CHANNELS = (
    *("u", "torque", "theta_m", "omega_m", "a", "theta_l", "deflection", "gyro", "ref"),
    *("ax", "ay", "az", "gx", "gy", "gz"),  # of an IMU
)
"""Channels there is one of per joint; `t` stands alone."""


def channel_names(count: int) -> tuple[str, ...]:
    """Every channel an arm of `count` joints can have."""
    return ("t", *(f"{name}{i}" for name in CHANNELS for i in range(1, count + 1)))
