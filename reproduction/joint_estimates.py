"""State-space models of a decoupled joint as `identify` estimates them, and their errors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from reproduction.records import Evidence
from strainwave.domain import (
    ArmModel,
    ComplexArray,
    ContinuousStateSpace,
    Decoupled,
    Diagnostic,
    FloatArray,
    FrequencyResponse,
    JointModel,
    LinearOptions,
    Mode,
    Place,
    StateSpace,
)
from strainwave.dynamics.two_inertia import TwoInertia, state_space
from strainwave.dynamics.two_inertia import anti_resonance as true_anti_resonance
from strainwave.dynamics.two_inertia import resonance as true_resonance
from strainwave.errors import NumericalFailure, StrainwaveError
from strainwave.identification.joint_model import modes_of, state_space_of
from strainwave.report.figures.curves import Curve
from strainwave.statespace import frequency_response, remove_alternating_poles, to_continuous

LINES_HZ = np.geomspace(1.0, 100.0, 240)  # of frequency responses
JUDGED_HZ = (3.0, 60.0)  # band of response errors: around anti-resonance and resonance
_GROWTH_SAMPLE_TIME = 1e-3  # [s] of the discrete-time poles of a physical model


@dataclass(frozen=True, slots=True)
class JointEstimate:
    """A model of motor torque to motor velocity with its modes."""

    evidence: Evidence
    model: StateSpace | None  # None: the estimation failed
    continuous: ContinuousStateSpace | None = None  # None: does not exist
    response: FrequencyResponse | None = None  # of `continuous` at `LINES_HZ`
    anti_resonance: Mode | None = None
    resonance: Mode | None = None


@dataclass(frozen=True, slots=True)
class JointErrors:
    """Errors of an estimate; infinite if the estimate lacks the quantity."""

    anti_resonance_percent: float
    resonance_percent: float
    response_db: float  # root mean square over `JUDGED_HZ`, logarithmic in frequency

    @property
    def worst_percent(self) -> float:
        """Larger error of the two frequencies."""
        return max(abs(self.anti_resonance_percent), abs(self.resonance_percent))


def estimate(records: Sequence[Decoupled], options: LinearOptions, name: str) -> JointEstimate:
    """State-space model of one joint as `identify` estimates it, with status and warnings.

    `name` identifies the model. If the estimation fails, the evidence holds the reason.
    """
    try:
        model = state_space_of(records, options)
    except (StrainwaveError, np.linalg.LinAlgError) as error:
        warning = Diagnostic("state-space-failed", Place(part=name), reason=str(error))
        return JointEstimate(Evidence(name, options.method, "failed", warnings=(warning,)), None)
    evidence = Evidence(
        name,
        options.method,
        model.status,
        order=model.order,
        growth=float(np.abs(np.linalg.eigvals(model.A)).max()),
        warnings=model.warnings,
    )
    try:
        modes = modes_of(model)
        continuous = to_continuous(remove_alternating_poles(model))
        response = frequency_response(continuous, LINES_HZ)
    except (StrainwaveError, NumericalFailure, np.linalg.LinAlgError) as error:
        warning = Diagnostic("modes-failed", Place(part=name), reason=str(error))
        return JointEstimate(replace(evidence, warnings=(*model.warnings, warning)), model)
    return JointEstimate(
        evidence, model, continuous, response, modes.anti_resonance, modes.resonance
    )


def evidence_of(model: JointModel | ArmModel, name: str) -> Evidence:
    """Status and warnings of a physical model."""
    method = model.method if isinstance(model, JointModel) else "whole-arm fit"
    return Evidence(name, method, model.status, warnings=model.warnings)


def growth_of(joint: TwoInertia) -> float:
    """Largest modulus of a joint's discrete-time poles at 1 ms."""
    slowest = float(np.linalg.eigvals(state_space(joint).A).real.max())
    return float(np.exp(slowest * _GROWTH_SAMPLE_TIME))


def response_of(joint: TwoInertia, frequencies_hz: FloatArray = LINES_HZ) -> FrequencyResponse:
    """Frequency response of a joint with known parameters."""
    return frequency_response(state_space(joint), frequencies_hz)


def errors_of(model: JointEstimate, truth: TwoInertia) -> JointErrors:
    """Errors of an estimate relative to the true joint."""
    db = float("inf")
    if model.response is not None:
        db = distance_db(model.response.response[:, 0, 0], response_of(truth).response[:, 0, 0])
    return JointErrors(
        _error_percent(model.anti_resonance, true_anti_resonance(truth)),
        _error_percent(model.resonance, true_resonance(truth)),
        db,
    )


def distance_db(
    first: ComplexArray,
    second: ComplexArray,
    frequencies_hz: FloatArray = LINES_HZ,
    band_hz: tuple[float, float] = JUDGED_HZ,
) -> float:
    """Root mean square [dB] of the magnitude ratio of two responses over a band.

    All arrays have shape (n_frequencies,). The frequencies are evenly spaced in their logarithm.
    """
    in_band = (frequencies_hz >= band_hz[0]) & (frequencies_hz <= band_hz[1])
    ratio = 20.0 * np.log10(np.abs(first[in_band]) / np.abs(second[in_band]))
    return float(np.sqrt(np.mean(ratio**2)))


def curve(
    name: str, response: FrequencyResponse, *, true: bool = False, band: bool = False
) -> list[Curve]:
    """Curve of motor torque to motor velocity for a figure, as a list.

    `true` marks the true response, `band` adds the 95 % band if there is a covariance.
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


def estimated_curve(name: str, model: JointEstimate, *, band: bool = False) -> list[Curve]:
    """Curve of an estimate; empty if it has no response. The name states whether it is sound."""
    if model.response is None:
        return []
    sound = model.evidence.sound
    return curve(name if sound else f"{name} (not sound)", model.response, band=band and sound)


def _error_percent(mode: Mode | None, true: Mode) -> float:
    if mode is None:
        return float("inf")
    return 100.0 * (mode.frequency_hz / true.frequency_hz - 1.0)
