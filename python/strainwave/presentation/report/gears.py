"""Stiffness curves of the gears, with the torques that the records loaded them by."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from strainwave.domain import FloatArray, Identification, Parameter, TorqueHistogram
from strainwave.domain.gear_laws import GearLaw, gear_law
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

_REACH = 1.96  # of a 95 % band, in deviations
_POINTS = 200  # of the curve
_BEYOND = 1.5  # times the last knee, where nothing says what torques there were
_BESIDE = 1e-9  # of a stretch between knees, so far from which its stiffness is drawn


@dataclass(frozen=True, slots=True)
class Curve:
    """One gear's curve by its law, as far as its parameters are identified."""

    joint: int  # from 1
    law: GearLaw
    values: Mapping[str, float]  # of the law's parameters that are identified, in its order
    covariance: FloatArray  # of these
    largest: float  # [N m] up to which it is drawn
    gear_loads: TorqueHistogram | None  # None: not known
    is_equivalent: bool = False  # one stiffness for the whole of another law's curve
    straight: bool = False  # whether it is a prismatic joint's: N and m, not N m and rad

    @property
    def unit(self) -> str:
        """Of the torque."""
        return "N" if self.straight else "N m"

    @property
    def slope_unit(self) -> str:
        """Of a slope."""
        return "N/m" if self.straight else "N m/rad"

    @property
    def knees(self) -> FloatArray:
        """(n_knees,) torques at which the stiffness changes at once [N m]."""
        return np.array(self.law.knees(self.values))

    @property
    def bends(self) -> bool:
        """Whether it is more than a straight line."""
        return len(self.values) > 1


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
        if not joint.elastic:
            continue
        gear_loads = next(
            (h for h in (tuned.gear_loads if tuned else ()) if h.joint == number), None
        )
        curve = None
        if tuned is not None:
            curve = _curve(number, joint.law, tuned.parameters, tuned.covariance, gear_loads)
        for own in identification.joints:
            if curve is None and own.joint == number:
                size = len(own.parameters)
                covariance = own.covariance[:size, :size]
                curve = _curve(number, joint.law, own.parameters, covariance, gear_loads)
        if curve is not None:
            equivalent = joint.law.is_curved and not curve.bends
            straight = joint.motion == "prismatic"
            found.append(replace(curve, is_equivalent=equivalent, straight=straight))
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
    torque, torsion = _stretches(curve)
    slope = curve.law.stiffness(curve.values, torsion)
    reach = _REACH * _spread(curve, curve.law.stiffness_jacobian(curve.values, torsion))
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
    law, values = curve.law, curve.values
    torque = np.linspace(0.0, curve.largest, _POINTS)
    torsion = law.torsion(values, torque)
    reach = _REACH * _spread(curve, law.jacobian(values, torsion))
    at, straight = 1e3 * torsion, law.stiffness(values, torsion[:1]) * torsion
    marks = (
        Band(at, torque - reach, torque + reach, MODEL, "gear"),
        Line(at, torque, "gear", MODEL, width=2.0),
        Line(at, straight, "its first slope", RESIDUAL, BRIEF, width=1.0),
    )
    axis = Axis(f"torsion of the gear, at the link [{'mm' if curve.straight else 'mrad'}]")
    knees = 1e3 * law.torsion(values, curve.knees)
    return Figure(axis, (Panel(Axis(f"torque [{curve.unit}]"), marks),), _knees(curve, knees))


def torsion_at(curve: Curve, torque: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Torsion under a torque, and its deviation by the delta method.

    ddelta/dp = -(dT/dp) / (dT/ddelta) at a torque.

    Parameters
    ----------
    curve : Curve
    torque : (n,) [N m]

    Returns
    -------
    torsion, std : (n,) [rad]
    """
    torsion = curve.law.torsion(curve.values, torque)
    std = _spread(curve, curve.law.jacobian(curve.values, torsion))
    return torsion, np.asarray(std / curve.law.stiffness(curve.values, torsion))


def words(curve: Curve) -> str:
    """What the figure shows, for those who do not see it.

    Parameters
    ----------
    curve : Curve

    Returns
    -------
    str
    """
    std = np.sqrt(np.clip(np.diag(curve.covariance), 0.0, None)).tolist()
    text = f"{curve.law.sentence(curve.values, std, is_straight=curve.straight)}."
    if curve.is_equivalent:
        text += " One stiffness for the whole of a curve."
    if curve.gear_loads is not None:
        reach = f"{curve.largest:.3g} {curve.unit}"
        text += f" The records load the gear up to {reach}, and nothing is identifiable beyond."
    return text


def _curve(
    number: int,
    law: GearLaw,
    parameters: Sequence[Parameter],
    covariance: FloatArray,
    gear_loads: TorqueHistogram | None,
) -> Curve | None:
    """From parameters in the order of their covariance; None where no slope is identified."""
    at = {p.name: k for k, p in enumerate(parameters) if p.joint == number and p.value is not None}
    names = law.drawn(at)
    if not names and law.simpler is not None:
        return _curve(number, gear_law(law.simpler), parameters, covariance, gear_loads)
    if not names:
        return None
    order = [at[name] for name in names]
    values = {name: float(parameters[k].value or 0.0) for name, k in zip(names, order, strict=True)}
    largest = _BEYOND * max(law.knees(values), default=0.0)
    if gear_loads is not None:
        largest = float(gear_loads.edges[-1])
    known = np.nan_to_num(covariance[np.ix_(order, order)])
    return Curve(number, law, values, known, largest or 1.0, gear_loads)


def _stretches(curve: Curve) -> tuple[FloatArray, FloatArray]:
    """Torques from knee to knee, and their torsions: (n,); where nothing bends, the ends only."""
    shares = np.linspace(_BESIDE, 1.0 - _BESIDE, _POINTS)
    edges = [0.0, *curve.knees, curve.largest]
    torque, torsion = list[FloatArray](), list[FloatArray]()
    for low, high in pairwise(edges):
        on = low + (high - low) * shares
        at = curve.law.torsion(curve.values, on)
        if np.ptp(curve.law.stiffness(curve.values, at)) == 0.0:
            on, at = np.array([low, high]), at[[0, -1]]
        torque.append(on)
        torsion.append(at)
    return np.concatenate(torque), np.concatenate(torsion)


def _spread(curve: Curve, J: FloatArray) -> FloatArray:
    """Deviation of what the parameters' errors move by J: (n,)."""
    variance = np.einsum("ni,ij,nj->n", J, curve.covariance, J)
    return np.asarray(np.sqrt(np.clip(variance, 0.0, None)))


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
