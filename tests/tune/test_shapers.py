"""Input shapers: definitions, simulated modes, samples of the clock, and refusals."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import expm

from strainwave.domain import FloatArray
from strainwave.errors import InvalidInput
from strainwave.tune.shapers import (
    Impulses,
    ShaperKind,
    design_shaper,
    design_zeros_and_maxima,
    has_design,
)

ALL_KINDS = tuple(ShaperKind)
ZERO_AT_DESIGN = (ShaperKind.ZV, ShaperKind.MZV, ShaperKind.ZVD, ShaperKind.TWO_HUMP_EI)
PERIOD = 1e-3

kinds = st.sampled_from(ALL_KINDS)
dampings = st.floats(0.0, 0.3)  # two-hump EI shapers for 5 % exist up to 0.44
steps = st.floats(0.02, 2.8)  # angle of the mode within a period; pi is the limit
detunings = st.floats(0.5, 1.5)


def vibration_of(impulses: Impulses, omega: float, damping: float) -> float:
    return float(impulses.residual_vibration(np.array(omega), np.array(damping)))


def simulated_vibration(weights: FloatArray, period: float, omega: float, damping: float) -> float:
    """Envelope after the last step of a held reference, over that of a single step at its start.

    x'' + 2 zeta omega x' + omega^2 x = omega^2 r, by the matrix exponential.
    """
    system = np.array([[0.0, 1.0, 0.0], [-(omega**2), -2.0 * damping * omega, omega**2], [0, 0, 0]])
    transition = expm(system * period)
    x, v, reference = 0.0, 0.0, 0.0
    for weight in weights[:-1]:
        reference += weight
        x, v, _ = transition @ [x, v, reference]

    def envelope(x: float, v: float) -> float:
        error = x - 1.0
        rate = (v / omega + damping * error) / np.sqrt(1.0 - damping**2)
        return float(np.hypot(error, rate))

    return envelope(x, v) / envelope(0.0, 0.0)


def insensitivity(kind: ShaperKind, damping: float, level: float = 0.05) -> float:
    """Width of the interval around the design frequency, over it, with at most this vibration."""
    shaper = design_shaper(kind, 1.0, damping)
    omega = np.linspace(0.4, 1.8, 28001)
    shares = shaper.impulses.residual_vibration(omega, np.full_like(omega, damping))
    beyond = omega[shares > level * (1.0 + 1e-9)]  # the maxima of EI shapers are at the level
    return float(beyond[beyond > 1.0].min() - beyond[beyond < 1.0].max())


@settings(deadline=None)
@given(kinds, steps, dampings)
def test_sums_to_one_with_positive_impulses(kind: ShaperKind, step: float, damping: float) -> None:
    shaper = design_shaper(kind, step / PERIOD, damping)
    for impulses in (shaper.impulses, shaper.sample(PERIOD)):
        assert impulses.amplitudes.sum() == pytest.approx(1.0, abs=1e-12)
        assert (impulses.amplitudes >= 0.0).all()
        assert impulses.times[0] == 0.0
        assert (np.diff(impulses.times) > 0.0).all()


@settings(deadline=None)
@given(st.sampled_from(ZERO_AT_DESIGN), steps, dampings)
def test_design_mode_is_at_rest_before_and_after_sampling(
    kind: ShaperKind, step: float, damping: float
) -> None:
    shaper = design_shaper(kind, step / PERIOD, damping)
    # 1e-9: the extra-insensitive shapers solve their equations to this accuracy
    assert vibration_of(shaper.impulses, shaper.omega, damping) < 1e-9
    assert vibration_of(shaper.sample(PERIOD), shaper.omega, damping) < 1e-8


@pytest.mark.parametrize("damping", [0.0, 0.03, 0.3])
def test_zvd_has_a_double_zero_and_zv_a_single_one(damping: float) -> None:
    offsets = np.array([1e-3, 1e-4])

    def order(kind: ShaperKind) -> float:
        impulses = design_shaper(kind, 1.0, damping).impulses
        near, nearer = impulses.residual_vibration(1.0 + offsets, np.full(2, damping))
        return float(np.log10(near / nearer))

    assert order(ShaperKind.ZV) == pytest.approx(1.0, abs=0.01)
    assert order(ShaperKind.MZV) == pytest.approx(1.0, abs=0.01)
    assert order(ShaperKind.ZVD) == pytest.approx(2.0, abs=0.01)


@settings(deadline=None)
@given(st.sampled_from([2, 3]), dampings, st.floats(1e-3, 0.06))
def test_extra_insensitive_shapers_meet_their_definition(
    n_zeros: int, damping: float, tolerance: float
) -> None:
    design = design_zeros_and_maxima(n_zeros, damping, tolerance)
    assert design is not None
    impulses = Impulses(design.amplitudes, design.times)
    at = impulses.residual_vibration(design.omega, np.full_like(design.omega, damping))
    assert design.omega[n_zeros - 1] == 1.0
    np.testing.assert_allclose(at[::2], 0.0, atol=1e-8)
    np.testing.assert_allclose(at[1::2], tolerance, rtol=1e-6)
    between = np.linspace(design.omega[0], design.omega[-1], 2001)
    if design.omega[-1] < 10.0:  # the grid resolves the maxima
        shares = impulses.residual_vibration(between, np.full_like(between, damping))
        assert shares.max() <= tolerance * (1.0 + 1e-6)


def test_undamped_extra_insensitive_shapers_are_the_published_ones() -> None:
    v = 0.05
    ei = design_shaper(ShaperKind.EI, 1.0, 0.0, v).impulses
    # Singhose, Seering and Singer, J. Mech. Des. 116, 1994
    np.testing.assert_allclose(ei.amplitudes, [(1 + v) / 4, (1 - v) / 2, (1 + v) / 4], rtol=1e-12)
    two_hump = design_shaper(ShaperKind.TWO_HUMP_EI, 1.0, 0.0, v).impulses
    # Singhose, Porter, Tuttle and Singer, J. Dyn. Sys. Meas. Control 119, 1997
    x = np.cbrt(v**2 * (np.sqrt(1 - v**2) + 1))
    first = (3 * x**2 + 2 * x + 3 * v**2) / (16 * x)
    np.testing.assert_allclose(
        two_hump.amplitudes, [first, 0.5 - first, 0.5 - first, first], rtol=1e-12
    )


def test_insensitivity_without_damping_is_analytic() -> None:
    x2, x3 = (np.cosh(np.arccosh(20.0) / n) for n in (2, 3))
    expected = {  # V = |cos(pi r / 2)|, ZVD its square, EI its Chebyshev polynomials
        ShaperKind.ZV: 4.0 / np.pi * np.arcsin(0.05),
        ShaperKind.ZVD: 4.0 / np.pi * np.arcsin(np.sqrt(0.05)),
        ShaperKind.EI: 4.0 / np.pi * np.arcsin(1.0 / x2),
        ShaperKind.TWO_HUMP_EI: 4.0 / np.pi * np.arcsin(1.0 / x3),
    }
    for kind, width in expected.items():
        assert insensitivity(kind, 0.0) == pytest.approx(width, abs=2e-4)  # two grid steps


@pytest.mark.parametrize("damping", [0.0, 0.02, 0.1])
def test_insensitivity_orders_the_kinds(damping: float) -> None:
    widths = [insensitivity(kind, damping) for kind in ALL_KINDS]
    assert widths == sorted(widths)
    assert len(set(widths)) == len(widths)


@settings(deadline=None, max_examples=60)
@given(kinds, st.floats(0.05, 2.8), dampings, detunings)
def test_simulated_mode_vibrates_as_computed(
    kind: ShaperKind, step: float, damping: float, detuning: float
) -> None:
    sampled = design_shaper(kind, step / PERIOD, damping).sample(PERIOD)
    omega = detuning * step / PERIOD
    simulated = simulated_vibration(sampled.amplitudes, PERIOD, omega, damping)
    # rounding of the recursion over up to 400 samples
    assert vibration_of(sampled, omega, damping) == pytest.approx(simulated, abs=1e-10)


@pytest.mark.parametrize("kind", ALL_KINDS)
def test_sampling_converges_with_the_square_of_the_period(kind: ShaperKind) -> None:
    shaper = design_shaper(kind, 10.0, 0.05)
    exact = shaper.impulses
    omega, damping = np.linspace(7.0, 13.0, 61), np.full(61, 0.05)

    def errors(period: float) -> list[float]:
        # times of impulses lie between samples differently for each of the periods
        sampled = [shaper.sample(period * f) for f in np.linspace(0.9, 1.1, 21)]
        shares = exact.residual_vibration(omega, damping)
        decay = [  # the last sample is up to a period later than the last impulse
            np.exp(damping * omega * (s.duration - exact.duration)) for s in sampled
        ]
        both = zip(sampled, decay, strict=True)
        return [
            max(
                float(np.abs(s.residual_vibration(omega, damping) * d - shares).max())
                for s, d in both
            ),
        ]

    orders = np.log10(np.array(errors(1e-2)) / np.array(errors(1e-3)))
    assert (orders > 1.7).all()


def test_convolved_shapers_multiply_their_vibrations() -> None:
    slow = design_shaper(ShaperKind.EI, 40.0, 0.02).sample(PERIOD)
    fast = design_shaper(ShaperKind.ZV, 95.0, 0.05).sample(PERIOD)
    weights = np.convolve(slow.amplitudes, fast.amplitudes)
    both = Impulses(weights, PERIOD * np.arange(len(weights), dtype=float))
    omega, damping = np.linspace(20.0, 150.0, 50), np.linspace(0.0, 0.2, 50)
    product = slow.residual_vibration(omega, damping) * fast.residual_vibration(omega, damping)
    np.testing.assert_allclose(both.residual_vibration(omega, damping), product, atol=1e-14)


def test_extra_insensitive_shapers_need_a_slow_decay() -> None:
    assert has_design(ShaperKind.TWO_HUMP_EI, 0.4, 0.05)
    assert not has_design(ShaperKind.TWO_HUMP_EI, 0.6, 0.05)
    with pytest.raises(InvalidInput, match=r"no two-hump EI shaper .* damping ratio of 0\.6"):
        design_shaper(ShaperKind.TWO_HUMP_EI, 1.0, 0.6)
    assert design_shaper(ShaperKind.ZVD, 1.0, 0.6).impulses.duration > 0.0
