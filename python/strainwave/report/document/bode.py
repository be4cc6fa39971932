"""Bode plots of one joint: measured response and models, each with its 95 % band.

Pole-zero map of one joint, motor torque to motor velocity, with 95 % confidence ellipses. Response
of each driven motor in the complete arm: measured, and simulated by the fitted arm.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from strainwave import domain
from strainwave.domain import (
    ComplexArray,
    FloatArray,
)
from strainwave.domain.messages import plus_minus
from strainwave.domain.results.distributions import chi_square_limit
from strainwave.dynamics.two_inertia import coefficients, jacobian, joint_of
from strainwave.identification.joint_model import agreement
from strainwave.report import figures
from strainwave.report.figures import Area, Axis, Colour, Dash, Figure, Line, Mark, Markers, Panel
from strainwave.report.figures.curves import ResponseMarks
from strainwave.statespace import frequency_response, nearest

_MAX_NYQUIST_SHARE = 0.98  # highest frequency of a sampled model's curve over the Nyquist frequency
_CURVE_POINTS = 300
_MAX_MEASURED_POINTS = 500
_STATE_SPACE_DASHES = figures.DASHES[1:4]
_TUNED_DASH: Dash = (8.0, 4.0)
_PANEL_HEIGHTS, _COHERENCE_HEIGHT = (1.4, 1.0), 0.6  # magnitude and phase; coherence
_POINT_SIZE, _POINT_OPACITY = 5, 0.4  # pale and large, so that lines on top stay visible


@dataclass(frozen=True, slots=True)
class FittedJoint:
    """The parameters of one joint in a fit."""

    vector: FloatArray  # (6,) in the order of `TwoInertia`
    covariance: FloatArray | None  # (6, 6); None if a parameter has no interval in that fit


def bode(
    joint: domain.JointModel,
    gear_ratio: float,
    measured: domain.FrequencyResponse | None,
    state_space: Mapping[str, domain.StateSpace] | None = None,
    *,
    whole_arm: FittedJoint | None = None,
    is_prismatic: bool = False,
) -> Figure:
    """Motor torque to motor velocity: magnitude, phase, and coherence if it is known.

    State-space models, by the names of their records, are drawn within the band of the fit only.
    """
    beyond = agreement.BAND_EXTENSION_FACTOR
    low, high = joint.band_hz[0] / beyond, joint.band_hz[1] * beyond
    marks = ResponseMarks()
    below = () if measured is None else _add_measured(marks, measured, low, high)
    for k, (name, model) in enumerate((state_space or {}).items()):
        top = min(joint.band_hz[1], _MAX_NYQUIST_SHARE * 0.5 / model.sample_time)
        response = frequency_response(model, np.geomspace(joint.band_hz[0], top, _CURVE_POINTS))
        G, label = response.response[:, 0, 0], f"state space, {name}"
        std, phase_std = response.magnitude_std, response.phase_std
        if std is not None and phase_std is not None:
            stds = std[:, 0, 0] / np.abs(G), phase_std[:, 0, 0]
            marks.add_band(response.frequencies_hz, G, stds, label, Colour.LINEAR)
        dash = _STATE_SPACE_DASHES[k % len(_STATE_SPACE_DASHES)]
        marks.add_line(response.frequencies_hz, G, label, Colour.LINEAR, dash)
    f: FloatArray = np.geomspace(low, high, _CURVE_POINTS)
    own = FittedJoint(agreement.vector_of(joint), joint.covariance[:6, :6])
    fits: list[tuple[FittedJoint, str, Colour, Dash]] = [
        (own, "joint model", Colour.MODEL, figures.SOLID)
    ]
    if whole_arm is not None:
        fits.append((whole_arm, "whole-arm fit", Colour.TUNED, _TUNED_DASH))
    for fit, name, colour, dash in fits:
        G = agreement.motor_response(fit.vector, gear_ratio, f)
        marks.add_line(f, G, name, colour, dash)
        if fit.covariance is not None and np.isfinite(fit.covariance).all():
            stds = response_stds(fit.vector, fit.covariance, gear_ratio, f, G)
            marks.add_band(f, G, stds, name, colour)
    panels = (*marks.panels(response_title(is_prismatic=is_prismatic), _PANEL_HEIGHTS), *below)
    return Figure(figures.FREQUENCY_AXIS, panels, tuple(_uprights(joint)))


def response_stds(
    vector: FloatArray, covariance: FloatArray, gear_ratio: float, f: FloatArray, G: ComplexArray
) -> tuple[FloatArray, FloatArray]:
    """Standard deviations of the modulus over the modulus, and of the phase [rad]: (n,) both.

    By the delta method, from the parameters of a joint and their covariance: the real part of dG/G
    is the relative change of the modulus, the imaginary part the change of the phase.
    """
    relative = agreement.response_jacobian(vector, gear_ratio, f) / G[:, None]
    J = np.concatenate([relative.real, relative.imag])
    variance = np.einsum("fi,ij,fj->f", J, covariance, J)
    modulus, phase = np.split(np.sqrt(np.clip(variance, 0.0, None)), 2)
    return modulus, phase


def response_title(*, is_prismatic: bool) -> str:
    """Axis title of the magnitude from motor torque to motor velocity."""
    return f"dB re {'m/s/N' if is_prismatic else 'rad/s/(N m)'}"


def describe(joint: domain.JointModel, measured: domain.FrequencyResponse | None) -> str:
    """Caption of the Bode plot."""
    parts = []
    for name, mode in modes_of(joint):
        value, std = plus_minus(mode.frequency_hz, mode.frequency_std_hz)
        parts.append(f"{name} {value} ± {std} Hz")
    if measured is not None:
        f = measured.frequencies_hz
        inside = (f >= joint.band_hz[0]) & (f <= joint.band_hz[1])
        share = float(np.mean(agreement.is_reliable(measured)[inside])) if inside.any() else 0.0
        parts.append(f"{100.0 * share:.0f} % of the measured lines in the fit band are reliable")
    text = "; ".join(parts)
    text = f"{text[:1].upper()}{text[1:]}. Shaded: 95 % bands." if text else ""
    warnings = [f"Warning: {w.message}." for w in joint.warnings if w.code == "response-apart"]
    return " ".join([text, *warnings]).strip()


def _add_measured(
    marks: ResponseMarks, measured: domain.FrequencyResponse, low: float, high: float
) -> tuple[Panel, ...]:
    """Add points with their 95 % band; the panel of the coherence is returned if it is known."""
    shown = measured.between(low, high, _MAX_MEASURED_POINTS)
    f, G = shown.frequencies_hz, shown.response[:, 0, 0]
    reliable, relative = agreement.is_reliable(shown), relative_std(shown)
    if relative is not None and reliable.any():
        std = relative[reliable]
        marks.add_band(f[reliable], G[reliable], (std, std), "measured", Colour.MEASURED)
    marks.add_measured(f, G, reliable, _POINT_SIZE, _POINT_OPACITY)
    if shown.coherence is None:
        return ()
    coherence, name = shown.coherence[:, 0], "coherence"
    area = Area(f, np.zeros(len(f)), coherence, Colour.MEASURED, name)
    line = Line(f, coherence, name, Colour.MEASURED, width=1.0, legend=False)
    return (Panel(Axis(name, range=(0.0, 1.05)), (area, line), _COHERENCE_HEIGHT),)


def relative_std(measured: domain.FrequencyResponse) -> FloatArray | None:
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


def modes_of(joint: domain.JointModel) -> list[tuple[str, domain.Mode]]:
    """Anti-resonance and resonance of a joint model, by name, if it has them."""
    modes = (("anti-resonance", joint.anti_resonance), ("resonance", joint.resonance))
    return [(name, mode) for name, mode in modes if mode is not None]


def _uprights(joint: domain.JointModel) -> Iterator[figures.Upright]:
    """Lines at both modes and at the edges of the fit band; labels are in the phase panel."""
    for name, mode in modes_of(joint):
        text, is_left = f"{name} {mode.frequency_hz:.4g} Hz", name == "anti-resonance"
        yield figures.Upright(mode.frequency_hz, text, panel=1, before=is_left, dash=figures.SOLID)
    for edge in joint.band_hz:
        yield figures.Upright(edge)


_ELLIPSE_POINTS = 40
_MAX_DAMPING = 0.5  # of the oscillating roots shown: others describe the edge of the band
_SYMBOL_SIZE = 9.0  # [px]
_HEIGHT = 2.2  # of the panel, in usual panels: the map is nearly square
_WIDEST_ELLIPSE = 1.0  # standard deviation over the modulus; wider ones are not informative


def pole_zero_map(
    joint: domain.JointModel,
    gear_ratio: float,
    state_space: Mapping[str, domain.Modes] | None = None,
    *,
    whole_arm: FittedJoint | None = None,
) -> Figure:
    """Poles (crosses) and zeros (circles) in continuous time.

    Of a state-space model, only oscillating roots in the band of the fit and real roots below it
    are shown.
    """
    marks: list[Mark] = []
    for k, (name, modes) in enumerate((state_space or {}).items()):
        roots = _state_space_roots(modes, joint.band_hz)
        marks += _marks(*roots, f"state space, {name}", Colour.LINEAR, k)
    roots = _joint_roots(agreement.vector_of(joint), joint.covariance[:6, :6], gear_ratio)
    marks += _marks(*roots, "joint model", Colour.MODEL)
    if whole_arm is not None:
        roots = _joint_roots(whole_arm.vector, whole_arm.covariance, gear_ratio)
        marks += _marks(*roots, "whole-arm fit", Colour.TUNED)
    panel = Panel(Axis("imaginary part [rad/s]"), tuple(marks), height=_HEIGHT)
    return Figure(Axis("real part [rad/s]"), (panel,))


Roots = tuple[ComplexArray, ComplexArray, FloatArray | None]
"""Poles, zeros, and the covariance of all real parts followed by all imaginary parts."""


def _joint_roots(vector: FloatArray, covariance: FloatArray | None, gear_ratio: float) -> Roots:
    """Roots of (17) and their covariance by the delta method."""
    b, a = coefficients(joint_of(vector, gear_ratio))
    poles, zeros = np.roots(a[::-1]).astype(complex), np.roots(b[::-1]).astype(complex)

    def parts(near: FloatArray) -> FloatArray:
        b, a = coefficients(joint_of(near, gear_ratio))
        moved = np.concatenate(
            [
                nearest(poles, np.roots(a[::-1]).astype(complex)),
                nearest(zeros, np.roots(b[::-1]).astype(complex)),
            ]
        )
        return np.concatenate([moved.real, moved.imag])

    if covariance is None or not np.isfinite(covariance).all():
        return poles, zeros, None
    J = jacobian(parts, vector)
    return poles, zeros, J @ covariance @ J.T


def _state_space_roots(modes: domain.Modes, band_hz: tuple[float, float]) -> Roots:
    """The roots that are shown, with both conjugates.

    Frequency and damping are taken as uncorrelated: s = w (-d + i sqrt(1 - d^2)).
    """
    groups = [[m for m in group if _is_shown(m, band_hz)] for group in (modes.poles, modes.zeros)]
    pairs = [[(m, s) for m in group for s in (1.0, -1.0)[: 1 + m.oscillates]] for group in groups]
    roots = [np.array([_root(*pair) for pair in group], dtype=complex) for group in pairs]
    every = [*pairs[0], *pairs[1]]
    covariance = np.zeros((2 * len(every), 2 * len(every)))
    for i, (mode, side) in enumerate(every):
        if mode.frequency_std_hz is None or mode.damping_std is None:
            return roots[0], roots[1], None
        w, d = abs(mode.value), mode.damping
        by_frequency = _root(mode, side) / w
        by_damping = complex(-w, -side * w * d / np.sqrt(1.0 - d**2)) if mode.oscillates else 0.0
        std = 2.0 * np.pi * mode.frequency_std_hz, mode.damping_std
        J = np.array([by_frequency * std[0], by_damping * std[1]])
        parts = np.stack([J.real, J.imag])
        covariance[np.ix_([i, len(every) + i], [i, len(every) + i])] = parts @ parts.T
    return roots[0], roots[1], covariance


def _root(mode: domain.Mode, side: float) -> complex:
    return complex(mode.value.real, side * mode.value.imag)


def _is_shown(mode: domain.Mode, band_hz: tuple[float, float]) -> bool:
    if mode.oscillates:
        return mode.frequency_hz < band_hz[1] and abs(mode.damping) < _MAX_DAMPING
    return mode.frequency_hz < band_hz[0]


def _marks(
    poles: ComplexArray,
    zeros: ComplexArray,
    covariance: FloatArray | None,
    name: str,
    colour: str,
    k: int = 0,
) -> list[Mark]:
    roots = np.concatenate([poles, zeros])
    kinds: tuple[tuple[figures.Symbol, ComplexArray, str], ...] = (
        ("x", poles, "poles"),
        ("circle-open", zeros, "zeros"),
    )
    marks: list[Mark] = [
        Markers(values.real, values.imag, f"{kind}, {name}", colour, _SYMBOL_SIZE, symbol=symbol)
        for symbol, values, kind in kinds
        if len(values)
    ]
    if covariance is None:
        return marks
    n = len(roots)
    for i, root in enumerate(roots):
        block = covariance[np.ix_([i, n + i], [i, n + i])]
        if np.trace(block) < (_WIDEST_ELLIPSE * abs(root)) ** 2:
            # the 95 % confidence region of real and imaginary part
            values, vectors = np.linalg.eigh(block)
            angle = np.linspace(0.0, 2.0 * np.pi, _ELLIPSE_POINTS)
            radii = np.sqrt(chi_square_limit(0.05, 2) * np.clip(values, 0.0, None))
            x, y = vectors @ (radii[:, None] * np.stack([np.cos(angle), np.sin(angle)]))
            label = f"{'poles' if i < len(poles) else 'zeros'}, {name}"
            ellipse = root.real + x, root.imag + y
            marks.append(Line(*ellipse, label, colour, figures.DASHES[k % 3], 1.0, legend=False))
    return marks


_MIN_COHERENCE = 0.8  # of a reliable line
_MAX_MOTOR_POINTS = 400
_LABEL_STEP = 0.16  # height between the labels of neighbours, as a share of the panel


def motor_figure(response: domain.MotorResponse, *, is_prismatic: bool = False) -> Figure:
    """Magnitude and phase; vertical lines show the modes of the fitted arm."""
    rows = figures.spread_evenly(response.frequencies_hz, 0.0, np.inf, _MAX_MOTOR_POINTS)
    f, reliable = response.frequencies_hz[rows], response.coherence[rows] >= _MIN_COHERENCE
    marks = ResponseMarks()
    marks.add_measured(f, response.measured[rows], reliable)
    marks.add_line(f, response.fitted[rows], "fitted arm, simulated", Colour.TUNED)
    panels = marks.panels(response_title(is_prismatic=is_prismatic), (1.2, 0.8))
    return Figure(figures.FREQUENCY_AXIS, panels, tuple(_motor_uprights(response)))


def _motor_uprights(response: domain.MotorResponse) -> Iterator[figures.Upright]:
    """A line for each mode. The first of a kind is named; neighbours have staggered labels."""
    f = response.frequencies_hz
    modes = [
        *((value, "anti-resonance", True) for value in _inside(response.anti_resonances_hz, f)),
        *((value, "resonance", False) for value in _inside(response.resonances_hz, f)),
    ]
    for k, (value, name, is_left) in enumerate(modes):
        is_repeated = k > 0 and name == modes[k - 1][1]
        yield figures.Upright(
            value,
            f"{value:.3g} Hz" if is_repeated else f"{name} {value:.3g} Hz",
            panel=1,
            height=1.0 - _LABEL_STEP * (k % 2),
            before=is_left,
            dash=figures.SOLID if is_left else figures.DOTTED,
        )


def describe_motor(response: domain.MotorResponse) -> str:
    """Caption of the figure."""
    parts = []
    kinds = (
        ("anti-resonances", response.anti_resonances_hz),
        ("resonances", response.resonances_hz),
    )
    for name, values in kinds:
        inside = [f"{value:.4g}" for value in _inside(values, response.frequencies_hz)]
        if inside:
            parts.append(f"{name} of the fitted arm: {', '.join(inside)} Hz")
    reliable = response.coherence >= _MIN_COHERENCE
    if reliable.any():
        measured, fitted = response.measured[reliable], response.fitted[reliable]
        error = 100.0 * float(np.median(np.abs(measured - fitted) / np.abs(measured)))
        parts.append(
            f"median difference where the coherence is at least {_MIN_COHERENCE:g}: {error:.2g} %"
        )
    text = "; ".join(parts)
    return f"{text[:1].upper()}{text[1:]}." if text else ""


def _inside(values: Sequence[float], f: FloatArray) -> list[float]:
    return [value for value in values if len(f) and f[0] <= value <= f[-1]]
