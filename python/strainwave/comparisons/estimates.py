"""State-space models of a decoupled joint, their responses, and how far they are off."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from strainwave.errors import NotIdentifiable, NumericalFailure
from strainwave.filters import low_pass
from strainwave.physical.two_inertia import TwoInertia, state_space
from strainwave.physical.two_inertia import anti_resonance as true_anti_resonance
from strainwave.physical.two_inertia import resonance as true_resonance
from strainwave.records import (
    ComplexArray,
    ContinuousStateSpace,
    Decoupled,
    FloatArray,
    FrequencyResponse,
    Hold,
    InputOutput,
    Mode,
    StateSpace,
)
from strainwave.report.curves import Curve
from strainwave.statespace import (
    frequency_response,
    modes,
    pem,
    subspace,
    to_continuous,
    without_means,
)

BANDWIDTH_HZ = 150.0  # zero-phase; well below the new Nyquist frequency, well above the resonances
STEP = 1e-3  # [s]
MODEL_ORDER = 3  # twist and two velocities
LINES_HZ = np.geomspace(1.0, 100.0, 240)
JUDGED_HZ = (3.0, 60.0)  # where errors of responses are taken: around dip and peak
_EDGE = 0.01  # [s] of a record's ends that the filters' transients spoil

Way = Literal["pem", "moesp"]


@dataclass(frozen=True, slots=True)
class Estimate:
    """A model of motor torque to motor velocity with its modes."""

    model: StateSpace
    continuous: ContinuousStateSpace | None  # None: there is none
    response: FrequencyResponse | None  # of the latter at `LINES_HZ`
    anti_resonance: Mode | None
    resonance: Mode | None


@dataclass(frozen=True, slots=True)
class Errors:
    """How far an estimate is from the truth; NaN where it has no such thing."""

    anti_resonance_percent: float
    resonance_percent: float
    response_db: float  # root mean square over `JUDGED_HZ`, logarithmic in frequency


def stretch(decoupled: Decoupled, *, inputs: int = 2, outputs: int = 2) -> InputOutput:
    """A joint's record as the estimators want it: smooth and thinned.

    Parameters
    ----------
    decoupled : Decoupled
    inputs, outputs : int
        How many to keep.

    Returns
    -------
    InputOutput
    """
    T = decoupled.sample_time
    first: Hold = "first"
    every = max(1, round(STEP / T))
    edge = round(_EDGE / T)
    rows = slice(edge, -edge, every)
    return InputOutput(
        low_pass(decoupled.inputs[:, :inputs], BANDWIDTH_HZ, T)[rows],
        low_pass(decoupled.outputs[:, :outputs], BANDWIDTH_HZ, T)[rows],
        every * T,
        hold=(first,) * inputs,
    )


def estimate(
    *records: Decoupled,
    way: Way = "pem",
    inputs: int = 2,
    outputs: int = 2,
    start: StateSpace | None = None,
) -> Estimate:
    """A third-order model of one joint.

    Parameters
    ----------
    records : Decoupled
    way : "pem" or "moesp"
    inputs : int
        1 leaves the interaction torque out.
    outputs : int
        1 leaves the link velocity out.
    start : StateSpace, optional
        Of PEM; None: from subspace methods.

    Returns
    -------
    Estimate
    """
    data = without_means([stretch(record, inputs=inputs, outputs=outputs) for record in records])
    if way == "pem":
        model = pem(data, None if start else MODEL_ORDER, start=start)
    else:
        model = subspace(data, MODEL_ORDER, method="moesp")
    try:
        continuous = to_continuous(model)
        found = modes(model, 0, 0)
        response = frequency_response(continuous, LINES_HZ)
    except (NotIdentifiable, NumericalFailure):  # a model that no continuous-time joint has
        return Estimate(model, None, None, None, None)
    return Estimate(model, continuous, response, found.anti_resonance, found.resonance)


def response_of(joint: TwoInertia, frequencies_hz: FloatArray = LINES_HZ) -> FrequencyResponse:
    """Of a joint with known parameters.

    Parameters
    ----------
    joint : TwoInertia
    frequencies_hz : (n_frequencies,)

    Returns
    -------
    FrequencyResponse
    """
    A, B, C = state_space(joint)
    return frequency_response(ContinuousStateSpace(A, B, C, np.zeros((2, 2))), frequencies_hz)


def errors_of(found: Estimate, truth: TwoInertia) -> Errors:
    """Against the truth.

    Parameters
    ----------
    found : Estimate
    truth : TwoInertia

    Returns
    -------
    Errors
    """
    db = float("nan")
    if found.response is not None:
        db = distance_db(found.response.response[:, 0, 0], response_of(truth).response[:, 0, 0])
    return Errors(
        _off(found.anti_resonance, true_anti_resonance(truth)),
        _off(found.resonance, true_resonance(truth)),
        db,
    )


def distance_db(
    one: ComplexArray,
    other: ComplexArray,
    frequencies_hz: FloatArray = LINES_HZ,
    band_hz: tuple[float, float] = JUDGED_HZ,
) -> float:
    """Root mean square of two responses' difference in magnitude, logarithmic in frequency.

    Parameters
    ----------
    one, other : (n_frequencies,)
    frequencies_hz : (n_frequencies,)
        Evenly spaced in their logarithm.
    band_hz : (float, float)

    Returns
    -------
    float [dB]
    """
    judged = (frequencies_hz >= band_hz[0]) & (frequencies_hz <= band_hz[1])
    ratio = 20.0 * np.log10(np.abs(one[judged]) / np.abs(other[judged]))
    return float(np.sqrt(np.mean(ratio**2)))


def curve(
    name: str, response: FrequencyResponse, *, true: bool = False, band: bool = False
) -> list[Curve]:
    """Motor torque to motor velocity for a figure.

    Parameters
    ----------
    name : str
    response : FrequencyResponse
    true : bool
        Of the truth.
    band : bool
        With its 95 % band, if it has a covariance.

    Returns
    -------
    list of Curve
        One.
    """
    size = response.magnitude_std if band else None
    angle = response.phase_std if band else None
    return [
        Curve(
            name,
            response.frequencies_hz,
            response.response[:, 0, 0],
            None if size is None else size[:, 0, 0],
            None if angle is None else angle[:, 0, 0],
            true=true,
        )
    ]


def estimated_curve(name: str, found: Estimate, *, band: bool = False) -> list[Curve]:
    """As `curve`, of an estimate; empty where it has no response.

    Parameters
    ----------
    name : str
    found : Estimate
    band : bool

    Returns
    -------
    list of Curve
    """
    return [] if found.response is None else curve(name, found.response, band=band)


def _off(found: Mode | None, true: Mode) -> float:
    if found is None:
        return float("nan")
    return 100.0 * (found.frequency_hz / true.frequency_hz - 1.0)
