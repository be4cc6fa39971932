"""The report's page: verdict first, then numbers, then pictures, then how it was made."""

from __future__ import annotations

import math
from collections.abc import Iterator

from strainwave.domain import CONDITIONS, ArmModel, Identification, JointModel, Prediction
from strainwave.domain.combinations import value_of
from strainwave.domain.formatting import percent
from strainwave.domain.gear_laws import STIFFNESS
from strainwave.domain.kinds import kind_of
from strainwave.domain.options import chosen_options
from strainwave.presentation.figures import MOST_POINTS, Figure
from strainwave.presentation.report import (
    amplitudes,
    bode,
    correlations,
    elastic,
    gears,
    motors,
    torques,
)
from strainwave.presentation.report.blocks import (
    Block,
    Cell,
    Facts,
    Fold,
    Plot,
    Row,
    Section,
    keyed,
    number,
    paragraph,
    prose,
    table,
)
from strainwave.presentation.report.criticism import criticised
from strainwave.presentation.report.document import document
from strainwave.presentation.report.parameters import meanings_table, parameter_table
from strainwave.presentation.report.predictions import of_prediction
from strainwave.presentation.report.remedies import warnings_table
from strainwave.presentation.report.sensor_gains import gain_sentences
from strainwave.presentation.report.verdict import verdict

_ALL_POINTS = 150_000  # in all lines over time: more would make a page of many megabytes
_FEWEST_POINTS = 300  # of one of them


def render(identification: Identification) -> str:
    """The whole report as one HTML page that needs no network.

    Parameters
    ----------
    identification : Identification

    Returns
    -------
    str
    """
    return document(_name(identification), _subtitle(identification), _sections(identification))


def figures_of(identification: Identification) -> dict[str, Figure]:
    """Every figure of the report.

    Parameters
    ----------
    identification : Identification

    Returns
    -------
    dict
        Name, fit for a file, to a figure.
    """
    return {key: plot.figure for key, plot in keyed(_sections(identification)).items()}


def _sections(found: Identification) -> list[Section]:
    parts = (
        ("verdict", "Verdict", (verdict(found),)),
        ("parameters", "Parameters", _parameters(found)),
        ("responses", "Frequency responses", _responses(found)),
        ("predictions", "Predicted and measured", _predictions(found)),
        ("interaction", "Interaction torques", _interaction(found)),
        ("gears", "Stiffness of the gears", _gears(found)),
        ("residuals", "Residuals", _residuals(found)),
        ("correlations", "Correlated parameters", _correlations(found)),
        ("warnings", "Warnings", warnings_table(found.warnings)),
        ("making", "How it was made", _making(found)),
    )
    return [Section(key, title, tuple(blocks)) for key, title, blocks in parts]


def _parameters(found: Identification) -> Iterator[Block]:
    """The table, and what link sensors that are not there would buy."""
    yield from parameter_table(found.decisions)
    for one in gain_sentences(found):
        yield paragraph(f"{one[0].upper()}{one[1:]}.")
    yield from meanings_table(found.decisions)


def _name(identification: Identification) -> str:
    path = identification.study.path
    return path.resolve().parent.name or path.name


def _subtitle(identification: Identification) -> str:
    study = identification.study
    kind = study.arm.kind.replace("-", " ")
    springs = ", ".join(joint.spring for joint in study.arm.joints)
    return f"{kind}, gear springs: {springs}; stages: {', '.join(identification.stages)}"


def _responses(found: Identification) -> Iterator[Block]:
    """Bode plots of every joint, its resonances, and its stiffness over the amplitude."""
    for joint in found.joints:
        yield _bode(found, joint)
    for seen in found.motor_responses:
        own = found.study.arm.joints[seen.joint - 1]
        label = f"Motor {seen.joint} in {seen.experiment}, {CONDITIONS[seen.condition]}:"
        label += " torque to velocity"
        drawn = motors.figure_of(seen, straight=own.motion == "prismatic")
        yield Plot(f"motor {seen.experiment}", label, drawn, motors.words_of(seen))
    heads = ("joint", "records", "anti-resonance [Hz]", "damping", "resonance [Hz]", "damping")
    rows = elastic.resonance_rows(found)
    yield from table("Resonances and anti-resonances", (*heads, "stiffness [N m/rad]"), rows)
    for place, records in amplitudes.swept(found).items():
        label = f"Joint {place} over the amplitude: motor torque to motor velocity"
        drawn = amplitudes.responses(records)
        yield Plot(f"sweep joint {place}", label, drawn, amplitudes.WORDS)
    for sweep in found.sweeps:
        label = f"Joint {sweep.joint}, stiffness over amplitude: {sweep.verdict}"
        yield Plot(f"amplitude joint {sweep.joint}", label, elastic.stiffness(sweep))


def _bode(found: Identification, joint: JointModel) -> Plot:
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
    return Plot(f"bode joint {joint.joint}", label, drawn, bode.words(joint, measured))


