"""Phrases and tables that the page and the terminal share, and the output in the terminal."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.text import Text

from strainwave.report.document.blocks import Cell, Row, Table, number, prose, table
from strainwave.report.terminal import print_tables
from strainwave.tune.cascade_tuning import MAX_RIPPLE_SHARE
from strainwave.tune.closed_loop import Biquad, Gains
from strainwave.tune.design import JointServo, LoopResults, ServoDesign
from strainwave.tune.handover.json_document import Units
from strainwave.tune.margins import Margins, MarginSummary, margin_summaries
from strainwave.tune.shapers import RankedShaper
from strainwave.tune.verification import MOVE, Move

N_SHOWN_SHAPERS = 5

_NEGLIGIBLE = 1e-4  # share of a step

_UNIT_WORDS = {"dB": "dB", "deg": "degrees", "1": ""}


def worst_margins(design: ServoDesign, margins: Margins) -> tuple[MarginSummary, ...]:
    """Gain, phase and modulus margin, each at its own worst plant."""
    summaries = margin_summaries(margins, design.options.required)
    return tuple(one for one in summaries if one.required is not None)


def current_sentences(design: ServoDesign) -> Iterator[str]:
    """Margins of the servo in the study; none if there is no servo."""
    if design.n_unstable:
        yield f"your servo is unstable for {design.n_unstable} of {design.n_plants} plants"
    for joint in design.joints:
        if joint.current_results is None:
            return
        margins = joint.current_results.margins
        gain, phase, modulus = worst_margins(design, margins)
        bandwidth = float(margins.bandwidth_hz.min())
        yield (
            f"your servo: joint {joint.joint} has {_at(gain)}, {_at(phase)}, "
            f"modulus {modulus.least:.2g}, bandwidth {bandwidth:.3g} Hz"
        )


def _at(margin: MarginSummary) -> str:
    if not math.isfinite(margin.least):
        return f"no limit of the {margin.name}"
    return f"{margin.least:.3g} {_UNIT_WORDS[margin.unit]} at {margin.frequency_hz:.3g} Hz"


def limit_sentence(design: ServoDesign, joint: JointServo) -> str:
    """What prevents a higher bandwidth of a joint."""
    if joint.limit == "encoder":
        counts = design.arm.study.arm.joints[joint.joint - 1].encoder_counts
        return (
            f"joint {joint.joint} is limited by its encoder of {counts:g} counts per turn: with a "
            f"higher gain, one count changes the voltage by more than {100 * MAX_RIPPLE_SHARE:g}"
            "\N{NO-BREAK SPACE}% of its limit"
        )
    worst = min(worst_margins(design, joint.results.margins), key=lambda m: m.share)
    return (
        f"joint {joint.joint} is limited by its {worst.name} margin at {worst.frequency_hz:.3g} "
        f"Hz, {plant_words(design, worst.plant)}"
    )


def plant_words(design: ServoDesign, plant: int) -> str:
    """Draw, posture and payload of a plant."""
    condition = design.conditions[design.condition[plant]]
    draw = int(design.draw[plant])
    words = [f"posture ({', '.join(f'{angle:.2g}' for angle in condition.posture)})"]
    if condition.payload is not None:
        words.append(f"payload {condition.payload.mass:g} kg")
    words.append(f"draw {draw}" if draw else "estimates")
    return ", ".join(words)


def input_unit(design: ServoDesign) -> str:
    """Unit of the drives' inputs."""
    return " or ".join(sorted({Units.of(joint).input for joint in design.arm.study.arm.joints}))


def limits(design: ServoDesign) -> str:
    """Limits of the drives with their unit: one if all are equal."""
    each = design.limits[:1] if np.ptp(design.limits) == 0.0 else design.limits
    return f"{', '.join(f'{limit:.4g}' for limit in each.tolist())} {input_unit(design)}"


def gain_heads(design: ServoDesign) -> tuple[Cell, ...]:
    """Heads of gains with units."""
    unit = input_unit(design)
    return tuple(map(number, (f"kp [{unit} s/rad]", f"ki [{unit}/rad]", "position [1/s]")))


def gain_cells(gains: Gains) -> tuple[Cell, ...]:
    """Gains under `gain_heads`."""
    return tuple(number(f"{x:.4g}") for x in (gains.kp, gains.ki, gains.position_gain))


