"""Bode plots of one joint: measured response and models, each with its 95 % band."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from strainwave.domain import (
    ComplexArray,
    FloatArray,
    FrequencyResponse,
    JointModel,
    Mode,
    StateSpace,
)
from strainwave.domain.formatting import plus_minus
from strainwave.identification.joint_model.agreement import (
    BAND_EXTENSION_FACTOR,
    is_reliable,
    motor_response,
    response_jacobian,
    vector_of,
)
from strainwave.presentation.figures import (
    DASHES,
    FREQUENCY_AXIS,
    SOLID,
    Area,
    Axis,
    Colour,
    Dash,
    Figure,
    Line,
    Panel,
    Upright,
    spread_evenly,
)
from strainwave.presentation.figures.curves import ResponseMarks
from strainwave.statespace import frequency_response

_MAX_NYQUIST_SHARE = 0.98  # highest frequency of a sampled model's curve over the Nyquist frequency
_CURVE_POINTS = 300
_MAX_MEASURED_POINTS = 500
_STATE_SPACE_DASHES = DASHES[1:4]
_TUNED_DASH: Dash = (8.0, 4.0)
_PANEL_HEIGHTS, _COHERENCE_HEIGHT = (1.4, 1.0), 0.6  # magnitude and phase; coherence
_POINT_SIZE, _POINT_OPACITY = 5, 0.4  # pale and large, so that lines on top stay visible


@dataclass(frozen=True, slots=True)
class JointFit:
    """The parameters of one joint in a fit."""

    vector: FloatArray  # (6,) in the order of `TwoInertia`
    covariance: FloatArray | None  # (6, 6); None if a parameter has no interval in that fit


def bode(
    joint: JointModel,
    gear_ratio: float,
    measured: FrequencyResponse | None,
    state_space: Mapping[str, StateSpace] | None = None,
    *,
    whole_arm: JointFit | None = None,
    is_prismatic: bool = False,
) -> Figure:
    """Motor torque to motor velocity: magnitude, phase, and coherence if it is known.

    State-space models, by the names of their records, are drawn within the band of the fit only.
    """
    low, high = joint.band_hz[0] / BAND_EXTENSION_FACTOR, joint.band_hz[1] * BAND_EXTENSION_FACTOR
    marks = ResponseMarks()
    below = () if measured is None else _add_measured(marks, measured, low, high)
    for k, (name, model) in enumerate((state_space or {}).items()):
        _add_state_space(marks, model, joint.band_hz, name, k)
    f: FloatArray = np.geomspace(low, high, _CURVE_POINTS)
    own = JointFit(vector_of(joint), joint.covariance[:6, :6])
    fits: list[tuple[JointFit, str, Colour, Dash]] = [(own, "joint model", Colour.MODEL, SOLID)]
    if whole_arm is not None:
        fits.append((whole_arm, "whole-arm fit", Colour.TUNED, _TUNED_DASH))
    for fit, name, colour, dash in fits:
        G = motor_response(fit.vector, gear_ratio, f)
        marks.add_line(f, G, name, colour, dash)
        if fit.covariance is not None and np.isfinite(fit.covariance).all():
            stds = _relative_stds(fit.vector, fit.covariance, gear_ratio, f, G)
            marks.add_band(f, G, stds, name, colour)
    panels = (*marks.panels(response_title(is_prismatic=is_prismatic), _PANEL_HEIGHTS), *below)
    return Figure(FREQUENCY_AXIS, panels, tuple(_uprights(joint)))


def response_title(*, is_prismatic: bool) -> str:
    """Axis title of the magnitude from motor torque to motor velocity."""
    return f"dB re {'m/s/N' if is_prismatic else 'rad/s/(N m)'}"


def describe(joint: JointModel, measured: FrequencyResponse | None) -> str:
    """Caption of the Bode plot."""
    parts = []
    for name, mode in _modes(joint):
        value, std = plus_minus(mode.frequency_hz, mode.frequency_std_hz)
        parts.append(f"{name} {value} ± {std} Hz")
    if measured is not None:
        f = measured.frequencies_hz
        inside = (f >= joint.band_hz[0]) & (f <= joint.band_hz[1])
        share = float(np.mean(is_reliable(measured)[inside])) if inside.any() else 0.0
        parts.append(f"{100.0 * share:.0f} % of the measured lines in the fit band are reliable")
    text = "; ".join(parts)
    text = f"{text[:1].upper()}{text[1:]}. Shaded: 95 % bands." if text else ""
    warnings = [f"Warning: {w.message}." for w in joint.warnings if w.code == "response-apart"]
    return " ".join([text, *warnings]).strip()


def _add_measured(
    marks: ResponseMarks, measured: FrequencyResponse, low: float, high: float
) -> tuple[Panel, ...]:
    """Add points with their 95 % band; the panel of the coherence is returned if it is known."""
    rows = spread_evenly(measured.frequencies_hz, low, high, _MAX_MEASURED_POINTS)
    f, G = measured.frequencies_hz[rows], measured.response[rows, 0, 0]
    reliable = is_reliable(measured)[rows]
    relative = relative_std(measured)
    if relative is not None and reliable.any():
        std = relative[rows][reliable]
        marks.add_band(f[reliable], G[reliable], (std, std), "measured", Colour.MEASURED)
    marks.add_measured(f, G, reliable, _POINT_SIZE, _POINT_OPACITY)
    if measured.coherence is None:
        return ()
    coherence, name = measured.coherence[rows, 0], "coherence"
    area = Area(f, np.zeros(len(f)), coherence, Colour.MEASURED, name)
    line = Line(f, coherence, name, Colour.MEASURED, width=1.0, legend=False)
    return (Panel(Axis(name, range=(0.0, 1.05)), (area, line), _COHERENCE_HEIGHT),)


def relative_std(measured: FrequencyResponse) -> FloatArray | None:
    """Standard deviation of the modulus over the modulus, and of the phase [rad]: (n,).

    From the scatter between periods, else from the coherence c of n averages:
    sqrt((1 - c) / (2 n c)) (Bendat and Piersol, Random Data, 9.2). Noise has no preferred
    direction in the complex plane, so each of the two has half of its variance.
    """
    modulus = np.abs(measured.response[:, 0, 0])
    if measured.noise_variance is not None:
        return np.asarray(np.sqrt(0.5 * measured.noise_variance[:, 0, 0]) / modulus)
    if measured.coherence is None or measured.n_averages < 1:
        return None
    c = np.clip(measured.coherence[:, 0], 1e-6, 1.0)
    return np.asarray(np.sqrt((1.0 - c) / (2.0 * measured.n_averages * c)))


def _add_state_space(
    marks: ResponseMarks, model: StateSpace, band_hz: tuple[float, float], name: str, k: int
) -> None:
    top = min(band_hz[1], _MAX_NYQUIST_SHARE * 0.5 / model.sample_time)
    f: FloatArray = np.geomspace(band_hz[0], top, _CURVE_POINTS)
    response = frequency_response(model, f)
    G, label = response.response[:, 0, 0], f"state space, {name}"
    std, phase_std = response.magnitude_std, response.phase_std
    if std is not None and phase_std is not None:
        stds = std[:, 0, 0] / np.abs(G), phase_std[:, 0, 0]
        marks.add_band(f, G, stds, label, Colour.LINEAR)
    dash = _STATE_SPACE_DASHES[k % len(_STATE_SPACE_DASHES)]
    marks.add_line(f, G, label, Colour.LINEAR, dash)


def _relative_stds(
    vector: FloatArray, covariance: FloatArray, gear_ratio: float, f: FloatArray, G: ComplexArray
) -> tuple[FloatArray, FloatArray]:
    """Standard deviations of modulus over modulus and of phase [rad] by the delta method.

    dG/G has the change of the modulus as its real part and that of the phase as its imaginary part.
    """
    relative = response_jacobian(vector, gear_ratio, f) / G[:, None]
    J = np.concatenate([relative.real, relative.imag])
    variance = np.einsum("fi,ij,fj->f", J, covariance, J)
    modulus, phase = np.split(np.sqrt(np.clip(variance, 0.0, None)), 2)
    return modulus, phase


def _modes(joint: JointModel) -> list[tuple[str, Mode]]:
    modes = (("anti-resonance", joint.anti_resonance), ("resonance", joint.resonance))
    return [(name, mode) for name, mode in modes if mode is not None]


def _uprights(joint: JointModel) -> Iterator[Upright]:
    """Lines at both modes and at the edges of the fit band; labels are in the phase panel."""
    for name, mode in _modes(joint):
        text, is_left = f"{name} {mode.frequency_hz:.4g} Hz", name == "anti-resonance"
        yield Upright(mode.frequency_hz, text, panel=1, before=is_left, dash=SOLID)
    for edge in joint.band_hz:
        yield Upright(edge)
