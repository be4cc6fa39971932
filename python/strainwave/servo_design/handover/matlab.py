"""The servo as a MATLAB script with `ss` and `tf` models."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from strainwave.domain import FloatArray
from strainwave.domain.control_law import INPUTS
from strainwave.export.omissions import sentence_of
from strainwave.export.source import Export
from strainwave.io.templates import fill_text
from strainwave.servo_design.design import ServoDesign
from strainwave.servo_design.handover.c_header import HOLD, difference_equations
from strainwave.servo_design.handover.json_document import Units
from strainwave.servo_design.handover.python_control import state_names
from strainwave.servo_design.handover.shaper_summary import chosen_shaper
from strainwave.servo_design.observer import OUTPUTS, Observer

_NOTES = (
    "not in the ss models: the limit of the input, the hold of integrators and the feed-forward",
    "not in the script: margins, see servo.json",
)


def to_script(design: ServoDesign) -> Export:
    """Script with `servo(i)`: gains, matrices, `ss` model and the `tf` of each filter."""
    joints = []
    for each in design.joints:
        gains, units = each.tuned.gains, Units.of(design.arm.joint(each.joint))
        law = gains.law()
        matrices = {name: _matrix(getattr(law, name)) for name in ("A", "B", "C", "D")}
        matrices["E"] = _matrix(law.E[:, None])
        equations = difference_equations(gains, design.limits[each.joint - 1], units)
        states = _cell(state_names(law))
        joints.append((each.joint, gains, units, matrices, states, equations))
    text = fill_text(
        Path(__file__).with_name("servo.m.j2"),
        design=design,
        joints=joints,
        inputs=_cell(INPUTS),
        observers=[_observer(one) for one in design.observers],
        damped=[
            (
                one,
                {name: _matrix(getattr(one.law, name)) for name in ("A", "B", "C", "D")}
                | {"E": _matrix(one.law.E[:, None])},
            )
            for one in design.dampings
            if not one.reason
        ],
        shaper=chosen_shaper(design),
        notes=_NOTES,
        hold=HOLD,
        sentence_of=sentence_of,
    )
    return Export(text.encode(), design.arm.warnings, _NOTES)


def _observer(observer: Observer) -> tuple[Observer, dict[str, str], dict[str, str]]:
    """An observer, its matrices and its names."""
    system = observer.system
    matrices = {name: _matrix(getattr(system, name)) for name in "ABCD"}
    names = {
        "StateName": _cell(system.states),
        "InputName": _cell(system.inputs),
        "OutputName": _cell(OUTPUTS),
    }
    return observer, matrices, names


def _matrix(matrix: FloatArray) -> str:
    rows = (", ".join(map(repr, row)) for row in np.atleast_2d(matrix).tolist())
    return f"[{'; '.join(rows)}]"


def _cell(names: Sequence[str]) -> str:
    return "{" + ", ".join(f"'{name}'" for name in names) + "}"
