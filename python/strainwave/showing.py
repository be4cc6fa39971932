"""How records show themselves: a small HTML table each, and a picture.

The pictures are the report's own figures, drawn by `strainwave.drawing`. `Log._repr_html_()`,
`RigidModel.plot()` and their like end here.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from functools import singledispatch
from html import escape
from typing import TYPE_CHECKING, Any

import numpy as np

from strainwave.drawing import draw
from strainwave.errors import InvalidInput
from strainwave.formatting import percent, plus_minus
from strainwave.records import (
    ArmModel,
    Caution,
    Decoupled,
    FloatArray,
    FrequencyResponse,
    Identification,
    JointModel,
    Log,
    Mode,
    Parameter,
    Prediction,
    RecordModel,
    RigidModel,
    Sweep,
)
from strainwave.report import curves, elastic, figures

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_NOISY = 0.3  # relative deviation from which a point of a response is left out
_PARAMETER_HEADS = ("parameter", "joint", "value", "± std", "unit")


def table_of(record: object) -> str:
    """A record as a small HTML table.

    Parameters
    ----------
    record : record of `strainwave.records`

    Returns
    -------
    str
        HTML, its texts escaped.
    """
    return _table(record)


def picture_of(record: object, **which: Any) -> Figure:
    """A record as a Matplotlib figure.

    Parameters
    ----------
    record : record of `strainwave.records`
    **which
        Of a `Prediction` its `channel`, without it the one that fits worst; of a
        `FrequencyResponse` its `output` and `input`, from 0, and the `band_hz` to show; of a
        `JointModel` its `gear_ratio`, which it does not know, and the `measured` response to draw
        beside it.

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    InvalidInput
        Matplotlib is missing, or the record has no such part.
    """
    return draw(_figure(record, **which))


# --- tables -----------------------------------------------------------------------------------


@singledispatch
def _table(record: object) -> str:
    raise TypeError(f"no table is known of a {type(record).__name__}")


@_table.register
def _(log: Log) -> str:
    rows = [
        (name, f"{values.min():.4g}", f"{values.max():.4g}", f"{values.std():.4g}")
        for name, values in log.channels.items()
    ]
    head = f"log {log.name}: {len(log)} samples every {1e3 * log.sample_time:.4g} ms"
    return _html(head, ("channel", "least", "largest", "deviation"), rows, log.warnings)


@_table.register
def _(model: RigidModel) -> str:
    head = f"rigid model, {model.status}: {model.n_rows} equations, condition number "
    head += f"{model.condition_number:.3g}, band to {model.bandwidth_hz:.3g} Hz"
    return _html(head, _PARAMETER_HEADS, _rows(model.parameters), model.warnings)


@_table.register
def _(joint: Decoupled) -> str:
    rows = [("holds" if check.passed else "fails", check.message) for check in joint.checks]
    head = f"joint {joint.joint} on its own, record {joint.experiment.name}: "
    head += f"{len(joint.time)} samples, {joint.inputs.shape[1]} input(s)"
    return _html(head, ("check", "of the data"), rows, joint.warnings)


@_table.register
def _(joint: JointModel) -> str:
    head = f"joint {joint.joint}, {joint.status}, by {joint.method} from "
    head += ", ".join(joint.experiments)
    rows = [*_rows(joint.parameters), *_ringing(joint)]
    return _html(head, _PARAMETER_HEADS, rows, joint.warnings)


@_table.register
def _(record: RecordModel) -> str:
    if record.physical is not None:
        return _table(record.physical)
    head = f"joint {record.signals.joint}, record {record.signals.experiment.name}: no model"
    return _html(head, (), (), record.warnings)


@_table.register
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


@_table.register
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


@_table.register
def _(arm: ArmModel) -> str:
    head = f"the whole arm at once: {arm.status} after {arm.iterations} evaluations"
    return _html(head, _PARAMETER_HEADS, _rows(arm.parameters), arm.warnings)


@_table.register
def _(prediction: Prediction) -> str:
    rows = [(name, percent(fit)) for name, fit in prediction.fit_percent.items()]
    head = f"record {prediction.experiment}, predicted"
    return _html(head, ("channel", "fit"), rows, prediction.warnings)


@_table.register
def _(found: Identification) -> str:
    head = f"{found.study.path.name}: " + ("determined" if found.determined else str(found.reason))
    return _html(head, _PARAMETER_HEADS, _rows(found.parameters), found.warnings)


def _rows(parameters: Iterable[Parameter]) -> list[tuple[str, ...]]:
    return [
        (p.name, str(p.joint or "arm"), *plus_minus(p.value, p.std), p.unit) for p in parameters
    ]


def _ringing(joint: JointModel) -> list[tuple[str, ...]]:
    modes: Mapping[str, Mode | None] = {
        "anti-resonance": joint.anti_resonance,
        "resonance": joint.resonance,
    }
    return [
        (name, str(joint.joint), *plus_minus(mode.frequency_hz, mode.frequency_std_hz), "Hz")
        for name, mode in modes.items()
        if mode is not None
    ]


def _html(
    head: str,
    columns: Iterable[str],
    rows: Iterable[tuple[str, ...]],
    warnings: Iterable[Caution],
) -> str:
    """One table, a row of it a tuple of texts; the warnings below it."""
    titles = "".join(f'<th scope="col">{escape(name)}</th>' for name in columns)
    body = "".join(
        "<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>" for row in rows
    )
    told = "".join(
        f"<li><code>{escape(w.code)}</code> {escape(w.where)}: {escape(w.message)}</li>"
        for w in warnings
    )
    table = f"<table><thead><tr>{titles}</tr></thead><tbody>{body}</tbody></table>" if body else ""
    return f"<div><p><strong>{escape(head)}</strong></p>{table}" + (
        f"<ul>{told}</ul></div>" if told else "</div>"
    )


# --- pictures ---------------------------------------------------------------------------------


@singledispatch
def _figure(record: object) -> figures.Figure:
    raise TypeError(f"no picture is known of a {type(record).__name__}")


@_figure.register
def _(log: Log) -> figures.Figure:
    """What drives the motors, and where they turn."""
    above = {n: v for n, v in log.channels.items() if n.startswith(("u", "torque"))}
    below = {n: v for n, v in log.channels.items() if n.startswith("theta_m")}
    titles = ("drive [V, N m]", "motor angle [rad]")
    return _stacked(log.time, above, below, titles, f"log {log.name}")


@_figure.register
def _(joint: Decoupled) -> figures.Figure:
    """The inputs, and both velocities on the link's side of the gear."""
    names = ("motor torque less Coulomb friction", "n times interaction torque")
    sizes = (1.0, joint.gear_ratio)
    columns = zip(names, sizes, joint.inputs.T, strict=False)
    above = {name: size * column for name, size, column in columns}
    below = {
        "n times motor velocity": joint.gear_ratio * joint.outputs[:, 0],
        "link velocity": joint.outputs[:, 1],
    }
    caption = f"joint {joint.joint} on its own, record {joint.experiment.name}"
    return _stacked(
        joint.time, above, below, ("[N m] at the motor", "[rad/s] at the link"), caption
    )


