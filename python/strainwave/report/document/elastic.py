"""Elastic joints: resonances, link motion, tests of state-space models, amplitudes, torques.

Amplitude dependence of a joint: responses by amplitude, and equivalent stiffness. Interaction
torque of the other links compared with the motor torque: over time, and spectra.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from strainwave import domain
from strainwave.domain import (
    FloatArray,
)
from strainwave.domain.messages import percent, plus_minus
from strainwave.domain.results.distributions import CI95_STDS
from strainwave.identification.amplitude_sweep import MIN_TREND_STD_ERRORS
from strainwave.identification.joint_model.agreement import motor_response, vector_of
from strainwave.numerics.spectra import cross_spectral_densities
from strainwave.report import figures
from strainwave.report.document.bode import response_title
from strainwave.report.figures import Axis, Colour, Figure, Line, Markers, Panel, Upright
from strainwave.report.figures.curves import ResponseMarks


def resonance_rows(identification: domain.Identification) -> list[tuple[str, ...]]:
    """Joint, records, anti-resonance and its damping, resonance and its damping, stiffness.

    The model of all records of a joint comes first, then one row for each record.
    """
    rows = [_resonance_row(joint, "all records") for joint in identification.joints]
    for record in identification.records:
        if record.joint_model is not None:
            rows.append(_resonance_row(record.joint_model, record.signals.experiment.name))
    return sorted(rows, key=lambda row: row[0])


def link_rows(identification: domain.Identification) -> list[tuple[str, ...]]:
    """Joint, record, source, bias, fusion error (10), delays of link sensor and of drive."""
    return [
        (
            str(link.joint),
            link.experiment,
            link.source,
            f"{link.bias:.2g}" if link.source == "accelerometer" else "",
            f"{link.fusion_error:.2g}" if link.fusion is not None else "none",
            _delay(link.sensor_delay),
            _delay(link.drive_delay),
        )
        for link in identification.links
    ]


def _delay(delay: domain.Delay | None) -> str:
    """In milliseconds; empty if the record does not determine it."""
    return "" if delay is None else " ± ".join(plus_minus(1e3 * delay.value, 1e3 * delay.std))


def validation_rows(identification: domain.Identification) -> list[tuple[str, ...]]:
    """Joint, record, one-step fits of motor and link velocity, and the p-value of each test."""
    rows: list[tuple[str, ...]] = []
    for record in identification.records:
        check = record.check
        if check is not None:
            fits = (percent(fit) for fit in check.prediction_fit_percent)
            tests = {str(test.name): test for test in check.tests}
            names = ("white", "independent-of-past-inputs", "no-feedback")
            values = [""] * len(names)
            for k, name in enumerate(names):
                if test := tests.get(name):
                    p = f"{test.p_value:.2g}" if test.p_value >= 1e-3 else "< 0.001"
                    values[k] = f"{p} ({'pass' if test.passed else 'fail'})"
            rows.append(
                (
                    str(record.signals.joint),
                    record.signals.experiment.name,
                    " / ".join(fits),
                    *values,
                )
            )
    return rows


def _resonance_row(joint: domain.JointModel, name: str) -> tuple[str, ...]:
    k = list(joint.values).index("gear_stiffness")
    std = float(np.sqrt(joint.covariance[k, k]))
    return (
        str(joint.joint),
        name,
        *mode_cells(joint.anti_resonance),
        *mode_cells(joint.resonance),
        " ± ".join(plus_minus(joint.values["gear_stiffness"], std)),
    )


def mode_cells(mode: domain.Mode | None) -> tuple[str, str]:
    """Frequency [Hz] and damping of a mode; "none" if the joint has none."""
    if mode is None:
        return "none", ""
    return (
        " ± ".join(plus_minus(mode.frequency_hz, mode.frequency_std_hz)),
        " ± ".join(plus_minus(mode.damping, mode.damping_std)),
    )


_CURVE_POINTS = 200
_SWEEP_COLOURS = (Colour.MEASURED, Colour.LINEAR, Colour.MODEL, Colour.RESIDUAL)
_SWEEP_DASHES = figures.DASHES[:3]  # one for each turn of the colours
_TRENDS = {"hardening": "hardening", "softening": "softening", "no-trend": "no significant trend"}


def swept_records(identification: domain.Identification) -> dict[int, list[domain.RecordModel]]:
    """PRBS records of each joint that has a sweep, in order of amplitude."""
    records: dict[int, list[domain.RecordModel]] = {}
    amplitudes: dict[str, float] = {}
    for record in identification.records:
        experiment = record.signals.experiment
        if record.joint_model is not None and experiment.prbs is not None:
            amplitudes[experiment.name] = experiment.prbs.amplitude
            records.setdefault(record.signals.joint, []).append(record)
    return {
        joint: sorted(in_order, key=lambda record: amplitudes[record.signals.experiment.name])
        for joint, in_order in records.items()
        if any(record.signals.experiment.use == "sweep" for record in in_order)
    }


def response_figure(records: Sequence[domain.RecordModel]) -> Figure:
    """Motor torque to motor velocity by the joint model of each record: magnitude and phase."""
    marks = ResponseMarks()
    for k, record in enumerate(records):
        joint, prbs = record.joint_model, record.signals.experiment.prbs
        if joint is None or prbs is None:
            continue
        f: FloatArray = np.geomspace(*joint.band_hz, _CURVE_POINTS)
        G = motor_response(vector_of(joint), record.signals.gear_ratio, f)
        name = f"{prbs.amplitude:g} V, {record.signals.experiment.name}"
        turn, position = divmod(k, len(_SWEEP_COLOURS))
        marks.add_line(
            f, G, name, _SWEEP_COLOURS[position], _SWEEP_DASHES[turn % len(_SWEEP_DASHES)]
        )
    return Figure(figures.FREQUENCY_AXIS, marks.panels(response_title(is_prismatic=False)))


def stiffness_figure(sweep: domain.Sweep) -> Figure:
    """Equivalent stiffness over amplitude with 95 % bars, and the fitted line."""
    x = np.array([point.amplitude for point in sweep.points])
    y = np.array([point.gear_stiffness for point in sweep.points])
    std = np.array([point.gear_stiffness_std for point in sweep.points])
    marks = Markers(x, y, "equivalent stiffness", Colour.MEASURED, 8.0, error=CI95_STDS * std)
    # the tested slope is that of the squared anti-resonance, which is proportional to the stiffness
    squared = np.array([point.squared_anti_resonance for point in sweep.points])
    weights = 1.0 / np.array([point.squared_anti_resonance_std for point in sweep.points]) ** 2
    centre, level = np.average(x, weights=weights), np.average(squared, weights=weights)
    ratio = float(np.mean(y / squared))
    ends = np.array([x.min(), x.max()])
    line = ratio * (level + sweep.slope * (ends - centre))
    trend = Line(ends, line, "weighted line", Colour.RESIDUAL, figures.SHORT_DASH)
    panel = Panel(Axis("equivalent stiffness [N m/rad]"), (trend, marks))
    return Figure(Axis("amplitude of the excitation [V]"), (panel,))


def trend_title(sweep: domain.Sweep) -> str:
    """The trend in words, with the test statistic."""
    return f"{_TRENDS[sweep.verdict]} ({abs(sweep.slope) / sweep.slope_std:.1f} standard errors)"


def describe_trend(sweep: domain.Sweep) -> str:
    """The test behind the trend: slope, standard error and limit."""
    value, std = plus_minus(sweep.slope, sweep.slope_std)
    return (
        f"Slope of the squared anti-resonance: {value} ± {std} rad²/s² per V,"
        f" {abs(sweep.slope) / sweep.slope_std:.1f} standard errors from zero; a trend is"
        f" significant from {MIN_TREND_STD_ERRORS:g} standard errors."
    )


_NAMES = ("motor torque", "interaction torque at the motor")
_COLOURS = (Colour.MEASURED, Colour.MODEL)
_DASHES = (figures.SOLID, figures.SHORT_DASH)
_WELCH_SEGMENTS = 8  # of a record
_SHOWN_DURATION = 0.5  # [s] single oscillations stay visible
_MAX_SINGULAR_VALUES = 24  # drawn; those of the noise follow
_BAND_MARGIN = 5.0  # highest frequency drawn over the band in which the motor moves


def interaction_records(identification: domain.Identification) -> list[domain.Decoupled]:
    """For each joint the full-amplitude record with the largest share of interaction torque."""
    largest: dict[int, domain.Decoupled] = {}
    for record in identification.records:
        signals = record.signals
        if signals.inputs.shape[1] < 2 or signals.experiment.use != "frequency":
            continue
        other = largest.get(signals.joint)
        if other is None or interaction_share(signals) > interaction_share(other):
            largest[signals.joint] = signals
    return [largest[joint] for joint in sorted(largest)]


def interaction_share(record: domain.Decoupled) -> float:
    """Standard deviation of the interaction torque over that of the motor torque."""
    motor, interaction = np.std(_at_motor(record), axis=0)
    return float(interaction / motor) if motor > 0.0 else 0.0


def order_figure(model: domain.StateSpace) -> Figure:
    """Singular values of the subspace step, relative to the largest, and the order selected."""
    values = np.asarray(model.singular_values, dtype=float)[:_MAX_SINGULAR_VALUES]
    index = np.arange(1.0, len(values) + 1.0)
    line = Line(index, values / values[0], "singular values", Colour.MEASURED, size=7.0)
    order = Upright(model.order + 0.5, f"order {model.order}", dash=figures.DOTTED)
    panel = Panel(Axis("singular value / largest", log=True), (line,))
    return Figure(Axis("number", step=1.0), (panel,), uprights=(order,))


def torque_figure(record: domain.Decoupled) -> Figure:
    """The beginning of both torques."""
    is_shown = record.time <= record.time[0] + _SHOWN_DURATION
    torques = _at_motor(record)[is_shown]
    rows = figures.decimate(torques)
    panel = Panel(Axis("torque [N m]"), _lines(record.time[is_shown][rows], torques[rows]))
    return Figure(Axis("time [s]"), (panel,))


def torque_spectrum(record: domain.Decoupled) -> Figure:
    """Amplitude spectral densities of both torques."""
    torques = _at_motor(record)
    segment = min(len(torques), max(16, 2 * len(torques) // (_WELCH_SEGMENTS + 1)))
    frequency, density = cross_spectral_densities(torques, record.sample_time, segment)
    power = np.einsum("fii->fi", density).real
    end = _BAND_MARGIN * float(record.richness_hz.max(initial=0.0)) or np.inf
    is_shown = (frequency > 0.0) & (frequency <= end)
    lines = _lines(frequency[is_shown], np.sqrt(power[is_shown]))
    panel = Panel(Axis("torque [N m/sqrt(Hz)]", log=True), lines)
    return Figure(figures.FREQUENCY_AXIS, (panel,))


def describe_interaction(record: domain.Decoupled) -> str:
    """Caption of the figures."""
    return (
        f"Interaction torque of the other links and gravity on joint {record.joint} in"
        f" {record.experiment.name}: {100.0 * interaction_share(record):.2g} % of the motor torque"
        " (rms without mean, at the motor)."
    )


def _at_motor(record: domain.Decoupled) -> FloatArray:
    """Motor torque, and interaction torque through the gear: (n_samples, 2) [N m]."""
    return np.asarray(record.inputs * np.array([1.0, record.gear_ratio]))


def _lines(x: FloatArray, torques: FloatArray) -> tuple[Line, ...]:
    styles = enumerate(zip(_NAMES, _COLOURS, _DASHES, strict=True))
    return tuple(Line(x, torques[:, k], name, colour, dash) for k, (name, colour, dash) in styles)
