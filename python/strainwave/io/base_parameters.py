"""Base parameters of serial arms in result.json, and physically consistent links with them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from strainwave.domain import FloatArray, Identification, Parameter, RigidModel
from strainwave.domain.arm.base_parameters import (
    MOTOR_INERTIA,
    base_parameters,
    core_arm,
    transmission,
)
from strainwave.domain.arm.consistent_links import consistent_links, priors_of
from strainwave.domain.arm.description import ArmDescription
from strainwave.domain.arm.kinds.base import LINK_PARAMETERS
from strainwave.domain.keys import Key, Values
from strainwave.domain.results.stage_results import ASSUMED_TORQUE_ERROR
from strainwave.errors import NumericalFailure

_PREFIXES = {"link_mass": "m", "link_first_moment_": "m", "link_inertia_": "I"}
_REGROUPED = "R"  # suffix of a combination, as in the literature
# Of the errors of the torques, in the choice of links: bodies that have the torques fit the records
# as well as the base parameters. With a smaller weight the search takes longer.
_EXACT = 0.01
_MAX_ERROR = 10.0 * _EXACT  # of bodies that have the torques
# Of other torques over their errors, until the search for links converges. At 10 the torques are as
# near as at 100; at 1, up to twice as far (seven measured joints whose estimates no bodies have).
_WEIGHTS = (10.0, 1.0, 0.1, 0.01)


def standard_name(key: Key) -> str:
    """Name of a standard parameter in result.json: `Izz1`, `mx2`, `m3`, `motor_inertia2`."""
    name, joint = key
    for prefix, short in _PREFIXES.items():
        if name.startswith(prefix):
            return f"{short}{name.removeprefix(prefix)}{joint}"
    return f"{name}{joint}"


def standard_key(name: str) -> Key | None:
    """The standard parameter that has a name in result.json; None if there is none."""
    short = name.rstrip("0123456789")
    if short not in _LONG_NAMES or short == name:
        return None
    return _LONG_NAMES[short], int(name.removeprefix(short))


_LONG_NAMES = {
    standard_name((long, 1)).removesuffix("1"): long
    for long in (*(f"link_{name}" for name in LINK_PARAMETERS), MOTOR_INERTIA)
}


@dataclass(frozen=True, slots=True)
class BaseParameter:
    """A base parameter under its name in the literature."""

    name: str  # of its leading parameter, with R if it is a combination
    combination: Mapping[str, float]  # weights of standard parameters by `standard_name`
    estimate: Parameter


def base_parameter_list(
    arm: ArmDescription, parameters: Iterable[Parameter]
) -> list[BaseParameter]:
    """Base parameters among estimates; none unless the arm's parameters are those of links."""
    base = base_parameters(arm)
    if not base.has_groups:
        return []
    keys: list[Key] = [*base.links, *((MOTOR_INERTIA, i + 1) for i in range(arm.n_joints))]
    final = {p.key: p for p in parameters}
    return [
        BaseParameter(
            standard_name(keys[at]) + (_REGROUPED if len(column.parts) > 1 else ""),
            {standard_name(key): weight for key, weight in column.parts.items()},
            final[column.key],
        )
        for column, at in zip(base.columns, base.independent, strict=True)
        if column.key in final
    ]


def standard_parameter_entries(identification: Identification) -> dict[str, float] | None:
    """The entry `standard_parameters`: the bodies of `standard_of_torques`.

    The model has the base parameters of the final table, and those of the rigid step that are not
    identified. None for arms whose parameters are base parameters, and without motion.
    """
    arm, model = identification.study.arm, identification.rigid
    columns = base_parameters(arm).columns
    if not base_parameters(arm).has_groups or model is None or not model.motion.size:
        return None
    final = {p.key: p.value for p in identification.parameters if p.value is not None}
    solution = model.solution.copy()
    for k, column in enumerate(columns):
        solution[k] = final.get(column.key, solution[k])
    joints = enumerate(arm.joints, start=1)
    motors = [final.get((MOTOR_INERTIA, i)) if joint.elastic else None for i, joint in joints]
    parameters = standard_of_torques(arm, replace(model, solution=solution), motors)
    if parameters is None:
        return None
    return {standard_name(key): value for key, value in parameters.items()}


