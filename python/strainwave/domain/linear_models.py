"""Linear models that know nothing of arms: state space, modes, responses, residual tests."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from strainwave.display import Displayed
from strainwave.domain.arrays import FloatArray
from strainwave.domain.estimates import Diagnostic

Hold = Literal["zero", "first"]  # between samples: held, or joined by straight lines


@dataclass(frozen=True, slots=True)
class InputOutput:
    """One uninterrupted stretch of inputs and outputs on a uniform time base."""

    inputs: FloatArray  # (n_samples, n_inputs)
    outputs: FloatArray  # (n_samples, n_outputs)
    sample_time: float  # [s]
    hold: tuple[Hold, ...] = ()  # one an input; empty: all "zero"
    input_names: tuple[str, ...] = ()
    output_names: tuple[str, ...] = ()

    def window(self, start: int, stop: int) -> InputOutput:
        """Samples `start` to `stop` - 1."""
        return replace(self, inputs=self.inputs[start:stop], outputs=self.outputs[start:stop])


@dataclass(frozen=True, slots=True)
class StateSpace:
    """x+ = A x + B u + K e, y = C x + D u + e, e white: a sampled model in innovations form.

    Its coordinates are arbitrary; whatever does not depend on them has a variance, which
    `covariance` gives through the delta method (`strainwave.statespace.propagate`).
    """

    A: FloatArray  # (order, order)
    B: FloatArray  # (order, n_inputs)
    C: FloatArray  # (n_outputs, order)
    D: FloatArray  # (n_outputs, n_inputs)
    K: FloatArray  # (order, n_outputs)
    noise_covariance: FloatArray  # (n_outputs, n_outputs) of e
    initial_states: FloatArray  # (n_records, order) at the first sample of each record
    sample_time: float  # [s]
    hold: tuple[Hold, ...]  # one an input
    method: Literal["subspace", "pem", "output-error"]
    status: Literal["estimated", "converged", "iteration-limit", "stalled", "not-determined"]
    fit_percent: tuple[float, ...]  # one an output: simulated from the inputs alone
    prediction_fit_percent: tuple[float, ...]  # one an output: one step ahead
    n_samples: int
    n_parameters: int  # directions in which the model moves; initial states included
    log_likelihood: float  # Gaussian, at the estimate
    # of the entries A, B, C, D, K, each row by row; singular along changes of coordinates
    covariance: FloatArray | None = None
    covariance_kind: Literal["white", "sandwich"] | None = None
    singular_values: FloatArray | None = None  # of the subspace step
    horizon: int | None = None  # of the subspace step, in samples
    iterations: int = 0
    evaluations: int = 0
    input_names: tuple[str, ...] = ()
    output_names: tuple[str, ...] = ()
    warnings: tuple[Diagnostic, ...] = ()

    @property
    def order(self) -> int:
        """Number of states."""
        return len(self.A)

    @property
    def aic(self) -> float:
        """Akaike's criterion; less is better."""
        return 2.0 * self.n_parameters - 2.0 * self.log_likelihood

    @property
    def bic(self) -> float:
        """Schwarz's criterion; less is better."""
        return self.n_parameters * float(np.log(self.n_samples)) - 2.0 * self.log_likelihood


@dataclass(frozen=True, slots=True)
class ContinuousStateSpace:
    """dx/dt = A x + B u, y = C x + D u: what a sampled model is between the samples."""

    A: FloatArray  # (order, order) [1/s]
    B: FloatArray  # (order, n_inputs)
    C: FloatArray  # (n_outputs, order)
    D: FloatArray  # (n_outputs, n_inputs)
    # of the entries A, B, C, D, each row by row
    covariance: FloatArray | None = None
    input_names: tuple[str, ...] = ()
    output_names: tuple[str, ...] = ()
    warnings: tuple[Diagnostic, ...] = ()

    @property
    def order(self) -> int:
        """Number of states."""
        return len(self.A)


@dataclass(frozen=True, slots=True)
class Mode:
    """A pole or a zero of a continuous-time model: one complex pair, or one real number."""

    value: complex  # [rad/s], imaginary part not negative
    frequency_hz: float  # modulus over 2 pi
    damping: float  # -real part over modulus; one on the negative real axis
    frequency_std_hz: float | None
    damping_std: float | None

    @property
    def oscillates(self) -> bool:
        """Whether it is a complex pair."""
        return self.value.imag > 0.0


