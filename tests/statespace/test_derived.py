"""Quantities derived from a model: continuous time, frequency responses, modes, covariances."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from strainwave.domain import FloatArray, StateSpace
from strainwave.errors import InvalidInput, NotIdentifiable
from strainwave.statespace import frequency_response, modes, pem, propagate, to_continuous
from strainwave.statespace._scaled import ModelMatrices
from two_inertia import SAMPLE_TIME, TwoInertia, excitation, simulate, state_space

ARM = TwoInertia()
GAIN = np.array([[0.0, 1e-3], [0.3, 0.5], [0.001, 0.3]])
NOISE = np.array([0.3, 0.005])


def fitted(seed: int = 0, samples: int = 1000) -> StateSpace:
    rng = np.random.default_rng(seed)
    noise = NOISE * rng.standard_normal((samples, 2))
    return pem(simulate(ARM.sampled(GAIN), excitation(rng, samples), noise), 3)


def transformed(model: StateSpace, T: FloatArray) -> StateSpace:
    """Model with the state T x and the correspondingly transformed covariance."""
    matrices = ModelMatrices(model.A, model.B, model.C, model.D, model.K, model.initial_states)
    changed = matrices.transformed(T)
    inverse = np.linalg.inv(T)
    assert model.covariance is not None
    p, m = model.D.shape
    blocks = [
        np.kron(T, inverse.T),
        np.kron(T, np.eye(m)),
        np.kron(np.eye(p), inverse.T),
        np.eye(p * m),
        np.kron(T, np.eye(p)),
    ]
    size = sum(len(block) for block in blocks)
    jacobian, start = np.zeros((size, size)), 0
    for block in blocks:
        jacobian[start : start + len(block), start : start + len(block)] = block
        start += len(block)
    return replace(
        model,
        A=changed.A,
        B=changed.B,
        C=changed.C,
        K=changed.K,
        covariance=jacobian @ model.covariance @ jacobian.T,
    )


def test_continuous_time_undoes_both_holds() -> None:
    converted, truth = to_continuous(ARM.sampled()), ARM.continuous()
    np.testing.assert_allclose(converted.A, truth.A, rtol=1e-10, atol=1e-9)
    np.testing.assert_allclose(converted.B, truth.B, rtol=1e-10, atol=1e-9)
    np.testing.assert_allclose(converted.D, 0.0, atol=1e-12)


def test_continuous_time_of_coinciding_poles() -> None:
    """Exponential of a Jordan block at -30 / s, which has a single eigenvector."""
    z, T = np.exp(-30.0 * SAMPLE_TIME), SAMPLE_TIME
    A = np.array([[z, z * T], [0.0, z]])
    model = state_space(A, np.ones((2, 1)), np.ones((1, 2)), np.zeros((1, 1)), hold=("zero",))
    np.testing.assert_allclose(
        to_continuous(model).A, [[-30.0, 1.0], [0.0, -30.0]], rtol=1e-6, atol=1e-6
    )


def test_poles_without_a_logarithm_are_refused() -> None:
    for pole in (-0.5, 0.0):
        model = state_space(np.array([[pole]]), np.eye(1), np.eye(1), np.zeros((1, 1)))
        with pytest.raises(NotIdentifiable, match="lower the order"):
            to_continuous(model)


def test_poles_near_the_nyquist_frequency_are_warned_of() -> None:
    angle = 0.9 * np.pi
    A = 0.9 * np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    model = state_space(A, np.ones((2, 1)), np.ones((1, 2)), np.zeros((1, 1)), hold=("zero",))
    assert [warning.code for warning in to_continuous(model).warnings] == ["pole-near-nyquist"]
    assert to_continuous(ARM.sampled()).warnings == ()


def test_modes_are_those_of_the_two_inertias() -> None:
    estimate, anti = modes(ARM.sampled(), 0, 0), ARM.anti_resonance()
    assert estimate.resonance is not None
    assert estimate.anti_resonance is not None
    assert estimate.anti_resonance.value == pytest.approx(anti, rel=1e-9)
    poles = np.linalg.eigvals(ARM.continuous().A)
    assert estimate.resonance.value == pytest.approx(poles[np.argmax(poles.imag)], rel=1e-9)
    assert [mode.oscillates for mode in estimate.poles] == [False, True]
    # From the motor to the link, gear damping adds one zero at -k / d_G.
    motor_to_link = modes(ARM.sampled(), 0, 1)
    assert motor_to_link.anti_resonance is None
    assert motor_to_link.zeros[0].value == pytest.approx(
        -ARM.gear_stiffness / ARM.gear_damping, rel=1e-6
    )
    assert modes(ARM.continuous(), 0, 1).zeros[0].value == pytest.approx(
        motor_to_link.zeros[0].value, rel=1e-6
    )


def test_response_of_slow_samples_is_that_of_continuous_time() -> None:
    """Far below the sampling rate, a hold delays by half a sampling period: a phase of w T / 2."""
    f = np.array([0.5, 2.0])
    sampled = frequency_response(ARM.sampled(), f).response[:, :, 0]
    exact = frequency_response(ARM.continuous(), f).response[:, :, 0]
    delay = np.exp(-0.5j * 2.0 * np.pi * f * SAMPLE_TIME)[:, None]
    # Remainder: sinc of the hold, 1 - (w T)^2 / 24, and aliases: 1e-5.
    np.testing.assert_allclose(sampled, exact * delay, rtol=1e-4)


def test_results_are_independent_of_state_coordinates() -> None:
    model = fitted()
    T = np.random.default_rng(2).standard_normal((3, 3))
    changed_model = transformed(model, T)
    f = np.linspace(1.0, 450.0, 30)
    reference, changed = frequency_response(model, f), frequency_response(changed_model, f)
    np.testing.assert_allclose(changed.response, reference.response, rtol=1e-8)
    assert reference.magnitude_std is not None
    assert changed.magnitude_std is not None
    np.testing.assert_allclose(changed.magnitude_std, reference.magnitude_std, rtol=1e-5)
    for expected, got in zip(
        modes(model, 0, 0).poles, modes(changed_model, 0, 0).poles, strict=True
    ):
        assert got.frequency_hz == pytest.approx(expected.frequency_hz, rel=1e-8)
        assert got.frequency_std_hz == pytest.approx(expected.frequency_std_hz, rel=1e-3)


def test_two_ways_to_the_deviation_of_a_response_agree() -> None:
    """Exact derivatives agree with central differences."""
    model, f = fitted(), np.array([5.0, 12.0, 20.0, 100.0])
    exact = frequency_response(model, f)
    assert exact.magnitude_std is not None
    assert exact.phase_std is not None
    values, covariance = propagate(
        model, lambda near: np.abs(frequency_response(replace(near), f).response).ravel()
    )
    assert covariance is not None
    np.testing.assert_allclose(values, np.abs(exact.response).ravel())
    np.testing.assert_allclose(np.sqrt(np.diag(covariance)), exact.magnitude_std.ravel(), rtol=1e-3)


def test_deviations_of_modes_are_honest() -> None:
    from scipy.stats import chi2

    truth, total, seeds = ARM.anti_resonance(), 0.0, 20
    for seed in range(seeds):
        zero = modes(fitted(seed, 600), 0, 0).anti_resonance
        assert zero is not None
        assert zero.frequency_std_hz is not None
        total += ((zero.frequency_hz - abs(truth) / (2.0 * np.pi)) / zero.frequency_std_hz) ** 2
    assert 1e-3 < chi2.sf(total, seeds) < 1.0 - 1e-3


def test_without_a_covariance_there_is_no_deviation() -> None:
    model = ARM.sampled()
    assert to_continuous(model).covariance is None
    assert frequency_response(model, np.ones(1)).magnitude_std is None
    assert modes(model, 0, 0).poles[0].frequency_std_hz is None
    assert propagate(model, lambda near: near.A.ravel())[1] is None


def test_invalid_indices_and_frequencies_are_refused() -> None:
    model = ARM.sampled()
    with pytest.raises(InvalidInput, match="expected input from 0 to 1, got 2"):
        modes(model, 2, 0)
    with pytest.raises(InvalidInput, match="expected output from 0 to 1, got -1"):
        modes(model, 0, -1)
    with pytest.raises(InvalidInput, match="half the sample rate"):
        frequency_response(model, np.array([600.0]))
    with pytest.raises(InvalidInput, match="from 0 Hz up"):
        frequency_response(model, np.array([-1.0]))
    with pytest.raises(InvalidInput, match="frequencies of shape"):
        frequency_response(model, np.ones((2, 2)))
