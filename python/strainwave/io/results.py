"""Identification -> result.json, and back to what that holds."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from strainwave.domain import (
    ArmModel,
    Criticism,
    Diagnostic,
    FloatArray,
    FrequencyResponse,
    Identification,
    JointModel,
    Mode,
    ModelCheck,
    Modes,
    MotorResponse,
    Parameter,
    RecordModel,
    RigidModel,
    StateSpace,
    Suspicion,
    Validated,
    Verdict,
)
from strainwave.errors import InvalidInput
from strainwave.io.atomic_files import decode, read_bytes
from strainwave.io.joint_covariance import covariance_document, joint_covariance

Record = TypeVar("Record")

SCHEMA = "strainwave/result/1"
NOT_A_RESULT = "give a result.json that strainwave identify has written"
"""What to do about a file that is none."""

_NUMBERS = re.compile(r'\[\n\s*([^][{}"]+?)\n\s*\]')  # strings hold no line ends in JSON
_OUTSIDE = 3.0  # how far beyond the band of a joint's fit its responses are given
_MOST_LINES = 500  # of one response
_DIGITS = 6  # of their numbers
_INPUTS = ("motor_torque", "interaction_torque")
_OUTPUTS = ("motor_velocity", "link_velocity")


def to_document(identification: Identification) -> dict[str, Any]:
    """The result as plain JSON values, in the layout of docs/result.md.

    Parameters
    ----------
    identification : Identification

    Returns
    -------
    dict
        Only dict, list, str, bool, int, finite float and None.
    """
    stages: dict[str, Any] = {}
    if identification.rigid is not None:
        stages["rigid"] = _rigid(identification.rigid)
    if "decoupled" in identification.stages:
        stages["decoupled"] = [_record(record) for record in identification.records]
        stages["decoupled"] += _of_motors(identification.joints)
        stages["joints"] = [_joint(joint) for joint in identification.joints]
        stages["sweeps"] = [asdict(sweep) for sweep in identification.sweeps]
        stages["links"] = [asdict(link) for link in identification.links]
        stages["responses"] = _responses(identification)
    if identification.tuned is not None:
        stages["tuned"] = _tuned(identification.tuned)
        stages["tuned"]["motor_responses"] = [
            _motor_response(each) for each in identification.motor_responses
        ]
    verdict = identification.verdict
    document = {
        "schema": SCHEMA,
        "version": identification.version,
        "study": {"path": str(identification.study.path), "sha256": identification.study.sha256},
        "created": identification.created,
        "options": asdict(identification.study.options),
        "status": verdict.status,
        "reason": "; ".join(verdict.reasons) or None,
        "verdict": _verdict(verdict),
        "parameters": [_parameter(p) for p in identification.parameters],
        "covariance": covariance_document(joint_covariance(identification)),
        "stages": stages,
        "checks": [
            {"experiment": name, "fit_percent": fits}
            for name, fits in _check_fits(identification).items()
        ],
        "warnings": [_warning(w) for w in identification.warnings],
        "timing_s": dict(identification.timing_s),
    }
    finite: dict[str, Any] = _finite(document)
    return finite


def to_json(document: Mapping[str, Any]) -> bytes:
    """A result's document as UTF-8 text that ends with a newline.

    Parameters
    ----------
    document : mapping
        As `to_document` gives it.

    Returns
    -------
    bytes
    """
    text = json.dumps(document, indent=2, ensure_ascii=False, allow_nan=False)
    return (_NUMBERS.sub(_on_one_line, text) + "\n").encode()


def read_document(path: Path) -> dict[str, Any]:
    """A result.json as plain JSON values.

    Parameters
    ----------
    path : Path

    Returns
    -------
    dict
        In the layout of docs/result.md.

    Raises
    ------
    InvalidInput
        The file is missing, or no result of `strainwave identify`.
    """
    text = decode(read_bytes(path, "the result"), path)
    try:
        document = json.loads(text)
    except (json.JSONDecodeError, RecursionError) as error:
        raise InvalidInput(
            f"is not JSON ({error})", where=str(path), remedy=NOT_A_RESULT
        ) from error
    schema = document.get("schema") if isinstance(document, dict) else None
    if schema != SCHEMA:
        said = 'has no key "schema"' if schema is None else f"has the schema {schema!r}"
        raise InvalidInput(
            f"{said}; this version reads {SCHEMA!r}", where=str(path), remedy=NOT_A_RESULT
        )
    return dict(document)


def parameters_of(document: Mapping[str, Any]) -> tuple[Parameter, ...]:
    """The final table of a result.

    Parameters
    ----------
    document : mapping
        As `to_document` gives it.

    Returns
    -------
    tuple of Parameter

    Raises
    ------
    InvalidInput
        An entry lacks a key.
    """
    return tuple(_read(Parameter, each, "parameters") for each in document.get("parameters", ()))


def warnings_of(document: Mapping[str, Any]) -> tuple[Diagnostic, ...]:
    """The warnings of a result.

    Parameters
    ----------
    document : mapping
        As `to_document` gives it.

    Returns
    -------
    tuple of Diagnostic

    Raises
    ------
    InvalidInput
        An entry lacks a key.
    """
    return tuple(_read(Diagnostic, each, "warnings") for each in document.get("warnings", ()))


def verdict_of(document: Mapping[str, Any]) -> Verdict:
    """The verdict of a result.

    Parameters
    ----------
    document : mapping
        As `to_document` gives it.

    Returns
    -------
    Verdict

    Raises
    ------
    InvalidInput
        The result has none, or one that lacks a key.
    """
    own = dict(document.get("verdict", {}))
    own["validated"] = _read(Validated, own.get("validated", {}), "verdict.validated")
    own["suspected"] = tuple(
        _read(Suspicion, each, "verdict.suspected") for each in own.get("suspected", ())
    )
    reason = document.get("reason")
    own["status"] = document.get("status")
    own["reasons"] = tuple(reason.split("; ")) if reason else ()
    return _read(Verdict, own, "verdict")


def _read(kind: type[Record], table: Mapping[str, Any], place: str) -> Record:
    """A record from a JSON table, whose lists become tuples; keys of later versions are passed."""
    known = {
        field.name: tuple(value) if isinstance(value, list) else value
        for field in fields(kind)  # type: ignore[arg-type]
        if (value := table.get(field.name)) is not None or field.name in table
    }
    try:
        return kind(**known)
    except TypeError as error:
        raise InvalidInput(
            f"{place} is incomplete ({error})", where="the result", remedy=NOT_A_RESULT
        ) from error


def _on_one_line(numbers: re.Match[str]) -> str:
    return f"[{' '.join(numbers[1].split())}]"


def _responses(identification: Identification) -> list[dict[str, Any]]:
    """Nonparametric responses: of all records of a joint at full amplitude, then of each record."""
    found = [
        _response(identification.responses[joint.joint], joint.joint, joint.experiments, joint)
        for joint in identification.joints
        if joint.joint in identification.responses
    ]
    for record in identification.records:
        if record.response is not None:
            names = (record.signals.experiment.name,)
            found.append(
                _response(record.response, record.signals.joint, names, record.joint_model)
            )
    return found


def _response(
    response: FrequencyResponse, number: int, names: tuple[str, ...], joint: JointModel | None
) -> dict[str, Any]:
    low, high = joint.band_hz if joint else (0.0, math.inf)
    seen = response.between(low / _OUTSIDE, high * _OUTSIDE, _MOST_LINES)
    _, n_out, n_in = seen.response.shape
    channels = []
    for o, output in enumerate(_OUTPUTS[:n_out]):
        for i, name in enumerate(_INPUTS[:n_in]):
            G = seen.response[:, o, i]
            channel: dict[str, Any] = {"output": output, "input": name}
            channel |= {"re": _short(G.real), "im": _short(G.imag)}
            for part in ("noise_variance", "distortion_variance"):
                variance = getattr(seen, part)
                channel[part] = None if variance is None else _short(variance[:, o, i])
            channels.append(channel)
    coherence = {
        output: _short(seen.coherence[:, o])
        for o, output in enumerate(_OUTPUTS[:n_out])
        if seen.coherence is not None
    }
    return {
        "joint": number,
        "experiments": names,
        "method": seen.method,
        "n_averages": seen.n_averages,
        "frequency_hz": _short(seen.frequencies_hz),
        "channels": channels,
        "coherence": coherence,
    }


def _motor_response(seen: MotorResponse) -> dict[str, Any]:
    return {
        "experiment": seen.experiment,
        "joint": seen.joint,
        "condition": seen.condition,
        "frequency_hz": _short(seen.frequencies_hz),
        "measured_re": _short(seen.measured.real),
        "measured_im": _short(seen.measured.imag),
        "fitted_re": _short(seen.fitted.real),
        "fitted_im": _short(seen.fitted.imag),
        "coherence": _short(seen.coherence),
        "anti_resonance_hz": list(seen.anti_resonances_hz),
        "resonance_hz": list(seen.resonances_hz),
    }


def _short(values: FloatArray) -> list[float]:
    """Enough digits for what noise leaves of a response."""
    return [float(f"{value:.{_DIGITS}g}") for value in values.tolist()]


def _verdict(verdict: Verdict) -> dict[str, Any]:
    suspected = [
        {key: value for key, value in asdict(one).items() if value is not None}
        for one in verdict.suspected
    ]
    return {
        "identified": list(verdict.identified),
        "not_identified": list(verdict.not_identified),
        "rejected": list(verdict.rejected),
        "validated": asdict(verdict.validated),
        "suspected": suspected,
    }


def _rigid(model: RigidModel) -> dict[str, Any]:
    return {
        "status": model.status,
        "parameters": [_parameter(p) for p in model.parameters],
        "fit_percent": {name: dict(fits) for name, fits in model.fit_percent.items()},
        "condition_number": model.condition_number,
        "bandwidth_hz": model.bandwidth_hz,
        "decimation": model.decimation,
        "n_rows": model.n_rows,
        "load_friction": [_parameter(p) for p in model.load_friction],
        "torque_ratio": model.torque_ratio
        and dict(zip(("value", "std"), model.torque_ratio, strict=True)),
    }


def _check_fits(identification: Identification) -> dict[str, dict[str, float]]:
    """Fits by record: torques by the rigid model, motion by the tuned arm."""
    found: dict[str, dict[str, float]] = {}
    for check in identification.checks:
        found.setdefault(check.experiment, {}).update(check.fit_percent)
    return found


def _record(record: RecordModel) -> dict[str, Any]:
    """One excited record: the physical model, and the state-space model beside it."""
    chosen = record.joint_model
    own = _nothing(record) if chosen is None else _joint(chosen)
    own["experiment"] = record.signals.experiment.name
    own["equation_fit_percent"] = own.pop("fit_percent")
    own["fit_percent"] = record.state_space and _simulated_fit(record.state_space)
    own["state_space"] = None
    if record.state_space is not None:
        own["state_space"] = _state_space(record.state_space, record.modes)
        own["state_space"]["held_out"] = None if record.check is None else _check(record.check)
    own["transfer_function"] = None if record.transfer is None else _joint(record.transfer)
    own["checks"] = [asdict(check) for check in record.signals.checks]
    own["warnings"] += [_warning(w) for w in record.warnings]
    return own


def _check(check: ModelCheck) -> dict[str, Any]:
    """Fits and tests of residuals on data that were not fitted."""
    return {
        "fit_percent": check.fit_percent,
        "prediction_fit_percent": check.prediction_fit_percent,
        "tests": [asdict(test) for test in check.tests],
    }


def _of_motors(joints: Sequence[JointModel]) -> list[dict[str, Any]]:
    """One entry a record of joints modelled by their motors, all by the model of all records."""
    found = []
    for joint in joints:
        for name in joint.experiments if joint.method == "motor-response" else ():
            own = _joint(joint)
            own["experiment"] = name
            own["fit_percent"] = list(joint.fit_percent.values())
            own["state_space"] = own["transfer_function"] = None
            found.append(own)
    return found


def _nothing(record: RecordModel) -> dict[str, Any]:
    """A record without physical parameters: its state-space model's resonances, if any."""
    modes = record.modes
    return {
        "joint": record.signals.joint,
        "method": None if record.state_space is None else record.state_space.method,
        "order": None if record.state_space is None else record.state_space.order,
        "status": "not-identifiable",
        **_frequencies(
            None if modes is None else modes.anti_resonance,
            None if modes is None else modes.resonance,
        ),
        "fit_percent": None,
        "parameters": [],
        "warnings": [],
    }


