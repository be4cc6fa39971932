"""Records and models of scaled channels, as the compiled core takes them.

Validation, stacking and scaling of input-output records; state-space matrices, their packing into
one vector, state transformations, and gains of the predictor.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from strainwave import _core
from strainwave.domain import FloatArray, Hold, InputOutput
from strainwave.errors import InvalidInput

Data = InputOutput | Sequence[InputOutput]


@dataclass(frozen=True, slots=True)
class Stack:
    """Stacked records, each channel divided by its root mean square."""

    samples: FloatArray  # (n_samples, n_inputs + n_outputs): inputs and outputs, scaled
    lengths: tuple[int, ...]
    input_scale: FloatArray  # (n_inputs,)
    output_scale: FloatArray  # (n_outputs,)
    sample_time: float
    hold: tuple[Hold, ...]
    input_names: tuple[str, ...]
    output_names: tuple[str, ...]

    @property
    def n_samples(self) -> int:
        return len(self.samples)

    @property
    def n_inputs(self) -> int:
        return len(self.input_scale)

    @property
    def n_outputs(self) -> int:
        return len(self.output_scale)

    @property
    def inputs(self) -> FloatArray:
        return self.samples[:, : self.n_inputs]

    @property
    def outputs(self) -> FloatArray:
        return self.samples[:, self.n_inputs :]

    def rows(self) -> list[slice]:
        """Slice of each record in the stacked samples."""
        stops = np.cumsum(self.lengths)
        return [slice(stop - n, stop) for n, stop in zip(self.lengths, stops, strict=True)]


def records_of(data: Data) -> tuple[InputOutput, ...]:
    """Tuple of records from one record or a sequence."""
    return (data,) if isinstance(data, InputOutput) else tuple(data)


def stack(data: Data) -> Stack:
    """Check records and stack them.

    Raises `InvalidInput` if there is no record, if shapes are inconsistent, or if entries are not
    finite.
    """
    records = records_of(data)
    if not records:
        raise InvalidInput("expected at least one record, got none")
    first = records[0]
    for index, record in enumerate(records, start=1):
        _check(record, f"record {index}")
        _check_same(record, first, f"record {index}")
    n_inputs, n_outputs = first.inputs.shape[1], first.outputs.shape[1]
    lengths = tuple(len(record.inputs) for record in records)
    samples, scale = np.empty((sum(lengths), n_inputs + n_outputs)), np.ones(n_inputs + n_outputs)
    for signals, begin in (
        ([record.inputs for record in records], 0),
        ([record.outputs for record in records], n_inputs),
    ):
        signal = np.asarray(signals[0] if len(signals) == 1 else np.concatenate(signals), float)
        # one channel at a time, which is many times faster than rows of a few channels
        for channel, values in enumerate(signal.T, start=begin):
            rms = np.sqrt(np.vecdot(values, values) / len(values))
            scale[channel] = rms if rms > 0.0 else 1.0
            np.divide(values, scale[channel], out=samples[:, channel])
    return Stack(
        samples=samples,
        lengths=lengths,
        input_scale=scale[:n_inputs],
        output_scale=scale[n_inputs:],
        sample_time=first.sample_time,
        hold=first.hold or ("zero",) * n_inputs,
        input_names=first.input_names,
        output_names=first.output_names,
    )


def remove_means(data: Data) -> tuple[InputOutput, ...]:
    """Records with the mean of every channel removed.

    A linear model describes deviations from an operating point, which the means represent.
    """
    return tuple(
        replace(
            record,
            inputs=record.inputs - record.inputs.mean(axis=0),
            outputs=record.outputs - record.outputs.mean(axis=0),
        )
        for record in records_of(data)
    )


def _check(record: InputOutput, where: str) -> None:
    for name, signal in (("inputs", record.inputs), ("outputs", record.outputs)):
        if not isinstance(signal, np.ndarray) or signal.ndim != 2 or signal.shape[1] == 0:
            shape = getattr(signal, "shape", type(signal).__name__)
            raise InvalidInput(
                f"expected {name} of shape (n_samples, n_{name}), got {shape}",
                where=where,
                remedy="one row a sample, one column a channel; a single channel is x[:, None]",
            )
        is_finite = np.isfinite(signal)
        if not is_finite.all():
            not_finite = np.flatnonzero(~is_finite.all(axis=1))
            raise InvalidInput(
                f"expected finite {name}, got {len(not_finite)} samples with NaN or infinity",
                where=f"{where}, sample {not_finite[0]}",
                remedy="cut the record there and pass the pieces as several records",
            )
    if len(record.inputs) != len(record.outputs):
        raise InvalidInput(
            "expected as many samples of outputs as of inputs, "
            f"got {len(record.outputs)} and {len(record.inputs)}",
            where=where,
        )
    if len(record.inputs) == 0:
        raise InvalidInput("expected samples, got none", where=where)
    if not (np.isfinite(record.sample_time) and record.sample_time > 0.0):
        raise InvalidInput(f"expected a sample time > 0, got {record.sample_time}", where=where)
    n_inputs = record.inputs.shape[1]
    if record.hold and len(record.hold) != n_inputs:
        raise InvalidInput(
            f"expected a hold for each of {n_inputs} inputs, got {len(record.hold)}", where=where
        )
    if not set(record.hold) <= {"zero", "first"}:
        raise InvalidInput(f"expected hold zero or first, got {record.hold}", where=where)


def _check_same(record: InputOutput, first: InputOutput, where: str) -> None:
    kinds = [
        ("inputs", record.inputs.shape[1], first.inputs.shape[1]),
        ("outputs", record.outputs.shape[1], first.outputs.shape[1]),
        ("sample time", record.sample_time, first.sample_time),
        ("hold", record.hold, first.hold),
    ]
    for name, got, expected in kinds:
        if got != expected:
            raise InvalidInput(
                f"expected {name} as in record 1, {expected}, got {got}",
                where=where,
                remedy="fit records of different kinds apart",
            )


@dataclass(frozen=True, slots=True)
class ModelMatrices:
    """State-space matrices A, B, C, D, K and the initial state of each record; stacks of them."""

    A: FloatArray
    B: FloatArray
    C: FloatArray
    D: FloatArray
    K: FloatArray
    initial_states: FloatArray  # (n_records, order)

    @property
    def order(self) -> int:
        return int(self.A.shape[-1])

    def pack(self) -> FloatArray:
        """Entries in the layout of the core: A, B, C, D, K by rows, then the initial states."""
        parts = (self.A, self.B, self.C, self.D, self.K, self.initial_states)
        stacked = self.A.shape[:-2]
        entries = [part.reshape(*stacked, part.shape[-2] * part.shape[-1]) for part in parts]
        return np.concatenate(entries, axis=-1)

    def transformed(self, T: FloatArray) -> ModelMatrices:
        """Model with the state T x."""
        inverse = np.linalg.inv(T)
        return ModelMatrices(
            A=T @ self.A @ inverse,
            B=T @ self.B,
            C=self.C @ inverse,
            D=self.D,
            K=T @ self.K,
            initial_states=self.initial_states @ T.T,
        )

    def with_units(self, inputs: FloatArray, outputs: FloatArray) -> ModelMatrices:
        """Model of channels multiplied by factors (n_inputs,) and (n_outputs,)."""
        column = outputs[:, None]
        return replace(
            self,
            B=self.B / inputs,
            C=self.C * column,
            D=self.D * column / inputs,
            K=self.K / outputs,
        )


def _shapes(order: int, n_inputs: int, n_outputs: int) -> tuple[tuple[int, int], ...]:
    """Shapes of A, B, C, D and K."""
    n, m, p = order, n_inputs, n_outputs
    return (n, n), (n, m), (p, n), (p, m), (n, p)


def n_entries(order: int, n_inputs: int, n_outputs: int) -> int:
    """Total number of entries of A, B, C, D and K."""
    return sum(rows * columns for rows, columns in _shapes(order, n_inputs, n_outputs))


def unpack(values: FloatArray, order: int, n_inputs: int, n_outputs: int) -> ModelMatrices:
    """Matrices from packed vectors (..., n_entries); the inverse of `Matrices.pack`."""
    stacked, parts, start = values.shape[:-1], [], 0
    for rows, columns in _shapes(order, n_inputs, n_outputs):
        stop = start + rows * columns
        parts.append(values[..., start:stop].reshape(*stacked, rows, columns))
        start = stop
    parts.append(values[..., start:].reshape(*stacked, -1, order))
    return ModelMatrices(*parts)


def unscale(matrices: ModelMatrices, data: Stack) -> ModelMatrices:
    """Convert a model of scaled channels to the units of the data."""
    return matrices.with_units(data.input_scale, data.output_scale)


def rescale(matrices: ModelMatrices, data: Stack) -> ModelMatrices:
    """Convert a model in the units of the data to scaled channels."""
    return matrices.with_units(1.0 / data.input_scale, 1.0 / data.output_scale)


def stabilise(matrices: ModelMatrices) -> ModelMatrices:
    """Model with the unstable poles reflected into the unit circle, and a stable predictor.

    The reflection of a pole scales the magnitude of the frequency response and changes its phase.
    """
    A, C = reflect_poles(matrices.A), matrices.C
    return replace(matrices, A=A, K=_core.stabilising_gain(A, C, matrices.K, np.eye(len(C))))


def balance(matrices: ModelMatrices) -> ModelMatrices:
    """Model in the balanced coordinates of `balancing`."""
    return matrices.transformed(balancing(matrices))


def balancing(matrices: ModelMatrices) -> FloatArray:
    """State transformation T that balances the predictor.

    In the coordinates T x, the controllability and observability Gramians of (A - K C, [B, K], C)
    are equal and diagonal, which keeps the normal equations of a fit well conditioned. T is the
    identity if the predictor is unstable or a Gramian is singular.
    """
    T = _core.balancing(matrices.A, matrices.B, matrices.C, matrices.K)
    return np.eye(matrices.order) if T is None else T


def reflect_poles(A: FloatArray) -> FloatArray:
    """Matrix A with the eigenvalues on or outside the unit circle reflected to the inside."""
    values, vectors = np.linalg.eig(A)
    moduli = np.abs(values)
    if (moduli < 1.0).all():
        return A
    new_moduli = np.where(moduli >= 1.0, np.minimum(1.0 / moduli, 1.0 - 1e-6), moduli)
    result = vectors @ np.diag(values / moduli * new_moduli) @ np.linalg.inv(vectors)
    return np.asarray(result.real)
