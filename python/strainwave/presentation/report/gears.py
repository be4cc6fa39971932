"""Stiffness curves of the gears, with the torques that the records loaded them by."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from strainwave.domain import FloatArray, Identification, Parameter, TorqueHistogram
from strainwave.domain.formatting import plus_minus
from strainwave.presentation.figures import (
    BRIEF,
    MEASURED,
    MODEL,
    RESIDUAL,
    Axis,
    Band,
    Bars,
    Figure,
    Line,
    Panel,
    Upright,
)

_SLOPES = ("gear_stiffness_k1", "gear_stiffness_k2", "gear_stiffness_k3")
_KNEES = ("gear_knee_t1", "gear_knee_t2")
_REACH = 1.96  # of a 95 % band, in deviations
_POINTS = 200  # of the curve
_BEYOND = 1.5  # times the last knee, where nothing says what torques there were


@dataclass(frozen=True, slots=True)
class Curve:
    """One gear's slopes and the torques at which they change, as far as they are identified."""

    joint: int  # from 1
    slopes: FloatArray  # (n_slopes,) [N m/rad]
    knees: FloatArray  # (n_slopes - 1,) [N m]
    covariance: FloatArray  # of slopes, then knees
    largest: float  # [N m] up to which it is drawn
    gear_loads: TorqueHistogram | None  # None: not known
    equivalent: bool = False  # one slope for the whole of a multi-slope curve
    straight: bool = False  # whether it is a prismatic joint's: N and m, not N m and rad

    @property
    def unit(self) -> str:
        """Of the torque."""
        return "N" if self.straight else "N m"

    @property
    def slope_unit(self) -> str:
        """Of a slope."""
        return "N/m" if self.straight else "N m/rad"


def curves(identification: Identification) -> list[Curve]:
    """The curve of every elastic gear: from the whole-arm fit, else from its joint's own.

    Parameters
    ----------
    identification : Identification

    Returns
    -------
    list of Curve
    """
    tuned = identification.tuned
    found = []
    for number, joint in enumerate(identification.study.arm.joints, start=1):
        if joint.spring == "rigid":
            continue
        gear_loads = next(
            (h for h in (tuned.gear_loads if tuned else ()) if h.joint == number), None
        )
        curve = None
        if tuned is not None:
            curve = _curve(number, tuned.parameters, tuned.covariance, gear_loads)
        for own in identification.joints:
            if curve is None and own.joint == number:
                size = len(own.parameters)
                curve = _curve(number, own.parameters, own.covariance[:size, :size], gear_loads)
        if curve is not None:
            equivalent = joint.spring == "three-slope" and len(curve.slopes) == 1
            straight = joint.motion == "prismatic"
            found.append(replace(curve, equivalent=equivalent, straight=straight))
    return found


def slope_figure(curve: Curve) -> Figure:
    """Slope over torque with its 95 % band and knees; below, the torques of the records.

    Parameters
    ----------
    curve : Curve

    Returns
    -------
    Figure
    """
    edges = np.concatenate([[0.0], curve.knees, [curve.largest]])
    torque = np.repeat(edges, 2)[1:-1]
    slope = np.repeat(curve.slopes, 2)
    reach = _REACH * np.repeat(_stds(curve)[: len(curve.slopes)], 2)
    stiffness = Panel(
        Axis(f"slope [{curve.slope_unit}]", range=(0.0, 1.1 * float((slope + reach).max()))),
        (
            Band(torque, slope - reach, slope + reach, MODEL, "slope"),
            Line(torque, slope, "slope", MODEL, width=2.0),
        ),
        height=1.1,
    )
    panels = [stiffness]
    if curve.gear_loads is not None:
        # logarithmic: the rare large torques identify the last slope
        panels.append(Panel(Axis("records [%]", log=True), (_bars(curve.gear_loads),), height=0.9))
    axis = Axis(f"|torque| of the gear, at the link [{curve.unit}]")
    return Figure(axis, tuple(panels), _knees(curve, curve.knees, height=0.25))


def torsion_figure(curve: Curve) -> Figure:
    """Torque over torsion, with its 95 % band, knees, and how it would go on without.

    Parameters
    ----------
    curve : Curve

    Returns
    -------
    Figure
    """
    torque = np.linspace(0.0, curve.largest, _POINTS)
    torsion, std = torsion_at(curve, torque)
    # the band of the torque at a given torsion: that of the torsion times the slope
    slope = curve.slopes[np.searchsorted(curve.knees, torque)]
    reach = _REACH * std * slope
    at, straight = 1e3 * torsion, curve.slopes[0] * torsion
    marks = (
        Band(at, torque - reach, torque + reach, MODEL, "gear"),
        Line(at, torque, "gear", MODEL, width=2.0),
        Line(at, straight, "its first slope", RESIDUAL, BRIEF, width=1.0),
    )
    axis = Axis(f"torsion of the gear, at the link [{'mm' if curve.straight else 'mrad'}]")
    knees = 1e3 * torsion_at(curve, curve.knees)[0]
    return Figure(axis, (Panel(Axis(f"torque [{curve.unit}]"), marks),), _knees(curve, knees))


