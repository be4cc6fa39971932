"""Detection of a wrong torque constant from the ratio of the torques of two joints."""

from __future__ import annotations

from collections.abc import Mapping

from strainwave.domain import (
    Channel,
    Clause,
    Consistency,
    Correction,
    Place,
    Study,
    Suspicion,
    channel_parts,
)

# Minimum significance of a ratio other than 1, in standard deviations.
_MIN_SIGNIFICANCE = 4.0
# Tolerated relative error; data sheets and amplifiers are accurate to a few percent.
_TOLERANCE = 0.03
# Largest factor that unmodelled effects can imitate.
_MAX_DOUBTFUL_FACTOR = 1.25
# Relative standard deviation above which messages state the factor as approximate.
_MIN_APPROXIMATE_STD = 0.02


def suspect_torque_constants(
    ratios: Mapping[int, tuple[float, float]], study: Study
) -> Suspicion | None:
    """Suspicion of a wrong torque constant if a torque ratio differs significantly from 1.

    `ratios` has the ratio of the torque-constant error of joint 1 to that of each other joint, from
    the symmetry of M(q), and its standard deviation.
    """
    wrong = {
        joint: (value, std)
        for joint, (value, std) in ratios.items()
        if abs(value - 1.0) > max(_MIN_SIGNIFICANCE * std, _TOLERANCE)
    }
    if not wrong:
        return None
    joint = max(wrong, key=lambda each: abs(wrong[each][0] - 1.0) / max(wrong[each][1], 1e-300))
    value, std = wrong[joint]
    is_precise = std < _MIN_APPROXIMATE_STD * value
    factor = Clause("factor" if is_precise else "factor/about", value=value)
    logged = any(channel_parts(name)[0] == "torque" for name in study.channels)
    remedy = "remedy/logged-torques" if logged else "remedy/torque-constants"
    # of joint 1; the signals do not determine which of the two constants is wrong
    corrections: tuple[Correction, ...] = ()
    if logged:
        scale = study.channels.get("torque1", Channel("torque1")).scale / value
        corrections = (Correction("channels", "torque1", "scale", scale),)
    elif constant := study.arm.joints[0].known_torque_per_volt:
        corrections = (Correction("joint", "1", "torque_per_volt", constant / value),)
    return Suspicion(
        code="wrong-torque-constant",
        places=(Place(key="torque_per_volt"),),
        clause=Clause("wrong-torque-constant", factor=factor, std=std, joint=joint),
        remedy_clause=Clause(remedy, factor=factor, joint=joint),
        factor=value,
        corrections=corrections,
    )


def find_doubtful_torque_constant(consistency: Consistency) -> Suspicion | None:
    """The only suspicion, if it is a wrong torque constant with a factor near 1; else None.

    The rigid fit assumes Coulomb and viscous friction and a linear drive. Other friction terms or
    a nonlinear drive can violate the symmetry of M(q) in the same way as a wrong torque constant.
    """
    if len(consistency.deciding) != 1:
        return None
    (suspicion,) = consistency.deciding
    is_near_one = (
        suspicion.factor is not None
        and 1.0 / _MAX_DOUBTFUL_FACTOR < suspicion.factor < _MAX_DOUBTFUL_FACTOR
    )
    return suspicion if suspicion.code == "wrong-torque-constant" and is_near_one else None
