"""The report's page: verdict first, then numbers, then pictures, then how it was made."""

from __future__ import annotations

import math
from html import escape

from strainwave.domain import CONDITIONS, ArmModel, Identification, JointModel, Prediction
from strainwave.domain.formatting import percent
from strainwave.domain.options import chosen_options
from strainwave.domain.parameters import link_inertia
from strainwave.presentation.report import (
    amplitudes,
    bode,
    correlations,
    elastic,
    gears,
    motors,
    torques,
)
from strainwave.presentation.report.criticism import criticised
from strainwave.presentation.report.figures import MOST_POINTS, Figure
from strainwave.presentation.report.html import (
    Cell,
    Section,
    document,
    figure,
    number,
    prose,
    row,
    table,
)
from strainwave.presentation.report.parameters import meanings_table, parameter_table
from strainwave.presentation.report.predictions import of_prediction
from strainwave.presentation.report.remedies import warnings_table
from strainwave.presentation.report.sensor_gains import gain_sentences
from strainwave.presentation.report.verdict import verdict

_ALL_POINTS = 150_000  # in all lines over time: more would make a page of many megabytes
_FEWEST_POINTS = 300  # of one of them

_INERTIAS = ("alpha", "beta", "gamma")


def render(identification: Identification) -> str:
    """The whole report as one HTML page that needs no network.

    Parameters
    ----------
    identification : Identification

    Returns
    -------
    str
    """
    sections, plots = _content(identification)
    return document(f"strainwave: {_name(identification)}", _head(identification), sections, plots)


def figures_of(identification: Identification) -> dict[str, Figure]:
    """Every figure of the report.

    Parameters
    ----------
    identification : Identification

    Returns
    -------
    dict
        Name, fit for a file, to a plotly figure.
    """
    return _content(identification)[1]


def _content(identification: Identification) -> tuple[list[Section], dict[str, Figure]]:
    plots: dict[str, Figure] = {}
    found = identification
    sections = [
        Section("verdict", "Verdict", verdict(found)),
        Section(
            "parameters",
            "Parameters",
            parameter_table(found.decisions) + _gains(found) + meanings_table(found.decisions),
        ),
        Section("responses", "Frequency responses", _responses(found, plots)),
        Section("predictions", "Predicted and measured", _predictions(found, plots)),
        Section("interaction", "Interaction torques", _interaction(found, plots)),
        Section("gears", "Stiffness of the gears", _gears(found, plots)),
        Section("residuals", "Residuals", _residuals(found, plots)),
        Section("correlations", "Correlated parameters", _correlations(found, plots)),
        Section("warnings", "Warnings", warnings_table(found.warnings)),
        Section("making", "How it was made", _making(found)),
    ]
    return sections, plots


def _gains(found: Identification) -> str:
    """What link sensors that are not there would buy."""
    said = (f"{one[0].upper()}{one[1:]}." for one in gain_sentences(found))
    return "".join(f"<p>{escape(one)}</p>" for one in said)


def _name(identification: Identification) -> str:
    path = identification.study.path
    return path.resolve().parent.name or path.name


def _head(identification: Identification) -> str:
    study = identification.study
    kind = study.arm.kind.replace("-", " ")
    springs = ", ".join(joint.spring for joint in study.arm.joints)
    return (
        f"<h1>{escape(_name(identification))}</h1>"
        f'<p class="faint">{escape(kind)}, gear springs: {escape(springs)}; '
        f"stages: {escape(', '.join(identification.stages))}</p>"
    )


