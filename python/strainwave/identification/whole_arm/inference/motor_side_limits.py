"""Reasons why a motor encoder alone does not determine the parameters of a gear."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from strainwave.domain import Clause, Diagnostic, Parameter, Place
from strainwave.domain.combinations import value_of
from strainwave.domain.distributions import CI95_STDS
from strainwave.domain.gear_laws import is_by_load, is_slope
from strainwave.domain.keys import Key
from strainwave.domain.link_sensors import Group
from strainwave.domain.parameter_table import VISCOUS
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.two_inertia import TwoInertia, anti_resonance, resonance
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
    channels = (channel for record in fit.objective.records for channel in record.channels)
    sensed_joints = {c.joint for c in channels if c.sensor.group is not Group.MOTOR}
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
            reasons = tuple(_reasons(fit, arm, number))
            if reasons:
                estimates = _describe(poor, at_bounds)
                place = Place(joint=number)
                yield Diagnostic("motor-side-limit", place, estimates=estimates, reasons=reasons)
        poor_viscous = [p for p in joint_parameters if p.name in VISCOUS and _is_poor(p, at_bounds)]
        if poor_viscous:
            estimates, place = _describe(poor_viscous, at_bounds), Place(joint=number)
            hz = anti_resonance(_undamped_joint(fit, arm, number)).frequency_hz
            yield Diagnostic(
                "motor-side-limit", place, "viscous", estimates=estimates, anti_resonance_hz=hz
            )


def _is_poor(p: Parameter, at_bounds: Sequence[Key]) -> bool:
    """Whether a parameter is at a bound, unidentified, or has a wide confidence interval."""
    if p.key in at_bounds:
        return True
    if p.value is None or p.std is None:
        return not is_by_load(p.name)  # a slope outside the torque range has its own warning
    return CI95_STDS * p.std > _MAX_RELATIVE_HALF_WIDTH * abs(p.value)


def _describe(poor: Sequence[Parameter], at_bounds: Sequence[Key]) -> tuple[Clause, ...]:
    """List the parameters, each with its relative uncertainty."""
    descriptions = []
    for p in poor:
        description = Clause("poor/not-identified", label=p.label)
        if p.key in at_bounds:
            description = Clause("poor/at-bound", label=p.label)
        elif p.value and p.std is not None:
            half = CI95_STDS * p.std / abs(p.value)
            description = Clause("poor/wide", label=p.label, half=half)
        descriptions.append(description)
    return tuple(descriptions)


def _undamped_joint(fit: Fit, arm: Arm, joint: int) -> TwoInertia:
    """A fitted joint with a free motor, without friction and damping; stiffness at zero torsion."""
    values, description = fit.values, arm.joints[joint - 1]
    curve = description.law.of_joint(values, joint)
    return TwoInertia(
        motor_inertia=values["motor_inertia", joint],
        motor_viscous_friction=0.0,
        link_inertia=value_of(arm.link_inertia(joint), values),
        link_viscous_friction=0.0,
        gear_stiffness=float(description.law.stiffness(curve, np.zeros(1))[0]),
        gear_damping=0.0,
        gear_ratio=float(arm.gear_ratios[joint - 1]),
    )


def _reasons(fit: Fit, arm: Arm, joint: int) -> Iterator[Clause]:
    """Reasons why the motor encoder does not determine the gear: stiffness, damping, resolution."""
    undamped = _undamped_joint(fit, arm, joint)
    resonance_hz = resonance(undamped).frequency_hz
    records = fit.objective.records
    logs = [record.log for record in records]
    signal_hz = max(signal_band(log.channels[f"theta_m{joint}"], log.sample_time) for log in logs)
    band = min(signal_hz, max(record.cutoff_hz for record in records))
    if resonance_hz > _MAX_RESONANCE_BAND_SHARE * band:
        reason = "stiff/beyond" if resonance_hz > band else "stiff/near"
        yield Clause(reason, resonance_hz=resonance_hz, band_hz=band)
    damping = fit.values["gear_damping", joint]
    damping_ratio = np.pi * resonance_hz * damping / undamped.gear_stiffness
    if damping_ratio > _MAX_PEAK_DAMPING_RATIO:
        yield Clause("damped", damping_ratio=float(damping_ratio), resonance_hz=resonance_hz)
    counts = arm.joints[joint - 1].encoder_counts
    error, noise = _velocity_errors(fit, joint)
    if counts and noise**2 > _MIN_ROUNDING_SHARE * error**2:
        channel = f"omega_m{joint}"
        yield Clause("coarse", channel=channel, error=error, noise=noise, counts=counts)


def _velocity_errors(fit: Fit, joint: int) -> tuple[float, float]:
    """Standard deviations [rad/s] of the residual and of the encoder rounding of a motor velocity.

    They are those of the record in which the motor moves most.
    """
    errors = []
    for record, weights in zip(fit.objective.records, fit.objective.weights, strict=True):
        column = [c.channel for c in record.channels].index(f"theta_m{joint}")
        slope = np.linalg.norm(record.kernels.taps(rate=True))
        rounding = float(record.counts[column] / np.sqrt(12.0) * slope)
        motion = float(np.std(record.measured[:, column]))
        errors.append((motion, float(weights.stds[column]), rounding))
    return max(errors)[1:]