def torsion_at(curve: Curve, torque: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Torsion under a torque, and its deviation by the delta method.

    delta(T) = sum over the slopes of (length of [0, T] that lies on each) / slope.

    Parameters
    ----------
    curve : Curve
    torque : (n,) [N m]

    Returns
    -------
    torsion, std : (n,) [rad]
    """
    edges = np.concatenate([[0.0], curve.knees, [np.inf]])
    on = np.clip(torque[:, None], edges[:-1], edges[1:]) - edges[:-1]  # (n, n_slopes)
    torsion = on @ (1.0 / curve.slopes)
    by_slope = -on / curve.slopes**2
    past = (torque[:, None] > curve.knees).astype(float)
    by_knee = past * (1.0 / curve.slopes[:-1] - 1.0 / curve.slopes[1:])
    J = np.hstack([by_slope, by_knee])
    variance = np.einsum("ni,ij,nj->n", J, curve.covariance, J)
    return torsion, np.asarray(np.sqrt(np.clip(variance, 0.0, None)))


def words(curve: Curve) -> str:
    """What the figure shows, for those who do not see it.

    Parameters
    ----------
    curve : Curve

    Returns
    -------
    str
    """
    stds = _stds(curve)
    count = len(curve.slopes)
    slopes = [" ± ".join(plus_minus(v, s)) for v, s in zip(curve.slopes, stds, strict=False)]
    text = f"Slope {', then '.join(slopes)} {curve.slope_unit}"
    if count > 1:
        knees = zip(curve.knees, stds[count:], strict=True)
        identified = " and ".join(" ± ".join(plus_minus(*knee)) for knee in knees)
        text += f", with knees at {identified} {curve.unit}"
    text += "."
    if curve.equivalent:
        text += " One stiffness for the whole of a multi-slope curve."
    if curve.gear_loads is not None:
        reach = f"{curve.largest:.3g} {curve.unit}"
        text += f" The records load the gear up to {reach}, and nothing is identifiable beyond."
    return text


def _curve(
    number: int,
    parameters: Sequence[Parameter],
    covariance: FloatArray,
    gear_loads: TorqueHistogram | None,
) -> Curve | None:
    """From parameters in the order of their covariance; None where no slope is identified."""
    at = {p.name: k for k, p in enumerate(parameters) if p.joint == number and p.value is not None}
    slopes = [at[name] for name in _SLOPES if name in at] or [
        at[name] for name in ("gear_stiffness",) if name in at
    ]
    if not slopes:
        return None
    knees = [at[name] for name in _KNEES if name in at][: len(slopes) - 1]
    slopes = slopes[: len(knees) + 1]  # beyond a knee that is not identified a slope has no place
    order = slopes + knees
    values = np.array([parameters[k].value for k in order], dtype=float)
    bends = values[len(slopes) :]
    largest = float(gear_loads.edges[-1]) if gear_loads is not None else 0.0
    largest = max(largest, _BEYOND * float(bends.max(initial=0.0)) if gear_loads is None else 0.0)
    return Curve(
        number,
        values[: len(slopes)],
        bends,
        np.nan_to_num(covariance[np.ix_(order, order)]),
        largest or 1.0,
        gear_loads,
    )


def _stds(curve: Curve) -> FloatArray:
    return np.asarray(np.sqrt(np.clip(np.diag(curve.covariance), 0.0, None)))


def _bars(gear_loads: TorqueHistogram) -> Bars:
    """Share of the samples in each bin."""
    middle = 0.5 * (gear_loads.edges[1:] + gear_loads.edges[:-1])
    width = float(np.diff(gear_loads.edges)[0])
    return Bars(middle, 100.0 * gear_loads.share, width, "torques in the records", MEASURED)


def _knees(curve: Curve, at: FloatArray, height: float = 1.0) -> tuple[Upright, ...]:
    """A line at each knee."""
    return tuple(
        Upright(float(x), f"{torque:.3g} {curve.unit}", height=height)
        for x, torque in zip(at, curve.knees, strict=True)
    )
