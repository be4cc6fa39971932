"""Two-inertia model: modes, reciprocity, (17), (18) and their inverse."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from strainwave.domain import ComplexArray
from strainwave.dynamics.two_inertia import (
    NAMES,
    TwoInertia,
    anti_resonance,
    coefficients,
    from_coefficients,
    jacobian,
    joint_of,
    resonance,
    state_space,
)


def size(low: float, high: float) -> st.SearchStrategy[float]:
    return st.floats(np.log(low), np.log(high)).map(lambda x: float(np.exp(x)))


joints = st.builds(
    TwoInertia,
    motor_inertia=size(2e-5, 1e-3),
    motor_viscous_friction=size(1e-5, 1e-3),
    link_inertia=size(0.1, 10.0),
    link_viscous_friction=size(0.01, 1.0),
    gear_stiffness=size(3e3, 5e4),
    gear_damping=size(1.0, 30.0),
    gear_ratio=size(5e-3, 2e-2),
)
"""Arms of some kilograms with strain-wave gears of ratio 50 to 200."""


def responses(p: TwoInertia, s: ComplexArray) -> ComplexArray:
    model = state_space(p)
    A, B, C = model.A, model.B, model.C
    return np.array([C @ np.linalg.solve(x * np.eye(3) - A, B + 0j) for x in s])


@given(joints)
def test_undamped_modes_match_the_closed_form(p: TwoInertia) -> None:
    """omega_a = sqrt(k/m_L), omega_r = sqrt(k/m_L + n^2 k/m_M)."""
    still = joint_of(p.vector * [1.0, 0.0, 1.0, 0.0, 1.0, 0.0], p.gear_ratio)
    of_link = still.gear_stiffness / still.link_inertia
    of_motor = still.gear_ratio**2 * still.gear_stiffness / still.motor_inertia
    low, high = anti_resonance(still), resonance(still)
    assert low.frequency_hz == pytest.approx(np.sqrt(of_link) / (2 * np.pi))
    assert high.frequency_hz == pytest.approx(np.sqrt(of_link + of_motor) / (2 * np.pi))
    assert low.damping == pytest.approx(0.0, abs=1e-9)
    assert high.damping == pytest.approx(0.0, abs=1e-9)


@given(joints)
def test_g11_matches_17_and_the_joint_is_reciprocal(p: TwoInertia) -> None:
    s: ComplexArray = np.asarray(1j * np.geomspace(1.0, 1e3, 9))
    G = responses(p, s)
    b, a = coefficients(p)
    direct = np.polyval(b[::-1], s) / np.polyval(a[::-1], s)
    assert G[:, 0, 0] == pytest.approx(direct, rel=1e-8)
    assert G[:, 0, 1] == pytest.approx(G[:, 1, 0], rel=1e-8)


@given(joints)
def test_the_poles_match_17(p: TwoInertia) -> None:
    _, a = coefficients(p)
    assert np.poly(state_space(p).A) == pytest.approx(a[::-1] / a[3], rel=1e-8)


@given(joints)
def test_18_inverts_17(p: TwoInertia) -> None:
    """a3 = c1 d2, a2 = c1 d1 + c0 d2 with c1 = m_M + n^2 m_L: exact both ways."""
    b, a = coefficients(p)
    n2 = p.gear_ratio**2
    c = np.array([a[0], p.motor_inertia + n2 * p.link_inertia])
    d2 = a[3] / c[1]
    d = np.array([(a[2] - c[0] * d2) / c[1], d2])
    back = from_coefficients(b[1:], d, c, p.gear_ratio)
    assert back.vector[[0, 2, 4]] == pytest.approx(p.vector[[0, 2, 4]], rel=1e-9)
    # the dampings are differences of larger numbers
    n2k = max(n2 * p.gear_damping, *p.vector[[1]], n2 * p.link_viscous_friction)
    weight = np.array([1.0, n2, n2])
    off = weight * (back.vector - p.vector)[[1, 3, 5]]
    assert off == pytest.approx(0.0, abs=1e-6 * n2k)


@given(joints)
def test_poles_and_zeros_give_the_parameters(p: TwoInertia) -> None:
    """Exact zeros and poles with c1 of the rigid model give the parameters up to the error of (18)."""
    zero, pole = anti_resonance(p).value, resonance(p).value
    b, d = (np.array([-2.0 * r.real / abs(r) ** 2, abs(r) ** -2]) for r in (zero, pole))
    n2 = p.gear_ratio**2
    c0 = p.motor_viscous_friction + n2 * p.link_viscous_friction
    c1 = p.motor_inertia + n2 * p.link_inertia
    back = from_coefficients(b, d, np.array([c0, c1]), p.gear_ratio)
    slow = c0 / c1 / abs(zero)
    off = back.vector[[0, 2, 4]] / p.vector[[0, 2, 4]] - 1.0
    # gear compliance changes the slow pole, more so with more damping, and an error of the larger
    # inertia is a larger relative error of the smaller one
    share = c1 / min(p.motor_inertia, n2 * p.link_inertia)
    damping = -pole.real / abs(pole) - zero.real / abs(zero)
    assert np.abs(off).max() < 5.0 * share * slow * (slow + damping) + 1e-9


def test_standard_deviations_follow_the_square_root() -> None:
    """f = sqrt(k/m_L)/2 pi: 1 % of k is 0.5 % of f."""
    p = joint_of(np.array([1.5e-4, 0.0, 3.8, 0.0, 2.5e4, 0.0]), 0.01)
    covariance = np.zeros((6, 6))
    covariance[4, 4] = (0.01 * p.gear_stiffness) ** 2
    mode = anti_resonance(p, covariance)
    assert mode.frequency_std_hz == pytest.approx(0.005 * mode.frequency_hz, rel=1e-6)
    assert anti_resonance(p).frequency_std_hz is None


def test_jacobian_of_a_quadratic_function() -> None:
    at = np.array([2.0, 0.0, -3.0])
    derivatives = jacobian(lambda x: np.array([x @ x, x[1]]), at)
    assert derivatives == pytest.approx(np.array([2.0 * at, [0.0, 1.0, 0.0]]), abs=1e-6)


def test_names_have_the_order_of_the_vector() -> None:
    p = joint_of(np.arange(1.0, 7.0), 0.01)
    assert [getattr(p, name) for name in NAMES] == p.vector.tolist()
