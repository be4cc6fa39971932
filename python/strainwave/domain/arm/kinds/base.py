"""Interface of an arm kind: a constructor of chains, with names and bodies for their parameters.

`SerialChain` is the general kind: 1 to 7 joints placed anywhere in space.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

import numpy as np

from strainwave.domain.arm.consistent_links import consistent_links, priors_of
from strainwave.domain.arm.description import ArmDescription, Joint, Servo, Vector, unit_in
from strainwave.domain.keys import JointIndex, JointNumber, Key, Keyed, Row, Values
from strainwave.domain.messages import Clause
from strainwave.errors import NotIdentifiable

LINK_PARAMETERS = (
    "mass",
    *(f"first_moment_{axis}" for axis in "xyz"),
    *(f"inertia_{entry}" for entry in ("xx", "xy", "yy", "xz", "yz", "zz")),
)
"""Standard parameters of a link in the order of the core, without `link_`."""


@dataclass(frozen=True, slots=True)
class Body:
    """One link as a rigid body, in the frame of its joint."""

    mass: float  # [kg]
    centre: Vector  # of mass [m]
    # Ixx, Iyy, Izz, Ixy, Ixz, Iyz about the centre of mass [kg m^2]
    inertia: tuple[float, float, float, float, float, float]

    @classmethod
    def of_standard(cls, parameters: Sequence[float]) -> Body:
        """Body with the values of `LINK_PARAMETERS`; its mass is positive."""
        mass, *moment = parameters[:4]
        x, y, z = (part / mass for part in moment)
        xx, xy, yy, xz, yz, zz = np.array(parameters[4:]) - mass * np.array(
            [y * y + z * z, -x * y, x * x + z * z, -x * z, -y * z, x * x + y * y]
        )
        return cls(mass, (x, y, z), (xx, yy, zz, xy, xz, yz))

    @classmethod
    def in_plane(cls, mass: float, centre: float, inertia: float) -> Body:
        """Body whose motion in the xy plane depends on Izz only, with its centre on the x axis."""
        return cls(mass, (centre, 0.0, 0.0), (inertia,) * 3 + (0.0,) * 3)


class ParameterLookup(Protocol):
    """Returns a parameter's value by name and joint; raises InvalidInput if it is unknown."""

    def __call__(self, name: str, joint: int | None = None) -> float:
        """Value of the parameter."""


MOTOR_SHARE = 0.5
"""Motor's share of a joint's total inertia where only the total is known.

Designs match motor and link within a small factor.
"""


@dataclass(frozen=True, slots=True)
class StageInertias:
    """Inertias of motor and link from each joint model, and the estimates of the rigid model."""

    motor: Mapping[JointNumber, float]  # [kg m^2]
    link: Mapping[JointNumber, float]  # [kg m^2]
    rigid: Mapping[Key, float | None]  # None: not identified
    rigid_std: Mapping[Key, float]
    combinations: Mapping[Key, Row]  # of link parameters and motor inertias, in the rigid model

    def require_rigid(self, name: str) -> float:
        """Return a parameter of the arm that only the rigid model provides.

        Raises NotIdentifiable if the motion records do not identify it.
        """
        value = self.rigid.get((name, None))
        if value is None:
            raise NotIdentifiable(
                f"the whole-arm fit needs {name}, which the motion records do not identify: record"
                ' all joints moving together with use = "motion"'
            )
        return value


def is_positive(value: float | None) -> bool:
    """Whether the value is known, finite and positive."""
    return value is not None and bool(np.isfinite(value)) and value > 0.0


def require_positive(name: str, value: float) -> float:
    """Return the value. Raises NotIdentifiable unless it is positive."""
    if not is_positive(value):
        raise NotIdentifiable(
            f"the whole-arm fit has no starting values: the earlier steps estimate {name} ="
            f" {value:.3g}, which is impossible. Check the signs, units and assignment of the"
            " channels, gear_ratio and torque_per_volt"
        )
    return value