@_figure.register(RigidModel)
@_figure.register(ArmModel)
@_figure.register(Identification)
def _(model: RigidModel | ArmModel | Identification) -> figures.Figure:
    return certainty(model.parameters)


@_figure.register
def _(
    joint: JointModel, *, gear_ratio: float, measured: FrequencyResponse | None = None
) -> figures.Figure:
    return elastic.response(joint, gear_ratio, measured)


@_figure.register
def _(record: RecordModel) -> figures.Figure:
    if record.physical is None:
        raise InvalidInput(
            "the record has no physical model to draw",
            where=record.signals.experiment.name,
            remedy="read its warnings, which say why",
        )
    return elastic.response(record.physical, record.signals.gear_ratio, None)


@_figure.register
def _(
    response: FrequencyResponse,
    *,
    output: int = 0,
    input: int = 0,
    band_hz: tuple[float, float] | None = None,
) -> figures.Figure:
    """Where it is told: a point less sure than `_NOISY` would hide the others."""
    f, G = response.frequencies_hz, response.response[:, output, input]
    low, high = band_hz or (0.0, np.inf)
    size, phase = _spread(response, output, input)
    shown = (f > 0.0) & (f >= low) & (f <= high)
    if size is not None:
        shown &= size < _NOISY * np.abs(G)
    if not shown.any():
        raise InvalidInput(
            "no point of the response is known well enough to draw",
            remedy="average more periods, or draw another input, output or band_hz",
        )
    curve = curves.Curve(
        response.method,
        f[shown],
        G[shown],
        None if size is None else size[shown],
        None if phase is None else phase[shown],
    )
    return curves.bode([curve], f"input {input} to output {output}")


