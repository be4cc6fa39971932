"""The driven motors' responses in each operating condition: the rig's beside the fitted arm's."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from strainwave.domain import FloatArray, MotorResponse
from strainwave.presentation.figures import (
    DOTTED,
    MEASURED,
    RESIDUAL,
    SOLID,
    TUNED,
    Axis,
    Figure,
    Line,
    Mark,
    Markers,
    Panel,
    Upright,
    decibel,
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
    Figure
    """
    f = seen.frequencies_hz
    chosen = _spread(f)
    sure = seen.coherence >= _SURE
    magnitude: list[Mark] = []
    phase: list[Mark] = []
    kinds = (("measured", MEASURED, sure), ("measured, doubtful", RESIDUAL, ~sure))
    for name, colour, own in kinds:
        at = chosen[own[chosen]]
        if at.size:
            x, G = f[at], seen.measured[at]
            magnitude.append(Markers(x, decibel(np.abs(G)), name, colour))
            phase.append(Markers(x, np.rad2deg(np.angle(G)), name, colour))
    x, G, name = f[chosen], seen.fitted[chosen], "fitted arm, simulated"
    magnitude.append(Line(x, decibel(np.abs(G)), name, TUNED))
    phase.append(Line(x, np.rad2deg(np.angle(G)), name, TUNED))
    panels = (
        Panel(Axis(f"dB re {'m/s/N' if straight else 'rad/s/(N m)'}"), tuple(magnitude), 1.2),
        Panel(Axis("phase [°]", step=90.0), tuple(phase), 0.8),
    )
    return Figure(Axis("frequency [Hz]", log=True), panels, tuple(_uprights(seen)))


def _uprights(seen: MotorResponse) -> Iterator[Upright]:
    """A line at each mode; words of neighbours differ in height, the first of a kind says which."""
    f = seen.frequencies_hz
    modes = [
        *((value, "anti-resonance", True) for value in _within(seen.anti_resonances_hz, f)),
        *((value, "resonance", False) for value in _within(seen.resonances_hz, f)),
    ]
    for k, (value, name, before) in enumerate(modes):
        alike = k > 0 and name == modes[k - 1][1]
        yield Upright(
            value,
            f"{value:.3g} Hz" if alike else f"{name} {value:.3g} Hz",
            panel=1,
            height=1.0 - 0.16 * (k % 2),
            before=before,
            dash=SOLID if before else DOTTED,
        )


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
