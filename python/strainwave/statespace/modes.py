"""Poles and zeros: the resonances and anti-resonances of a joint."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from strainwave.domain import ContinuousStateSpace, FloatArray, Mode, Modes, StateSpace
from strainwave.errors import InvalidInput
from strainwave.statespace.continuous import to_continuous
from strainwave.statespace.propagation import propagate

ComplexArray = NDArray[np.complex128]

# Zeros beyond this multiple of the fastest pole are those at infinity, moved there by rounding and
# by noise in a feedthrough.
FAR = 100.0

# Where the pencil of the zeros is inverted, over the fastest pole: on the unstable real axis, at
# no round number, for a zero just there would make it singular.
_ASIDE = 0.7320508


def modes(model: StateSpace | ContinuousStateSpace, input: int, output: int) -> Modes:
    """Poles of a model and zeros from one input to one output, in continuous time.

    Zeros are the s for which [[A - s I, b], [c, d]] is singular.

    `model`: A sampled one is converted by `to_continuous`.
    `input, output`: Columns, from 0.

    Returns: Standard deviations by the delta method, if the model has a covariance. Zeros that are
    far above the poles, and for a sampled model those beyond the Nyquist frequency, are left out:
    the data say nothing about them.

    Raises `InvalidInput`: no such input or output; `NotIdentifiable`: as `to_continuous`.
    """
    for name, index, count in (
        ("input", input, model.B.shape[1]),
        ("output", output, len(model.C)),
    ):
        if not 0 <= index < count:
            raise InvalidInput(f"expected {name} from 0 to {count - 1}, got {index}")
    found = to_continuous(model) if isinstance(model, StateSpace) else model
    poles = _poles(found)
    zeros = _zeros(found, input, output)
    highest = FAR * float(np.abs(poles).max())
    if isinstance(model, StateSpace):
        highest = min(highest, np.pi / model.sample_time)
    poles, zeros = _upper_half(poles), _upper_half(zeros[np.abs(zeros) < highest])
    known = np.concatenate([poles, zeros])

    def shapes(near: ContinuousStateSpace) -> FloatArray:
        of_zeros = nearest(zeros, _zeros(near, input, output))
        values = np.concatenate([nearest(poles, _poles(near)), of_zeros], axis=-1)
        return np.concatenate([_frequency_hz(values), _damping(values)], axis=-1)

    values, std = np.concatenate([_frequency_hz(known), _damping(known)]), None
    if found.covariance is not None:
        _, covariance = propagate(found, shapes, stacked=True)
        std = np.sqrt(np.maximum(np.diagonal(np.asarray(covariance)), 0.0))
    count = len(known)
    each = tuple(
        Mode(
            value=complex(value),
            frequency_hz=float(values[i]),
            damping=float(values[count + i]),
            frequency_std_hz=None if std is None else float(std[i]),
            damping_std=None if std is None else float(std[count + i]),
        )
        for i, value in enumerate(known)
    )
    of_poles, of_zeros = each[: len(poles)], each[len(poles) :]
    return Modes(of_poles, of_zeros, _least_damped(of_poles), _least_damped(of_zeros))


def _poles(model: ContinuousStateSpace) -> ComplexArray:
    return np.linalg.eigvals(model.A).astype(np.complex128)


def _zeros(model: ContinuousStateSpace, input: int, output: int) -> ComplexArray:
    """Zeros of one channel; those at infinity are infinite."""
    n = model.A.shape[-1]
    b, c = model.B[..., :, [input]], model.C[..., [output], :]
    # Rows and columns of like size: units of the channels must not decide what is infinite.
    fastest = np.abs(np.linalg.eigvals(model.A)).max(axis=-1)[..., None, None]
    size = np.maximum(fastest, np.finfo(float).tiny)
    b_size, c_size = (np.linalg.norm(x, axis=(-2, -1), keepdims=True) for x in (b, c))
    b_size, c_size = (np.where(x > 0.0, x, 1.0) for x in (b_size, c_size))
    d = model.D[..., [output], :][..., [input]] * size / (b_size * c_size)
    M = np.block([[model.A / size, b / b_size], [c / c_size, d]])
    N = np.zeros((n + 1, n + 1))
    N[:n, :n] = np.eye(n)
    # (M - s N) v = 0 is (M - a N)^-1 N v = v / (s - a): zeros at infinity become zero
    right = np.broadcast_to(N, M.shape)
    inverse = np.linalg.eigvals(np.linalg.solve(M - _ASIDE * N, right)).astype(np.complex128)
    finite = np.abs(inverse) > 1e-12
    found = size[..., 0] * (_ASIDE + 1.0 / np.where(finite, inverse, 1.0))
    return np.where(finite, found, np.inf)


def poles_and_zeros(
    model: ContinuousStateSpace, input: int, output: int
) -> tuple[ComplexArray, ComplexArray]:
    """Poles, and zeros from one input to one output, of a model or of a stack of them.

    `input, output`: Columns, from 0.

    Returns: `zeros`: Those at infinity are infinite.
    """
    return _poles(model), _zeros(model, input, output)


def _upper_half(values: ComplexArray) -> ComplexArray:
    """One of each conjugate pair, by frequency; an imaginary part of rounding size is none."""
    real = np.abs(values.imag) <= 1e-12 * np.abs(values)
    values = np.where(real, values.real, values)
    values = values[values.imag >= 0.0]
    return np.asarray(values[np.argsort(np.abs(values))], dtype=np.complex128)


def nearest(values: ComplexArray, others: ComplexArray) -> ComplexArray:
    """For each value, the one that is nearest to it of others, or of each row of others.

    `values` (n_values,).
    """
    distances = np.abs(values[:, None] - others[..., None, :])
    place = np.argmin(distances, axis=-1)
    return np.asarray(np.take_along_axis(others, place, axis=-1), dtype=np.complex128)


def _frequency_hz(values: ComplexArray) -> FloatArray:
    return np.abs(values) / (2.0 * np.pi)


def _damping(values: ComplexArray) -> FloatArray:
    moduli = np.abs(values)
    return np.where(moduli > 0.0, -values.real / np.where(moduli > 0.0, moduli, 1.0), 1.0)


def _least_damped(found: tuple[Mode, ...]) -> Mode | None:
    pairs = [mode for mode in found if mode.oscillates]
    return min(pairs, key=lambda mode: abs(mode.damping)) if pairs else None
