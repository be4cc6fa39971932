"""Assign columns to joints and quantities: by name, or by their data if the names are unknown."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from types import MappingProxyType
from typing import NamedTuple

from strainwave.domain import FloatArray
from strainwave.study_draft.inspection import Record
from strainwave.study_draft.names import ParsedName, max_joints, number_in, parse
from strainwave.study_draft.robot import Robot
from strainwave.study_draft.signal_features import levels, relation

_MIN_DERIVATIVE_CORRELATION = (
    0.95  # minimum correlation at which an unnamed column is the derivative of another
)


_ON_LINK = ("acceleration", "gyro", "deflection")  # quantities of sensors on a link


class ColumnAssignment(NamedTuple):
    """Quantity and joint of each column."""

    columns: dict[str, ParsedName]
    limit: str = ""  # why joints are omitted; empty if none is
    notes: tuple[str, ...] = ()
    unused: Mapping[str, str] = MappingProxyType({})  # columns of no joint, with the reason


def assign_columns(record: Record, fullest: Record, robot: Robot | None = None) -> ColumnAssignment:
    """Assign each column a quantity and a joint number.

    Joints count from 1. They are those of `robot`; without it, `fullest` is the record of the same
    arm that determines the moving joints, and columns of joints beyond `max_joints` are omitted.
    """
    parsed_names = {name: parse(name) for name in record.columns}
    notes: list[str] = []
    if not any(each.quantity == "angle" for each in parsed_names.values()):
        parsed_names |= _classify_by_data(record, parsed_names)
        notes.append("no column name indicates an angle: columns were assigned by their data alone")
    if robot is not None:
        numbers, unused = _number_by_robot(parsed_names, robot)
        return ColumnAssignment(numbers, "", tuple(notes), unused)
    numbered = _number_joints(parsed_names)
    joints = sorted({each.number or 1 for each in numbered.values() if each.quantity == "angle"})
    moving = [j for j in joints if _is_moving(fullest, numbered, j)] or joints
    chosen = sorted(moving[: max_joints()])
    limit = ""
    if len(joints) > len(chosen):
        limit = (
            f"these logs have angles of {len(joints)} joints, of which"
            f" {', '.join(_joint_label(numbered, j) for j in chosen)} are used as joints 1 to"
            f" {len(chosen)}: those that move, at most {max_joints()}. The result holds"
            " only if the other joints are at standstill in every record"
        )
    order = {joint: k for k, joint in enumerate(chosen, start=1)}
    for name, each in numbered.items():
        on_link = each.quantity in _ON_LINK
        if each.number is None and chosen and (on_link or len(chosen) == 1):
            # a sensor without a joint in its name is assigned to the last link
            placed = len(chosen) == 1
            numbered[name] = replace(each, number=chosen[-1], placed=placed)
    kept = {
        name: replace(each, number=order[each.number or 1])
        for name, each in numbered.items()
        if (each.number or 1) in order and (each.number or each.quantity != "temperature")
    }
    return ColumnAssignment(kept, limit, tuple(notes))


def _number_by_robot(
    parsed_names: Mapping[str, ParsedName], robot: Robot
) -> tuple[dict[str, ParsedName], dict[str, str]]:
    """Number the joints by their names in a URDF, else by numbers; and list the other columns."""
    matches = robot.named_joints([each.label or name for name, each in parsed_names.items()])
    by_name, by_number = dict[str, ParsedName](), dict[str, ParsedName]()
    for name, each in parsed_names.items():
        match = matches.get(each.label or name)
        if match is not None:
            parsed = each if each.label else parse(name, match.words)
            by_name[name] = replace(parsed, number=match.number, label="")
        else:
            number = number_in(each.label) if each.label else each.number
            by_number[name] = replace(each, number=number, label="")
    kept, unused, count = by_name, dict[str, str](), len(robot.joints)
    for name, each in _count_from_one(by_number).items():
        number = robot.number_of(each.number)
        if number is not None:
            kept[name] = replace(each, number=number)
        elif each.number is None and each.quantity in _ON_LINK:
            kept[name] = replace(each, number=count, placed=False)
        elif each.quantity not in (None, "time"):
            unused[name] = f"no joint that moves in {robot.path.name} has this name or number"
    return kept, unused


def _number_joints(parsed_names: Mapping[str, ParsedName]) -> dict[str, ParsedName]:
    """Number the joints from 1, also if the names count from 0 or use labels."""
    parsed_names = {
        name: replace(each, label=_label(each, parsed_names)) for name, each in parsed_names.items()
    }
    labels = list(dict.fromkeys(each.label for each in parsed_names.values() if each.label))
    return {
        name: replace(each, number=labels.index(each.label) + 1) if each.label else each
        for name, each in _count_from_one(parsed_names).items()
    }


def _count_from_one(parsed_names: Mapping[str, ParsedName]) -> dict[str, ParsedName]:
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


def _label(each: ParsedName, parsed_names: Mapping[str, ParsedName]) -> str:
    """Return the joint's label; in a table, the word that distinguishes two or more angles."""
    angles = [e for e in parsed_names.values() if e.quantity == "angle" and e.number is None]
    words = {e.unrecognised_word for e in angles if e.unrecognised_word}
    return each.label or (
        each.unrecognised_word if len(words) > 1 and each.unrecognised_word in words else ""
    )


