"""Warnings about a fit of the rigid model."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from strainwave.domain import Diagnostic, Place
from strainwave.domain.parameter_table import family_of
from strainwave.identification.rigid.trial import MAX_ITERATIONS, RESONANCE_RATIO, Trial
from strainwave.numerics import least_squares as ls

_MAX_LAST_CHANGE = 0.5  # last change in standard deviations above which the fit has not converged
_MAX_STICTION_SHARE = 0.3  # share of a record in possible stiction that causes a warning
_MAX_CONDITION_NUMBER = 300.0  # condition number that causes a warning; good motion gives 10 to 50
_REMEDY = "record all joints moving together, in both directions, at varied speeds and postures"


def warnings_of(best: Trial) -> Iterator[Diagnostic]:
    """Warnings on unidentified parameters, stiction, excitation, convergence and elasticity."""
    columns = best.arm.rigid_columns
    records = Place.in_records(*(s.signals.experiment.name for s in best.stretches))
    for k, column in enumerate(columns):
        if not best.determined[k]:
            place = Place(joint=column.joint, parameter=column.name)
            yield Diagnostic.at("not-identifiable", place, _reason(best, k))
    for stretch in best.stretches:
        stiction_shares = (stretch.signals.direction == 0.0).mean(axis=0)
        for i, share in enumerate(stiction_shares):
            if share > _MAX_STICTION_SHARE:
                message = (
                    f"motor {i + 1} may stick in {100.0 * share:.0f} % of the record; these samples"
                )
                message += (
                    " contain no information on its friction; move faster and reverse less often"
                )
                place = Place.in_records(stretch.signals.experiment.name)
                yield Diagnostic.at("standing", place, message)
    if best.factor.condition_number > _MAX_CONDITION_NUMBER and best.determined.all():
        weakest_direction = np.abs(best.factor.directions[-1])
        names_involved = ", ".join(str(columns[k]) for k in np.flatnonzero(weakest_direction > 0.3))
        message = (
            f"condition number {best.factor.condition_number:.0f}: the records poorly separate"
        )
        yield Diagnostic.at("poor-excitation", records, f"{message} {names_involved}; {_REMEDY}")
    for k in best.implausible:
        message = f"{best.solution[k]:.3g} {columns[k].unit} is negative beyond its uncertainty:"
        message += " the data contradict a rigid arm with Coulomb and viscous friction"
        place = Place(joint=columns[k].joint, parameter=columns[k].name)
        yield Diagnostic.at("implausible", place, message)
    if best.last_move > _MAX_LAST_CHANGE:
        message = (
            f"after {MAX_ITERATIONS} iterations a parameter still changes by {best.last_move:.1f}"
        )
        message += " standard deviations; record a longer or more varied motion"
        yield Diagnostic.at("not-settled", records, message)
    limit = best.max_rigid_bandwidth
    if best.bandwidth_hz > limit:
        message = (
            f"the anti-resonance at {RESONANCE_RATIO * limit:.1f} Hz is too close to the motion"
        )
        message += f" band of {best.bandwidth_hz:.1f} Hz for a rigid model; move more slowly"
        yield Diagnostic.at("not-rigid", records, message)


def _reason(best: Trial, unknown: int) -> str:
    """Reason why one parameter is not identifiable, and what to record."""
    columns = best.arm.rigid_columns
    column = columns[unknown]
    joint = column.joint
    motion_directions = [s.signals.direction for s in best.stretches]
    if joint is not None:
        directions = np.concatenate([d[:, joint - 1] for d in motion_directions])
        if not np.any(directions):
            return f"joint {joint} does not move; record a motion in which it does"
        one_way = not (np.any(directions > 0.0) and np.any(directions < 0.0))
        if one_way and family_of(column.name) == "dry friction":
            message = (
                f"joint {joint} moves in one direction only, so that Coulomb friction and offset"
            )
            return f"{message} are not separately identifiable; record motion in both directions"
    joints_at_rest = [
        str(i + 1)
        for i in range(best.arm.n_joints)
        if not any(np.any(d[:, i]) for d in motion_directions)
    ]
    if joints_at_rest:
        return f"joint {', '.join(joints_at_rest)} does not move; {_REMEDY}"
    others = [
        str(columns[k]) for k in ls.companions(best.factor, unknown) if not best.determined[k]
    ]
    if others:
        return f"these records cannot separate it from {', '.join(others)}; {_REMEDY}"
    return f"these records contain too little information on it; {_REMEDY}"
