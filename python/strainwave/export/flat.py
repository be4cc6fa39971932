"""Parameters and configuration as flat lists of names: JSON, a C header, and MATLAB.

MATLAB gets the linear models as well: a .mat file of numbers, or a script that makes `ss` and
`idgrey` models.
"""

from __future__ import annotations

import io
import json
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from strainwave.domain import ArmDescription, FloatArray
from strainwave.domain.arm.description import unit_in
from strainwave.domain.arm.kinds import kind_of
from strainwave.domain.arm.link_sensors import key_texts
from strainwave.dynamics.two_inertia import NAMES
from strainwave.export import linear_models, source
from strainwave.export.linear_models import Matrices
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
_BODIES = (
    "masses, first moments and inertias of the links are one of many sets with the same motion; "
    "base_parameters in result.json has the combinations that grouped parameters represent"
)


@dataclass(frozen=True, slots=True)
class FlatNumber:
    """One number under a name that is an identifier in any language."""

    name: str  # as in docs/notation.md, followed by the number of the joint
    value: float | None
    std: float | None  # None: known, or not identified
    unit: str
    known: bool = False  # from the study, not estimated


def entries(arm: IdentifiedArm) -> tuple[FlatNumber, ...]:
    """Numbers of the study, then the identified parameters and the bodies of a serial arm."""
    known = list(_numbers_of_arm(arm.study.arm))
    for number, joint in enumerate(arm.study.arm.joints, start=1):
        units = _JOINT_UNITS | ({"torque_per_volt": "N/V"} if joint.motion == "prismatic" else {})
        known += [
            FlatNumber(f"{key}_{number}", getattr(joint, key), None, unit, known=True)
            for key, unit in units.items()
        ]
    entries = {entry.name: entry for entry in known if entry.value is not None}
    for p in arm.parameters:
        name = p.name if p.joint is None else f"{p.name}_{p.joint}"
        name = re.sub(r"[\W_]+", "_", name)  # a parameter of one record has the record in brackets
        value = arm.standard.get(p.key, p.value)
        if value is None and arm.completion is not None:
            value = arm.completion.get(p.key)
        entries[name] = FlatNumber(name, value, p.std, p.unit)
    for key, value in arm.standard.items():
        name = "_".join(map(str, key))
        entries.setdefault(name, FlatNumber(name, value, None, unit_in(arm.study.arm, key)))
    return tuple(entries.values())


def _numbers_of_arm(arm: ArmDescription) -> Iterator[FlatNumber]:
    """Numbers of the `[arm]` table; placement and coupling of joints that the kind does not place.

    The components of a vector have the suffixes x, y and z, roll, pitch and yaw.
    """
    table = kind_of(arm).table_of(arm)
    for field in fields(table):
        value, unit = getattr(table, field.name), _ARM_UNITS.get(field.name)
        if unit is None or value is None:
            continue
        if isinstance(value, float | int):
            yield FlatNumber(field.name, value, None, unit, known=True)
        else:
            yield from _components([f"{field.name}_{x}" for x in "xyz"], value, unit)
    if kind_of(arm).places_joints:
        return
    for i, joint in enumerate(arm.joints, start=1):
        yield from _components([f"origin_{x}_{i}" for x in "xyz"], joint.origin.xyz, "m")
        turns = [f"origin_{x}_{i}" for x in ("roll", "pitch", "yaw")]
        yield from _components(turns, joint.origin.rpy, "rad")
        yield from _components([f"axis_{x}_{i}" for x in "xyz"], joint.axis, "1")
    for i, row in enumerate(arm.coupling or (), start=1):
        names = [f"coupling_{i}_{motor}" for motor in range(1, len(row) + 1)]
        yield from _components(names, row, "1")


def _components(names: Sequence[str], values: Sequence[float], unit: str) -> Iterator[FlatNumber]:
    for name, value in zip(names, values, strict=True):
        yield FlatNumber(name, value, None, unit, known=True)


