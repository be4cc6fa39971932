"""Assign columns to joints and quantities: by name, or by their data if the names are unknown."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from itertools import permutations
from typing import NamedTuple

import numpy as np

from strainwave.domain.keys import JointNumber
from strainwave.init.inspection import InspectedLog
from strainwave.init.joint_columns import ON_LINK, Mapping
from strainwave.init.names import (
    MAX_JOINTS,
    ParsedName,
    find_unit,
    joint_rank,
    last_number,
    parse,
    position,
    system_entry,
    words_of,
)
from strainwave.init.robot import Robot
from strainwave.init.signal_features import levels

_MIN_DERIVATIVE_CORRELATION = 0.95  # of an unnamed column that is the derivative of another


def assign_columns(
    record: InspectedLog, fullest: InspectedLog, robot: Robot | None = None
) -> tuple[dict[str, ParsedName], Mapping]:
    """Assign each column a quantity and a joint number; a mapping has the columns of no joint.

    Joints count from 1. They are those of `robot`; without it, `fullest` is the record of the same
    arm that determines the moving joints, and columns of joints beyond MAX_JOINTS are omitted.
    """
    parsed_names = {name: _parse(name, record) for name in record.columns}
    quantities = {each.quantity for each in parsed_names.values()}
    mapping = Mapping()
    if quantities.isdisjoint(("angle", "velocity")):
        parsed_names |= _classify_by_data(record, parsed_names)
        quantities |= {each.quantity for each in parsed_names.values()}
        mapping.notes = (
            "no column name indicates an angle: columns were assigned by their data alone",
        )
    if robot is not None:
        numbers, mapping.unused = _number_by_robot(parsed_names, robot, record)
        return numbers, mapping
    motion = "angle" if "angle" in quantities else "velocity"
    numbered = _number_joints(parsed_names, motion, record)
    joints = sorted({each.number or 1 for each in numbered.values() if each.quantity == motion})
    moving = {
        each.number or 1
        for name, each in numbered.items()
        if each.quantity == motion and np.ptp(fullest.columns.get(name, 0.0)) > 0.0
    }
    chosen = sorted(moving or joints)[:MAX_JOINTS]
    if len(joints) > len(chosen):
        labels = {e.number: f"{e.number} ({e.label})" for e in numbered.values() if e.label}
        listed = ", ".join(labels.get(joint, str(joint)) for joint in chosen)
        mapping.limit = (
            f"these logs have angles of {len(joints)} joints, of which {listed} are used as joints"
            f" 1 to {len(chosen)}: those that move, at most {MAX_JOINTS}. The result holds"
            " only if the other joints are at standstill in every record"
        )
    order = {joint: k for k, joint in enumerate(chosen, start=1)}
    for name, each in numbered.items():
        on_link = each.quantity in ON_LINK
        if each.number is None and chosen and (on_link or len(chosen) == 1):
            # a sensor without a joint in its name is assigned to the last link
            placed = len(chosen) == 1
            numbered[name] = replace(each, number=chosen[-1], placed=placed)
    kept = {
        name: replace(each, number=order[each.number or 1])
        for name, each in numbered.items()
        if (each.number or 1) in order and (each.number or each.quantity != "temperature")
    }
    return kept, mapping


def find_logged_joints(
    records: Sequence[InspectedLog], fullest: InspectedLog, robot: Robot
) -> set[JointNumber]:
    """Joints of a robot that logs have: with an angle that moves, or with an input."""
    parsed_names = {name: _parse(name, fullest) for name in fullest.columns}
    numbered, _ = _number_by_robot(parsed_names, robot, fullest)
    inputs = {e.number for e in numbered.values() if e.quantity in ("torque", "current", "voltage")}
    return {
        each.number
        for name, each in numbered.items()
        if each.number is not None
        and each.quantity in ("angle", "velocity")
        and (each.number in inputs or any(np.ptp(r.columns.get(name, 0.0)) > 0.0 for r in records))
    }


def _parse(name: str, record: InspectedLog, joint_words: Sequence[str] = ()) -> ParsedName:
    """Parse a column name, with the unit of its units row or of the robot system of the log."""
    each = parse(name, joint_words, record.units.get(name, ""))
    columns = tuple(record.columns)
    if each.unit is None and each.quantity is not None:
        unit = system_entry(columns, "units").get(each.quantity, "")
        each = replace(each, measure=find_unit(unit, each.quantity))
    if each.side is None and each.quantity in system_entry(columns, "sides"):
        each = replace(each, side="link")
    has_motor = any("motor" in words_of(other) for other in record.columns)
    if "arm" in each.rest and has_motor and each.side is None:
        each = replace(each, side="link", rest=tuple(w for w in each.rest if w != "arm"))
    return each


def _number_by_robot(
    parsed_names: dict[str, ParsedName], robot: Robot, record: InspectedLog
) -> tuple[dict[str, ParsedName], dict[str, str]]:
    """Number the joints by their names in a URDF, else by numbers; and list the other columns."""
    matches = robot.named_joints([each.label or name for name, each in parsed_names.items()])
    names_joints = any(parsed_names[n].quantity == "angle" for n in matches if n in parsed_names)
    by_name, by_number = dict[str, ParsedName](), dict[str, ParsedName]()
    for name, each in parsed_names.items():
        match = matches.get(each.label or name)
        if match is not None:
            joint, words = match
            parsed = each if each.label else _parse(name, record, words)
            by_name[name] = replace(parsed, number=joint, label="")
        else:
            number = last_number(words_of(each.label)) if each.label else each.number
            if names_joints and each.rest and each.quantity not in ON_LINK:
                number = None  # finger1 is not joint 1 of a robot whose joints have names
            by_number[name] = replace(each, number=number, label="")
    kept, unused, count = by_name, dict[str, str](), len(robot.joints)
    for name, each in _count_from_one(by_number).items():
        number = robot.number_of(each.number)
        if number is not None:
            kept[name] = replace(each, number=number)
        elif each.number is None and each.quantity in ON_LINK:
            kept[name] = replace(each, number=count, placed=False)
        elif each.quantity not in (None, "time"):
            unused[name] = f"no joint that moves in {robot.path.name} has this name or number"
    return kept, unused


def _number_joints(
    parsed_names: dict[str, ParsedName], motion: str, record: InspectedLog
) -> dict[str, ParsedName]:
    keys = _joint_words(parsed_names, motion)
    numbered = dict[str, ParsedName]()
    for name, each in parsed_names.items():
        matches = [key for key in keys if each.number == key.number and key.is_of(each, name)]
        if each.label or not matches:
            numbered[name] = each
            continue
        key = max(matches, key=lambda match: len(match.words))
        parsed = _parse(name, record, key.words) if key.is_letter else each
        numbered[name] = replace(parsed, number=keys.index(key) + 1)
    labels = list(dict.fromkeys(each.label for each in numbered.values() if each.label))
    counted = {n: e for n, e in numbered.items() if not keys or e is parsed_names[n]}
    return {
        name: replace(each, number=labels.index(each.label) + 1) if each.label else each
        for name, each in (numbered | _count_from_one(counted)).items()
    }


class _JointWords(NamedTuple):
    """Words, and the number with them, that distinguish a joint in a table."""

    words: tuple[str, ...]
    number: int | None

    @property
    def is_letter(self) -> bool:
        """Whether the joint is a letter, which elsewhere in a name may be a unit."""
        return len(self.words) == 1 and re.fullmatch("[a-z]", self.words[0]) is not None

    def is_of(self, each: ParsedName, name: str) -> bool:
        if self.is_letter and position(words_of(name), self.words) is not None:
            return True
        return bool(self.words) and set(self.words) <= set(each.rest)


def _joint_words(parsed_names: dict[str, ParsedName], motion: str) -> list[_JointWords]:
    """The joints that words distinguish, in kinematic or alphabetic order; none if one has none."""
    moving = [each for each in parsed_names.values() if each.quantity == motion and not each.label]
    common = set[str]().union(*(e.rest for e in moving)).intersection(*(e.rest for e in moving))
    keys = list(
        dict.fromkeys(
            _JointWords(tuple(w for w in each.rest if w not in common), each.number)
            for each in moving
        )
    )
    named = [key for key in keys if key.words]
    if len({key.words for key in named}) < 2 or (
        len(named) < len(keys) and any(key.number is not None for key in keys)
    ):
        return []
    if all(key.is_letter for key in named):
        return sorted(named)
    return sorted(named, key=lambda key: (joint_rank(key.words), key.number or 0))


def _count_from_one(parsed_names: dict[str, ParsedName]) -> dict[str, ParsedName]:
    """Increase the numbers of topics and quantities that count from 0."""
    from_zero = {
        _numbering_group(name, each) for name, each in parsed_names.items() if each.number == 0
    }
    return {
        name: replace(each, number=each.number + 1)
        if each.number is not None and _numbering_group(name, each) in from_zero
        else each
        for name, each in parsed_names.items()
    }


def _numbering_group(name: str, each: ParsedName) -> tuple[str, str | None]:
    """Return the group of columns that share a numbering: a topic, or a quantity in a table."""
    return (name.partition(".")[0] if name.startswith("/") else "", each.quantity)


def _classify_by_data(
    record: InspectedLog, parsed_names: dict[str, ParsedName]
) -> dict[str, ParsedName]:
    """Classify columns by their data.

    An angle is the integral of a velocity; a voltage takes few levels. Whether any other column is
    a torque, a current or a voltage, the data leave open.
    """
    unclassified = [
        n for n, e in parsed_names.items() if e.quantity is None and np.ptp(record.columns[n]) > 0.0
    ]
    voltages = [n for n in unclassified if levels(record.columns[n]) is not None]
    unclassified = [n for n in unclassified if n not in voltages]
    pairs = [
        (record.relation(rate, value)[0], value, rate)
        for rate, value in permutations(unclassified, 2)
    ]
    classified: dict[str, ParsedName] = {}
    for r, angle, velocity in sorted(pairs, reverse=True):
        if r > _MIN_DERIVATIVE_CORRELATION and classified.keys().isdisjoint((angle, velocity)):
            classified[angle], classified[velocity] = ParsedName("angle"), ParsedName("velocity")
    for quantity in ("angle", "velocity"):
        names = (
            n for n in record.columns if n in classified and classified[n].quantity == quantity
        )
        for k, name in enumerate(names, start=1):
            classified[name] = replace(classified[name], number=k)
    for k, name in enumerate(voltages, start=1):
        classified[name] = ParsedName("voltage", k)
    return classified
