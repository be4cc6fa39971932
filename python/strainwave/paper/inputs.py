"""Inputs of a joint: the PRBS (Fig. 4), and the interaction torque (Figs. 5 and 12)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from strainwave.domain import BoolArray, Comparison, Control, Criterion, FloatArray
from strainwave.dynamics.interaction_torque import interaction_torques
from strainwave.numerics.filters import apply_lags
from strainwave.paper.claims import comparison_of
from strainwave.paper.rig import CLOCK_PERIOD, MAX_AMPLITUDE, PRBS_ORDER, Rig, Run
from strainwave.presentation.figures import Figure
from strainwave.presentation.figures.curves import Series, lines, spectrum

PRBS_PERIOD = (2**PRBS_ORDER - 1) * CLOCK_PERIOD  # [s]
_PLOTTED_DURATION = 0.3  # [s]
_MAX_SERVO_HZ = 5.0  # below the anti-resonance, where the servo holds the joint
_MAX_RIPPLE_DB = 3.0  # half the power
_MIN_TORQUE_FIT = 95.0  # [%] of the computed torque
_MIN_BAND_SHARE = 0.8  # in which the torque exceeds its noise
_MIN_COSINE = 0.999  # of joint 2's angle, for a constant inertia
_MAX_SERVO_POWER_DB = -3.0  # relative to the free joint


def prbs(rig: Rig) -> Comparison:
    """Fig. 4: input of joint 1."""
    run = rig.prbs(1)
    voltage = run.trajectory["voltage"][:, 0]
    frequency, density = _density(voltage, run)
    inside = (frequency >= 1.0) & (frequency <= 100.0)
    ripple = float(np.ptp(10.0 * np.log10(density[inside])))
    levels = np.unique(np.round(voltage, 9))
    is_shown = run.trajectory.time < _PLOTTED_DURATION
    return comparison_of(
        4,
        criteria=(
            Criterion("levels", float(len(levels)), "at most", 2.0, "a binary sequence has two"),
            Criterion(
                "ripple of the density from 1 to 100 Hz [dB]",
                ripple,
                "at most",
                _MAX_RIPPLE_DB,
                "half the power, the usual edge of a band",
            ),
        ),
        values={"amplitude_v": float(np.abs(voltage).max())},
        message=f"{len(levels)} levels of ±{MAX_AMPLITUDE:g} V; the density varies by "
        f"{ripple:.2f} dB from 1 to 100 Hz",
        plots=(
            lines(
                [Series("u1", run.trajectory.time[is_shown], voltage[is_shown])],
                "time [s]",
                "voltage [V]",
                "Input of joint 1, its first 0.3 s",
            ),
            spectrum([Series("u1", frequency, density)], "V²/Hz", "Its power spectral density"),
        ),
    )


def free(rig: Rig) -> Comparison:
    """Fig. 5: torque of link 2 on link 1 with joint 2 free."""
    run = rig.prbs(1)
    tau, true, fit = _interaction_torque(run)
    frequency, density = _density(tau, run)
    spectrum_check = next(c for c in run.decoupled.checks if c.name == "interaction-spectrum")
    cosine = _least_cosine(run)
    early = run.trajectory.time < PRBS_PERIOD
    return comparison_of(
        5,
        criteria=(
            Criterion(
                "share of the band in which the torque is above its noise",
                spectrum_check.value,
                "at least",
                _MIN_BAND_SHARE,
                "below it, identify warns of a poor second input",
            ),
            _cosine_criterion(cosine),
            _fit_criterion(fit),
        ),
        values={"rms_n_m": float(tau.std())},
        message=f"above its noise in {100.0 * spectrum_check.value:.0f} % of the band; "
        f"{fit:.1f} % fit to the true torque; least cosine of joint 2 {cosine:.5f}",
        plots=(
            *_torque_plots(run, tau, true, early),
            _spectra({"joint 2 free": (frequency, density)}),
        ),
    )


def servoed(rig: Rig) -> Comparison:
    """Fig. 12: torque of link 2 on link 1 with joint 2 under its servo."""
    densities, slow = {}, {}
    controls: tuple[tuple[str, Control], ...] = (("free", "open"), ("servoed", "servo"))
    for name, other in controls:
        run = rig.prbs(1, other=other)
        tau, true, fit = _interaction_torque(run)
        frequency, density = _density(tau, run)
        densities[f"joint 2 {name}"] = (frequency, density)
        cosine = _least_cosine(run)
        slow[name] = float(density[(frequency >= 1.0) & (frequency <= _MAX_SERVO_HZ)].mean())
    drop = 10.0 * float(np.log10(slow["servoed"] / slow["free"]))
    early = run.trajectory.time < PRBS_PERIOD
    return comparison_of(
        12,
        criteria=(
            Criterion(
                f"power from 1 to {_MAX_SERVO_HZ:g} Hz against the free joint [dB]",
                drop,
                "at most",
                _MAX_SERVO_POWER_DB,
                "half the power",
            ),
            _cosine_criterion(cosine),
            _fit_criterion(fit),
        ),
        message=f"{drop:+.1f} dB from 1 to {_MAX_SERVO_HZ:g} Hz against the free joint; {fit:.1f} "
        f"% fit to the true torque; least cosine of joint 2 {cosine:.5f}",
        plots=(*_torque_plots(run, tau, true, early), _spectra(densities)),
    )


def _least_cosine(run: Run) -> float:
    """Smallest cosine of joint 2's angle from its motor encoder, as the source computes it."""
    ratio = run.arm.joints[1].gear_ratio
    return float(np.cos(ratio * run.log.channels["theta_m2"]).min())


