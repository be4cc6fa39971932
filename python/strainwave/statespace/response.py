"""Frequency responses of models, with their uncertainty."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from strainwave.domain import ContinuousStateSpace, FloatArray, FrequencyResponse, StateSpace
from strainwave.errors import InvalidInput

ComplexArray = NDArray[np.complex128]


def frequency_response(
    model: StateSpace | ContinuousStateSpace, frequencies_hz: FloatArray
) -> FrequencyResponse:
    """C (z I - A)^-1 B + D, z = exp(j w T) for a sampled model and j w for a continuous-time one.

    A sampled model's response is that from sampled inputs, their hold included.

    `frequencies_hz` (n_frequencies,): For a sampled model, up to the Nyquist frequency.

    Returns: With the covariance of real and imaginary parts, by the delta method, if the model has
    one.

    Raises `InvalidInput`: frequencies of the wrong shape, negative, not finite or beyond the
    Nyquist frequency.
    """
    frequencies = np.asarray(frequencies_hz, dtype=np.float64)
    _check(frequencies, model)
    z = 2j * np.pi * frequencies
    if isinstance(model, StateSpace):
        z = np.exp(z * model.sample_time)
    n = model.order
    resolvent = np.linalg.inv(z[:, None, None] * np.eye(n) - model.A)
    states = resolvent @ model.B  # (n_frequencies, n, m)
    outputs = model.C @ resolvent  # (n_frequencies, p, n)
    covariance = None
    if model.covariance is not None:
        covariance = _covariance(states, outputs, model.covariance)
    return FrequencyResponse(frequencies, model.C @ states + model.D, covariance)


def _covariance(states: ComplexArray, outputs: ComplexArray, covariance: FloatArray) -> FloatArray:
    """Of real and imaginary part: (n_frequencies, p, m, 2, 2).

    dG = outputs (dA states + dB) + dC states + dD, entry by entry.
    """
    count, n, m = states.shape
    p = outputs.shape[1]
    J = np.zeros((count, p, m, len(covariance)), dtype=np.complex128)  # columns of K stay zero
    through = np.einsum("foj,fki->foijk", outputs, states)
    J[..., : n * n] = through.reshape(count, p, m, n * n)
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
