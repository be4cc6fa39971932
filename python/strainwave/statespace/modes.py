"""Frequency responses, poles and zeros of state-space models, with their uncertainty."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from strainwave.domain import (
    ComplexArray,
    ContinuousStateSpace,
    FloatArray,
    FrequencyResponse,
    Mode,
    Modes,
    StateSpace,
)
from strainwave.errors import InvalidInput
from strainwave.statespace.continuous import propagate, to_continuous

# Zeros above this multiple of the fastest pole count as zeros at infinity, which rounding and noise
# in D make finite.
MAX_ZERO_TO_POLE = 100.0

# Shift of the inverted pencil, relative to the fastest pole. A shift on the unstable real axis that
# is not a round number is unlikely to coincide with a zero.
_PENCIL_SHIFT = 0.7320508


def modes(model: StateSpace | ContinuousStateSpace, input: int, output: int) -> Modes:
    """Poles, and zeros from one input to one output, in continuous time.

    Zeros are the s for which [[A - s I, b], [c, d]] is singular. `to_continuous` converts a sampled
    model. The result has standard deviations by the delta method if the model has a covariance.
    Zeros far above the poles are omitted, and for a sampled model those above the Nyquist
    frequency: the data do not determine them.

    `input, output`: Columns, from 0.

    Raises `InvalidInput` if the input or output does not exist, and `NotIdentifiable` like
    `to_continuous`.
    """
    columns = (("input", input, model.B.shape[1]), ("output", output, len(model.C)))
    for name, index, count in columns:
        if not 0 <= index < count:
            raise InvalidInput(f"expected {name} from 0 to {count - 1}, got {index}")
    continuous = to_continuous(model) if isinstance(model, StateSpace) else model
    poles = _poles(continuous)
    zeros = _zeros(continuous, input, output)
    highest = MAX_ZERO_TO_POLE * float(np.abs(poles).max())
    if isinstance(model, StateSpace):
        highest = min(highest, np.pi / model.sample_time)
    poles, zeros = _upper_half(poles), _upper_half(zeros[np.abs(zeros) < highest])
    values = np.concatenate([poles, zeros])

    def shapes(near: ContinuousStateSpace) -> FloatArray:
        of_zeros = nearest(zeros, _zeros(near, input, output))
        return _shapes(np.concatenate([nearest(poles, _poles(near)), of_zeros], axis=-1))

    # rows: frequency and damping, columns: poles and zeros
    numbers = _shapes(values).reshape(2, -1).tolist()
    stds: list[list[float | None]] = [[None] * len(values)] * 2
    if continuous.covariance is not None:
        _, covariance = propagate(continuous, shapes, stacked=True)
        variance = np.maximum(np.diagonal(np.asarray(covariance)), 0.0)
        stds = np.sqrt(variance).reshape(2, -1).tolist()
    all_modes = tuple(map(Mode, values.tolist(), *numbers, *stds))
    of_poles, of_zeros = all_modes[: len(poles)], all_modes[len(poles) :]
    return Modes(of_poles, of_zeros, _least_damped(of_poles), _least_damped(of_zeros))


def _poles(model: ContinuousStateSpace) -> ComplexArray:
    return np.linalg.eigvals(model.A).astype(np.complex128)


def _zeros(model: ContinuousStateSpace, input: int, output: int) -> ComplexArray:
    """Zeros from one input to one output; zeros at infinity are infinite."""
    n = model.A.shape[-1]
    b, c = model.B[..., :, [input]], model.C[..., [output], :]
    # Scale rows and columns, so that the channel units do not affect which zeros are infinite.
    fastest = np.abs(np.linalg.eigvals(model.A)).max(axis=-1)[..., None, None]
    size = np.maximum(fastest, np.finfo(float).tiny)
    b_size, c_size = (np.linalg.norm(x, axis=(-2, -1), keepdims=True) for x in (b, c))
    b_size, c_size = (np.where(x > 0.0, x, 1.0) for x in (b_size, c_size))
    d = model.D[..., [output], :][..., [input]] * size / (b_size * c_size)
    M = np.block([[model.A / size, b / b_size], [c / c_size, d]])
    N = np.zeros((n + 1, n + 1))
    N[:n, :n] = np.eye(n)
    # (M - s N) v = 0 is equivalent to (M - a N)^-1 N v = v / (s - a); infinite zeros become zero
    right = np.broadcast_to(N, M.shape)
    inverses = np.linalg.eigvals(np.linalg.solve(M - _PENCIL_SHIFT * N, right)).astype(complex)
    finite = np.abs(inverses) > 1e-12
    zeros = size[..., 0] * (_PENCIL_SHIFT + 1.0 / np.where(finite, inverses, 1.0))
    return np.where(finite, zeros, np.inf)


def poles_and_zeros(
    model: ContinuousStateSpace, input: int, output: int
) -> tuple[ComplexArray, ComplexArray]:
    """Poles, and zeros from one input to one output, of a model or a stack of models.

    `input, output`: Columns, from 0. Zeros at infinity are infinite.
    """
    return _poles(model), _zeros(model, input, output)


def _upper_half(values: ComplexArray) -> ComplexArray:
    """One value of each conjugate pair, sorted by modulus; rounded imaginary parts are removed."""
    real = np.abs(values.imag) <= 1e-12 * np.abs(values)
    values = np.where(real, values.real, values)
    values = values[values.imag >= 0.0]
    return np.asarray(values[np.argsort(np.abs(values))], dtype=np.complex128)


def nearest(values: ComplexArray, others: ComplexArray) -> ComplexArray:
    """For each value, the nearest of `others`, or of each row of `others`.

    `values` (n_values,).
    """
    distances = np.abs(values[:, None] - others[..., None, :])
    indices = np.argmin(distances, axis=-1)
    return np.asarray(np.take_along_axis(others, indices, axis=-1), dtype=np.complex128)


def _shapes(values: ComplexArray) -> FloatArray:
    """Frequencies [Hz], then damping ratios, along the last axis."""
    moduli = np.abs(values)
    damping = np.where(moduli > 0.0, -values.real / np.where(moduli > 0.0, moduli, 1.0), 1.0)
    return np.concatenate([moduli / (2.0 * np.pi), damping], axis=-1)


def _least_damped(candidates: tuple[Mode, ...]) -> Mode | None:
    pairs = [mode for mode in candidates if mode.oscillates]
    return min(pairs, key=lambda mode: abs(mode.damping)) if pairs else None


def remove_alternating_poles(model: StateSpace) -> StateSpace:
    """Remove poles on the negative real axis, which have no continuous-time equivalent.

    Such a pole alternates in sign from sample to sample and models the edge of the band, at
    Nyquist. Within the band it is a constant gain, which is added to D. The covariance is
    propagated. Returns the model itself if it has no such pole.
    """
    values, vectors = np.linalg.eig(model.A)
    alternating = np.flatnonzero((values.imag == 0.0) & (values.real <= 0.0))
    if not len(alternating) or len(alternating) == model.order:
        return model
    z, w = float(values[alternating[0]].real), np.linalg.inv(vectors)[alternating[0]].real
    # w'A = z w': `complement` is the invariant subspace
    complement = np.linalg.svd(w[None])[2][1:].T
    reduced = _without(z, complement, model)

    def entries(near: StateSpace) -> FloatArray:
        other = _without(z, complement, near)
        return np.concatenate([np.ravel(m) for m in (other.A, other.B, other.C, other.D, other.K)])

    if model.covariance is not None:
        reduced = replace(reduced, covariance=propagate(model, entries)[1])
    return remove_alternating_poles(reduced)


def _without(z: float, others: FloatArray, model: StateSpace) -> StateSpace:
    """Remove the pole nearest to z, in the basis `others` projected along that pole's eigenvector.

    The basis is a smooth function of the model, as `propagate` requires.
    """
    values, vectors = np.linalg.eig(model.A)
    index = int(np.argmin(np.abs(values - z)))
    pole, v, w = values[index].real, vectors[:, index].real, np.linalg.inv(vectors)[index].real
    basis = others - np.outer(v, w @ others)
    projection = np.linalg.inv(np.column_stack([basis, v]))[:-1]
    return replace(
        model,
        A=projection @ model.A @ basis,
        B=projection @ model.B,
        C=model.C @ basis,
        D=model.D + np.outer(model.C @ v, w @ model.B) / (1.0 - pole),
        K=projection @ model.K,
        initial_states=model.initial_states @ projection.T,
        covariance=None,
    )


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