@dataclass(frozen=True, slots=True)
class Modes:
    """Poles of a model, and zeros from one of its inputs to one of its outputs."""

    poles: tuple[Mode, ...]  # by frequency
    zeros: tuple[Mode, ...]  # by frequency
    resonance: Mode | None  # the least damped pair of poles, if any oscillates
    anti_resonance: Mode | None  # the least damped pair of zeros


@dataclass(frozen=True, slots=True)
class FrequencyResponse(Displayed):
    """Response of every output to every input, with its uncertainty."""

    frequencies_hz: FloatArray  # (n_frequencies,)
    response: NDArray[np.complex128]  # (n_frequencies, n_outputs, n_inputs)
    # (n_frequencies, n_outputs, n_inputs, 2, 2) of real and imaginary part
    covariance: FloatArray | None = None
    coherence: FloatArray | None = None  # (n_frequencies, n_outputs), multiple
    # Variance of the response, (n_frequencies, n_outputs, n_inputs), by its source; None: unknown
    noise_variance: FloatArray | None = None
    distortion_variance: FloatArray | None = None  # of one record's response
    method: Literal["model", "periods", "welch"] = "model"
    n_averages: int = 0
    warnings: tuple[Diagnostic, ...] = ()

    def between(self, low_hz: float, high_hz: float, most: int) -> FrequencyResponse:
        """Its lines in a band; of more than `most`, those evenly spread over log frequency.

        `low_hz`, `high_hz` [Hz].
        """
        f = self.frequencies_hz
        kept = np.flatnonzero((f >= low_hz) & (f <= high_hz))
        if len(kept) > most:
            wanted = np.geomspace(f[kept[0]], f[kept[-1]], most)
            kept = np.unique(np.searchsorted(f, wanted).clip(kept[0], kept[-1]))

        def of(lines: FloatArray | None) -> FloatArray | None:
            return None if lines is None else lines[kept]

        return replace(
            self,
            frequencies_hz=f[kept],
            response=self.response[kept],
            covariance=of(self.covariance),
            coherence=of(self.coherence),
            noise_variance=of(self.noise_variance),
            distortion_variance=of(self.distortion_variance),
        )

    @property
    def magnitude_std(self) -> FloatArray | None:
        """Standard deviation of the modulus, to first order."""
        return self._std(self.response / np.abs(self.response))

    @property
    def phase_std(self) -> FloatArray | None:
        """Standard deviation of the phase [rad], to first order."""
        return self._std(1j * self.response / np.abs(self.response) ** 2)

    def _std(self, along: NDArray[np.complex128]) -> FloatArray | None:
        if self.covariance is None:
            return None
        direction = np.stack([along.real, along.imag], axis=-1)
        variance = np.einsum("...i,...ij,...j->...", direction, self.covariance, direction)
        return np.asarray(np.sqrt(np.maximum(variance, 0.0)))


@dataclass(frozen=True, slots=True)
class HypothesisTest:
    """One test of residuals, with its verdict."""

    name: Literal["white", "independent-of-past-inputs", "no-feedback"]
    statistic: float  # chi-square if the hypothesis holds
    degrees: int
    p_value: float
    passed: bool
    message: str  # the verdict in a sentence


@dataclass(frozen=True, slots=True)
class ModelCheck:
    """A state-space model on data: fits and residual tests."""

    fit_percent: tuple[float, ...]  # one an output: simulated, initial state from the data
    prediction_fit_percent: tuple[float, ...]
    tests: tuple[HypothesisTest, ...]
    autocorrelation: FloatArray  # (lags, n_outputs, n_outputs), lags 0, 1, ..., normalised
    cross_correlation: FloatArray  # (2 lags + 1, n_outputs, n_inputs), lags -L..L, normalised
    confidence_99: float  # bound of one normalised correlation

    @property
    def passed(self) -> bool:
        """Whether no test failed."""
        return all(test.passed for test in self.tests)


@dataclass(frozen=True, slots=True)
class OrderSelection:
    """Models of several orders, and the one to take."""

    models: tuple[StateSpace, ...]
    # One tuple a model, one number an output: one step ahead, or simulated if K was not estimated.
    held_out_fit_percent: tuple[tuple[float, ...], ...]
    chosen: int  # the order
    rule: str  # why

    @property
    def model(self) -> StateSpace:
        """The chosen one."""
        return next(model for model in self.models if model.order == self.chosen)
