"""The report of a servo design: one self-contained page, and its figures."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path

import numpy as np

from strainwave.domain import FloatArray
from strainwave.export.source import sentence_of
from strainwave.report.document.blocks import (
    Block,
    Callout,
    Facts,
    Plot,
    Row,
    Section,
    Span,
    document,
    number,
    paragraph,
    table,
)
from strainwave.report.figures import (
    DASHES,
    DOTTED,
    FREQUENCY_AXIS,
    PALETTE,
    SHORT_DASH,
    SOLID,
    Area,
    Axis,
    Colour,
    Dash,
    Figure,
    Line,
    Mark,
    Panel,
    Upright,
    decimate,
)
from strainwave.tune.design import JointServo, LoopResults, ServoDesign
from strainwave.tune.handover.json_document import Units
from strainwave.tune.report import words
from strainwave.tune.verification import EstimationError

_TEXTS: dict[str, str] = tomllib.loads(Path(__file__).with_name("page.toml").read_text("utf-8"))
"""Paragraphs and captions; fields in braces are numbers of the design."""

_MAX_ROWS = 500  # of a band, which has three lines
_LOWEST_SHARE = 0.05  # of the bandwidth: lower frequencies do not matter
_GAIN_RANGE = (-60.0, 80.0)  # [dB]; integrators have no upper limit
_FARTHEST = 2.0  # distance from -1 that is shown
_SHOWN_SETTLINGS = 1.5  # duration of a figure over the settling time
_LABEL_STEP = 0.15  # of a panel, between labels that may overlap
_N_SHAPERS = 3  # lines of a figure
_N_FREQUENCIES = 400
_MODE_MARGIN = 1.6  # ratio of the frequencies shown beyond the modes


def render(design: ServoDesign) -> str:
    """The design as a page that needs no network."""
    arm, required = design.arm, design.options.required
    current = tuple(map(_sentence, words.current_sentences(design)))
    meaning = _TEXTS["margins"].format(
        gain_db=required.gain_db,
        factor=10.0 ** (required.gain_db / 20.0),
        amplification=1.0 / required.modulus,
    )
    designed: tuple[Block, ...] = (
        *words.gains(design),
        *words.behaviour(design),
        paragraph(_TEXTS["law"]),
        *words.worst_margin_table(design),
    )
    sections = (
        Section("scope", "Scope of the design", tuple(_scope(design))),
        Section("current", "Current servo", current or (paragraph(_TEXTS["no-servo"]),)),
        Section("designed", "Designed servo", designed),
        Section("loops", "Open loops", tuple(_loops(design))),
        Section("steps", "Steps of the links", tuple(_steps(design))),
        Section("shapers", "Input shapers", tuple(_shapers(design))),
        Section("observers", "Observers of the links", tuple(_observers(design))),
        Section("damping", "Damping of the links", tuple(_damping(design))),
        Section("moves", "Moves", tuple(_moves(design))),
        Section("margins", "Meaning of the margins", (paragraph(meaning),)),
        Section("trial", "First trial on the rig", tuple(_trial(design))),
    )
    n = len(design.joints)
    subtitle = f"{arm.source}: {n} joint{'s' if n > 1 else ''}, {design.n_plants} plants"
    lead = _TEXTS["headline"].format(**asdict(required), plants=design.n_plants)
    limits = (words.limit_sentence(design, joint) for joint in design.joints)
    headline = Callout("good", (paragraph(Span(lead, strong=True)), *map(_sentence, limits)))
    return document("Servo design", subtitle, sections, before=(headline,))


def _sentence(text: str) -> Block:
    return paragraph(sentence_of(text))


def _scope(design: ServoDesign) -> Iterator[Block]:
    clock, options = design.clock, design.options
    yield Facts(
        (
            ("parameters", f"the estimates and {options.draws} draws of them, seed {options.seed}"),
            ("plants", f"{design.n_plants}: draws, conditions, lowest and highest gear slope"),
            ("servo period", f"{1e3 * clock.period:g} ms"),
            ("delay", f"{1e3 * clock.delay:g} ms from an encoder reading to its voltage"),
            ("limit of the drives", words.limits(design)),
        )
    )
    joints = range(1, len(design.joints) + 1)
    has_load = bool(options.payloads)
    heads: Row = (
        "condition",
        *(number(f"joint {i} [{Units.of(design.arm.joint(i)).angle}]") for i in joints),
        *((number("payload [kg]"), "centre of mass [m]") if has_load else ()),
    )
    rows: list[Row] = []
    for k, condition in enumerate(design.conditions, start=1):
        load = condition.payload
        mass, centre = (f"{load.mass:g}", load.xyz) if load else ("0", ())
        rows.append(
            (
                str(k),
                *(number(f"{angle:.3g}") for angle in condition.posture),
                *((number(mass), ", ".join(f"{x:g}" for x in centre)) if has_load else ()),
            )
        )
    yield from table("Postures and payloads", heads, rows)


def _loops(design: ServoDesign) -> Iterator[Block]:
    for joint in design.joints:
        title = f"Joint {joint.joint}: open loop"
        figure = _loops_of(joint, design.options.required.modulus)
        yield Plot(f"loop {joint.joint}", title, figure, _TEXTS["loop-caption"])


def _steps(design: ServoDesign) -> Iterator[Block]:
    caption = "Linear response to a step of the reference angle; bands cover all plants."
    for joint in design.joints:
        text = caption
        if joint.current is not None and not joint.current.position_gain:
            text += f" {_TEXTS['pulse-step']}"
        servos = list(_servos(joint))
        shown = max(_duration(each.steps.settling, each.steps.time) for *_, each in servos)
        marks: list[Mark] = []
        for name, colour, dash, results in servos:
            steps = results.steps
            marks += _over_time(steps.time, steps.link, shown, name, colour, dash)
        figure = Figure(Axis("time [s]"), (Panel(Axis("link angle / step"), tuple(marks)),))
        title = f"Joint {joint.joint}: step of the link"
        yield Plot(f"step {joint.joint}", title, figure, text)


def _shapers(design: ServoDesign) -> Iterator[Block]:
    if not design.shapers:
        yield paragraph("No elastic mode remains while the motors are held: no shaper is needed.")
        return
    modes = "; ".join(
        f"mode {k}: {low:.3g} to {high:.3g} Hz"
        for k, (low, high) in enumerate(design.modes_hz, start=1)
    )
    yield paragraph(_TEXTS["shapers"].format(modes=modes))
    yield from words.shapers(design, "Shapers, best first")
    title = "Residual vibration over the frequency"
    yield Plot("shapers", title, _shapers_of(design), _TEXTS["shaper-caption"])


def _observers(design: ServoDesign) -> Iterator[Block]:
    if not design.observers:
        yield paragraph(_TEXTS["no-observers"])
        return
    yield paragraph(_TEXTS["observers"])
    yield from words.readings(design)
    yield from map(_sentence, words.observer_gaps(design))
    if not design.estimation:
        yield paragraph(f"The observers are not compared in a move: {design.unchecked}.")
        return
    yield from words.estimation(design)
    yield paragraph(_TEXTS["estimation"])
    caption = _TEXTS["estimation-caption"]
    for one in design.estimation:
        title = f"Joint {one.joint}: error of the estimated link angle"
        yield Plot(f"observer {one.joint}", title, _estimation_of(one), caption)


def _damping(design: ServoDesign) -> Iterator[Block]:
    if not design.dampings:
        yield paragraph("There is no feedback of torsions without observers.")
        return
    yield paragraph(_TEXTS["damping"])
    yield from words.dampings(design)
    yield from map(_sentence, words.damping_sentences(design))


def _moves(design: ServoDesign) -> Iterator[Block]:
    if design.refusal:
        yield paragraph(f"No moves are compared: {design.refusal}.")
        return
    yield paragraph(_TEXTS["moves"])
    yield from words.moves(design)
    if any(joint.current and not joint.current.position_gain for joint in design.joints):
        yield paragraph(_TEXTS["pulse-move"])
    for move in design.moves:
        settling = np.array([move.step.settling, move.planned.settling])
        shown = _duration(settling, move.time)
        marks = [
            *_over_time(move.time, move.step_link, shown, "step", Colour.MEASURED, SHORT_DASH),
            *_over_time(move.time, move.planned_link, shown, "planned", Colour.MODEL, SOLID),
        ]
        figure = Figure(Axis("time [s]"), (Panel(Axis("link angle / move"), tuple(marks)),))
        yield Plot(f"move {move.joint}", f"Joint {move.joint}: step and planned move", figure)


def _trial(design: ServoDesign) -> Iterator[Block]:
    yield paragraph(_TEXTS["trial-1"])
    yield paragraph(_TEXTS["trial-2"].format(share=100.0 * design.first_share))
    heads: Row = ("joint", *words.gain_heads(design))
    firsts = [gains.slowed(design.first_share) for gains in design.gains]
    rows: list[Row] = [(str(i), *words.gain_cells(each)) for i, each in enumerate(firsts, start=1)]
    yield from table("First gains", heads, rows)
    yield paragraph(_TEXTS["trial-3"])
    yield paragraph(_TEXTS["trial-4"])


def _loops_of(joint: JointServo, required: float) -> Figure:
    """Gain, phase and distance from -1 of the open loop, with the band over all plants.

    `required` is the modulus margin.
    """
    servos = list(_servos(joint))
    lowest = min(float(results.margins.bandwidth_hz.min()) for *_, results in servos)
    gain, phase, distance = list[Mark](), list[Mark](), list[Mark]()
    for name, colour, dash, results in servos:
        band = results.band
        shown = np.flatnonzero(band.frequency_hz >= _LOWEST_SHARE * lowest)
        rows = shown[decimate(band.gain_db[shown], _MAX_ROWS)]
        near = np.minimum(band.distance, 2.0 * _FARTHEST)
        pairs = ((gain, band.gain_db), (phase, band.phase_deg), (distance, near))
        for marks, values in pairs:
            marks.extend(_band(band.frequency_hz[rows], values[rows], name, colour, dash))
    ends, level = joint.results.band.frequency_hz[shown[[0, -1]]], np.full(2, required)
    distance.append(Line(ends, level, "required distance", Colour.RESIDUAL, DOTTED))
    panels = (
        Panel(Axis("gain [dB]", range=_GAIN_RANGE), tuple(gain)),
        Panel(Axis("phase [degree]"), tuple(phase)),
        Panel(Axis("|1 + L|", range=(0.0, _FARTHEST)), tuple(distance)),
    )
    return Figure(FREQUENCY_AXIS, panels)


def _estimation_of(one: EstimationError) -> Figure:
    """Errors of the link angle in a planned move, by the motor alone and by the observer."""
    rows = np.linspace(0, len(one.time) - 1, min(len(one.time), _MAX_ROWS)).astype(int)
    servos = (("motor", Colour.MEASURED, SHORT_DASH), ("observer", Colour.MODEL, SOLID))
    marks = tuple(
        Line(one.time[rows], 1e6 * one.errors[rows, k], name, colour, dash)
        for k, (name, colour, dash) in enumerate(servos)
    )
    return Figure(Axis("time [s]"), (Panel(Axis("error [1e-6 rad or m]"), marks),))


def _shapers_of(design: ServoDesign) -> Figure:
    """Residual vibration of the best shapers over the frequency of a mode."""
    low, high = design.modes_hz.min(), design.modes_hz.max()
    hz = np.geomspace(low / _MODE_MARGIN, high * _MODE_MARGIN, _N_FREQUENCIES)
    damping = np.full(len(hz), design.shapers[0].shapers[0].damping)
    lines = [
        Line(
            hz,
            100.0 * ranked.impulses.residual_vibration(2.0 * np.pi * hz, damping),
            f"{k + 1}: {words.shaper_name(ranked)}",
            PALETTE[k],
            DASHES[k],
        )
        for k, ranked in enumerate(design.shapers[:_N_SHAPERS])
    ]
    intervals = [
        Area(np.array(ends), np.zeros(2), np.full(2, 100.0), Colour.RESIDUAL, f"mode {k}")
        for k, ends in enumerate(design.modes_hz.tolist(), start=1)
    ]
    labels = tuple(
        Upright(float(low), f"mode {k + 1}", height=1.0 - _LABEL_STEP * k)
        for k, (low, _) in enumerate(design.modes_hz)
    )
    axis = Axis("vibration [%]", range=(0.0, 100.0))
    return Figure(FREQUENCY_AXIS, (Panel(axis, (*intervals, *lines)),), labels)


def _servos(joint: JointServo) -> Iterator[tuple[str, Colour, Dash, LoopResults]]:
    if joint.current_results is not None:
        yield "current", Colour.MEASURED, SHORT_DASH, joint.current_results
    yield "designed", Colour.MODEL, SOLID, joint.results


def _band(
    x: FloatArray, values: FloatArray, name: str, colour: Colour, dash: Dash
) -> tuple[Mark, ...]:
    """The range and the middle line of values (n, 3): smallest, of the estimates, largest."""
    low, middle, high = values.T
    return Area(x, low, high, colour, name), Line(x, middle, name, colour, dash)


def _over_time(
    time: FloatArray, link: FloatArray, shown: float, name: str, colour: Colour, dash: Dash
) -> tuple[Mark, ...]:
    """Band and line of motions (n_samples, 3) until a time [s]."""
    values = link[: int(np.searchsorted(time, shown))]
    rows = decimate(values, _MAX_ROWS)
    return _band(time[rows], values[rows], name, colour, dash)


def _duration(settling: FloatArray, time: FloatArray) -> float:
    """Time [s] to show, until all plants have settled."""
    longest = float(settling.max())
    end = float(time[-1])
    return min(end, _SHOWN_SETTLINGS * longest) if math.isfinite(longest) else end