def _responses(found: Identification, plots: dict[str, Figure]) -> str:
    """Bode plots of every joint, where it rings, and its stiffness over the amplitude."""
    parts = []
    for joint in found.joints:
        own = found.study.arm.joints[joint.joint - 1]
        measured = found.responses.get(joint.joint)
        sampled = [
            (r.signals.experiment.name, r.state_space)
            for r in found.records
            if r.signals.joint == joint.joint
            and r.state_space is not None
            and r.signals.experiment.use == "frequency"
        ]
        drawn = bode.bode(
            joint,
            own.gear_ratio,
            measured,
            sampled,
            tuned=_by_whole_arm(found, joint),
            straight=own.motion == "prismatic",
        )
        label = f"Joint {joint.joint} alone: motor torque to motor velocity"
        name = f"bode joint {joint.joint}"
        words = bode.words(joint, measured)
        parts.append(figure(name, label, drawn, plots, words=words))
    for seen in found.motor_responses:
        own = found.study.arm.joints[seen.joint - 1]
        drawn = motors.figure_of(seen, straight=own.motion == "prismatic")
        label = f"Motor {seen.joint} in {seen.experiment}, {CONDITIONS[seen.condition]}:"
        label += " torque to velocity"
        name, words = f"motor {seen.experiment}", motors.words_of(seen)
        parts.append(figure(name, label, drawn, plots, words=words))
    heads = ("joint", "records", "anti-resonance [Hz]", "damping", "resonance [Hz]", "damping")
    rows = "".join(row(cells) for cells in elastic.resonance_rows(found))
    parts.append(table("Resonances and anti-resonances", (*heads, "stiffness [N m/rad]"), rows))
    for place, records in amplitudes.swept(found).items():
        drawn = amplitudes.responses(records)
        label = f"Joint {place} over the amplitude: motor torque to motor velocity"
        parts.append(figure(f"sweep joint {place}", label, drawn, plots, words=amplitudes.WORDS))
    for sweep in found.sweeps:
        label = f"Joint {sweep.joint}, stiffness over amplitude: {sweep.verdict}"
        name = f"amplitude joint {sweep.joint}"
        parts.append(figure(name, label, elastic.stiffness(sweep), plots))
    return "".join(parts)


def _by_whole_arm(found: Identification, joint: JointModel) -> dict[str, float] | None:
    """One joint's parameters by the whole-arm fit; None without one, or where it has not all."""
    if found.tuned is None:
        return None
    values = dict(found.tuned.values)
    own = {name: value for (name, of), value in values.items() if of == joint.joint}
    own.setdefault("gear_stiffness", joint.values["gear_stiffness"])  # of a curve: its equivalent
    if found.study.arm.n_joints == 1 or all((name, None) in values for name in _INERTIAS):
        own["link_inertia"] = link_inertia(values, found.study, joint.joint)
    return own if set(list(joint.values)[:6]) <= set(own) else None


