"""Parameters and configuration as flat lists of names: JSON, and a C header."""

from __future__ import annotations

import json
from dataclasses import dataclass

from strainwave.export.source import Export, IdentifiedArm


@dataclass(frozen=True, slots=True)
class Entry:
    """One number under a name that any language takes."""

    name: str  # as in docs/notation.md, the joint's number behind it
    value: float | None
    std: float | None  # None: known, or not identified
    unit: str
    known: bool = False  # from the study, not estimated


def entries(arm: IdentifiedArm) -> tuple[Entry, ...]:
    """What the study knows and the identification found, in that order.

    Parameters
    ----------
    arm : IdentifiedArm

    Returns
    -------
    tuple of Entry
    """
    found = [
        Entry("link_length", arm.study.arm.link_length, None, "m", known=True),
        Entry("gravity", arm.study.arm.gravity, None, "m/s^2", known=True),
    ]
    for number, joint in enumerate(arm.study.arm.joints, start=1):
        torque = "N/V" if joint.motion == "prismatic" else "N m/V"
        found += [
            Entry(f"gear_ratio_{number}", joint.gear_ratio, None, "1", known=True),
            Entry(f"torque_per_volt_{number}", joint.torque_per_volt, None, torque, known=True),
        ]
    found = [entry for entry in found if entry.value is not None]
    for p in arm.parameters:
        name = p.name if p.joint is None else f"{p.name}_{p.joint}"
        found.append(Entry(name, p.value, p.std, p.unit))
    return tuple(found)


def to_json(arm: IdentifiedArm) -> Export:
    """Three flat tables by name: `values`, `stds` and `units`; null is what was not identified.

    Parameters
    ----------
    arm : IdentifiedArm

    Returns
    -------
    Export
    """
    listed = entries(arm)
    document = {
        "schema": "strainwave/parameters/1",
        "values": {entry.name: entry.value for entry in listed},
        "stds": {entry.name: entry.std for entry in listed if not entry.known},
        "units": {entry.name: entry.unit for entry in listed},
    }
    text = json.dumps(document, indent=2, allow_nan=False)
    return Export((text + "\n").encode(), arm.warnings)


def to_c_header(arm: IdentifiedArm) -> Export:
    """A header of `static const double`, units in comments; a null leaves a comment only.

    Parameters
    ----------
    arm : IdentifiedArm

    Returns
    -------
    Export
    """
    lines = [
        "/* Parameters of an arm, identified by strainwave. SI units, angles in rad.",
        " * A number at the end of a name is the joint's, from the base. */",
        "#ifndef STRAINWAVE_ARM_H",
        "#define STRAINWAVE_ARM_H",
        "",
        *(_line(entry) for entry in entries(arm)),
        "",
        "#endif",
    ]
    return Export(("\n".join(lines) + "\n").encode(), arm.warnings)


def _line(entry: Entry) -> str:
    # a unit from a file must not end the comment
    unit = entry.unit.replace("*/", "* /")
    if entry.value is None:
        return f"/* {entry.name} [{unit}] was not identified */"
    sure = "known" if entry.known else "std " + (f"{entry.std:.2g}" if entry.std else "not known")
    return f"static const double {entry.name} = {entry.value!r}; /* [{unit}], {sure} */"
