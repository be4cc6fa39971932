"""Residual analysis: tests, spectra, correlations, and the effects that may explain residuals."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from strainwave import domain
from strainwave.domain import FloatArray
from strainwave.domain.arm.effects import effect_named
from strainwave.domain.messages import plus_minus
from strainwave.domain.results.distributions import CI99_STDS
from strainwave.numerics.spectra import correlate_residuals, expected_autocorrelation
from strainwave.report import figures
from strainwave.report.document import blocks
from strainwave.report.document.blocks import Block, FigureName, Fold, Plot, Row, Span, Table
from strainwave.report.document.predictions import unit_of
from strainwave.report.figures import Area, Axis, Colour, Figure, Line, Mark, Panel

MIN_PROBABILITY = 1e-3  # smaller probabilities are shown as "< 0.001"
_LISTED_SIZES = 3  # sizes of one effect in a cell
_LISTED_SHIFTS = 4  # parameters moved by one effect in a cell
_CORRELATION_HEIGHT = 0.7  # of a panel
_LIMITS = (
    "Shaded: 99 % limits for residuals that are sensor noise (autocorrelation, after the low-pass"
    " of the fit) and independent of the inputs (cross-correlation)."
)


def residual_tests(criticism: domain.Criticism) -> Iterator[Block]:
    """Tables of the residual tests and the effects, and a spectrum for each channel."""
    tests = criticism.residuals
    channels = list(dict.fromkeys(test.channel for test in tests))
    worst = [max((t for t in tests if t.channel == name), key=_noise_ratio) for name in channels]
    yield from _residual_table("Whole-arm fit: largest residuals of each channel", worst)
    if len(tests) > len(worst):
        label = f"All {len(tests)} residual tests"
        yield Fold(label, tuple(_residual_table(label, tests, heading=False)))
    share = blocks.number("share of the cost")
    heads: Row = ("effect", "joint", "its parameters", share, "changes by it", "model")
    title = "Effects that the model includes, and plausible ones that the intervals contain"
    yield from blocks.table(title, heads, map(_cause_row, criticism.causes))
    for name in dict.fromkeys(cause.effect for cause in criticism.causes):
        effect = effect_named(name)
        yield blocks.paragraph(
            Span(effect.name, kind="code"),
            f" is {effect.description}. Without it in the model, {effect.consequence}."
            f" To confirm it, {effect.experiment}.",
        )
    for test in worst:
        label = f"{test.experiment}, {test.channel}: residual spectrum"
        caption = (
            f"The residuals are {_noise_ratio(test):.2g} times the sensor noise; the excess is"
        )
        caption += f" largest near {test.worst_hz:.3g} Hz."
        yield Plot(FigureName("residuals", part=test.channel), label, spectrum(test), caption)


def residual_correlations(identification: domain.Identification) -> Iterator[Block]:
    """Auto- and cross-correlations: check records open, fitted records and state space folded."""
    tests = identification.whole_arm.criticism if identification.whole_arm else None
    by_record: dict[str, list[domain.ResidualTest]] = {}
    for test in tests.residuals if tests else ():
        by_record.setdefault(test.experiment, []).append(test)
    yield from _check_correlations(identification, by_record)
    fitted: list[Plot] = []
    for name, record in by_record.items():
        panels: list[Panel] = []
        for test in record:
            if test.correlation is not None:
                panels += _residual_panels(test.channel, test.correlation, test)
        if panels:
            fitted.append(_correlation_plot(name, "fitted", panels))
    if fitted:
        yield Fold(f"Residual correlations of fitted records ({len(fitted)})", tuple(fitted))
    models = tuple(_state_space_plots(identification.records))
    if models:
        yield Fold(f"Residual correlations of state-space models ({len(models)})", models)


def spectrum(test: domain.ResidualTest) -> Figure:
    """Amplitude spectral density of the residuals and of the sensor noise."""
    positive = test.frequency_hz > 0.0
    f = test.frequency_hz[positive]
    residuals, noise = (np.sqrt(d[positive]) for d in (test.density, test.noise_density))
    axis = Axis(f"{test.channel} [{unit_of(test.channel)}/sqrt(Hz)]", log=True)
    lines = (
        Line(f, residuals, "residuals", Colour.MEASURED),
        Line(f, noise, "sensor noise", Colour.RESIDUAL, figures.SHORT_DASH),
    )
    return Figure(figures.FREQUENCY_AXIS, (Panel(axis, lines),))


def _residual_table(
    title: str, tests: Sequence[domain.ResidualTest], *, heading: bool = True
) -> Iterator[Table]:
    numbers = map(blocks.number, ("residual / noise", "largest excess at", "like sensor noise"))
    heads: Row = ("record", "channel", *numbers, "correlated with an input")
    return blocks.table(title, heads, map(_residual_row, tests), heading=heading)


def _residual_row(test: domain.ResidualTest) -> Row:
    input_text = "no"
    if test.input_probability < MIN_PROBABILITY:
        input_text = f"joint {test.input_joint}, r = {test.input_correlation:.2f},"
        input_text += f" delay {1e3 * test.input_delay:.3g} ms"
    p = f"p < {MIN_PROBABILITY:g}"
    if test.whiteness >= MIN_PROBABILITY:
        p = f"p = {test.whiteness:.2g}"
    numbers = blocks.two_digits(_noise_ratio(test)), f"{test.worst_hz:.3g} Hz", p
    return (test.experiment, test.channel, *map(blocks.number, numbers), input_text)


def _noise_ratio(test: domain.ResidualTest) -> float:
    return test.deviation / test.noise if test.noise > 0.0 else 0.0


def _cause_row(cause: domain.Cause) -> Row:
    prefix = cause.effect.replace("-", "_") + "_"
    sizes = [
        f"{p.name.removeprefix(prefix)} {' ± '.join(plus_minus(p.value, p.std))} {p.unit}".rstrip()
        for p in cause.parameters
        if p.value is not None and p.std is not None
    ]
    more = len(sizes) - _LISTED_SIZES  # some effects have a size for each record
    listed = ", ".join(sizes[:_LISTED_SIZES]) + (f" and {more} more" if more > 0 else "")
    shifts = []
    for shift in cause.shifts[:_LISTED_SHIFTS]:
        change = f"{shift.deviations:+.2g} standard deviations"
        if shift.without:
            change = f"{100.0 * shift.shift / shift.without:+.2g} %"
        shifts.append(f"{shift.label} {change}")
    share = blocks.number(f"{blocks.two_digits(100.0 * cause.share)} %")
    return (
        cause.effect,
        str(cause.joint),
        listed or "not identified",
        share,
        blocks.prose(", ".join(shifts)),
        "included" if cause.is_included else f"weight {blocks.two_digits(cause.weight)}",
    )


def _check_correlations(
    identification: domain.Identification, by_record: Mapping[str, Sequence[domain.ResidualTest]]
) -> Iterator[Plot]:
    """Of check records that the whole-arm fit predicts, at the lags of the fitted records."""
    logs = {log.name: log for log in identification.logs}
    lag_times = {
        test.channel: test.correlation.lag_time
        for tests in by_record.values()
        for test in tests
        if test.correlation is not None
    }
    noise = {  # the low-pass behind the noise depends on the sample time
        (test.channel, logs[name].sample_time): test
        for name, tests in by_record.items()
        for test in tests
        if name in logs
    }
    for prediction in identification.checks:
        log = logs.get(prediction.experiment)
        if prediction.of_drive or log is None:
            continue
        panels: list[Panel] = []
        for column, channel in enumerate(prediction.channels):
            is_moving = np.isfinite(prediction.fit_percent.get(channel, np.nan))
            if channel in lag_times and is_moving:
                correlation = _prediction_correlation(prediction, column, log, lag_times[channel])
                panels += _residual_panels(
                    channel, correlation, noise.get((channel, log.sample_time))
                )
        if panels:
            yield _correlation_plot(prediction.experiment, "check", panels)


def _correlation_plot(experiment: str, use: str, panels: Sequence[Panel]) -> Plot:
    return Plot(
        FigureName("correlation", experiment=experiment),
        f"{experiment}, {use}: residual correlations",
        Figure(Axis("lag [ms]"), tuple(panels)),
        _LIMITS,
    )


def _prediction_correlation(
    prediction: domain.Prediction, column: int, log: domain.Log, lag_time: float
) -> domain.ResidualCorrelation:
    """Residuals and drives of a check record, averaged over the lag time of the fitted records."""
    sample_time = float(prediction.time[1] - prediction.time[0])
    step = max(1, round(lag_time / sample_time))
    residual = prediction.measured[:, column] - prediction.predicted[:, column]
    names = [n for n in log.channels if n.rstrip("0123456789") in ("u", "torque")]
    drives = np.column_stack(
        [np.interp(prediction.time, log.time, log.channels[name]) for name in names]
    )
    rows = len(residual) // step * step
    inputs = drives[:rows].reshape(-1, step, len(names)).mean(axis=1)
    middle = residual[:rows].reshape(-1, step).mean(axis=1)
    return correlate_residuals(middle, inputs, step * sample_time)


def _residual_panels(
    channel: str, correlation: domain.ResidualCorrelation, test: domain.ResidualTest | None
) -> list[Panel]:
    auto, limits = correlation.autocorrelation, None
    if test is not None and test.noise > 0.0:
        expected, std = expected_autocorrelation(
            test.frequency_hz,
            test.noise_density,
            correlation.lag_time,
            len(auto) - 1,
            correlation.n_samples,
        )
        limits = (expected - CI99_STDS * std, expected + CI99_STDS * std)
    lag = np.asarray(
        1e3 * correlation.lag_time * np.arange(-len(auto) + 1, len(auto)), dtype=np.float64
    )
    columns = zip(correlation.cross_correlation.T, correlation.cross_std.tolist(), strict=True)
    cross = {
        f"input of joint {j}": (column, CI99_STDS * limit)
        for j, (column, limit) in enumerate(columns, start=1)
    }
    return _correlation_panels(channel, lag, auto, limits, cross)


def _correlation_panels(
    channel: str,
    lag: FloatArray,
    auto: FloatArray,
    limits: tuple[FloatArray, FloatArray] | None,
    cross: Mapping[str, tuple[FloatArray, float]],
) -> list[Panel]:
    """Two panels over one lag axis; limits are bands around what independence predicts."""

    def both(values: FloatArray) -> FloatArray:
        return np.concatenate([values[:0:-1], values])

    name = "autocorrelation"
    above: list[Mark] = [Line(lag, both(auto), name, Colour.MODEL, size=3.0, width=1.0)]
    if limits is not None:
        above.insert(0, Area(lag, both(limits[0]), both(limits[1]), Colour.RESIDUAL, name))
    below: list[Mark] = []
    for k, (label, (values, limit)) in enumerate(cross.items()):
        colour = figures.PALETTE[(0, 2, 3, 4, 5)[k % 5]]
        below.append(
            Area(lag, np.full(len(lag), -limit), np.full(len(lag), limit), Colour.RESIDUAL, label)
        )
        below.append(
            Line(
                lag,
                values,
                label,
                colour,
                figures.DASHES[k % len(figures.DASHES)],
                size=3.0,
                width=1.0,
            )
        )
    range_ = (-1.05, 1.05)
    panels = [Panel(Axis(f"{channel} [auto]", range=range_), tuple(above), _CORRELATION_HEIGHT)]
    if below:
        panels.append(Panel(Axis(f"{channel} [cross]"), tuple(below), _CORRELATION_HEIGHT))
    return panels


def _state_space_plots(records: Sequence[domain.RecordModel]) -> Iterator[Plot]:
    outputs, inputs = ("motor velocity", "link velocity"), ("motor torque", "interaction torque")
    for record in records:
        if record.check is None or record.state_space is None:
            continue
        check, sample_time = record.check, record.state_space.sample_time
        lags = len(check.autocorrelation) - 1
        lag = np.asarray(1e3 * sample_time * np.arange(-lags, lags + 1), dtype=np.float64)
        flat = np.full(lags + 1, check.confidence_99)
        flat[0] = 1.0
        panels: list[Panel] = []
        for o in range(check.autocorrelation.shape[1]):
            cross = {
                inputs[i]: (check.cross_correlation[:, o, i], check.confidence_99)
                for i in range(check.cross_correlation.shape[2])
            }
            auto = check.autocorrelation[:, o, o]
            panels += _correlation_panels(outputs[o], lag, auto, (-flat, flat), cross)
        figure = Figure(Axis("lag [ms]"), tuple(panels))
        name, joint = record.signals.experiment.name, record.signals.joint
        label = f"Joint {joint}, {name}: state-space model on the data that were not fitted"
        caption = "Shaded: 99 % limits for white residuals that are independent of the inputs."
        yield Plot(FigureName("correlation", joint, name), label, figure, caption)
