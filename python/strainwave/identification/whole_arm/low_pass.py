"""The linear-phase low-pass that every compared channel passes through, on both sides."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from strainwave.domain import FloatArray

_PER_PERIOD = 4.0  # rows in a period of the cut-off; more would only repeat each other
_REACH = 1.5  # periods of the cut-off that the low-pass reaches to either side
_BAND = 8  # rows of the low-pass that share a matrix product
_SHAPE = 5.0  # of its Kaiser window: 50 dB outside its band


@dataclass(frozen=True, slots=True)
class Kernels:
    """A low-pass as weights of the samples around each row, and the same of the slope."""

    smooth: FloatArray  # (n_taps,)
    slope: FloatArray  # (n_taps,) [1/s]
    step: int  # samples from row to row

    def taps(self, *, rate: bool) -> FloatArray:
        """Those of the slope, or of the low-pass itself: (n_taps,)."""
        return self.slope if rate else self.smooth

    def rows(self, samples: FloatArray, *, rate: bool) -> FloatArray:
        """(n_samples, ...) -> (n_rows, ...), without the edges that the low-pass cannot reach.

        Some rows at a time are one product of a banded matrix with the samples that they reach.
        """
        taps, step = self.taps(rate=rate), self.step
        n_rows = (len(samples) - len(taps)) // step + 1
        band = np.zeros((_BAND, (_BAND - 1) * step + len(taps)))
        for k in range(_BAND):
            band[k, k * step : k * step + len(taps)] = taps
        flat = np.ascontiguousarray(samples).reshape(len(samples), -1)
        rows = np.empty((n_rows, flat.shape[1]))
        whole = n_rows // _BAND * _BAND
        if whole:
            reach, (along, across) = band.shape[1], flat.strides
            blocks: FloatArray = np.ndarray(  # views that overlap: each has what its rows reach
                (whole // _BAND, reach, flat.shape[1]),
                buffer=flat,
                strides=(_BAND * step * along, along, across),
            )
            rows[:whole] = np.matmul(band, blocks).reshape(whole, -1)
        rest = flat[whole * step : (n_rows - 1) * step + len(taps)]
        rows[whole:] = band[: n_rows - whole, : len(rest)] @ rest
        return rows.reshape(n_rows, *samples.shape[1:])


def low_pass_kernels(cutoff_hz: float, sample_time: float, ahead: float = 0.0) -> Kernels:
    """A windowed-sinc low-pass and its slope, for rows as far apart as the cut-off allows.

    `cutoff_hz` [Hz].
    `sample_time` [s].
    `ahead` [samples]: By which the rows look ahead of their time.

    Returns: Its number of taps is a multiple of `step`.
    """
    step = max(1, int(1.0 / (_PER_PERIOD * cutoff_hz * sample_time)))
    n_parts = 2 * int(np.ceil(_REACH / (cutoff_hz * sample_time * step)))
    n = n_parts * step
    half = 0.5 * (n - 1)
    at = np.arange(n) - half - ahead
    window = np.i0(_SHAPE * np.sqrt(np.clip(1.0 - (at / half) ** 2, 0.0, None)))
    smooth = np.sinc(2.0 * cutoff_hz * sample_time * at) * np.where(np.abs(at) > half, 0.0, window)
    smooth /= smooth.sum()
    # an angle's slope is the product with minus the kernel's own; a ramp must give one exactly
    slope = -np.gradient(smooth)
    slope /= np.sum(slope * at) * sample_time
    return Kernels(smooth, slope, step)
