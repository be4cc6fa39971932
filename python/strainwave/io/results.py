"""result.json: an identification as plain JSON values, and records read back from it."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, fields, is_dataclass, replace
from functools import cache
from itertools import starmap
from pathlib import Path
from typing import Any, Literal, TypeVar

import numpy as np

from strainwave.domain import (
    ArmDescription,
    ArmModel,
    Clause,
    Correction,
    Diagnostic,
    FloatArray,
    FrequencyResponse,
    FrictionTerm,
    Identification,
    InputCheck,
    JointModel,
    Mode,
    Modes,
    MotorResponse,
    Parameter,
    Place,
    PublishedWarning,
    RecordModel,
    RigidModel,
    StateSpace,
    Status,
    Study,
    Suspicion,
    Validation,
    Verdict,
)
from strainwave.domain.base_parameters import MOTOR_INERTIA, base_parameters
from strainwave.domain.keys import Key, Values, label_of
from strainwave.errors import InvalidInput
from strainwave.io.atomic_files import read_json
from strainwave.io.base_parameters import (
    base_parameter_list,
    standard_name,
    standard_parameter_entries,
)
from strainwave.io.joint_covariance import joint_covariance
from strainwave.io.study import document_of
from strainwave.io.study.reader import Reader
from strainwave.version import __version__

T = TypeVar("T")

SCHEMA = "strainwave/result/1"
NOT_A_RESULT = "give a result.json that strainwave identify has written"
"""Remedy for a file that is not a result."""
FILE_NAME = "result.json"

_NUMBERS = re.compile(r'\[\n\s*([^][{}"]+?)\n\s*\]')  # JSON strings contain no line ends
_BAND_FACTOR = 3.0  # responses are published this far beyond the band of a joint's fit
_MAX_RESPONSE_LINES = 500  # frequencies of one published response
_RESPONSE_DIGITS = 6  # significant digits of a published response; its noise exceeds 1e-6
_INPUTS = ("motor_torque", "interaction_torque")
_OUTPUTS = ("motor_velocity", "link_velocity")
_DECISIONS = ("identified", "not_identified", "rejected")
_RIG_TABLES = ("arm", "joint", "transmission", "servo")  # of the study file, which results repeat


def to_document(identification: Identification) -> dict[str, Any]:
    """The result as plain JSON values in the layout of docs/result.md; numbers are finite."""
    stages: dict[str, Any] = {}
    if identification.rigid is not None:
        stages["rigid"] = _rigid(identification.rigid)
    if "decoupled" in identification.stages:
        stages["decoupled"] = [_record(record) for record in identification.records]
        stages["decoupled"] += _motor_response_entries(identification.joints)
        stages["joints"] = [_joint(joint) for joint in identification.joints]
        stages["torsions"] = [
            _entry(each, "joint experiments fit_percent") | {"parameters": [each.stiffness]}
            for each in identification.torsions
        ]
        stages["sweeps"] = identification.sweeps
        stages["links"] = identification.links
        stages["responses"] = _responses(identification)
    if identification.whole_arm is not None:
        stages["tuned"] = _whole_arm(identification.whole_arm)
        stages["tuned"]["motor_responses"] = [
            _motor_response(each) for each in identification.motor_responses
        ]
    verdict, covariance = identification.verdict, joint_covariance(identification)
    base = base_parameter_entries(identification.study.arm, identification.parameters)
    of_chain: dict[str, Any] = {}
    if base:
        standard = standard_parameter_entries(identification)
        of_chain = {"base_parameters": base, "standard_parameters": standard}
    # drive signals by the rigid model, motion by the elastic model
    fits: dict[str, dict[str, float]] = {}
    for check in identification.checks:
        fits.setdefault(check.experiment, {}).update(check.fit_percent)
    document = {
        "schema": SCHEMA,
        "version": identification.version,
        "study": _study(identification.study),
        "created": identification.created,
        "options": identification.study.options,
        "status": verdict.status,
        "reason": "; ".join(verdict.reasons) or None,
        "verdict": {
            **{name: [*starmap(label_of, getattr(verdict, name))] for name in _DECISIONS},
            "validated": verdict.validated,
            "suspected": suspicion_entries(verdict.suspected),
        },
        "parameters": identification.parameters,
        "covariance": covariance and _entry(covariance, "stage names matrix"),
        **of_chain,
        "stages": stages,
        "checks": [{"experiment": name, "fit_percent": fit} for name, fit in fits.items()],
        "warnings": identification.warnings,
        "timing_s": identification.timing_s,
    }
    values: dict[str, Any] = plain(document)
    return values


def check_document(check: InputCheck) -> dict[str, Any]:
    """An input check as plain JSON values, in the layout of docs/result.md."""
    relations = [
        {"relation": each.kind}
        | _entry(each, "where measured std expected accuracy bound")
        | {"consistent": each.is_consistent}
        for each in check.relations
    ]
    document = {
        "schema": "strainwave/check/1",
        "version": __version__,
        "study": {"path": str(check.study.path), "sha256": check.study.sha256},
        "status": check.status,
        "relations": relations,
        "suspected": suspicion_entries(check.suspected),
        **_entry(check, "unchecked warnings seconds"),
    }
    values: dict[str, Any] = plain(document)
    return values


def to_json(document: Mapping[str, Any]) -> bytes:
    """A result document as UTF-8 text; lists of numbers take one line each."""
    text = json.dumps(document, indent=2, ensure_ascii=False, allow_nan=False)
    text = _NUMBERS.sub(lambda numbers: f"[{' '.join(numbers[1].split())}]", text)
    return f"{text}\n".encode()


def read_document(path: Path) -> dict[str, Any]:
    """Read a result.json, or the one in a directory; `InvalidInput` if it is not a result."""
    path = result_path(path)
    document = read_json(path, "the result", NOT_A_RESULT)
    schema = document.get("schema") if isinstance(document, dict) else None
    if schema != SCHEMA:
        problem = 'has no key "schema"' if schema is None else f"has the schema {schema!r}"
        raise InvalidInput(
            f"{problem}; this version reads {SCHEMA!r}", where=str(path), remedy=NOT_A_RESULT
        )
    for name in ("study", "stages", "verdict"):
        if not isinstance(document.get(name, {}), dict):
            raise InvalidInput(f"'{name}' is not a table", where=str(path), remedy=NOT_A_RESULT)
    _validated(tuple[_CheckEntry, ...], document.get("checks", []), f"{path}: checks")
    return dict(document)


def result_path(path: Path) -> Path:
    """The result.json that a path names: the file itself, or the one in a directory."""
    return path / FILE_NAME if path.is_dir() else path


def study_of(document: Mapping[str, Any], path: Path) -> Study | None:
    """The rig as identified, without experiments; None in results of earlier versions."""
    tables = document.get("study")
    if not isinstance(tables, dict) or "arm" not in tables:
        return None
    rig = {name: tables[name] for name in _RIG_TABLES if name in tables}
    sha256 = str(tables.get("sha256", ""))
    study = Reader(path, "").study(rig, sha256, experiments_exist=False)
    return replace(study, path=Path(str(tables.get("path", path))))


def parameters_of(document: Mapping[str, Any], source: str = "the result") -> tuple[Parameter, ...]:
    """The final table of a result; `source` names it in messages."""
    place = f"{source}: parameters"
    entries = _validated(tuple[Parameter, ...], document.get("parameters", []), place)
    for number, parameter in enumerate(entries, start=1):
        for value in (parameter.value, parameter.std):
            if value is not None and not math.isfinite(value):
                raise InvalidInput(
                    f"{value!r} is not a finite number",
                    where=f"{place}, entry {number}",
                    remedy="write a number or null",
                )
    return entries


def stage_estimates_of(document: Mapping[str, Any]) -> Values:
    """Estimates of all stages by (name, joint), the last stage first; they may be rejected."""
    stages = document.get("stages", {})
    tables = [stages.get("tuned") or {}, *stages.get("joints", []), stages.get("rigid") or {}]
    values: Values = {}
    for table in tables:
        for p in parameters_of(table, "the result: stages"):
            if p.value is not None:
                values.setdefault(p.key, p.value)
    return values


def standard_parameters_of(
    document: Mapping[str, Any], arm: ArmDescription, source: str = "the result"
) -> Values:
    """Physically consistent standard parameters; empty if the result has none.

    Files of earlier versions do not contain motor inertias without estimate.
    """
    place = f"{source}: standard_parameters"
    entries = _validated(dict[str, float], document.get("standard_parameters") or {}, place)
    names = {standard_name(key): key for key in base_parameters(arm).links} if entries else {}
    for name in names:
        if not math.isfinite(entries.get(name, math.nan)):
            raise InvalidInput(
                f"{name} is missing or not a finite number", where=place, remedy=NOT_A_RESULT
            )
    motors: list[Key] = [(MOTOR_INERTIA, i + 1) for i in range(arm.n_joints)]
    names |= {standard_name(key): key for key in motors if standard_name(key) in entries}
    return {key: entries[name] for name, key in names.items()}


def warnings_of(document: Mapping[str, Any]) -> tuple[PublishedWarning, ...]:
    """The warnings of a result."""
    entries = document.get("warnings", [])
    return _validated(tuple[PublishedWarning, ...], entries, "the result: warnings")


def verdict_of(document: Mapping[str, Any]) -> Verdict:
    """The verdict of a result."""
    table = {"status": document.get("status"), **document.get("verdict", {})}
    entry = _validated(_VerdictEntry, table, "the result: verdict")
    reason = document.get("reason")
    return Verdict(
        status=entry.status,
        identified=tuple(map(_key_of, entry.identified)),
        not_identified=tuple(map(_key_of, entry.not_identified)),
        rejected=tuple(map(_key_of, entry.rejected)),
        validated=entry.validated,
        suspected=tuple(
            Suspicion(
                places=(Place(part=each.where),),
                clause=_plain(each.message),
                remedy_clause=_plain(each.remedy),
                **_entry(each, "code factor delay_s corrections accepted"),
            )
            for each in entry.suspected
        ),
        reason_clauses=tuple(map(_plain, reason.split("; ") if reason else ())),
    )


def rigid_model_of(document: Mapping[str, Any], n_parameters: int) -> RigidModel | None:
    """The rigid model of a result, without covariance; None if it predicts nothing.

    `n_parameters` is the number of the arm's rigid columns. Files of earlier versions have no
    entry `prediction`.
    """
    table = document.get("stages", {}).get("rigid") or {}
    if "prediction" not in table or table.get("status") == "not-identifiable":
        return None
    entry = _validated(_RigidEntry, table, "the result: stages.rigid")
    solution, motion = np.array(entry.prediction.solution), np.array(entry.prediction.motion)
    if solution.shape != (n_parameters,) or motion.ndim != 3 or len(motion) != 3:
        raise InvalidInput(
            f"has {len(solution)} values and a motion of shape {motion.shape}; expected "
            f"{n_parameters} values and (3, n_samples, n_joints)",
            where="the result: stages.rigid.prediction",
            remedy=NOT_A_RESULT,
        )
    return RigidModel(
        parameters=entry.parameters,
        solution=solution,
        covariance=np.full((n_parameters, n_parameters), np.nan),
        condition_number=math.nan,
        fit_percent={},
        bandwidth_hz=entry.bandwidth_hz,
        decimation=entry.decimation,
        n_rows=entry.n_rows,
        status=entry.status,
        torque_errors={each.joint: each.value for each in entry.torque_errors},
        friction_terms=entry.prediction.friction_terms,
        motion=motion,
    )


@dataclass(frozen=True, kw_only=True)
class _PredictionEntry:
    solution: tuple[float, ...]
    friction_terms: tuple[FrictionTerm, ...]
    motion: tuple[tuple[tuple[float, ...], ...], ...]


@dataclass(frozen=True, kw_only=True)
class _TorqueErrorEntry:
    joint: int
    value: float


@dataclass(frozen=True, kw_only=True)
class _RigidEntry:
    parameters: tuple[Parameter, ...]
    bandwidth_hz: float
    decimation: int
    n_rows: int
    status: Literal["determined", "partly-determined"]
    prediction: _PredictionEntry
    torque_errors: tuple[_TorqueErrorEntry, ...] = ()


@dataclass(frozen=True, kw_only=True)
class _CheckEntry:
    experiment: str
    fit_percent: dict[str, float | None]


@dataclass(frozen=True, kw_only=True)
class _SuspicionEntry:
    code: str
    where: str = ""
    message: str
    remedy: str
    factor: float | None = None
    delay_s: float | None = None
    corrections: tuple[Correction, ...] = ()
    accepted: bool = False


@dataclass(frozen=True, kw_only=True)
class _VerdictEntry:
    status: Status
    identified: tuple[str, ...]
    not_identified: tuple[str, ...]
    rejected: tuple[str, ...]
    validated: Validation
    suspected: tuple[_SuspicionEntry, ...] = ()


def _plain(text: str) -> Clause:
    return Clause("text", text=text)


def _key_of(label: str) -> Key:
    """Name and joint of a label such as "gear_stiffness 1"."""
    name, _, joint = label.rpartition(" ")
    return (name, int(joint)) if name and joint.isdecimal() else (label, None)


def response_of(document: Mapping[str, Any], joint: int) -> FrequencyResponse | None:
    """The nonparametric response of a joint at full amplitude; None if the result has none."""
    responses = document.get("stages", {}).get("responses", [])
    entry = next((each for each in responses if each["joint"] == joint), None)
    if entry is None:
        return None
    n_out, n_in = (len({c[end] for c in entry["channels"]}) for end in ("output", "input"))

    def grid(part: str) -> FloatArray | None:
        columns = [channel[part] for channel in entry["channels"]]
        if any(column is None for column in columns):
            return None
        return np.array(columns, dtype=np.float64).T.reshape(-1, n_out, n_in)

    real, imaginary = grid("re"), grid("im")
    if real is None or imaginary is None:
        return None
    coherence = list(entry["coherence"].values())
    return FrequencyResponse(
        np.array(entry["frequency_hz"], dtype=np.float64),
        real + 1j * imaginary,
        coherence=np.array(coherence, dtype=np.float64).T if coherence else None,
        noise_variance=grid("noise_variance"),
        distortion_variance=grid("distortion_variance"),
        method=entry["method"],
        n_averages=entry["n_averages"],
    )


def _validated(kind: type[T], value: Any, place: str) -> T:
    """A JSON value as a record; keys that this version does not know are ignored."""
    from pydantic import ValidationError

    try:
        record: T = _adapter(kind).validate_json(  # type: ignore[arg-type]
            json.dumps(value), strict=True
        )
    except ValidationError as error:
        first = error.errors()[0]
        keys: list[Any] = list(first["loc"])
        if keys and isinstance(keys[0], int):
            place += f", entry {keys.pop(0) + 1}"
        key = ".".join(str(part) for part in keys) or "the entry"
        problem = first["msg"].replace("Input should be ", "it should be ")
        raise InvalidInput(
            f"'{key}' is invalid: {problem[0].lower() + problem[1:]}",
            where=place,
            remedy=NOT_A_RESULT,
        ) from error
    return record


@cache
def _adapter(kind: Any) -> Any:
    from pydantic import TypeAdapter

    return TypeAdapter(kind)


def _study(study: Study) -> dict[str, Any]:
    """Path, hash and folder of the study file; the rig, with joints where a URDF places them."""
    urdf, arm = study.arm.urdf, replace(study.arm, urdf=None)
    tables = document_of(replace(study, arm=arm))
    rig = {name: tables[name] for name in _RIG_TABLES if name in tables}
    folder = str(study.path.resolve().parent)
    entry = {"path": str(study.path), "sha256": study.sha256, "folder": folder, **rig}
    return entry | ({"urdf": {"file": urdf.file, "held": urdf.held}} if urdf else {})


def _responses(identification: Identification) -> list[dict[str, Any]]:
    """Nonparametric responses of each joint at full amplitude, then of each record."""
    responses = [
        _response(identification.responses[joint.joint], joint.joint, joint.experiments, joint)
        for joint in identification.joints
        if joint.joint in identification.responses
    ]
    for record in identification.records:
        if record.response is not None:
            names = (record.signals.experiment.name,)
            responses.append(
                _response(record.response, record.signals.joint, names, record.joint_model)
            )
    return responses


def _response(
    response: FrequencyResponse, number: int, names: tuple[str, ...], joint: JointModel | None
) -> dict[str, Any]:
    low, high = joint.band_hz if joint else (0.0, math.inf)
    lines = response.between(low / _BAND_FACTOR, high * _BAND_FACTOR, _MAX_RESPONSE_LINES)
    _, n_out, n_in = lines.response.shape
    channels = []
    for o, output in enumerate(_OUTPUTS[:n_out]):
        for i, name in enumerate(_INPUTS[:n_in]):
            G = lines.response[:, o, i]
            channel: dict[str, Any] = {"output": output, "input": name}
            channel |= {"re": _short(G.real), "im": _short(G.imag)}
            for part in ("noise_variance", "distortion_variance"):
                variance = getattr(lines, part)
                channel[part] = None if variance is None else _short(variance[:, o, i])
            channels.append(channel)
    coherence = {
        output: _short(lines.coherence[:, o])
        for o, output in enumerate(_OUTPUTS[:n_out])
        if lines.coherence is not None
    }
    return {
        "joint": number,
        "experiments": names,
        "method": lines.method,
        "n_averages": lines.n_averages,
        "frequency_hz": _short(lines.frequencies_hz),
        "channels": channels,
        "coherence": coherence,
    }


def _motor_response(response: MotorResponse) -> dict[str, Any]:
    entry: dict[str, Any] = _entry(response, "experiment joint condition coherence")
    entry["frequency_hz"] = response.frequencies_hz
    for name in ("measured", "fitted"):
        values = getattr(response, name)
        entry |= {f"{name}_re": values.real, f"{name}_im": values.imag}
    entry = {k: _short(v) if isinstance(v, np.ndarray) else v for k, v in entry.items()}
    entry["anti_resonance_hz"] = response.anti_resonances_hz
    entry["resonance_hz"] = response.resonances_hz
    return entry


def _short(values: FloatArray) -> list[float]:
    return [float(f"{value:.{_RESPONSE_DIGITS}g}") for value in values.tolist()]


def suspicion_entries(suspicions: Iterable[Suspicion]) -> list[dict[str, Any]]:
    """Suspected faults as JSON values."""
    suspected = []
    for one in suspicions:
        sizes = {k: size for k, size in _entry(one, "factor delay_s").items() if size is not None}
        accepted = {"accepted": True} if one.accepted else {}
        corrections = {"corrections": [asdict(each) for each in one.corrections]}
        texts = _entry(one, "code where message remedy")
        suspected.append(texts | sizes | accepted | corrections)
    return suspected


def _rigid(model: RigidModel) -> dict[str, Any]:
    pairs = model.torque_ratios.items()
    ratios = [{"joint": joint, "value": value, "std": std} for joint, (value, std) in pairs]
    names = "status parameters fit_percent condition_number bandwidth_hz decimation n_rows"
    return _entry(model, names) | {
        "friction_terms": [
            parameter_entry(p) | _entry(term, "effect changes")
            for term in model.friction_terms
            for p in term.parameters
        ],
        "torque_ratio": next((ratio for ratio in ratios if ratio["joint"] == 2), None),
        "torque_ratios": ratios,
        "torque_errors": [
            {"joint": joint, "value": value} for joint, value in model.torque_errors.items()
        ],
        "prediction": {
            "solution": model.solution,
            "friction_terms": [asdict(term) for term in model.friction_terms],
            "motion": [[_short(sample) for sample in part] for part in model.motion],
        },
    }


def _record(record: RecordModel) -> dict[str, Any]:
    """The physical model and the state-space model of one excited record."""
    chosen = record.joint_model
    entry = _without_joint_model(record) if chosen is None else _joint(chosen)
    entry["experiment"] = record.signals.experiment.name
    entry["equation_fit_percent"] = entry.pop("fit_percent")
    entry["fit_percent"] = record.state_space and _simulated_fit(record.state_space)
    entry["state_space"] = None
    if record.state_space is not None:
        names = "A B C D K sample_time method order status hold input_names output_names"
        entry["state_space"] = {
            **_entry(record.state_space, f"{names} prediction_fit_percent warnings"),
            "fit_percent": entry["fit_percent"],
            **_frequencies(record.modes),
            "held_out": record.check
            and _entry(record.check, "fit_percent prediction_fit_percent tests"),
        }
    entry["transfer_function"] = None if record.transfer is None else _joint(record.transfer)
    entry["checks"] = [asdict(check) for check in record.signals.checks]
    entry["warnings"] += record.warnings
    return entry


def _motor_response_entries(joints: Sequence[JointModel]) -> list[dict[str, Any]]:
    """One entry per record for joints that are modelled from motor signals alone."""
    entries = []
    for joint in joints:
        for name in joint.experiments if joint.method == "motor-response" else ():
            entry = _joint(joint)
            entry["experiment"] = name
            entry["fit_percent"] = list(joint.fit_percent.values())
            entry["state_space"] = entry["transfer_function"] = None
            entries.append(entry)
    return entries


def _without_joint_model(record: RecordModel) -> dict[str, Any]:
    """A record without physical parameters; its state-space model gives the resonances."""
    return {
        "joint": record.signals.joint,
        "method": None if record.state_space is None else record.state_space.method,
        "order": None if record.state_space is None else record.state_space.order,
        "status": "not-identifiable",
        **_frequencies(record.modes),
        "fit_percent": None,
        "parameters": (),
        "warnings": (),
    }


def _joint(joint: JointModel) -> dict[str, Any]:
    names = "experiments joint method status band_hz fit_percent parameters warnings"
    return _entry(joint, names) | _frequencies(joint) | {"order": 3}


def _frequencies(model: JointModel | Modes | None) -> dict[str, Any]:
    entry: dict[str, Any] = {}
    for name in ("anti_resonance", "resonance"):
        mode: Mode | None = getattr(model, name, None)
        entry[f"{name}_hz"] = mode and mode.frequency_hz
        entry[f"{name}_std_hz"] = mode and mode.frequency_std_hz
        entry[f"{name}_damping"] = mode and mode.damping
    return entry


def _simulated_fit(model: StateSpace) -> tuple[float, ...] | None:
    """Fits of the simulated model; None if the model is unstable."""
    unstable = any(warning.code == "unstable-model" for warning in model.warnings)
    return None if unstable else model.fit_percent


def _whole_arm(model: ArmModel) -> dict[str, Any]:
    """The fit with its correlations; residuals without their spectra, and causes."""
    names = "status end iterations parameters fit_percent initial_fit_percent warnings"
    residual = "experiment channel deviation noise sample_noise worst_hz whiteness"
    residual += " input_joint input_correlation input_delay input_probability"
    cause = "joint effect parameters gain share shifts weight is_included is_linearised"
    return _entry(model, names) | {
        "correlations": _correlations(model),
        "gear_laws": [asdict(choice) for choice in model.gear_laws],
        "sensor_gains": [asdict(gain) for gain in model.sensor_gains],
        "criticism": model.criticism
        and {
            "residuals": [_entry(each, residual) for each in model.criticism.residuals],
            "causes": [_entry(each, cause) for each in model.criticism.causes],
        },
    }


def _correlations(model: ArmModel) -> list[list[float]]:
    """Correlations of the parameters in their order; zero for those that are not identified."""
    std = np.sqrt(np.diag(model.covariance))
    identified = np.isfinite(std)
    scale = np.where((std > 0.0) & identified, std, 1.0)
    covariance = np.where(np.outer(identified, identified), model.covariance, 0.0)
    correlations: list[list[float]] = (covariance / np.outer(scale, scale)).round(4).tolist()
    return correlations


def parameter_entry(parameter: Parameter) -> dict[str, Any]:
    """One entry of the list `parameters`; `model_std` where a model error is known."""
    entry = asdict(parameter)
    if parameter.model_std is None:
        del entry["model_std"]
    return entry


def base_parameter_entries(
    arm: ArmDescription, parameters: Iterable[Parameter]
) -> list[dict[str, Any]]:
    """The entry `base_parameters`: estimates under their names in the literature."""
    entries = []
    for one in base_parameter_list(arm, parameters):
        estimate = parameter_entry(one.estimate)
        del estimate["joint"]
        entries.append({**estimate, "name": one.name, "combination": dict(one.combination)})
    return entries


def plain(value: Any) -> Any:
    """A record as JSON values; numbers that are not finite become null."""
    if isinstance(value, Parameter):
        value = parameter_entry(value)
    elif isinstance(value, Diagnostic):
        experiments = {"experiments": value.experiments} if value.experiments else {}
        value = _entry(value, "code where message") | experiments
    elif isinstance(value, np.ndarray):
        value = value.tolist()
    elif is_dataclass(value):
        value = {each.name: getattr(value, each.name) for each in fields(value)}
    if isinstance(value, Mapping):
        return {key: plain(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [plain(entry) for entry in value]
    if isinstance(value, float):  # also NumPy's float64
        return float(value) if math.isfinite(value) else None
    return value


def _entry(record: Any, names: str) -> dict[str, Any]:
    """Attributes of a record, by names that spaces separate."""
    return {name: getattr(record, name) for name in names.split()}
