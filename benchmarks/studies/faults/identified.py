"""Values that `identify` determines from a faulty input and that are wrong."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from benchmarks.studies.faults.inputs import Input
from strainwave.domain.keys import Key
from strainwave.errors import InvalidInput
from strainwave.io.parameters import read_parameters
from strainwave.io.study import read_study
from strainwave.pipeline import identify
from strainwave.virtual.experiments import derived

Interval = tuple[float, float]

_MAX_HARMLESS = 0.03  # relative error of a value outside its interval that a reader can bear


def true_intervals(path: Path, given: Input) -> dict[Key, Interval]:
    """Values of the truth.json beside a study, or intervals of the input without a fault.

    A truth.json of a chain has the links under other names; only the joints are compared.
    """
    truth = path.parent / "truth.json"
    if not truth.exists():
        result = identify(given.study, data=given.tables)
        return {p.key: p.ci95 for p in result.parameters if p.ci95 is not None}
    document = json.loads(truth.read_text())
    if "links" not in document:
        values = derived(read_parameters(truth), read_study(path).arm)
        return {key: (value, value) for key, value in values.items()}
    return {
        (name, i): (value, value)
        for i, joint in enumerate(document["joints"], start=1)
        for name, value in joint.items()
        if isinstance(value, float)
    } | {
        ("gear_stiffness", i): (stiffness[0], stiffness[0])
        for i, joint in enumerate(document["joints"], start=1)
        if len(stiffness := joint["gear_stiffness"]) == 1
    }


def wrong_values(given: Input, truth: Mapping[Key, Interval]) -> list[str]:
    """Identified values outside their intervals, of a result that is "determined"; or none."""
    try:
        result = identify(given.study, data=given.tables)
    except InvalidInput:
        return []
    if result.verdict.status != "determined":
        return []
    wrong = []
    for p in result.parameters:
        if p.key not in result.verdict.identified or p.key not in truth or p.value is None:
            continue
        low, high = truth[p.key]
        middle, half = 0.5 * (low + high), 0.5 * (high - low)
        own = 0.5 * (p.ci95[1] - p.ci95[0]) if p.ci95 else 0.0
        error = abs(p.value - middle)
        if error > np.hypot(own, half) and error > _MAX_HARMLESS * abs(middle):
            wrong.append(f"{p.label} {p.value / middle - 1.0:+.1%}")
    return wrong
