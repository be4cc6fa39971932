"""What is searched for: unknowns, where they start, how far they may go, what is known of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from strainwave.errors import NotIdentifiable
from strainwave.parameters import Values, unit_of
from strainwave.records import FloatArray, JointModel, RigidModel, Study

VISCOUS = ("motor_viscous_friction", "link_viscous_friction")
_DAMPINGS = (*VISCOUS, "gear_damping")
_GEAR = ("gear_stiffness", "gear_damping")
_BASE = ("alpha", "beta", "gamma")
_LEAST_SHARE = 0.05  # of the total viscous friction, where a start would be negative
_DAMPING_FACTOR = 3.0  # up and down
_REACH = 4.0  # deviations
_MOST = 0.9  # of its value, which a parameter may lose
# Of its value: the stiffness that stands for a curve, and the damping found with it, depend on how
# far the gear was twisted; between softest and stiffest slope lies about twice as much.
_EQUIVALENT = 0.1


@dataclass(frozen=True, slots=True)
class Unknown:
    """One parameter that is searched for."""

    name: str
    joint: int | None
    unit: str
    start: float
    reach: float  # how far its coordinate may go, up and down

    def __str__(self) -> str:
        return self.name if self.joint is None else f"{self.name} of joint {self.joint}"


@dataclass(frozen=True, slots=True)
class Prior:
    """What earlier stages know: linear combinations of the unknowns, with correlated errors."""

    rows: FloatArray  # (n_rows, n_unknowns), whitened
    target: FloatArray  # (n_rows,), whitened


@dataclass(frozen=True, slots=True)
class Search:
    """The unknowns together, and what stays as it is.

    Their coordinates z are zero at the start: a positive parameter is start exp(z), a gravity
    torque start (1 + z).
    """

    unknowns: tuple[Unknown, ...]
    fixed: Mapping[tuple[str, int | None], float]
    fixed_deviation: Mapping[tuple[str, int | None], float]
    prior: Prior

    @property
    def reach(self) -> FloatArray:
        """(n_unknowns,) the bounds of z are minus and plus this."""
        return np.array([unknown.reach for unknown in self.unknowns])

    @property
    def _start(self) -> FloatArray:
        return np.array([unknown.start for unknown in self.unknowns])

    @property
    def _exponential(self) -> FloatArray:
        return np.array([not u.name.startswith("gravity") for u in self.unknowns])

    def index(self, name: str, joint: int | None) -> int:
        """Where an unknown stands."""
        return [(u.name, u.joint) for u in self.unknowns].index((name, joint))

    def parameters(self, z: FloatArray) -> FloatArray:
        """The unknowns' values, (n_unknowns,)."""
        return np.asarray(self._start * np.where(self._exponential, np.exp(z), 1.0 + z))

    def slope(self, z: FloatArray) -> FloatArray:
        """Derivative of each value with respect to its coordinate, (n_unknowns,)."""
        return np.asarray(self._start * np.where(self._exponential, np.exp(z), 1.0))

    def values(self, z: FloatArray) -> Values:
        """All that simulating the arm needs."""
        found = dict(self.fixed)
        for unknown, value in zip(self.unknowns, self.parameters(z).tolist(), strict=True):
            found[unknown.name, unknown.joint] = value
        return found

    def prior_residual(self, z: FloatArray) -> FloatArray:
        """(n_rows,) of unit variance."""
        return np.asarray(self.prior.rows @ self.parameters(z) - self.prior.target)

    def prior_jacobian(self, z: FloatArray) -> FloatArray:
        """(n_rows, n_unknowns)."""
        return np.asarray(self.prior.rows * self.slope(z))


def link_inertias(study: Study, names: Sequence[tuple[str, int | None]]) -> FloatArray:
    """m_L of each joint as a combination of the unknowns: (n_joints, n_unknowns).

    m_L1 = alpha + beta + 2 gamma, m_L2 = beta.
    """
    weight = np.zeros((study.n_joints, len(names)))
    if study.n_joints == 1:
        weight[0, names.index(("link_inertia", 1))] = 1.0
        return weight
    weight[0, [names.index((name, None)) for name in _BASE]] = 1.0, 1.0, 2.0
    weight[1, names.index(("beta", None))] = 1.0
    return weight