def gains(design: ServoDesign) -> Iterator[Table]:
    """Designed and current gains of each joint."""
    rows: list[Row] = [
        (
            joint,
            servo,
            *gain_cells(each),
            prose(", ".join(map(_filter_words, each.filters)) or "none"),
        )
        for joint, servo, each, _ in _servos(design)
    ]
    return table("Gains", ("joint", "servo", *gain_heads(design), "filters"), rows)


def behaviour(design: ServoDesign) -> Iterator[Table]:
    """Bandwidth and step of each joint, designed and current."""
    rows = [
        (
            joint,
            servo,
            number(f"{results.margins.bandwidth_hz.min():.3g}"),
            number(percent(float(results.steps.overshoot.max()))),
            number(seconds(float(results.steps.settling.max()))),
        )
        for joint, servo, _, results in _servos(design)
    ]
    numbers = map(number, ("bandwidth [Hz]", "overshoot [%]", "settling [s]"))
    return table("Behaviour, worst over all plants", ("joint", "servo", *numbers), rows)


def _servos(design: ServoDesign) -> Iterator[tuple[str, str, Gains, LoopResults]]:
    for joint in design.joints:
        yield str(joint.joint), "designed", joint.gains, joint.results
        if joint.current is not None and joint.current_results is not None:
            yield str(joint.joint), "current", joint.current, joint.current_results


def _filter_words(one: Biquad) -> str:
    """Kind and frequency of a filter."""
    if one.kind == "notch":
        return f"notch {one.frequency_hz:.3g} Hz, width {one.width:.2g}, depth {one.depth:.2g}"
    return f"{one.kind} {one.frequency_hz:.3g} Hz"


def worst_margin_table(design: ServoDesign) -> Iterator[Table]:
    """Worst margins of the designed loops."""
    rows = []
    for joint in design.joints:
        for worst in worst_margins(design, joint.results.margins):
            is_finite, unit = math.isfinite(worst.least), _UNIT_WORDS[worst.unit]
            rows.append(
                (
                    str(joint.joint),
                    f"{worst.name} [{unit}]" if unit else worst.name,
                    number(f"{worst.least:.3g}" if is_finite else "no limit"),
                    number(f"{worst.required:g}"),
                    number(f"{worst.frequency_hz:.3g}" if is_finite else ""),
                    prose(plant_words(design, worst.plant) if is_finite else ""),
                )
            )
    numbers = map(number, ("worst", "required", "at [Hz]"))
    return table("Worst margins", ("joint", "margin", *numbers, "plant"), rows)


def shaper_name(ranked: RankedShaper) -> str:
    """Kinds of the shapers of one candidate."""
    return " and ".join(str(shaper.kind) for shaper in ranked.shapers)


def shapers(design: ServoDesign, title: str) -> Iterator[Table]:
    """The best shapers, the recommended one first."""
    rows = []
    for k, ranked in enumerate(design.shapers[:N_SHOWN_SHAPERS]):
        verdict = "possible" if ranked.is_sufficient else "vibrates"
        rows.append(
            (
                shaper_name(ranked),
                number(", ".join(f"{s.omega / (2.0 * math.pi):.3g}" for s in ranked.shapers)),
                number(f"{1e3 * ranked.impulses.duration:.0f}"),
                number(percent(ranked.vibration)),
                "recommended" if k == 0 and ranked.is_sufficient else verdict,
            )
        )
    numbers = map(number, ("at [Hz]", "duration [ms]", "vibration [%]"))
    return table(title, ("shaper", *numbers, "use"), rows)


def moves(design: ServoDesign) -> Iterator[Table]:
    """Behaviour of each joint after steps of the reference and in the planned move."""
    rows: list[Row] = []
    for move in design.moves:
        joint, steps = str(move.joint), {"step, current": move.current, "step, designed": move.step}
        rows += [
            (joint, name, number("0"), *_move_cells(step)) for name, step in steps.items() if step
        ]
        rows.append((joint, "planned", number(f"{move.duration:.3g}"), *_move_cells(move.planned)))
    title = f"Moves of {MOVE:g} rad (or m): a step of the reference, then planned with feed-forward"
    names = ("lasts [s]", "settling [s]", "overshoot [%]", "vibration [%]")
    return table(
        title, ("joint", "move", *map(number, (*names, f"peak [{input_unit(design)}]"))), rows
    )


