"""Base parameters of serial arms in result.json, and physically consistent links with them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from strainwave.domain import Identification
from strainwave.domain.arm import ArmDescription
from strainwave.domain.base_parameters import MOTOR_INERTIA, base_parameters
from strainwave.domain.consistent_links import consistent_links, priors_of
from strainwave.domain.keys import Key
from strainwave.domain.kinds import RigidColumn
from strainwave.errors import NumericalFailure
from strainwave.io.joint_covariance import JointCovariance

_PREFIXES = {"link_mass": "m", "link_first_moment_": "m", "link_inertia_": "I"}
_REGROUPED = "R"  # suffix of a combination, as in the literature
_MIN_RELATIVE_STD = 1e-6  # of a combination in the search for consistent links


def standard_name(key: Key) -> str:
    """Name of a standard parameter in result.json: `Izz1`, `mx2`, `m3`, `motor_inertia2`."""
    name, joint = key
    for prefix, short in _PREFIXES.items():
        if name.startswith(prefix):
            return f"{short}{name.removeprefix(prefix)}{joint}"
    return f"{name}{joint}"


def base_name_of(column: RigidColumn, leading: Key) -> str:
    """Name of a base parameter: that of its leading parameter, with R if it is a combination."""
    return standard_name(leading) + (_REGROUPED if len(column.parts) > 1 else "")


def base_parameter_entries(identification: Identification) -> list[dict[str, Any]]:
    """The entry `base_parameters`; empty unless the arm's parameters are those of its links."""
    arm = identification.study.arm
    base = base_parameters(arm)
    if not base.has_groups:
        return []
    keys: list[Key] = [*base.links, *((MOTOR_INERTIA, i + 1) for i in range(arm.n_joints))]
    final = {(p.name, p.joint): p for p in identification.parameters}
    entries = []
    for column, at in zip(base.columns, base.independent, strict=True):
        parameter = final.get(column.key)
        if parameter is None:
            continue
        entries.append(
            {
                "name": base_name_of(column, keys[at]),
                "combination": {standard_name(k): w for k, w in column.parts.items()},
                "value": parameter.value,
                "std": parameter.std,
                "ci95": parameter.ci95,
                "unit": parameter.unit,
                "stage": parameter.stage,
            }
        )
    return entries


def standard_parameter_entries(
    identification: Identification, covariance: JointCovariance | None
) -> dict[str, float] | None:
    """The entry `standard_parameters`: bodies nearest to the prior that have the base parameters.

    The bodies include the inertia of motors that rigid motion does not separate from them, which
    have no entry. None unless a base parameter has a covariance.
    """
    arm = identification.study.arm
    if covariance is None or not base_parameters(arm).has_groups:
        return None
    values = {p.label: p.value for p in identification.parameters}
    links = links_near_prior(arm, values, covariance)
    if links is None:
        return None
    motors = ((MOTOR_INERTIA, i + 1) for i in range(arm.n_joints))
    known = {standard_name(key): values.get(f"{key[0]} {key[1]}") for key in motors}
    named = {standard_name(key): value for key, value in links.items()}
    return named | {name: value for name, value in known.items() if value is not None}


def links_near_prior(
    arm: ArmDescription, values: Mapping[str, float | None], covariance: JointCovariance
) -> dict[Key, float] | None:
    """Consistent standard parameters of the links; None if no set agrees with the estimates.

    `values` are the estimates by label; `covariance` is that of some of them. Motors without
    estimate are part of the links.
    """
    base = base_parameters(arm)
    n_links, names = len(base.links), list(covariance.names)
    known = [k for k, column in enumerate(base.columns) if column.label in names]
    known = [k for k in known if base.rows[k, :n_links].any()]
    motors = [f"{MOTOR_INERTIA} {i + 1}" for i in range(arm.n_joints)]
    if not known:
        return None
    rows = base.rows[known]
    inertias = np.array([values.get(motor) or 0.0 for motor in motors])
    target = np.array([values[base.columns[k].label] for k in known], dtype=float)
    target -= rows[:, n_links:] @ inertias
    places = [names.index(base.columns[k].label) for k in known]
    matrix = covariance.matrix[np.ix_(places, places)]
    floor = _MIN_RELATIVE_STD * np.abs(target).max()
    factor = np.linalg.cholesky(matrix + floor**2 * np.eye(len(places)))
    try:
        links = consistent_links(
            priors_of(arm),
            np.asarray(np.linalg.solve(factor, rows[:, :n_links])),
            np.asarray(np.linalg.solve(factor, target)),
        )
    except NumericalFailure:
        return None
    return dict(zip(base.links, links.tolist(), strict=True))