def _cosine_criterion(cosine: float) -> Criterion:
    return Criterion(
        "least cosine of the angle of joint 2",
        cosine,
        "at least",
        _MIN_COSINE,
        "limit of the source for a constant inertia",
        "in open loop this arm swings further than that of the source",
    )


def _fit_criterion(fit: float) -> Criterion:
    return Criterion(
        "fit of the computed to the true torque [%]",
        fit,
        "at least",
        _MIN_TORQUE_FIT,
        "errors of 5 % in the base parameters change the link inertia by 2.4 %",
    )


class _InteractionTorque(NamedTuple):
    computed: FloatArray
    true: FloatArray
    fit_percent: float


def _interaction_torque(run: Run) -> _InteractionTorque:
    joint = run.decoupled.joint
    tau = run.decoupled.inputs[:, 1]
    motion = (run.trajectory[q] for q in ("link_angle", "link_velocity", "link_acceleration"))
    base = np.array([run.values.get(key, 0.0) for key in run.arm.base_names])
    true = interaction_torques(run.arm, base, *motion)[:, joint - 1]
    true = apply_lags(true, run.decoupled.shared, run.decoupled.sample_time)
    valid = run.decoupled.valid
    error = np.linalg.norm((tau - true)[valid])
    fit = 100.0 * (1.0 - error / np.linalg.norm(true[valid] - true[valid].mean()))
    return _InteractionTorque(tau, true, float(fit))


def _density(signal: FloatArray, run: Run) -> tuple[FloatArray, FloatArray]:
    """Power spectral density with segments of one period, for which a PRBS has no leakage."""
    from scipy.signal import welch

    T = run.decoupled.sample_time
    segment = min(len(signal), round(PRBS_PERIOD / T))
    frequency, density = welch(signal, 1.0 / T, window="boxcar", nperseg=segment, noverlap=0)
    is_shown = (frequency > 0.0) & (frequency <= 500.0)
    return np.asarray(frequency[is_shown]), np.asarray(density[is_shown])


def _torque_plots(
    run: Run, tau: FloatArray, true: FloatArray, rows: BoolArray
) -> tuple[Figure, ...]:
    time = run.trajectory.time[rows]
    return (
        lines(
            [Series("true", time, true[rows], true=True), Series("computed", time, tau[rows])],
            "time [s]",
            "torque [N m]",
            "Interaction torque on link 1, one period",
        ),
    )


def _spectra(densities: dict[str, tuple[FloatArray, FloatArray]]) -> Figure:
    series = [Series(name, f[f <= 200.0], p[f <= 200.0]) for name, (f, p) in densities.items()]
    return spectrum(series, "(N m)²/Hz", "Its power spectral density")
