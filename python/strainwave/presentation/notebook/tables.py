"""Records as HTML tables; every text is escaped."""

from __future__ import annotations

from collections.abc import Iterable
from functools import singledispatch

from strainwave.domain import (
    ArmModel,
    Decoupled,
    Diagnostic,
    FrequencyResponse,
    Identification,
    JointModel,
    Log,
    Parameter,
    Prediction,
    RecordModel,
    RigidModel,
    Sweep,
)
from strainwave.domain.formatting import percent, plus_minus
from strainwave.presentation.html import fill_template

_PARAMETER_HEADS = ("parameter", "joint", "value", "± std", "unit")


@singledispatch
def table_of(record: object) -> str:
    """A record of `strainwave.domain` as an HTML table."""
    raise TypeError(f"a {type(record).__name__} has no table")


def table_of_parameters(parameters: Iterable[Parameter]) -> str:
    """Parameters as a table."""
    return _html("", _PARAMETER_HEADS, _rows(parameters), ())


@table_of.register
def _(log: Log) -> str:
    rows = [
        (name, f"{values.min():.4g}", f"{values.max():.4g}", f"{values.std():.4g}")
        for name, values in log.channels.items()
    ]
    head = f"log {log.name}: {len(log)} samples every {1e3 * log.sample_time:.4g} ms"
    return _html(head, ("channel", "minimum", "maximum", "standard deviation"), rows, log.warnings)


@table_of.register
def _(model: RigidModel) -> str:
    head = f"rigid model, {model.status}: {model.n_rows} equations, condition number "
    head += f"{model.condition_number:.3g}, band to {model.bandwidth_hz:.3g} Hz"
    return _html(head, _PARAMETER_HEADS, _rows(model.parameters), model.warnings)


@table_of.register
def _(joint: Decoupled) -> str:
    rows = [("pass" if check.passed else "fail", check.message) for check in joint.checks]
    head = f"joint {joint.joint}, decoupled, record {joint.experiment.name}: "
    head += f"{len(joint.time)} samples, {joint.inputs.shape[1]} input(s)"
    return _html(head, ("check", "result"), rows, joint.warnings)


@table_of.register
def _(joint: JointModel) -> str:
    head = f"joint {joint.joint}, {joint.status}, by {joint.method} from "
    head += ", ".join(joint.experiments)
    rows = [*_rows(joint.parameters), *_modes(joint)]
    return _html(head, _PARAMETER_HEADS, rows, joint.warnings)


@table_of.register
def _(record: RecordModel) -> str:
    if record.joint_model is not None:
        return table_of(record.joint_model)
    head = f"joint {record.signals.joint}, record {record.signals.experiment.name}: no model"
    return _html(head, (), (), record.warnings)


@table_of.register
def _(response: FrequencyResponse) -> str:
    f = response.frequencies_hz
    _, outputs, inputs = response.response.shape
    rows = [
        ("frequencies", f"{len(f)}, {f.min():.4g} to {f.max():.4g} Hz"),
        ("outputs and inputs", f"{outputs} and {inputs}"),
        ("averages", str(response.n_averages)),
    ]
    head = f"frequency response by {response.method}"
    return _html(head, ("", ""), rows, response.warnings)


@table_of.register
def _(sweep: Sweep) -> str:
    rows = [
        (
            point.experiment,
            f"{point.amplitude:g}",
            " ± ".join(plus_minus(point.gear_stiffness, point.gear_stiffness_std)),
        )
        for point in sweep.points
    ]
    head = f"joint {sweep.joint}, stiffness over amplitude: {sweep.verdict}"
    return _html(head, ("record", "amplitude", "k [N m/rad]"), rows, ())


@table_of.register
def _(arm: ArmModel) -> str:
    head = f"whole-arm fit: {arm.end} after {arm.iterations} evaluations"
    return _html(head, _PARAMETER_HEADS, _rows(arm.parameters), arm.warnings)


@table_of.register
def _(prediction: Prediction) -> str:
    rows = [(name, percent(fit)) for name, fit in prediction.fit_percent.items()]
    head = f"prediction of record {prediction.experiment}"
    return _html(head, ("channel", "fit"), rows, ())


@table_of.register
def _(result: Identification) -> str:
    head = f"{result.study.path.name}: {result.verdict.status}"
    if result.reason is not None:
        head += f" ({result.reason})"
    return _html(head, _PARAMETER_HEADS, _rows(result.parameters), result.warnings)


def _rows(parameters: Iterable[Parameter]) -> list[tuple[str, ...]]:
    return [
        (p.name, str(p.joint or "arm"), *plus_minus(p.value, p.std), p.unit) for p in parameters
    ]


def _modes(joint: JointModel) -> list[tuple[str, ...]]:
    modes = (("anti-resonance", joint.anti_resonance), ("resonance", joint.resonance))
    return [
        (name, str(joint.joint), *plus_minus(mode.frequency_hz, mode.frequency_std_hz), "Hz")
        for name, mode in modes
        if mode is not None
    ]


def _html(
    head: str,
    columns: Iterable[str],
    rows: Iterable[tuple[str, ...]],
    warnings: Iterable[Diagnostic],
) -> str:
    """One table with the warnings below it."""
    columns, rows, warnings = tuple(columns), tuple(rows), tuple(warnings)
    return fill_template("notebook/table", head=head, columns=columns, rows=rows, warnings=warnings)
