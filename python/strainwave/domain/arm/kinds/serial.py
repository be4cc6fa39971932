"""A chain of 1 to 7 joints placed anywhere in space."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from strainwave.domain.arm.consistent_links import consistent_links, priors_of
from strainwave.domain.arm.description import ArmDescription, Joint, Servo, Vector, unit_in
from strainwave.domain.arm.kinds.base import (
    LINK_PARAMETERS,
    MAX_JOINTS,
    MOTOR_SHARE,
    Fault,
    Kind,
    StageInertias,
    is_positive,
    require_positive,
)
from strainwave.domain.keys import Key, Values

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
