"""What the ratio of two joints' torques, against the symmetry of M(q), says of their constants."""

from __future__ import annotations

from strainwave.domain import Channel, Consistency, Correction, Study, Suspicion
from strainwave.signals.consistency.wording import number

_CERTAIN = 4.0  # standard deviations
_TOLERANCE = 0.03  # data sheets and amplifiers are good to some per cent
_DOUBTED = 1.25  # factor up to which what the model lacks may look like a wrong constant
_ABOUT = 0.02  # relative deviation from which a number is only about right


def torque_constants(value: float, std: float, study: Study) -> Suspicion | None:
    """A suspicion where one joint's torques certainly do not go with the other's.

    Parameters
    ----------
    value, std : float
        Joint 1's torques over joint 2's against what the symmetry of M(q) allows, and its standard
        deviation.
    study : Study

    Returns
    -------
    Suspicion or None
    """
    off = abs(value - 1.0)
    if off <= _CERTAIN * std or off <= _TOLERANCE:
        return None
    return wrong_torque_constant(value, std, study)


def doubted_torques(found: Consistency) -> Suspicion | None:
    """The suspicion of a torque constant that is off by little, where there is no other.

    The rigid fit knows no friction but the usual, and no drive but a linear one: what either does
    beyond that may break the symmetry of M(q) as a wrong constant does.

    Parameters
    ----------
    found : Consistency

    Returns
    -------
    Suspicion or None
    """
    if len(found.suspected) != 1:
        return None
    (only,) = found.suspected
    near = only.factor is not None and 1.0 / _DOUBTED < only.factor < _DOUBTED
    return only if only.code == "wrong-torque-constant" and near else None


def wrong_torque_constant(value: float, std: float, study: Study) -> Suspicion:
    """The suspicion that one of two torque constants is wrong; which of them no data show."""
    factor = number(value) if std < _ABOUT * value else f"about {number(value, 2)}"
    logged = any(name.startswith("torque") for name in study.channels)
    if logged:
        remedy = (
            f"Divide the scale of channels.torque1 by {factor}, or multiply that of channels."
            "torque2 by it, whichever is known less well"
        )
    else:
        remedy = (
            f"Divide torque_per_volt of [[joint]] 1 by {factor}, or multiply that of [[joint]] 2 "
            "by it, whichever is known less well"
        )
    return Suspicion(
        code="wrong-torque-constant",
        where="torque_per_volt",
        message=(
            f"the torques of joint 1 are {factor} (deviation {number(std, 2)}) times what the "
            "symmetry of the inertia matrix allows beside those of joint 2: one of the two torque "
            "constants is wrong, and which of them these signals do not show"
        ),
        remedy=remedy,
        factor=value,
        corrections=_corrections(value, study, logged=logged),
    )


def _corrections(value: float, study: Study, *, logged: bool) -> tuple[Correction, ...]:
    """Those of joint 1: which of the two constants is wrong the signals do not show."""
    if logged:
        scale = study.channels.get("torque1", Channel("torque1")).scale / value
        return (Correction("channels", "torque1", "scale", scale),)
    constant = study.arm.joints[0].torque_per_volt
    return (Correction("joint", "1", "torque_per_volt", constant / value),) if constant else ()