def _spread(
    response: FrequencyResponse, output: int, input: int
) -> tuple[FloatArray | None, FloatArray | None]:
    """Deviations of modulus and phase: a model's by its covariance, a measured one's by its noise.

    Noise has no direction, so half of its variance lies along the modulus.
    """
    if response.noise_variance is not None:
        size = np.sqrt(0.5 * response.noise_variance[:, output, input])
        return size, size / np.abs(response.response[:, output, input])
    modulus, phase = response.magnitude_std, response.phase_std
    if modulus is None or phase is None:
        return None, None
    return modulus[:, output, input], phase[:, output, input]


@_figure.register
def _(sweep: Sweep) -> figures.Figure:
    return elastic.stiffness(sweep)


@_figure.register
def _(prediction: Prediction, *, channel: str | None = None) -> figures.Figure:
    fits = prediction.fit_percent
    worst = min(prediction.channels, key=lambda name: fits.get(name, np.inf))
    chosen = channel or worst
    if chosen not in prediction.channels:
        raise InvalidInput(
            f"no channel {chosen!r} was predicted",
            where=prediction.experiment,
            remedy=f"take one of {', '.join(prediction.channels)}",
        )
    drawn = figures.time_fit(prediction, prediction.channels.index(chosen))
    fit = percent(fits.get(chosen, float("nan")))
    drawn["layout"]["meta"] = f"{prediction.experiment}, {chosen}: fit {fit}"
    return drawn


def certainty(parameters: Iterable[Parameter]) -> figures.Figure:
    """How well each parameter is known: its deviation as a share of its value.

    Parameters
    ----------
    parameters : iterable of Parameter
        Those without a value or a deviation are left out.

    Returns
    -------
    dict
        A plotly figure.
    """
    known = [(p, p.std / abs(p.value)) for p in parameters if p.std is not None and p.value]
    names = [p.name + (f" {p.joint}" if p.joint else "") for p, _ in known]
    return {
        "data": [
            {
                "type": "scatter",
                "mode": "markers",
                "name": "standard deviation",
                "x": names,
                "y": [100.0 * share for _, share in known],
                "marker": {"color": figures.MEASURED, "size": 8},
            }
        ],
        "layout": {
            "height": 480,  # the names stand upright
            "xaxis": {"title": {"text": ""}, "tickangle": -90},
            "yaxis": {"type": "log", "title": {"text": "deviation [% of the value]"}},
        },
    }


def _stacked(
    time: Any,
    above: Mapping[str, Any],
    below: Mapping[str, Any],
    titles: tuple[str, str],
    caption: str,
) -> figures.Figure:
    """Lines over one time axis, on two axes, one above the other."""
    data = []
    looks = zip(curves.PALETTE * 2, curves.DASHES * 2, strict=True)
    parts = [("y", *item) for item in above.items()] + [("y2", *item) for item in below.items()]
    for (axis, name, values), (colour, dash) in zip(parts, looks, strict=False):
        pick = figures.thinned(time, values)
        drawn = figures.line(figures.rounded(time[pick]), values[pick], name, colour, dash=dash)
        data.append(drawn | {"yaxis": axis})
    return {
        "data": data,
        "layout": {
            "meta": caption,
            "xaxis": {"title": {"text": "time [s]"}, "anchor": "y2"},
            "yaxis": {"title": {"text": titles[0]}, "domain": [0.54, 1.0]},
            "yaxis2": {"title": {"text": titles[1]}, "domain": [0.0, 0.46]},
        },
    }
