"""What a servo on the other joint does to two estimators, and why: Fig. 13.

The interaction torque is computed from the outputs, so that whatever disturbs them disturbs this
input as well: a feedback, and through a servo on the other joint a stronger one. Whether it is to
blame is tested by cutting it: the same inputs, the joint's true linear answer to them, and the same
disturbance backwards in time. It keeps its spectrum, and the inputs do not depend on it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from strainwave.domain import Comparison, Control, Criterion, Decoupled, Evidence, FloatArray
from strainwave.domain.options import EstimationMethod
from strainwave.dynamics.two_inertia import state_space
from strainwave.paper.claims import compared
from strainwave.paper.estimates import (
    Errors,
    close,
    curve,
    errors_of,
    estimate,
    estimated_curve,
    far,
    response_of,
)
from strainwave.paper.rig import Rig, Run
from strainwave.paper.settings import CLASSICAL
from strainwave.presentation.figures.curves import bode
from strainwave.signals.fusion import complement

_CUTS = 6  # records with the loop cut: their mean error is a bias, not one noise's chance
_HALF = 0.5
_OWN_ORDER = 3  # torsion and two velocities
_ENDS = 50  # of a record, over which its ends are averaged
_LOOPS: tuple[tuple[str, Control], ...] = (("free", "open"), ("servoed", "servo"))
_WAYS: tuple[tuple[EstimationMethod, str], ...] = (
    ("pem", "prediction-error minimisation"),
    (CLASSICAL, "the classical subspace method"),
)


def methods(rig: Rig) -> Comparison:
    """Fig. 13: PEM against subspace with the other joint free and servoed."""
    evidence: list[Evidence] = []
    off: dict[tuple[str, str], Errors] = {}
    plots = []
    for way, method in _WAYS:
        truth = rig.prbs(1, other="servo").truth
        curves = curve("truth", response_of(truth), true=True)
        for loop, other in _LOOPS:
            run = rig.prbs(1, other=other)
            found = rig.estimate(run, method=way, order=_order(rig))
            evidence.append(found.evidence)
            curves += estimated_curve(f"joint 2 {loop}", found)
            off[way, loop] = errors_of(found, run.truth)
        plots.append(bode(curves, f"Joint 1 by {method}"))
    bias = {}
    for loop, other in _LOOPS:
        bias[loop], models = _without_feedback(rig, rig.prbs(1, other=other))
        evidence += models
    criteria = [
        close(f"PEM, joint 2 {loop}, larger error of both [%]", off["pem", loop].worst_percent)
        for loop, _ in _LOOPS
    ]
    servoed = off[CLASSICAL, "servoed"].anti_resonance_percent
    criteria += [
        close(
            "subspace, joint 2 free, error of the anti-resonance [%]",
            off[CLASSICAL, "free"].anti_resonance_percent,
            "the torque is computed from the outputs, so that it feeds back while joint 2 is free "
            f"as well; with that loop cut the mean error is {bias['free']:+.1f} %",
        ),
        far("subspace, joint 2 servoed, error of the anti-resonance [%]", servoed),
        Criterion(
            "share of the subspace method's error, joint 2 servoed, that stays without feedback",
            abs(bias["servoed"] / servoed),
            "at most",
            _HALF,
            "feedback is the cause if most of the error goes with it",
        ),
    ]
    return compared(
        13,
        criteria=tuple(criteria),
        evidence=tuple(evidence),
        values={
            f"{way}, joint 2 {loop}: error of the response [dB]": e.response_db
            for (way, loop), e in off.items()
        }
        | {
            f"subspace, joint 2 {loop}, feedback cut: mean error of the anti-resonance [%]": mean
            for loop, mean in bias.items()
        },
        message="error of the anti-resonance with joint 2 free, servoed: PEM "
        f"{_pair(off, 'pem')} %, subspace {_pair(off, CLASSICAL)} %; the latter with feedback cut "
        f"{bias['free']:+.1f}, {bias['servoed']:+.1f} %",
        plots=tuple(plots),
    )


def _order(rig: Rig) -> int:
    """The joint's own where it is free: a higher one brings spurious modes into the comparison."""
    return rig.settings.linear.order or _OWN_ORDER


def _pair(off: dict[tuple[str, str], Errors], way: str) -> str:
    return ", ".join(f"{off[way, loop].anti_resonance_percent:+.1f}" for loop, _ in _LOOPS)


def _without_feedback(rig: Rig, run: Run) -> tuple[float, list[Evidence]]:
    """Mean error of the anti-resonance by the subspace method with the loop cut [%]."""
    options = replace(rig.settings.linear, method=CLASSICAL, order=_order(rig))
    errors, sound, models = [], [], []
    for k in range(_CUTS):
        cut = without_feedback(run, k / _CUTS)
        found = estimate([cut], options, f"{CLASSICAL}, {run.name}, feedback cut ({k + 1})")
        models.append(found.evidence)
        if found.evidence.sound and found.anti_resonance is not None:
            errors.append(errors_of(found, run.truth).anti_resonance_percent)
            sound.append(found.evidence)
    if len(sound) < _HALF * _CUTS:
        return float("nan"), models
    # what is not sound does not count, and nothing rests on it
    return float(np.mean(errors)), [replace(e, decisive=e in sound) for e in models]


def without_feedback(run: Run, share: float) -> Decoupled:
    """A record with its disturbance backwards in time, so that the inputs do not depend on it.

    y(t) = G [u, tau](t) + v(shift - t), where v = y_recorded - G [u, tau] and G is the true joint.

    `share`: Of the record, by which the disturbance is moved as well, in a circle.
    """
    record, linear = run.decoupled, linear_outputs(run)
    disturbance = record.outputs - linear
    n, end = len(disturbance), len(disturbance) // _ENDS
    drift = disturbance[-end:].mean(axis=0) - disturbance[:end].mean(axis=0)
    disturbance -= np.outer(np.arange(n) / (n - end), drift)  # the circle closes without a jump
    moved = np.roll(disturbance[::-1], round(share * n), axis=0)
    return replace(record, outputs=linear + moved)


def linear_outputs(run: Run) -> FloatArray:
    """Outputs of the true linear joint from the recorded inputs, the link velocity as fused.

    Returns (n_samples, 2) [rad/s].
    """
    from scipy.signal import lsim

    record = run.decoupled
    A, B, C = state_space(run.truth)
    time = np.arange(len(record.inputs)) * record.sample_time
    _, y, _ = lsim((A, B, C, np.zeros((2, 2))), record.inputs, time)
    if record.fusion is not None:
        apart = record.gear_ratio * y[:, 0] - y[:, 1]
        y[:, 1] += complement(apart, record.fusion, record.sample_time)
    return np.asarray(y)
