"""Decoupling: compute interaction torques (13), (14) and one `Decoupled` record per joint."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from strainwave.domain import (
    Check,
    ComplexArray,
    Decoupled,
    Diagnostic,
    FloatArray,
    JointModel,
    LinkSignals,
    Place,
    RigidModel,
    Value,
)
from strainwave.domain.arm.combinations import is_uncoupled, viscous_friction
from strainwave.domain.arm.parameter_table import COULOMB, OFFSET
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.rigid_prediction import (
    base_parameters,
    interaction_torques,
    mean_postures,
    total_inertias,
)
from strainwave.errors import NotIdentifiable
from strainwave.numerics.spectra import cross_spectral_densities

_POWER_SHARE = 0.95  # share of the motor velocity's power below the upper edge of the band
_MIN_FREQUENCY_HZ = 1.0  # [Hz] minimum of the lower edge of the band
_N_SEGMENTS = 8  # number of Welch segments in a record
_MAX_INERTIA_CHANGE = 0.1  # maximum relative change of the element (1,1) of M(q)
_MIN_BAND_SHARE = 0.8  # minimum share of the band in which tau exceeds its noise
_NOISE_FACTOR = 4.0  # factor on the noise level; a Welch estimate with 8 averages stays below it
# minimum eigenvalue ratio: standard deviations are 16 times those of independent inputs
_MIN_EIGENVALUE_RATIO = 1e-3
_MIN_INTERACTION_RATIO = 0.02  # minimum of n tau over u
_MIN_SLIDING_SHARE = 0.85  # minimum share of the record in which the motor slides


@dataclass(frozen=True, slots=True)
class DecouplingOptions:
    """Options of `decouple`."""

    band_hz: tuple[float, float] | None = None  # of the checks; None: band of the motor motion


def decouple(
    signals: LinkSignals,
    model: RigidModel | None,
    arm: Arm,
    options: DecouplingOptions | None = None,
    postures: FloatArray | None = None,
) -> tuple[Decoupled, ...]:
    """Decouple each joint into a two-inertia system with the inputs u and tau.

    u_i = e_i v_i - f_i sgn(dtheta_Mi) - f_0i at the motor; tau_i is from `interaction_torques`.

    Returns one record per joint, from the base. `model` may be None for a single joint without
    gravity. Friction that the rigid step does not identify remains in u: see `subtract_friction`. A
    single joint without gravity has only the input u.
    Row i of `postures` (n_joints, n_joints) [rad] has the link angles at which m_L of joint i is
    taken, the same for all records that are fitted together; None: the mean angles of the record.

    Raises `NotIdentifiable` if the rigid model is missing or lacks a parameter of the torques.
    """
    options = options or DecouplingOptions()
    if postures is None:
        postures = mean_postures([signals])
    base, tau = _interaction(signals, model, arm, postures)
    records = []
    for i in range(arm.n_joints):
        u = signals.motor_torque[:, i]
        if model is not None and (coulomb := model.value(COULOMB, i + 1)) is not None:
            offset = model.value(OFFSET, i + 1) or 0.0
            u = u - (coulomb * signals.direction[:, i] + offset)
        inputs = u[:, None] if tau is None else np.column_stack([u, tau[:, i]])
        band = options.band_hz or _motion_band(signals, i)
        frequency, density = _spectra(inputs, signals.sample_time)
        inside = (frequency >= band[0]) & (frequency <= band[1])
        share = float(np.mean(np.abs(signals.direction[:, i]) > 0.5))
        checks = [_check("sliding", share, _MIN_SLIDING_SHARE, share=share)]
        if tau is not None:
            checks.append(_check_inertia(signals, arm, base, i))
            checks += _check_interaction(inputs, arm.gear_ratios[i], frequency, density, band)
        records.append(
            Decoupled(
                experiment=signals.experiment,
                joint=i + 1,
                time=signals.time,
                sample_time=signals.sample_time,
                inputs=inputs,
                outputs=np.column_stack(
                    [signals.motor_velocity[:, i], signals.link_velocity[:, i]]
                ),
                valid=np.asarray(signals.valid.all(axis=1)),
                held=signals.held[i],
                gear_ratio=float(arm.gear_ratios[i]),
                total_inertia=float(total_inertias(model, arm, postures)[i]) if model else None,
                total_viscous_friction=(
                    model.value(viscous_friction(arm), i + 1) if model else None
                ),
                bandwidth_hz=signals.bandwidth_hz,
                shared=signals.shared,
                fusion=signals.links[i].fusion,
                richness_hz=frequency[inside],
                checks=tuple(checks),
                warnings=tuple(_warnings(signals, arm, i, checks)),
                posture=tuple(postures[i].tolist()),
            )
        )
    return tuple(records)


def _interaction(
    signals: LinkSignals, model: RigidModel | None, arm: Arm, postures: FloatArray
) -> tuple[FloatArray, FloatArray | None]:
    """Base parameters and interaction torques; None if no interaction torque acts on the joint."""
    if is_uncoupled(arm):
        return np.zeros(0), None
    if model is None:
        raise NotIdentifiable(
            "the torques of gravity and other links require a rigid model: add a motion record"
        )
    base = base_parameters(model, arm)
    motion = (signals.link_angle, signals.link_velocity, signals.link_acceleration)
    return base, interaction_torques(arm, base, *motion, postures)


def subtract_friction(signals: LinkSignals, part: Decoupled, joint: JointModel) -> Decoupled:
    """Subtract Coulomb friction and offset that the rigid step does not identify from u.

    Returns u - f sgn(dtheta_M) - f_0, as `decouple` computes with a rigid model. The friction comes
    from `motor_coulomb_friction` and `friction_offset` of `joint`, if it has them.
    """
    i = part.joint - 1
    coulomb_torque = joint.values.get(COULOMB, 0.0) * signals.direction[:, i]
    inputs = part.inputs.copy()
    inputs[:, 0] -= coulomb_torque + joint.values.get(OFFSET, 0.0)
    return replace(part, inputs=inputs)


def _motion_band(signals: LinkSignals, i: int) -> tuple[float, float]:
    """Frequency band [Hz] of the motor velocity's power."""
    frequency, power = _spectra(signals.motor_velocity[:, i : i + 1], signals.sample_time)
    share = np.cumsum(power[:, 0, 0].real)
    lowest = max(_MIN_FREQUENCY_HZ, frequency[1])
    if share[-1] == 0.0:
        return lowest, frequency[-1]
    return lowest, max(
        4.0 * lowest, float(frequency[np.searchsorted(share, _POWER_SHARE * share[-1])])
    )