def _predictions(found: Identification, plots: dict[str, Figure]) -> str:
    """Records over time: validation data first, then those that were fitted."""
    tuned = found.tuned
    groups = (
        ("check", "validation", found.checks),
        ("tuning", "fitted", tuned.simulated if tuned else ()),
        ("fitted", "fitted", found.fitted),
    )
    channels = sum(len(p.channels) for _, _, group in groups for p in group)
    most = min(MOST_POINTS, max(_FEWEST_POINTS, _ALL_POINTS // (3 * max(channels, 1))))
    parts = []
    for kind, seen, group in groups:
        for prediction in group:
            label = f"{prediction.experiment}, {seen}: {_what(prediction)}"
            fits = [f"{name} {_fit(fit)}" for name, fit in prediction.fit_percent.items()]
            parts.append(
                figure(
                    f"{kind} {prediction.experiment}",
                    label,
                    of_prediction(prediction, found.study.arm.joints, most),
                    plots,
                    words=f"Fit: {', '.join(fits)}.",
                )
            )
    return "".join(parts) + (_fits(tuned) if tuned else "")


def _fit(fit: float) -> str:
    """A fit, where there was something to judge it by."""
    return percent(fit) if math.isfinite(fit) else "at standstill, not judged"


def _change(before: float, after: float | None) -> Cell:
    if after is None:
        return number("")
    if not math.isfinite(before) or not math.isfinite(after):
        return number(_fit(after))
    return number(f"{percent(before)} → {percent(after)}")


def _what(prediction: Prediction) -> str:
    if prediction.channels[0].startswith(("u", "torque")):
        return "drive, from the measured motion by the rigid model"
    return "motion, simulated by the elastic model"


def _fits(tuned: ArmModel) -> str:
    """Fits of the whole arm before and after tuning, one row a record."""
    channels = list(dict.fromkeys(name for fits in tuned.fit_percent.values() for name in fits))
    rows = []
    for experiment, fits in tuned.fit_percent.items():
        before = tuned.initial_fit_percent.get(experiment, {})
        cells = [_change(before.get(name, math.nan), fits.get(name)) for name in channels]
        rows.append(row((experiment, *cells)))
    title = f"Fits before → after the whole-arm fit: {tuned.status}"
    title += f" after {tuned.iterations} evaluations"
    return table(title, ("record", *(f"#{name}" for name in channels)), "".join(rows))


def _interaction(found: Identification, plots: dict[str, Figure]) -> str:
    parts = []
    for record in torques.interacting(found):
        where = f"Joint {record.joint}, {record.experiment.name}"
        name = f"interaction joint {record.joint}"
        words, drawn = torques.words(record), torques.over_time(record)
        label = f"{where}: torques over time"
        parts.append(figure(f"{name} time", label, drawn, plots, words=words))
        drawn = torques.over_frequency(record)
        parts.append(figure(f"{name} spectrum", f"{where}: their spectra", drawn, plots))
    heads = ("joint", "record", "from", "bias [rad/s²]", "error of (10) [rad/s]")
    rows = "".join(row(cells) for cells in elastic.link_rows(found))
    delays = ("link sensor late by [ms]", "motor's response late by [ms]")
    parts.append(table("How the links' motion was found", (*heads, *delays), rows))
    return "".join(parts)


def _gears(found: Identification, plots: dict[str, Figure]) -> str:
    parts = []
    for curve in gears.curves(found):
        words = gears.words(curve)
        label = f"Gear {curve.joint}: slope over torque, and the torques in the records"
        name = f"gear joint {curve.joint}"
        parts.append(figure(f"{name} slope", label, gears.slope_figure(curve), plots, words=words))
        if len(curve.knees):
            label = f"Gear {curve.joint}: torque over torsion"
            parts.append(figure(f"{name} torsion", label, gears.torsion_figure(curve), plots))
    return "".join(parts)


def _residuals(found: Identification, plots: dict[str, Figure]) -> str:
    criticism = found.tuned.criticism if found.tuned else None
    parts = [criticised(criticism, plots)] if criticism is not None else []
    rows = "".join(row((*cells[:-1], prose(cells[-1]))) for cells in elastic.judgement_rows(found))
    title = "State-space models on the last quarter of their records, fitted to the rest"
    parts.append(table(title, ("joint", "record", "one step ahead", "residuals"), rows))
    return "".join(parts)


def _correlations(found: Identification, plots: dict[str, Figure]) -> str:
    told = correlations.correlations(found)
    if told is None:
        return ""
    words, drawn = correlations.words(told), correlations.heat_map(told)
    label = "Correlations of the parameters' errors"
    return figure("correlations", label, drawn, plots, words=words)


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
    chosen = chosen_options(study.options)
    facts.append(("options", ", ".join(chosen) if chosen else "as by default"))
    if identification.rigid is not None:
        model = identification.rigid
        facts.append(
            (
                "rigid step",
                f"{model.n_rows} equations, zero-phase filter {model.bandwidth_hz:.3g} Hz, every "
                f"{model.decimation}th sample, condition number {model.condition_number:.3g}",
            )
        )
        if model.torque_ratio is not None:
            value, std = model.torque_ratio
            facts.append(
                (
                    "torque of joint 1 over joint 2",
                    f"{value:.4f}, standard deviation {std:.2g}, of what the symmetry of the "
                    "inertia matrix allows; 1 where both torque constants are right",
                )
            )
    items = "".join(f"<dt>{escape(term)}</dt><dd>{escape(fact)}</dd>" for term, fact in facts)
    return f"<dl>{items}</dl>"
