"""The report's page: verdict first, then numbers, then pictures, then how it was made."""

from __future__ import annotations

import math
from collections.abc import Iterable
from html import escape

from strainwave.formatting import percent, plus_minus
from strainwave.records import Caution, Identification, Parameter, Prediction
from strainwave.report import elastic, figures
from strainwave.report.criticism import criticised
from strainwave.report.html import document, figure, table


def render(identification: Identification) -> str:
    """The whole report as one HTML page that needs no network.

    Parameters
    ----------
    identification : Identification

    Returns
    -------
    str
    """
    plots: dict[str, figures.Figure] = {}
    body = [
        _heading(identification),
        _verdict(identification),
        _warnings(identification.warnings),
        _parameters(identification.parameters),
        _elastic(identification, plots),
        _predictions(
            "How well the model explains what it was fitted to", identification.fitted, plots
        ),
        _tuned(identification, plots),
        _predictions("Records it never saw", identification.checks, plots),
        _making(identification),
    ]
    title = f"strainwave: {identification.study.path.parent.name or identification.study.path.name}"
    return document(title, body, plots)


def _heading(identification: Identification) -> str:
    study = identification.study
    kind = study.arm.kind.replace("-", " ")
    springs = ", ".join(joint.spring for joint in study.joints)
    return (
        f"<h1>{escape(study.path.parent.name or study.path.name)}</h1>"
        f'<p class="faint">{escape(kind)}, gear springs: {escape(springs)}; '
        f"stages: {escape(', '.join(identification.stages))}</p>"
    )


def _verdict(identification: Identification) -> str:
    lines = []
    if identification.reason is not None:
        mark = "bad"
        lines.append(
            f"<strong>Not everything could be told.</strong> {escape(identification.reason)}"
        )
    else:
        mark = "doubt" if identification.warnings else ""
        lines.append(
            "<strong>Every parameter was found, but for those that a warning names.</strong>"
        )
    worst = _worst(identification.checks)
    if worst is not None:
        lines.append(
            f"On records it never saw the model explains at least {worst[0]:.1f} % "
            f"(fit of {escape(worst[2])} in “{escape(worst[1])}”)."
        )
    elif not identification.checks:
        lines.append(
            "No record was kept for checking: nothing here says how the model does on new data."
        )
    if identification.warnings:
        lines.append(
            f"{len(identification.warnings)} warning(s) below: read them before the numbers."
        )
    text = "".join(f"<p>{line}</p>" for line in lines)
    return f'<div class="verdict {mark}" role="status">{text}</div>'


def _worst(predictions: Iterable[Prediction]) -> tuple[float, str, str] | None:
    fits = [
        (fit, prediction.experiment, channel)
        for prediction in predictions
        for channel, fit in prediction.fit_percent.items()
        if math.isfinite(fit)
    ]
    return min(fits, default=None)


def _warnings(warnings: tuple[Caution, ...]) -> str:
    if not warnings:
        return ""
    rows = "".join(
        f"<tr><td><code>{escape(w.code)}</code></td><td>{escape(w.where)}</td>"
        f'<td class="text">{escape(w.message)}</td></tr>'
        for w in warnings
    )
    return table("Warnings", ("code", "where", "what, and what to do"), rows)


def _parameters(parameters: tuple[Parameter, ...]) -> str:
    rows = []
    for p in parameters:
        value, spread = plus_minus(p.value, p.std)
        interval = f"{p.ci95[0]:.4g} … {p.ci95[1]:.4g}" if p.ci95 is not None else "not known"
        rows.append(
            f"<tr><td>{escape(p.name)}</td><td>{p.joint or 'arm'}</td>"
            f'<td class="number">{value}</td><td class="number">{spread}</td>'
            f'<td class="number">{interval}</td><td>{escape(p.unit)}</td>'
            f"<td>{escape(p.stage)}</td></tr>"
        )
    heads = ("parameter", "joint", "#value", "#± one sigma", "#95 % interval", "unit", "stage")
    return table("Parameters", heads, "".join(rows))


