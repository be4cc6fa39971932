"""Warnings about a fit of the rigid model."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from strainwave.domain import Diagnostic, FloatArray, Place
from strainwave.domain.parameter_table import family_of
from strainwave.identification.rigid.trial import MAX_ITERATIONS, RESONANCE_RATIO, Trial
from strainwave.numerics import least_squares as ls

_MAX_LAST_CHANGE = 0.5  # last change in standard deviations above which the fit has not converged
_MAX_STICTION_SHARE = 0.3  # share of a record in possible stiction that causes a warning
_MAX_CONDITION_NUMBER = 300.0  # condition number that causes a warning; good motion gives 10 to 50


def warnings_of(best: Trial, variances: FloatArray) -> Iterator[Diagnostic]:
    """Warnings on unidentified parameters, stiction, excitation, convergence and elasticity.

    `variances` (n_parameters,) include the model error.
    """
    columns = best.arm.rigid_columns
    records = Place.in_records(*(s.signals.experiment.name for s in best.stretches))
    for k, column in enumerate(columns):
        if not best.determined[k]:
            place = Place(joint=column.joint, parameter=column.name)
            yield _not_identifiable(best, k, place)
    for joint in best.weighed:
        yield Diagnostic("assumed", Place(joint=joint), "weight", joint=joint)
    for stretch in best.stretches:
        stiction_shares = (stretch.signals.direction == 0.0).mean(axis=0)
        for joint, share in enumerate(stiction_shares.tolist(), start=1):
            if share > _MAX_STICTION_SHARE:
                place = Place.in_records(stretch.signals.experiment.name)
                yield Diagnostic("standing", place, joint=joint, share=share)
    condition = best.factor.condition_number
    if condition > _MAX_CONDITION_NUMBER and best.determined.all():
        weakest_direction = np.abs(best.factor.directions[-1])
        names = tuple(str(columns[k]) for k in np.flatnonzero(weakest_direction > 0.3))
        yield Diagnostic("poor-excitation", records, condition=condition, names=names)
    for k in best.implausible(variances):
        place = Place(joint=columns[k].joint, parameter=columns[k].name)
        value = float(best.solution[k])
        yield Diagnostic("implausible", place, "rigid", value=value, unit=columns[k].unit)
    yield from _cancelling_offsets(best, variances)
    if best.last_move > _MAX_LAST_CHANGE:
        change = best.last_move
        yield Diagnostic("not-settled", records, iterations=MAX_ITERATIONS, change=change)
    limit = best.max_rigid_bandwidth
    if best.bandwidth_hz > limit:
        yield Diagnostic(
            "not-rigid",
            records,
            anti_resonance_hz=RESONANCE_RATIO * limit,
            bandwidth_hz=best.bandwidth_hz,
        )


def _cancelling_offsets(best: Trial, variances: FloatArray) -> Iterator[Diagnostic]:
    """Warn of offsets that only an equal gravity torque can balance."""
    torques = np.array([np.abs(s.signals.motor_torque).max(axis=0) for s in best.stretches])
    width = best.interval_half_width
    for k, column in enumerate(best.arm.rigid_columns):
        if column.name == "friction_offset" and column.joint is not None and best.determined[k]:
            value, largest = float(best.solution[k]), float(torques[:, column.joint - 1].max())
            if abs(value) - width * float(np.sqrt(variances[k])) > largest:
                place, unit = Place(joint=column.joint, parameter=column.name), column.unit
                yield Diagnostic(
                    "implausible", place, "offset", value=value, unit=unit, largest=largest
                )


def _not_identifiable(best: Trial, unknown: int, place: Place) -> Diagnostic:
    """Warn why one parameter is not identifiable, and what to record."""
    columns = best.arm.rigid_columns
    column = columns[unknown]
    joint = column.joint
    motion_directions = [s.signals.direction for s in best.stretches]
    if joint is not None:
        directions = np.concatenate([d[:, joint - 1] for d in motion_directions])
        if not np.any(directions):
            return Diagnostic("not-identifiable", place, "joint-at-rest", joint=joint)
        one_way = not (np.any(directions > 0.0) and np.any(directions < 0.0))
        if one_way and family_of(column.name) == "dry friction":
            return Diagnostic("not-identifiable", place, "one-way", joint=joint)
    joints_at_rest = tuple(
        i + 1
        for i in range(best.arm.n_joints)
        if not any(np.any(d[:, i]) for d in motion_directions)
    )
    if joints_at_rest:
        return Diagnostic("not-identifiable", place, "joints-at-rest", joints=joints_at_rest)
    others = tuple(
        str(columns[k]) for k in ls.companions(best.factor, unknown) if not best.determined[k]
    )
    if others:
        return Diagnostic("not-identifiable", place, "not-separable", others=others)
    return Diagnostic("not-identifiable", place, "no-information")
