"""LinkSignals, RigidModel -> one Decoupled record a joint: interaction torques (13), (14)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from strainwave.errors import NotIdentifiable
from strainwave.records import (
    Caution,
    Check,
    Decoupled,
    FloatArray,
    LinkSignals,
    RigidModel,
    Study,
)
from strainwave.regressor import gear_ratios
from strainwave.simulation import build_arm

_SHARE = 0.95  # of the motor velocity's power that lies below the band's top
_LOWEST = 1.0  # [Hz]
_SEGMENTS = 8  # Welch segments in a record
_CONSTANT = 0.1  # largest relative change of the element (1,1)
_FULL = 0.8  # share of the band in which tau must stand out of its noise
_ABOVE = 4.0  # times the noise: a Welch estimate of 8 averages stays below that
_RICH = 1e-3  # least over largest eigenvalue: deviations are then 16 times those of lone inputs
_SEEN = 0.02  # of n tau over u
_SLIDING = 0.85  # share of the record in which the motor must slide


@dataclass(frozen=True, slots=True)
class DecouplingOptions:
    """What may be set by hand."""

    band_hz: tuple[float, float] | None = None  # of the checks; None: where the motor moves


def decouple(
    signals: LinkSignals,
    model: RigidModel,
    study: Study,
    options: DecouplingOptions | None = None,
) -> tuple[Decoupled, ...]:
    """Each joint as a two-inertia system of its own, driven by u and by the other links.

    u_i = e_i v_i - f_i sgn(dtheta_Mi) - f_0i at the motor, tau_i from `interaction_torques`.

    Parameters
    ----------
    signals : LinkSignals
    model : RigidModel
    study : Study
    options : DecouplingOptions, optional

    Returns
    -------
    tuple of Decoupled
        One a joint, from the base. A single joint without gravity has the one input u.

    Raises
    ------
    NotIdentifiable
        The rigid model lacks a parameter that the torques need.
    """
    chosen = options or DecouplingOptions()
    base = base_parameters(model, study)
    tau = interaction_torques(
        study, base, signals.link_angle, signals.link_velocity, signals.link_acceleration
    )
    acted_on = study.n_joints > 1 or study.arm.gravity is not None
    total = total_inertias(model, study)
    found = []
    for i in range(study.n_joints):
        u = signals.motor_torque[:, i] - _dry_friction(signals, model, i)
        inputs = np.column_stack([u, tau[:, i]]) if acted_on else u[:, None]
        band = chosen.band_hz or _band(signals, i)
        frequency, richness = _richness(inputs, signals.sample_time, band)
        checks = tuple(_checks(signals, study, base, i, inputs, band, richness))
        found.append(
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
                total_inertia=float(total[i]),
                total_viscous_friction=_viscous(model, study, i + 1),
                shared=signals.shared,
                fusion=signals.fusion[i],
                richness_hz=frequency,
                richness=richness,
                checks=checks,
                warnings=tuple(_warnings(signals, study, i, checks)),
            )
        )
    return tuple(found)


def base_parameters(model: RigidModel, study: Study) -> FloatArray:
    """What the link-side inverse dynamics need, from the rigid model.

    In alpha's place stands alpha + m_M1/n1^2, because the rigid model cannot part them; see
    `interaction_torques` for why nothing is lost.

    Parameters
    ----------
    model : RigidModel
    study : Study

    Returns
    -------
    (n_base,)
        In the order of the core's parameters.

    Raises
    ------
    NotIdentifiable
        One of them is not known.
    """
    arm = build_arm(study)
    still = np.zeros((1, study.n_joints))
    count = arm.base_regressor(still, still, still).shape[2]
    values = []
    for name, joint in arm.parameter_names[:count]:
        if name.startswith("gravity") and study.arm.gravity is None:
            values.append(0.0)
        elif name == "alpha":
            values.append(_known(model, "rigid_inertia", 1))
        elif study.n_joints == 1 and not name.startswith("gravity"):
            # its share of the total cancels likewise
            values.append(_known(model, "inertia", 1) / study.joints[0].gear_ratio ** 2)
        else:
            values.append(_known(model, name, joint))
    return np.array(values)


def interaction_torques(
    study: Study,
    base: FloatArray,
    angle: FloatArray,
    velocity: FloatArray,
    acceleration: FloatArray,
) -> FloatArray:
    """Torque of all the other links, of rates and of gravity on each link, (13), (14).

    tau_i = mbar_i ddq_i - [M(q) ddq + c(q, dq) + g(q)]_i,
    mbar_1 = alpha + beta + 2 gamma, mbar_2 = beta: each link's own inertia, the arm stretched.

    For joint 1 that is 2 gamma (1 - cos q2) ddq1 - (beta + gamma cos q2) ddq2 - c_1 - g_1. Here
    alpha has gone: it is in mbar_1 and, the same, in the (1,1) element of M. So any value may
    stand for it in both, and alpha + m_M1/n1^2 does. Gravity is a torque like the rest.

    Parameters
    ----------
    study : Study
    base : (n_base,)
        From `base_parameters`.
    angle, velocity, acceleration : (n_samples, n_joints) [rad, rad/s, rad/s^2]
        Of the links, relative.

    Returns
    -------
    (n_samples, n_joints) [N m] at the links
    """
    arm = build_arm(study)
    motion = tuple(np.ascontiguousarray(x) for x in (angle, velocity, acceleration))
    rigid = arm.base_regressor(*motion) @ base
    return np.asarray(own_inertias(study, base) * acceleration - rigid)


def own_inertias(study: Study, base: FloatArray) -> FloatArray:
    """mbar, each link's own inertia with the arm stretched, out of the core's regressor.

    Parameters
    ----------
    study : Study
    base : (n_base,)

    Returns
    -------
    (n_joints,) [kg m^2]
    """
    arm = build_arm(study)
    n_joints = study.n_joints
    still = np.zeros((n_joints, n_joints))
    unit: FloatArray = np.eye(n_joints)
    # row k: torques of a unit acceleration of joint k, less what gravity asks for at rest
    torque = arm.base_regressor(still, still, unit) @ base
    held = arm.base_regressor(still, still, still) @ base
    return np.asarray(np.diagonal(torque - held))


def total_inertias(model: RigidModel, study: Study) -> FloatArray:
    """c_1 = m_M + n^2 m_L of (18), at the motors.

    Parameters
    ----------
    model : RigidModel
    study : Study

    Returns
    -------
    (n_joints,) [kg m^2]

    Raises
    ------
    NotIdentifiable
        A parameter it is made of is not known.
    """
    own = own_inertias(study, base_parameters(model, study)) * gear_ratios(study) ** 2
    if study.n_joints > 1:
        own[1] += _known(model, "motor_inertia", 2)
    return np.asarray(own)


def _known(model: RigidModel, name: str, joint: int | None) -> float:
    value = model.value(name, joint)
    if value is None:
        place = f" of joint {joint}" if joint else ""
        raise NotIdentifiable(
            f"decoupling needs {name}{place}, which the motion records do not tell"
        )
    return value


def _viscous(model: RigidModel, study: Study, joint: int) -> float | None:
    alone = study.arm.kind == "single-joint" and study.joints[0].spring == "rigid"
    return model.value("motor_viscous_friction" if alone else "total_viscous_friction", joint)


def _dry_friction(signals: LinkSignals, model: RigidModel, i: int) -> FloatArray:
    coulomb = _known(model, "motor_coulomb_friction", i + 1)
    offset = model.value("friction_offset", i + 1) or 0.0
    return np.asarray(coulomb * signals.direction[:, i] + offset)


def _band(signals: LinkSignals, i: int) -> tuple[float, float]:
    """Where a motor moves."""
    frequency, power = _spectra(signals.motor_velocity[:, i : i + 1], signals.sample_time)
    share = np.cumsum(power[:, 0, 0].real)
    lowest = max(_LOWEST, frequency[1])
    if share[-1] == 0.0:
        return lowest, frequency[-1]
    return lowest, max(4.0 * lowest, float(frequency[np.searchsorted(share, _SHARE * share[-1])]))


def _spectra(columns: FloatArray, sample_time: float) -> tuple[FloatArray, FloatArray]:
    """Cross-spectral density matrices by Welch's method: (n_frequencies, n, n), complex."""
    from scipy.signal import csd

    segment = max(16, 2 * len(columns) // (_SEGMENTS + 1))
    rows = np.ascontiguousarray(columns.T)
    frequency, density = csd(
        rows[:, None], rows[None], 1.0 / sample_time, nperseg=min(segment, len(columns))
    )
    return frequency, np.moveaxis(density, -1, 0)


def _richness(
    inputs: FloatArray, sample_time: float, band: tuple[float, float]
) -> tuple[FloatArray, FloatArray]:
    """Least over largest eigenvalue of the inputs' coherency matrix, by frequency.

    Two inputs with the coherence gamma^2 have (1 - gamma)/(1 + gamma): zero where one is a linear
    function of the other, so that their effects cannot be told apart. At the ratio r the
    deviations are 1 / sqrt(4 r) times those of inputs without coherence, for small r.
    """
    frequency, density = _spectra(inputs, sample_time)
    inside = (frequency >= band[0]) & (frequency <= band[1])
    power = np.sqrt(np.einsum("fii->fi", density[inside]).real)
    floor = 1e-12 * power.max() if power.size else 1.0
    scale = np.maximum(power, max(floor, 1e-300))
    values = np.linalg.eigvalsh(density[inside] / (scale[:, :, None] * scale[:, None, :]))
    return frequency[inside], np.clip(values[:, 0], 0.0, None) / np.maximum(values[:, -1], 1e-300)


def _checks(
    signals: LinkSignals,
    study: Study,
    base: FloatArray,
    i: int,
    inputs: FloatArray,
    band: tuple[float, float],
    richness: FloatArray,
) -> Iterator[Check]:
    moving = float(np.mean(np.abs(signals.direction[:, i]) > 0.5))
    text = f"the motor slides in {100.0 * moving:.0f} % of the record"
    text += (
        ""
        if moving >= _SLIDING
        else "; a linear model takes stiction for inertia: raise the amplitude"
    )
    yield Check("sliding", moving >= _SLIDING, moving, _SLIDING, text)
    if inputs.shape[1] == 1:
        return
    yield _constancy(signals, study, base, i)
    n = study.joints[i].gear_ratio
    u, tau = inputs[:, 0] - inputs[:, 0].mean(), inputs[:, 1] - inputs[:, 1].mean()
    ratio = float(n * tau.std() / max(u.std(), 1e-300))
    text = f"n tau is {ratio:.3g} times u"
    text += "" if ratio >= _SEEN else "; too small for its effect to be estimated"
    yield Check("interaction-amplitude", ratio >= _SEEN, ratio, _SEEN, text)
    yield _fullness(inputs, signals.sample_time, band)
    rich = float(np.median(richness)) if richness.size else 0.0
    text = f"u and tau differ: eigenvalue ratio {rich:.3g}, median of {band[0]:.1f} to"
    text += f" {band[1]:.1f} Hz"
    if rich < _RICH:
        text = f"tau is nearly a linear function of u (eigenvalue ratio {rich:.1g}); excite both"
        text += " joints at once with independent sequences"
    yield Check("input-richness", rich >= _RICH, rich, _RICH, text)


def _constancy(signals: LinkSignals, study: Study, base: FloatArray, i: int) -> Check:
    """How much a link's own inertia changes in the motion; tau holds it, the paper's (13) not."""
    arm = build_arm(study)
    q = signals.link_angle
    unit = np.zeros_like(q)
    unit[:, i] = 1.0
    still = np.zeros_like(q)
    held = arm.base_regressor(np.ascontiguousarray(q), still, still) @ base
    inertia = (arm.base_regressor(np.ascontiguousarray(q), still, unit) @ base - held)[:, i]
    change = float(np.ptp(inertia) / own_inertias(study, base)[i])
    text = f"the link's own inertia changes by {100.0 * change:.2g} %"
    text += "" if change <= _CONSTANT else ", all of it in tau; keep the swing of joint 2 small"
    return Check("constant-inertia", change <= _CONSTANT, change, _CONSTANT, text)


def _fullness(inputs: FloatArray, sample_time: float, band: tuple[float, float]) -> Check:
    """Share of the band in which the power density of tau is above its noise."""
    frequency, density = _spectra(inputs, sample_time)
    power = density[:, 1, 1].real
    noise = float(np.median(power[frequency >= 0.5 * frequency[-1]]))
    inside = (frequency >= band[0]) & (frequency <= band[1])
    full = float(np.mean(power[inside] > _ABOVE * noise)) if inside.any() else 0.0
    text = f"tau is above its noise in {100.0 * full:.0f} % of the band"
    text += "" if full >= _FULL else "; raise the amplitude"
    return Check("interaction-spectrum", full >= _FULL, full, _FULL, text)


def _warnings(
    signals: LinkSignals, study: Study, i: int, checks: tuple[Check, ...]
) -> Iterator[Caution]:
    """Failed checks, of joints that were to be identified in this record."""
    if signals.experiment.joint not in (None, i + 1):
        return
    for check in checks:
        if not check.passed:
            where = f"{signals.experiment.name}, joint {i + 1}" if study.n_joints > 1 else ""
            yield Caution(check.name, where or signals.experiment.name, check.message)
