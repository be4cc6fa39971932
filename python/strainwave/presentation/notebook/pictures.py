"""Records as the report's plotly dictionaries; some may be asked for a part of themselves."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
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
)
from strainwave.domain.formatting import percent
from strainwave.errors import InvalidInput
from strainwave.presentation.report import bode, curves, elastic, figures, predictions

_NOISY = 0.3  # relative deviation from which a point of a response is left out


@singledispatch
def figure_of(record: object) -> figures.Figure:
    """A record's figure; `picture_of` says what may be asked for.

    Parameters
    ----------
    record : record of `strainwave.domain`

    Returns
    -------
    dict
        A plotly figure.

    Raises
    ------
    InvalidInput
        The record has no such part.
    """
    raise TypeError(f"no picture is known of a {type(record).__name__}")


@figure_of.register
def _(log: Log) -> figures.Figure:
    """What drives the motors, and where they turn."""
    above = {n: v for n, v in log.channels.items() if n.startswith(("u", "torque"))}
    below = {n: v for n, v in log.channels.items() if n.startswith("theta_m")}
    titles = ("drive [V, N m]", "motor angle [rad]")
    return _stacked(log.time, above, below, titles, f"log {log.name}")


@figure_of.register
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


@figure_of.register(RigidModel)
@figure_of.register(ArmModel)
@figure_of.register(Identification)
def _(model: RigidModel | ArmModel | Identification) -> figures.Figure:
    return certainty(model.parameters)


@figure_of.register
def _(
    joint: JointModel, *, gear_ratio: float, measured: FrequencyResponse | None = None
) -> figures.Figure:
    return bode.bode(joint, gear_ratio, measured)


@figure_of.register
def _(record: RecordModel) -> figures.Figure:
    if record.joint_model is None:
        raise InvalidInput(
            "the record has no physical model to draw",
            where=record.signals.experiment.name,
            remedy="read its warnings, which say why",
        )
    return bode.bode(record.joint_model, record.signals.gear_ratio, None)


@figure_of.register
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


@figure_of.register
def _(sweep: Sweep) -> figures.Figure:
    return elastic.stiffness(sweep)


@figure_of.register
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
    drawn = predictions.of_prediction(prediction, channels=(chosen,))
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
    time: FloatArray,
    above: Mapping[str, FloatArray],
    below: Mapping[str, FloatArray],
    titles: tuple[str, str],
    caption: str,
) -> figures.Figure:
    """Lines over one time axis, on two axes, one above the other."""
    data = []
    looks = zip(curves.PALETTE * 2, curves.DASHES * 2, strict=True)
    parts = [("y", *item) for item in above.items()] + [("y2", *item) for item in below.items()]
    for (axis, name, values), (colour, dash) in zip(parts, looks, strict=False):
        pick = figures.thinned(values)
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
