"""result.json: an identification as plain JSON values, and records read back from it."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from pydantic import BaseModel, TypeAdapter, ValidationError

from strainwave.domain import (
    ArmDescription,
    ArmModel,
    Clause,
    FrequencyResponse,
    Identification,
    InputCheck,
    JointModel,
    Modes,
    Parameter,
    Place,
    PublishedWarning,
    RecordModel,
    RigidModel,
    Study,
    Suspicion,
    Verdict,
)
from strainwave.domain.arm.base_parameters import MOTOR_INERTIA, base_parameters
from strainwave.domain.keys import Key, Values
from strainwave.errors import InvalidInput
from strainwave.io.atomic_files import read_json
from strainwave.io.base_parameters import (
    base_parameter_list,
    standard_name,
    standard_parameter_entries,
)
from strainwave.io.joint_covariance import IdentifiedNoise, JointCovariance, joint_covariance
from strainwave.io.result_entries import (
    ArmEntry,
    BaseParameterEntry,
    ChannelNoise,
    CheckEntry,
    CovarianceEntry,
    EstimatesEntry,
    FrictionEntry,
    InputCheckEntry,
    JointValue,
    PredictionEntry,
    RecordEntry,
    ResponseEntry,
    ResultEntry,
    RigidEntry,
    StagesEntry,
    StateSpaceEntry,
    TorqueRatio,
    VerdictEntry,
)
from strainwave.io.study import document_of
from strainwave.io.study.reader import Reader
from strainwave.version import __version__

T = TypeVar("T")

SCHEMA = "strainwave/result/1"
NOT_A_RESULT = "give a result.json that strainwave identify has written"
"""Remedy for a file that is not a result."""
FILE_NAME = "result.json"

_BAND_FACTOR = 3.0  # responses are published this far beyond the band of a joint's fit
_MAX_RESPONSE_LINES = 500  # frequencies of one published response
_INPUTS = ("motor_torque", "interaction_torque")
_OUTPUTS = ("motor_velocity", "link_velocity")
_RIG_TABLES = ("arm", "joint", "transmission", "servo")  # of the study file, which results repeat


def to_document(identification: Identification) -> dict[str, Any]:
    """The result as plain JSON values in the layout of docs/result.md; numbers are finite."""
    base = _base_entries(identification.study.arm, identification.parameters)
    # drive signals by the rigid model, motion by the elastic model
    fits: dict[str, dict[str, float]] = {}
    for check in identification.checks:
        fits.setdefault(check.experiment, {}).update(check.fit_percent)
    result = ResultEntry.of(
        identification,
        schema_=SCHEMA,
        study=_study(identification.study),
        options=identification.study.options,
        status=identification.verdict.status,
        covariance=joint_covariance(identification),
        base_parameters=base,
        standard_parameters=standard_parameter_entries(identification) if base else None,
        stages=_stages(identification),
        checks=tuple({"experiment": name, "fit_percent": fit} for name, fit in fits.items()),
    )
    return _plain(result, () if base else ("base_parameters", "standard_parameters"))


def check_document(check: InputCheck) -> dict[str, Any]:
    """An input check as plain JSON values, in the layout of docs/result.md."""
    study = {"path": str(check.study.path), "sha256": check.study.sha256}
    schema = "strainwave/check/1"
    return _plain(InputCheckEntry.of(check, schema_=schema, version=__version__, study=study))


def estimates_document(
    arm: ArmDescription, parameters: Iterable[Parameter], rigid: Iterable[Parameter]
) -> dict[str, Any]:
    """The keys `parameters`, and `base_parameters` of serial arms from those of the rigid model."""
    base = _base_entries(arm, rigid)
    entry = EstimatesEntry(parameters=tuple(parameters), base_parameters=base)
    return _plain(entry, () if base else ("base_parameters",))


def _base_entries(
    arm: ArmDescription, parameters: Iterable[Parameter]
) -> tuple[BaseParameterEntry, ...]:
    return tuple(
        BaseParameterEntry.of(one.estimate, name=one.name, combination=one.combination)
        for one in base_parameter_list(arm, parameters)
    )


def _plain(entry: BaseModel, without: Iterable[str] = ()) -> dict[str, Any]:
    text = entry.model_dump_json(by_alias=True, exclude=set(without))
    values: dict[str, Any] = json.loads(text)
    return values


def to_json(document: Mapping[str, Any]) -> bytes:
    """A result document as UTF-8 text; lists of numbers take one line each."""
    return f"{_indented(document)}\n".encode()


def _indented(value: Any, line: str = "\n") -> str:
    """JSON text of a value; `line` is a line end with the indentation of the value."""
    inner = f"{line}  "
    if isinstance(value, Mapping) and value:
        entries = [
            f"{_compact(str(name))}: {_indented(each, inner)}" for name, each in value.items()
        ]
        return f"{{{inner}{f',{inner}'.join(entries)}{line}}}"
    if isinstance(value, list | tuple) and any(isinstance(each, _NESTED) for each in value):
        return f"[{inner}{f',{inner}'.join(_indented(each, inner) for each in value)}{line}]"
    return _compact(value)


_compact = json.JSONEncoder(ensure_ascii=False, allow_nan=False).encode  # all in C
_NESTED = (str, list, tuple, dict)  # lists of these take one line for each entry


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
    checks_of(document, str(path))
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
    study = Reader(path, "", is_result=True).study(rig, sha256, experiments_exist=False)
    return replace(study, path=Path(str(tables.get("path", path))))


def parameters_of(document: Mapping[str, Any], source: str = "the result") -> tuple[Parameter, ...]:
    """The final table of a result; `source` names it in messages."""
    place = f"{source}: parameters"
    entries = _read(tuple[Parameter, ...], document.get("parameters", []), place)
    for number, parameter in enumerate(entries, start=1):
        for value in (parameter.value, parameter.std):
            if value is not None and not math.isfinite(value):
                raise InvalidInput(
                    f"{value!r} is not a finite number",
                    where=f"{place}, entry {number}",
                    remedy="write a number or null",
                )
    return entries


def _stage(document: Mapping[str, Any], name: str, kind: type = dict) -> Any:
    """The table of a stage, or the list of its tables; empty if the result has none."""
    stages = document.get("stages") or {}
    entry = (stages.get(name) or kind()) if isinstance(stages, dict) else stages
    tables = entry if kind is list and isinstance(entry, list) else [entry]
    if not isinstance(entry, kind) or not all(isinstance(table, dict) for table in tables):
        where = f"the result: stages.{name}"
        raise InvalidInput("is not a table", where=where, remedy=NOT_A_RESULT)
    return entry


def stage_estimates_of(document: Mapping[str, Any]) -> Values:
    """Estimates of all stages by (name, joint), the last stage first; they may be rejected."""
    joints = _stage(document, "joints", list)
    tables = [_stage(document, "tuned"), *joints, _stage(document, "rigid")]
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
    entries = _read(dict[str, float], document.get("standard_parameters") or {}, place)
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
    return _read(tuple[PublishedWarning, ...], entries, "the result: warnings")


def checks_of(
    document: Mapping[str, Any], source: str = "the result"
) -> dict[str, dict[str, float | None]]:
    """Fit [%] of each channel of each validation record; None: the channel does not vary."""
    entries = _read(tuple[CheckEntry, ...], document.get("checks", []), f"{source}: checks")
    return {each.experiment: dict(each.fit_percent) for each in entries}


def verdict_of(document: Mapping[str, Any]) -> Verdict:
    """The verdict of a result; results of earlier versions have all reasons in one text."""
    entry = _read(
        VerdictEntry,
        {"status": document.get("status"), **document.get("verdict", {})},
        "the result: verdict",
    )
    reason = document.get("reason")
    reasons = entry.reasons if entry.reasons is not None else (reason,) if reason else ()
    return Verdict(
        status=entry.status,
        identified=entry.identified,
        not_identified=entry.not_identified,
        rejected=entry.rejected,
        validated=entry.validated,
        suspected=tuple(
            Suspicion(
                code=each.code,
                places=(Place(part=each.where),),
                clause=_as_clause(each.message),
                remedy_clause=_as_clause(each.remedy),
                factor=each.factor,
                delay_s=each.delay_s,
                corrections=each.corrections,
                accepted=each.accepted,
            )
            for each in entry.suspected
        ),
        reason_clauses=tuple(map(_as_clause, reasons)),
    )


def _as_clause(text: str) -> Clause:
    return Clause("text", text=text)


def covariance_of(
    document: Mapping[str, Any], source: str = "the result"
) -> JointCovariance | None:
    """The joint covariance of a result document; None if it has none, as in earlier versions."""
    if document.get("covariance") is None:
        return None
    place = f"{source}: covariance"
    entry = _read(CovarianceEntry, document["covariance"], place)
    names, matrix = entry.names, entry.matrix
    if [len(row) for row in matrix] != [len(names)] * len(names) or not np.isfinite(matrix).all():
        raise InvalidInput(
            f"has {len(names)} names and a matrix that is not square, of another size, or not "
            "finite",
            where=place,
            remedy=NOT_A_RESULT,
        )
    return JointCovariance(entry.stage, names, np.array(matrix))


def noise_of(document: Mapping[str, Any], source: str = "the result") -> IdentifiedNoise:
    """The noise of a result document: of each channel the median over the records.

    `source` names the document in messages.
    """
    stages = document.get("stages") or {}
    rigid, tuned = stages.get("rigid") or {}, stages.get("tuned") or {}
    residuals = (tuned.get("criticism") or {}).get("residuals", [])
    place = f"{source}: stages.tuned.criticism.residuals"
    samples: dict[str, list[float]] = {}
    for test in _read(tuple[ChannelNoise, ...], residuals, place):
        if test.sample_noise:
            samples.setdefault(test.channel, []).append(test.sample_noise)
    place = f"{source}: stages.rigid.torque_errors"
    torques = _read(tuple[JointValue, ...], rigid.get("torque_errors", []), place)
    return IdentifiedNoise(
        {channel: float(np.median(values)) for channel, values in samples.items()},
        {each.joint: each.value for each in torques},
        rigid.get("bandwidth_hz"),
    )


def rigid_model_of(document: Mapping[str, Any], n_parameters: int) -> RigidModel | None:
    """The rigid model of a result, without covariance; None if it predicts nothing.

    `n_parameters` is the number of the arm's rigid columns. Files of earlier versions have no
    entry `prediction`.
    """
    table = _stage(document, "rigid")
    if "prediction" not in table or table.get("status") == "not-identifiable":
        return None
    entry = _read(RigidEntry, table, "the result: stages.rigid")
    if entry.prediction is None:
        return None
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


def rigid_band_of(document: Mapping[str, Any]) -> float:
    """Bandwidth [Hz] of the rigid model; zero without one."""
    band = _stage(document, "rigid").get("bandwidth_hz")
    return band if isinstance(band, float) and band > 0.0 else 0.0


def response_of(document: Mapping[str, Any], joint: int) -> FrequencyResponse | None:
    """The nonparametric response of a joint at full amplitude; None if the result has none."""
    responses = _stage(document, "responses", list)
    table = next((each for each in responses if each.get("joint") == joint), None)
    if table is None:
        return None
    entry = _read(ResponseEntry, table, "the result: stages.responses")
    n_out, n_in = (len({getattr(c, end) for c in entry.channels}) for end in ("output", "input"))

    def grid(part: str) -> Any:
        columns = [getattr(channel, part) for channel in entry.channels]
        if any(column is None for column in columns):
            return None
        return np.array(columns, dtype=np.float64).T.reshape(-1, n_out, n_in)

    coherence = list(entry.coherence.values())
    return FrequencyResponse(
        np.array(entry.frequency_hz),
        grid("re") + 1j * grid("im"),
        coherence=np.array(coherence, dtype=np.float64).T if coherence else None,
        noise_variance=grid("noise_variance"),
        distortion_variance=grid("distortion_variance"),
        method=entry.method,
        n_averages=entry.n_averages,
    )


def _read(kind: type[T], value: Any, place: str) -> T:
    """A JSON value as an entry or a record; keys that this version does not know are ignored."""
    try:
        entry: T = _adapter(kind).validate_json(  # type: ignore[arg-type]
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
    return entry


@cache
def _adapter(kind: Any) -> TypeAdapter[Any]:
    return TypeAdapter(kind)


def _study(study: Study) -> dict[str, Any]:
    """Path, hash and folder of the study file; the rig, with joints where a URDF places them."""
    urdf, arm = study.arm.urdf, replace(study.arm, urdf=None)
    tables = document_of(replace(study, arm=arm))
    rig = {name: tables[name] for name in _RIG_TABLES if name in tables}
    folder = str(study.path.resolve().parent)
    entry = {"path": str(study.path), "sha256": study.sha256, "folder": folder, **rig}
    return entry | ({"urdf": {"file": urdf.file, "held": urdf.held}} if urdf else {})


def _stages(identification: Identification) -> StagesEntry:
    stages: dict[str, Any] = {}
    if identification.rigid is not None:
        stages["rigid"] = _rigid(identification.rigid)
    if "decoupled" in identification.stages:
        stages["decoupled"] = [
            *map(_record, identification.records),
            *(  # joints that are modelled from motor signals alone, record by record
                RecordEntry.of(
                    joint, experiment=name, fit_percent=tuple(joint.fit_percent.values())
                )
                for joint in identification.joints
                if joint.method == "motor-response"
                for name in joint.experiments
            ),
        ]
        for name in ("joints", "torsions", "sweeps", "links"):
            stages[name] = getattr(identification, name)
        stages["responses"] = [*_responses(identification)]
    if identification.whole_arm is not None:
        stages["tuned"] = ArmEntry.of(
            identification.whole_arm,
            correlations=_correlations(identification.whole_arm),
            motor_responses=identification.motor_responses,
        )
    return StagesEntry(**stages)


def _rigid(model: RigidModel) -> RigidEntry:
    ratios = tuple(
        TorqueRatio(joint=joint, value=value, std=std)
        for joint, (value, std) in model.torque_ratios.items()
    )
    return RigidEntry.of(
        model,
        friction_terms=tuple(
            FrictionEntry.of(p, effect=term.effect, changes=term.changes)
            for term in model.friction_terms
            for p in term.parameters
        ),
        torque_ratio=next((ratio for ratio in ratios if ratio.joint == 2), None),
        torque_ratios=ratios,
        torque_errors=tuple(JointValue(joint=i, value=x) for i, x in model.torque_errors.items()),
        # servos without a torque log have parameters, and predict no torques
        prediction=PredictionEntry.of(model) if model.motion.size else None,
    )


def _record(record: RecordModel) -> RecordEntry:
    """The physical model and the state-space model of one excited record."""
    linear, chosen, fit, state_space = record.state_space, record.joint_model, None, None
    if linear is not None:
        # a simulation of an unstable model has no fit
        is_unstable = any(warning.code == "unstable-model" for warning in linear.warnings)
        fit = None if is_unstable else linear.fit_percent
        modes = record.modes or Modes((), (), None, None)
        state_space = StateSpaceEntry.of(
            linear,
            anti_resonance=modes.anti_resonance,
            resonance=modes.resonance,
            fit_percent=fit,
            held_out=record.check,
        )
    models = {
        "experiment": record.signals.experiment.name,
        "fit_percent": fit,
        "state_space": state_space,
        "transfer_function": record.transfer,
        "checks": record.signals.checks,
    }
    if chosen is not None:
        return RecordEntry.of(
            chosen,
            equation_fit_percent=chosen.fit_percent,
            warnings=(*chosen.warnings, *record.warnings),
            **models,
        )
    return RecordEntry.of(  # the state-space model alone gives the resonances
        record.modes,
        joint=record.signals.joint,
        method=None if linear is None else linear.method,
        order=None if linear is None else linear.order,
        status="not-identifiable",
        warnings=record.warnings,
        **models,
    )


def _responses(identification: Identification) -> Iterator[ResponseEntry]:
    """Nonparametric responses of each joint at full amplitude, then of each record."""
    for joint in identification.joints:
        if joint.joint in identification.responses:
            response = identification.responses[joint.joint]
            yield _response(response, joint.joint, joint.experiments, joint)
    for record in identification.records:
        if record.response is not None:
            names = (record.signals.experiment.name,)
            yield _response(record.response, record.signals.joint, names, record.joint_model)


def _response(
    response: FrequencyResponse, number: int, names: tuple[str, ...], joint: JointModel | None
) -> ResponseEntry:
    low, high = joint.band_hz if joint else (0.0, math.inf)
    lines = response.between(low / _BAND_FACTOR, high * _BAND_FACTOR, _MAX_RESPONSE_LINES)
    _, n_out, n_in = lines.response.shape
    noise, distortion = lines.noise_variance, lines.distortion_variance
    channels = [
        {
            "output": output,
            "input": name,
            "re": lines.response[:, o, i].real,
            "im": lines.response[:, o, i].imag,
            "noise_variance": None if noise is None else noise[:, o, i],
            "distortion_variance": None if distortion is None else distortion[:, o, i],
        }
        for o, output in enumerate(_OUTPUTS[:n_out])
        for i, name in enumerate(_INPUTS[:n_in])
    ]
    coherence = {}
    if lines.coherence is not None:
        coherence = dict(zip(_OUTPUTS[:n_out], lines.coherence.T, strict=True))
    return ResponseEntry.of(
        lines, joint=number, experiments=names, channels=channels, coherence=coherence
    )


def _correlations(model: ArmModel) -> list[list[float]]:
    """Correlations of the parameters in their order; zero for those that are not identified."""
    std = np.sqrt(np.diag(model.covariance))
    identified = np.isfinite(std)
    scale = np.where((std > 0.0) & identified, std, 1.0)
    covariance = np.where(np.outer(identified, identified), model.covariance, 0.0)
    correlations: list[list[float]] = (covariance / np.outer(scale, scale)).round(4).tolist()
    return correlations
