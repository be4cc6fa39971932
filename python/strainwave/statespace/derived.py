"""Quantities derived from state-space models, with their uncertainty.

Continuous-time models, frequency responses, poles and zeros; propagation of the covariance to any
function of a model.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from math import factorial
from typing import TypeVar

import numpy as np

from strainwave.domain import (
    STATE_SPACE_MODEL,
    ComplexArray,
    ContinuousStateSpace,
    Diagnostic,
    FloatArray,
    FrequencyResponse,
    Mode,
    Modes,
    StateSpace,
)
from strainwave.errors import InvalidInput, NotIdentifiable
from strainwave.numerics.linalg import exponential

Model = TypeVar("Model", StateSpace, ContinuousStateSpace)

# Step of the central differences, in standard deviations. Their relative error is about the square
# of the step, and the step is far above rounding for data with noise.
DIFFERENCE_STEP_STDS = 0.01

# Relative eigenvalue of the correlation matrix below which a direction is rounding error.
MIN_EIGENVALUE_RATIO = 1e-13

# Fraction of the Nyquist frequency above which a pole may be an alias of a faster pole.
MAX_NYQUIST_SHARE = 0.8

# Largest condition number of the eigenvectors for which the eigendecomposition of A is used. For
# nearly multiple poles, the slower inverse scaling-and-squaring method is used.
MAX_EIGENVECTOR_CONDITION = 1e6

# Coefficients of (e^x - 1 - x)/x^2 = sum of x^k / (k + 2)!, highest power first. The truncation
# error is below rounding for |x| < _SMALL.
_HOLD_SERIES = [1.0 / factorial(k + 2) for k in range(14, -1, -1)]

_MAX_SERIES_ARGUMENT = 0.5


def propagate(
    model: Model, function: Callable[[Model], FloatArray], *, stacked: bool = False
) -> tuple[FloatArray, FloatArray | None]:
    """Value of a function of a model, and its covariance by the delta method.

    P_f = J P J', where J is the derivative of f. Central differences along the principal directions
    of P give J P^(1/2). The covariance has no component along changes of state coordinates, so
    these are not evaluated.

    `function`: Smooth near the model and invariant to changes of state coordinates; returns
        (n_values,).
    `stacked`: The function accepts a stack of models, whose matrices have a leading axis of length
        n_models, and returns (n_models, n_values).

    Returns values (n_values,) and their covariance (n_values, n_values), or None if the model has
    no covariance.
    """
    n_entries = sum(getattr(model, name).size for name in _names(model))
    steps = np.zeros((0, n_entries))
    if model.covariance is not None:
        steps = DIFFERENCE_STEP_STDS * _directions(model.covariance).T
    changes = np.concatenate([np.zeros((1, n_entries)), steps, -steps])
    if stacked:
        values = function(_with_changes(model, changes))
    else:
        values = np.stack([np.atleast_1d(function(_with_changes(model, c))) for c in changes])
    if model.covariance is None:
        return values[0], None
    J = (values[1 : len(steps) + 1] - values[len(steps) + 1 :]).T / (2.0 * DIFFERENCE_STEP_STDS)
    return values[0], J @ J.T


def _directions(covariance: FloatArray) -> FloatArray:
    """Factor S with S S' = covariance, from the eigenvalues of the correlation matrix.

    The correlation matrix is used because the entries have different units.
    """
    std = np.sqrt(np.maximum(np.diagonal(covariance), 0.0))
    nonzero = np.flatnonzero(std > 0.0)
    if not len(nonzero):
        return np.zeros((len(covariance), 0))
    correlation = covariance[np.ix_(nonzero, nonzero)] / np.outer(std[nonzero], std[nonzero])
    values, vectors = np.linalg.eigh(0.5 * (correlation + correlation.T))
    is_significant = values > MIN_EIGENVALUE_RATIO * values[-1]
    factor = np.zeros((len(covariance), int(is_significant.sum())))
    roots = np.sqrt(values[is_significant])
    factor[nonzero] = std[nonzero, None] * vectors[:, is_significant] * roots
    return factor


def _names(model: Model) -> tuple[str, ...]:
    return ("A", "B", "C", "D", "K") if isinstance(model, StateSpace) else ("A", "B", "C", "D")


def _with_changes(model: Model, change: FloatArray) -> Model:
    """Model with one change, or a stack of changes, added to its entries; without covariance."""
    entries, start = {}, 0
    for name in _names(model):
        matrix = getattr(model, name)
        part = change[..., start : start + matrix.size]
        entries[name] = matrix + part.reshape(*change.shape[:-1], *matrix.shape)
        start += matrix.size
    return replace(model, covariance=None, **entries)


def to_continuous(model: StateSpace) -> ContinuousStateSpace:
    """Convert a sampled model to continuous time, with the hold of each input.

    A = log(A_d) / T. P1 is the integral of exp(A s) over one sampling period, and P2 is the
    integral of exp(A (T - s)) s / T. For an input with zero-order hold, B = P1^-1 B_d and D = D_d.
    For an input with first-order hold, B = (A_d P2 + P1 - P2)^-1 B_d and D = D_d - C P2 B.

    The result has a covariance if the model has one. A pole near the Nyquist frequency, which may
    be an alias, gives a warning. Raises `NotIdentifiable` if a pole of the sampled model is zero or
    on the negative real axis: no continuous-time model of the same order exists.
    """
    converted = _convert(model)
    if model.covariance is None:
        return converted
    _, covariance = propagate(model, lambda near: _entries(_convert(near)), stacked=True)
    return replace(converted, covariance=covariance)


def _entries(model: ContinuousStateSpace) -> FloatArray:
    parts = (model.A, model.B, model.C, model.D)
    return np.concatenate([part.reshape(*part.shape[:-2], -1) for part in parts], axis=-1)


def _convert(model: StateSpace) -> ContinuousStateSpace:
    """Conversion without covariance of one model or a stack of models."""
    T = model.sample_time
    A, P1, P2 = _continuous_matrices(model.A, T)
    is_first_order = np.array([hold == "first" for hold in model.hold])
    B = np.asarray(np.linalg.solve(P1, model.B), dtype=np.float64)
    D = model.D.copy()
    if is_first_order.any():
        joined = model.A @ P2 + P1 - P2
        B[..., is_first_order] = np.linalg.solve(joined, model.B[..., is_first_order])
        D[..., is_first_order] -= model.C @ P2 @ B[..., is_first_order]
    warnings: tuple[Diagnostic, ...] = ()
    hz = float(np.abs(np.linalg.eigvals(A).imag).max(initial=0.0)) / (2.0 * np.pi)
    if hz >= MAX_NYQUIST_SHARE * 0.5 / T:
        place = STATE_SPACE_MODEL
        warnings = (Diagnostic("pole-near-nyquist", place, frequency_hz=hz, rate_hz=1.0 / T),)
    return ContinuousStateSpace(
        A=A,
        B=B,
        C=model.C,
        D=D,
        input_names=model.input_names,
        output_names=model.output_names,
        warnings=warnings,
    )


def _continuous_matrices(A: FloatArray, T: float) -> FloatArray:
    """Continuous-time A, and the integrals P1 and P2 of `to_continuous`: (3, ..., n, n).

    A is the real logarithm with the smallest imaginary parts of the eigenvalues.
    """
    values, vectors = np.linalg.eig(A)
    bad = values[(values.imag == 0.0) & (values.real <= 0.0)]
    if len(bad):
        raise NotIdentifiable(
            f"the sampled model has a pole at {bad[0].real:.3g}, which no continuous-time model of "
            "the same order has: lower the order"
        )
    if np.linalg.cond(vectors).max() >= MAX_EIGENVECTOR_CONDITION:
        if A.ndim > 2:
            return np.stack([_continuous_matrices(matrix, T) for matrix in A], axis=1)
        from scipy.linalg import logm

        logarithm = np.ascontiguousarray(np.real(logm(A)), dtype=np.float64) / T
        # both integrals from one block exponential (Van Loan, IEEE Trans. AC 23, 1978)
        n = len(A)
        block = np.zeros((3 * n, 3 * n))
        block[:n, :n] = logarithm * T
        block[:n, n : 2 * n] = np.eye(n) * T
        block[n : 2 * n, 2 * n :] = np.eye(n)
        top = exponential(block)[:n]
        return np.stack([logarithm, top[:, n : 2 * n], top[:, 2 * n :]])
    x = np.log(values.astype(complex))
    # the closed form loses digits for small x, so the series is used there
    small = np.abs(x) < _MAX_SERIES_ARGUMENT
    series = np.polyval(_HOLD_SERIES, x)
    nonzero = np.where(small, 1.0, x)
    second = np.where(small, series, (np.exp(nonzero) - 1.0 - nonzero) / nonzero**2)
    inverse = np.linalg.inv(vectors)
    functions = np.stack([x / T, T * (1.0 + x * second), T * second])
    return np.real((vectors * functions[..., None, :]) @ inverse)


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
