"""Servo design for a result, with options as texts of the command line."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from strainwave.domain import Payload
from strainwave.errors import InvalidInput
from strainwave.export.source import IdentifiedArm
from strainwave.io.atomic_files import write_whole
from strainwave.io.results import covariance_of, noise_of
from strainwave.tune.design import ServoDesign, ServoOptions, design_servo

PAGE = "tune.html"
"""Name of the report."""


def tune_document(
    document: Mapping[str, Any],
    arm: IdentifiedArm,
    options: ServoOptions,
    out: Path | None = None,
    progress: Callable[[str], None] = lambda _: None,
) -> ServoDesign:
    """Design the servos for a result and its arm; write page and hand-over to a directory `out`."""
    design = design_servo(arm, covariance_of(document), options, progress, noise_of(document))
    if out is not None:
        from strainwave.tune.handover import FILES
        from strainwave.tune.report.page import render

        progress("writing the report")
        files = {name: to_file(design).encode() for name, to_file in FILES.items()}
        write_whole(out, {PAGE: render(design).encode(), **files})
    return design


def read_postures(texts: Sequence[str]) -> tuple[tuple[float, ...], ...]:
    """Postures from texts such as "0,1.2"; raises InvalidInput for text that is no number."""
    return tuple(
        _numbers(text, "--posture", "give one link angle [rad] per joint, such as 0,1.2")
        for text in texts
    )


def read_payloads(texts: Sequence[str]) -> tuple[Payload, ...]:
    """Payloads from texts "mass,x,y,z"; raises InvalidInput unless there are four numbers."""
    remedy = "give mass [kg] and centre of mass [m] in the last link's frame, such as 2,0.1,0,0"
    payloads = []
    for text in texts:
        mass, *centre = _numbers(text, "--payload", remedy)
        if len(centre) != 3:
            raise InvalidInput(
                f"{text!r} has {1 + len(centre)} of the four numbers mass,x,y,z",
                where="--payload",
                remedy=remedy,
            )
        payloads.append(Payload(mass, (centre[0], centre[1], centre[2])))
    return tuple(payloads)


def _numbers(text: str, option: str, remedy: str) -> tuple[float, ...]:
    values = []
    for part in text.split(","):
        try:
            value = float(part)
        except ValueError:
            value = math.nan
        if not math.isfinite(value):
            raise InvalidInput(
                f"{part.strip()!r} in {text!r} is not a number", where=option, remedy=remedy
            )
        values.append(value)
    return tuple(values)
