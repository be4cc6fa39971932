"""What the second input and the second output are good for: Figs. 10 and 11."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from strainwave.domain import Comparison, Criterion, Evidence
from strainwave.domain.options import Channels
from strainwave.paper.claims import compared
from strainwave.paper.estimates import (
    Estimate,
    close,
    curve,
    errors_of,
    estimated_curve,
    far,
    response_of,
)
from strainwave.paper.rig import Rig
from strainwave.presentation.figures.curves import Curve, bode

_OUTPUTS: tuple[tuple[str, Channels], ...] = (("one output", "motor"), ("two outputs", "both"))


def inputs(rig: Rig) -> Comparison:
    """Fig. 10: with the interaction torque as an input, and without."""
    criteria: list[Criterion] = []
    evidence: list[Evidence] = []
    values: dict[str, float] = {}
    plots, said, worst = [], [], []
    for joint in (1, 2):
        run = rig.prbs(joint)
        both, alone = rig.estimate(run), rig.estimate(run, inputs="motor")
        evidence += [both.evidence, alone.evidence]
        curves = [
            *curve("truth", response_of(run.truth), true=True),
            *estimated_curve("decoupled: u and tau", both, band=True),
            *estimated_curve("motor input only", alone),
        ]
        plots.append(bode(curves, f"Joint {joint}: motor torque to motor velocity"))
        good, poor = errors_of(both, run.truth), errors_of(alone, run.truth)
        values[f"decoupled_db_{joint}"] = good.response_db
        values[f"motor_only_db_{joint}"] = poor.response_db
        criteria += [
            close(f"joint {joint}, error of the anti-resonance [%]", good.anti_resonance_percent),
            close(f"joint {joint}, error of the resonance [%]", good.resonance_percent),
            far(f"joint {joint} by motor input only, larger error of both [%]", poor.worst_percent),
        ]
        worst.append(poor.response_db)
        said.append(
            f"joint {joint}: anti-resonance {good.anti_resonance_percent:+.1f} %, resonance "
            f"{good.resonance_percent:+.1f} % against {poor.anti_resonance_percent:+.0f} % and "
            f"{poor.resonance_percent:+.0f} % without the torque"
        )
    values["motor input only, error of the response, joint 2 over joint 1"] = worst[1] / worst[0]
    return compared(
        10,
        criteria=tuple(criteria),
        evidence=tuple(evidence),
        values=values,
        message="; ".join(said),
        plots=tuple(plots),
    )


def outputs(rig: Rig, payloads: Sequence[int]) -> Comparison:
    """Fig. 11: with the link velocity as an output, and without, over the payload.

    `payloads` [kg]: From the largest.
    """
    evidence: list[Evidence] = []
    values: dict[str, float] = {}
    curves: dict[str, list[Curve]] = {name: [] for name, _ in _OUTPUTS}
    hz: dict[str, list[float]] = {name: [] for name, _ in _OUTPUTS}
    worst = dict.fromkeys(hz, 0.0)
    for disks in payloads:
        rig.progress(f"one output against two, {disks} kg")
        run = rig.prbs(1, disks=disks)
        for name, kept in _OUTPUTS:
            found = rig.estimate(run, outputs=kept)
            off = errors_of(found, run.truth)
            evidence.append(found.evidence)
            values[f"{name}, {disks} kg: error of the anti-resonance [%]"] = (
                off.anti_resonance_percent
            )
            values[f"{name}, {disks} kg: error of the response [dB]"] = off.response_db
            worst[name] = max(worst[name], abs(off.anti_resonance_percent))
            hz[name].append(_anti_resonance_hz(found))
            curves[name] += estimated_curve(f"{disks} kg", found)
    one, two = hz
    return compared(
        11,
        criteria=(
            close("two outputs, largest error of the anti-resonance [%]", worst[two]),
            Criterion(
                "two outputs, least ratio of anti-resonances from one payload to the next lighter",
                _least_ratio(hz[two]),
                "at least",
                1.0,
                "a lighter link has a higher anti-resonance",
            ),
            far(
                "one output, largest error of the anti-resonance [%]",
                worst[one],
                "the motor velocity alone shows the anti-resonance as well, once the interaction "
                "torque is an input",
            ),
        ),
        evidence=tuple(evidence),
        values=values,
        message=f"anti-resonance at most {worst[two]:.1f} % off with two outputs, "
        f"{worst[one]:.1f} % with one",
        plots=tuple(bode(drawn, f"Joint 1, {name}") for name, drawn in curves.items()),
    )


def _anti_resonance_hz(found: Estimate) -> float:
    return float("nan") if found.anti_resonance is None else found.anti_resonance.frequency_hz


def _least_ratio(hz: Sequence[float]) -> float:
    return float(np.min(np.divide(hz[1:], hz[:-1])))
