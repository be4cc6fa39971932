"""Effect of a servo on the other joint on two estimators, and its cause: Fig. 13.

The interaction torque is computed from the outputs, so output disturbances also disturb this input.
This is a feedback, which a servo on the other joint strengthens. The test of this cause removes the
feedback: the inputs stay the same, and the outputs are the true linear response to them plus the
time-reversed disturbance. The disturbance keeps its spectrum, and the inputs do not depend on it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from strainwave.domain import Comparison, Control, Decoupled, Evidence, FloatArray
from strainwave.domain.options import EstimationMethod
from strainwave.dynamics.two_inertia import state_space
from strainwave.paper.claims import comparison_of, criterion_of
from strainwave.paper.joint_estimates import (
    JointErrors,
    curve,
    errors_of,
    estimate,
    estimated_curve,
    response_of,
)
from strainwave.paper.rig import Rig, Run
from strainwave.paper.settings import CLASSICAL_METHOD
from strainwave.presentation.figures.curves import bode
from strainwave.signals.fusion import complement

_N_RECORDS_WITHOUT_FEEDBACK = 6  # their mean error is a bias, not the effect of one noise
_MIN_SOUND_SHARE = 0.5  # of these records
_DEFAULT_ORDER = 3  # torsion and two velocities
_END_SHARE = 50  # an end is 1/50 of a record, over which it is averaged
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
    bias = {}
    for loop, other in _LOOPS:
        bias[loop], models = _without_feedback(rig, rig.prbs(1, other=other))
        evidence += models
    criteria = [
        criterion_of(
            "small-error",
            errors["pem", loop].worst_percent,
            what=f"PEM, joint 2 {loop}, larger error of both",
        )
        for loop, _ in _LOOPS
    ]
    servoed = errors[CLASSICAL_METHOD, "servoed"].anti_resonance_percent
    criteria += [
        criterion_of(
            "small-error",
            abs(errors[CLASSICAL_METHOD, "free"].anti_resonance_percent),
            what="subspace, joint 2 free, error of the anti-resonance",
            otherwise="the torque is computed from the outputs, so that it feeds back while joint "
            f"2 is free as well; with that loop cut the mean error is {bias['free']:+.1f} %",
        ),
        criterion_of(
            "large-error",
            abs(servoed),
            what="subspace, joint 2 servoed, error of the anti-resonance",
        ),
        criterion_of("remaining-share", abs(bias["servoed"] / servoed)),
    ]
    return comparison_of(
        13,
        criteria=tuple(criteria),
        evidence=tuple(evidence),
        values={
            f"{method}, joint 2 {loop}: error of the response [dB]": e.response_db
            for (method, loop), e in errors.items()
        }
        | {
            f"subspace, joint 2 {loop}, feedback cut: mean error of the anti-resonance [%]": mean
            for loop, mean in bias.items()
        },
        message="error of the anti-resonance with joint 2 free, servoed: PEM "
        f"{_pair(errors, 'pem')} %, subspace {_pair(errors, CLASSICAL_METHOD)} %; the latter with "
        f"feedback cut {bias['free']:+.1f}, {bias['servoed']:+.1f} %",
        plots=tuple(plots),
    )


def _order(rig: Rig) -> int:
    """Order of the decoupled joint by default: a higher order adds spurious modes."""
    return rig.settings.linear.order or _DEFAULT_ORDER


def _pair(errors: dict[tuple[str, str], JointErrors], method: str) -> str:
    return ", ".join(f"{errors[method, loop].anti_resonance_percent:+.1f}" for loop, _ in _LOOPS)


def _without_feedback(rig: Rig, run: Run) -> tuple[float, list[Evidence]]:
    """Mean error [%] of the anti-resonance by the subspace method without feedback, and models."""
    options = replace(rig.settings.linear, method=CLASSICAL_METHOD, order=_order(rig))
    errors, sound, models = [], [], []
    for k in range(_N_RECORDS_WITHOUT_FEEDBACK):
        record = without_feedback(run, k / _N_RECORDS_WITHOUT_FEEDBACK)
        model = estimate(
            [record], options, f"{CLASSICAL_METHOD}, {run.name}, feedback cut ({k + 1})"
        )
        models.append(model.evidence)
        if model.evidence.sound and model.anti_resonance is not None:
            errors.append(errors_of(model, run.truth).anti_resonance_percent)
            sound.append(model.evidence)
    if len(sound) < _MIN_SOUND_SHARE * _N_RECORDS_WITHOUT_FEEDBACK:
        return float("nan"), models
    # models that are not sound do not count and are not decisive
    return float(np.mean(errors)), [replace(e, decisive=e in sound) for e in models]


def without_feedback(run: Run, share: float) -> Decoupled:
    """Record with a time-reversed disturbance, so that its inputs do not depend on it.

        y(t) = G [u, tau](t) + v(shift - t),   v = y_recorded - G [u, tau]

    G is the true joint. `share` is the circular shift over the length of the record.
    """
    record, linear = run.decoupled, linear_outputs(run)
    disturbance = record.outputs - linear
    n, end = len(disturbance), len(disturbance) // _END_SHARE
    drift = disturbance[-end:].mean(axis=0) - disturbance[:end].mean(axis=0)
    disturbance -= np.outer(np.arange(n) / (n - end), drift)  # the ends then meet without a jump
    shifted = np.roll(disturbance[::-1], round(share * n), axis=0)
    return replace(record, outputs=linear + shifted)


def linear_outputs(run: Run) -> FloatArray:
    """Outputs (n_samples, 2) [rad/s] of the true linear joint, with the link velocity as fused."""
    from scipy.signal import lsim

    record = run.decoupled
    model = state_space(run.truth)
    time = np.arange(len(record.inputs)) * record.sample_time
    _, y, _ = lsim((model.A, model.B, model.C, model.D), record.inputs, time)
    if record.fusion is not None:
        difference = record.gear_ratio * y[:, 0] - y[:, 1]
        y[:, 1] += complement(difference, record.fusion, record.sample_time)
    return np.asarray(y)
