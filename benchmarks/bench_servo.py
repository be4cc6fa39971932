"""The design of servos over 1,000 draws, against the five seconds that an engineer waits.

The built-in arm with 5 kg, whose parameters have standard deviations of 0.3 %, in five postures:
loops, margins, steps, shapers, observers, damping and moves.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path

from benchmarks.timing import Row, best_of
from strainwave.domain import Parameter
from strainwave.export.source import IdentifiedArm
from strainwave.tune.design import ServoOptions, design_servo
from strainwave.virtual import scara

_REL_STD = 3e-3
_LIMIT = 5.0  # [s]
_DRAWS = 1000


def rows() -> list[Row]:
    table = []
    for spring in ("linear", "three-slope"):
        values = scara.STIFF.parameters(5, spring)
        parameters = tuple(
            Parameter(name, joint, value, _REL_STD * abs(value), "", "tuned")
            for (name, joint), value in values.items()
        )
        arm = IdentifiedArm(scara.STIFF.study(Path(), spring), parameters, "the built-in arm")
        options = ServoOptions(draws=_DRAWS)
        time = best_of(partial(design_servo, arm, None, options), repeats=2, at_most=30.0)
        table.append(Row(f"servo design, {_DRAWS} draws, {spring}", time, "limit", _LIMIT))
    return table
