"""What the report shows of what a fit leaves, and of what might explain it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from strainwave.domain import Cause, Criticism, ParameterShift, ResidualTest, ScoreTest
from strainwave.domain.effects import effect_named
from strainwave.domain.formatting import plus_minus
from strainwave.presentation.figures import BRIEF, MEASURED, RESIDUAL, Axis, Figure, Line, Panel
from strainwave.presentation.report.blocks import (
    Block,
    Fold,
    Paragraph,
    Plot,
    Row,
    Span,
    Table,
    number,
    paragraph,
    table,
)
from strainwave.presentation.report.predictions import unit_of

_CHANCE = 1e-3  # probabilities below are not separated
_SHOWN = 6  # score tests that are shown at first
_LISTED = 3  # sizes of an effect that are listed
_MOVES = 4  # parameters that are named of those that an effect moves


def criticised(criticism: Criticism) -> Iterator[Block]:
    """Tables of the tests, and the spectrum of the worst record of each channel.

    Parameters
    ----------
    criticism : Criticism

    Yields
    ------
    Block
    """
    tests = criticism.residuals
    channels = list(dict.fromkeys(test.channel for test in tests))
    worst = [max((t for t in tests if t.channel == name), key=_loudness) for name in channels]
    yield from _tests("What the fit leaves, the worst record of each channel", worst)
    if len(tests) > len(worst):
        label = f"What the fit leaves, all {len(tests)} tests"
        yield Fold(f"All {len(tests)} tests", tuple(_tests(label, tests, heading=False)))
    share = number("share of the cost")
    heads: Row = ("effect", "joint", "its parameters", share, "moves")
    fitted = map(_fitted, criticism.causes)
    yield from table("What the model most likely lacks, each fitted", heads, fitted)
    yield from map(_in_words, dict.fromkeys(cause.effect for cause in criticism.causes))
    yield from _score_tests("What further effects would explain", criticism.score_tests[:_SHOWN])
    if len(criticism.score_tests) > _SHOWN:
        label = f"All {len(criticism.score_tests)} effects that were tested"
        yield Fold(label, tuple(_score_tests(label, criticism.score_tests, heading=False)))
    for test in worst:
        label = f"{test.experiment}, {test.channel}: residuals over frequency"
        words = f"The residuals are {_loudness(test):.2g} times the sensor's noise, and exceed it"
        words += f" most near {test.worst_hz:.3g} Hz."
        yield Plot(f"residuals {test.channel}", label, spectrum(test), words)


def _tests(title: str, tests: Sequence[ResidualTest], *, heading: bool = True) -> Iterator[Table]:
    numbers = map(number, ("times its noise", "most at", "like noise"))
    heads: Row = ("record", "channel", *numbers, "follows an input")
    return table(title, heads, map(_row, tests), heading=heading)


def _score_tests(
    title: str, tests: Sequence[ScoreTest], *, heading: bool = True
) -> Iterator[Table]:
    numbers = (number("standard deviations"), number("share of the cost"))
    heads: Row = ("effect", "joint", *numbers, "here", "of the size")
    return table(title, heads, map(_further, tests), heading=heading)


def spectrum(test: ResidualTest) -> Figure:
    """The density of the residuals and of the sensor's noise.

    Parameters
    ----------
    test : ResidualTest

    Returns
    -------
    Figure
    """
    seen = test.frequency_hz > 0.0
    f = test.frequency_hz[seen]
    residuals, noise = (np.sqrt(d[seen]) for d in (test.density, test.noise_density))
    axis = Axis(f"{test.channel} [{unit_of(test.channel)}/sqrt(Hz)]", log=True)
    lines = (
        Line(f, residuals, "residuals", MEASURED),
        Line(f, noise, "noise of the sensor", RESIDUAL, BRIEF),
    )
    return Figure(Axis("frequency [Hz]", log=True), (Panel(axis, lines),))


def _loudness(test: ResidualTest) -> float:
    return test.deviation / test.noise if test.noise > 0.0 else 0.0


def _row(test: ResidualTest) -> Row:
    follows = "no"
    if test.input_probability < _CHANCE:
        follows = f"joint {test.input_joint}'s, r = {test.input_correlation:.2f},"
        follows += f" {1e3 * test.input_delay:.3g} ms behind"
    numbers = (f"{_loudness(test):.2g}", f"{test.worst_hz:.3g} Hz", _odds(test.whiteness))
    return (test.experiment, test.channel, *map(number, numbers), follows)


def _further(one: ScoreTest) -> Row:
    prefix = one.effect.replace("-", "_") + "_"
    sizes = [
        f"{name.removeprefix(prefix)} {' ± '.join(plus_minus(size, one.stds[name]))}"
        for name, size in one.sizes.items()
    ]
    return (
        one.effect,
        str(one.joint),
        number(f"{np.sqrt(max(one.gain, 0.0)):.2g}"),
        number(f"{100.0 * one.share:.2g} %"),
        "likely" if one.evident else "no sign of it",
        _listed(sizes),
    )


def _listed(parts: Sequence[str]) -> str:
    """The first few of them: some effects have one for each record."""
    more = len(parts) - _LISTED
    return ", ".join(parts[:_LISTED]) + (f" and {more} more" if more > 0 else "")


def _fitted(cause: Cause) -> Row:
    prefix = cause.effect.replace("-", "_") + "_"
    own = [
        f"{p.name.removeprefix(prefix)} {' ± '.join(plus_minus(p.value, p.std))} {p.unit}".rstrip()
        for p in cause.parameters
        if p.value is not None and p.std is not None
    ]
    moves = ", ".join(map(_move, cause.shifts[:_MOVES]))
    share = number(f"{100.0 * cause.share:.2g} %")
    return (cause.effect, str(cause.joint), _listed(own) or "not identified", share, moves)


def _move(move: ParameterShift) -> str:
    name = move.name if move.joint is None else f"{move.name} {move.joint}"
    if not move.without:
        return f"{name} by {move.deviations:+.2g} deviations"
    return f"{name} by {100.0 * move.shift / move.without:+.2g} %"


def _in_words(name: str) -> Paragraph:
    effect = effect_named(name)
    return paragraph(
        Span(effect.name, kind="code"),
        f" is {effect.description}; in a model without it {effect.consequence}."
        f" To be sure, {effect.experiment}.",
    )


def _odds(probability: float) -> str:
    return f"p = {probability:.2g}" if probability >= _CHANCE else f"p < {_CHANCE:g}"
