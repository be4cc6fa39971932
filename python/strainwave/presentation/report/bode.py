"""Bode plots of one joint: measured response and models, each with its 95 % band."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np

from strainwave.domain import (
    ComplexArray,
    FloatArray,
    FrequencyResponse,
    JointModel,
    Mode,
    StateSpace,
)
from strainwave.domain.distributions import CI95_STDS
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
    LINEAR_COLOUR,
    MEASURED_COLOUR,
    MIN_BAND_SHARE,
    MODEL_COLOUR,
    RESIDUAL_COLOUR,
    SOLID,
    TUNED_COLOUR,
    Area,
    Axis,
    Dash,
    Figure,
    Line,
    Mark,
    Markers,
    Panel,
    Upright,
    decibel,
    spread_evenly,
)
from strainwave.statespace import frequency_response

_MAX_NYQUIST_SHARE = 0.98  # highest frequency of a sampled model's curve over the Nyquist frequency
_CURVE_POINTS = 300
_MAX_MEASURED_POINTS = 500
_STATE_SPACE_DASHES = DASHES[1:4]
_TUNED_DASH: Dash = (8.0, 4.0)
_PANEL_HEIGHTS = (1.4, 1.0, 0.6)  # of magnitude, phase and coherence
_POINT_SIZE, _POINT_OPACITY = 5, 0.4  # pale and large, so that lines on top stay visible


@dataclass(frozen=True, slots=True)
class WholeArmJoint:
    """The parameters of one joint in the whole-arm fit."""

    vector: FloatArray  # (6,) in the order of `TwoInertia`
    covariance: FloatArray | None  # (6, 6); None if a parameter has no interval in that fit


@dataclass(frozen=True, slots=True)
class _Panels:
    """Marks of each panel."""

    magnitude: list[Mark] = field(default_factory=list)
    phase: list[Mark] = field(default_factory=list)
    coherence: list[Mark] = field(default_factory=list)


def bode(
    joint: JointModel,
    gear_ratio: float,
    measured: FrequencyResponse | None,
    state_space: Mapping[str, StateSpace] | None = None,
    *,
    whole_arm: WholeArmJoint | None = None,
    is_prismatic: bool = False,
) -> Figure:
    """Motor torque to motor velocity: magnitude, phase, and coherence if it is known.

    State-space models, by the names of their records, are drawn within the band of the fit only.
    """
    low, high = joint.band_hz[0] / BAND_EXTENSION_FACTOR, joint.band_hz[1] * BAND_EXTENSION_FACTOR
    panels = _Panels()
    if measured is not None:
        _add_measured(panels, measured, low, high)
    for k, (name, model) in enumerate((state_space or {}).items()):
        _add_state_space(panels, model, joint.band_hz, name, k)
    f: FloatArray = np.geomspace(low, high, _CURVE_POINTS)
    covariance = joint.covariance[:6, :6]
    _add_joint(
        panels, vector_of(joint), covariance, gear_ratio, f, ("joint model", MODEL_COLOUR, SOLID)
    )
    if whole_arm is not None:
        style = ("whole-arm fit", TUNED_COLOUR, _TUNED_DASH)
        _add_joint(panels, whole_arm.vector, whole_arm.covariance, gear_ratio, f, style)
    axes = [
        Axis(f"dB re {'m/s/N' if is_prismatic else 'rad/s/(N m)'}"),
        Axis("phase [°]", step=90.0),
        Axis("coherence", range=(0.0, 1.05)),
    ]
    marks = (panels.magnitude, panels.phase, panels.coherence)
    stack = tuple(
        Panel(axis, tuple(panel_marks), height)
        for axis, panel_marks, height in zip(axes, marks, _PANEL_HEIGHTS, strict=True)
        if panel_marks
    )
    return Figure(Axis("frequency [Hz]", log=True), stack, tuple(_uprights(joint)))


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


def _add_measured(panels: _Panels, measured: FrequencyResponse, low: float, high: float) -> None:
    """Points with their 95 % band, grey where they are unreliable, and the coherence."""
    rows = spread_evenly(measured.frequencies_hz, low, high, _MAX_MEASURED_POINTS)
    f, G = measured.frequencies_hz[rows], measured.response[rows, 0, 0]
    reliable = is_reliable(measured)[rows]
    kinds = (
        ("measured", MEASURED_COLOUR, reliable),
        ("measured, unreliable", RESIDUAL_COLOUR, ~reliable),
    )
    std = relative_std(measured)
    if std is not None and reliable.any():
        _add_band(
            panels, f[reliable], G[reliable], std[rows][reliable], "measured", MEASURED_COLOUR
        )
    for name, colour, is_shown in kinds:
        if is_shown.any():
            modulus, phase = decibel(np.abs(G[is_shown])), np.rad2deg(np.angle(G[is_shown]))
            style = (name, colour, _POINT_SIZE, _POINT_OPACITY)
            panels.magnitude.append(Markers(f[is_shown], modulus, *style))
            panels.phase.append(Markers(f[is_shown], phase, *style))
    if measured.coherence is not None:
        coherence, name = measured.coherence[rows, 0], "coherence"
        panels.coherence.append(Area(f, np.zeros(len(f)), coherence, MEASURED_COLOUR, name))
        panels.coherence.append(Line(f, coherence, name, MEASURED_COLOUR, width=1.0, legend=False))


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
    panels: _Panels, model: StateSpace, band_hz: tuple[float, float], name: str, k: int
) -> None:
    top = min(band_hz[1], _MAX_NYQUIST_SHARE * 0.5 / model.sample_time)
    f: FloatArray = np.geomspace(band_hz[0], top, _CURVE_POINTS)
    response = frequency_response(model, f)
    G, label = response.response[:, 0, 0], f"state space, {name}"
    std, phase_std = response.magnitude_std, response.phase_std
    if std is not None and phase_std is not None:
        relative = std[:, 0, 0] / np.abs(G)
        _add_band(panels, f, G, relative, label, LINEAR_COLOUR, phase_std[:, 0, 0])
    _add_curve(
        panels, f, G, (label, LINEAR_COLOUR, _STATE_SPACE_DASHES[k % len(_STATE_SPACE_DASHES)])
    )


def _add_joint(
    panels: _Panels,
    vector: FloatArray,
    covariance: FloatArray | None,
    gear_ratio: float,
    f: FloatArray,
    style: tuple[str, str, Dash],
) -> None:
    """The curve of a two-inertia joint and its band by the delta method."""
    G = motor_response(vector, gear_ratio, f)
    _add_curve(panels, f, G, style)
    if covariance is None or not np.isfinite(covariance).all():
        return
    # dG/G: real part for the modulus, imaginary part for the phase
    relative = response_jacobian(vector, gear_ratio, f) / G[:, None]
    J = np.concatenate([relative.real, relative.imag])
    variance = np.einsum("fi,ij,fj->f", J, covariance, J)
    modulus_std, phase_std = np.split(np.sqrt(np.clip(variance, 0.0, None)), 2)
    _add_band(panels, f, G, modulus_std, style[0], style[1], phase_std)


def _add_curve(
    panels: _Panels, f: FloatArray, G: ComplexArray, style: tuple[str, str, Dash]
) -> None:
    panels.magnitude.append(Line(f, decibel(np.abs(G)), *style))
    panels.phase.append(Line(f, np.rad2deg(np.angle(G)), *style))


def _add_band(
    panels: _Panels,
    f: FloatArray,
    G: ComplexArray,
    relative: FloatArray,
    name: str,
    colour: str,
    phase_std: FloatArray | None = None,
) -> None:
    """95 % bands of modulus and phase; the phase has the relative deviation unless given."""
    half, modulus = CI95_STDS * relative, np.abs(G)
    low, high = modulus * np.maximum(1.0 - half, MIN_BAND_SHARE), modulus * (1.0 + half)
    turn = half if phase_std is None else CI95_STDS * phase_std
    phase, turn = np.rad2deg(np.angle(G)), np.minimum(np.rad2deg(turn), 180.0)
    panels.magnitude.append(Area(f, decibel(low), decibel(high), colour, name))
    panels.phase.append(Area(f, phase - turn, phase + turn, colour, name))


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
