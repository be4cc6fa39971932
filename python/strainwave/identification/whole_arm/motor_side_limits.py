"""What a motor's encoder cannot say of the gear behind it, and why, in numbers of the fit."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from strainwave.domain import Diagnostic, Parameter
from strainwave.domain.combinations import value_of
from strainwave.domain.gear_laws import is_by_load, is_slope
from strainwave.dynamics.arm import Arm
from strainwave.identification.whole_arm.estimates import Fit
from strainwave.identification.whole_arm.parametrisation import VISCOUS, Key
from strainwave.numerics.filters import signal_band

_POOR = 0.1  # of a value: half-width of an interval from which a reason is given
_REACH = 1.96  # of a 95 % interval, in deviations
_NEAR_END = 0.5  # of the band, from which little is left of a resonance and its surroundings
_NO_PEAK = 0.5  # damping ratio from which a resonance hardly shows
_ROUNDING = 0.5  # share of the errors' variance from which they count as rounding
_MAIN = ("gear_damping", "motor_inertia", "link_inertia")


def motor_side_limits(
    fit: Fit, arm: Arm, parameters: Sequence[Parameter], at_bounds: Sequence[Key]
) -> Iterator[Diagnostic]:
    """Why gears without link sensors are known badly.

    Of a joint alone, with its motor free, the resonance lies at w_r^2 = k s, s = 1/m_L + n^2/m_M,
    and has the damping ratio d_G sqrt(s / k) / 2. The motor's encoder shows it only within the
    band where its angle stands above its own noise.

    Parameters
    ----------
    fit : Fit
        At its minimum.
    arm : Arm
    parameters : sequence of Parameter
        As published by the fit.
    at_bounds : sequence of (name, joint)
        Of those that ended at the end of their range.

    Yields
    ------
    Diagnostic
        One per joint and reason, of joints whose link has no sensor in any record.
    """
    have = {
        c.joint for r in fit.objective.records for c in r.channels if c.quantity != "motor_angle"
    }
    for number, joint in enumerate(arm.joints, start=1):
        if number in have or not joint.elastic:
            continue
        own = [p for p in parameters if p.joint == number]
        poor = [p for p in own if (p.name in _MAIN or is_slope(p.name)) and _is_poor(p, at_bounds)]
        if poor:
            reasons = list(_reasons(fit, arm, number))
            if reasons:
                text = f"{_named(poor, at_bounds)}: {', and '.join(reasons)}"
                text += "; an accelerometer or an encoder on the link would show it"
                yield Diagnostic("motor-side-limit", f"joint {number}", text)
        split = [p for p in own if p.name in VISCOUS and _is_poor(p, at_bounds)]
        if split:
            low = _anti_resonance(fit, arm, number)
            text = f"{_named(split, at_bounds)}: far below the anti-resonance, {low:.3g} Hz, motor"
            text += " and link move as one and only the sum d_M + n^2 d_L acts at the motor; use"
            text += " total_viscous_friction"
            yield Diagnostic("motor-side-limit", f"joint {number}", text)


def _is_poor(p: Parameter, at_bounds: Sequence[Key]) -> bool:
    if (p.name, p.joint) in at_bounds:
        return True
    if p.value is None or p.std is None:
        return not is_by_load(p.name)  # a slope that no record reaches has a warning of its own
    return _REACH * p.std > _POOR * abs(p.value)


def _named(poor: Sequence[Parameter], at_bounds: Sequence[Key]) -> str:
    """Each with how well it is known."""
    found = []
    for p in poor:
        known = "not identified"
        if (p.name, p.joint) in at_bounds:
            known = "at the end of its range"
        elif p.value is not None and p.std is not None:
            known = f"to {100.0 * _REACH * p.std / abs(p.value):.2g} % only"
        found.append(f"{p.label} {known}")
    return ", ".join(found)


def _mobility(fit: Fit, arm: Arm, joint: int) -> tuple[float, float, float]:
    """Stiffness, damping and s = 1/m_L + n^2/m_M of a fitted joint, link side."""
    values = fit.objective.space.values(fit.z)
    own, ratio = arm.joints[joint - 1].law, arm.joints[joint - 1].gear_ratio
    (stiffness,) = own.stiffness(own.of_joint(values, joint), np.zeros(1)).tolist()
    s = 1.0 / value_of(arm.link_inertia(joint), values) + ratio**2 / values["motor_inertia", joint]
    return stiffness, values["gear_damping", joint], s


def _anti_resonance(fit: Fit, arm: Arm, joint: int) -> float:
    """[Hz] sqrt(k / m_L) / 2 pi."""
    stiffness, _, _ = _mobility(fit, arm, joint)
    m_l = value_of(arm.link_inertia(joint), fit.objective.space.values(fit.z))
    return float(np.sqrt(stiffness / m_l) / (2.0 * np.pi))


def _reasons(fit: Fit, arm: Arm, joint: int) -> Iterator[str]:
    stiffness, damping, s = _mobility(fit, arm, joint)
    resonance = float(np.sqrt(stiffness * s) / (2.0 * np.pi))
    records = fit.objective.records
    logs = [record.log for record in records]
    shown = max(signal_band(log.channels[f"theta_m{joint}"], log.sample_time) for log in logs)
    band = min(shown, max(record.cutoff_hz for record in records))
    if resonance > _NEAR_END * band:
        where = "beyond" if resonance > band else "near the end of"
        yield (
            f"the gear is very stiff: its resonance, {resonance:.3g} Hz, lies {where} the band of"
            f" {band:.3g} Hz in which the motor's motion stands above its encoder's noise"
        )
    ratio = 0.5 * damping * float(np.sqrt(s / stiffness))
    if ratio > _NO_PEAK:
        yield (
            f"the gear is very damped: with a damping ratio of {ratio:.2g} its resonance,"
            f" {resonance:.3g} Hz, makes no peak in the motor's response"
        )
    counts = arm.joints[joint - 1].encoder_counts
    share, error, noise = _rounding(fit, joint)
    if counts and share > _ROUNDING:
        yield (
            f"the encoder is coarse: of the residuals of omega_m{joint}, {error:.2g} rad/s,"
            f" {noise:.2g} are the rounding of its {counts:g} counts per turn"
        )


def _rounding(fit: Fit, joint: int) -> tuple[float, float, float]:
    """Share of the errors of a motor's velocity that is rounding, and both deviations [rad/s].

    Of the record in which the motor moves most.
    """
    found = []
    for record, weights in zip(fit.objective.records, fit.objective.weights, strict=True):
        own = [(c.quantity, c.joint) for c in record.channels].index(("motor_angle", joint))
        slope = float(np.linalg.norm(record.kernels.taps(rate=True)))
        noise = record.counts[own] / np.sqrt(12.0) * slope
        moves = float(np.std(record.measured[:, own]))
        found.append((moves, float(weights.deviation[own]), float(noise)))
    _, error, noise = max(found)
    return min(1.0, (noise / error) ** 2) if error > 0.0 else 0.0, error, noise
