"""Effect of a servo on the other joint on two estimators: Fig. 13."""

from __future__ import annotations

from strainwave.domain import Comparison, Control, Evidence
from strainwave.domain.options import EstimationMethod
from strainwave.paper.document import comparison_of, criterion_of
from strainwave.paper.joint_estimates import (
    JointErrors,
    curve,
    errors_of,
    estimated_curve,
    response_of,
)
from strainwave.paper.rig import CLASSICAL_METHOD, Rig
from strainwave.presentation.figures.curves import bode

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
