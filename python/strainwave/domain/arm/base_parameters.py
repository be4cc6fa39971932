"""Base parameters: the combinations of parameters that the torques of rigid motion identify.

The torques are linear in the parameters of the links and in the motor inertias. Columns of the
regressor of the compiled arm that depend on others are grouped with them: with the independent
columns W_b and the dependent ones W_d = W_b K, the base parameters are b = pi_b + K pi_d (Gautier,
1991).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import numpy as np

from strainwave._core import Arm as CoreArm
from strainwave.domain.arm.description import ArmDescription, Joint, unit_in
from strainwave.domain.arm.kinds import RigidColumn, kind_of
from strainwave.domain.arm.parameter_table import grouped_name
from strainwave.domain.keys import FloatArray, JointNumber, Key, Row


def core_arm(arm: ArmDescription, springs: Sequence[str], **constants: Any) -> CoreArm:
    """The equations of motion of an arm; `constants` are those of its electronics and sensors.

    Planar arms have compiled programs of their own, which are faster than those of a chain.
    """
    return CoreArm(
        [(j.motion, j.origin.xyz, j.origin.rpy, j.axis) for j in arm.joints],
        springs,
        [joint.gear_ratio for joint in arm.joints],
        program=arm.kind if arm.has_planar_program else "serial",
        gravity=arm.gravity or (0.0, 0.0, 0.0),
        transmission=arm.coupling,
        **constants,
    )


def transmission(arm: ArmDescription) -> FloatArray:
    """C N: link angles per motor angle, (n_joints, n_joints)."""
    coupling = np.eye(arm.n_joints) if arm.coupling is None else np.array(arm.coupling)
    return np.asarray(coupling * np.array([joint.gear_ratio for joint in arm.joints]))


MOTOR_INERTIA = "motor_inertia"

_SAMPLES = 60  # random states; each gives one equation per joint for at most 77 parameters
# Part of a column of norm one across all others below which motion does not show its parameter:
# axes that are parallel to a microradian count as parallel.
_MIN_INDEPENDENT_PART = 1e-6
# Columns of links with a smaller part become independent after those with a larger one: others
# have large weights over them.
_CLEARLY_INDEPENDENT_PART = 1e-3
# Relative rounding error of norms, weights and ratios of the regressor's
# columns. Smaller ones are zero.
_MAX_ROUNDING_ERROR = 1e-8


@dataclass(frozen=True)
class BaseParameters:
    """Base parameters of an arm behind rigid gears, and the parameters of which they consist."""

    links: tuple[Key, ...]  # parameters of the links, in the order of the core
    effective: tuple[Key, ...]  # those on which the torques depend
    columns: tuple[RigidColumn, ...]  # base parameters, those with a motor inertia first
    rows: FloatArray  # (n_base, n_links + n_joints) weights of link parameters and motor inertias
    independent: tuple[int, ...]  # (n_base,) index of the independent parameter of each

    def particular(self, motor_share: float | FloatArray = 0.0) -> FloatArray:
        """Parameters that have given base parameters: (n_links + n_joints, n_base).

        `motor_share` is the share of all motors, or of each one, (n_joints,), in base parameters
        that contain inertias of a motor and of links. The torques do not depend on it.
        """
        if isinstance(motor_share, np.ndarray):
            return self._particular_of(motor_share)
        if motor_share not in self._by_share:
            self._by_share[motor_share] = self._particular_of(motor_share)
            self._by_share[motor_share].setflags(write=False)
        return self._by_share[motor_share]

    @cached_property
    def _by_share(self) -> dict[float, FloatArray]:
        """Results of `particular`, for which every iteration asks."""
        return {}

    def _particular_of(self, motor_share: float | FloatArray) -> FloatArray:
        shares = np.broadcast_to(motor_share, self.rows.shape[1] - len(self.links))
        leading = np.zeros(self.rows.T.shape)
        for k, at in enumerate(self.independent):
            leading[at, k] = 1.0 / self.rows[k, at]
        particular = leading.copy()
        for motor in range(len(self.links), self.rows.shape[1]):
            groups = np.flatnonzero(self.rows[:, motor])
            if len(groups) and motor not in self.independent:
                shift = -leading @ self.rows[:, motor]
                shift[motor] += 1.0
                share = shares[motor - len(self.links)]
                particular[:, groups[0]] += share / self.rows[groups[0], motor] * shift
        return particular

    @property
    def links_per_motor(self) -> FloatArray:
        """Change of the link parameters per motor inertia without change of the torques.

        (n_links, n_joints); zero for the motors whose inertia motion determines.
        """
        n_links = len(self.links)
        return -(self.particular() @ self.rows)[:n_links, n_links:]

    @cached_property
    def independent_links(self) -> tuple[Key, ...]:
        """Parameters of links whose columns are independent."""
        return tuple(self.links[at] for at in self.independent if at < len(self.links))

    @cached_property
    def has_groups(self) -> bool:
        """Whether motion determines combinations of link parameters only, as in a general chain.

        An independent parameter then stands for its combination and may have either sign.
        """
        return len(self.effective) > len(self.independent_links)

    @cached_property
    def separate_links(self) -> tuple[Key, ...]:
        """Parameters of links that are base parameters by themselves."""
        return tuple(column.key for column in self.columns if column.key in self.links)

    def weights(self, row: Row) -> Row:
        """A combination of link parameters and motor inertias over the base parameters.

        The combination must be identifiable, such as a diagonal element of the inertia matrix with
        the reflected motor inertia.
        """
        dense = np.zeros(self.rows.shape[1])
        for (name, joint), weight in row.items():
            at = (
                len(self.links) + (joint or 1) - 1
                if name == MOTOR_INERTIA
                else self.links.index((name, joint))
            )
            dense[at] = weight
        over_base = dense @ self.particular()
        pairs = zip(self.columns, over_base.tolist(), strict=True)
        return {column.key: weight for column, weight in pairs if weight}


def base_parameters(arm: ArmDescription) -> BaseParameters:
    """Base parameters of an arm; they depend on its geometry, gravity and transmission only."""
    joints = (
        Joint(
            "rigid",
            j.gear_ratio,
            j.motion,
            origin=j.origin,
            axis=j.axis,
            torque_at_link=j.torque_at_link,
        )
        for j in arm.joints
    )
    return _base_parameters(ArmDescription(arm.kind, tuple(joints), arm.gravity, arm.coupling))


@lru_cache(maxsize=64)
def _base_parameters(arm: ArmDescription) -> BaseParameters:
    regressor, links = _regressor(arm)
    norms = np.linalg.norm(regressor, axis=0)
    of_links = norms[: len(links)]  # the columns of motors are exact and may be far larger
    of_links[of_links < _MAX_ROUNDING_ERROR * of_links.max()] = 0.0
    regressor = regressor * (norms > 0.0)
    scale = np.where(norms > 0.0, norms, 1.0)
    independent, grouping = _grouping(regressor / scale, _preference(links, arm))
    grouping = np.where(np.abs(grouping) > _MAX_ROUNDING_ERROR, grouping, 0.0)
    grouping *= scale / scale[independent][:, None]
    grouping[:, independent] = np.eye(len(independent))
    keys = (*links, *((MOTOR_INERTIA, i + 1) for i in range(arm.n_joints)))
    named = kind_of(arm).rigid_combinations(arm)
    columns = []
    for at, weights in zip(independent, grouping, strict=True):
        row = {keys[k]: float(f"{weights[k]:.12g}") for k in np.flatnonzero(weights)}
        columns.append((_named_column(keys[at], row, named, arm), at))
    columns.sort(key=lambda pair: (pair[0].motor is None, pair[0].motor or (0, 0.0)))
    return BaseParameters(
        links=links,
        effective=tuple(key for key, norm in zip(links, norms, strict=False) if norm > 0.0),
        columns=tuple(column for column, _ in columns),
        rows=np.array([[column.parts.get(key, 0.0) for key in keys] for column, _ in columns]),
        independent=tuple(at for _, at in columns),
    )


def _grouping(
    columns: FloatArray, order: Sequence[tuple[int, float]]
) -> tuple[list[int], FloatArray]:
    """Group columns of norm one with independent ones that come before them in `order`.

    Returns the independent columns, ascending, and the weights of each column over them,
    (n_independent, n_columns). A column is independent if its part across the independent columns
    before it exceeds the limit beside it in `order`. Nearly dependent columns, such as those of
    nearly parallel axes, do not take that part from columns after them. Parts of other columns as
    small are rounded to zero.
    """
    basis, kept = np.zeros((len(columns), 0)), list[int]()
    coefficients = np.zeros((columns.shape[1],) * 2)  # row k: along the k-th vector of the basis
    for at, limit in order:
        if at in kept:
            continue
        along = basis.T @ columns[:, at]
        rest = columns[:, at] - basis @ along
        again = basis.T @ rest  # the second pass makes the basis orthogonal to rounding
        rest -= basis @ again
        coefficients[: len(kept), at] = along + again
        size = float(np.linalg.norm(rest))
        if size > limit:
            coefficients[len(kept), at] = size
            basis = np.column_stack([basis, rest / size])
            kept.append(at)
    coefficients = coefficients[: len(kept)]
    triangular = coefficients[:, kept]
    parts = np.where(np.abs(coefficients) > _MIN_INDEPENDENT_PART, coefficients, 0.0)
    parts[:, kept] = triangular
    weights = np.asarray(np.linalg.solve(triangular, parts))
    ascending = np.argsort(kept)
    return [kept[k] for k in ascending], weights[ascending]


def link_inertia(arm: ArmDescription, joint: JointNumber, posture: FloatArray | None = None) -> Row:
    """m_L of a joint: the diagonal element of M(q) as a row over link parameters.

    `posture` (n_joints,) are link angles; None: all are zero.
    """
    core = core_arm(arm, ["rigid"] * arm.n_joints)
    angle = np.zeros((1, arm.n_joints)) if posture is None else np.atleast_2d(posture)
    rest, unit = np.zeros_like(angle), np.zeros_like(angle)
    unit[0, joint - 1] = 1.0
    weights = core.base_regressor(angle, rest, unit) - core.base_regressor(angle, rest, rest)
    links = core.parameter_names[: weights.shape[2]]
    pairs = zip(links, weights[0, joint - 1].tolist(), strict=True)
    return {key: weight for key, weight in pairs if weight}


def torque_per_parameter(
    arm: ArmDescription, velocity: Sequence[float], acceleration: Sequence[float]
) -> FloatArray:
    """Rms motor torque per base parameter over random motions: (n_joints, n_base).

    `velocity` and `acceleration` of each joint's link are rms values; angles are uniform.
    """
    base, core, n = base_parameters(arm), core_arm(arm, ["rigid"] * arm.n_joints), arm.n_joints
    random = np.random.default_rng(0)
    angle = random.uniform(-np.pi, np.pi, size=(_SAMPLES, n))
    rates, changes = (random.normal(size=(_SAMPLES, n)) * size for size in (velocity, acceleration))
    of_links = core.base_regressor(angle, rates, changes) @ base.particular()[: len(base.links)]
    torques = np.einsum("kj,skb->sjb", transmission(arm), of_links)
    return np.asarray(np.sqrt(np.mean(torques**2, axis=0)))


def _regressor(arm: ArmDescription) -> tuple[FloatArray, tuple[Key, ...]]:
    """Link torques per link parameter and motor inertia at random states, and the parameters."""
    core, n = core_arm(arm, ["rigid"] * arm.n_joints), arm.n_joints
    angle, velocity, acceleration = np.random.default_rng(0).normal(size=(3, _SAMPLES, n))
    of_links = core.base_regressor(angle, velocity, acceleration)
    inverse = np.linalg.inv(transmission(arm))
    motors = inverse.T[None] * (acceleration @ inverse.T)[:, None, :]
    motors *= [not joint.torque_at_link for joint in arm.joints]
    links = tuple(core.parameter_names[: of_links.shape[2]])
    return np.concatenate([of_links, motors], axis=2).reshape(_SAMPLES * n, -1), links


def _preference(links: tuple[Key, ...], arm: ArmDescription) -> list[tuple[int, float]]:
    """Order in which columns become independent, each with its smallest independent part.

    The remaining ones are grouped with them. Clearly independent columns of links come first. The
    mass, the first moment along the axis and one moment of inertia across it come after all
    others, as in the literature (Khalil and Dombre); motor inertias come last.
    """

    def rank(k: int) -> tuple[bool, int, int]:
        name, joint = links[k]
        number = (joint or 1) - 1
        along = int(np.argmax(np.abs(arm.joints[number].axis)))
        across = "xyz"[(along + 2) % 3]
        grouped = "link_mass", f"link_first_moment_{'xyz'[along]}", f"link_inertia_{2 * across}"
        return name in grouped, -number, k

    of_links = sorted(range(len(links)), key=rank)
    of_motors = range(len(links), len(links) + arm.n_joints)
    clearly = [(k, _CLEARLY_INDEPENDENT_PART) for k in of_links]
    return [*clearly, *((k, _MIN_INDEPENDENT_PART) for k in (*of_links, *of_motors))]


def _named_column(
    leading: Key, row: Row, named: Mapping[Key, Row], arm: ArmDescription
) -> RigidColumn:
    """Base parameter with the name of a proportional combination, or of its leading parameter."""
    for key, declared in named.items():
        if declared.keys() == row.keys():
            factors = [declared[part] / weight for part, weight in row.items()]
            if np.ptp(factors) < _MAX_ROUNDING_ERROR * abs(factors[0]):
                return RigidColumn(*key, unit_in(arm, key), declared)
    name, joint = leading
    key = (grouped_name(name) if len(row) > 1 else name, joint)
    return RigidColumn(*key, unit_in(arm, key), row)
