"""State-space models of a decoupled joint by the product's own step, and how far they are off."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from strainwave.domain import (
    ArmModel,
    ComplexArray,
    ContinuousStateSpace,
    Criterion,
    Decoupled,
    Diagnostic,
    Evidence,
    FloatArray,
    FrequencyResponse,
    JointModel,
    LinearOptions,
    Mode,
    StateSpace,
)
from strainwave.dynamics.two_inertia import TwoInertia, state_space
from strainwave.dynamics.two_inertia import anti_resonance as true_anti_resonance
from strainwave.dynamics.two_inertia import resonance as true_resonance
from strainwave.errors import NumericalFailure, StrainwaveError
from strainwave.identification.joint_model import modes_of, state_space_of
from strainwave.identification.joint_model.linear import without_alternating
from strainwave.presentation.figures.curves import Curve
from strainwave.statespace import frequency_response, to_continuous

LINES_HZ = np.geomspace(1.0, 100.0, 240)
JUDGED_HZ = (3.0, 60.0)  # where errors of responses are taken: around dip and peak
CLOSE_PERCENT = 5.0
_STEP = 1e-3  # [s] over which a physical model's growth is taken
CLOSE = "5 % in a frequency are 10 % in a stiffness, as which a parameter counts as well known"


@dataclass(frozen=True, slots=True)
class Estimate:
    """A model of motor torque to motor velocity with its modes."""

    evidence: Evidence
    model: StateSpace | None  # None: the estimation failed
    continuous: ContinuousStateSpace | None = None  # None: there is none
    response: FrequencyResponse | None = None  # of the latter at `LINES_HZ`
    anti_resonance: Mode | None = None
    resonance: Mode | None = None


@dataclass(frozen=True, slots=True)
class Errors:
    """How far an estimate is from the truth; infinite where it has no such thing."""

    anti_resonance_percent: float
    resonance_percent: float
    response_db: float  # root mean square over `JUDGED_HZ`, logarithmic in frequency

    @property
    def worst_percent(self) -> float:
        """The larger error of the two frequencies."""
        return max(abs(self.anti_resonance_percent), abs(self.resonance_percent))


def estimate(records: Sequence[Decoupled], options: LinearOptions, name: str) -> Estimate:
    """A model of one joint by `physical.state_space_of`, as `identify` makes it.

    `name`: Of the model, for whoever reads its status. Returns: With the model's status and
    warnings; where the estimation failed, with the reason.
    """
    try:
        model = state_space_of(records, options)
    except (StrainwaveError, np.linalg.LinAlgError) as problem:
        said = Diagnostic("state-space-failed", name, str(problem))
        return Estimate(Evidence(name, options.method, "failed", warnings=(said,)), None)
    evidence = Evidence(
        name,
        options.method,
        model.status,
        order=model.order,
        growth=float(np.abs(np.linalg.eigvals(model.A)).max()),
        warnings=model.warnings,
    )
    try:
        found = modes_of(model)
        continuous = to_continuous(without_alternating(model))
        response = frequency_response(continuous, LINES_HZ)
    except (StrainwaveError, NumericalFailure, np.linalg.LinAlgError) as problem:
        said = Diagnostic("modes-failed", name, str(problem))
        return Estimate(replace(evidence, warnings=(*model.warnings, said)), model)
    return Estimate(evidence, model, continuous, response, found.anti_resonance, found.resonance)


def evidence_of(model: JointModel | ArmModel, name: str) -> Evidence:
    """Status and warnings of a physical model."""
    method = model.method if isinstance(model, JointModel) else "whole-arm fit"
    return Evidence(name, method, model.status, warnings=model.warnings)


def response_evidence(model: JointModel, joint: TwoInertia, name: str) -> Evidence:
    """Of a physical model of which only the response counts, not each parameter by itself.

    `joint`: Its parameters.
    """
    return replace(evidence_of(model, name), growth=growth_of(joint))


def growth_of(joint: TwoInertia) -> float:
    """Largest modulus of a joint's poles, sampled every millisecond."""
    slowest = float(np.linalg.eigvals(state_space(joint)[0]).real.max())
    return float(np.exp(slowest * _STEP))


def close(name: str, percent: float, otherwise: str = "") -> Criterion:
    """That an error of a frequency is small.

    `otherwise`: Why it is not, where it is not.
    """
    return Criterion(name, abs(percent), "at most", CLOSE_PERCENT, CLOSE, otherwise)


def far(name: str, percent: float, otherwise: str = "") -> Criterion:
    """That an error of a frequency is not small; a missing frequency is the largest error.

    `otherwise`: Why it is small, where it is.
    """
    return Criterion(name, abs(percent), "at least", CLOSE_PERCENT, CLOSE, otherwise)


def response_of(joint: TwoInertia, frequencies_hz: FloatArray = LINES_HZ) -> FrequencyResponse:
    """Of a joint with known parameters.

    `frequencies_hz` (n_frequencies,).
    """
    A, B, C = state_space(joint)
    return frequency_response(ContinuousStateSpace(A, B, C, np.zeros((2, 2))), frequencies_hz)


def errors_of(found: Estimate, truth: TwoInertia) -> Errors:
    """Against the truth."""
    db = float("inf")
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

    `one`, `other` (n_frequencies,). `frequencies_hz` (n_frequencies,): Evenly spaced in their
    logarithm. `band_hz` (float, float). Returns [dB].
    """
    judged = (frequencies_hz >= band_hz[0]) & (frequencies_hz <= band_hz[1])
    ratio = 20.0 * np.log10(np.abs(one[judged]) / np.abs(other[judged]))
    return float(np.sqrt(np.mean(ratio**2)))


def curve(
    name: str, response: FrequencyResponse, *, true: bool = False, band: bool = False
) -> list[Curve]:
    """Motor torque to motor velocity for a figure.

    `true`: Of the truth. `band`: With its 95 % band, if it has a covariance. Returns: One.
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

    `name`: What is wrong with the model is added to it.
    """
    if found.response is None:
        return []
    sound = found.evidence.sound
    return curve(name if sound else f"{name} (not sound)", found.response, band=band and sound)


def _off(found: Mode | None, true: Mode) -> float:
    if found is None:
        return float("inf")
    return 100.0 * (found.frequency_hz / true.frequency_hz - 1.0)
