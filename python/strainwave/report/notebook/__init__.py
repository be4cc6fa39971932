"""HTML tables and figures of records in notebooks.

`Log._repr_html_()`, `RigidModel.plot()` and similar methods call this package. The figures are
those of the report, drawn by Matplotlib.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from functools import singledispatch
from typing import TYPE_CHECKING, Any

import numpy as np

from strainwave import domain
from strainwave.domain import FloatArray
from strainwave.domain.messages import percent, plus_minus
from strainwave.errors import InvalidInput
from strainwave.report import figures
from strainwave.report.document import bode, elastic, predictions
from strainwave.report.document.blocks import Row, fill_template, number, table
from strainwave.report.document.parameters import SUMMARY_HEADS, summary_row
from strainwave.report.figures import Axis, Colour, Figure, Line, Markers, Panel, curves
from strainwave.report.matplotlib_backend import draw

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Drawing

__all__ = ["certainty", "picture_of", "table_of"]


def picture_of(record: object, **which: Any) -> Drawing:
    """A record of `strainwave.domain` as a Matplotlib figure.

    Options: of a `Prediction` its `channel` (default: the one with the lowest fit); of a
    `FrequencyResponse` its `output` and `input`, from 0, and `band_hz`; of a `JointModel` its
    `gear_ratio`, and the `measured` response to compare. Raises InvalidInput if Matplotlib is
    missing or the record has no such part.
    """
    return draw(figure_of(record, **which))


@singledispatch
def table_of(record: object) -> str:
    """A record of `strainwave.domain` as an HTML table."""
    raise TypeError(f"a {type(record).__name__} has no table")


def table_of_parameters(parameters: Iterable[domain.Parameter]) -> str:
    """Parameters as a table."""
    return _html("", SUMMARY_HEADS, map(summary_row, parameters), ())


@table_of.register
def _(log: domain.Log) -> str:
    rows: list[Row] = [
        (name, *(number(f"{x:.4g}") for x in (values.min(), values.max(), values.std())))
        for name, values in log.channels.items()
    ]
    head = f"log {log.name}: {len(log)} samples every {1e3 * log.sample_time:.4g} ms"
    sizes = map(number, ("minimum", "maximum", "standard deviation"))
    return _html(head, ("channel", *sizes), rows, log.warnings)


@table_of.register
def _(model: domain.RigidModel) -> str:
    head = f"rigid model, {model.status}: {model.n_rows} equations, condition number "
    head += f"{model.condition_number:.3g}, band to {model.bandwidth_hz:.3g} Hz"
    return _html(head, SUMMARY_HEADS, map(summary_row, model.parameters), model.warnings)


@table_of.register
def _(joint: domain.Decoupled) -> str:
    rows = [("pass" if check.passed else "fail", check.message) for check in joint.checks]
    head = f"joint {joint.joint}, decoupled, record {joint.experiment.name}: "
    head += f"{len(joint.time)} samples, {joint.inputs.shape[1]} input(s)"
    return _html(head, ("check", "result"), rows, joint.warnings)


@table_of.register
def _(joint: domain.JointModel) -> str:
    head = f"joint {joint.joint}, {joint.status}, by {joint.method} from "
    head += ", ".join(joint.experiments)
    rows = list(map(summary_row, joint.parameters))
    for name, mode in bode.modes_of(joint):
        frequency = map(number, plus_minus(mode.frequency_hz, mode.frequency_std_hz))
        rows.append((name, str(joint.joint), *frequency, "Hz"))
    return _html(head, SUMMARY_HEADS, rows, joint.warnings)


@table_of.register
def _(record: domain.RecordModel) -> str:
    if record.joint_model is not None:
        return table_of(record.joint_model)
    head = f"joint {record.signals.joint}, record {record.signals.experiment.name}: no model"
    return _html(head, (), (), record.warnings)


@table_of.register
def _(response: domain.FrequencyResponse) -> str:
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
def _(sweep: domain.Sweep) -> str:
    rows: list[Row] = []
    for point in sweep.points:
        stiffness = " ± ".join(plus_minus(point.gear_stiffness, point.gear_stiffness_std))
        rows.append((point.experiment, *map(number, (f"{point.amplitude:g}", stiffness))))
    head = f"joint {sweep.joint}, stiffness over amplitude: {sweep.verdict}"
    heads = ("record", number("amplitude"), number("k [N m/rad]"))
    return _html(head, heads, rows, ())


@table_of.register
def _(arm: domain.ArmModel) -> str:
    head = f"whole-arm fit: {arm.end} after {arm.iterations} evaluations"
    return _html(head, SUMMARY_HEADS, map(summary_row, arm.parameters), arm.warnings)


@table_of.register
def _(prediction: domain.Prediction) -> str:
    rows = [(name, number(percent(fit))) for name, fit in prediction.fit_percent.items()]
    head = f"prediction of record {prediction.experiment}"
    return _html(head, ("channel", number("fit")), rows, ())


@table_of.register
def _(result: domain.Identification) -> str:
    head = f"{result.study.path.name}: {result.verdict.status}"
    if result.reason is not None:
        head += f" ({result.reason})"
    return _html(head, SUMMARY_HEADS, map(summary_row, result.parameters), result.warnings)


def _html(head: str, heads: Row, rows: Iterable[Row], warnings: Sequence[domain.Diagnostic]) -> str:
    tables = table(head, heads, rows, heading=False)
    return fill_template("notebook/table", head=head, tables=tables, warnings=warnings)


MAX_RELATIVE_STD = 0.3  # of a response: less certain points would hide the others


@singledispatch
def figure_of(record: object) -> Figure:
    """The figure of a record; `picture_of` lists the options.

    Raises InvalidInput if the record has no such part.
    """
    raise TypeError(f"a {type(record).__name__} has no figure")


@figure_of.register
def _(log: domain.Log) -> Figure:
    """Drive and motor angles."""
    above = {n: v for n, v in log.channels.items() if domain.channel_parts(n)[0] in ("u", "torque")}
    below = {n: v for n, v in log.channels.items() if domain.channel_parts(n)[0] == "theta_m"}
    titles = ("drive [V, N m]", "motor angle [rad]")
    return _stacked(log.time, above, below, titles, f"log {log.name}")


@figure_of.register
def _(joint: domain.Decoupled) -> Figure:
    """Inputs, and both velocities on the link side of the gear."""
    names = ("motor torque less Coulomb friction", "n times interaction torque")
    columns = zip(names, (1.0, joint.gear_ratio), joint.inputs.T, strict=False)
    above = {name: size * column for name, size, column in columns}
    below = {
        "n times motor velocity": joint.gear_ratio * joint.outputs[:, 0],
        "link velocity": joint.outputs[:, 1],
    }
    caption = f"joint {joint.joint}, decoupled, record {joint.experiment.name}"
    return _stacked(
        joint.time, above, below, ("[N m] at the motor", "[rad/s] at the link"), caption
    )


@figure_of.register(domain.RigidModel)
@figure_of.register(domain.ArmModel)
@figure_of.register(domain.Identification)
def _(model: domain.RigidModel | domain.ArmModel | domain.Identification) -> Figure:
    return certainty(model.parameters)


@figure_of.register
def _(
    joint: domain.JointModel, *, gear_ratio: float, measured: domain.FrequencyResponse | None = None
) -> Figure:
    return bode.bode(joint, gear_ratio, measured)


@figure_of.register
def _(record: domain.RecordModel) -> Figure:
    if record.joint_model is None:
        raise InvalidInput(
            "the record has no physical model to draw",
            where=record.signals.experiment.name,
            remedy="read its warnings, which state the reason",
        )
    return bode.bode(record.joint_model, record.signals.gear_ratio, None)


@figure_of.register
def _(
    response: domain.FrequencyResponse,
    *,
    output: int = 0,
    input: int = 0,
    band_hz: tuple[float, float] | None = None,
) -> Figure:
    """The reliable points of a response with their 95 % band."""
    f, G = response.frequencies_hz, response.response[:, output, input]
    low, high = band_hz or (0.0, np.inf)
    size, phase = _spread(response, output, input)
    is_shown = (f > 0.0) & (f >= low) & (f <= high)
    if size is not None:
        is_shown &= size < MAX_RELATIVE_STD * np.abs(G)
    if not is_shown.any():
        raise InvalidInput(
            f"no point of the response has a standard deviation below {100 * MAX_RELATIVE_STD:g} %",
            remedy="average more periods, or draw another input, output or band_hz",
        )
    curve = curves.Curve(
        response.method,
        f[is_shown],
        G[is_shown],
        None if size is None else size[is_shown],
        None if phase is None else phase[is_shown],
    )
    return curves.bode([curve], f"input {input} to output {output}")


def _spread(
    response: domain.FrequencyResponse, output: int, input: int
) -> tuple[FloatArray | None, FloatArray | None]:
    """Standard deviations of modulus and phase, by the covariance of a model or measured noise.

    Noise has no preferred direction, so half of its variance is along the modulus.
    """
    if response.noise_variance is not None:
        size = np.sqrt(0.5 * response.noise_variance[:, output, input])
        return size, size / np.abs(response.response[:, output, input])
    modulus, phase = response.magnitude_std, response.phase_std
    if modulus is None or phase is None:
        return None, None
    return modulus[:, output, input], phase[:, output, input]


@figure_of.register
def _(sweep: domain.Sweep) -> Figure:
    return elastic.stiffness_figure(sweep)


@figure_of.register
def _(prediction: domain.Prediction, *, channel: str | None = None) -> Figure:
    fits = prediction.fit_percent
    channel = channel or min(prediction.channels, key=lambda name: fits.get(name, np.inf))
    if channel not in prediction.channels:
        raise InvalidInput(
            f"channel {channel!r} is not predicted",
            where=prediction.experiment,
            remedy=f"choose one of {', '.join(prediction.channels)}",
        )
    figure = predictions.prediction_figure(prediction, channels=(channel,))
    fit = percent(fits.get(channel, float("nan")))
    return replace(figure, caption=f"{prediction.experiment}, {channel}: fit {fit}")


def certainty(parameters: Iterable[domain.Parameter]) -> Figure:
    """Standard deviation of each parameter in percent of its value, where both are known."""
    certain = [(p, p.std / abs(p.value)) for p in parameters if p.std is not None and p.value]
    names = [p.name + (f" {p.joint}" if p.joint else "") for p, _ in certain]
    shares = np.array([100.0 * share for _, share in certain])
    points = Markers(tuple(names), shares, "standard deviation", Colour.MEASURED, size=8.0)
    return Figure(
        Axis(""), (Panel(Axis("standard deviation [% of the value]", log=True), (points,)),)
    )


def _stacked(
    time: FloatArray,
    above: Mapping[str, FloatArray],
    below: Mapping[str, FloatArray],
    titles: tuple[str, str],
    caption: str,
) -> Figure:
    styles = iter(zip(figures.PALETTE * 2, figures.DASHES * 2, strict=True))
    panels = []
    for title, group in zip(titles, (above, below), strict=True):
        marks = []
        for (name, values), (colour, dash) in zip(group.items(), styles, strict=False):
            rows = figures.decimate(values)
            marks.append(Line(time[rows], values[rows], name, colour, dash))
        panels.append(Panel(Axis(title), tuple(marks)))
    return Figure(Axis("time [s]"), tuple(panels), caption=caption)
