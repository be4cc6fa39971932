"""The logs as recorded: drive, motor velocity and link sensors over time."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from strainwave.domain import FloatArray, Identification, Joint, Log, channel_parts
from strainwave.domain.link_sensors import all_types
from strainwave.presentation.figures import (
    DASHES,
    PALETTE,
    SOLID,
    Axis,
    Colour,
    Figure,
    Line,
    Panel,
    decimate,
)
from strainwave.presentation.figures.curves import Series
from strainwave.presentation.report.blocks import Block, FigureName, Fold, Plot
from strainwave.presentation.report.predictions import unit_of

_TITLES = {
    "u": "voltage",
    "torque": "motor torque",
    "omega_m": "motor velocity",
    **{kind: sensor.measurand for sensor in all_types() for kind in sensor.channel_kinds},
}
"""Panel of each kind of channel; the position of a title is the position of its panel."""


def recordings(identification: Identification, limit: int) -> Iterator[Block]:
    """A figure of each record, at most `limit` points a line; folded if there are results."""
    logs = {"Fitted records": list[Plot](), "Check records": list[Plot]()}
    joints = identification.study.arm.joints
    for log in identification.logs:
        title = "Check records" if log.experiment.use == "check" else "Fitted records"
        duration = float(log.time[-1] - log.time[0]) if len(log) else 0.0
        caption = (
            f"{len(log)} samples, {duration:.4g} s, sample time {1e3 * log.sample_time:.4g} ms."
        )
        label = f"{log.name}: {log.experiment.use} record"
        figure = recording_figure(log, joints, limit)
        logs[title].append(Plot(FigureName("record", experiment=log.name), label, figure, caption))
    for title, plots in logs.items():
        if identification.decisions and plots:
            yield Fold(f"{title} ({len(plots)})", tuple(plots))
        else:
            yield from plots


def recording_figure(log: Log, joints: Sequence[Joint], limit: int) -> Figure:
    """One panel for each physical quantity, one line for each channel.

    Lines keep the minimum and the maximum of each pixel column. A motor velocity that is not
    logged is the mean slope of the encoder angle between the points drawn.
    """
    panels: dict[str, list[Series]] = {}
    for series in _channel_series(log, limit):
        kind, number = channel_parts(series.name)
        unit = unit_of(f"omega_m{number}" if kind == "ref" else series.name, joints)
        title = _TITLES["omega_m" if kind == "ref" else kind]
        panels.setdefault(f"{title} [{unit}]", []).append(series)
    order = list(dict.fromkeys(_TITLES.values()))
    titles = sorted(panels, key=lambda title: order.index(title.rsplit(" [", 1)[0]))
    stack = tuple(Panel(Axis(title), tuple(_panel_lines(panels[title])), 0.8) for title in titles)
    return Figure(Axis("time [s]"), stack)


def _channel_series(log: Log, limit: int) -> Iterator[Series]:
    """The line of each channel."""
    channels: Mapping[str, FloatArray] = log.channels
    for name, values in channels.items():
        kind, number = channel_parts(name)
        if kind == "theta_m":
            if f"omega_m{number}" not in channels:
                yield Series(f"omega_m{number}", *_mean_slope(log.time, values, limit))
        elif kind in _TITLES or kind == "ref":
            rows = decimate(values, limit)
            yield Series(name, log.time[rows], values[rows])


def _mean_slope(time: FloatArray, angle: FloatArray, limit: int) -> tuple[FloatArray, FloatArray]:
    """Mean velocity between evenly spaced rows, which averages the encoder's quantisation."""
    rows = np.unique(np.linspace(0, len(time) - 1, max(2, limit // 2)).astype(np.intp))
    t = time[rows]
    return 0.5 * (t[1:] + t[:-1]), np.diff(angle[rows]) / np.diff(t)


def _panel_lines(panel: Sequence[Series]) -> Iterator[Line]:
    """Coloured by joint, axes of an IMU by dash; references are grey and below the others."""
    for series in sorted(panel, key=lambda series: channel_parts(series.name)[0] != "ref"):
        kind, number = channel_parts(series.name)
        time, values = series.x, series.y
        if kind == "ref":
            dash = DASHES[1 + (number - 1) % 3]
            yield Line(time, values, f"reference {number}", Colour.RESIDUAL, dash, width=1.0)
            continue
        axis = kind[1:] if kind in ("ax", "ay", "az", "gx", "gy", "gz") else ""
        label = f"joint {number}, {axis}" if axis else f"joint {number}"
        dash, colour = DASHES["xyz".find(axis)] if axis else SOLID, PALETTE[(number - 1) % 6]
        yield Line(time, values, label, colour, dash, width=1.2)