def _notes_of_values(arm: IdentifiedArm) -> tuple[str, ...]:
    bodies = [_BODIES] if arm.standard else []
    return (*arm.assumptions, *source.loss_note([source.CORRELATIONS]), *bodies)


def to_json(arm: IdentifiedArm) -> Export:
    """JSON tables `values`, `stds` and `units` by name; a parameter without value is null."""
    all_entries = entries(arm)
    notes = _notes_of_values(arm)
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
    notes = _notes_of_values(arm)
    text = fill_text(
        Path(__file__).with_name("arm.h.j2"),
        entries=entries(arm),
        notes=notes,
        prefix=HEADER_PREFIX,
        comment=lambda text: text.replace("*/", "* /"),  # which would end it
        sentence_of=source.sentence_of,
    )
    return Export(text.encode(), arm.warnings, notes)


_UNKNOWN = float("nan")


def to_mat(arm: IdentifiedArm) -> Export:
    """MAT-file with structs `parameters`, `parameters_std`, `units`, and the models.

    `joints` has A, B, C, D of each joint, empty for a joint without model, `whole_arm` those of the
    arm. Errors as for `models_of`.
    """
    from scipy.io import savemat

    joints, whole_arm = linear_models.models_of(arm)
    all_entries = entries(arm)
    content: dict[str, Any] = {
        "parameters": {e.name: _UNKNOWN if e.value is None else e.value for e in all_entries},
        "parameters_std": {
            e.name: _UNKNOWN if e.std is None else e.std for e in all_entries if not e.known
        },
        "units": {e.name: e.unit for e in all_entries},
        "joints": _joints(arm.study.arm.n_joints, joints),
        **{key: np.array(names, dtype=object) for key, names in linear_models.SIGNALS.items()},
        "notes": np.array(_notes_of_models(arm), dtype=object),
        "whole_arm": whole_arm.matrices
        | {key: np.array(getattr(whole_arm, key), dtype=object) for key in linear_models.SIGNALS},
    }
    file = io.BytesIO()
    savemat(file, content, long_field_names=True, oned_as="column")
    return Export(file.getvalue(), linear_models.linearised(arm), _notes_of_models(arm))


def _joints(count: int, models: Mapping[int, Matrices]) -> FloatArray:
    array = np.zeros(count, dtype=[(name, object) for name in "ABCD"])
    for i in range(count):
        for name in "ABCD":
            array[name][i] = getattr(models.get(i + 1), name, np.zeros((0, 0)))
    return array


def _notes_of_models(arm: IdentifiedArm) -> tuple[str, ...]:
    lost = source.loss_note(source.losses(arm, (*source.LINEAR, "servo", source.ERRORS)))
    matrices = (f"{note}: not in the matrices, but in the struct parameters" for note in lost)
    return (*arm.assumptions, *matrices, *source.loss_note([source.CORRELATIONS]))


def to_script(arm: IdentifiedArm) -> Export:
    """Script with structs `parameters`, `parameters_std`, and models.

    They are `sys{i}` and `grey(i)` of each joint with a model of its own, and `sys_arm` of the
    whole arm. Errors as for `models_of`.
    """
    models, whole_arm = linear_models.models_of(arm)
    joints = []
    for number, matrices in models.items():
        model = linear_models.joint_model(arm, number)
        values = {name: getattr(model, name) for name in NAMES}
        joints.append((number, values, model.gear_ratio, matrices._asdict()))
    text = fill_text(
        Path(__file__).with_name("arm.m.j2"),
        entries=entries(arm),
        joints=joints,
        whole_arm=whole_arm,
        **linear_models.SIGNALS,
        notes=_notes_of_models(arm),
        matrix=_matrix,
        names=lambda names: "{" + ", ".join(f"'{name}'" for name in names) + "}",
        number=lambda value: "NaN" if value is None else repr(value),
        sentence_of=source.sentence_of,
    )
    return Export(text.encode(), linear_models.linearised(arm), _notes_of_models(arm))


def _matrix(matrix: FloatArray) -> str:
    rows = (", ".join(repr(float(x)) for x in row) for row in matrix)
    return f"[{'; '.join(rows)}]"
