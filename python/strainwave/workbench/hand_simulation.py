"""A record simulated with parameters that the user sets, compared with its measurement."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from strainwave.domain import ComplexArray, FloatArray, Log, Parameter, Study, channel_parts
from strainwave.domain.arm import unit_in
from strainwave.domain.keys import Key, Values, label_of
from strainwave.domain.kinds.base import LINK_PARAMETERS
from strainwave.domain.parameter_table import base_name, parameter_table
from strainwave.domain.parameters import complete_values
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.two_inertia import TwoInertia, resonance
from strainwave.errors import InvalidInput, NotIdentifiable, NumericalFailure
from strainwave.export.source import IdentifiedArm
from strainwave.export.state_space import joint_model
from strainwave.identification.joint_model.agreement import motor_response
from strainwave.identification.whole_arm.records.dataset import Dataset
from strainwave.identification.whole_arm.records.preparation import (
    cutoff_of,
    dataset_of,
    lengthen_steps,
)
from strainwave.presentation.figures import Axis, Colour, Figure, Line, Panel, decimate
from strainwave.presentation.report.predictions import unit_of
from strainwave.workbench.cached_files import fingerprint, log_of, study_at

_DASH = (6.0, 4.0)  # of simulated lines, behind which the measured ones stay visible
_RESIDUAL_HEIGHT = 0.45  # of a panel with residuals
_MAX_POINTS = 800  # of a line
_DECADES = 1.0  # of a Bode plot below the anti-resonance and above the resonance
_N_FREQUENCIES = 300
_DEFAULT_RESONANCE_HZ = 30.0  # where no joint has a linear model
_RANGE_DECADES = 1.0  # of a slider on either side of its start
_MIN_MOTION_TO_NOISE = 3.0  # a channel with less has no fit
_MIN_MOTION_SHARE = 0.02  # of the largest motion of a channel of its kind
_MOTOR_KINDS = ("omega_m",)
_LINK_NAMES = frozenset(f"link_{name}" for name in LINK_PARAMETERS)


@dataclass(frozen=True, slots=True)
class Slider:
    """One parameter that the user sets."""

    label: str
    name: str
    joint: int | None
    symbol: str
    description: str
    unit: str
    value: float
    low: float
    high: float
    is_log: bool
    is_of_link: bool  # a standard parameter of a link


@dataclass(frozen=True, slots=True)
class Comparison:
    """A simulated record and its measurement."""

    dataset: Dataset
    simulated: FloatArray  # (n_rows, n_channels)
    residual: FloatArray  # (n_rows, n_channels)
    fit_percent: Mapping[str, float]


def sliders(study: Study, values: Values) -> list[Slider]:
    """The parameters of the arm that a simulation needs, with the ranges of their sliders."""
    arm = Arm.of(study.arm.with_selected_laws(values))
    known = complete_values(values, arm)
    largest: dict[str, float] = {}
    for key in arm.parameter_names:
        unit = unit_in(study.arm, key)
        largest[unit] = max(largest.get(unit, 0.0), abs(known.get(key, 0.0)))
    return [_slider(study, key, known[key], largest) for key in arm.parameter_names if key in known]


def _slider(study: Study, key: Key, value: float, largest: Mapping[str, float]) -> Slider:
    table, unit = parameter_table().get(base_name(key[0])), unit_in(study.arm, key)
    is_log = value > 0.0 and (table is None or table.range != "any")
    factor = 10.0**_RANGE_DECADES
    spread = 2.0 * abs(value) or 0.1 * largest[unit] or 1.0
    return Slider(
        label_of(*key),
        key[0],
        key[1],
        table.symbol if table else "",
        table.description if table else "",
        unit,
        value,
        value / factor if is_log else value - spread,
        value * factor if is_log else value + spread,
        is_log,
        key[0] in _LINK_NAMES,
    )


def check_values(study: Study, entries: object) -> Values:
    """Values of a request; raises InvalidInput for an unknown parameter or no number."""
    values: Values = {}
    for entry in entries if isinstance(entries, list) else [None]:
        if not isinstance(entry, dict) or not isinstance(entry.get("value"), int | float):
            raise InvalidInput("the request has no values", where="values")
        key = str(entry.get("name")), entry.get("joint")
        if not isinstance(key[1], int | None):
            raise InvalidInput(f"there is no parameter {label_of(*key)}", where="values")
        values[key] = float(entry["value"])
    known = Arm.of(study.arm.with_selected_laws(values)).parameter_names
    for key in values.keys() - set(known):
        raise InvalidInput(f"there is no parameter {label_of(*key)}", where="values")
    return values


def simulate(
    path: Path, experiment: str, window: tuple[float, float], values: Values
) -> Comparison:
    """Simulate a window of a record with given parameters.

    Raises NotIdentifiable with a sentence if these values cannot be simulated, and InvalidInput if
    the record cannot be compared.
    """
    record = _prepared(path, fingerprint(path), experiment, window)
    record = replace(record, arm=record.arm.with_selected_laws(values))
    try:
        simulated, _ = record.linearise(values, record.start(), ())
    except (NumericalFailure, InvalidInput) as error:
        raise NotIdentifiable(f"these values cannot be simulated: {error}") from error
    if not np.all(np.isfinite(simulated)):
        raise NotIdentifiable("these values cannot be simulated: the motion grows without limit")
    residual = record.measured - simulated
    for k, name in enumerate(record.channel_names):
        if channel_parts(name)[0] not in _MOTOR_KINDS:  # a sensor on the link has a bias
            residual[:, k] -= residual[:, k].mean()
    motion, errors = record.measured.std(axis=0), np.sqrt(np.mean(residual**2, axis=0))
    rests = (motion < _MIN_MOTION_TO_NOISE * record.noise) | (motion < _rest_level(record, motion))
    fits = 100.0 * (1.0 - errors / np.where(rests, np.nan, motion))
    names = record.channel_names
    return Comparison(record, simulated, residual, dict(zip(names, fits.tolist(), strict=True)))


def _rest_level(record: Dataset, motion: FloatArray) -> FloatArray:
    """Standard deviation of each channel below which it only reacts to the motion of others."""
    kinds = [channel_parts(name)[0] for name in record.channel_names]
    largest = {k: max(m for m, kind in zip(motion, kinds, strict=True) if kind == k) for k in kinds}
    return np.array([_MIN_MOTION_SHARE * largest[kind] for kind in kinds])


@lru_cache(maxsize=6)
def _prepared(
    path: Path, _fingerprint: str, experiment: str, window: tuple[float, float]
) -> Dataset:
    """A window of a record, filtered and in long integrator steps."""
    study, log = study_at(path), log_of(path, experiment)
    cut = _cut(log, window)
    arm = Arm.of(study.arm)
    cutoff = cutoff_of([cut], arm, _DEFAULT_RESONANCE_HZ)
    # under gravity the error of a simulation by recorded voltages grows; a servo holds it
    closed_loop = study.arm.servo is not None and "servo" in cut.experiment.control
    return lengthen_steps(dataset_of(cut, arm, cutoff, closed_loop=closed_loop))


def _cut(log: Log, window: tuple[float, float]) -> Log:
    first, last = np.searchsorted(log.time, window)
    rows = slice(int(first), int(last))
    if first == 0 and last >= len(log):
        return log
    return replace(
        log,
        time=log.time[rows],
        channels={name: values[rows] for name, values in log.channels.items()},
        masked={name: mask[rows] for name, mask in log.masked.items()},
    )


def time_figure(study: Study, shown: Comparison, channels: list[str]) -> Figure:
    """Measured and simulated channels, and the residual of each."""
    panels: list[Panel] = []
    names = list(shown.dataset.channel_names)
    for name in [name for name in channels if name in names] or names[:2]:
        k = names.index(name)
        measured = shown.dataset.measured[:, k]
        simulated = measured - shown.residual[:, k]
        rows = decimate(np.column_stack([measured, simulated]), _MAX_POINTS)
        time, unit = shown.dataset.time[rows], unit_of(name, study.arm.joints)
        both = (
            Line(time, measured[rows], "measured", Colour.MEASURED, width=2.5),
            Line(time, simulated[rows], "simulated", Colour.MODEL, _DASH),
        )
        error = Line(time, shown.residual[rows, k], "residual", Colour.RESIDUAL, width=1.0)
        panels.append(Panel(Axis(f"{name} [{unit}]"), both))
        panels.append(Panel(Axis(f"residual [{unit}]"), (error,), _RESIDUAL_HEIGHT))
    return Figure(Axis("time [s]"), tuple(panels))


def joint_response(study: Study, values: Values, joint: int) -> tuple[FloatArray, ComplexArray]:
    """Frequencies [Hz] and response of motor velocity to motor torque of one joint alone.

    Raises InvalidInput if the joint has no linear model with these values.
    """
    model = linear_joint(study, values, joint)
    high = resonance(model).frequency_hz
    f = np.geomspace(high / 10.0 ** (2.0 * _DECADES), high * 10.0**_DECADES, _N_FREQUENCIES)
    return f, motor_response(model.vector, model.gear_ratio, f)


def linear_joint(study: Study, values: Values, joint: int) -> TwoInertia:
    """The linear model of a joint with the given parameters."""
    parameters = tuple(
        Parameter(*key, value, None, unit_in(study.arm, key), "tuned")
        for key, value in values.items()
    )
    study = replace(study, arm=study.arm.with_selected_laws(values))
    return joint_model(IdentifiedArm(study, parameters, "the sliders"), joint)


def parameter_document(values: Values) -> dict[str, Any]:
    """Values as a parameter file that the command line reads."""
    entries = [{"name": key[0], "joint": key[1], "value": value} for key, value in values.items()]
    return {"parameters": entries}
