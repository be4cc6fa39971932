"""Reasons why a motor encoder alone does not determine the parameters of a gear."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from strainwave.domain import Diagnostic, Parameter
from strainwave.domain.combinations import value_of
from strainwave.domain.distributions import CI95_STDS
from strainwave.domain.gear_laws import is_by_load, is_slope
from strainwave.domain.keys import Key
from strainwave.domain.parameter_table import VISCOUS
from strainwave.dynamics.arm import Arm
from strainwave.identification.whole_arm.search.fit import Fit
from strainwave.numerics.filters import signal_band

# half-width of a confidence interval, relative to its value, that needs a reason
_MAX_RELATIVE_HALF_WIDTH = 0.1
_MAX_RESONANCE_BAND_SHARE = 0.5  # share of the band above which a resonance is attenuated
_MAX_PEAK_DAMPING_RATIO = 0.5  # damping ratio above which a resonance has hardly any peak
_MIN_ROUNDING_SHARE = 0.5  # share of the residual variance above which encoder rounding dominates
# parameters that need a reason, in addition to the slopes of the gear
_MAIN_PARAMETERS = ("gear_damping", "motor_inertia", "link_inertia")


def motor_side_limits(
    fit: Fit, arm: Arm, parameters: Sequence[Parameter], at_bounds: Sequence[Key]
) -> Iterator[Diagnostic]:
    """Explain wide confidence intervals of gears without link sensors.

    The resonance of a single joint with a free motor is w_r^2 = k s, s = 1/m_L + n^2/m_M, and its
    damping ratio is d_G sqrt(s / k) / 2. The motor encoder shows it only in the band in which the
    motor angle exceeds the encoder noise.

    `fit` is at its minimum, `parameters` are its published parameters, and `at_bounds` lists those
    at a bound of their range. Yields at most one diagnostic on the gear and one on viscous friction
    for each joint whose link has no sensor in any record.
    """
    sensed_joints = {
        c.joint for r in fit.objective.records for c in r.channels if c.quantity != "motor_angle"
    }
    for number, joint in enumerate(arm.joints, start=1):
        if number in sensed_joints or not joint.elastic:
            continue
        joint_parameters = [p for p in parameters if p.joint == number]
        poor = [
            p
            for p in joint_parameters
            if (p.name in _MAIN_PARAMETERS or is_slope(p.name)) and _is_poor(p, at_bounds)
        ]
        if poor:
            reasons = list(_reasons(fit, arm, number))
            if reasons:
                text = f"{_describe(poor, at_bounds)}: {', and '.join(reasons)}"
                text += "; an accelerometer or an encoder on the link would show it"
                yield Diagnostic("motor-side-limit", f"joint {number}", text)
        poor_viscous = [p for p in joint_parameters if p.name in VISCOUS and _is_poor(p, at_bounds)]
        if poor_viscous:
            anti_resonance_hz = _anti_resonance(fit, arm, number)
            text = (
                f"{_describe(poor_viscous, at_bounds)}: far below the anti-resonance,"
                f" {anti_resonance_hz:.3g} Hz, motor"
            )
            text += " and link move as one and only the sum d_M + n^2 d_L acts at the motor; use"
            text += " total_viscous_friction"
            yield Diagnostic("motor-side-limit", f"joint {number}", text)


def _is_poor(p: Parameter, at_bounds: Sequence[Key]) -> bool:
    """Whether a parameter is at a bound, unidentified, or has a wide confidence interval."""
    if (p.name, p.joint) in at_bounds:
        return True
    if p.value is None or p.std is None:
        return not is_by_load(p.name)  # a slope outside the torque range has its own warning
    return CI95_STDS * p.std > _MAX_RELATIVE_HALF_WIDTH * abs(p.value)


def _describe(poor: Sequence[Parameter], at_bounds: Sequence[Key]) -> str:
    """List the parameters, each with its relative uncertainty."""
    descriptions = []
    for p in poor:
        uncertainty = "not identified"
        if (p.name, p.joint) in at_bounds:
            uncertainty = "at the limit of its range"
        elif p.value is not None and p.std is not None:
            uncertainty = f"to {100.0 * CI95_STDS * p.std / abs(p.value):.2g} % only"
        descriptions.append(f"{p.label} {uncertainty}")
    return ", ".join(descriptions)


def _joint_dynamics(fit: Fit, arm: Arm, joint: int) -> tuple[float, float, float]:
    """Stiffness, damping and s = 1/m_L + n^2/m_M of a fitted joint, link side.

    The stiffness is that at zero torsion.
    """
    values = fit.objective.space.values(fit.z)
    law, ratio = arm.joints[joint - 1].law, arm.joints[joint - 1].gear_ratio
    (stiffness,) = law.stiffness(law.of_joint(values, joint), np.zeros(1)).tolist()
    s = 1.0 / value_of(arm.link_inertia(joint), values) + ratio**2 / values["motor_inertia", joint]
    return stiffness, values["gear_damping", joint], s


def _anti_resonance(fit: Fit, arm: Arm, joint: int) -> float:
    """Anti-resonance frequency sqrt(k / m_L) / (2 pi) [Hz]."""
    stiffness, _, _ = _joint_dynamics(fit, arm, joint)
    m_l = value_of(arm.link_inertia(joint), fit.objective.space.values(fit.z))
    return float(np.sqrt(stiffness / m_l) / (2.0 * np.pi))


def _reasons(fit: Fit, arm: Arm, joint: int) -> Iterator[str]:
    """Reasons why the motor encoder does not determine the gear: stiffness, damping, resolution."""
    stiffness, damping, s = _joint_dynamics(fit, arm, joint)
    resonance = float(np.sqrt(stiffness * s) / (2.0 * np.pi))
    records = fit.objective.records
    logs = [record.log for record in records]
    signal_hz = max(signal_band(log.channels[f"theta_m{joint}"], log.sample_time) for log in logs)
    band = min(signal_hz, max(record.cutoff_hz for record in records))
    if resonance > _MAX_RESONANCE_BAND_SHARE * band:
        where = "beyond" if resonance > band else "near the end of"
        yield (
            f"the gear is very stiff: its resonance, {resonance:.3g} Hz, lies {where} the band of"
            f" {band:.3g} Hz in which the motor's motion stands above its encoder's noise"
        )
    damping_ratio = 0.5 * damping * float(np.sqrt(s / stiffness))
    if damping_ratio > _MAX_PEAK_DAMPING_RATIO:
        yield (
            f"the gear is very damped: with a damping ratio of {damping_ratio:.2g} its resonance,"
            f" {resonance:.3g} Hz, makes no peak in the motor's response"
        )
    counts = arm.joints[joint - 1].encoder_counts
    share, error, noise = _rounding_share(fit, joint)
    if counts and share > _MIN_ROUNDING_SHARE:
        yield (
            f"the encoder is coarse: of the residuals of omega_m{joint}, {error:.2g} rad/s,"
            f" {noise:.2g} are the rounding of its {counts:g} counts per turn"
        )


def _rounding_share(fit: Fit, joint: int) -> tuple[float, float, float]:
    """Share of encoder rounding in the residual variance of a motor velocity.

    The second and third values are the standard deviations of residual and rounding [rad/s]. They
    refer to the record in which the motor moves most.
    """
    candidates = []
    for record, weights in zip(fit.objective.records, fit.objective.weights, strict=True):
        column = [(c.quantity, c.joint) for c in record.channels].index(("motor_angle", joint))
        slope = float(np.linalg.norm(record.kernels.taps(rate=True)))
        noise = record.counts[column] / np.sqrt(12.0) * slope
        motion = float(np.std(record.measured[:, column]))
        candidates.append((motion, float(weights.stds[column]), float(noise)))
    _, error, noise = max(candidates)
    return min(1.0, (noise / error) ** 2) if error > 0.0 else 0.0, error, noise
