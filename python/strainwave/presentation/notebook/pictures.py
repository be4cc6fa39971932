"""Records as figures; options select a part of a record."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from functools import singledispatch

import numpy as np

from strainwave.domain import (
    ArmModel,
    Decoupled,
    FloatArray,
    FrequencyResponse,
    Identification,
    JointModel,
    Log,
    Parameter,
    Prediction,
    RecordModel,
    RigidModel,
    Sweep,
    channel_parts,
)
from strainwave.domain.formatting import percent
from strainwave.errors import InvalidInput
from strainwave.presentation.figures import (
    DASHES,
    PALETTE,
    Axis,
    Colour,
    Figure,
    Line,
    Markers,
    Panel,
    curves,
    decimate,
)
from strainwave.presentation.report import amplitudes, bode, predictions

MAX_RELATIVE_STD = 0.3  # of a response: less certain points would hide the others


@singledispatch
def figure_of(record: object) -> Figure:
    """The figure of a record; `picture_of` lists the options.

    Raises InvalidInput if the record has no such part.
    """
    raise TypeError(f"a {type(record).__name__} has no figure")


@figure_of.register
def _(log: Log) -> Figure:
    """Drive and motor angles."""
    above = {n: v for n, v in log.channels.items() if channel_parts(n)[0] in ("u", "torque")}
    below = {n: v for n, v in log.channels.items() if channel_parts(n)[0] == "theta_m"}
    titles = ("drive [V, N m]", "motor angle [rad]")
    return _stacked(log.time, above, below, titles, f"log {log.name}")


@figure_of.register
def _(joint: Decoupled) -> Figure:
    """Inputs, and both velocities on the link side of the gear."""
    names = ("motor torque less Coulomb friction", "n times interaction torque")
    sizes = (1.0, joint.gear_ratio)
    columns = zip(names, sizes, joint.inputs.T, strict=False)
    above = {name: size * column for name, size, column in columns}
    below = {
        "n times motor velocity": joint.gear_ratio * joint.outputs[:, 0],
        "link velocity": joint.outputs[:, 1],
    }
    caption = f"joint {joint.joint}, decoupled, record {joint.experiment.name}"
    return _stacked(
        joint.time, above, below, ("[N m] at the motor", "[rad/s] at the link"), caption
    )


@figure_of.register(RigidModel)
@figure_of.register(ArmModel)
@figure_of.register(Identification)
def _(model: RigidModel | ArmModel | Identification) -> Figure:
    return certainty(model.parameters)


@figure_of.register
def _(joint: JointModel, *, gear_ratio: float, measured: FrequencyResponse | None = None) -> Figure:
    return bode.bode(joint, gear_ratio, measured)


@figure_of.register
def _(record: RecordModel) -> Figure:
    if record.joint_model is None:
        raise InvalidInput(
            "the record has no physical model to draw",
            where=record.signals.experiment.name,
            remedy="read its warnings, which state the reason",
        )
    return bode.bode(record.joint_model, record.signals.gear_ratio, None)


@figure_of.register
def _(
    response: FrequencyResponse,
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
    response: FrequencyResponse, output: int, input: int
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
def _(sweep: Sweep) -> Figure:
    return amplitudes.stiffness_figure(sweep)


@figure_of.register
def _(prediction: Prediction, *, channel: str | None = None) -> Figure:
    fits = prediction.fit_percent
    lowest = min(prediction.channels, key=lambda name: fits.get(name, np.inf))
    channel_name = channel or lowest
    if channel_name not in prediction.channels:
        raise InvalidInput(
            f"channel {channel_name!r} is not predicted",
            where=prediction.experiment,
            remedy=f"choose one of {', '.join(prediction.channels)}",
        )
    figure = predictions.prediction_figure(prediction, channels=(channel_name,))
    fit = percent(fits.get(channel_name, float("nan")))
    return replace(figure, caption=f"{prediction.experiment}, {channel_name}: fit {fit}")


def certainty(parameters: Iterable[Parameter]) -> Figure:
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
    """Two panels of lines over one time axis."""
    styles = iter(zip(PALETTE * 2, DASHES * 2, strict=True))
    panels = []
    for title, group in zip(titles, (above, below), strict=True):
        marks = []
        for (name, values), (colour, dash) in zip(group.items(), styles, strict=False):
            rows = decimate(values)
            marks.append(Line(time[rows], values[rows], name, colour, dash))
        panels.append(Panel(Axis(title), tuple(marks)))
    return Figure(Axis("time [s]"), tuple(panels), caption=caption)
