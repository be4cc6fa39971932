"""Signals -> RigidModel: the rigid-joint arm (5)-(7) by weighted least squares."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from strainwave import _equations as eq
from strainwave._least_squares import Equations, Solution, solve
from strainwave.errors import InvalidInput, NotIdentifiable
from strainwave.records import FloatArray, Parameter, RigidModel, Signals, Study, Warning

_ROUNDS = 12
_STANDING_SHARE = 0.58  # deviation of a torque uniform in [-f, f], in f


@dataclass(frozen=True, slots=True)
class RigidOptions:
    """What may be set by hand."""

    bandwidth_hz: float | None = None  # of the equations' filter; None: chosen from the data


@dataclass(frozen=True, slots=True)
class Trial:
    stretches: tuple
    value: FloatArray
    compliance: FloatArray
    solution: Solution
    equations: Equations
    fitted: tuple


def fit_at(signals: Sequence[Signals], study: Study, bandwidth_hz: float, blocks: int = 20, comp=True, kprior=0.25):
    stretches = [eq.prepare(s, bandwidth_hz) for s in signals]
    columns = eq.columns_of(study)
    n_body = len(columns) - 3 * study.n_joints
    value = None
    compliance = np.zeros(study.n_joints)
    elastic = np.array([j.spring != "rigid" for j in study.joints]) & comp
    for it in range(_ROUNDS):
        equations = assemble(stretches, study, value, compliance, elastic, blocks, kprior)
        solution = solve(equations)
        new = solution.value
        if value is not None:
            std = np.sqrt(np.diag(solution.covariance)) + 1e-300
            if np.all(np.abs(new - value) < 0.01 * std): value=new; break
        value = new
        if elastic.any():
            compliance = solution.compliance if False else np.clip(equations_last_local(equations, solution, study), 0.0, None) * elastic
    return Trial(stretches, value, compliance, solution, equations, ())
