"""Match names in logs to the joints of a URDF file, and angles to the limits of its joints."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from strainwave.domain import FloatArray, JointLimits
from strainwave.domain.keys import JointNumber
from strainwave.errors import InvalidInput
from strainwave.init.names import MAX_JOINTS, position, words_of
from strainwave.io.urdf import UrdfJoint, read_chains, read_urdf

Words = tuple[str, ...]

# minimum range [rad, m] of an angle that shows whether it is within the limits of a joint: a motor
# behind 1:100 then moves its joint by a milliradian
_MIN_RANGE = 0.1
# share by which logs exceed the limits of a URDF, which are set-points
_LIMIT_TOLERANCE = 0.2


@dataclass(frozen=True)
class Robot:
    """The moving joints of a URDF file."""

    path: Path
    joints: tuple[UrdfJoint, ...]
    held: tuple[str, ...] = ()  # joints that stay at zero

    @staticmethod
    def read(path: Path, logged: Callable[[Robot], Collection[JointNumber]] | None = None) -> Robot:
        """Read a URDF file; `logged` returns the joints that logs have.

        The arm is the chain of most logged joints, up to the last of them; the other joints are
        held at zero. Raises InvalidInput if it has more than seven joints, or if two chains of a
        tree have as many.
        """
        chains, mimics = read_chains(path)
        names = dict.fromkeys([*(name for chain in chains for name in chain), *mimics])
        counted = dict[tuple[str, ...], int]()
        for chain in chains:
            robot = Robot.holding(path, [name for name in names if name not in chain])
            found = logged(robot) if logged else range(1, len(chain) + 1)
            kept = chain[: max(found)] if found else chain
            counted[kept] = max(counted.get(kept, 0), len(found))
        best = [chain for chain, count in counted.items() if count == max(counted.values())]
        if len(best) > 1:
            read_urdf(path, mimics)  # raises the error of a tree
        robot = Robot.holding(path, [name for name in names if name not in best[0]])
        if len(robot.joints) > MAX_JOINTS:
            raise InvalidInput(
                f"{len(robot.joints)} joints move ({', '.join(best[0])}), but an arm has at most "
                f"{MAX_JOINTS}",
                where=str(path),
                remedy='set the types of joints that stand still in all logs to "fixed"',
            )
        return robot

    @staticmethod
    def holding(path: Path, held: Sequence[str]) -> Robot:
        """The joints of a URDF file that are not held at zero."""
        return Robot(path, read_urdf(path, held), tuple(held))

    def named_joints(self, names: Iterable[str]) -> dict[str, tuple[JointNumber, Words]]:
        """Joint and its words in each name: by the whole names, else by distinct words.

        The distinct words of `ur10e_wrist_1_joint` are `wrist_1`: the others are common to all
        joints.
        """
        listed = list(names)
        # a single letter or number is no name: it may mean anything in a column
        distinct: list[Words] = [
            words if any(len(word) > 1 and word.isalpha() for word in words) else ()
            for words in self._stripped
        ]
        whole = [words_of(joint.name) for joint in self.joints]
        by_words = [
            {name: match for name in listed if (match := _longest_match(words, name)) is not None}
            for words in (whole, distinct)
        ]
        return max(by_words, key=lambda matches: len({number for number, _ in matches.values()}))

    def number_of(self, number: int | None) -> JointNumber | None:
        """Joint of a number in a name that counts from 1; None if there is none.

        Joints named by numbers alone, such as `joint_2`, have these numbers.
        """
        if number is None:
            return 1 if len(self.joints) == 1 else None
        own_numbers = [words[0] for words in self._stripped if len(words) == 1]
        own_numbers = [word for word in own_numbers if word.isdecimal()]
        if len(own_numbers) == len(self.joints):
            zero_based = "0" in own_numbers
            own_numbers = [str(int(each) + zero_based) for each in own_numbers]
        else:
            own_numbers = [str(k) for k in range(1, len(self.joints) + 1)]
        return own_numbers.index(str(number)) + 1 if str(number) in own_numbers else None

    def are_within_limits(
        self, motions: Mapping[JointNumber, tuple[FloatArray, float]]
    ) -> bool | None:
        """Whether all angles stay within the limits of position and velocity of their joints.

        `motions` has the angle (n_samples,) [rad, m] and the sampling period [s] of each joint.
        None if no angle moves enough to tell, or if no joint that moves has limits.
        """
        tested = None
        for number, (values, period) in motions.items():
            limits = self.joints[number - 1].limits or JointLimits()
            if float(np.ptp(values)) < _MIN_RANGE:
                continue
            lower, upper = limits.lower, limits.upper
            if lower is not None and upper is not None and upper > lower:
                tested = True
                margin = _LIMIT_TOLERANCE * (upper - lower)
                if values.min() < lower - margin or values.max() > upper + margin:
                    return False
            if limits.velocity:
                tested = True
                # over a tenth of a second, which averages the rounding of encoders
                width = max(1, round(0.1 / period))
                fastest = np.abs(values[width:] - values[:-width]).max(initial=0.0)
                if fastest > (1.0 + _LIMIT_TOLERANCE) * limits.velocity * width * period:
                    return False
        return tested

    def gravity_bounds(self) -> list[float]:
        """Largest gravity torque [N m] at each joint: of the arm stretched horizontally."""
        bounds, moment, mass = list[float](), 0.0, 0.0
        for joint in reversed(self.joints):
            link_mass, *first_moment = joint.prior[:4]
            moment += float(np.linalg.norm(first_moment))
            mass += link_mass
            bounds.append(9.81 * moment)
            moment += mass * float(np.linalg.norm(joint.origin.xyz))
        return bounds[::-1]

    @cached_property
    def _stripped(self) -> tuple[Words, ...]:
        """Words of each joint without those at the start and the end that all joints share."""
        stripped = tuple(words_of(joint.name) for joint in self.joints)
        for end, rest in ((0, slice(1, None)), (-1, slice(None, -1))):
            while len(stripped) > 1 and all(len(words) > 1 for words in stripped):
                if len({words[end] for words in stripped}) > 1:
                    break
                stripped = tuple(words[rest] for words in stripped)
        return stripped


def _longest_match(joints: Sequence[Words], name: str) -> tuple[JointNumber, Words] | None:
    """The joint whose words are in a name, next to each other; of several, the longest."""
    inside = words_of(name)
    matches = [
        (number, words)
        for number, words in enumerate(joints, start=1)
        if words and position(inside, words) is not None
    ]
    return max(matches, key=lambda match: len(match[1]), default=None)
