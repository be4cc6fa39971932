"""The page of the study: tables and plots."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from benchmarks.studies.servo_moves.moves import Move
from benchmarks.studies.servo_moves.sweep import Loop
from strainwave.report.document.blocks import (
    Block,
    Plot,
    Row,
    Section,
    document,
    number,
    paragraph,
    table,
)
from strainwave.report.figures import (
    DASHES,
    FREQUENCY_AXIS,
    PALETTE,
    Axis,
    Figure,
    Line,
    Panel,
    decimate,
)

MOVE_HEADS: Row = (
    "joint",
    number("move [rad]"),
    "reference",
    *map(number, ("settling [s]", "overshoot [%]", "vibration [%]")),
)
LOOP_HEADS: Row = (
    "joint",
    "loop",
    *map(number, ("gain margin [dB]", "phase margin [degrees]", "modulus margin")),
)
_SHOWN_SECONDS, _MAX_ROWS = 0.6, 500


def render(arms: Sequence[tuple[str, Sequence[Move], str, Sequence[Loop]]]) -> str:
    """A page with the moves, the tracking error and the loops of each arm, by its name."""
    sections = [
        Section(f"arm-{k}", name, tuple(_arm(name, found, tracking, loops)))
        for k, (name, found, tracking, loops) in enumerate(arms)
    ]
    subtitle = "Identified from MuJoCo's logs, moved in MuJoCo"
    return document("Servo designs on an independent plant", subtitle, sections)


def move_rows(moves: Sequence[Move]) -> Iterator[Row]:
    """Behaviour of each move."""
    for move in moves:
        cells = map(number, move.cells())
        yield str(move.joint), number(f"{move.size:g}"), move.reference, *cells


def loop_rows(loops: Sequence[Loop]) -> Iterator[Row]:
    """Margins of each loop."""
    return ((str(loop.joint), loop.name, *map(number, loop.cells())) for loop in loops)


def _arm(name: str, moves: Sequence[Move], tracking: str, loops: Sequence[Loop]) -> Iterator[Block]:
    yield from table("Moves of single joints", MOVE_HEADS, list(move_rows(moves)))
    for joint, size in dict.fromkeys((move.joint, move.size) for move in moves):
        shown = [move for move in moves if (move.joint, move.size) == (joint, size)]
        yield Plot(f"{name} {joint} {size}", f"Joint {joint}: move of {size:g} rad", _motion(shown))
    yield paragraph(f"{tracking}.")
    yield from table("Margins", LOOP_HEADS, list(loop_rows(loops)))
    for joint in dict.fromkeys(loop.joint for loop in loops):
        shown_loops = [loop for loop in loops if loop.joint == joint]
        yield Plot(f"{name} loop {joint}", f"Joint {joint}: open loop", _loops(shown_loops))


def _motion(moves: Sequence[Move]) -> Figure:
    lines = []
    for k, move in enumerate(moves):
        until = int(np.searchsorted(move.time, _SHOWN_SECONDS))
        rows = decimate(move.share[:until, None], _MAX_ROWS)
        lines.append(
            Line(move.time[rows], move.share[rows], move.reference, PALETTE[k], DASHES[k % 3])
        )
    return Figure(Axis("time [s]"), (Panel(Axis("link angle / move"), tuple(lines)),))


def _loops(loops: Sequence[Loop]) -> Figure:
    gain, phase = [], []
    for k, loop in enumerate(loops):
        hz = loop.omega / (2.0 * np.pi)
        level = 20.0 * np.log10(np.abs(loop.response))
        degrees = np.degrees(np.unwrap(np.angle(loop.response)))
        degrees -= 360.0 * (degrees[0] > 0.0)
        gain.append(Line(hz, level, loop.name, PALETTE[k], DASHES[k]))
        phase.append(Line(hz, degrees, loop.name, PALETTE[k], DASHES[k]))
    panels = Panel(Axis("gain [dB]"), tuple(gain)), Panel(Axis("phase [degree]"), tuple(phase))
    return Figure(FREQUENCY_AXIS, panels)
