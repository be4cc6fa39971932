"""Title and claim of each figure of the source."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from strainwave.domain import Comparison, Criterion, Evidence
from strainwave.errors import StrainwaveError
from strainwave.presentation.figures import Figure

CLAIMS: dict[int, tuple[str, str]] = {
    2: (
        "Gear stiffness from the largest amplitude",
        "A PRBS of the largest amplitude gives the gear's stiffest slope, K3.",
    ),
    4: (
        "PRBS input",
        "A two-level sequence excites all frequencies around the resonances equally.",
    ),
    5: (
        "Interaction torque on joint 1, joint 2 free",
        "The computed interaction torque is a usable second input: its spectrum is uneven but not "
        "empty around the resonances, and the inertia stays constant.",
    ),
    6: (
        "Frequency responses of joint 1 before and after refinement",
        "The rigid model's low-frequency lag (18), and then fine tuning, bring the first response "
        "closer to the joint's own.",
    ),
    7: (
        "Step responses of joint 1 before and after fine tuning",
        "Fine tuning brings the simulated step closer to the measured one.",
    ),
    8: ("Validation steps of joint 1", "The tuned model predicts steps of other sizes."),
    9: ("Frequency responses of joint 2 before and after refinement", "The same holds at joint 2."),
    10: (
        "Decoupled against motor input only",
        "With the interaction torque as a second input the model has the joint's own "
        "anti-resonance and resonance; by motor input alone it has not.",
    ),
    11: (
        "One output against two under changing payload",
        "Only with the link velocity as a second output does the anti-resonance follow the "
        "payload.",
    ),
    12: (
        "Interaction torque on joint 1, joint 2 servoed",
        "With a servo on joint 2 the interaction torque is small at low frequencies, and the "
        "inertia stays constant.",
    ),
    13: (
        "PEM against the classical subspace method, joint 2 free or servoed",
        "PEM is right with joint 2 free and servoed; the classical subspace method is right with "
        "joint 2 free and biased with joint 2 servoed, because of the feedback.",
    ),
    14: (
        "Frequency responses over the amplitude",
        "The stronger the input, the higher anti-resonance and resonance of both joints.",
    ),
    15: (
        "Squared anti-resonance over the amplitude",
        "The squared anti-resonance, and so the equivalent stiffness, rises with the amplitude and "
        "stays between those of the gear's softest and stiffest slope.",
    ),
}
"""Title and claim by figure. The claim on Fig. 2 is in section 5 of the source."""


def comparison_of(
    figure: int,
    *,
    criteria: Sequence[Criterion],
    message: str,
    evidence: Sequence[Evidence] = (),
    values: Mapping[str, float] | None = None,
    plots: Sequence[Figure] = (),
) -> Comparison:
    """Comparison of one figure with its title and claim."""
    title, claim = CLAIMS[figure]
    return Comparison(
        figure=figure,
        title=title,
        claim=claim,
        criteria=tuple(criteria),
        evidence=tuple(evidence),
        message=message,
        plots=tuple(plots),
        values=values or {},
    )


def failed_comparison(figure: int, error: StrainwaveError) -> Comparison:
    """Comparison of a figure whose estimation failed: the claim is not shown."""
    evidence = Evidence(str(error), "estimation", "failed")
    return comparison_of(figure, criteria=(), message="the estimation failed", evidence=(evidence,))
