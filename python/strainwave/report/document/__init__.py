"""The report, one self-contained HTML file.

Verdict, rig, parameters, figures, residual analysis, warnings, provenance.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from strainwave.domain import (
    CONDITION_TEXTS,
    ArmDescription,
    Identification,
    JointModel,
    Prediction,
    RecordModel,
)
from strainwave.domain.arm.base_parameters import link_inertia
from strainwave.domain.arm.combinations import value_of
from strainwave.domain.arm.gear_laws import STIFFNESS
from strainwave.domain.arm.kinds import kind_of
from strainwave.domain.messages import percent
from strainwave.domain.study import changed_options
from strainwave.errors import InvalidInput, suggest_name
from strainwave.io.base_parameters import base_parameter_list
from strainwave.report.document import blocks, bode, elastic, gears, parameters
from strainwave.report.document.blocks import (
    FIGURE_KINDS,
    Block,
    FigureKind,
    FigureName,
    Fold,
    Plot,
)
from strainwave.report.document.predictions import prediction_figure, recordings
from strainwave.report.document.residuals import residual_correlations, residual_tests
from strainwave.report.document.rig import (
    arm_picture,
    describe_arm,
    gain_sentences,
    rig_constants,
)
from strainwave.report.document.verdict import (
    MODELS,
    drive_note,
    predicting_model,
    verdict,
    warnings_table,
)
from strainwave.report.figures import MAX_POINTS, Axis, Figure, Panel

__all__ = ["FIGURE_KINDS", "FigureKind", "FigureName", "figures_of", "find_figure", "render"]

_MAX_PREDICTION_POINTS = 150_000  # of all lines over time: more make a page of many megabytes
_MAX_RECORDING_POINTS = 60_000
_MIN_LINE_POINTS = 300  # of one line
_POLES_CAPTION = (
    "Crosses are poles, circles are zeros, in continuous time; ellipses are 95 % regions."
)


def render(identification: Identification) -> str:
    """The report as one HTML page that needs no network."""
    study = identification.study
    rig = study.path.resolve().parent.name or study.path.name
    springs = ", ".join(dict.fromkeys(joint.spring for joint in study.arm.joints))
    subtitle = f"{study.arm.kind.replace('-', ' ')}, gear springs: {springs}; "
    subtitle += f"stages: {', '.join(identification.stages)}"
    return blocks.document(rig, subtitle, _sections(identification))


def figures_of(identification: Identification) -> dict[str, Figure]:
    """Every figure of the report, by a name that is valid as a file name."""
    return {key: plot.figure for key, plot in blocks.keyed(_sections(identification)).items()}


def find_figure(identification: Identification, name: FigureName) -> Figure:
    """The first figure of the report that has a name; `InvalidInput` lists the others."""
    plots = blocks.keyed(_sections(identification)).values()
    for plot in plots:
        if isinstance(plot.name, FigureName) and name.includes(plot.name):
            return plot.figure
    names = [str(plot.name) for plot in plots]
    raise InvalidInput(
        f"there is no figure {str(name)!r}",
        remedy=f"choose from: {', '.join(names)}{suggest_name(str(name), names)}",
    )


def _sections(result: Identification) -> list[blocks.Section]:
    n_recorded = sum(len(log.channels) for log in result.logs)
    recording_points = _line_points(_MAX_RECORDING_POINTS, n_recorded)
    parts = (
        ("verdict", "Verdict", (verdict(result),)),
        ("rig", "Rig constants", _rig_blocks(result.study.arm)),
        ("parameters", "Parameters", _parameter_blocks(result)),
        ("base-parameters", "Base parameters", _base_parameter_blocks(result)),
        ("responses", "Frequency responses", _response_blocks(result)),
        ("poles", "Poles and zeros", _pole_blocks(result)),
        ("gears", "Gear stiffness", _gear_blocks(result)),
        ("predictions", "Predicted and measured", _prediction_blocks(result)),
        ("residuals", "Residual analysis", _residual_blocks(result)),
        ("interaction", "Interaction torques", _interaction_blocks(result)),
        ("correlations", "Parameter correlations", _correlation_blocks(result)),
        ("recordings", "Recorded data", recordings(result, recording_points)),
        ("warnings", "Warnings", warnings_table(result.warnings)),
        ("making", "Provenance", _provenance_blocks(result)),
    )
    return [blocks.Section(key, title, tuple(content)) for key, title, content in parts]


def _rig_blocks(arm: ArmDescription) -> Iterator[Block]:
    if not kind_of(arm).places_joints:
        yield Plot(FigureName("arm"), "Joints of the arm", arm_picture(arm), describe_arm(arm))
    yield from rig_constants(arm)


def _base_parameter_blocks(result: Identification) -> Iterator[Block]:
    base = base_parameter_list(result.study.arm, result.parameters)
    if base:
        yield blocks.paragraph(
            "Motion determines these combinations of masses m, first moments mx, my, mz, inertias "
            "Ixx to Izz about the origin of the joint's frame, and motor inertias; the number of a "
            "parameter is that of its joint."
        )
    yield from parameters.base_parameter_table(base)


def _parameter_blocks(result: Identification) -> Iterator[Block]:
    yield from parameters.parameter_table(result.decisions)
    for clause in gain_sentences(result):
        yield blocks.paragraph(f"{clause[0].upper()}{clause[1:]}.")
    descriptions = tuple(parameters.descriptions_table(result.decisions))
    if descriptions:
        yield Fold("Descriptions of the parameters", descriptions)


def _response_blocks(result: Identification) -> Iterator[Block]:
    for joint in result.joints:
        yield _bode_plot(result, joint)
    heads = ("joint", "records", "anti-resonance [Hz]", "damping", "resonance [Hz]", "damping")
    rows = elastic.resonance_rows(result)
    yield from blocks.table("Resonances and anti-resonances", (*heads, "stiffness [N m/rad]"), rows)
    for sweep in result.sweeps:
        label = f"Joint {sweep.joint}, stiffness over amplitude: {elastic.trend_title(sweep)}"
        figure, caption = elastic.stiffness_figure(sweep), elastic.describe_trend(sweep)
        yield Plot(FigureName("amplitude", sweep.joint), label, figure, caption)
    for joint_number, records in elastic.swept_records(result).items():
        label = f"Joint {joint_number}, response by amplitude: motor torque to motor velocity"
        figure = elastic.response_figure(records)
        caption = "Joint model of each record, within the band of its fit."
        yield Plot(FigureName("sweep", joint_number), label, figure, caption)
    plots = []
    for response in result.motor_responses:
        is_prismatic = result.study.arm.joints[response.joint - 1].motion == "prismatic"
        label = f"Motor {response.joint} in {response.experiment},"
        label += f" {CONDITION_TEXTS[response.condition]}: torque to velocity"
        name = FigureName("motor", experiment=response.experiment)
        figure = bode.motor_figure(response, is_prismatic=is_prismatic)
        plots.append(Plot(name, label, figure, bode.describe_motor(response)))
    if plots:
        yield Fold(f"Responses of the motors in the complete arm ({len(plots)})", tuple(plots))


def _bode_plot(result: Identification, joint: JointModel) -> Plot:
    description = result.study.arm.joints[joint.joint - 1]
    measured = result.responses.get(joint.joint)
    figure = bode.bode(
        joint,
        description.gear_ratio,
        measured,
        {
            record.signals.experiment.name: record.state_space
            for record in _full_amplitude(result, joint)
            if record.state_space is not None
        },
        whole_arm=_whole_arm_joint(result, joint),
        is_prismatic=description.motion == "prismatic",
    )
    label = f"Joint {joint.joint}: motor torque to motor velocity"
    return Plot(FigureName("bode", joint.joint), label, figure, bode.describe(joint, measured))


def _pole_blocks(result: Identification) -> Iterator[Block]:
    for joint in result.joints:
        ratio = result.study.arm.joints[joint.joint - 1].gear_ratio
        modes = {
            record.signals.experiment.name: record.modes
            for record in _full_amplitude(result, joint)
            if record.modes is not None
        }
        figure = bode.pole_zero_map(joint, ratio, modes, whole_arm=_whole_arm_joint(result, joint))
        label = f"Joint {joint.joint}: poles and zeros of motor torque to motor velocity"
        yield Plot(FigureName("poles", joint.joint), label, figure, _POLES_CAPTION)


def _full_amplitude(result: Identification, joint: JointModel) -> list[RecordModel]:
    return [
        record
        for record in result.records
        if record.signals.joint == joint.joint and record.signals.experiment.use == "frequency"
    ]


def _whole_arm_joint(result: Identification, joint: JointModel) -> bode.FittedJoint | None:
    """One joint's parameters in the whole-arm fit; None if the fit lacks one of them.

    A gear curve is represented by the joint model's equivalent stiffness, without a band.
    """
    whole_arm = result.whole_arm
    if whole_arm is None:
        return None
    values = whole_arm.values
    values_of_joint = {name: x for (name, number), x in values.items() if number == joint.joint}
    if STIFFNESS not in values_of_joint or result.study.arm.joints[joint.joint - 1].law.is_curved:
        values_of_joint[STIFFNESS] = joint.values[STIFFNESS]
    posture = np.array(joint.posture) if joint.posture else None
    row = link_inertia(result.study.arm, joint.joint, posture)
    if all(key in values for key in row):
        values_of_joint["link_inertia"] = value_of(row, values)
    names = list(joint.values)[:6]
    if not set(names) <= set(values_of_joint):
        return None
    rows = {p.name: k for k, p in enumerate(whole_arm.parameters) if p.joint == joint.joint}
    vector = np.array([values_of_joint[name] for name in names])
    if not set(names) <= set(rows):
        return bode.FittedJoint(vector, None)
    order = [rows[name] for name in names]
    return bode.FittedJoint(vector, whole_arm.covariance[np.ix_(order, order)])


def _prediction_blocks(result: Identification) -> Iterator[Block]:
    """Check records first, then fitted records, folded."""
    whole_arm = result.whole_arm
    fitted: list[tuple[FigureKind, Prediction]] = [
        ("tuning", p) for p in (whole_arm.simulated if whole_arm else ())
    ]
    fitted += [("fitted", p) for p in result.fitted]
    channels = sum(len(p.channels) for p in (*result.checks, *(p for _, p in fitted)))
    limit = _line_points(_MAX_PREDICTION_POINTS, 3 * channels)
    for prediction in result.checks:
        yield _prediction_plot(result, prediction, "check", limit)
    if fitted:
        plots = [_prediction_plot(result, p, kind, limit) for kind, p in fitted]
        yield Fold(f"Fitted records ({len(plots)})", tuple(plots))
    if whole_arm is None:
        return
    # fits of each record before and after the whole-arm fit
    names = list(dict.fromkeys(name for fits in whole_arm.fit_percent.values() for name in fits))
    rows: list[blocks.Row] = []
    for experiment, fits in whole_arm.fit_percent.items():
        cells = [blocks.number("")] * len(names)
        for name, after in fits.items():
            before = whole_arm.initial_fit_percent.get(experiment, {}).get(name, math.nan)
            change = f"{percent(before)} → {percent(after)}"
            text = change if math.isfinite(before + after) else _format_fit(after)
            cells[names.index(name)] = blocks.number(text)
        rows.append((experiment, *cells))
    outcome = f"{whole_arm.end}, {whole_arm.iterations} evaluations"
    title = f"Fits before → after the whole-arm fit ({outcome})"
    yield from blocks.table(title, ("record", *map(blocks.number, names)), rows)


def _line_points(total: int, lines: int) -> int:
    return min(MAX_POINTS, max(_MIN_LINE_POINTS, total // max(lines, 1)))


def _prediction_plot(
    result: Identification, prediction: Prediction, kind: FigureKind, limit: int
) -> Plot:
    use = "check record" if kind == "check" else "fitted record"
    fits = [f"{name} {_format_fit(fit)}" for name, fit in prediction.fit_percent.items()]
    _, model = MODELS[predicting_model(result, prediction)]
    return Plot(
        FigureName(kind, experiment=prediction.experiment),
        f"{prediction.experiment}, {use}: {model}",
        prediction_figure(prediction, result.study.arm.joints, limit),
        f"Fit: {', '.join(fits)}. {drive_note(result) if prediction.of_drive else ''}".rstrip(),
    )


def _format_fit(fit: float) -> str:
    return percent(fit) if math.isfinite(fit) else "no fit (standstill)"


def _interaction_blocks(result: Identification) -> Iterator[Block]:
    for record in elastic.interaction_records(result):
        where = f"Joint {record.joint}, {record.experiment.name}"
        name = FigureName("interaction", record.joint)
        yield Plot(
            replace(name, part="time"),
            f"{where}: torques over time",
            elastic.torque_figure(record),
            elastic.describe_interaction(record),
        )
        figure = elastic.torque_spectrum(record)
        yield Plot(replace(name, part="spectrum"), f"{where}: spectra", figure)
    heads = ("joint", "record", "source", "bias [rad/s²]", "error of (10) [rad/s]")
    delays = ("link sensor delay [ms]", "motor response delay [ms]")
    rows = elastic.link_rows(result)
    label = "Link motion of each record"
    links = tuple(blocks.table(label, (*heads, *delays), rows, heading=False))
    if links:
        yield Fold(f"{label} ({len(rows)} rows)", links)


def _gear_blocks(result: Identification) -> Iterator[Block]:
    for curve in gears.stiffness_curves(result):
        label = f"Gear {curve.joint}: stiffness over torque, and torques in the records"
        name = FigureName("gear", curve.joint)
        figure = gears.stiffness_figure(curve)
        yield Plot(replace(name, part="slope"), label, figure, gears.describe(curve))
        if curve.is_nonlinear:
            label = f"Gear {curve.joint}: torque over torsion"
            yield Plot(replace(name, part="torsion"), label, gears.torsion_figure(curve))
    for fit in result.torsions:
        label = f"Gear {fit.joint}: link torque over measured torsion"
        is_prismatic = result.study.arm.joints[fit.joint - 1].motion == "prismatic"
        figure = gears.measured_torsion_figure(fit, is_prismatic=is_prismatic)
        name = FigureName("gear", fit.joint, part="torsion")
        yield Plot(name, label, figure, gears.describe_measured(fit))


def _residual_blocks(result: Identification) -> Iterator[Block]:
    criticism = result.whole_arm.criticism if result.whole_arm else None
    if criticism is not None:
        yield from residual_tests(criticism)
    yield from residual_correlations(result)
    title = "State-space models on the last quarter of their record, fitted to the rest"
    tests = ("whiteness p", "independence of past inputs p", "no feedback p")
    heads = ("joint", "record", "one-step fits", *tests)
    yield from blocks.table(title, heads, elastic.validation_rows(result))


def _correlation_blocks(result: Identification) -> Iterator[Block]:
    errors = parameters.correlations(result)
    if errors is not None:
        label = "Correlations of the parameter errors"
        caption = parameters.describe_correlations(errors)
        figure = Figure(Axis(""), (Panel(Axis(""), (errors,)),))
        yield Plot(FigureName("correlations"), label, figure, caption)


def _provenance_blocks(result: Identification) -> Iterator[Block]:
    study = result.study
    timing = ", ".join(f"{name} {seconds:.2f} s" for name, seconds in result.timing_s.items())
    options = changed_options(study.options)
    facts = [
        ("study", str(study.path)),
        ("sha256", study.sha256),
        ("strainwave", result.version),
        ("created", result.created),
        ("computing time", timing),
        ("options", ", ".join(options) if options else "default"),
    ]
    model = result.rigid
    if model is not None:
        text = f"{model.n_rows} equations, zero-phase low-pass {model.bandwidth_hz:.3g} Hz,"
        text += f" decimation {model.decimation}, condition number {model.condition_number:.3g}"
        facts.append(("rigid step", text))
        for joint, (value, std) in model.torque_ratios.items():
            term = f"torque ratio of joints 1 and {joint}, by symmetry of the inertia matrix"
            text = f"{value:.4f} ± {std:.2g}; 1 if both torque constants are correct"
            facts.append((term, text))
    yield blocks.Facts(tuple(facts))
