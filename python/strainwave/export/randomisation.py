"""Arms drawn from the joint covariance of a result, for domain randomisation and robust design.

Estimates are normal with the covariance of result.json. A draw across a physical bound of zero is
reflected, which gives the one-sided distribution that a result states for an estimate at the bound.
Draws without bodies or with knees out of order are drawn again. The links of a serial arm are the
consistent bodies, with positive definite pseudo-inertias, nearest to those of the result that have
the drawn base parameters.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from strainwave.domain import FloatArray, physical_range
from strainwave.domain.arm.base_parameters import MOTOR_INERTIA, base_parameters
from strainwave.domain.arm.combinations import rigid_columns, total_viscous_friction
from strainwave.domain.arm.consistent_links import consistent_links
from strainwave.domain.keys import Key, Values
from strainwave.errors import InvalidInput, NotIdentifiable, NumericalFailure
from strainwave.export import completion
from strainwave.export.source import IdentifiedArm
from strainwave.io.joint_covariance import JointCovariance

_SCHEMA = "strainwave/randomisation/1"
_MAX_STDS = 4.0  # of a drawn parameter from its estimate
_MIN_SHARE = 0.01  # of the estimate, the smallest value drawn for a positive parameter
_MAX_TRIES = 20  # per draw; at fewer than one arm in twenty the intervals describe no arm
_BODY_ERROR = 0.1  # of the drawn bodies, in standard deviations of the base parameters
_LEAST_ERROR = 1e-4  # relative; of base parameters without standard deviation


def drawn_values(
    arm: IdentifiedArm, covariance: JointCovariance | None, n_draws: int, rng: np.random.Generator
) -> list[Values]:
    """The estimates, then draws from their joint covariance.

    Parameters outside the covariance are drawn from their own intervals, independently. Draws are
    limited to `_MAX_STDS` standard deviations, and reflected at physical bounds.
    """
    estimates, draws = arm.values, _draws(arm, covariance, rng)
    return [estimates, *({**estimates, **next(draws)} for _ in range(n_draws))]


def _root(arm: IdentifiedArm, covariance: JointCovariance | None) -> tuple[list[Key], FloatArray]:
    """Keys of the parameters with errors, and a root F of their covariance F F^T."""
    parameters = {p.label: p for p in arm.parameters if p.value is not None}
    names = [name for name in (covariance.names if covariance else ()) if name in parameters]
    others = {n: p.std for n, p in parameters.items() if n not in names and p.std is not None}
    n, root = len(names), np.diag([0.0] * len(names) + list(others.values()))
    if covariance is not None:
        at = [covariance.names.index(name) for name in names]
        squares, vectors = np.linalg.eigh(covariance.matrix[np.ix_(at, at)])
        root[:n, :n] = vectors * np.sqrt(np.clip(squares, 0.0, None))
    return [parameters[name].key for name in (*names, *others)], root


def _draws(
    arm: IdentifiedArm, covariance: JointCovariance | None, rng: np.random.Generator
) -> Iterator[Values]:
    """Drawn values of the parameters with errors, without end."""
    keys, root = _root(arm, covariance)
    identified, description = arm.identified, arm.study.arm
    means = np.array([identified[key] for key in keys])
    is_signed = np.array([physical_range(name) == "any" for name, _ in keys], dtype=bool)
    least = np.where(is_signed, -np.inf, _MIN_SHARE * means)
    totals = [total_viscous_friction(description, i + 1) for i in range(description.n_joints)]
    while True:
        unit = np.clip(rng.standard_normal(len(keys)), -_MAX_STDS, _MAX_STDS)
        drawn = means + root @ unit
        drawn = np.maximum(np.where(is_signed, drawn, np.abs(drawn)), least)
        values = dict(zip(keys, drawn.tolist(), strict=True))
        for number, row in enumerate(totals, start=1):
            total = ("total_viscous_friction", number)
            if total in values and values.keys() >= row.keys():  # also after a reflection
                values[total] = sum(weight * values[key] for key, weight in row.items())
        yield values


def drawn_arms(arm: IdentifiedArm, n_draws: int, seed: int = 0) -> tuple[IdentifiedArm, ...]:
    """Arms drawn from the covariance of `arm`: equal for equal seeds.

    Raises `NotIdentifiable` if the result has no standard deviations, or if hardly a draw is an
    arm.
    """
    if not any(p.std for p in arm.parameters if p.value is not None):
        raise NotIdentifiable("the result has no standard deviations to draw arms from")
    has_bodies = _has_bodies(arm)
    draws = _draws(arm, arm.covariance, np.random.default_rng(seed))
    accepted = list[IdentifiedArm]()
    for _ in range(_MAX_TRIES * n_draws):
        if len(accepted) == n_draws:
            break
        drawn = _with_values(arm, next(draws))
        if drawn is None or not _has_ordered_knees(drawn):
            continue
        if _has_bodies(drawn) or not has_bodies:
            accepted.append(drawn)
    if len(accepted) < n_draws:
        raise NotIdentifiable(
            f"only {len(accepted)} of {_MAX_TRIES * n_draws} draws from the covariance are arms: "
            "the intervals are too wide to draw from; record motions that excite the inertias"
        )
    return tuple(accepted)


def _with_values(arm: IdentifiedArm, values: Values) -> IdentifiedArm | None:
    """The arm with drawn values; None if no bodies near those of the result have them."""
    standard = _drawn_standard(arm, values) if arm.standard else {}
    if standard is None:
        return None
    rigid = arm.rigid
    if rigid is not None:
        keys = [column.key for column in rigid_columns(arm.study.arm)]
        solution = [values.get(key, x) for key, x in zip(keys, rigid.solution, strict=True)]
        rigid = replace(rigid, solution=np.array(solution))
    parameters = tuple(replace(p, value=values.get(p.key, p.value)) for p in arm.parameters)
    return replace(arm, parameters=parameters, standard=standard, rigid=rigid)


def _drawn_standard(arm: IdentifiedArm, values: Values) -> Values | None:
    """Standard parameters that follow the drawn base parameters; None if the search diverges."""
    base, identified = base_parameters(arm.study.arm), arm.identified
    motors: list[Key] = [(MOTOR_INERTIA, i + 1) for i in range(arm.study.arm.n_joints)]
    before = np.array([arm.standard[key] for key in (*base.links, *motors)])
    after, n_links = before.copy(), len(base.links)
    for k, key in enumerate(motors):
        after[n_links + k] += values.get(key, 0.0) - identified.get(key, 0.0)
    std = {p.key: p.std for p in arm.parameters}
    known = [k for k, column in enumerate(base.columns) if column.key in values]
    keys = [base.columns[k].key for k in known]
    changes = np.array([values[key] - identified[key] for key in keys])
    rows = base.rows[known]
    target = rows @ before + changes - rows[:, n_links:] @ after[n_links:]
    rows, sizes = rows[:, :n_links], np.abs(target) * _LEAST_ERROR + np.finfo(float).tiny
    errors = np.maximum([_BODY_ERROR * (std[key] or 0.0) for key in keys], sizes)
    links = [tuple(link) for link in before[:n_links].reshape(-1, 10).tolist()]
    try:
        nearest = consistent_links(links, rows / errors[:, None], target / errors)
    except NumericalFailure:
        return None
    after[:n_links] = nearest
    return dict(zip((*base.links, *motors), after.tolist(), strict=True))


def _has_bodies(arm: IdentifiedArm) -> bool:
    try:
        completion.link_bodies(arm, completion.effective_gravity(arm))
    except InvalidInput:
        return False
    return True


def _has_ordered_knees(arm: IdentifiedArm) -> bool:
    """Whether every parameter of a gear law exceeds the one that bounds it."""
    values = arm.values
    return all(
        values.get((p.name, i), np.inf) > values.get((p.above, i), -np.inf)
        for i, joint in enumerate(arm.study.arm.joints, start=1)
        for p in joint.law.parameters
        if p.above is not None
    )


def to_randomisation(
    arm: IdentifiedArm, draws: Sequence[IdentifiedArm], seed: int, files: Sequence[str] = ()
) -> bytes:
    """JSON of the distribution and of the drawn arms, whose exports are in `files`.

    `factor` is the lower triangular root L of the covariance: value + L z, with standard normal z,
    is another draw. `links` are mass, centre of mass and inertias (xx, yy, zz, xy, xz, yz) about it
    of each drawn arm; null if the arm has no bodies of its own.
    """
    keys, root = _root(arm, arm.covariance)
    parameters = {p.key: p for p in arm.parameters}
    factor = np.asarray(np.linalg.qr(root.T, mode="r")).T
    factor *= np.where(np.diag(factor) < 0.0, -1.0, 1.0)
    document: dict[str, Any] = {
        "schema": _SCHEMA,
        "source": arm.source,
        "seed": seed,
        "distribution": "normal, reflected at zero where a value cannot be negative",
        "parameters": [
            {"name": p.name, "joint": p.joint, "unit": p.unit, "value": p.value, "std": p.std}
            | {"ci95": p.ci95}
            for p in map(parameters.__getitem__, keys)
        ],
        "factor": factor.tolist(),
        "draws": [[each.identified[key] for key in keys] for each in draws],
        "links": [_links(each) for each in draws],
        "files": list(files),
    }
    return (json.dumps(document, indent=1) + "\n").encode()


def _links(arm: IdentifiedArm) -> list[list[float]] | None:
    if not _has_bodies(arm):
        return None
    bodies = completion.link_bodies(arm, completion.effective_gravity(arm))
    return [[body.mass, *body.centre, *body.inertia] for body in bodies]
