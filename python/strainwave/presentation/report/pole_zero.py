"""Pole-zero map of one joint, motor torque to motor velocity, with 95 % confidence ellipses."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from strainwave.domain import (
    BoolArray,
    ComplexArray,
    ContinuousStateSpace,
    FloatArray,
    JointModel,
    StateSpace,
)
from strainwave.dynamics.two_inertia import coefficients, jacobian, joint_of
from strainwave.errors import NotIdentifiable
from strainwave.identification.joint_model.agreement import vector_of
from strainwave.identification.joint_model.linear import without_alternating
from strainwave.presentation.figures import (
    DASHES,
    LINEAR,
    MODEL,
    TUNED,
    Axis,
    Figure,
    Line,
    Mark,
    Markers,
    Panel,
    Symbol,
)
from strainwave.presentation.report.bode import TunedJoint
from strainwave.statespace import to_continuous
from strainwave.statespace.modes import nearest, poles_and_zeros
from strainwave.statespace.propagation import propagate

_CHI_SQUARE_95 = 5.991  # two degrees of freedom: real and imaginary part
_ELLIPSE_POINTS = 40
_MAX_DAMPING = 0.5  # of the oscillating roots shown: others describe the edge of the band
_SYMBOL_SIZE = 9.0  # [px]
_HEIGHT = 2.2  # of the panel, in usual panels: the map is nearly square
_WIDEST_ELLIPSE = 1.0  # largest standard deviation over the modulus: a wider ellipse says nothing


def pole_zero_map(
    joint: JointModel,
    gear_ratio: float,
    state_space: Mapping[str, StateSpace] | None = None,
    *,
    tuned: TunedJoint | None = None,
) -> Figure:
    """Poles (crosses) and zeros (circles) in continuous time.

    Of a state-space model, only oscillating roots in the band of the fit and real roots below it
    are shown.
    """
    marks: list[Mark] = []
    for k, (name, model) in enumerate((state_space or {}).items()):
        roots = _state_space_roots(model, joint.band_hz)
        if roots is not None:
            marks += _marks(*roots, f"state space, {name}", LINEAR, k)
    covariance = joint.covariance[:6, :6]
    marks += _marks(*_joint_roots(vector_of(joint), covariance, gear_ratio), "joint model", MODEL)
    if tuned is not None:
        roots = _joint_roots(tuned.vector, tuned.covariance, gear_ratio)
        marks += _marks(*roots, "whole-arm fit", TUNED)
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


def _state_space_roots(model: StateSpace, band_hz: tuple[float, float]) -> Roots | None:
    """The roots that are shown; None if there is no continuous-time model."""
    try:
        continuous = to_continuous(without_alternating(model))
    except NotIdentifiable:
        return None
    poles, zeros = poles_and_zeros(continuous, 0, 0)
    poles, zeros = (roots[_is_shown(roots, band_hz)] for roots in (poles, zeros))

    def parts(near: ContinuousStateSpace) -> FloatArray:
        new_poles, new_zeros = poles_and_zeros(near, 0, 0)
        moved = np.concatenate([nearest(poles, new_poles), nearest(zeros, new_zeros)], axis=-1)
        return np.concatenate([moved.real, moved.imag], axis=-1)

    _, covariance = propagate(continuous, parts, stacked=True)
    return poles, zeros, covariance


def _is_shown(roots: ComplexArray, band_hz: tuple[float, float]) -> BoolArray:
    low, high = (2.0 * np.pi * edge for edge in band_hz)
    modulus = np.abs(roots)
    oscillates = (np.abs(roots.imag) > 0.0) & (np.abs(roots.real) < _MAX_DAMPING * modulus)
    return np.asarray(np.where(oscillates, modulus < high, modulus < low))


def _marks(
    poles: ComplexArray,
    zeros: ComplexArray,
    covariance: FloatArray | None,
    name: str,
    colour: str,
    k: int = 0,
) -> list[Mark]:
    roots = np.concatenate([poles, zeros])
    kinds: tuple[tuple[Symbol, ComplexArray, str], ...] = (
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
            x, y = _ellipse(root, block)
            label = f"{'poles' if i < len(poles) else 'zeros'}, {name}"
            marks.append(Line(x, y, label, colour, DASHES[k % 3], 1.0, legend=False))
    return marks


def _ellipse(centre: complex, covariance: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The 95 % confidence region of real and imaginary part."""
    values, vectors = np.linalg.eigh(covariance)
    angle = np.linspace(0.0, 2.0 * np.pi, _ELLIPSE_POINTS)
    radii = np.sqrt(_CHI_SQUARE_95 * np.clip(values, 0.0, None))
    points = vectors @ (radii[:, None] * np.stack([np.cos(angle), np.sin(angle)]))
    return centre.real + points[0], centre.imag + points[1]
