"""Inputs of a joint: the PRBS (Fig. 4), and the interaction torque (Figs. 5 and 12)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from reproduction.document import comparison_of, criterion_of
from reproduction.records import Comparison, Criterion
from reproduction.rig import CLOCK_PERIOD, MAX_AMPLITUDE, PRBS_ORDER, Rig, Run
from strainwave.domain import Control, FloatArray
from strainwave.dynamics.rigid_prediction import interaction_torques
from strainwave.numerics.filters import apply_lags
from strainwave.report.figures import Figure
from strainwave.report.figures.curves import Series, lines, spectrum

PRBS_PERIOD = (2**PRBS_ORDER - 1) * CLOCK_PERIOD  # [s]
_PLOTTED_DURATION = 0.3  # [s]
_MAX_SERVO_HZ = 5.0  # below the anti-resonance, where the servo holds the joint


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
            criterion_of("levels", float(len(levels))),
            criterion_of("ripple", ripple),
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
    torque = _InteractionTorque.of(run)
    spectrum_check = next(c for c in run.decoupled.checks if c.name == "interaction-spectrum")
    return comparison_of(
        5,
        criteria=(
            criterion_of("band-share", spectrum_check.value),
            *torque.criteria(),
        ),
        values={"rms_n_m": float(torque.computed.std())},
        message=f"above its noise in {100.0 * spectrum_check.value:.0f} % of the band; "
        f"{torque.describe()}",
        plots=(torque.plot(run), _spectra({"free": torque})),
    )


def servoed(rig: Rig) -> Comparison:
    """Fig. 12: torque of link 2 on link 1 with joint 2 under its servo."""
    controls: tuple[tuple[str, Control], ...] = (("free", "open"), ("servoed", "servo"))
    runs = {name: rig.prbs(1, other=other) for name, other in controls}
    torques = {name: _InteractionTorque.of(run) for name, run in runs.items()}
    slow = {name: torque.slow_power for name, torque in torques.items()}
    drop = 10.0 * float(np.log10(slow["servoed"] / slow["free"]))
    torque = torques["servoed"]
    return comparison_of(
        12,
        criteria=(
            criterion_of("servo-power", drop, hz=_MAX_SERVO_HZ),
            *torque.criteria(),
        ),
        message=f"{drop:+.1f} dB from 1 to {_MAX_SERVO_HZ:g} Hz against the free joint; "
        f"{torque.describe()}",
        plots=(torque.plot(runs["servoed"]), _spectra(torques)),
    )


@dataclass(frozen=True, slots=True)
class _InteractionTorque:
    """Interaction torque on the excited joint in one run."""

    computed: FloatArray
    true: FloatArray
    fit_percent: float
    cosine: float  # smallest of joint 2's angle from its motor encoder, as in the source
    frequency: FloatArray
    density: FloatArray  # of `computed`

    @classmethod
    def of(cls, run: Run) -> _InteractionTorque:
        record = run.decoupled
        tau = record.inputs[:, 1]
        motion = (run.trajectory[q] for q in ("link_angle", "link_velocity", "link_acceleration"))
        base = np.array([run.values.get(key, 0.0) for key in run.arm.base_names])
        true = interaction_torques(run.arm, base, *motion)[:, record.joint - 1]
        true = apply_lags(true, record.shared, record.sample_time)
        error = np.linalg.norm((tau - true)[record.valid])
        spread = np.linalg.norm(true[record.valid] - true[record.valid].mean())
        angle = run.arm.joints[1].gear_ratio * run.log.channels["theta_m2"]
        fit = float(100.0 * (1.0 - error / spread))
        return cls(tau, true, fit, float(np.cos(angle).min()), *_density(tau, run))

    @property
    def slow_power(self) -> float:
        """Mean density in the band in which the servo holds the joint."""
        is_slow = (self.frequency >= 1.0) & (self.frequency <= _MAX_SERVO_HZ)
        return float(self.density[is_slow].mean())

    def criteria(self) -> tuple[Criterion, Criterion]:
        """A constant inertia, and a torque that is computed correctly."""
        fit = criterion_of("torque-fit", self.fit_percent)
        return criterion_of("cosine", self.cosine), fit

    def describe(self) -> str:
        """Both criteria in a clause."""
        fit = f"{self.fit_percent:.1f} % fit to the true torque"
        return f"{fit}; least cosine of joint 2 {self.cosine:.5f}"

    def plot(self, run: Run) -> Figure:
        """Computed and true torque over one period."""
        rows = run.trajectory.time < PRBS_PERIOD
        time = run.trajectory.time[rows]
        series = [
            Series("true", time, self.true[rows], true=True),
            Series("computed", time, self.computed[rows]),
        ]
        caption = "Interaction torque on link 1, one period"
        return lines(series, "time [s]", "torque [N m]", caption)


def _density(signal: FloatArray, run: Run) -> tuple[FloatArray, FloatArray]:
    """Power spectral density with segments of one period, for which a PRBS has no leakage."""
    from scipy.signal import welch

    T = run.decoupled.sample_time
    segment = min(len(signal), round(PRBS_PERIOD / T))
    frequency, density = welch(signal, 1.0 / T, window="boxcar", nperseg=segment, noverlap=0)
    is_shown = (frequency > 0.0) & (frequency <= 500.0)
    return np.asarray(frequency[is_shown]), np.asarray(density[is_shown])


def _spectra(torques: dict[str, _InteractionTorque]) -> Figure:
    series = []
    for name, torque in torques.items():
        is_shown = torque.frequency <= 200.0
        f, density = torque.frequency[is_shown], torque.density[is_shown]
        series.append(Series(f"joint 2 {name}", f, density))
    return spectrum(series, "(N m)²/Hz", "Its power spectral density")
