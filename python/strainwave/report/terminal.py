"""The summary printed in the terminal after a run."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import chain
from pathlib import Path

from rich.console import Console
from rich.table import Table
from rich.text import Text

from strainwave.domain import (
    CONDITION_TEXTS,
    Decision,
    Diagnostic,
    Identification,
    InputCheck,
    Suspicion,
)
from strainwave.domain.keys import Key
from strainwave.domain.messages.formatting import percent, plus_minus
from strainwave.report.document import blocks
from strainwave.report.document.blocks import Cell, number
from strainwave.report.document.elastic import trend_title
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
    identification: Identification,
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
    decisions = identification.decisions
    if decisions:
        console.print(_parameter_table(decisions, truth))
    for table in (_resonance_table(identification), _fit_table(identification)):
        if table.row_count:
            console.print()
            console.print(table)
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


def print_check(check: InputCheck, *, console: Console | None = None) -> None:
    """Print the relations of an input check as a table, warnings, and the suspected faults."""
    console = console or Console(highlight=False)
    numbers = map(number, ("measured", "expected", "accuracy"))
    table = printed_table("relation", "place", *numbers, "verdict")
    places: dict[tuple[str, ...], list[str]] = {}
    for relation in sorted(check.relations, key=lambda each: each.is_consistent):
        verdict = "consistent" if relation.is_consistent else "contradiction"
        sign = _BOUNDS[relation.bound]
        expected = "> 0" if relation.expected is None else f"{sign}{relation.expected:g}"
        measured = f"{relation.measured:.4g}"
        accuracy = f"{relation.accuracy:.2g}" if relation.accuracy else ""
        row = relation.text, measured, expected, accuracy, verdict
        places.setdefault(row, []).append(relation.where)
    for (text, *values), names in places.items():
        style = "" if values[-1] == "consistent" else _FAULT_STYLE
        table.add_row(*map(Text, (text, ", ".join(names), *values)), style=style)
    console.print(table)
    if check.unchecked:
        console.print(Text(f"in no relation, not checked: {', '.join(check.unchecked)}"))
    _print_warnings(check.warnings, console)
    console.print()
    style = _FAULT_STYLE if check.exit_code else _STATUS_STYLES["determined"]
    console.print(Text(f"check: {check.status} (exit code {check.exit_code})"), style=style)
    for line in _suspicion_lines(check.suspected):
        console.print(Text(line), style=style)
    console.print(f"{check.seconds:.1f} s")


def _print_warnings(warnings: Sequence[Diagnostic], console: Console) -> None:
    groups: dict[str, list[Diagnostic]] = {}
    for warning in by_severity(warnings):
        groups.setdefault(warning.code, []).append(warning)
    for code, same in groups.items():
        console.print()
        kind, style = ("note", "") if is_note(code) else ("warning", "yellow")
        console.print(Text(f"{kind} [{code}]"), style=style)
        table = Table.grid(padding=(0, 1))
        table.add_column(no_wrap=True)
        table.add_column()
        for warning in same:
            table.add_row("  observed", Text(f"{warning.where}: {warning.observation}"))
        if known := advice().get(code):  # the report has the whole messages
            table.add_row("  meaning", Text(known.meaning))
            table.add_row("  what to do", Text(known.remedy))
        console.print(table)


def _suspicion_lines(suspicions: Sequence[Suspicion]) -> Iterator[str]:
    for suspicion in suspicions:
        accepted = "accepted: " if suspicion.accepted else ""
        yield f"  {accepted}{suspicion.where}: {suspicion.message}"
        yield f"    correction: {suspicion.remedy}"


def _fit_table(identification: Identification) -> Table:
    rows: dict[tuple[str, str], dict[str, float]] = {}
    for use, predictions in (("fitted", identification.fitted), ("check", identification.checks)):
        for prediction in predictions:
            rows.setdefault((prediction.experiment, use), {}).update(prediction.fit_percent)
    if not identification.fitted and identification.whole_arm is not None:
        for name, fits in identification.whole_arm.fit_percent.items():
            rows[name, "fitted"] = dict(fits)
    channels = list(dict.fromkeys(name for fits in rows.values() for name in fits))
    table = printed_table("fit of record", "use", *map(number, channels))
    for (experiment, use), fits in rows.items():
        cells = [""] * len(channels)
        for name, fit in fits.items():
            cells[channels.index(name)] = percent(fit) if math.isfinite(fit) else "-"
        table.add_row(Text(experiment), use, *cells)
    return table


def _resonance_table(identification: Identification) -> Table:
    """Resonances of the joints; if only motors were measured, those of the fitted arm."""
    table = printed_table("resonances [Hz]", "of", number("anti-resonance"), number("resonance"))
    responses = identification.motor_responses
    by_motor = {joint.joint for joint in identification.joints if joint.method == "motor-response"}
    for joint in identification.joints:
        if not responses or joint.joint not in by_motor:
            modes = (joint.anti_resonance, joint.resonance)
            cells = (
                "none"
                if mode is None
                else " ± ".join(plus_minus(mode.frequency_hz, mode.frequency_std_hz))
                for mode in modes
            )
            table.add_row(f"joint {joint.joint}", "joint model", *cells)
    for response in responses:
        if response.joint in by_motor:
            kinds = (response.anti_resonances_hz, response.resonances_hz)
            cells = (", ".join(f"{value:.4g}" for value in values) for values in kinds)
            where = Text(f"{response.experiment}, {CONDITION_TEXTS[response.condition]}")
            table.add_row(f"motor {response.joint}", where, *cells)
    return table


def printed_table(*heads: str | Cell) -> Table:
    """An empty table for the terminal; columns whose head is a number are on the right."""
    table = Table(box=None, padding=(0, 1, 0, 0), header_style="bold")
    for head in heads:
        cell = head if isinstance(head, Cell) else Cell(head)
        table.add_column(Text(cell.text), justify="right" if cell.kind == "number" else "left")
    return table


def print_tables(console: Console, *tables: Iterable[blocks.Table]) -> None:
    """Print tables of a page with their titles, without rows that title others."""
    for each in chain(*tables):
        table = printed_table(*each.heads)
        for row in each.rows:
            if not isinstance(row, blocks.RowGroup):
                table.add_row(*(Text(cell.text) for cell in row))
        console.print()
        console.print(Text(each.label, style="bold"))
        console.print(table)


def _parameter_table(decisions: Sequence[Decision], truth: Truth | None) -> Table:
    heads: list[str | Cell] = ["parameter", "joint", number("value"), number("± std"), "unit"]
    if truth is not None:
        heads += map(number, ("true", "error %"))
    table = printed_table(*heads)
    table.columns[0].no_wrap = True
    for decision in decisions:
        p = decision.parameter
        value, std = plus_minus(p.value, p.std)
        if p.value is None:
            value, std = "rejected" if decision.rejected else "not identified", ""
        row = [p.name, str(p.joint or "arm"), value, std, p.unit]
        if truth is not None:
            true = truth.get(p.key)
            error = ""
            if true and p.value is not None:
                error = f"{100.0 * (p.value / true - 1.0):+.2f}"
            row += ["" if true is None else f"{true:.4g}", error]
        table.add_row(*map(Text, row))
    return table
