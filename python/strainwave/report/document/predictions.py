"""Channels over time: the logs as recorded, and predictions with the residuals below each."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from strainwave.domain import Identification, Joint, Log, Prediction, channel_parts
from strainwave.domain.arm.link_sensors import all_types
from strainwave.report import figures
from strainwave.report.document.blocks import Block, FigureName, Fold, Plot
from strainwave.report.figures import Axis, Colour, Dash, Figure, Line, Panel
from strainwave.report.figures.curves import Series, lines

_MODEL_DASH: Dash = (6.0, 4.0)  # the measured line shows through
_RESIDUAL_HEIGHT = 0.45  # of a residual panel relative to the panel above
_MOTOR_UNITS = {"u": "V", "torque": "N m", "theta_m": "rad", "omega_m": "rad/s", "ref": "rad/s"}
_MOTOR_UNITS |= {"temperature": "°C", "t": "s"}
_PRISMATIC_MOTOR_UNITS = _MOTOR_UNITS | {
    "torque": "N",
    "theta_m": "m",
    "omega_m": "m/s",
    "ref": "m/s",
}


def prediction_figure(
    prediction: Prediction,
    joints: Sequence[Joint] = (),
    limit: int = figures.MAX_POINTS,
    channels: Sequence[str] = (),
    model: str = "model",
) -> Figure:
    """Measured and predicted channels of a record over time, and the residuals of each.

    All channels are shown unless some are named. A line has at most `limit` points; `model` names
    the predicted lines.
    """
    panels: list[Panel] = []
    for channel in channels or prediction.channels:
        column = prediction.channels.index(channel)
        measured, predicted = prediction.measured[:, column], prediction.predicted[:, column]
        residuals = measured - predicted
        rows = figures.decimate(np.column_stack([measured, predicted, residuals]), limit)
        time = prediction.time[rows]
        both = (
            Line(time, measured[rows], "measured", Colour.MEASURED, width=2.5),
            Line(time, predicted[rows], model, Colour.MODEL, _MODEL_DASH),
        )
        residual = Line(time, residuals[rows], "residual", Colour.RESIDUAL, width=1.0)
        unit = unit_of(channel, joints)
        panels.append(Panel(Axis(f"{channel} [{unit}]"), both))
        panels.append(Panel(Axis(f"residual [{unit}]"), (residual,), _RESIDUAL_HEIGHT))
    return Figure(Axis("time [s]"), tuple(panels))


def difference_figure(
    predictions: Mapping[str, Prediction], channel: str, joints: Sequence[Joint]
) -> Figure:
    """Predicted minus measured channel of one record over time, of each prediction that has it."""
    series = []
    for name, prediction in predictions.items():
        if channel in prediction.channels:
            k = prediction.channels.index(channel)
            difference = prediction.predicted[:, k] - prediction.measured[:, k]
            series.append(Series(name, prediction.time, difference))
    unit = unit_of(channel, joints)
    return lines(series, "time [s]", f"{channel}, simulated minus measured [{unit}]", "")


def unit_of(channel: str, joints: Sequence[Joint] = (), *, commands_angles: bool = False) -> str:
    """The unit of a log channel such as `u1` or `omega_m2`; joints are revolute by default.

    References are velocities, or angles of a position servo: `commands_angles`.
    """
    kind, number = channel_parts(channel)
    kind = "theta_m" if kind == "ref" and commands_angles else kind
    is_prismatic = 0 < number <= len(joints) and joints[number - 1].motion == "prismatic"
    for sensor in all_types():
        if kind in sensor.channel_kinds:
            prismatic = sensor.prismatic_unit or sensor.unit
            return (prismatic if is_prismatic else sensor.unit).replace("^2", "²")
    return (_PRISMATIC_MOTOR_UNITS if is_prismatic else _MOTOR_UNITS).get(kind, "")


_TITLES = {
    "u": "voltage",
    "torque": "motor torque",
    "theta_m": "angle",
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
        has_angles = identification.study.arm.position_servo is not None
        figure = recording_figure(log, joints, limit, commands_angles=has_angles)
        logs[title].append(Plot(FigureName("record", experiment=log.name), label, figure, caption))
    for title, plots in logs.items():
        if identification.decisions and plots:
            yield Fold(f"{title} ({len(plots)})", tuple(plots))
        else:
            yield from plots


def recording_figure(
    log: Log, joints: Sequence[Joint], limit: int, *, commands_angles: bool = False
) -> Figure:
    """One panel for each physical quantity, one line for each channel.

    Lines keep the minimum and the maximum of each pixel column. A motor velocity that is not
    logged is the mean slope of the encoder angle between the points drawn. With `commands_angles`,
    the references are angles of joints, beside the measured ones.
    """
    of_reference = "theta_m" if commands_angles else "omega_m"
    panels: dict[str, list[Series]] = {}
    for series in _channel_series(log, limit, angles=commands_angles):
        kind, _ = channel_parts(series.name)
        unit = unit_of(series.name, joints, commands_angles=commands_angles)
        title = _TITLES[of_reference if kind == "ref" else kind]
        panels.setdefault(f"{title} [{unit}]", []).append(series)
    order = list(dict.fromkeys(_TITLES.values()))
    titles = sorted(panels, key=lambda title: order.index(title.rsplit(" [", 1)[0]))
    stack = tuple(Panel(Axis(title), tuple(_panel_lines(panels[title])), 0.8) for title in titles)
    return Figure(Axis("time [s]"), stack)


def _channel_series(log: Log, limit: int, *, angles: bool) -> Iterator[Series]:
    for name, values in log.channels.items():
        kind, number = channel_parts(name)
        if kind == "theta_m" and not angles:
            if f"omega_m{number}" not in log.channels:
                # the mean between evenly spaced rows averages the encoder's quantisation
                ends = np.linspace(0, len(values) - 1, max(2, limit // 2)).astype(np.intp)
                t, angle = log.time[np.unique(ends)], values[np.unique(ends)]
                slope = np.diff(angle) / np.diff(t)
                yield Series(f"omega_m{number}", 0.5 * (t[1:] + t[:-1]), slope)
        elif kind in _TITLES or kind == "ref":
            rows = figures.decimate(values, limit)
            yield Series(name, log.time[rows], values[rows])


def _panel_lines(panel: Sequence[Series]) -> Iterator[Line]:
    """Coloured by joint, axes of an IMU by dash; references are grey and below the others."""
    for series in sorted(panel, key=lambda series: channel_parts(series.name)[0] != "ref"):
        kind, number = channel_parts(series.name)
        time, values = series.x, series.y
        if kind == "ref":
            dash = figures.DASHES[1 + (number - 1) % 3]
            yield Line(time, values, f"reference {number}", Colour.RESIDUAL, dash, width=1.0)
            continue
        axis = kind[1:] if kind in ("ax", "ay", "az", "gx", "gy", "gz") else ""
        label = f"joint {number}, {axis}" if axis else f"joint {number}"
        dash, colour = (
            figures.DASHES["xyz".find(axis)] if axis else figures.SOLID,
            figures.PALETTE[(number - 1) % 6],
        )
        yield Line(time, values, label, colour, dash, width=1.2)
