"""Linear-phase low-pass that filters every measured and every simulated channel."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from strainwave.domain import FloatArray

_ROWS_PER_PERIOD = 4.0  # rows per period of the cut-off; further rows would be redundant
_HALF_LENGTH_PERIODS = 1.5  # half-length of the filter, in periods of the cut-off
_ROWS_PER_PRODUCT = 8  # output rows per matrix product
_KAISER_BETA = 5.0  # beta of the Kaiser window: 50 dB stop-band attenuation


@dataclass(frozen=True, slots=True)
class Kernels:
    """Taps of a low-pass and of its derivative, with decimation."""

    smooth: FloatArray  # (n_taps,)
    slope: FloatArray  # (n_taps,) [1/s]
    step: int  # samples per row

    def taps(self, *, slope: bool) -> FloatArray:
        """Taps (n_taps,) of the derivative if `slope` is true, otherwise of the low-pass."""
        return self.slope if slope else self.smooth

    def rows(self, samples: FloatArray, *, slope: bool) -> FloatArray:
        """Filter and decimate samples (n_samples, ...) to rows (n_rows, ...), without the edges.

        One product of a banded matrix with overlapping blocks of samples computes several rows.
        """
        taps, step = self.taps(slope=slope), self.step
        n_rows = (len(samples) - len(taps)) // step + 1
        band = np.zeros((_ROWS_PER_PRODUCT, (_ROWS_PER_PRODUCT - 1) * step + len(taps)))
        for k in range(_ROWS_PER_PRODUCT):
            band[k, k * step : k * step + len(taps)] = taps
        flat = np.ascontiguousarray(samples).reshape(len(samples), -1)
        rows = np.empty((n_rows, flat.shape[1]))
        n_blocked = n_rows // _ROWS_PER_PRODUCT * _ROWS_PER_PRODUCT
        if n_blocked:
            n_reached, (sample_stride, column_stride) = band.shape[1], flat.strides
            blocks: FloatArray = np.ndarray(  # overlapping views of the samples
                (n_blocked // _ROWS_PER_PRODUCT, n_reached, flat.shape[1]),
                buffer=flat,
                strides=(_ROWS_PER_PRODUCT * step * sample_stride, sample_stride, column_stride),
            )
            rows[:n_blocked] = np.matmul(band, blocks).reshape(n_blocked, -1)
        remaining = flat[n_blocked * step : (n_rows - 1) * step + len(taps)]
        rows[n_blocked:] = band[: n_rows - n_blocked, : len(remaining)] @ remaining
        return rows.reshape(n_rows, *samples.shape[1:])


def low_pass_kernels(cutoff_hz: float, sample_time: float, ahead: float = 0.0) -> Kernels:
    """Design a windowed-sinc low-pass and its derivative with a Kaiser window.

    `sample_time` is in s; `ahead` is a fractional advance of the rows in samples. The cut-off sets
    the decimation `step`, and the number of taps is a multiple of it.
    """
    step = max(1, int(1.0 / (_ROWS_PER_PERIOD * cutoff_hz * sample_time)))
    n_steps = 2 * int(np.ceil(_HALF_LENGTH_PERIODS / (cutoff_hz * sample_time * step)))
    n_taps = n_steps * step
    half = 0.5 * (n_taps - 1)
    offset = np.arange(n_taps) - half - ahead
    window = np.i0(_KAISER_BETA * np.sqrt(np.clip(1.0 - (offset / half) ** 2, 0.0, None)))
    # a tap that the advance moves beyond the window keeps its weight, so that rows are continuous
    smooth = np.sinc(2.0 * cutoff_hz * sample_time * offset) * window
    smooth /= smooth.sum()
    # derivative by convolution with -d(taps)/dt; a constant gives exactly zero, a unit ramp one
    slope = -np.gradient(smooth)
    slope -= np.sum(slope) * smooth
    slope /= np.sum(slope * offset) * sample_time
    return Kernels(smooth, slope, step)
