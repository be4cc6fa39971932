"""Entries of result.json, in the layout of docs/result.md.

Each entry is declared once: pydantic makes it from the attributes of a record, and reads it back
from JSON. Numbers that are not finite become null. Keys that this version does not know are
ignored when they are read.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import AliasPath, BaseModel, BeforeValidator, ConfigDict, Field, WrapSerializer

from strainwave.domain import (
    Correction,
    FloatArray,
    FrictionTerm,
    Parameter,
    PublishedWarning,
    Stage,
    Status,
    Validation,
)
from strainwave.domain.keys import Key, label_of

_RESPONSE_DIGITS = 6  # significant digits of a published response; its noise exceeds 1e-6


def short(values: FloatArray) -> list[Any]:
    """An array as lists of numbers with `_RESPONSE_DIGITS` digits."""
    if values.ndim > 1:
        return [short(each) for each in values]
    return [float(f"{value:.{_RESPONSE_DIGITS}g}") for value in values.tolist()]


def _from_array(convert: Callable[[FloatArray], list[Any]]) -> BeforeValidator:
    return BeforeValidator(lambda value: convert(value) if isinstance(value, np.ndarray) else value)


def _key_of(label: Any) -> Any:
    """Name and joint of a label such as "gear_stiffness 1"."""
    if not isinstance(label, str):
        return label
    name, _, joint = label.rpartition(" ")
    return (name, int(joint)) if name and joint.isdecimal() else (label, None)


def _omitting(**empty: Any) -> WrapSerializer:
    """Leave out keys that have these values."""
    return WrapSerializer(
        lambda value, write: {
            name: entry
            for name, entry in write(value).items()
            if name not in empty or entry != empty[name]
        }
    )


def _published(warning: Any) -> Any:
    if hasattr(warning, "clause"):
        return PublishedWarning(warning.code, warning.where, warning.message, warning.experiments)
    return warning


Numbers = Annotated[list[float], _from_array(np.ndarray.tolist)]
NumberRows = Annotated[list[list[float]], _from_array(np.ndarray.tolist)]
Rounded = Annotated[list[float | None], _from_array(short)]
Fits = Mapping[str, float | None]  # by channel
Label = Annotated[
    Key, BeforeValidator(_key_of), WrapSerializer(lambda key, _: label_of(*key), return_type=str)
]
ParameterEntry = Annotated[Parameter, _omitting(model_std=None, per=None)]
Warned = Annotated[PublishedWarning, BeforeValidator(_published), _omitting(experiments=[])]


class _Source:
    """The attributes of a record, and computed ones in addition or instead."""

    def __init__(self, record: Any, computed: Mapping[str, Any]) -> None:
        self._record = record
        self.__dict__.update(computed)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._record, name)


class Entry(BaseModel):
    """An entry that is made from the attributes of a record, or from JSON."""

    # validators are built when they are first used
    model_config = ConfigDict(from_attributes=True, populate_by_name=True, defer_build=True)

    @classmethod
    def of(cls, record: Any, **computed: Any) -> Self:
        """The entry of a record; `computed` adds or replaces attributes."""
        return cls.model_validate(_Source(record, computed))


def _at(*attributes: str) -> Any:
    """A field from an attribute of an attribute, or null."""
    return Field(None, validation_alias=AliasPath(*attributes))


class Resonances(Entry):
    """Modes of motor torque to motor velocity."""

    anti_resonance_hz: float | None = _at("anti_resonance", "frequency_hz")
    anti_resonance_std_hz: float | None = _at("anti_resonance", "frequency_std_hz")
    anti_resonance_damping: float | None = _at("anti_resonance", "damping")
    resonance_hz: float | None = _at("resonance", "frequency_hz")
    resonance_std_hz: float | None = _at("resonance", "frequency_std_hz")
    resonance_damping: float | None = _at("resonance", "damping")


class JointEntry(Resonances):
    """The physical model of a joint, from all its records or by (17), (18)."""

    experiments: tuple[str, ...] | None = None
    joint: int
    method: str | None
    order: int | None = 3
    status: str
    band_hz: tuple[float, float] | None = None
    parameters: tuple[ParameterEntry, ...] = ()
    warnings: tuple[Warned, ...] = ()
    fit_percent: Fits | tuple[float, ...] | None  # of a record: of each output


class HeldOutEntry(Entry):
    """A state-space model fitted to the first part of a record, on the rest."""

    fit_percent: tuple[float, ...]
    prediction_fit_percent: tuple[float, ...]
    tests: tuple[Any, ...]


class StateSpaceEntry(Resonances):
    """The state-space model of one record."""

    A: NumberRows
    B: NumberRows
    C: NumberRows
    D: NumberRows
    K: NumberRows
    sample_time: float
    method: str
    order: int
    status: str
    hold: tuple[str, ...]
    input_names: tuple[str, ...]
    output_names: tuple[str, ...]
    prediction_fit_percent: tuple[float, ...]
    warnings: tuple[Warned, ...]
    fit_percent: tuple[float, ...] | None
    held_out: HeldOutEntry | None = None


class RecordEntry(JointEntry):
    """All models of the joint that is excited in one record."""

    experiment: str
    equation_fit_percent: Fits | None = None
    state_space: StateSpaceEntry | None = None
    transfer_function: JointEntry | None = None
    checks: tuple[Any, ...] | None = None


class TorsionEntry(Entry):
    """Stiffness of a gear from its torsion in slow motion."""

    joint: int
    experiments: tuple[str, ...]
    fit_percent: float
    parameters: Annotated[
        tuple[ParameterEntry, ...],
        BeforeValidator(lambda p: (p,) if isinstance(p, Parameter) else p),
    ] = Field(validation_alias="stiffness")


class ChannelResponse(Entry):
    """Response of one output to one input."""

    output: str
    input: str
    re: Rounded
    im: Rounded
    noise_variance: Rounded | None
    distortion_variance: Rounded | None


class ResponseEntry(Entry):
    """Nonparametric response of a joint."""

    joint: int
    experiments: tuple[str, ...]
    method: Literal["model", "periods", "welch"]
    n_averages: int
    frequency_hz: Rounded = Field(validation_alias="frequencies_hz")
    channels: tuple[ChannelResponse, ...]
    coherence: Mapping[str, Rounded]


class MotorResponseEntry(Entry):
    """Measured and fitted response of one driven motor."""

    experiment: str
    joint: int
    condition: str
    coherence: Rounded
    frequency_hz: Rounded = Field(validation_alias="frequencies_hz")
    measured_re: Rounded = _at("measured", "real")
    measured_im: Rounded = _at("measured", "imag")
    fitted_re: Rounded = _at("fitted", "real")
    fitted_im: Rounded = _at("fitted", "imag")
    anti_resonance_hz: tuple[float, ...] = Field(validation_alias="anti_resonances_hz")
    resonance_hz: tuple[float, ...] = Field(validation_alias="resonances_hz")


class JointValue(Entry):
    """A number of a joint."""

    joint: int
    value: float


class TorqueRatio(JointValue):
    """Torque of joint 1 over that of a joint, relative to the symmetry of the inertia matrix."""

    std: float


class _EstimateEntry(Entry):
    """A parameter with further keys."""

    name: str
    value: float | None
    std: float | None
    ci95: tuple[float, float] | None
    model_std: float | None = None
    unit: str
    stage: Stage


class FrictionEntry(_EstimateEntry):
    """Size or shape of friction in addition to viscous and Coulomb friction."""

    joint: int | None
    effect: str
    changes: Mapping[str, float]


class PredictionEntry(Entry):
    """What predictions and exports use of the rigid model."""

    solution: Numbers
    friction_terms: tuple[FrictionTerm, ...]
    motion: Annotated[list[list[list[float]]], _from_array(short)]


class RigidEntry(Entry):
    """The rigid model."""

    status: Literal["determined", "partly-determined", "not-identifiable"]
    parameters: tuple[ParameterEntry, ...]
    fit_percent: Mapping[str, Fits] = {}
    condition_number: float | None = None
    bandwidth_hz: float
    decimation: int
    n_rows: int
    friction_terms: tuple[Annotated[FrictionEntry, _omitting(model_std=None, per=None)], ...] = ()
    torque_ratio: TorqueRatio | None = None
    torque_ratios: tuple[TorqueRatio, ...] = ()
    torque_errors: tuple[JointValue, ...] = ()
    prediction: PredictionEntry | None = None


class ChannelNoise(Entry):
    """Noise of the samples of one channel; results of earlier versions do not have it."""

    channel: str
    sample_noise: float | None = None


class ResidualEntry(ChannelNoise):
    """Residual of one channel in one record, without its spectrum."""

    experiment: str
    deviation: float
    noise: float
    worst_hz: float | None
    whiteness: float | None
    input_joint: int
    input_correlation: float | None
    input_delay: float | None
    input_probability: float | None


class CauseEntry(Entry):
    """Effect that the model includes, or that a plausible model has in addition."""

    joint: int
    effect: str
    parameters: tuple[ParameterEntry, ...]
    gain: float
    share: float
    shifts: tuple[Any, ...]
    weight: float
    is_included: bool
    is_linearised: bool


class CriticismEntry(Entry):
    """Residual analysis of the whole-arm fit."""

    residuals: tuple[ResidualEntry, ...]
    causes: tuple[CauseEntry, ...]


class ArmEntry(Entry):
    """The whole-arm fit."""

    status: str
    end: str
    iterations: int
    parameters: tuple[ParameterEntry, ...]
    fit_percent: Mapping[str, Fits]
    initial_fit_percent: Mapping[str, Fits]
    warnings: tuple[Warned, ...]
    correlations: list[list[float]] = []
    gear_laws: tuple[Any, ...]
    sensor_gains: tuple[Any, ...]
    criticism: CriticismEntry | None = None
    motor_responses: tuple[MotorResponseEntry, ...] = ()


class StagesEntry(Entry):
    """Results of the stages that were reached."""

    rigid: RigidEntry | None = None
    decoupled: (
        tuple[Annotated[RecordEntry, _omitting(experiments=None, band_hz=None, checks=None)], ...]
        | None
    ) = None
    joints: tuple[JointEntry, ...] | None = None
    torsions: tuple[TorsionEntry, ...] | None = None
    sweeps: tuple[Any, ...] | None = None
    links: tuple[Any, ...] | None = None
    responses: tuple[ResponseEntry, ...] | None = None
    tuned: ArmEntry | None = None


class SuspicionEntry(Entry):
    """Suspected fault of the input."""

    code: str
    where: str = ""
    message: str
    remedy: str
    factor: float | None = None
    delay_s: float | None = None
    accepted: bool = False
    corrections: tuple[Correction, ...] = ()


Suspected = Annotated[SuspicionEntry, _omitting(factor=None, delay_s=None, accepted=False)]


class VerdictEntry(Entry):
    """The verdict; the file has the status next to it."""

    status: Status = Field(exclude=True)
    identified: tuple[Label, ...]
    not_identified: tuple[Label, ...]
    rejected: tuple[Label, ...]
    validated: Validation
    suspected: tuple[Suspected, ...] = ()
    reasons: tuple[str, ...] | None = None  # None in results of earlier versions


class CovarianceEntry(Entry):
    """Joint covariance of the final table."""

    stage: Stage
    names: tuple[str, ...]
    matrix: NumberRows


class BaseParameterEntry(_EstimateEntry):
    """A base parameter under its name in the literature."""

    combination: Mapping[str, float]


class CheckEntry(Entry):
    """Fit of one validation record."""

    experiment: str
    fit_percent: Fits


class EstimatesEntry(Entry):
    """Parameters, and those of serial arms under their names in the literature."""

    parameters: tuple[ParameterEntry, ...]
    base_parameters: tuple[Annotated[BaseParameterEntry, _omitting(model_std=None, per=None)], ...]


class ResultEntry(EstimatesEntry):
    """The whole file."""

    schema_: str = Field(serialization_alias="schema")
    version: str
    study: Mapping[str, Any]
    created: str
    options: Any
    status: Status
    reason: str | None
    verdict: VerdictEntry
    covariance: CovarianceEntry | None
    standard_parameters: Mapping[str, float] | None
    stages: Annotated[StagesEntry, _omitting(**dict.fromkeys(StagesEntry.model_fields))]
    checks: tuple[CheckEntry, ...]
    warnings: tuple[Warned, ...]
    timing_s: Mapping[str, float]


class RelationEntry(Entry):
    """A number that the channels and the study determine."""

    relation: str = Field(validation_alias="kind")
    where: str
    measured: float
    std: float
    expected: float | None
    accuracy: float
    bound: str
    consistent: bool = Field(validation_alias="is_consistent")


class InputCheckEntry(Entry):
    """The object of `strainwave check --json`."""

    schema_: str = Field(serialization_alias="schema")
    version: str
    study: Mapping[str, str]
    status: str
    relations: tuple[RelationEntry, ...]
    suspected: tuple[Suspected, ...]
    unchecked: tuple[str, ...]
    warnings: tuple[Warned, ...]
    seconds: float
