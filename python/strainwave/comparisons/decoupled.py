"""What the second input and the second output are good for: Figs. 10 and 11."""

from __future__ import annotations

from collections.abc import Sequence

from strainwave.comparisons.estimates import (
    curve,
    errors_of,
    estimated_curve,
    response_of,
)
from strainwave.comparisons.rig import Rig
from strainwave.records import Comparison
from strainwave.report.curves import Curve, bode

_BETTER = 0.5  # times the error that the method is compared with


def inputs(rig: Rig) -> Comparison:
    """Fig. 10: with the interaction torque as an input, and without.

    Parameters
    ----------
    rig : Rig

    Returns
    -------
    Comparison
    """
    values: dict[str, float] = {}
    plots, said, holds = [], [], True
    for joint in (1, 2):
        run = rig.prbs(joint)
        both, alone = rig.estimate(run), rig.estimate(run, inputs=1)
        curves = [
            *curve("truth", response_of(run.truth), true=True),
            *estimated_curve("decoupled: u and tau", both, band=True),
            *estimated_curve("motor input only", alone),
        ]
        plots.append(bode(curves, f"Joint {joint}: motor torque to motor velocity"))
        errors = {"decoupled": errors_of(both, run.truth), "alone": errors_of(alone, run.truth)}
        for name, e in errors.items():
            values[f"{name}_anti_resonance_percent_{joint}"] = e.anti_resonance_percent
            values[f"{name}_resonance_percent_{joint}"] = e.resonance_percent
            values[f"{name}_db_{joint}"] = e.response_db
        good, poor = errors["decoupled"], errors["alone"]
        holds &= good.response_db < _BETTER * poor.response_db
        said.append(
            f"joint {joint}: anti-resonance {good.anti_resonance_percent:+.1f} %, resonance "
            f"{good.resonance_percent:+.1f} % against {poor.anti_resonance_percent:+.0f} % and "
            f"{poor.resonance_percent:+.0f} % without the torque"
        )
    return Comparison(
        figure=10,
        title="Decoupled against motor input only",
        claim="With the interaction torque as a second input each joint shows its own "
        "anti-resonance and resonance; without it, others.",
        holds=holds,
        values=values,
        message="; ".join(said),
        plots=tuple(plots),
    )


def outputs(rig: Rig, payloads: Sequence[int]) -> Comparison:
    """Fig. 11: with the link velocity as an output, and without, over the payload.

    Parameters
    ----------
    rig : Rig
    payloads : sequence of int [kg]

    Returns
    -------
    Comparison
    """
    values: dict[str, float] = {}
    curves: dict[int, list[Curve]] = {1: [], 2: []}
    for disks in payloads:
        rig.progress(f"one output against two, {disks} kg")
        run = rig.prbs(1, disks=disks)
        for count in curves:
            found = rig.estimate(run, outputs=count)
            e = errors_of(found, run.truth)
            values[f"outputs_{count}_db_{disks}_kg"] = e.response_db
            values[f"outputs_{count}_anti_resonance_percent_{disks}_kg"] = e.anti_resonance_percent
            curves[count] += estimated_curve(f"{disks} kg", found)
        subspace = rig.estimate(run, outputs=1, way="moesp")
        values[f"outputs_1_subspace_db_{disks}_kg"] = errors_of(subspace, run.truth).response_db
    worst = {
        count: max(values[f"outputs_{count}_db_{disks}_kg"] for disks in payloads)
        for count in curves
    }
    least = min(values[f"outputs_1_db_{disks}_kg"] for disks in payloads)
    first = max(values[f"outputs_1_subspace_db_{disks}_kg"] for disks in payloads)
    holds = worst[2] < _BETTER * min(least, first)
    return Comparison(
        figure=11,
        title="One output against two under changing payload",
        claim="Only with the link velocity as a second output does the response follow the "
        "payload.",
        holds=holds,
        values=values,
        message=f"two outputs: at most {worst[2]:.2f} dB off; one: {least:.1f} to {worst[1]:.1f} dB"
        f" by PEM and up to {first:.1f} dB by the subspace method alone (rms, 3 to 60 Hz)",
        plots=tuple(
            bode(drawn, f"Joint 1, {count} output{'s' if count > 1 else ''}")
            for count, drawn in curves.items()
        ),
    )