@dataclass(frozen=True, slots=True)
class RigidColumn(Keyed):
    """One unknown of the rigid model: a combination of parameters that motor torque identifies.

    If the combination adds a motor's inertia to inertias of links, rigid motion does not separate
    them.
    """

    name: str
    joint: int | None
    unit: str
    parts: Row

    @property
    def motor(self) -> tuple[JointNumber, float] | None:
        """Joint whose motor inertia the combination contains, and its weight."""
        for (name, joint), weight in self.parts.items():
            if name == "motor_inertia" and joint is not None:
                return joint, weight
        return None

    def __str__(self) -> str:
        return self.name if self.joint is None else f"{self.name} of joint {self.joint}"


@dataclass(frozen=True, slots=True)
class Fault:
    """A contradiction in an arm's description: its place in the study file, and the remedy."""

    problem: str
    remedy: str
    table: str  # "arm" or "joint"
    index: JointIndex | None = None  # of the [[joint]] table
    key: str | None = None


Table = TypeVar("Table")

MAX_JOINTS = 7
"""Most joints of a chain in the compiled core."""


class Kind(ABC, Generic[Table]):
    """An arm kind: a constructor of chains from an `[arm]` table.

    The compiled core has faster equations of motion for some kinds, with parameters of their own;
    other kinds are simulated as chains. Their links have the standard parameters: mass, first
    moments and inertias about the joint's frame.
    """

    name: str  # value of `kind` in a study file
    max_joints: int = MAX_JOINTS  # most joints of an arm of this kind
    table: type[Table]  # keys of `[arm]`, without `kind`
    # whether the kind places the joints; otherwise their tables or a URDF do, and motors may be
    # coupled
    places_joints: bool = True
    gravity_note: str = ""  # formula of `effective_gravity`, if it is not the gravity of the study

    def faults(self, table: Table, joints: Sequence[Joint]) -> Iterator[Fault]:
        """Contradictions between the tables of a study file and this kind, most severe first."""
        yield from ()

    @abstractmethod
    def construct(
        self, table: Table, joints: Sequence[Joint], servo: Servo | None = None
    ) -> ArmDescription:
        """The chain of an `[arm]` table and its joints; the kind places the joints."""

    @abstractmethod
    def table_of(self, arm: ArmDescription) -> Table:
        """The `[arm]` table of a chain: the inverse of `construct`."""

    def standard_rows(self, arm: ArmDescription) -> Mapping[Key, Row]:
        """Parameters of the links as rows over the standard parameters of a chain.

        Empty if they are the standard parameters.
        """
        return {}

    def rigid_combinations(self, arm: ArmDescription) -> Mapping[Key, Row]:
        """Names of combinations of link parameters and motor inertias in results."""
        return {}

    def starting_inertias(
        self, arm: ArmDescription, estimates: StageInertias
    ) -> tuple[Values, Values]:
        """Starting inertias of the whole-arm fit, and the stage estimates that it rejects.

        The starting inertias of links and motors are positive definite. Estimates that no arm can
        have are replaced and returned second. Raises NotIdentifiable if an estimate that has no
        substitute is missing or impossible, or if the kind has no starting values.
        """
        raise NotIdentifiable(f"the whole-arm fit has no starting values for a {self.name} arm")

    def contradictions(self, values: Values) -> Mapping[Key, Clause]:
        """Link parameters with which no arm has the other values, each with the reason."""
        return {}

    def complete(self, known: Values, arm: ArmDescription) -> None:
        """Add to `known` the inertias that follow from it or have little effect.

        Existing entries do not change.
        """

    def bodies(
        self, arm: ArmDescription, need: ParameterLookup, gravity: float
    ) -> tuple[Body, ...]:
        """One rigid body per link, from the base, with the base parameters of the arm.

        They have the standard parameters of the links unless the kind chooses them. `gravity`
        [m/s^2] relates link 1's gravity torque to its first moment; if it is zero, the centre of
        mass lies on the axis. Raises InvalidInput if no bodies have these parameters.
        """
        return tuple(
            Body.of_standard([need(f"link_{name}", number) for name in LINK_PARAMETERS])
            for number in range(1, arm.n_joints + 1)
        )

    def effective_gravity(self, arm: ArmDescription, need: ParameterLookup) -> float:
        """Gravity [m/s^2] at which the rigid bodies have all measured gravity torques.

        Zero for a horizontal arm. Raises InvalidInput if the parameters contradict each other.
        """
        return arm.gravity_size