def _joint(joint: JointModel) -> dict[str, Any]:
    return {
        "experiments": joint.experiments,
        "joint": joint.joint,
        "method": joint.method,
        "order": 3,
        "status": joint.status,
        **_frequencies(joint.anti_resonance, joint.resonance),
        "band_hz": joint.band_hz,
        "fit_percent": dict(joint.fit_percent),
        "parameters": [_parameter(p) for p in joint.parameters],
        "warnings": [_warning(w) for w in joint.warnings],
    }


def _frequencies(anti_resonance: Mode | None, resonance: Mode | None) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for name, mode in (("anti_resonance", anti_resonance), ("resonance", resonance)):
        found[f"{name}_hz"] = mode and mode.frequency_hz
        found[f"{name}_std_hz"] = mode and mode.frequency_std_hz
        found[f"{name}_damping"] = mode and mode.damping
    return found


def _state_space(model: StateSpace, modes: Modes | None) -> dict[str, Any]:
    matrices = {name: getattr(model, name).tolist() for name in ("A", "B", "C", "D", "K")}
    return {
        **matrices,
        "sample_time": model.sample_time,
        "method": model.method,
        "order": model.order,
        "status": model.status,
        "hold": model.hold,
        "input_names": model.input_names,
        "output_names": model.output_names,
        "fit_percent": _simulated_fit(model),
        "prediction_fit_percent": model.prediction_fit_percent,
        "warnings": [_warning(w) for w in model.warnings],
        **_frequencies(
            None if modes is None else modes.anti_resonance,
            None if modes is None else modes.resonance,
        ),
    }


