"""Guessed channels and joint properties, each with its reason."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

Sure = Literal["sure", "likely", "unsure"]

MIN_RELATED_CORRELATION = 0.9
"""Minimum correlation at which two columns count as related."""
MIN_RANGE_SHARE = 0.1
"""Share of its largest range above which a joint moves in a record."""


@dataclass(frozen=True, slots=True)
class Guess:
    """Guessed source column of one channel."""

    channel: str
    column: str
    reason: str
    sure: Sure
    scale: float | None = 1.0  # factor to SI units; None: the user must fill it in
    meaning: str = ""  # of a torque: "sensor" behind the gear
    todo: str = ""  # description of the value that the user must fill in, here or in [[joint]]


@dataclass(slots=True)
class JointFacts:
    """Properties of one joint derived from the columns, or from a URDF."""

    name: str = ""  # in the URDF
    joint_side: str = ""  # why its signals are measured behind the gear; empty if they are not
    prismatic: bool = False
    gear_ratio: tuple[float, str] | None = None  # with its reason
    encoder_counts: tuple[int | None, str] | None = None  # None: the step matches no common encoder
    voltage: bool = False  # whether the drive's input is a voltage
    command: str = ""  # unit of the input if it is a command of the drive: V or A
    link_sensors: set[str] = field(default_factory=set)

    @property
    def shows_elasticity(self) -> bool:
        """Whether a sensor on the link shows the gear's elasticity."""
        return bool(self.link_sensors) and not self.joint_side


@dataclass(slots=True)
class Mapping:
    """Channels of a study, and the columns without a channel."""

    guesses: dict[str, Guess] = field(default_factory=dict)
    joints: list[JointFacts] = field(default_factory=list)
    urdf: Path | None = None  # file that places the joints
    held: tuple[str, ...] = ()  # joints of the file that stay at zero
    unused: dict[str, str] = field(default_factory=dict)  # column -> reason
    missing: dict[str, str] = field(default_factory=dict)  # channel -> description
    limit: str = ""  # why the arm exceeds the supported models
    notes: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()  # notes that the user needs before completing the study

    @property
    def shows_elasticity(self) -> bool:
        """Whether a sensor on a link shows the elasticity of a gear."""
        return any(facts.shows_elasticity for facts in self.joints)