def _move_cells(move: Move) -> tuple[Cell, ...]:
    return (
        number(seconds(move.settling)),
        number(percent(move.overshoot)),
        number(percent(move.vibration)),
        number(f"{move.peak_voltage:.2g}"),
    )


def readings(design: ServoDesign) -> Iterator[Table]:
    """Readings of the observers."""
    rows = [
        (str(observer.joint), one.name, number(f"{one.std:.2g}"), one.unit, one.source)
        for observer in design.observers
        for one in observer.measurements
    ]
    heads = ("joint", "reading", number("standard deviation"), "unit", "from")
    return table("Readings", heads, rows)


def observer_gaps(design: ServoDesign) -> Iterator[str]:
    """Joints without observer for their transmission, and sensors that observers do not use."""
    for joint in sorted(design.arm.study.arm.coupled_joints):
        yield f"joint {joint} has no observer: a transmission couples it with other motors"
    for observer in design.observers:
        yield from (f"joint {observer.joint} does not use its {one}" for one in observer.unused)


def estimation(design: ServoDesign) -> Iterator[Table]:
    """Root mean square errors of the estimates of each link."""
    rows = []
    for one in design.estimation:
        errors = (
            ("motor angle", one.by_motor, one.velocity_by_motor),
            ("observer, motor encoder alone", one.by_encoder, one.velocity_by_encoder),
            ("observer", one.by_observer, one.velocity_by_observer),
            ("observer, no interaction", one.without_interaction, None),
        )
        for name, angle, velocity in errors:
            rate = "" if velocity is None else f"{1e6 * velocity:.3g}"
            rows.append((str(one.joint), name, number(f"{1e6 * angle:.3g}"), number(rate)))
    title = f"Error of the link, rms [rad or m], in planned moves of {MOVE:g} rad (or m)"
    numbers = map(number, ("angle [1e-6]", "velocity [1e-6/s]"))
    return table(title, ("joint", "estimate", *numbers), rows)


def damping_sentences(design: ServoDesign) -> Iterator[str]:
    """Joints whose servo has no feedback of the torsion, and why."""
    for one in design.dampings:
        if one.reason:
            yield f"joint {one.joint} has no feedback of the torsion: {one.reason}"


def dampings(design: ServoDesign) -> Iterator[Table]:
    """Damping of each link without and with feedback of the torsion."""
    rows: list[Row] = []
    for one in design.dampings:
        plain = next(joint for joint in design.joints if joint.joint == one.joint)
        servos = [("designed", one.without, plain.results.margins)]
        if one.margins is not None:
            servos.append(("torsion feedback", one.with_feedback, one.margins))
        for name, ratios, margins in servos:
            least = (f"{margin.least:.3g}" for margin in worst_margins(design, margins))
            sizes = (*(f"{ratio:.2g}" for ratio in ratios), *least)
            rows.append((str(one.joint), name, *map(number, sizes)))
    numbers = map(number, ("least", "median", "gain [dB]", "phase [deg]", "modulus"))
    title = "Least damping of the links over all plants"
    return table(title, ("joint", "servo", *numbers), rows)


def percent(share: float) -> str:
    """A share [%] with two digits, or that it is negligible."""
    if share < _NEGLIGIBLE:
        return "0" if share == 0.0 else f"< {100.0 * _NEGLIGIBLE:g}"
    return f"{100.0 * share:.2g}"


def seconds(value: float) -> str:
    """A duration; text if it is infinite."""
    return f"{value:.3g}" if math.isfinite(value) else "does not settle"


def print_design(design: ServoDesign, page: Path, *, console: Console | None = None) -> None:
    """Print current servo, designed gains, margins, limits, shapers, observers and moves."""
    console = console or Console(highlight=False)
    for line in current_sentences(design):
        console.print(Text(line))
    before = (gains, behaviour, worst_margin_table)
    print_tables(console, *(each(design) for each in before))
    for joint in design.joints:
        console.print(Text(limit_sentence(design, joint)))
    after = (shapers(design, "Input shapers"), estimation(design))
    print_tables(console, *after, dampings(design))
    for line in (*observer_gaps(design), *damping_sentences(design)):
        console.print(Text(line))
    print_tables(console, moves(design))
    if design.refusal:
        console.print(Text(f"note: no moves are compared: {design.refusal}"), style="yellow")
    console.print(Text(f"written: {page}"), soft_wrap=True)
