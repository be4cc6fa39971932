"""What a person reads in the terminal after a run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from rich.console import Console
from rich.table import Table
from rich.text import Text

from strainwave.formatting import percent, plus_minus
from strainwave.records import Comparison, Identification, JointModel, Parameter, Sweep

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
    """Print parameters, fits, warnings and where the files are.

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
    if identification.parameters:
        console.print(_parameters(identification.parameters, truth))
    for joint in identification.joints:
        console.print(Text(_frequencies(joint)))
    for sweep in identification.sweeps:
        console.print(Text(_trend(sweep)))
    for title, predictions in (("fitted", identification.fitted), ("check", identification.checks)):
        together: dict[str, dict[str, float]] = {}
        for prediction in predictions:
            together.setdefault(prediction.experiment, {}).update(prediction.fit_percent)
        for experiment, by_channel in together.items():
            fits = ", ".join(f"{name} {percent(fit)}" for name, fit in by_channel.items())
            console.print(f"fit ({title}) {experiment}: {fits}", markup=False)
    for warning in identification.warnings:
        text = Text(f"warning [{warning.code}] {warning.where}: {warning.message}")
        console.print(text, style="yellow")
    if identification.reason is not None:
        console.print(Text(f"not identifiable: {identification.reason}"), style="bold red")
    total = sum(identification.timing_s.values())
    for name in ("report.html", "result.json", *(["figures"] if figures else [])):
        console.print(Text(f"written: {folder / name}"), soft_wrap=True)
    console.print(f"{total:.1f} s")


def print_comparisons(
    comparisons: Sequence[Comparison], folder: Path, *, console: Console | None = None
) -> None:
    """Print each claim with its number and verdict.

    Parameters
    ----------
    comparisons : sequence of Comparison
    folder : Path
        Where comparisons.html and comparisons.json were written.
    console : rich Console, optional
        The terminal, if not standard output.
    """
    console = console or Console(highlight=False)
    for c in comparisons:
        verdict = "Holds" if c.holds else "Does not hold"
        line = Text(f"Fig. {c.figure:>2}: {c.claim} {verdict}: {c.message}")
        console.print(line, style="" if c.holds else "yellow", soft_wrap=True)
    for name in ("comparisons.html", "comparisons.json"):
        console.print(Text(f"written: {folder / name}"), soft_wrap=True)


def _frequencies(joint: JointModel) -> str:
    """One line on where a joint rings."""
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


def _parameters(parameters: tuple[Parameter, ...], truth: Truth | None) -> Table:
    table = Table(box=None, padding=(0, 1, 0, 0), header_style="bold")  # 80 columns, with truth
    table.add_column("parameter", no_wrap=True)
    table.add_column("joint")
    for head in ("value", "±"):
        table.add_column(head, justify="right")
    table.add_column("unit")
    if truth is not None:
        table.add_column("truth", justify="right")
        table.add_column("off %", justify="right")
    for p in parameters:
        value, spread = plus_minus(p.value, p.std)
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
