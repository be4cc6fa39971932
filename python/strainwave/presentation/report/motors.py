"""The driven motors' responses in each operating condition: the rig's beside the fitted arm's."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from strainwave.domain import FloatArray, MotorResponse
from strainwave.presentation.report.figures import (
    MEASURED,
    RESIDUAL,
    TUNED,
    Figure,
    decibel,
    dots,
    line,
    marked,
    panels,
    place,
    rounded,
    upright,
)

_SURE = 0.8  # coherence from which a measured line is drawn as such
_MOST = 400  # lines


def figure_of(seen: MotorResponse, *, straight: bool = False) -> Figure:
    """Magnitude and phase of one motor's response, with the fitted arm's modes as upright lines.

    Parameters
    ----------
    seen : MotorResponse
    straight : bool
        Whether the joint is prismatic.

    Returns
    -------
    dict
        A plotly figure.
    """
    unit = "m/s/N" if straight else "rad/s/(N m)"
    f = seen.frequencies_hz
    chosen = _spread(f)
    sure = seen.coherence >= _SURE
    data: list[Figure] = []
    kinds = (("measured", MEASURED, sure), ("measured, doubtful", RESIDUAL, ~sure))
    for name, colour, own in kinds:
        at = chosen[own[chosen]]
        if at.size:
            x, G = rounded(f[at]), seen.measured[at]
            data.append(dots(x, decibel(np.abs(G)), name, colour) | place(0, name, first=True))
            phase = np.rad2deg(np.angle(G))
            data.append(dots(x, phase, name, colour) | place(1, name, first=False))
    x, G, name = rounded(f[chosen]), seen.fitted[chosen], "fitted arm, simulated"
    data.append(line(x, decibel(np.abs(G)), name, TUNED) | place(0, name, first=True))
    data.append(line(x, np.rad2deg(np.angle(G)), name, TUNED) | place(1, name, first=False))
    layout = panels("frequency [Hz]", (f"dB re {unit}", "phase [°]"), log=True, heights=(1.0, 0.7))
    layout["yaxis2"]["dtick"] = 90
    height = layout["yaxis2"]["domain"][1]
    modes = [
        *((value, "anti-resonance", True) for value in _within(seen.anti_resonances_hz, f)),
        *((value, "resonance", False) for value in _within(seen.resonances_hz, f)),
    ]
    marks = [
        upright(
            value,
            f"{name} {value:.3g} Hz" if k < 1 or name != modes[k - 1][1] else f"{value:.3g} Hz",
            height=height * (1.0 - 0.16 * (k % 2)),
            before=before,
            log=True,
            dash="solid" if before else "dot",
        )
        for k, (value, name, before) in enumerate(modes)
    ]
    return {"data": data, "layout": marked(layout, marks)}


def words_of(seen: MotorResponse) -> str:
    """What the figure shows, for those who do not see it.

    Parameters
    ----------
    seen : MotorResponse

    Returns
    -------
    str
    """
    said = []
    kinds = (("anti-resonance", seen.anti_resonances_hz), ("resonance", seen.resonances_hz))
    for name, values in kinds:
        shown = [f"{value:.4g}" for value in _within(values, seen.frequencies_hz)]
        if shown:
            said.append(f"{name} of the fitted arm at {' and '.join(shown)} Hz")
    sure = seen.coherence >= _SURE
    if sure.any():
        left = np.abs(seen.measured[sure] - seen.fitted[sure]) / np.abs(seen.measured[sure])
        size = 100.0 * float(np.median(left))
        said.append(f"where the coherence is 0.8 and more the two differ by {size:.2g} % (median)")
    text = "; ".join(said)
    return f"{text[:1].upper()}{text[1:]}." if text else ""


def _spread(f: FloatArray) -> np.ndarray:
    """Lines to draw, no more than a screen shows, evenly over the logarithm."""
    if len(f) <= _MOST:
        return np.arange(len(f))
    return np.unique(np.searchsorted(f, np.geomspace(f[0], f[-1], _MOST)).clip(0, len(f) - 1))


def _within(values: Sequence[float], f: FloatArray) -> list[float]:
    return [value for value in values if len(f) and f[0] <= value <= f[-1]]