def _spectra(columns: FloatArray, sample_time: float) -> tuple[FloatArray, ComplexArray]:
    """Frequencies, and cross-spectral densities (n_frequencies, n, n) by Welch's method."""
    segment = max(16, 2 * len(columns) // (_N_SEGMENTS + 1))
    return cross_spectral_densities(columns, sample_time, min(segment, len(columns)))


def _check(name: str, value: float, least: float, **values: Value) -> Check:
    """Check that a value is not below its limit."""
    return Check(name, value >= least, value, least, tuple(values.items()))


def _check_inertia(signals: LinkSignals, arm: Arm, base: FloatArray, i: int) -> Check:
    """Change of a link's own inertia in the motion, which is part of tau here but not in (13)."""
    q = signals.link_angle
    unit_acceleration = np.zeros_like(q)
    unit_acceleration[:, i] = 1.0
    zero = np.zeros_like(q)
    static_torque = arm.link_torques(base, q, zero, zero)
    inertia = (arm.link_torques(base, q, zero, unit_acceleration) - static_torque)[:, i]
    change, limit = float(np.ptp(inertia) / np.mean(inertia)), _MAX_INERTIA_CHANGE
    values = (("change", change), ("joint", i + 2))
    return Check("constant-inertia", change <= limit, change, limit, values)


def _check_interaction(
    inputs: FloatArray,
    gear_ratio: float,
    frequency: FloatArray,
    density: ComplexArray,
    band: tuple[float, float],
) -> Iterator[Check]:
    """Whether tau acts on the joint, exceeds its noise, and is separable from u.

    The inputs are separable by the ratio of smallest to largest eigenvalue of their coherency
    matrix. With coherence gamma^2 it is (1 - gamma)/(1 + gamma); it is zero if one input is a
    linear function of the other. For a small ratio r, the standard deviations are 1 / sqrt(4 r)
    times those of inputs without coherence.
    """
    low, high = band
    inside = (frequency >= low) & (frequency <= high)
    u, tau = inputs.std(axis=0)
    ratio = float(gear_ratio * tau / max(u, 1e-300))
    yield _check("interaction-amplitude", ratio, _MIN_INTERACTION_RATIO, ratio=ratio)
    power = density[:, 1, 1].real
    noise = float(np.median(power[frequency >= 0.5 * frequency[-1]]))
    share = float(np.mean(power[inside] > _NOISE_FACTOR * noise)) if inside.any() else 0.0
    yield _check("interaction-spectrum", share, _MIN_BAND_SHARE, share=share)
    amplitude = np.sqrt(np.einsum("fii->fi", density[inside]).real)
    scale = np.maximum(amplitude, max(1e-12 * amplitude.max(initial=0.0), 1e-300))
    coherency = density[inside] / (scale[:, :, None] * scale[:, None, :])
    eigenvalues = np.linalg.eigvalsh(coherency)
    smallest, largest = np.clip(eigenvalues[:, 0], 0.0, None), eigenvalues[:, -1]
    ratio = float(np.median(smallest / np.maximum(largest, 1e-300))) if inside.any() else 0.0
    yield _check(
        "input-richness", ratio, _MIN_EIGENVALUE_RATIO, ratio=ratio, low_hz=low, high_hz=high
    )


def _warnings(
    signals: LinkSignals, arm: Arm, i: int, checks: Sequence[Check]
) -> Iterator[Diagnostic]:
    """Warnings for failed checks of the joints that the record identifies."""
    if signals.experiment.joint not in (None, i + 1):
        return
    for check in checks:
        if not check.passed:
            joint = i + 1 if arm.n_joints > 1 else None
            place = Place.in_records(signals.experiment.name, joint=joint)
            yield Diagnostic.of(check.name, place, check.clause)