# standard deviation of a base parameter at the start, apart from its own, relative to
# the largest of its unit and joint
_START_TOLERANCE = 1e-3


@dataclass(frozen=True, slots=True)
class SerialTable:
    """Keys of `[arm]`."""

    gravity: Vector | None = None  # [m/s^2] in the frame of the base
    urdf: str | None = None  # file that places the joints
    held: tuple[str, ...] = ()  # joints of the file that stay at zero in all logs


class SerialChain(Kind[SerialTable]):
    """Joints with the origins and axes of their own tables."""

    name = "serial"
    table = SerialTable
    places_joints = False

    def faults(self, table: SerialTable, joints: Sequence[Joint]) -> Iterator[Fault]:
        """Too many joints, or an axis of length zero."""
        if len(joints) > MAX_JOINTS:
            yield Fault(
                f"there are {len(joints)} [[joint]] tables, but a chain has at most {MAX_JOINTS}",
                "describe the joints that move",
                "joint",
            )
        for index, joint in enumerate(joints):
            if not any(joint.axis):
                yield Fault("the axis has length zero", "set its direction", "joint", index, "axis")

    def construct(
        self, table: SerialTable, joints: Sequence[Joint], servo: Servo | None = None
    ) -> ArmDescription:
        """The joints as they are."""
        return ArmDescription(self.name, tuple(joints), table.gravity, servo=servo)

    def table_of(self, arm: ArmDescription) -> SerialTable:
        """Gravity, and the file that places the joints."""
        if arm.urdf is None:
            return SerialTable(arm.gravity)
        return SerialTable(arm.gravity, arm.urdf.file, arm.urdf.held)

    def starting_inertias(
        self, arm: ArmDescription, estimates: StageInertias
    ) -> tuple[Values, Values]:
        """Consistent links with the base parameters of the rigid step, motors of the joint models.

        A motor without a usable estimate gets its usual share of the joint's inertia.
        """
        numbers = range(1, arm.n_joints + 1)
        links: list[Key] = [(f"link_{name}", i) for i in numbers for name in LINK_PARAMETERS]
        n_links = len(links)
        motors, rejected = dict(estimates.motor), Values()
        for number, joint in enumerate(arm.joints, start=1):
            if is_positive(motors[number]):
                continue
            rejected["motor_inertia", number] = motors[number]
            link = require_positive("link_inertia", estimates.link[number])
            motors[number] = MOTOR_SHARE / (1.0 - MOTOR_SHARE) * joint.gear_ratio**2 * link
        known = [
            key
            for key, row in estimates.combinations.items()
            if estimates.rigid.get(key) is not None and not row.keys().isdisjoint(links)
        ]
        parts: list[Key] = [*links, *(("motor_inertia", i) for i in numbers)]
        rows = np.array(
            [[estimates.combinations[key].get(part, 0.0) for part in parts] for key in known]
        )
        target = np.array([estimates.rigid[key] for key in known], dtype=float)
        target -= rows[:, n_links:] @ np.array([motors[i] for i in numbers])
        sizes = [(unit_in(arm, key), key[1]) for key in known]
        largest = {size: np.abs(target[[s == size for s in sizes]]).max() for size in sizes}
        tolerance = _START_TOLERANCE * np.array([largest[size] for size in sizes])
        std = np.hypot(tolerance, [estimates.rigid_std[key] for key in known])
        values = consistent_links(priors_of(arm), rows[:, :n_links] / std[:, None], target / std)
        start: Values = dict(zip(links, values.tolist(), strict=True))
        return start | {("motor_inertia", i): value for i, value in motors.items()}, rejected
