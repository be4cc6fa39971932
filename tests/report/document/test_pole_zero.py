"""Pole-zero maps: roots of known joints, and ellipses of their covariance."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from elastic_results import JOINT, SPREAD, joint_model, sampled
from figure_parts import marks
from strainwave.domain import Modes
from strainwave.dynamics.two_inertia import coefficients, joint_of
from strainwave.report.document.bode import FittedJoint, pole_zero_map
from strainwave.report.figures import Figure, Line, Markers
from strainwave.statespace import modes

RATIO = JOINT.gear_ratio


def roots(figure: Figure, name: str) -> np.ndarray:
    (markers,) = (mark for mark in marks(figure, Markers) if mark.name == name)
    return np.sort_complex(np.asarray(markers.x, dtype=float) + 1j * markers.y)


def test_the_roots_are_those_of_the_transfer_function() -> None:
    b, a = coefficients(JOINT)
    figure = pole_zero_map(joint_model(), RATIO)
    assert roots(figure, "poles, joint model") == pytest.approx(np.sort_complex(np.roots(a[::-1])))
    assert roots(figure, "zeros, joint model") == pytest.approx(np.sort_complex(np.roots(b[::-1])))
    symbols = {mark.name: mark.symbol for mark in marks(figure, Markers)}
    assert symbols == {"poles, joint model": "x", "zeros, joint model": "circle-open"}


def test_a_state_space_model_has_the_poles_of_the_joint_and_their_ellipses() -> None:
    model = joint_model()
    known = modes(sampled(), 0, 0)
    assert known.resonance is not None
    assert model.resonance is not None
    std = {"frequency_std_hz": 0.3, "damping_std": 0.004}
    known = Modes((replace(known.resonance, **std),), (), known.resonance, None)
    figure = pole_zero_map(model, RATIO, {"prbs": known})
    poles = roots(figure, "poles, state space, prbs")
    expected = [m for m in roots(figure, "poles, joint model") if abs(m.imag) > 1.0]
    assert poles == pytest.approx(np.array(expected), rel=1e-6)
    # far from damping one, real and imaginary part move with damping and frequency alone
    upper = max(
        (m for m in marks(figure, Line) if "state space" in m.name), key=lambda m: m.y.mean()
    )
    w = abs(poles[0])
    assert np.ptp(upper.x) == pytest.approx(2.0 * 2.448 * 0.004 * w, rel=0.02)
    assert np.ptp(upper.y) == pytest.approx(2.0 * 2.448 * 2.0 * np.pi * 0.3, rel=0.02)


def test_95_percent_of_random_parameters_lie_in_the_ellipse() -> None:
    figure = pole_zero_map(joint_model(), RATIO)
    ellipse = max(marks(figure, Line), key=lambda line: float(line.y.mean()))  # the upper pole
    centre = complex(ellipse.x[:-1].mean(), ellipse.y[:-1].mean())
    outline = ellipse.x + 1j * ellipse.y - centre
    shape = np.stack([outline.real, outline.imag])
    # points x of an ellipse of covariance P: x' P^-1 x is constant
    P = shape[:, :-1] @ shape[:, :-1].T
    limit = float(np.einsum("in,ij,jn->n", shape, np.linalg.inv(P), shape).max())
    rng = np.random.default_rng(4)
    inside = 0
    for _ in range(1000):
        moved = joint_of(JOINT.vector * (1.0 + SPREAD * rng.standard_normal(6)), JOINT.gear_ratio)
        pole = max(np.roots(coefficients(moved)[1][::-1]), key=lambda root: root.imag) - centre
        x = np.array([pole.real, pole.imag])
        inside += float(x @ np.linalg.solve(P, x)) <= limit
    assert inside / 1000 == pytest.approx(0.95, abs=0.025)  # three standard deviations of a share


def test_the_whole_arm_fit_is_drawn_without_ellipses_if_its_covariance_is_unknown() -> None:
    unknown = replace(joint_model(), covariance=np.full((6, 6), np.nan))
    figure = pole_zero_map(unknown, RATIO, whole_arm=FittedJoint(JOINT.vector, None))
    assert marks(figure, Line) == []
    poles = roots(figure, "poles, whole-arm fit")
    assert poles == pytest.approx(roots(figure, "poles, joint model"))
