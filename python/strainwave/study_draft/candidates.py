"""What is guessed of a rig: channels, and facts of its joints, each with its reason."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

Sure = Literal["sure", "likely", "unsure"]

AGREES = 0.9
"""Correlation from which two columns belong together."""


@dataclass(frozen=True, slots=True)
class Guess:
    """What feeds one channel."""

    channel: str
    column: str
    why: str
    sure: Sure
    scale: float | None = 1.0  # None: to be filled in
    todo: str = ""  # what is to be filled in


@dataclass(slots=True)
class JointFacts:
    """What the columns say of one joint."""

    prismatic: bool = False
    gear_ratio: tuple[float, str] | None = None  # and why
    encoder_counts: tuple[int | None, str] | None = None  # None: steps of no usual size
    voltage: bool = False  # the drive's input is a voltage
    link_sensors: set[str] = field(default_factory=set)


@dataclass(slots=True)
class Mapping:
    """All channels, and the columns that are none."""

    guesses: dict[str, Guess] = field(default_factory=dict)
    joints: list[JointFacts] = field(default_factory=list)
    unused: dict[str, str] = field(default_factory=dict)  # column -> why
    missing: dict[str, str] = field(default_factory=dict)  # channel -> what it is
    limit: str = ""  # what of the logs is beyond the arms that can be identified
    notes: tuple[str, ...] = ()
