"""Parameters and configuration as flat lists of names: JSON, and a C header."""

from __future__ import annotations

import json
import re
from dataclasses import dataclass, fields
from pathlib import Path

from strainwave.domain.kinds import kind_of
from strainwave.domain.link_sensors import key_texts
from strainwave.export.omissions import CORRELATIONS, Part, notes_of, sentence_of
from strainwave.export.source import Export, IdentifiedArm
from strainwave.io.templates import fill_text

HEADER_PREFIX = "strainwave_"
"""Of every name in the C header; without it `gamma` collides with <math.h>."""
_ARM_UNITS = {"link_length": "m", "gravity": "m/s^2"}
_JOINT_UNITS = {
    "gear_ratio": "1",
    "torque_per_volt": "N m/V",
    "current_loop_hz": "Hz",
    "encoder_counts": "1",
    **{key: unit for key, (_, unit) in key_texts().items() if unit},
}
_OMISSIONS = {Part.SERVO: "the study file has its gains"}


@dataclass(frozen=True, slots=True)
class Entry:
    """One number under a name that is an identifier in any language."""

    name: str  # as in docs/notation.md, followed by the number of the joint
    value: float | None
    std: float | None  # None: known, or not identified
    unit: str
    known: bool = False  # from the study, not estimated


def entries(arm: IdentifiedArm) -> tuple[Entry, ...]:
    """Numbers of the study, then the identified parameters."""
    table = kind_of(arm.study.arm).table_of(arm.study.arm)
    known = [
        Entry(field.name, getattr(table, field.name), None, _ARM_UNITS[field.name], known=True)
        for field in fields(table)
    ]
    for number, joint in enumerate(arm.study.arm.joints, start=1):
        units = _JOINT_UNITS | ({"torque_per_volt": "N/V"} if joint.motion == "prismatic" else {})
        known += [
            Entry(f"{key}_{number}", getattr(joint, key), None, unit, known=True)
            for key, unit in units.items()
        ]
    entries = {entry.name: entry for entry in known if entry.value is not None}
    for p in arm.parameters:
        name = p.name if p.joint is None else f"{p.name}_{p.joint}"
        name = re.sub(r"[\W_]+", "_", name)  # a parameter of one record has the record in brackets
        entries[name] = Entry(name, p.value, p.std, p.unit)
    return tuple(entries.values())


def to_json(arm: IdentifiedArm) -> Export:
    """JSON tables `values`, `stds` and `units` by name; a parameter without value is null."""
    all_entries = entries(arm)
    notes = (*notes_of(arm, _OMISSIONS), CORRELATIONS)
    document = {
        "schema": "strainwave/parameters/1",
        "values": {entry.name: entry.value for entry in all_entries},
        "stds": {entry.name: entry.std for entry in all_entries if not entry.known},
        "units": {entry.name: entry.unit for entry in all_entries},
        "notes": notes,
    }
    text = json.dumps(document, indent=2, allow_nan=False)
    return Export((text + "\n").encode(), arm.warnings, notes)


def to_c_header(arm: IdentifiedArm) -> Export:
    """C header of `static const double`; a comment replaces a parameter without value."""
    notes = (*notes_of(arm, _OMISSIONS), CORRELATIONS)
    text = fill_text(
        Path(__file__).with_name("arm.h.j2"),
        entries=entries(arm),
        notes=notes,
        prefix=HEADER_PREFIX,
        comment=lambda text: text.replace("*/", "* /"),  # which would end it
        sentence_of=sentence_of,
    )
    return Export(text.encode(), arm.warnings, notes)
