"""Bode plots of one joint: what was measured and how far it is to be trusted, and its models."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

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
from strainwave.presentation.report.figures import (
    LINEAR,
    MEASURED,
    MODEL,
    RESIDUAL,
    TUNED,
    Figure,
    band,
    decibel,
    dots,
    line,
    marked,
    panels,
    place,
    rounded,
    upright,
)
from strainwave.statespace import frequency_response

_POINTS = 300  # of a model's curve
_MOST_LINES = 500  # measured; of more, those evenly spread over the logarithm of frequency
_NYQUIST = 0.98  # of half the sample rate, up to which a sampled model is drawn
_DASHES = ("6px,3px", "2px,2px", "8px,3px,2px,3px")  # of sampled models
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
    dict
        A plotly figure.
    """
    low, high = joint.band_hz[0] / OUTSIDE, joint.band_hz[1] * OUTSIDE
    data: list[Figure] = []
    unit = "m/s/N" if straight else "rad/s/(N m)"
    titles, heights = [f"dB re {unit}", "phase [°]"], [1.0, 0.7]
    if measured is not None:
        seen = _lines_between(measured, low, high)
        data += _measured(measured, seen)
        if measured.coherence is not None:
            data += _coherence(measured.frequencies_hz[seen], measured.coherence[seen, 0])
            titles.append("coherence")
            heights.append(0.4)
    for k, (name, model) in enumerate(sampled):
        top = min(joint.band_hz[1], _NYQUIST * 0.5 / model.sample_time)
        f: FloatArray = np.geomspace(joint.band_hz[0], top, _POINTS)
        G = frequency_response(model, f).response[:, 0, 0]
        dash = _DASHES[k % len(_DASHES)]
        data += _curve(f, G, f"state space, {name}", LINEAR, dash)
    f = np.geomspace(low, high, _POINTS)
    data += _physical(joint, gear_ratio, f)
    if tuned is not None:
        vector = np.array([tuned[name] for name in list(joint.values)[:6]])
        data += _curve(f, motor_response(vector, gear_ratio, f), "whole-arm fit", TUNED, "8px,4px")
    layout = panels("frequency [Hz]", titles, log=True, heights=heights)
    layout["yaxis2"]["dtick"] = 90
    if "yaxis3" in layout:
        layout["yaxis3"]["range"] = [0.0, 1.05]
    marks = _marks(joint, layout["yaxis2"]["domain"][1])
    return {"data": data, "layout": marked(layout, marks)}


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


def _measured(measured: FrequencyResponse, seen: np.ndarray) -> list[Figure]:
    """Points, grey where they say little."""
    G = measured.response[seen, 0, 0]
    f = measured.frequencies_hz[seen]
    sure = trusted(measured)[seen]
    data = []
    kinds = (("measured", MEASURED, sure), ("measured, doubtful", RESIDUAL, ~sure))
    for name, colour, chosen in kinds:
        if chosen.any():
            at = rounded(f[chosen])
            size, phase = decibel(np.abs(G[chosen])), np.rad2deg(np.angle(G[chosen]))
            # paler and larger than the lines over them, which are then seen where both agree
            pale = {"marker": {"color": colour, "size": _DOT, "opacity": _PALE}}
            data.append(dots(at, size, name, colour) | pale | place(0, name, first=True))
            data.append(dots(at, phase, name, colour) | pale | place(1, name, first=False))
    return data


def _coherence(f: FloatArray, coherence: FloatArray) -> list[Figure]:
    """An area below the coherence."""
    at = rounded(f)
    area = band(at, np.zeros(len(f)), coherence, MEASURED)
    edge = line(at, coherence, "coherence", MEASURED, width=1)
    return [part | place(2, "coherence", first=False) for part in (area, edge)]


def _physical(joint: JointModel, gear_ratio: float, f: FloatArray) -> list[Figure]:
    """The curve of the physical model and its 95 % band, by the delta method."""
    vector = vector_of(joint)
    G = motor_response(vector, gear_ratio, f)
    name = "physical model"
    data = _curve(f, G, name, MODEL, "solid")
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
        at = rounded(f)
        data.append(band(at, decibel(low), decibel(high), MODEL) | place(0, name, first=False))
        data.append(band(at, phase - reach, phase + reach, MODEL) | place(1, name, first=False))
    return data


def _curve(f: FloatArray, G: ComplexArray, name: str, colour: str, dash: str) -> list[Figure]:
    """Magnitude and phase of one model."""
    at = rounded(f)
    size, phase = decibel(np.abs(G)), np.rad2deg(np.angle(G))
    return [
        line(at, size, name, colour, dash=dash) | place(0, name, first=True),
        line(at, phase, name, colour, dash=dash) | place(1, name, first=False),
    ]


def _modes(joint: JointModel) -> list[tuple[str, Mode]]:
    both = (("anti-resonance", joint.anti_resonance), ("resonance", joint.resonance))
    return [(name, mode) for name, mode in both if mode is not None]


def _marks(joint: JointModel, height: float) -> list[Figure]:
    """Lines at both modes, and at the edges of the band that was fitted.

    The words stand in the phase's panel, which is empty there: left of one, right of the other.
    """
    marks = [
        upright(
            mode.frequency_hz,
            f"{name} {mode.frequency_hz:.4g} Hz",
            height=height,
            before=name == "anti-resonance",
            log=True,
            dash="solid",
        )
        for name, mode in _modes(joint)
    ]
    return marks + [upright(edge, "", log=True) for edge in joint.band_hz]