def _by_whole_arm(found: Identification, joint: JointModel) -> dict[str, float] | None:
    """One joint's parameters by the whole-arm fit; None without one, or where it has not all."""
    if found.tuned is None:
        return None
    values = dict(found.tuned.values)
    own = {name: value for (name, of), value in values.items() if of == joint.joint}
    if STIFFNESS not in own or found.study.arm.joints[joint.joint - 1].law.is_curved:
        own[STIFFNESS] = joint.values[STIFFNESS]  # its equivalent
    kind = kind_of(found.study.arm)
    if all(key in values for key in kind.inertias):
        own["link_inertia"] = value_of(kind.link_inertia(joint.joint), values)
    return own if set(list(joint.values)[:6]) <= set(own) else None


def _predictions(found: Identification) -> Iterator[Block]:
    """Records over time: validation data first, then those that were fitted."""
    tuned = found.tuned
    fitted = [("tuning", p) for p in (tuned.simulated if tuned else ())]
    fitted += [("fitted", p) for p in found.fitted]
    channels = sum(len(p.channels) for p in (*found.checks, *(p for _, p in fitted)))
    most = min(MOST_POINTS, max(_FEWEST_POINTS, _ALL_POINTS // (3 * max(channels, 1))))
    for prediction in found.checks:
        yield _predicted(found, prediction, ("check", "validation"), most)
    if fitted:
        plots = [_predicted(found, p, (kind, "fitted"), most) for kind, p in fitted]
        yield Fold(f"Records that were fitted ({len(plots)})", tuple(plots))
    if tuned is not None:
        yield from _fits(tuned)


def _predicted(
    found: Identification, prediction: Prediction, of: tuple[str, str], most: int
) -> Plot:
    """One record over time, with its fits in words."""
    kind, use = of
    fits = [f"{name} {_fit(fit)}" for name, fit in prediction.fit_percent.items()]
    return Plot(
        f"{kind} {prediction.experiment}",
        f"{prediction.experiment}, {use}: {_what(prediction)}",
        of_prediction(prediction, found.study.arm.joints, most),
        f"Fit: {', '.join(fits)}.",
    )


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


def _fits(tuned: ArmModel) -> Iterator[Block]:
    """Fits of the whole arm before and after tuning, one row per record."""
    channels = list(dict.fromkeys(name for fits in tuned.fit_percent.values() for name in fits))
    rows: list[Row] = []
    for experiment, fits in tuned.fit_percent.items():
        before = tuned.initial_fit_percent.get(experiment, {})
        cells = [_change(before.get(name, math.nan), fits.get(name)) for name in channels]
        rows.append((experiment, *cells))
    title = f"Fits before → after the whole-arm fit: {tuned.status}"
    title += f" after {tuned.iterations} evaluations"
    yield from table(title, ("record", *map(number, channels)), rows)


def _interaction(found: Identification) -> Iterator[Block]:
    for record in torques.interacting(found):
        where = f"Joint {record.joint}, {record.experiment.name}"
        name = f"interaction joint {record.joint}"
        words, drawn = torques.words(record), torques.over_time(record)
        yield Plot(f"{name} time", f"{where}: torques over time", drawn, words)
        drawn = torques.over_frequency(record)
        yield Plot(f"{name} spectrum", f"{where}: their spectra", drawn)
    heads = ("joint", "record", "from", "bias [rad/s²]", "error of (10) [rad/s]")
    delays = ("link sensor late by [ms]", "motor's response late by [ms]")
    rows = elastic.link_rows(found)
    yield from table("How the links' motion was found", (*heads, *delays), rows)


def _gears(found: Identification) -> Iterator[Block]:
    for curve in gears.curves(found):
        label = f"Gear {curve.joint}: slope over torque, and the torques in the records"
        name = f"gear joint {curve.joint}"
        yield Plot(f"{name} slope", label, gears.slope_figure(curve), gears.words(curve))
        if curve.bends:
            label = f"Gear {curve.joint}: torque over torsion"
            yield Plot(f"{name} torsion", label, gears.torsion_figure(curve))


def _residuals(found: Identification) -> Iterator[Block]:
    criticism = found.tuned.criticism if found.tuned else None
    if criticism is not None:
        yield from criticised(criticism)
    rows: list[Row] = [(*cells[:-1], prose(cells[-1])) for cells in elastic.judgement_rows(found)]
    title = "State-space models on the last quarter of their records, fitted to the rest"
    yield from table(title, ("joint", "record", "one step ahead", "residuals"), rows)


def _correlations(found: Identification) -> Iterator[Block]:
    known = correlations.correlations(found)
    if known is not None:
        label = "Correlations of the parameters' errors"
        drawn = correlations.heat_map(known)
        yield Plot("correlations", label, drawn, correlations.words(known))


def _making(identification: Identification) -> Iterator[Block]:
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
                f"{model.n_rows} equations, zero-phase filter {model.bandwidth_hz:.3g} Hz, one "
                f"sample in {model.decimation}, condition number {model.condition_number:.3g}",
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
    yield Facts(tuple(facts))
