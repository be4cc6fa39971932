"""What a person reads in the terminal after a run."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from rich.console import Console
from rich.table import Table
from rich.text import Text

from strainwave.domain import (
    CONDITIONS,
    Decision,
    Diagnostic,
    Identification,
    JointModel,
    Parameter,
    Sweep,
    Tally,
    Verdict,
)
from strainwave.domain.formatting import percent, plus_minus
from strainwave.presentation.report import by_weight, gain_sentences

Truth = Mapping[tuple[str, int | None], float]
"""Known values of a virtual arm, by name and joint."""


def print_summary(
    identification: Identification,
    folder: Path,
    *,
    truth: Truth | None = None,
    figures: bool = False,
    console: Console | None = None,
) -> None:
    """Print parameters, fits, warnings, the verdict and where the files are.

    Parameters
    ----------
    identification : Identification
    folder : Path
        Where result.json and report.html were written.
    truth : mapping, optional
        True values where the arm is virtual; adds their column and the error.
    figures : bool
        Whether every figure was written as a file, too.
    console : rich Console, optional
        The terminal, if not standard output.
    """
    console = console or Console(highlight=False)
    decisions = identification.decisions
    if decisions:
        console.print(_parameters(decisions, truth))
    for line in _resonances(identification):
        console.print(Text(line))
    for sweep in identification.sweeps:
        console.print(Text(_trend(sweep)))
    for line in _fits(identification):
        console.print(line, markup=False)
    for warning in by_weight(identification.warnings):
        console.print(_warning(warning), style="yellow")
    for line, style in _verdict(identification.verdict):
        console.print(Text(line), style=style)
    for sentence in gain_sentences(identification):
        console.print(Text(sentence))
    total = sum(identification.timing_s.values())
    for name in ("report.html", "result.json", *(["figures"] if figures else [])):
        console.print(Text(f"written: {folder / name}"), soft_wrap=True)
    console.print(f"{total:.1f} s")


def _verdict(verdict: Verdict) -> Iterator[tuple[str, str]]:
    """The verdict, why, and what validation says."""
    style = {"determined": "bold", "partly-determined": "bold yellow"}.get(verdict.status)
    yield f"verdict: {verdict.status} (exit code {verdict.exit_code})", style or "bold red"
    for reason in verdict.reasons:
        yield f"  {reason}", style or "bold red"
    for suspicion in verdict.suspected:
        yield f"  remedy: {suspicion.remedy}", "bold red"


def _fits(identification: Identification) -> Iterator[str]:
    """One line per record: what was fitted, then what was kept for validation."""
    together: dict[tuple[str, str], dict[str, float]] = {}
    for title, predictions in (("fitted", identification.fitted), ("check", identification.checks)):
        for prediction in predictions:
            found = together.setdefault((title, prediction.experiment), {})
            found.update(prediction.fit_percent)
    if not identification.fitted and identification.tuned is not None:
        for name, by_channel in identification.tuned.fit_percent.items():
            together["fitted", name] = dict(by_channel)
    for (title, experiment), by_channel in together.items():
        fits = ", ".join(f"{name} {percent(fit)}" for name, fit in by_channel.items())
        yield f"fit ({title}) {experiment}: {fits}"


def _warning(warning: Diagnostic) -> Text:
    """In one line what is the matter; what to do about it stands in the report."""
    first = warning.message.split("; ")[0]
    return Text(f"warning [{warning.code}] {warning.where}: {first}")


def print_comparisons(
    tallies: Sequence[Tally], folder: Path, *, console: Console | None = None
) -> None:
    """Print each claim with its verdict, what shows it, and why where it is not shown.

    Parameters
    ----------
    tallies : sequence of Tally
    folder : Path
        Where comparisons.html, comparisons.json and comparisons.md were written.
    console : rich Console, optional
        The terminal, if not standard output.
    """
    console = console or Console(highlight=False)
    for tally in tallies:
        c = tally.first
        how = "" if c.protocol == "own" else " (as published)"
        line = Text(f"Fig. {c.figure:>2}{how}: {c.claim} {tally.verdict}: {c.message}")
        shown = tally.count("shown") == len(tally.runs)
        console.print(line, style="" if shown else "yellow", soft_wrap=True)
        for reason in c.reasons:
            console.print(Text(f"         {reason}"), style="yellow", soft_wrap=True)
    for name in ("comparisons.html", "comparisons.json", "comparisons.md"):
        console.print(Text(f"written: {folder / name}"), soft_wrap=True)


def _resonances(identification: Identification) -> Iterator[str]:
    """Of the joints alone; where only motors were measured, of what these respond to."""
    seen = identification.motor_responses
    by_motor = {joint.joint for joint in identification.joints if joint.method == "motor-response"}
    for joint in identification.joints:
        if not seen or joint.joint not in by_motor:
            yield _frequencies(joint)
    for each in seen:
        if each.joint in by_motor:
            kinds = (each.anti_resonances_hz, each.resonances_hz)
            listed = [" and ".join(f"{value:.4g}" for value in values) for values in kinds]
            condition = CONDITIONS[each.condition]
            yield (
                f"motor {each.joint} in {each.experiment}, {condition}: by the fitted arm"
                f" anti-resonance {listed[0]} Hz, resonance {listed[1]} Hz"
            )


def _frequencies(joint: JointModel) -> str:
    """One line on a joint's resonances."""
    parts = []
    for name, mode in (("anti-resonance", joint.anti_resonance), ("resonance", joint.resonance)):
        if mode is not None:
            value, spread = plus_minus(mode.frequency_hz, mode.frequency_std_hz)
            parts.append(f"{name} {value} ± {spread} Hz")
    return f"joint {joint.joint}: {', '.join(parts)}"


def _trend(sweep: Sweep) -> str:
    """One line on what a sweep of amplitudes shows."""
    first, last = sweep.points[0], sweep.points[-1]
    return (
        f"joint {sweep.joint}, {first.amplitude:g} to {last.amplitude:g} V: equivalent stiffness "
        f"{first.gear_stiffness:.4g} to {last.gear_stiffness:.4g}, {sweep.verdict}"
    )


def _parameters(decisions: Sequence[Decision], truth: Truth | None) -> Table:
    table = Table(box=None, padding=(0, 1, 0, 0), header_style="bold")  # 80 columns, with truth
    table.add_column("parameter", no_wrap=True)
    table.add_column("joint")
    for head in ("value", "±"):
        table.add_column(head, justify="right")
    table.add_column("unit")
    if truth is not None:
        table.add_column("truth", justify="right")
        table.add_column("off %", justify="right")
    for decision in decisions:
        p = decision.parameter
        value, spread = plus_minus(p.value, p.std)
        if p.value is None:
            value, spread = "rejected" if decision.rejected else "not identified", ""
        row = [p.name, str(p.joint or "arm"), value, spread, p.unit]
        if truth is not None:
            row += _against_truth(p, truth.get((p.name, p.joint)))
        table.add_row(*(Text(cell) for cell in row))
    return table


def _against_truth(parameter: Parameter, true: float | None) -> list[str]:
    if true is None:
        return ["", ""]
    if parameter.value is None or true == 0.0:
        return [f"{true:.4g}", ""]
    return [f"{true:.4g}", f"{100.0 * (parameter.value / true - 1.0):+.2f}"]
