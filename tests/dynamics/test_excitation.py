from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.signal import max_len_seq

from strainwave.domain import FloatArray, Prbs
from strainwave.dynamics import excitation
from strainwave.errors import InvalidInput


@given(order=st.integers(2, 12), amplitude=st.floats(0.1, 100.0))
def test_prbs_has_the_autocorrelation_of_a_maximum_length_sequence(
    order: int, amplitude: float
) -> None:
    one = excitation.prbs(Prbs(order, 1e-3, 1, amplitude)) / amplitude
    n = 2**order - 1
    correlation = np.fft.ifft(np.abs(np.fft.fft(one)) ** 2).real
    # Golomb: n at lag 0 and -1 at all other lags; the rounding error of the FFT is 1e-16 n
    expected = np.full(n, -1.0)
    expected[0] = n
    np.testing.assert_allclose(correlation, expected, atol=1e-11 * n)


@pytest.mark.parametrize("order", range(2, 18))
def test_prbs_matches_scipy(order: int) -> None:
    bits, _ = max_len_seq(order)
    one = excitation.prbs(Prbs(order, 1e-3, 1, 1.0))
    np.testing.assert_array_equal(one, 2.0 * bits - 1.0)


def test_prbs_repeats_its_period() -> None:
    u = excitation.prbs(Prbs(6, 1e-3, 3, 2.0))
    assert u.shape == (3 * 63,)
    np.testing.assert_array_equal(u[:63], u[63:126])


def test_prbs_rejects_unsupported_orders() -> None:
    with pytest.raises(InvalidInput, match="order 40"):
        excitation.prbs(Prbs(40, 1e-3, 1, 1.0))


def test_multisine_has_a_flat_line_spectrum() -> None:
    lines = np.array([3, 5, 8, 13])
    u = excitation.multisine(lines, period=0.5, clock=1e-3, periods=2, peak=4.0)
    spectrum = np.abs(np.fft.rfft(u[:500]))
    assert np.abs(u).max() == pytest.approx(4.0)
    np.testing.assert_allclose(spectrum[lines], spectrum[lines].mean(), rtol=1e-12)
    rest = np.delete(spectrum, lines)
    assert rest.max() < 1e-10 * spectrum.max()


def test_schroeder_phases_give_a_low_crest_factor() -> None:
    u = excitation.multisine(np.arange(1.0, 101.0), period=1.0, clock=1e-3, periods=1, peak=1.0)
    crest = np.abs(u).max() / np.sqrt(np.mean(u**2))
    assert crest < 2.0  # about 1.7 for Schroeder phases, 14 for equal phases


@pytest.mark.parametrize(
    ("lines", "period"), [([0, 3], 0.5), ([3, 250], 0.5), ([3], 0.50037), ([], 0.5)]
)
def test_multisine_rejects_invalid_lines_and_periods(lines: list[int], period: float) -> None:
    with pytest.raises(InvalidInput):
        excitation.multisine(np.array(lines), period=period, clock=1e-3, periods=1, peak=1.0)


def test_steps_hold_their_levels() -> None:
    np.testing.assert_array_equal(
        excitation.steps(np.array([0.0, 2.0]), hold=0.003, clock=0.001), [0, 0, 0, 2, 2, 2]
    )


def test_chirp_crosses_zero_at_half_turns_of_its_phase() -> None:
    start, stop, duration, clock = 1.0, 100.0, 4.0, 1e-3
    u = excitation.chirp(start_hz=start, stop_hz=stop, duration=duration, clock=clock, peak=2.0)
    crossings = clock * np.flatnonzero(np.diff(np.signbit(u)))
    # phase 2 pi f0 (r^t - 1) / ln r with r = (f1/f0)^(1/T)
    rate = np.log(stop / start) / duration
    half_turns = np.arange(1, crossings.size + 1)
    expected = np.log1p(half_turns * rate / (2.0 * start)) / rate
    np.testing.assert_allclose(crossings[-20:], expected[-20:], atol=clock)
    assert u[0] == pytest.approx(0.0, abs=1e-12)
    assert np.abs(u).max() == pytest.approx(2.0, rel=1e-4)


@given(seed=st.integers(0, 1000), speed=st.floats(1.0, 200.0), excursion=st.floats(1.0, 200.0))
def test_smooth_motion_satisfies_its_limits_and_returns(
    seed: int, speed: float, excursion: float
) -> None:
    velocity = excitation.smooth_motion(
        duration=5.0,
        clock=1e-3,
        top_hz=2.0,
        excursion=excursion,
        speed=speed,
        rng=np.random.default_rng(seed),
    )
    angle = np.cumsum(velocity) * 1e-3
    assert np.abs(velocity).max() <= speed * (1 + 1e-12)
    assert np.abs(angle).max() <= excursion * (1 + 1e-12)
    assert abs(angle[-1]) < 1e-9 * excursion
    assert velocity[0] == 0.0
    assert max(np.abs(velocity).max() / speed, np.abs(angle).max() / excursion) > 0.999


def test_optimised_random_phases_give_a_low_crest_factor() -> None:
    lines = np.arange(3.0, 103.0)

    def wave(seed: int) -> FloatArray:
        rng = np.random.default_rng(seed)
        return excitation.multisine(lines, period=1.0, clock=1e-3, periods=1, peak=1.0, rng=rng)

    first, second = wave(0), wave(1)
    spectrum = np.abs(np.fft.rfft(first))
    excited = lines.astype(int)
    np.testing.assert_allclose(spectrum[excited], spectrum[excited].mean(), rtol=1e-12)
    assert np.delete(spectrum, excited).max() < 1e-10 * spectrum.max()
    for u in (first, second):
        assert (
            np.abs(u).max() / u.std() < 1.6
        )  # about 3 for random phases, 1.7 for Schroeder phases
    assert not np.array_equal(first, second)