def _elastic(identification: Identification, plots: dict[str, figures.Figure]) -> str:
    """Elastic joints: where they ring, their responses, their stiffness over the amplitude."""
    if not identification.joints:
        return ""
    rows = "".join(
        "<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>"
        for row in elastic.resonance_rows(identification)
    )
    heads = ("joint", "records", "anti-resonance [Hz]", "damping", "resonance [Hz]", "damping")
    parts = [table("Resonances", (*heads, "equivalent stiffness [N m/rad]"), rows)]
    judged = "".join(
        "<tr>"
        + "".join(f"<td>{escape(cell)}</td>" for cell in row[:-1])
        + f'<td class="text">{escape(row[-1])}</td></tr>'
        for row in elastic.judgement_rows(identification)
    )
    if judged:
        title = "State-space models on the last quarter of their records, fitted to the rest"
        parts.append(table(title, ("joint", "record", "one step ahead", "residuals"), judged))
    for joint in identification.joints:
        ratio = identification.study.joints[joint.joint - 1].gear_ratio
        drawn = elastic.response(joint, ratio, identification.responses.get(joint.joint))
        label = (
            f"joint {joint.joint} alone, motor torque to motor velocity; dotted: band of the fit"
        )
        parts.append(figure(label, drawn, plots))
    for sweep in identification.sweeps:
        label = f"joint {sweep.joint}, stiffness over amplitude: {sweep.verdict}"
        parts.append(figure(label, elastic.stiffness(sweep), plots))
    return "".join(parts)


def _tuned(identification: Identification, plots: dict[str, figures.Figure]) -> str:
    """What tuning did: fits before and after, and the records it was tuned to."""
    tuned = identification.tuned
    if tuned is None:
        return ""
    rows = []
    for experiment, fits in tuned.fit_percent.items():
        before = tuned.initial_fit_percent.get(experiment, {})
        rows += [
            f"<tr><td>{escape(experiment)}</td><td>{escape(channel)}</td>"
            f'<td class="number">{percent(before.get(channel, math.nan))}</td>'
            f'<td class="number">{percent(fit)}</td></tr>'
            for channel, fit in fits.items()
        ]
    fits_of_records = table(
        f"The whole arm at once: {tuned.status} after {tuned.iterations} evaluations",
        ("record", "channel", "#fit before", "#fit after"),
        "".join(rows),
    )
    parts = [fits_of_records]
    if tuned.criticism is not None:
        parts.append(criticised(tuned.criticism, plots))
    parts.append(_predictions("The tuned arm under its servo", tuned.simulated, plots))
    return "".join(parts)


def _predictions(
    title: str, predictions: tuple[Prediction, ...], plots: dict[str, figures.Figure]
) -> str:
    if not predictions:
        return ""
    parts = [f"<h2>{escape(title)}</h2>"]
    for prediction in predictions:
        for column, channel in enumerate(prediction.channels):
            fit = prediction.fit_percent.get(channel, float("nan"))
            label = f"{prediction.experiment}, {channel}: fit {percent(fit)}"
            parts.append(figure(label, figures.time_fit(prediction, column), plots))
    return "".join(parts)


def _making(identification: Identification) -> str:
    study = identification.study
    timing = ", ".join(
        f"{name} {seconds:.2f} s" for name, seconds in identification.timing_s.items()
    )
    facts = [
        ("study", str(study.path)),
        ("sha256", study.sha256),
        ("strainwave", identification.version),
        ("made", identification.created),
        ("time taken", timing),
    ]
    if identification.rigid is not None:
        model = identification.rigid
        facts.append(
            (
                "rigid step",
                f"{model.n_rows} equations, zero-phase filter {model.bandwidth_hz:.3g} Hz, every "
                f"{model.decimation}th sample, condition number {model.condition_number:.3g}",
            )
        )
    items = "".join(f"<dt>{escape(term)}</dt><dd>{escape(fact)}</dd>" for term, fact in facts)
    return f"<h2>How it was made</h2><dl>{items}</dl>"
