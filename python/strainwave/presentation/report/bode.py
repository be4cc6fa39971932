"""Bode plots of one joint: what was measured and how far it is to be trusted, and its models."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

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
    OUTSIDE,
    REACH,
    motor_response,
    response_jacobian,
    trusted,
    vector_of,
)
from strainwave.presentation.figures import (
    DASHES,
    LINEAR,
    MEASURED,
    MODEL,
    RESIDUAL,
    SOLID,
    TUNED,
    Axis,
    Band,
    Dash,
    Figure,
    Line,
    Mark,
    Markers,
    Panel,
    Upright,
    decibel,
)
from strainwave.statespace import frequency_response

_POINTS = 300  # of a model's curve
_MOST_LINES = 500  # measured; of more, those evenly spread over the logarithm of frequency
_NYQUIST = 0.98  # of half the sample rate, up to which a sampled model is drawn
_DASHES = DASHES[1:4]  # of sampled models
_LONG: Dash = (8.0, 4.0)  # of the whole-arm fit
_HEIGHTS = (1.4, 1.0, 0.6)  # of magnitude, phase and coherence
_DOT, _PALE = 5, 0.4  # size and opacity of measured points
_BOTTOM = 1e-2  # of the modulus: a band down to zero has no bottom in dB


def bode(
    joint: JointModel,
    gear_ratio: float,
    measured: FrequencyResponse | None,
    sampled: Sequence[tuple[str, StateSpace]] = (),
    *,
    tuned: Mapping[str, float] | None = None,
    straight: bool = False,
) -> Figure:
    """Motor torque to motor velocity: magnitude, phase, and coherence where it is known.

    Parameters
    ----------
    joint : JointModel
        The physical model, drawn with its 95 % band.
    gear_ratio : float
    measured : FrequencyResponse or None
        The nonparametric one; doubtful points are grey.
    sampled : sequence of (str, StateSpace)
        State-space models by the names of their records, drawn within the band of the fit: beyond
        it they were not asked.
    tuned : mapping, optional
        Name -> value of the same joint by the whole-arm fit, with one stiffness.
    straight : bool
        Whether the joint is prismatic.

    Returns
    -------
    Figure
    """
    low, high = joint.band_hz[0] / OUTSIDE, joint.band_hz[1] * OUTSIDE
    drawn = _Drawn()
    if measured is not None:
        seen = _lines_between(measured, low, high)
        _measured(drawn, measured, seen)
    for k, (name, model) in enumerate(sampled):
        top = min(joint.band_hz[1], _NYQUIST * 0.5 / model.sample_time)
        f: FloatArray = np.geomspace(joint.band_hz[0], top, _POINTS)
        G = frequency_response(replace(model, covariance=None), f).response[:, 0, 0]
        _curve(drawn, f, G, f"state space, {name}", LINEAR, _DASHES[k % len(_DASHES)])
    f = np.geomspace(low, high, _POINTS)
    _physical(drawn, joint, gear_ratio, f)
    if tuned is not None:
        vector = np.array([tuned[name] for name in list(joint.values)[:6]])
        _curve(drawn, f, motor_response(vector, gear_ratio, f), "whole-arm fit", TUNED, _LONG)
    axes = [
        Axis(f"dB re {'m/s/N' if straight else 'rad/s/(N m)'}"),
        Axis("phase [°]", step=90.0),
        Axis("coherence", range=(0.0, 1.05)),
    ]
    every = zip(axes, (drawn.magnitude, drawn.phase, drawn.coherence), _HEIGHTS, strict=True)
    panels = tuple(Panel(axis, tuple(marks), height) for axis, marks, height in every if marks)
    return Figure(Axis("frequency [Hz]", log=True), panels, tuple(_uprights(joint)))


def words(joint: JointModel, measured: FrequencyResponse | None) -> str:
    """What the figure shows, for those who do not see it.

    Parameters
    ----------
    joint : JointModel
    measured : FrequencyResponse or None

    Returns
    -------
    str
    """
    said = []
    for name, mode in _modes(joint):
        value, spread = plus_minus(mode.frequency_hz, mode.frequency_std_hz)
        said.append(f"{name} at {value} ± {spread} Hz")
    if measured is not None:
        f = measured.frequencies_hz
        inside = (f >= joint.band_hz[0]) & (f <= joint.band_hz[1])
        share = float(np.mean(trusted(measured)[inside])) if inside.any() else 0.0
        lines = f"{100.0 * share:.0f} % of the measured lines in the fit's band"
        said.append(f"{lines} stand out of their noise")
    text = "; ".join(said)
    text = f"{text[:1].upper()}{text[1:]}." if text else ""
    apart = [f"Warning: {w.message}." for w in joint.warnings if w.code == "response-apart"]
    return " ".join([text, *apart]).strip()


def _lines_between(measured: FrequencyResponse, low: float, high: float) -> np.ndarray:
    f = measured.frequencies_hz
    inside = np.flatnonzero((f >= low) & (f <= high))
    if len(inside) <= _MOST_LINES:
        return inside
    wanted = np.geomspace(f[inside[0]], f[inside[-1]], _MOST_LINES)
    return np.unique(np.searchsorted(f, wanted).clip(inside[0], inside[-1]))


@dataclass(frozen=True, slots=True)
class _Drawn:
    """Marks of each panel, as they come."""

    magnitude: list[Mark] = field(default_factory=list)
    phase: list[Mark] = field(default_factory=list)
    coherence: list[Mark] = field(default_factory=list)


def _measured(drawn: _Drawn, measured: FrequencyResponse, seen: np.ndarray) -> None:
    """Points, grey where they say little, and an area below the coherence."""
    G = measured.response[seen, 0, 0]
    f = measured.frequencies_hz[seen]
    sure = trusted(measured)[seen]
    kinds = (("measured", MEASURED, sure), ("measured, doubtful", RESIDUAL, ~sure))
    for name, colour, chosen in kinds:
        if chosen.any():
            at = f[chosen]
            # paler and larger than the lines over them, which are then seen where both agree
            size, phase = decibel(np.abs(G[chosen])), np.rad2deg(np.angle(G[chosen]))
            drawn.magnitude.append(Markers(at, size, name, colour, _DOT, _PALE))
            drawn.phase.append(Markers(at, phase, name, colour, _DOT, _PALE))
    if measured.coherence is not None:
        coherence, name = measured.coherence[seen, 0], "coherence"
        drawn.coherence.append(Band(f, np.zeros(len(f)), coherence, MEASURED, name))
        drawn.coherence.append(Line(f, coherence, name, MEASURED, width=1.0, legend=False))


def _physical(drawn: _Drawn, joint: JointModel, gear_ratio: float, f: FloatArray) -> None:
    """The curve of the physical model and its 95 % band, by the delta method."""
    vector = vector_of(joint)
    G = motor_response(vector, gear_ratio, f)
    name = "physical model"
    _curve(drawn, f, G, name, MODEL, SOLID)
    # dG/G: of the modulus, and i times the phase
    relative = response_jacobian(vector, gear_ratio, f) / G[:, None]
    J = np.concatenate([relative.real, relative.imag])
    variance = np.einsum("fi,ij,fj->f", J, joint.covariance[:6, :6], J)
    if np.isfinite(variance).all():
        size, turn = np.split(REACH * np.sqrt(np.clip(variance, 0.0, None)), 2)
        phase = np.rad2deg(np.angle(G))
        reach = np.minimum(np.rad2deg(turn), 180.0)
        modulus = np.abs(G)
        low, high = modulus * np.maximum(1.0 - size, _BOTTOM), modulus * (1.0 + size)
        drawn.magnitude.append(Band(f, decibel(low), decibel(high), MODEL, name))
        drawn.phase.append(Band(f, phase - reach, phase + reach, MODEL, name))


def _curve(
    drawn: _Drawn, f: FloatArray, G: ComplexArray, name: str, colour: str, dash: Dash
) -> None:
    """Magnitude and phase of one model."""
    drawn.magnitude.append(Line(f, decibel(np.abs(G)), name, colour, dash))
    drawn.phase.append(Line(f, np.rad2deg(np.angle(G)), name, colour, dash))


def _modes(joint: JointModel) -> list[tuple[str, Mode]]:
    both = (("anti-resonance", joint.anti_resonance), ("resonance", joint.resonance))
    return [(name, mode) for name, mode in both if mode is not None]


def _uprights(joint: JointModel) -> Iterator[Upright]:
    """Lines at both modes, and at the edges of the band that was fitted.

    The words stand in the phase's panel, which is empty there: left of one, right of the other.
    """
    for name, mode in _modes(joint):
        text, before = f"{name} {mode.frequency_hz:.4g} Hz", name == "anti-resonance"
        yield Upright(mode.frequency_hz, text, panel=1, before=before, dash=SOLID)
    for edge in joint.band_hz:
        yield Upright(edge)
