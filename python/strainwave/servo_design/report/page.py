"""The report of a servo design: one self-contained page."""

from __future__ import annotations

import tomllib
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path

from strainwave.export.omissions import sentence_of
from strainwave.presentation.report.blocks import (
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
from strainwave.servo_design.design import ServoDesign
from strainwave.servo_design.handover.json_document import Units
from strainwave.servo_design.report import figures, words

_TEXTS: dict[str, str] = tomllib.loads(Path(__file__).with_name("page.toml").read_text("utf-8"))
"""Paragraphs and captions; fields in braces are numbers of the design."""


def render(design: ServoDesign) -> str:
    """The design as a page that needs no network."""
    arm = design.arm
    sections = (
        Section("scope", "Scope of the design", tuple(_scope(design))),
        Section("current", "Current servo", tuple(_current(design))),
        Section("designed", "Designed servo", tuple(_designed(design))),
        Section("loops", "Open loops", tuple(_loops(design))),
        Section("steps", "Steps of the links", tuple(_steps(design))),
        Section("shapers", "Input shapers", tuple(_shapers(design))),
        Section("observers", "Observers of the links", tuple(_observers(design))),
        Section("damping", "Damping of the links", tuple(_damping(design))),
        Section("moves", "Moves", tuple(_moves(design))),
        Section("margins", "Meaning of the margins", tuple(_meaning(design))),
        Section("trial", "First trial on the rig", tuple(_trial(design))),
    )
    n = len(design.joints)
    subtitle = f"{arm.source}: {n} joint{'s' if n > 1 else ''}, {design.n_plants} plants"
    return document("Servo design", subtitle, sections, before=(_headline(design),))


def _headline(design: ServoDesign) -> Callout:
    required = design.options.required
    lead = _TEXTS["headline"].format(**asdict(required), plants=design.n_plants)
    limits = [words.limit_sentence(design, joint) for joint in design.joints]
    return Callout(
        "good",
        (
            paragraph(Span(lead, strong=True)),
            *(paragraph(sentence_of(limit)) for limit in limits),
        ),
    )


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


def _current(design: ServoDesign) -> Iterator[Block]:
    sentences = list(words.current_sentences(design))
    if not sentences:
        yield paragraph(_TEXTS["no-servo"])
    for sentence in sentences:
        yield paragraph(sentence_of(sentence))


def _designed(design: ServoDesign) -> Iterator[Block]:
    yield from words.gains(design)
    yield from words.behaviour(design)
    yield paragraph(_TEXTS["law"])
    yield from words.worst_margin_table(design)


def _loops(design: ServoDesign) -> Iterator[Block]:
    caption = _TEXTS["loop-caption"]
    for joint in design.joints:
        title = f"Joint {joint.joint}: open loop"
        yield Plot(
            f"loop {joint.joint}",
            title,
            figures.loops_of(joint, design.options.required.modulus),
            caption,
        )


def _steps(design: ServoDesign) -> Iterator[Block]:
    caption = "Linear response to a step of the reference angle; bands cover all plants."
    for joint in design.joints:
        text = caption
        if joint.current is not None and not joint.current.position_gain:
            text += f" {_TEXTS['pulse-step']}"
        title = f"Joint {joint.joint}: step of the link"
        yield Plot(f"step {joint.joint}", title, figures.steps_of(joint), text)


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
    yield Plot(
        "shapers",
        "Residual vibration over the frequency",
        figures.shapers_of(design),
        _TEXTS["shaper-caption"],
    )


def _observers(design: ServoDesign) -> Iterator[Block]:
    if not design.observers:
        yield paragraph(_TEXTS["no-observers"])
        return
    yield paragraph(_TEXTS["observers"])
    yield from words.readings(design)
    for sentence in words.observer_gaps(design):
        yield paragraph(sentence_of(sentence))
    if not design.estimation:
        yield paragraph(f"The observers are not compared in a move: {design.unchecked}.")
        return
    yield from words.estimation(design)
    yield paragraph(_TEXTS["estimation"])
    caption = _TEXTS["estimation-caption"]
    for one in design.estimation:
        title = f"Joint {one.joint}: error of the estimated link angle"
        yield Plot(f"observer {one.joint}", title, figures.estimation_of(one), caption)


def _damping(design: ServoDesign) -> Iterator[Block]:
    if not design.dampings:
        yield paragraph("There is no feedback of torsions without observers.")
        return
    yield paragraph(_TEXTS["damping"])
    yield from words.dampings(design)
    for sentence in words.damping_sentences(design):
        yield paragraph(sentence_of(sentence))


def _moves(design: ServoDesign) -> Iterator[Block]:
    if design.refusal:
        yield paragraph(f"No moves are compared: {design.refusal}.")
        return
    yield paragraph(_TEXTS["moves"])
    yield from words.moves(design)
    if any(joint.current and not joint.current.position_gain for joint in design.joints):
        yield paragraph(_TEXTS["pulse-move"])
    for move in design.moves:
        title = f"Joint {move.joint}: step and planned move"
        yield Plot(f"move {move.joint}", title, figures.moves_of(move))


def _meaning(design: ServoDesign) -> Iterator[Block]:
    required = design.options.required
    yield paragraph(
        _TEXTS["margins"].format(
            gain_db=required.gain_db,
            factor=10.0 ** (required.gain_db / 20.0),
            amplification=1.0 / required.modulus,
        )
    )


def _trial(design: ServoDesign) -> Iterator[Block]:
    yield paragraph(_TEXTS["trial-1"])
    share = 100.0 * design.first_share
    yield paragraph(_TEXTS["trial-2"].format(share=share))
    heads: Row = ("joint", *words.gain_heads(design))
    firsts = [gains.slowed(design.first_share) for gains in design.gains]
    rows: list[Row] = [(str(i), *words.gain_cells(each)) for i, each in enumerate(firsts, start=1)]
    yield from table("First gains", heads, rows)
    yield paragraph(_TEXTS["trial-3"])
    yield paragraph(_TEXTS["trial-4"])