def _numbering_group(name: str, each: ParsedName) -> tuple[str, str | None]:
    """Return the group of columns that share a numbering: a topic, or a quantity in a table."""
    return (name.partition(".")[0] if name.startswith("/") else "", each.quantity)


def _is_moving(record: Record, parsed_names: Mapping[str, ParsedName], joint: int) -> bool:
    return any(
        each.quantity == "angle"
        and (each.number or 1) == joint
        and name in record.columns
        and float(_span(record, name)) > 0.0
        for name, each in parsed_names.items()
    )


def _span(record: Record, name: str) -> float:
    values = record.columns[name]
    return float(values.max() - values.min())


def _joint_label(parsed_names: Mapping[str, ParsedName], joint: int) -> str:
    labels = [e.label for e in parsed_names.values() if e.label and e.number == joint]
    return f"{joint} ({labels[0]})" if labels else str(joint)


def _classify_by_data(
    record: Record, parsed_names: Mapping[str, ParsedName]
) -> dict[str, ParsedName]:
    """Classify columns by their data.

    An angle is the integral of a velocity; a voltage takes few levels.
    """
    unclassified = [
        n for n, e in parsed_names.items() if e.quantity is None and _span(record, n) > 0.0
    ]
    voltages = [n for n in unclassified if levels(record.columns[n]) is not None]
    unclassified = [n for n in unclassified if n not in voltages]
    pairs = sorted(
        _derivative_pairs({n: record.columns[n] for n in unclassified}, record.time), reverse=True
    )
    classified: dict[str, ParsedName] = {}
    for _, angle, velocity in pairs:
        if angle not in classified and velocity not in classified:
            classified[angle], classified[velocity] = ParsedName("angle"), ParsedName("velocity")
    for quantity in ("angle", "velocity"):
        same_quantity = [
            n for n in record.columns if n in classified and classified[n].quantity == quantity
        ]
        for k, name in enumerate(same_quantity, start=1):
            classified[name] = replace(classified[name], number=k)
    joints = sum(each.quantity == "angle" for each in classified.values())
    remaining = [n for n in unclassified if n not in classified]
    inputs = voltages + (remaining if len(voltages) + len(remaining) == joints else [])
    inputs.sort(key=list(record.columns).index)
    for k, name in enumerate(inputs, start=1):
        classified[name] = ParsedName("voltage", k)
    return classified


class _DerivativePair(NamedTuple):
    correlation: float
    angle: str
    velocity: str


def _derivative_pairs(columns: Mapping[str, FloatArray], time: FloatArray) -> list[_DerivativePair]:
    """Return each column that is the derivative of another, with the other."""
    pairs = []
    for rate, speeds in columns.items():
        for value, angles in columns.items():
            if rate != value:
                r, ratio = relation(speeds, angles, time)
                if r > _MIN_DERIVATIVE_CORRELATION and ratio > 0.0:
                    pairs.append(_DerivativePair(r, value, rate))
    return pairs
