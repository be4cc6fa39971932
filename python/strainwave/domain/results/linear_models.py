"""Linear models without reference to arms: state space, modes, responses, residual tests."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from strainwave.display import Displayed
from strainwave.domain.keys import FloatArray
from strainwave.domain.results.estimates import Diagnostic, SearchEnd

Hold = Literal["zero", "first"]  # zero-order or first-order hold between samples


@dataclass(frozen=True, slots=True)
class InputOutput:
    """An uninterrupted section of inputs and outputs on a uniform time base."""

    inputs: FloatArray  # (n_samples, n_inputs)
    outputs: FloatArray  # (n_samples, n_outputs)
    sample_time: float  # [s]
    hold: tuple[Hold, ...] = ()  # one per input; empty: all "zero"
    input_names: tuple[str, ...] = ()
    output_names: tuple[str, ...] = ()

    def window(self, start: int, stop: int) -> InputOutput:
        """Samples `start` to `stop` - 1."""
        return replace(self, inputs=self.inputs[start:stop], outputs=self.outputs[start:stop])


@dataclass(frozen=True, slots=True)
class StateSpace:
    """Discrete-time model in innovations form: x+ = A x + B u + K e, y = C x + D u + e, e white.

    Its coordinates are arbitrary. Quantities that do not depend on them have a variance, which
    `covariance` gives by the delta method (`strainwave.statespace.propagate`).
    """

    A: FloatArray  # (order, order)
    B: FloatArray  # (order, n_inputs)
    C: FloatArray  # (n_outputs, order)
    D: FloatArray  # (n_outputs, n_inputs)
    K: FloatArray  # (order, n_outputs)
    noise_covariance: FloatArray  # (n_outputs, n_outputs) of e
    initial_states: FloatArray  # (n_records, order) at the first sample of each record
    sample_time: float  # [s]
    hold: tuple[Hold, ...]  # one per input
    method: Literal["subspace", "pem", "output-error"]
    # end of the search; "estimated" without a search, "not-determined" without a covariance
    status: SearchEnd | Literal["estimated", "not-determined"]
    fit_percent: tuple[float, ...]  # one per output: simulation
    prediction_fit_percent: tuple[float, ...]  # one per output: one-step prediction
    n_samples: int
    n_parameters: int  # degrees of freedom, initial states included
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
    def bic(self) -> float:
        """Schwarz's information criterion; smaller is better."""
        return self.n_parameters * float(np.log(self.n_samples)) - 2.0 * self.log_likelihood


@dataclass(frozen=True, slots=True)
class ContinuousStateSpace:
    """Continuous-time model dx/dt = A x + B u, y = C x + D u."""

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
    """A pole or zero of a continuous-time model: a complex pair or a real number."""

    value: complex  # [rad/s], imaginary part non-negative
    frequency_hz: float  # modulus over 2 pi
    damping: float  # -real part over modulus; 1 on the negative real axis
    frequency_std_hz: float | None
    damping_std: float | None

    @property
    def oscillates(self) -> bool:
        """Whether the mode is a complex pair."""
        return self.value.imag > 0.0


@dataclass(frozen=True, slots=True)
class Modes:
    """Poles of a model, and zeros from one input to one output."""

    poles: tuple[Mode, ...]  # by frequency
    zeros: tuple[Mode, ...]  # by frequency
    resonance: Mode | None  # the least damped pair of poles; None: no complex pair
    anti_resonance: Mode | None  # the least damped pair of zeros; None: no complex pair


@dataclass(frozen=True, slots=True)
class FrequencyResponse(Displayed):
    """Response of every output to every input, with its uncertainty."""

    frequencies_hz: FloatArray  # (n_frequencies,)
    response: NDArray[np.complex128]  # (n_frequencies, n_outputs, n_inputs)
    # (n_frequencies, n_outputs, n_inputs, 2, 2) of real and imaginary part
    covariance: FloatArray | None = None
    coherence: FloatArray | None = None  # (n_frequencies, n_outputs), multiple
    # variance of the response, (n_frequencies, n_outputs, n_inputs), by source; None: unknown
    noise_variance: FloatArray | None = None
    distortion_variance: FloatArray | None = None  # of the response of one record
    method: Literal["model", "periods", "welch"] = "model"
    n_averages: int = 0
    warnings: tuple[Diagnostic, ...] = ()

    def between(self, low_hz: float, high_hz: float, max_lines: int) -> FrequencyResponse:
        """Lines in a band [Hz], at most `max_lines` of them, evenly spread over log frequency."""
        f = self.frequencies_hz
        lines = np.flatnonzero((f >= low_hz) & (f <= high_hz))
        if len(lines) > max_lines:
            targets = np.geomspace(f[lines[0]], f[lines[-1]], max_lines)
            lines = np.unique(np.searchsorted(f, targets).clip(lines[0], lines[-1]))
        by_line = ("response", "covariance", "coherence", "noise_variance", "distortion_variance")
        known = {name: values for name in by_line if (values := getattr(self, name)) is not None}
        selected = {name: values[lines] for name, values in known.items()}
        return replace(self, frequencies_hz=f[lines], **selected)

    @property
    def magnitude_std(self) -> FloatArray | None:
        """Standard deviation of the magnitude, to first order."""
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
    """One residual test and its result."""

    name: Literal["white", "independent-of-past-inputs", "no-feedback"]
    statistic: float  # chi-square distributed under the hypothesis
    degrees: int
    p_value: float
    passed: bool
    message: str  # the result in one sentence


@dataclass(frozen=True, slots=True)
class ModelCheck:
    """Fits and residual tests of a state-space model on data."""

    fit_percent: tuple[float, ...]  # one per output: simulation, initial state from the data
    prediction_fit_percent: tuple[float, ...]  # one per output: one-step prediction
    tests: tuple[HypothesisTest, ...]
    autocorrelation: FloatArray  # (lags, n_outputs, n_outputs), lags 0, 1, ..., normalised
    cross_correlation: FloatArray  # (2 lags + 1, n_outputs, n_inputs), lags -L..L, normalised
    confidence_99: float  # 99 % bound of one normalised correlation

    @property
    def passed(self) -> bool:
        """Whether all tests passed."""
        return all(test.passed for test in self.tests)


@dataclass(frozen=True, slots=True)
class OrderSelection:
    """Models of several orders, and the selected order."""

    models: tuple[StateSpace, ...]
    # one tuple per model, one number per output: prediction, or simulation if K is not estimated
    held_out_fit_percent: tuple[tuple[float, ...], ...]
    chosen: int  # the selected order
    rule: str  # reason of the selection

    @property
    def model(self) -> StateSpace:
        """The model of the selected order."""
        return next(model for model in self.models if model.order == self.chosen)