def standard_of_torques(
    arm: ArmDescription, model: RigidModel, motors: Sequence[float | None]
) -> Values | None:
    """Consistent links and motor inertias with the torques of a rigid model over its motion.

    `motors` are known motor inertias; the others are what the bodies leave, and not negative.
    None if no set is found.
    """
    n, base = arm.n_joints, base_parameters(arm)
    viscous, coulomb, offset = model.solution[len(base.columns) :][: 3 * n].reshape(-1, 3).T
    torque = motor_regressor(arm, model.motion) @ base.particular()
    torque = torque @ model.solution[: len(base.columns)]
    laws = friction_laws(model.motion[1])
    total = torque + viscous * laws[..., 0] + coulomb * laws[..., 1] + offset
    columns = laws[:, :, None] * np.eye(n)[:, :, None]
    chain, errors = replace(arm, kind="serial"), torque_errors(model, total)
    values = links_of_torques(chain, model.motion, torque, errors, columns, motors)
    if values is None:
        return None
    keys = [*base_parameters(chain).links, *((MOTOR_INERTIA, i + 1) for i in range(n))]
    return dict(zip(keys, values.tolist(), strict=True))


def torque_errors(model: RigidModel | None, torque: FloatArray) -> FloatArray:
    """Errors (n_joints,) of the torques (n_samples, n_joints): residuals of the model, if known."""
    known = model.torque_errors if model else {}
    shares = [known.get(number, ASSUMED_TORQUE_ERROR) for number in range(1, torque.shape[1] + 1)]
    return np.asarray(np.sqrt(np.mean(torque**2, axis=0)) * shares + np.finfo(float).tiny)


def friction_laws(velocity: FloatArray) -> FloatArray:
    """Viscous, Coulomb and constant friction of unit size, as the last axis."""
    return np.stack([velocity, np.sign(velocity), np.ones_like(velocity)], axis=-1)


def links_of_torques(
    chain: ArmDescription,
    motion: FloatArray,
    torque: FloatArray,
    errors: FloatArray,
    friction: FloatArray,
    motors: Sequence[float | None],
) -> FloatArray | None:
    """Links and motor inertias (11 n_joints,) nearest to torques over a motion; None if none are.

    `torque` (n_samples, n_joints) is that of the motors without friction. If no bodies have these
    torques within a tenth of their `errors` (n_joints,), the bodies are the nearest ones: the prior
    counts little against differences over the errors, and those that friction with the columns
    (n_samples, n_joints, ...) makes up for do not count. `motors` are as in `standard_of_torques`.
    """
    n, scale = chain.n_joints, errors[:, None]
    known = np.array([motor or 0.0 for motor in motors])
    columns = motor_regressor(chain, motion)
    columns = np.concatenate([columns, friction.reshape(*torque.shape, -1)], axis=2) / scale
    target = (torque[:, :, None] / scale).ravel()
    target -= columns[:, :, 10 * n : 11 * n].reshape(target.size, -1) @ known
    Q, rows = np.linalg.qr(columns.reshape(target.size, -1))
    right = Q.T @ target

    def search(weight: float, ignored: list[int]) -> tuple[FloatArray, float] | None:
        """Links and motor inertias, and the norm of the differences; None if it diverges."""
        inertias, free = known.copy(), [i for i, motor in enumerate(motors) if motor is None]
        while True:
            others = rows[:, [10 * n + i for i in free] + ignored]
            directions = np.linalg.svd(others)[0][:, np.linalg.matrix_rank(others) :].T
            A, b = directions @ rows[:, : 10 * n], directions @ right
            try:
                links = consistent_links(priors_of(chain), weight * A, weight * b)
            except NumericalFailure:  # the torques lead along the border of the consistent sets
                return None
            rest = np.linalg.lstsq(others, right - rows[:, : 10 * n] @ links)[0]
            inertias[free] = rest[: len(free)]
            negative = [i for i in free if inertias[i] < 0.0]
            if not negative:
                return np.concatenate([links, inertias]), float(np.linalg.norm(A @ links - b))
            inertias[negative] = 0.0
            free = [i for i in free if i not in negative]

    of_friction, limit = list(range(11 * n, rows.shape[1])), _MAX_ERROR * np.sqrt(target.size)
    attempts = (search(weight, of_friction) for weight in _WEIGHTS)
    nearest = next((each for each in attempts if each is not None), None)
    if nearest is None:
        return None
    exact = search(1.0 / _EXACT, []) if nearest[1] <= limit else None
    return (exact if exact is not None and exact[1] <= limit else nearest)[0]


def motor_regressor(arm: ArmDescription, motion: FloatArray) -> FloatArray:
    """Motor torques per parameter of the links and motor inertia: (n_samples, n_joints, n)."""
    core, to_links = core_arm(arm, ["rigid"] * arm.n_joints), transmission(arm)
    links = (np.ascontiguousarray(x @ to_links.T) for x in motion)
    of_links = np.einsum("jm,njp->nmp", to_links, core.base_regressor(*links))
    return np.concatenate([of_links, motion[2][:, :, None] * np.eye(arm.n_joints)], axis=2)