def _simulated_fit(model: StateSpace) -> tuple[float, ...] | None:
    """A simulation that grows without end fits nothing."""
    unstable = any(warning.code == "unstable-model" for warning in model.warnings)
    return None if unstable else model.fit_percent


def _tuned(model: ArmModel) -> dict[str, Any]:
    return {
        "status": model.status,
        "iterations": model.iterations,
        "parameters": [_parameter(p) for p in model.parameters],
        "correlations": _correlations(model),
        "fit_percent": {name: dict(fits) for name, fits in model.fit_percent.items()},
        "initial_fit_percent": {
            name: dict(fits) for name, fits in model.initial_fit_percent.items()
        },
        "sensor_gains": [asdict(gain) for gain in model.sensor_gains],
        "criticism": model.criticism and _criticism(model.criticism),
        "warnings": [_warning(w) for w in model.warnings],
    }


def _criticism(criticism: Criticism) -> dict[str, Any]:
    plain = ("experiment", "channel", "deviation", "noise", "worst_hz", "whiteness")
    inputs = ("input_joint", "input_correlation", "input_delay", "input_probability")
    return {
        "residuals": [
            {name: getattr(test, name) for name in (*plain, *inputs)}
            for test in criticism.residuals
        ],
        "score_tests": [
            {
                "joint": one.joint,
                "effect": one.effect,
                "sizes": dict(one.sizes),
                "stds": dict(one.stds),
                "gain": one.gain,
                "share": one.share,
                "evident": one.evident,
                "shifts": [asdict(shift) for shift in one.shifts],
            }
            for one in criticism.score_tests
        ],
        "causes": [
            {
                "joint": cause.joint,
                "effect": cause.effect,
                "parameters": [_parameter(p) for p in cause.parameters],
                "gain": cause.gain,
                "share": cause.share,
                "shifts": [asdict(shift) for shift in cause.shifts],
            }
            for cause in criticism.causes
        ],
    }


