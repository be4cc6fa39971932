"""Pole-zero map of one joint, motor torque to motor velocity, with 95 % confidence ellipses."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from strainwave.domain import ComplexArray, FloatArray, JointModel, Mode, Modes
from strainwave.domain.distributions import chi_square_limit
from strainwave.dynamics.two_inertia import coefficients, jacobian, joint_of
from strainwave.identification.joint_model.agreement import vector_of
from strainwave.presentation.figures import (
    DASHES,
    Axis,
    Colour,
    Figure,
    Line,
    Mark,
    Markers,
    Panel,
    Symbol,
)
from strainwave.presentation.report.bode import JointFit
from strainwave.statespace import nearest

_ELLIPSE_POINTS = 40
_MAX_DAMPING = 0.5  # of the oscillating roots shown: others describe the edge of the band
_SYMBOL_SIZE = 9.0  # [px]
_HEIGHT = 2.2  # of the panel, in usual panels: the map is nearly square
_WIDEST_ELLIPSE = (
    1.0  # largest standard deviation over the modulus; wider ellipses are not informative
)


def pole_zero_map(
    joint: JointModel,
    gear_ratio: float,
    state_space: Mapping[str, Modes] | None = None,
    *,
    whole_arm: JointFit | None = None,
) -> Figure:
    """Poles (crosses) and zeros (circles) in continuous time.

    Of a state-space model, only oscillating roots in the band of the fit and real roots below it
    are shown.
    """
    marks: list[Mark] = []
    for k, (name, modes) in enumerate((state_space or {}).items()):
        roots = _state_space_roots(modes, joint.band_hz)
        marks += _marks(*roots, f"state space, {name}", Colour.LINEAR, k)
    covariance = joint.covariance[:6, :6]
    marks += _marks(
        *_joint_roots(vector_of(joint), covariance, gear_ratio), "joint model", Colour.MODEL
    )
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


def _state_space_roots(modes: Modes, band_hz: tuple[float, float]) -> Roots:
    """The roots that are shown, with both conjugates.

    Frequency and damping are taken as uncorrelated: s = w (-d + i sqrt(1 - d^2)).
    """
    groups = [[m for m in group if _is_shown(m, band_hz)] for group in (modes.poles, modes.zeros)]
    pairs = [[(m, side) for m in group for side in _sides(m)] for group in groups]
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


def _sides(mode: Mode) -> tuple[float, ...]:
    return (1.0, -1.0) if mode.oscillates else (1.0,)


def _root(mode: Mode, side: float) -> complex:
    return complex(mode.value.real, side * mode.value.imag)


def _is_shown(mode: Mode, band_hz: tuple[float, float]) -> bool:
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
    radii = np.sqrt(chi_square_limit(0.05, 2) * np.clip(values, 0.0, None))
    points = vectors @ (radii[:, None] * np.stack([np.cos(angle), np.sin(angle)]))
    return centre.real + points[0], centre.imag + points[1]
