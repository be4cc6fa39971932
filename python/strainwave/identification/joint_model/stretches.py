"""Data of decoupled joints for prediction-error estimation: filtered, decimated stretches.

- Innovations need noise power at all frequencies up to Nyquist. The sampling rate is therefore
  reduced together with the low-pass; a low-pass alone would make the noise predictable.
- Friction and sensor bias drift. A second-order zero-phase high-pass below the anti-resonance
  removes them. Its gentle slope leaves power at all frequencies.
- Linear interpolation between samples attenuates the inputs by sinc^2. The inputs are divided by
  sinc^2, so that the interpolated inputs have the original spectrum within the band.
- At low frequencies the fused link velocity (10) contains the motor velocity. The fusion filter is
  known and is inverted.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from strainwave.domain import (
    ComplexArray,
    Decoupled,
    FloatArray,
    InputOutput,
    JointModel,
    LinearOptions,
    LinkSignals,
    Modes,
)
from strainwave.errors import NotIdentifiable
from strainwave.numerics.filters import by_spectrum, low_pass
from strainwave.signals.standstill import runs_of

Band = tuple[float, float]
"""Lower and upper edge [Hz]."""

FIRST_BAND_HZ: Band = (3.0, 60.0)
"""Initial band of a search: resonances of strain-wave gears with links of about 1 m."""

MIN_PERIODS = 6.0
"""Minimum number of periods of the lower edge in a record."""

_MAX_HIGH_EDGE_TO_RATE = 0.4  # upper edge over the sampling rate
_MAX_HIGH_EDGE_TO_BANDWIDTH = 0.8  # upper edge over the bandwidth of a filter of the signals

_ANTI_RESONANCE_TO_LOW_EDGE = 3.0  # ratio of the anti-resonance to the lower edge of the band
# ratio of the upper edge of the band to the resonance; with less, the data do not determine d_G
_HIGH_EDGE_TO_RESONANCE = 3.0
_MIN_EDGE_RATIO = 4.0  # minimum ratio of the edges of the band
# ratio of the sampling rate to the upper edge of the band. 3.5 to 4.5 work; above 5 the low-pass
# leaves too little noise near Nyquist for the prediction-error method
_RATE_TO_HIGH_EDGE = 4.0
# orders of the band-pass: powers of the frequency ratios in the gain
_HIGH_PASS_ORDER, _LOW_PASS_ORDER = 2, 6
# share of the new sampling rate up to which inputs are divided by sinc^2, which is 0.1 there
_MAX_COMPENSATED_RATE_SHARE = 0.75
_CUTOFF_TO_NYQUIST = 0.8  # cut-off over the new Nyquist frequency, as in MATLAB's `decimate`
# minimum number of periods of the cut-off in one period of the slowest motion
_MIN_CUTOFF_PERIODS = 10.0
_BAND_CHANGE = 1.2  # factor on the band edges for the estimate of the model error


def other_bands(band_hz: Band, records: Sequence[Decoupled]) -> list[Band]:
    """A narrower and a wider band [Hz], to measure the model error by the change of estimates."""
    return [limit_to_records(band, records) for band in neighbouring_bands(band_hz, _BAND_CHANGE)]


def band_around(
    anti_resonance_hz: float, resonance_hz: float, records: Sequence[Decoupled]
) -> Band:
    """Filter band [Hz] around the resonances, limited to the frequencies in the records."""
    low = anti_resonance_hz / _ANTI_RESONANCE_TO_LOW_EDGE
    return limit_to_records((low, resonance_hz * _HIGH_EDGE_TO_RESONANCE), records)


def limit_to_records(band: Band, records: Sequence[Decoupled]) -> Band:
    """Limit the band to the frequencies that the longest stretch of each record contains."""
    longest = [int(np.max(np.diff(runs_of(record.valid)), initial=0)) or 1 for record in records]
    return limit_band(band, records, longest, _MIN_EDGE_RATIO)


def band_for(rings_hz: Band, records: Sequence[Decoupled], options: LinearOptions) -> Band:
    """Filter band [Hz] of the options, otherwise the band around a joint's resonances.

    `rings_hz` has the anti-resonance and the resonance [Hz].
    """
    return options.band_hz or limit_to_rate(band_around(*rings_hz, records), records, options)


def limit_to_rate(band_hz: Band, records: Sequence[Decoupled], options: LinearOptions) -> Band:
    """Limit the upper edge of the band to what the decimation of the options allows."""
    factor = _decimation_of(records[0], options)
    if factor is None:
        return band_hz
    high = 1.0 / (_RATE_TO_HIGH_EDGE * factor * records[0].sample_time)
    return min(band_hz[0], high / _MIN_EDGE_RATIO), high


def _decimation_of(record: Decoupled, options: LinearOptions) -> int | None:
    """Factor of downsampling that the options set; None: it follows from the band."""
    if options.decimation is not None or options.sample_time is None:
        return options.decimation
    return max(1, round(options.sample_time / record.sample_time))


def band_of(f: FloatArray, band_hz: Band) -> FloatArray:
    """Gain (n_frequencies,) of the zero-phase band-pass, 1 / ((1 + (low/f)^2) (1 + (f/high)^6))."""
    low, high = band_hz
    gain = (1.0 + (low / f) ** _HIGH_PASS_ORDER) * (1.0 + (f / high) ** _LOW_PASS_ORDER)
    return np.asarray(1.0 / gain)


def velocities(f: FloatArray, record: Decoupled) -> ComplexArray:
    """Frequency response from the outputs to motor and link velocity, the inverse of (10).

    Returns (n_frequencies, 2, 2) for `f` (n_frequencies,) [Hz].
    """
    inverse = np.zeros((len(f), 2, 2), dtype=complex)
    inverse[:, 0, 0] = inverse[:, 1, 1] = 1.0
    if record.fusion is not None:
        x = 2j * np.pi * f * record.fusion.time_constant
        F = 1.0 / (1.0 + x if record.fusion.order == 1 else 1.0 + np.sqrt(2.0) * x + x * x)
        inverse[:, 1, 1] = 1.0 / (1.0 - F)
        inverse[:, 1, 0] = -record.gear_ratio * F / (1.0 - F)
    return inverse


def input_output_of(
    records: Sequence[Decoupled], band_hz: Band, options: LinearOptions
) -> tuple[InputOutput, ...]:
    """Filtered and decimated stretches of all records."""
    pieces = _pieces if options.filter == "band" else _decimate
    stretches = [piece for record in records for piece in pieces(record, band_hz, options)]
    if not stretches:
        raise NotIdentifiable(
            f"no stretch of {records[0].experiment.name} is free of edges and saturation for "
            f"{MIN_PERIODS:g} periods of "
            f"{band_hz[0] or band_hz[1] / _MIN_CUTOFF_PERIODS:.3g} Hz: record for longer, "
            "or lower the amplitude"
        )
    return tuple(stretches)


def _pieces(record: Decoupled, band_hz: Band, options: LinearOptions) -> Iterator[InputOutput]:
    low, high = band_hz
    T = record.sample_time
    step = _decimation_of(record, options) or max(1, round(1.0 / (_RATE_TO_HIGH_EDGE * high * T)))

    def compensated_band(f: FloatArray) -> ComplexArray:
        attenuation = np.where(
            f * step * T < _MAX_COMPENSATED_RATE_SHARE, np.sinc(f * step * T) ** 2, 1.0
        )
        return np.asarray(band_of(f, band_hz) / attenuation, dtype=complex)

    def compensated_sensors(f: FloatArray) -> ComplexArray:
        return np.asarray(band_of(f, band_hz)[:, None, None] * velocities(f, record))

    for start, stop in runs_of(record.valid).tolist():
        edge = int(1.0 / (low * T))
        # the high-pass response lasts one period; the remaining samples must suffice for a fit
        if (stop - start) * T * low < MIN_PERIODS - 1e-6:
            continue
        inputs = by_spectrum(record.inputs[start:stop], compensated_band, T, 3.0 / low)
        outputs = by_spectrum(record.outputs[start:stop], compensated_sensors, T, 3.0 / low)
        inner = slice(edge, stop - start - edge, step)
        yield _input_output(inputs[inner], outputs[inner], step * T, options)


def decimated_hz(record: Decoupled, options: LinearOptions) -> float:
    """Cut-off frequency [Hz] of the low-pass before decimation."""
    return _CUTOFF_TO_NYQUIST * 0.5 / ((_decimation_of(record, options) or 1) * record.sample_time)


def _decimate(record: Decoupled, _: Band, options: LinearOptions) -> Iterator[InputOutput]:
    """Low-passed, decimated stretches without their means, prepared as in the source."""
    T, cutoff = record.sample_time, decimated_hz(record, options)
    step = _decimation_of(record, options) or 1
    for start, stop in runs_of(record.valid).tolist():
        edge = int(1.0 / (cutoff * T))
        if (stop - start) * T * cutoff < _MIN_CUTOFF_PERIODS * MIN_PERIODS:
            continue
        columns = np.hstack([record.inputs[start:stop], record.outputs[start:stop]])
        samples = low_pass(columns, cutoff, T)[edge : stop - start - edge : step]
        samples = samples - samples.mean(axis=0)
        yield _input_output(samples[:, :-2], samples[:, -2:], step * T, options)


def _input_output(
    inputs: FloatArray, outputs: FloatArray, sample_time: float, options: LinearOptions
) -> InputOutput:
    """One stretch with the inputs and outputs that the options select."""
    n_in = 1 if options.inputs == "motor" else inputs.shape[1]
    n_out = 1 if options.outputs == "motor" else 2
    return InputOutput(
        inputs=np.ascontiguousarray(inputs[:, :n_in]),
        outputs=np.ascontiguousarray(outputs[:, :n_out]),
        sample_time=sample_time,
        hold=tuple("first" for _ in range(n_in)),
        input_names=("motor_torque", "interaction_torque")[:n_in],
        output_names=("motor_velocity", "link_velocity")[:n_out],
    )


def resonances_of(modes: Modes | JointModel | None) -> Band | None:
    """Frequencies [Hz] of anti-resonance and resonance; None unless both are known."""
    if modes is None or modes.anti_resonance is None or modes.resonance is None:
        return None
    return modes.anti_resonance.frequency_hz, modes.resonance.frequency_hz


def limit_band(
    band: Band,
    records: Sequence[LinkSignals | Decoupled],
    lengths: Sequence[int],
    min_edge_ratio: float,
) -> Band:
    """Limit a band to the frequencies that records contain.

    `lengths` are the usable samples of each record, `min_edge_ratio` the least ratio of the edges.
    """
    low, high = band
    for record, length in zip(records, lengths, strict=True):
        T = record.sample_time
        low = max(low, MIN_PERIODS / (length * T))
        bandwidth = record.bandwidth_hz or np.inf
        high = min(high, _MAX_HIGH_EDGE_TO_RATE / T, _MAX_HIGH_EDGE_TO_BANDWIDTH * bandwidth)
    return min(low, high / min_edge_ratio), high


def neighbouring_bands(band: Band, by: float) -> tuple[Band, Band]:
    """A narrower and a wider band. Changes of estimates with the band measure the model error."""
    low, high = band
    return (low * by, high / by), (low / by, high * by)


def same_band(band: Band, other: Band, within: float) -> bool:
    """Whether both edges of two bands agree to the relative difference `within`."""
    return all(abs(a / b - 1.0) < within for a, b in zip(band, other, strict=True))
