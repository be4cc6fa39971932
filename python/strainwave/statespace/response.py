"""Frequency responses of state-space models with their uncertainty."""

from __future__ import annotations

import numpy as np

from strainwave.domain import (
    ComplexArray,
    ContinuousStateSpace,
    FloatArray,
    FrequencyResponse,
    StateSpace,
)
from strainwave.errors import InvalidInput


def frequency_response(
    model: StateSpace | ContinuousStateSpace, frequencies_hz: FloatArray
) -> FrequencyResponse:
    """Frequency response C (z I - A)^-1 B + D of a model.

    z = exp(j w T) for a sampled model and z = j w for a continuous-time model. The response of a
    sampled model includes the hold of its inputs. If the model has a covariance, the result has the
    covariance of real and imaginary parts by the delta method.

    `frequencies_hz` (n_frequencies,) [Hz]: At most the Nyquist frequency for a sampled model.

    Raises `InvalidInput` if the frequencies have a wrong shape, are negative or not finite, or
    exceed the Nyquist frequency.
    """
    frequencies = np.asarray(frequencies_hz, dtype=np.float64)
    _check(frequencies, model)
    z = 2j * np.pi * frequencies
    if isinstance(model, StateSpace):
        z = np.exp(z * model.sample_time)
    n = model.order
    resolvent = np.linalg.inv(z[:, None, None] * np.eye(n) - model.A)
    input_to_state = resolvent @ model.B  # (n_frequencies, n, m)
    state_to_output = model.C @ resolvent  # (n_frequencies, p, n)
    covariance = None
    if model.covariance is not None:
        covariance = _covariance(input_to_state, state_to_output, model.covariance)
    return FrequencyResponse(frequencies, model.C @ input_to_state + model.D, covariance)


def _covariance(states: ComplexArray, outputs: ComplexArray, covariance: FloatArray) -> FloatArray:
    """Covariance of real and imaginary parts: (n_frequencies, p, m, 2, 2).

    dG = outputs (dA states + dB) + dC states + dD, entry by entry.
    """
    count, n, m = states.shape
    p = outputs.shape[1]
    J = np.zeros((count, p, m, len(covariance)), dtype=np.complex128)  # the columns of K stay zero
    of_A = np.einsum("foj,fki->foijk", outputs, states)
    J[..., : n * n] = of_A.reshape(count, p, m, n * n)
    start_c = n * (n + m)
    for i in range(m):
        J[:, :, i, n * n + i : start_c : m] = outputs
        for o in range(p):
            J[:, o, i, start_c + o * n : start_c + (o + 1) * n] = states[:, :, i]
            J[:, o, i, start_c + p * n + o * m + i] = 1.0
    parts = np.stack([J.real, J.imag], axis=-2)
    return np.asarray(parts @ covariance @ np.swapaxes(parts, -1, -2))


def _check(frequencies: FloatArray, model: StateSpace | ContinuousStateSpace) -> None:
    if frequencies.ndim != 1:
        raise InvalidInput(f"expected frequencies of shape (n,), got {frequencies.shape}")
    if not (np.isfinite(frequencies).all() and (frequencies >= 0.0).all()):
        raise InvalidInput("expected finite frequencies from 0 Hz up")
    if isinstance(model, StateSpace):
        nyquist = 0.5 / model.sample_time
        highest = float(frequencies.max(initial=0.0))
        if highest > nyquist * (1.0 + 1e-9):
            raise InvalidInput(
                f"expected frequencies up to {nyquist:.6g} Hz, half the sample rate, "
                f"got {highest:.6g} Hz"
            )
