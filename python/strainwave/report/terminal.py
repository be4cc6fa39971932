"""The summary printed in the terminal after a run."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import chain
from pathlib import Path
from typing import Literal

from rich import table as rich_table
from rich.console import Console
from rich.text import Text

from strainwave import domain
from strainwave.domain.keys import Key
from strainwave.domain.messages import percent, plus_minus
from strainwave.domain.results.payload import INERTIAS
from strainwave.report.document import blocks
from strainwave.report.document.blocks import Cell, Row, RowGroup, Table
from strainwave.report.document.elastic import mode_cells, trend_title
from strainwave.report.document.parameters import SUMMARY_HEADS, summary_row
from strainwave.report.document.rig import gain_sentences
from strainwave.report.document.verdict import (
    advice,
    by_severity,
    drive_note,
    is_note,
    scale_note,
    sentence,
)

Truth = Mapping[Key, float]
"""Known values of a virtual arm, by name and joint."""

_STATUS_STYLES = {"determined": "bold green", "partly-determined": "bold yellow"}
_FAULT_STYLE = "bold red"


def print_summary(
    identification: domain.Identification,
    folder: Path,
    *,
    truth: Truth | None = None,
    figures: bool = False,
    console: Console | None = None,
) -> None:
    """Print parameters, resonances, fits, warnings, verdict, and the files in `folder`.

    `truth` adds the true values of a virtual arm and the errors; `figures` states that figure
    files were written; `console` defaults to standard output.
    """
    console = console or Console(highlight=False)
    for parameters in _parameter_table(identification.decisions, truth):
        console.print(printed_table(parameters))
    print_tables(console, _resonance_table(identification), _fit_table(identification))
    for note in filter(None, (drive_note(identification), scale_note(identification))):
        console.print(Text(note))
    if identification.sweeps:
        console.print()
    for sweep in identification.sweeps:
        joint = identification.study.arm.joints[sweep.joint - 1]
        unit = "N/m" if joint.motion == "prismatic" else "N m/rad"
        first, last = sweep.points[0], sweep.points[-1]
        ends = [
            " ± ".join(plus_minus(p.gear_stiffness, p.gear_stiffness_std)) for p in (first, last)
        ]
        trend = f"joint {sweep.joint}, {first.amplitude:g} to {last.amplitude:g} V: stiffness"
        trend += f" {ends[0]} to {ends[1]} {unit}, {trend_title(sweep)}"
        console.print(Text(trend))
    for clause in gain_sentences(identification):
        console.print(Text(sentence(clause)))
    _print_warnings(identification.warnings, console)
    console.print()
    verdict = identification.verdict
    style = _STATUS_STYLES.get(verdict.status, _FAULT_STYLE)
    lines = [f"verdict: {verdict.status} (exit code {verdict.exit_code})"]
    if verdict.status != "inconsistent-input":
        lines += [f"  {sentence(reason)}" for reason in verdict.reasons]
    for line in (*lines, *_suspicion_lines(verdict.suspected)):
        console.print(Text(line), style=style)
    for name in ("report.html", "result.json", *(["figures"] if figures else [])):
        console.print(Text(f"written: {folder / name}"), soft_wrap=True)
    console.print(f"{sum(identification.timing_s.values()):.1f} s")


_BOUNDS = {"equal": "", "least": "> ", "most": "< "}


def print_check(check: domain.InputCheck, *, console: Console | None = None) -> None:
    """Print the relations of an input check as a table, warnings, and the suspected faults."""
    console = console or Console(highlight=False)
    numbers = map(blocks.number, ("measured", "expected", "accuracy"))
    heads: Row = (blocks.prose("relation"), "place", *numbers, "verdict")
    places: dict[tuple[str, ...], list[str]] = {}
    for relation in sorted(check.relations, key=lambda each: each.is_consistent):
        verdict = "consistent" if relation.is_consistent else "contradiction"
        sign = _BOUNDS[relation.bound]
        expected = "> 0" if relation.expected is None else f"{sign}{relation.expected:g}"
        measured = f"{relation.measured:.4g}"
        accuracy = f"{relation.accuracy:.2g}" if relation.accuracy else ""
        row = relation.text, measured, expected, accuracy, verdict
        places.setdefault(row, []).append(relation.where)
    rows: list[Row] = []
    for (text, *values, verdict), names in places.items():
        mark = Cell(verdict, mark="" if verdict == "consistent" else "bad")
        rows.append((text, ", ".join(names), *values, mark))
    for relations in blocks.table("Relations", heads, rows):
        console.print(printed_table(relations))
    if check.unchecked:
        console.print(Text(f"in no relation, not checked: {', '.join(check.unchecked)}"))
    _print_warnings(check.warnings, console)
    console.print()
    style = _FAULT_STYLE if check.exit_code else _STATUS_STYLES["determined"]
    console.print(Text(f"check: {check.status} (exit code {check.exit_code})"), style=style)
    for line in _suspicion_lines(check.suspected):
        console.print(Text(line), style=style)
    console.print(f"{check.seconds:.1f} s")


_TARGETS = {
    "ur_set_target_payload": "UR",
    "franka_set_load": "Franka",
    "kuka_load": "KUKA",
    "ros_ur_set_payload": "ROS, ur_msgs/srv/SetPayload",
    "study": "study file, in [[experiment]]",
    "urdf": "URDF",
}


def print_payload(
    estimate: domain.PayloadEstimate,
    exports: Mapping[str, str],
    path: Path,
    *,
    console: Console | None = None,
) -> None:
    """Print a load with its intervals, the warnings, and the texts for controllers."""
    console = console or Console(highlight=False)
    found = estimate.quantities
    members = [("mass", found.mass)]
    members += [(f"centre {a}", q) for a, q in zip("xyz", found.xyz, strict=True)]
    if not any(found.xyz):
        pairs = zip("xyz", found.first_moments, strict=True)
        members += [(f"first moment {a}", q) for a, q in pairs if q]
    pairs = zip(INERTIAS, found.inertia_about_centre, strict=True)
    members += [(f"inertia {a} about the centre", q) for a, q in pairs]
    if estimate.torque_scale is not None:
        members.append(("torque scale", estimate.torque_scale))
    rows: list[Row] = []
    for name, quantity in members:
        if quantity is None:
            rows.append((name, "not determined", "", "", ""))
            continue
        value, std = plus_minus(quantity.value, quantity.std)
        interval = " to ".join(f"{limit:.4g}" for limit in quantity.ci95)
        rows.append((name, value, std, interval, quantity.unit))
    heads: Row = ("load", *map(blocks.number, ("value", "±")), "95 %", "unit")
    for each in blocks.table("Load", heads, rows, heading=False):
        console.print(printed_table(each))
    frame = f"frame: link {estimate.study.arm.n_joints}, that of the last joint in the study"
    console.print(Text(frame))
    _print_warnings(estimate.warnings, console)
    for target, title in _TARGETS.items() if exports else ():
        console.print()
        console.print(Text(f"{title}:", style="bold"))
        console.print(Text(exports[target]), soft_wrap=True)
    if exports and estimate.assumed:
        console.print()
        console.print(Text(f"assumed in these texts: {', '.join(estimate.assumed)}"))
    console.print()
    console.print(Text(f"written: {path}"), soft_wrap=True)


def _print_warnings(warnings: Sequence[domain.Diagnostic], console: Console) -> None:
    groups: dict[str, list[domain.Diagnostic]] = {}
    for warning in by_severity(warnings):
        groups.setdefault(warning.code, []).append(warning)
    for code, same in groups.items():
        console.print()
        kind, style = ("note", "") if is_note(code) else ("warning", "yellow")
        console.print(Text(f"{kind} [{code}]"), style=style)
        grid = rich_table.Table.grid(padding=(0, 1))
        grid.add_column(no_wrap=True)
        grid.add_column()
        for warning in same:
            grid.add_row("  observed", Text(f"{warning.where}: {warning.observation}"))
        if known := advice().get(code):  # the report has the whole messages
            grid.add_row("  meaning", Text(known.meaning))
            grid.add_row("  what to do", Text(known.remedy))
        console.print(grid)


def _suspicion_lines(suspicions: Sequence[domain.Suspicion]) -> Iterator[str]:
    for suspicion in suspicions:
        accepted = "accepted: " if suspicion.accepted else ""
        yield f"  {accepted}{suspicion.where}: {suspicion.message}"
        yield f"    correction: {suspicion.remedy}"


def _fit_table(identification: domain.Identification) -> Iterator[Table]:
    fits: dict[tuple[str, str], dict[str, float]] = {}
    for use, predictions in (("fitted", identification.fitted), ("check", identification.checks)):
        for prediction in predictions:
            fits.setdefault((prediction.experiment, use), {}).update(prediction.fit_percent)
    if not identification.fitted and identification.whole_arm is not None:
        for name, of_record in identification.whole_arm.fit_percent.items():
            fits[name, "fitted"] = dict(of_record)
    channels = list(dict.fromkeys(name for of_record in fits.values() for name in of_record))
    rows: list[Row] = []
    for key, of_record in fits.items():
        cells = dict.fromkeys(channels, "")
        cells |= {name: percent(x) if math.isfinite(x) else "-" for name, x in of_record.items()}
        rows.append((*key, *cells.values()))
    heads: Row = ("fit of record", "use", *map(blocks.number, channels))
    return blocks.table("Fits of the records", heads, rows, heading=False)


def _resonance_table(identification: domain.Identification) -> Iterator[Table]:
    """Resonances of the joints; if only motors were measured, those of the fitted arm."""
    rows: list[Row] = []
    responses = identification.motor_responses
    by_motor = {joint.joint for joint in identification.joints if joint.method == "motor-response"}
    for joint in identification.joints:
        if not responses or joint.joint not in by_motor:
            modes = (joint.anti_resonance, joint.resonance)
            frequencies = (mode_cells(mode)[0] for mode in modes)
            rows.append((f"joint {joint.joint}", "joint model", *frequencies))
    for response in responses:
        if response.joint in by_motor:
            kinds = (response.anti_resonances_hz, response.resonances_hz)
            cells = (", ".join(f"{value:.4g}" for value in values) for values in kinds)
            where = f"{response.experiment}, {domain.CONDITION_TEXTS[response.condition]}"
            rows.append((f"motor {response.joint}", where, *cells))
    heads: Row = (
        "resonances [Hz]",
        "of",
        blocks.number("anti-resonance"),
        blocks.number("resonance"),
    )
    return blocks.table("Resonances", heads, rows, heading=False)


def _parameter_table(decisions: Sequence[domain.Decision], truth: Truth | None) -> Iterator[Table]:
    rows: list[Row] = []
    for decision in decisions:
        p = decision.parameter
        row = summary_row(p, is_rejected=decision.rejected is not None)
        if truth is not None:
            true = truth.get(p.key)
            error = ""
            if true and p.value is not None:
                error = f"{100.0 * (p.value / true - 1.0):+.2f}"
            row = (*row, "" if true is None else f"{true:.4g}", error)
        rows.append(row)
    heads = SUMMARY_HEADS
    if truth is not None:
        heads = (*heads, *map(blocks.number, ("true", "error %")))
    return blocks.table("Parameters", heads, rows, heading=False)


def printed_table(cells: Table) -> rich_table.Table:
    """A table of a page for the terminal, without its label and rows that title others.

    Numbers are on the right, the heads of rows wrap only if they are prose, and a row with a bad
    cell has the colour of faults.
    """
    printed = rich_table.Table(box=None, padding=(0, 1, 0, 0), header_style="bold")
    for k, head in enumerate(cells.heads):
        side: Literal["left", "right"] = "right" if head.kind == "number" else "left"
        printed.add_column(Text(head.text), justify=side, no_wrap=k == 0 and head.kind != "text")
    for row in cells.rows:
        if not isinstance(row, RowGroup):
            is_bad = any(cell.mark == "bad" for cell in row)
            printed.add_row(*(Text(cell.text) for cell in row), style=_FAULT_STYLE * is_bad)
    return printed


def print_tables(console: Console, *tables: Iterable[Table]) -> None:
    """Print tables, each after an empty line and under its label if that is visible."""
    for each in chain(*tables):
        console.print()
        if each.heading:
            console.print(Text(each.label, style="bold"))
        console.print(printed_table(each))
