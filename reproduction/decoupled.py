"""Models of a decoupled joint: inputs, outputs, a servo on the other joint: Figs. 10, 11, 13."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from reproduction.document import comparison_of, criterion_of
from reproduction.joint_estimates import (
    JointErrors,
    JointEstimate,
    curve,
    errors_of,
    estimated_curve,
    response_of,
)
from reproduction.records import Comparison, Criterion, Evidence
from reproduction.rig import CLASSICAL_METHOD, Rig
from strainwave.domain import Control
from strainwave.domain.study import Channels, EstimationMethod
from strainwave.report.figures.curves import Curve, bode

_OUTPUTS: tuple[tuple[str, Channels], ...] = (("one output", "motor"), ("two outputs", "both"))


def inputs(rig: Rig) -> Comparison:
    """Fig. 10: models with and without the interaction torque as an input."""
    criteria: list[Criterion] = []
    evidence: list[Evidence] = []
    values: dict[str, float] = {}
    plots, texts, worst = [], [], []
    for joint in (1, 2):
        run = rig.prbs(joint)
        both, motor_only = rig.estimate(run), rig.estimate(run, inputs="motor")
        evidence += [both.evidence, motor_only.evidence]
        curves = [
            *curve("truth", response_of(run.truth), true=True),
            *estimated_curve("decoupled: u and tau", both, band=True),
            *estimated_curve("motor input only", motor_only),
        ]
        plots.append(bode(curves, f"Joint {joint}: motor torque to motor velocity"))
        good, poor = errors_of(both, run.truth), errors_of(motor_only, run.truth)
        values[f"decoupled_db_{joint}"] = good.response_db
        values[f"motor_only_db_{joint}"] = poor.response_db
        criteria += [
            criterion_of(
                "small-error",
                abs(good.anti_resonance_percent),
                what=f"joint {joint}, error of the anti-resonance",
            ),
            criterion_of(
                "small-error",
                abs(good.resonance_percent),
                what=f"joint {joint}, error of the resonance",
            ),
            criterion_of(
                "large-error",
                poor.worst_percent,
                what=f"joint {joint} by motor input only, larger error of both",
            ),
        ]
        worst.append(poor.response_db)
        texts.append(
            f"joint {joint}: anti-resonance {good.anti_resonance_percent:+.1f} %, resonance "
            f"{good.resonance_percent:+.1f} % against {poor.anti_resonance_percent:+.0f} % and "
            f"{poor.resonance_percent:+.0f} % without the torque"
        )
    values["motor input only, error of the response, joint 2 over joint 1"] = worst[1] / worst[0]
    return comparison_of(
        10,
        criteria=tuple(criteria),
        evidence=tuple(evidence),
        values=values,
        message="; ".join(texts),
        plots=tuple(plots),
    )


def outputs(rig: Rig, payloads: Sequence[int]) -> Comparison:
    """Fig. 11: models with and without the link velocity as an output, over the payloads [kg]."""
    evidence: list[Evidence] = []
    values: dict[str, float] = {}
    curves: dict[str, list[Curve]] = {name: [] for name, _ in _OUTPUTS}
    hz: dict[str, list[float]] = {name: [] for name, _ in _OUTPUTS}
    worst = dict.fromkeys(hz, 0.0)
    for disks in payloads:
        rig.progress(f"one output against two, {disks} kg")
        run = rig.prbs(1, disks=disks)
        for name, used in _OUTPUTS:
            model = rig.estimate(run, outputs=used)
            errors = errors_of(model, run.truth)
            evidence.append(model.evidence)
            values[f"{name}, {disks} kg: error of the anti-resonance [%]"] = (
                errors.anti_resonance_percent
            )
            values[f"{name}, {disks} kg: error of the response [dB]"] = errors.response_db
            worst[name] = max(worst[name], abs(errors.anti_resonance_percent))
            hz[name].append(_anti_resonance_hz(model))
            curves[name] += estimated_curve(f"{disks} kg", model)
    one, two = hz
    return comparison_of(
        11,
        criteria=(
            criterion_of(
                "small-error", worst[two], what="two outputs, largest error of the anti-resonance"
            ),
            criterion_of("payload-ratio", _least_ratio(hz[two])),
            criterion_of(
                "error-ratio",
                worst[one] / worst[two],
                what="largest error of the anti-resonance with one output over that with two",
            ),
        ),
        evidence=tuple(evidence),
        values=values,
        message=f"anti-resonance at most {worst[two]:.1f} % off with two outputs, "
        f"{worst[one]:.1f} % with one",
        plots=tuple(bode(group, f"Joint 1, {name}") for name, group in curves.items()),
    )


def _anti_resonance_hz(model: JointEstimate) -> float:
    return float("nan") if model.anti_resonance is None else model.anti_resonance.frequency_hz


def _least_ratio(hz: Sequence[float]) -> float:
    return float(np.min(np.divide(hz[1:], hz[:-1])))


_DEFAULT_ORDER = 3  # torsion and two velocities
_LOOPS: tuple[tuple[str, Control], ...] = (("free", "open"), ("servoed", "servo"))
_METHODS: tuple[tuple[EstimationMethod, str], ...] = (
    ("pem", "prediction-error minimisation"),
    (CLASSICAL_METHOD, "the classical subspace method"),
)


def methods(rig: Rig) -> Comparison:
    """Fig. 13: PEM and subspace method with the other joint free and servoed."""
    evidence: list[Evidence] = []
    errors: dict[tuple[str, str], JointErrors] = {}
    plots = []
    for method, method_text in _METHODS:
        truth = rig.prbs(1, other="servo").truth
        curves = curve("truth", response_of(truth), true=True)
        for loop, other in _LOOPS:
            run = rig.prbs(1, other=other)
            model = rig.estimate(run, method=method, order=_order(rig))
            evidence.append(model.evidence)
            curves += estimated_curve(f"joint 2 {loop}", model)
            errors[method, loop] = errors_of(model, run.truth)
        plots.append(bode(curves, f"Joint 1 by {method_text}"))
    criteria = [
        criterion_of(
            "small-error",
            errors["pem", loop].worst_percent,
            what=f"PEM, joint 2 {loop}, larger error of both",
        )
        for loop, _ in _LOOPS
    ]
    servoed = {method: errors[method, "servoed"].worst_percent for method, _ in _METHODS}
    criteria.append(
        criterion_of(
            "error-ratio",
            servoed[CLASSICAL_METHOD] / servoed["pem"],
            what="joint 2 servoed, larger error of both by the subspace method over that by PEM",
        )
    )
    return comparison_of(
        13,
        criteria=tuple(criteria),
        evidence=tuple(evidence),
        values={
            f"{method}, joint 2 {loop}: error of the response [dB]": e.response_db
            for (method, loop), e in errors.items()
        },
        message="larger error of both frequencies with joint 2 free, servoed: PEM "
        f"{_pair(errors, 'pem')} %, subspace {_pair(errors, CLASSICAL_METHOD)} %",
        plots=tuple(plots),
    )


def _order(rig: Rig) -> int:
    """Order of the decoupled joint by default: a higher order adds spurious modes."""
    return rig.settings.linear.order or _DEFAULT_ORDER


def _pair(errors: dict[tuple[str, str], JointErrors], method: str) -> str:
    return ", ".join(f"{errors[method, loop].worst_percent:.1f}" for loop, _ in _LOOPS)