def search_of(
    model: RigidModel | None,
    joints: Sequence[JointModel],
    study: Study,
    *,
    floor: float,
    span: float,
) -> Search:
    """Start, bounds and prior from what the earlier stages found.

    Parameters
    ----------
    model : RigidModel or None
        Dispensable for a single joint without gravity.
    joints : sequence of JointModel
        One a joint.
    study : Study
    floor : float
        Least deviation of what is known, as a share of its value.
    span : float
        Least share by which a parameter may leave its start.

    Returns
    -------
    Search

    Raises
    ------
    NotIdentifiable
        A start is missing or impossible.
    """
    by_joint = _by_joint(joints, study)
    start = _starts(model, by_joint, study)
    names = tuple(start)
    prior = _prior(model, by_joint, study, start, floor)
    leeway = _leeway(prior, np.array(list(start.values())))
    unknowns = []
    for k, (name, joint) in enumerate(names):
        reach = -np.log1p(-min(max(span, leeway[k]), _MOST))
        if name in _DAMPINGS:
            reach = max(reach, np.log(_DAMPING_FACTOR))
        unit = unit_of(name, study.joints[(joint or 1) - 1]) if joint else _unit(name)
        unknowns.append(Unknown(name, joint, unit, start[name, joint], float(reach)))
    return Search(tuple(unknowns), *_fixed(model, by_joint), prior)


def _unit(name: str) -> str:
    return "N m" if name.startswith("gravity") else "kg m^2"


def _by_joint(joints: Sequence[JointModel], study: Study) -> dict[int, JointModel]:
    found = {joint.joint: joint for joint in joints}
    for number, joint in enumerate(study.joints, start=1):
        if joint.spring == "rigid" or number not in found:
            raise NotIdentifiable(
                f"tuning starts from a model of each elastic joint, and joint {number} has none:"
                ' record it with use = "frequency"'
            )
    return found


def _starts(
    model: RigidModel | None, joints: Mapping[int, JointModel], study: Study
) -> dict[tuple[str, int | None], float]:
    start: dict[tuple[str, int | None], float] = {}
    for number in sorted(joints):
        values = _mended(joints[number].values, study.joints[number - 1].gear_ratio)
        for name in ("motor_inertia", *VISCOUS, *_GEAR):
            start[name, number] = values[name]
        if study.n_joints == 1:
            start["link_inertia", number] = values["link_inertia"]
    if study.n_joints == 2:
        beta, gamma = joints[2].values["link_inertia"], _rigid(model, "gamma")
        start["alpha", None] = joints[1].values["link_inertia"] - beta - 2.0 * gamma
        start["beta", None], start["gamma", None] = beta, gamma
    if study.arm.gravity is not None:
        for i in range(1, study.n_joints + 1):
            start[f"gravity_torque_{i}", None] = _rigid(model, f"gravity_torque_{i}")
    for (name, joint), value in start.items():
        if not np.isfinite(value) or (value <= 0.0 and not name.startswith("gravity")):
            place = name if joint is None else f"{name} of joint {joint}"
            raise NotIdentifiable(
                f"tuning cannot start from {place} = {value:.3g}; record more for the steps before"
            )
    # a start of nothing has no coordinate
    return {key: value for key, value in start.items() if value != 0.0}


def _mended(values: Mapping[str, float], ratio: float) -> dict[str, float]:
    """A negative viscous friction starts at a small share of the total, the other at the rest."""
    mended = dict(values)
    motor, link = (values[name] for name in VISCOUS)
    least = _LEAST_SHARE * abs(motor + ratio**2 * link)
    if motor < least:
        mended[VISCOUS[0]] = least
        mended[VISCOUS[1]] = max(link + (motor - least) / ratio**2, least / ratio**2)
    elif ratio**2 * link < least:
        mended[VISCOUS[1]] = least / ratio**2
        mended[VISCOUS[0]] = max(motor + ratio**2 * link - least, least)
    return mended


