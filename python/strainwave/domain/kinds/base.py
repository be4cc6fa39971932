"""What a kind of arm has to say of itself; its equations of motion are the core's."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

from strainwave.domain.arm import ArmDescription

if TYPE_CHECKING:
    from strainwave.domain.kinds.bodies import Body, Needed
    from strainwave.domain.kinds.starts import StageInertias

Key = tuple[str, int | None]
"""A parameter: its name and its joint, from 1, or None for the arm's own."""

Values = dict[Key, float]
"""Parameter values."""

Row = Mapping[Key, float]
"""A linear combination of parameters: their weights."""


@dataclass(frozen=True, slots=True)
class RigidColumn:
    """One unknown of the rigid model: a combination of parameters that motor torques identify.

    Its regressor is that of its first part, whose weight is one. Where that combines a motor's
    inertia with the links', rigid motion does not separate them.
    """

    name: str
    joint: int | None
    unit: str
    parts: Row

    @property
    def key(self) -> Key:
        """What it is known by."""
        return self.name, self.joint

    @property
    def motor(self) -> tuple[int, float] | None:
        """The joint whose motor's inertia is part of it, from 1, and that part's weight."""
        for (name, joint), weight in self.parts.items():
            if name == "motor_inertia" and joint is not None:
                return joint, weight
        return None

    def __str__(self) -> str:
        return self.name if self.joint is None else f"{self.name} of joint {self.joint}"


@dataclass(frozen=True, slots=True)
class Fault:
    """What an arm of a kind cannot be: where it says so, and what to do."""

    problem: str
    remedy: str
    table: str  # "arm" or "joint"
    index: int | None = None  # of the [[joint]] table, from 0
    key: str | None = None


class Kind(ABC):
    """A kind of arm: the inertial parameters of its links, and what follows from them.

    Parameters of gravity, motors, friction and gears are every kind's alike; see
    `strainwave.domain.combinations`.
    """

    n_joints: int
    """How many joints it has."""

    inertias: tuple[Key, ...]
    """Inertial parameters of the links."""

    primary: tuple[str, ...]
    """Labels of inertias that the rigid model is expected to give, as a verdict lists them."""

    primary_of_all: tuple[str, ...]
    """And those that take the whole-arm fit."""

    gravity_note: str = ""
    """What the gravity of `effective_gravity` is, where it is not the study's."""

    @abstractmethod
    def faults(self, arm: ArmDescription) -> Iterator[Fault]:
        """What a description says that an arm of this kind cannot be.

        `arm`: With the right number of joints.
        """

    @abstractmethod
    def link_inertia(self, joint: int) -> Row:
        """m_L of a joint, its link's inertia with the arm stretched: (3).

        `joint`: From 1. Returns: Over `inertias`.
        """

    @property
    @abstractmethod
    def from_link_inertias(self) -> tuple[tuple[Key, Row], ...]:
        """Inertias that follow from every joint's `link_inertia`: the other way round.

        Each may take those before it.
        """

    @abstractmethod
    def rigid_inertias(self, arm: ArmDescription) -> tuple[RigidColumn, ...]:
        """Inertias that rigid motion identifies, links' and motors': (6)."""

    @abstractmethod
    def starting_inertias(self, arm: ArmDescription, found: StageInertias) -> tuple[Values, Values]:
        """Inertias that a fit of the whole arm starts from.

        Returns: Of links and motors, positive definite. Returns: Those of the stages before that no
        arm can have. Raises `NotIdentifiable`: Something is missing or impossible that nothing can
        stand for.
        """

    @abstractmethod
    def complete(self, known: Values, arm: ArmDescription) -> None:
        """Add the links' inertias, and motors', that follow from what is known or hardly matter.

        `known`: (name, joint) -> value; nothing that is there is changed.
        """

    @abstractmethod
    def bodies(self, arm: ArmDescription, need: Needed, gravity: float) -> tuple[Body, ...]:
        """Rigid bodies whose base parameters are the arm's, one a link from the base.

        `need`: The parameters. `gravity` [m/s^2]: Under which link 1 has the measured gravity
        torque; zero: its centre lies on the axis. Raises `InvalidInput`: No bodies have these
        parameters.
        """

    def effective_gravity(self, arm: ArmDescription, need: Needed) -> float:
        """Gravity under which rigid bodies have all measured gravity torques.

        `need`: The parameters. Returns [m/s^2]: Zero for a horizontal arm. Raises `InvalidInput`:
        Parameters contradict each other.
        """
        return arm.gravity or 0.0