def _correlations(model: ArmModel) -> list[list[float]]:
    """Between the parameters, in their order; nothing varies with what no record shows."""
    deviation = np.sqrt(np.diag(model.covariance))
    identified = np.isfinite(deviation)
    scale = np.where((deviation > 0.0) & identified, deviation, 1.0)
    covariance = np.where(np.outer(identified, identified), model.covariance, 0.0)
    correlations: list[list[float]] = (covariance / np.outer(scale, scale)).round(4).tolist()
    return correlations


def _parameter(parameter: Parameter) -> dict[str, Any]:
    return {
        "name": parameter.name,
        "joint": parameter.joint,
        "value": parameter.value,
        "std": parameter.std,
        "ci95": list(parameter.ci95) if parameter.ci95 is not None else None,
        "unit": parameter.unit,
        "stage": parameter.stage,
    }


def _warning(warning: Diagnostic) -> dict[str, Any]:
    shown = {"code": warning.code, "where": warning.where, "message": warning.message}
    return shown | ({"experiments": warning.experiments} if warning.experiments else {})


def _finite(value: Any) -> Any:
    """Numbers that JSON can hold; what is not finite is not known, and null."""
    if isinstance(value, dict):
        return {key: _finite(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(entry) for entry in value]
    if isinstance(value, float):  # also NumPy's float64
        return float(value) if math.isfinite(value) else None
    return value