def _rigid(model: RigidModel | None, name: str) -> float:
    value = model.value(name) if model is not None else None
    if value is None:
        raise NotIdentifiable(
            f"tuning needs {name} from the rigid model, which does not tell it:"
            ' record both joints moving together with use = "motion"'
        )
    return value


def _fixed(model: RigidModel | None, joints: Mapping[int, JointModel]) -> tuple[Values, Values]:
    """Friction that is taken over, and its deviations."""
    fixed: Values = {}
    deviation: Values = {}
    for number, joint in joints.items():
        key = "motor_coulomb_friction", number
        at = list(joint.values).index(key[0])
        fixed[key] = joint.values[key[0]]
        deviation[key] = float(np.sqrt(joint.covariance[at, at]))
        fixed["friction_offset", number] = deviation["friction_offset", number] = 0.0
        for k, p in enumerate(model.parameters if model is not None else ()):
            if (p.name, p.joint) in fixed and p.joint == number and p.value is not None:
                assert model is not None
                fixed[p.name, number] = p.value
                deviation[p.name, number] = float(np.sqrt(model.covariance[k, k]))
        fixed[key] = max(fixed[key], 0.0)
    return fixed, deviation


def _prior(
    model: RigidModel | None,
    joints: Mapping[int, JointModel],
    study: Study,
    start: Values,
    floor: float,
) -> Prior:
    names = tuple(start)
    rows: list[FloatArray] = []
    target: list[FloatArray] = []
    link = link_inertias(study, names)
    for number, joint in joints.items():
        known = [name for name in joint.values if name != "motor_coulomb_friction"]
        at = [list(joint.values).index(name) for name in known]
        weight = np.zeros((len(known), len(names)))
        for row, name in zip(weight, known, strict=True):
            row[:] = link[number - 1] if name == "link_inertia" else 0.0
            if name != "link_inertia":
                row[names.index((name, number))] = 1.0
        mean = np.array([joint.values[name] for name in known])
        least = np.full(len(known), floor)
        if study.joints[number - 1].spring == "three-slope":
            least[[known.index(name) for name in _GEAR]] = max(floor, _EQUIVALENT)
        _append(rows, target, weight, mean, joint.covariance[np.ix_(at, at)], least)
    if model is not None:
        # inertias and friction of one joint's own have gone into its model already
        shared = [
            k
            for k, p in enumerate(model.parameters)
            if (p.name, p.joint) in start and p.joint is None and p.value is not None
        ]
        weight = np.zeros((len(shared), len(names)))
        for row, k in zip(weight, shared, strict=True):
            row[names.index((model.parameters[k].name, None))] = 1.0
        covariance = model.covariance[np.ix_(shared, shared)]
        least = np.full(len(shared), floor)
        _append(rows, target, weight, model.solution[shared], covariance, least)
    return Prior(np.concatenate(rows), np.concatenate(target))


def _leeway(prior: Prior, start: FloatArray) -> FloatArray:
    """Share by which each parameter may leave its start by what is known of it.

    Four deviations from what all earlier stages say together, which is not quite the start where
    two of them tell of one parameter.
    """
    mean = np.linalg.lstsq(prior.rows, prior.target)[0]
    deviation = np.sqrt(np.diag(np.linalg.inv(prior.rows.T @ prior.rows)))
    return np.asarray((np.abs(mean - start) + _REACH * deviation) / np.abs(start))


def _append(
    rows: list[FloatArray],
    target: list[FloatArray],
    weight: FloatArray,
    mean: FloatArray,
    covariance: FloatArray,
    floor: FloatArray,
) -> None:
    """Rows divided by the Cholesky factor of their errors."""
    if not len(mean):
        return
    factor = np.linalg.cholesky(covariance + np.diag((floor * np.abs(mean)) ** 2))
    rows.append(np.linalg.solve(factor, weight))
    target.append(np.linalg.solve(factor, mean))
