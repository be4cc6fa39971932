"""Stiffness curves of the gears, and the torques that load them in the records."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from strainwave import domain
from strainwave.domain import FloatArray
from strainwave.domain.arm.gear_laws import GearLaw, gear_law
from strainwave.domain.keys import JointNumber
from strainwave.domain.results.distributions import CI95_STDS
from strainwave.report import figures
from strainwave.report.figures import Area, Axis, Colour, Figure, Line, Markers, Panel, Upright

_POINTS_PER_SEGMENT = 200  # of a curve between two knees
_RANGE_BEYOND_LAST_KNEE = 1.5  # largest torque drawn over the last knee if the loads are unknown
_KNEE_MARGIN = 1e-9  # share of a segment omitted at its ends, where the stiffness jumps
_MAX_TORSION_POINTS = 1500
_KNEE_SIZE = 9.0  # [px] of a knee marker


@dataclass(frozen=True, slots=True)
class StiffnessCurve:
    """The identified stiffness curve of one gear."""

    joint: JointNumber
    law: GearLaw
    values: Mapping[str, float]  # identified parameters of the law, in its order
    covariance: FloatArray  # of `values`
    largest_torque: float  # [N m] end of the drawn range
    loads: domain.TorqueHistogram | None  # None if unknown
    is_equivalent: bool = False  # one stiffness approximates a curve
    is_prismatic: bool = False  # N and m instead of N m and rad
    choice: domain.LawChoice | None = None  # None if the study states the law

    @property
    def torque_unit(self) -> str:
        """Unit of the gear torque."""
        return "N" if self.is_prismatic else "N m"

    @property
    def knees(self) -> FloatArray:
        """Torques [N m] at which the stiffness jumps: (n_knees,)."""
        return np.array(self.law.knees(self.values))

    @property
    def is_nonlinear(self) -> bool:
        """Whether the curve is more than a straight line."""
        return len(self.values) > 1


def stiffness_curves(identification: domain.Identification) -> list[StiffnessCurve]:
    """The curve of every elastic gear: of the whole-arm fit, else of the joint model."""
    whole_arm = identification.whole_arm
    loads = {h.joint: h for h in whole_arm.gear_loads} if whole_arm else {}
    choices = {choice.joint: choice for choice in whole_arm.gear_laws} if whole_arm else {}
    fits = [(whole_arm.parameters, whole_arm.covariance)] if whole_arm else []
    for model in identification.joints:
        size = len(model.parameters)
        fits.append((model.parameters, model.covariance[:size, :size]))
    curves = []
    for number, joint in enumerate(identification.study.arm.joints, start=1):
        if not joint.elastic:
            continue
        candidates = (_stiffness_curve(number, joint.law, *fit, loads.get(number)) for fit in fits)
        curve = next(filter(None, candidates), None)
        if curve is not None:
            curve = replace(
                curve,
                is_equivalent=joint.law.is_curved and not curve.is_nonlinear,
                is_prismatic=joint.motion == "prismatic",
                choice=choices.get(number),
            )
            curves.append(curve)
    return curves


def stiffness_figure(curve: StiffnessCurve) -> Figure:
    """Stiffness over torque with its 95 % band and knees; below, a histogram of the torques."""
    torque, torsion = _sample_segments(curve)
    stiffness = curve.law.stiffness(curve.values, torsion)
    half = CI95_STDS * _std(curve, curve.law.stiffness_jacobian(curve.values, torsion))
    top = 1.1 * float((stiffness + half).max())
    panels = [
        Panel(
            Axis(f"stiffness [{'N/m' if curve.is_prismatic else 'N m/rad'}]", range=(0.0, top)),
            (
                Area(torque, stiffness - half, stiffness + half, Colour.MODEL, "stiffness"),
                Line(torque, stiffness, "stiffness", Colour.MODEL, width=2.0),
            ),
            height=1.1,
        )
    ]
    if curve.loads is not None:
        # logarithmic: the few samples at large torques determine the last stiffness
        axis = Axis("samples [%]", log=True)
        edges = curve.loads.edges
        bars = figures.Bars(
            0.5 * (edges[1:] + edges[:-1]),
            100.0 * curve.loads.share,
            float(np.diff(edges)[0]),
            "torques in the records",
            Colour.MEASURED,
        )
        panels.append(Panel(axis, (bars,), height=0.9))
    knees = (Upright(x, f"{x:.3g} {curve.torque_unit}", height=0.25) for x in curve.knees.tolist())
    axis = Axis(f"absolute gear torque at the link [{curve.torque_unit}]")
    return Figure(axis, tuple(panels), tuple(knees))


def torsion_figure(curve: StiffnessCurve) -> Figure:
    """Torque over torsion with its 95 % band; markers show the knees on the curve."""
    law, values = curve.law, curve.values
    torque, torsion = _sample_segments(curve)
    half = CI95_STDS * _std(curve, law.jacobian(values, torsion))
    x, scale = 1e3 * torsion, 1e3
    initial = law.stiffness(values, torsion[:1]) * torsion
    knees = scale * law.torsion(values, curve.knees)
    marks = (
        Area(x, torque - half, torque + half, Colour.MODEL, "identified curve"),
        Line(x, initial, "initial stiffness", Colour.RESIDUAL, figures.SHORT_DASH, width=1.0),
        Line(x, torque, "identified curve", Colour.MODEL, width=2.0),
        *([Markers(knees, curve.knees, "knees", Colour.MODEL, _KNEE_SIZE)] if len(knees) else ()),
    )
    axis = Axis(f"gear torsion at the link [{'mm' if curve.is_prismatic else 'mrad'}]")
    return Figure(axis, (Panel(Axis(f"gear torque [{curve.torque_unit}]"), marks),))


def measured_torsion_figure(fit: domain.TorsionFit, *, is_prismatic: bool = False) -> Figure:
    """Torque of the rigid model over the measured torsion, and the line of the stiffness."""
    step = -(-len(fit.torque) // _MAX_TORSION_POINTS)
    torque, torsion = fit.torque[::step], 1e3 * fit.torsion[::step]
    ends = np.array([torque.min(), torque.max()])
    stiffness = fit.stiffness.value or np.inf
    marks = (
        Markers(torsion, torque, "measured", Colour.MEASURED, 3.0, 0.4),
        Line(1e3 * ends / stiffness, ends, "estimated stiffness", Colour.MODEL, width=2.0),
    )
    axis = Axis(f"measured torsion [{'mm' if is_prismatic else 'mrad'}]")
    return Figure(axis, (Panel(Axis(f"link torque [{'N' if is_prismatic else 'N m'}]"), marks),))


def describe_measured(fit: domain.TorsionFit) -> str:
    """Caption of the figure of the measured torsion."""
    p = fit.stiffness
    return (
        f"Stiffness {p.value:.4g} ± {p.std:.2g} {p.unit} from {', '.join(fit.experiments)}: the"
        f" torque explains {fit.fit_percent:.1f} % of the torsion, without offsets and without the"
        " parts that follow acceleration and velocity."
    )


def describe(curve: StiffnessCurve) -> str:
    """Caption of the stiffness figure."""
    std = np.sqrt(np.clip(np.diag(curve.covariance), 0.0, None)).tolist()
    text = f"{curve.law.sentence(curve.values, std, is_straight=curve.is_prismatic)}."
    if curve.is_equivalent:
        text += " One equivalent stiffness approximates the whole curve."
    choice = curve.choice
    if choice is not None and choice.margins:
        margins = ", ".join(
            f"{margin.difference:.3g} that of {margin.law} (weight {margin.weight:.2f})"
            for margin in choice.margins
        )
        text += f" The data support the law {choice.law}: its held-out log score exceeds by"
        text += f" {margins}."
    elif choice is not None:
        text += f" The law is {choice.law}: no curve explains a considerable part of the residuals."
    if curve.loads is not None:
        limit = f"{curve.largest_torque:.3g} {curve.torque_unit}"
        text += f" The largest gear torque in the records is {limit}; the curve is unknown above."
    return text


def _stiffness_curve(
    number: int,
    law: GearLaw,
    parameters: Sequence[domain.Parameter],
    covariance: FloatArray,
    loads: domain.TorqueHistogram | None,
) -> StiffnessCurve | None:
    """The curve from the identified parameters of a joint; None if no stiffness is identified."""
    index = {
        p.name: k for k, p in enumerate(parameters) if p.joint == number and p.value is not None
    }
    names = law.drawn(index)
    if not names and law.simpler is not None:
        return _stiffness_curve(number, gear_law(law.simpler), parameters, covariance, loads)
    if not names:
        return None
    order = [index[name] for name in names]
    values = {name: float(parameters[k].value or 0.0) for name, k in zip(names, order, strict=True)}
    largest = _RANGE_BEYOND_LAST_KNEE * max(law.knees(values), default=0.0)
    if loads is not None:
        largest = float(loads.edges[-1])
    covariance_of_curve = np.nan_to_num(covariance[np.ix_(order, order)])
    return StiffnessCurve(number, law, values, covariance_of_curve, largest or 1.0, loads)


def _sample_segments(curve: StiffnessCurve) -> tuple[FloatArray, FloatArray]:
    """Torques between the knees within the drawn range, and their torsions: (n,).

    A straight segment has its end points only, so that each knee is a vertex of the line.
    """
    shares = np.linspace(_KNEE_MARGIN, 1.0 - _KNEE_MARGIN, _POINTS_PER_SEGMENT)
    inside = curve.knees[curve.knees < curve.largest_torque]
    torque, torsion = list[FloatArray](), list[FloatArray]()
    for low, high in pairwise([0.0, *inside.tolist(), curve.largest_torque]):
        points = low + (high - low) * shares
        angles = curve.law.torsion(curve.values, points)
        if np.ptp(curve.law.stiffness(curve.values, angles)) == 0.0:
            points, angles = np.array([low, high]), angles[[0, -1]]
        torque.append(points)
        torsion.append(angles)
    return np.concatenate(torque), np.concatenate(torsion)


def _std(curve: StiffnessCurve, J: FloatArray) -> FloatArray:
    variance = np.einsum("ni,ij,nj->n", J, curve.covariance, J)
    return np.asarray(np.sqrt(np.clip(variance, 0.0, None)))
