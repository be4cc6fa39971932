"""Validation, stacking and scaling of input-output records for the compiled core."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from strainwave.domain import FloatArray, Hold, InputOutput
from strainwave.errors import InvalidInput

Data = InputOutput | Sequence[InputOutput]


@dataclass(frozen=True, slots=True)
class Stack:
    """Stacked records, each channel divided by its root mean square."""

    inputs: FloatArray  # (n_samples, n_inputs), scaled
    outputs: FloatArray  # (n_samples, n_outputs), scaled
    lengths: tuple[int, ...]
    input_scale: FloatArray  # (n_inputs,)
    output_scale: FloatArray  # (n_outputs,)
    sample_time: float
    hold: tuple[Hold, ...]
    input_names: tuple[str, ...]
    output_names: tuple[str, ...]

    @property
    def n_samples(self) -> int:
        return len(self.inputs)

    @property
    def n_inputs(self) -> int:
        return int(self.inputs.shape[1])

    @property
    def n_outputs(self) -> int:
        return int(self.outputs.shape[1])

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
    inputs = np.concatenate([record.inputs for record in records]).astype(np.float64)
    outputs = np.concatenate([record.outputs for record in records]).astype(np.float64)
    input_scale, output_scale = _scale(inputs), _scale(outputs)
    return Stack(
        inputs=np.ascontiguousarray(inputs / input_scale),
        outputs=np.ascontiguousarray(outputs / output_scale),
        lengths=tuple(len(record.inputs) for record in records),
        input_scale=input_scale,
        output_scale=output_scale,
        sample_time=first.sample_time,
        hold=first.hold or ("zero",) * inputs.shape[1],
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


def _scale(signal: FloatArray) -> FloatArray:
    rms = np.sqrt(np.mean(signal**2, axis=0))
    return np.where(rms > 0.0, rms, 1.0)


def _check(record: InputOutput, where: str) -> None:
    for name, signal in (("inputs", record.inputs), ("outputs", record.outputs)):
        if not isinstance(signal, np.ndarray) or signal.ndim != 2 or signal.shape[1] == 0:
            shape = getattr(signal, "shape", type(signal).__name__)
            raise InvalidInput(
                f"expected {name} of shape (n_samples, n_{name}), got {shape}",
                where=where,
                remedy="one row a sample, one column a channel; a single channel is x[:, None]",
            )
        not_finite = np.flatnonzero(~np.isfinite(signal).all(axis=1))
        if len(not_finite):
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
