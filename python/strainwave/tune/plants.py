"""Linear arms behind their drives, for drawn parameters, postures, payloads and gear slopes.

With the coordinates p of `strainwave.export.linear_models`, a deviation from rest follows

    M ddp + D dp + K p = P tau_M

M has the motor inertias and M(q), K the gears and the slope of gravity, and P transmits torques to
motors behind rigid gears. Coulomb friction is neglected: it damps, so that the margins are those
of joints that slide.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import product

import numpy as np

from strainwave.domain import BoolArray, ComplexArray, FloatArray, IntArray, Payload
from strainwave.domain.keys import Values
from strainwave.dynamics.arm import Arm
from strainwave.errors import NotIdentifiable
from strainwave.export.linear_models import coordinates_of
from strainwave.export.source import IdentifiedArm
from strainwave.numerics.parallel import run_parallel

_GRAVITY_STEP = 1e-3  # [rad] of central differences; gravity is smooth
_PART = 100  # plants
_N_PROBED = 8  # frequencies at which sums over poles are compared with solutions
_MAX_ROUNDING = 1e-9  # of responses
_RIGID_SHARE = 1e-3  # of the highest frequency, below which a mode has no torsion

Resonances = list[tuple[FloatArray, FloatArray]]
"""Elastic modes, slowest first: (frequencies [rad/s], damping ratios) of all plants."""


@dataclass(frozen=True, slots=True, eq=False)
class Condition:
    """A posture and a load for which a servo must hold."""

    posture: FloatArray  # link angles (n_joints,)
    payload: Payload | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Plants:
    """Linear arms: matrices over the coordinates, motors and drives."""

    mass: FloatArray  # (n_plants, n, n)
    damping: FloatArray  # (n_plants, n, n)
    stiffness: FloatArray  # (n_plants, n, n)
    motors: FloatArray  # (n_joints, n) motor angles per coordinate
    links: FloatArray  # (n_joints, n) link angles per coordinate
    rigid: FloatArray  # (n, n_joints) coordinates per motor angle, without torsion
    torque_per_volt: FloatArray  # (n_joints,) [N m/V]
    current_loop: FloatArray  # (n_joints,) [rad/s]; infinite without a lag
    draw: IntArray  # (n_plants,) drawn parameters; 0 are the estimates
    condition: IntArray  # (n_plants,)

    def __len__(self) -> int:
        return len(self.mass)

    @property
    def n_joints(self) -> int:
        """Number of joints."""
        return len(self.motors)

    def part(self, chosen: slice | IntArray) -> Plants:
        """Some of the plants."""
        names = ("mass", "damping", "stiffness", "draw", "condition")
        return replace(self, **{name: getattr(self, name)[chosen] for name in names})

    def equations(self) -> tuple[FloatArray, FloatArray]:
        """F (n_plants, 2 n, 2 n) and G (n_plants, 2 n, n_joints) of dx = F x + G tau_M.

        The states x are coordinates and their velocities.
        """
        n = self.mass.shape[1]
        inputs = np.broadcast_to(self.motors.T, (len(self), n, self.n_joints))
        of_motion = np.concatenate([-self.stiffness, -self.damping, inputs], axis=2)
        F, G = np.zeros((len(self), 2 * n, 2 * n)), np.zeros((len(self), 2 * n, self.n_joints))
        F[:, :n, n:] = np.eye(n)
        F[:, n:], G[:, n:] = np.split(np.linalg.solve(self.mass, of_motion), [2 * n], axis=2)
        return F, G

    def motor_inertias(self) -> FloatArray:
        """Inertia that each motor accelerates in the first instant: (n_plants, n_joints)."""
        motors = np.broadcast_to(self.motors.T, (len(self), *self.motors.T.shape))
        compliance = self.motors @ np.linalg.solve(self.mass, motors)
        return np.asarray(1.0 / np.diagonal(compliance, axis1=1, axis2=2))

    def rigid_inertias(self) -> FloatArray:
        """Inertia at each motor without torsion, the others locked: (n_plants, n_joints)."""
        inertia = self.rigid.T @ self.mass @ self.rigid
        return np.asarray(np.diagonal(inertia, axis1=1, axis2=2))

    def resonances(self, *, with_held_motors: bool = False) -> Resonances:
        """Resonances with free motors, or with held motors.

        An ideal servo leaves the modes of the links with held motors.
        """
        free = np.arange(self.mass.shape[1])
        if with_held_motors:
            free = np.flatnonzero(~self.motors.any(axis=0))
        if not len(free):
            return []
        at = np.ix_(np.arange(len(self)), free, free)
        root = np.linalg.inv(np.linalg.cholesky(self.mass[at]))
        turned = np.swapaxes(root, 1, 2)
        squares, vectors = np.linalg.eigh(root @ self.stiffness[at] @ turned)
        shapes = turned @ vectors  # of unit modal mass
        damping = np.einsum("pci,pcd,pdi->pi", shapes, self.damping[at], shapes, optimize=True)
        omega = np.sqrt(np.maximum(squares, 0.0))
        moving = omega.min(axis=0) > _RIGID_SHARE * omega.max()
        return [(omega[:, k], 0.5 * damping[:, k] / omega[:, k]) for k in np.flatnonzero(moving)]


@dataclass(frozen=True, slots=True, eq=False)
class PoleSums:
    """Responses of motor angles to motor torques as sums over pairs of poles of each plant.

        sum over k of (b_k + c_k s) / (s^2 + d_k s + e_k)

    Both poles of a pair are real or they are conjugate. The coefficients do not depend on servos.
    Responses are symmetric, so that those of pairs of joints suffice: (0, 0), (0, 1) ...
    (n_joints - 1, n_joints - 1).
    """

    plants: Plants
    numerators: FloatArray  # (n_plants, n_pairs, 2 n): b_k, then c_k
    denominators: FloatArray  # (n_plants, 2, n): d_k and e_k
    is_accurate: BoolArray  # (n_plants,) false for nearly equal poles: those plants are solved

    @classmethod
    def of(cls, plants: Plants, omega: FloatArray) -> PoleSums:
        """The sums, compared with solutions at some of the frequencies [rad/s]."""
        probed = omega[:: -(-len(omega) // _N_PROBED)]
        places = np.array_split(np.arange(len(plants)), -(-len(plants) // _PART))
        parts = run_parallel([partial(_pole_sums, plants.part(each), probed) for each in places])
        return cls(plants, *(np.concatenate(each) for each in zip(*parts, strict=True)))

    def responses(self, omega: FloatArray, chosen: IntArray) -> ComplexArray:
        """Responses (n_chosen, n_pairs, n_omega) at frequencies [rad/s]."""
        response = _sums(self.numerators[chosen], self.denominators[chosen], omega)
        if len(others := np.flatnonzero(~self.is_accurate[chosen])):
            response[others] = _solved_responses(self.plants.part(chosen[others]), omega)
        return np.asarray(response)


def _sums(numerators: FloatArray, denominators: FloatArray, omega: FloatArray) -> ComplexArray:
    """Responses of `PoleSums`, by one real product."""
    d, e = np.moveaxis(denominators[..., None], 1, 0)
    n, real, imag = d.shape[1], e - omega**2, d * omega
    scale = 1.0 / (real**2 + imag**2)
    terms = np.empty((len(d), 2 * n, len(omega)), dtype=complex)
    terms.real[:, :n], terms.imag[:, :n] = real * scale, -imag * scale
    terms.real[:, n:], terms.imag[:, n:] = omega * imag * scale, omega * real * scale
    return np.asarray((numerators @ terms.view(np.float64)).view(np.complex128))


def _pole_sums(plants: Plants, probed: FloatArray) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Numerators, denominators and accuracy of `PoleSums`."""
    system, by_torque = plants.equations()
    poles, modes = np.linalg.eig(system)
    first, second = np.triu_indices(plants.n_joints)
    with np.errstate(over="ignore", invalid="ignore"):  # of nearly equal poles
        excited = np.swapaxes(np.linalg.solve(modes, by_torque), 1, 2)
        angles = plants.motors @ modes[:, : plants.mass.shape[1]]
        residues = angles[:, first] * excited[:, second]
        # conjugate poles, which are neighbours, before real poles
        order = np.argsort(poles.imag == 0.0, axis=1, kind="stable")
        poles = np.take_along_axis(poles, order, 1)
        residues = np.take_along_axis(residues, order[:, None], 2)
        (p, q), (r, t) = ((each[..., ::2], each[..., 1::2]) for each in (poles, residues))
        numerators = np.concatenate([-r * q[:, None] - t * p[:, None], r + t], axis=2).real
        denominators = np.stack([-p - q, p * q], axis=1).real
        sums = _sums(numerators, denominators, probed)
        solved = _solved_responses(plants, probed)
        error = np.abs(sums - solved).max(axis=1)
    accuracy = _MAX_ROUNDING * np.abs(solved).max(axis=1)
    is_accurate = (error <= accuracy).all(axis=1)  # false for one that is not a number
    return numerators, denominators, is_accurate


def _solved_responses(plants: Plants, omega: FloatArray) -> ComplexArray:
    """Responses in the shape of `PoleSums.responses`, which takes longer than the sums."""
    s = 1j * omega[:, None, None]
    system = s**2 * plants.mass[:, None] + s * plants.damping[:, None] + plants.stiffness[:, None]
    inputs = np.broadcast_to(plants.motors.T, (*system.shape[:3], plants.n_joints))
    first, second = np.triu_indices(plants.n_joints)
    return np.moveaxis((plants.motors @ np.linalg.solve(system, inputs))[..., first, second], 1, 2)


def plants_of(
    arm: IdentifiedArm,
    draws: Sequence[Values],
    conditions: Sequence[Condition],
) -> Plants:
    """Plants of all draws in all conditions, with the lowest and highest slope of curved gears.

    `draws` begin with the estimates, which have all parameters of the plants.
    """
    description, model = arm.study.arm, Arm.of(arm.study.arm)
    coordinates = coordinates_of(description)
    motors, torsions = coordinates.motor_angles, coordinates.torsions
    n, size = description.n_joints, motors.shape[1]
    links = np.eye(n, size, k=size - n)
    numbers = range(1, n + 1)
    laws = [(number, arm.joint(number).law) for number in coordinates.elastic]
    slopes = (0, 1) if any(law.is_curved for _, law in laws) else (1,)
    links_at = [LinksAt.of(model, condition) for condition in conditions]
    parts: list[tuple[FloatArray, FloatArray, FloatArray]] = []
    places = []
    for (d, values), slope in product(enumerate(draws), slopes):

        def column(name: str, values: Values = values) -> FloatArray:
            return np.array([values[name, number] for number in numbers])

        gears = np.array(
            [law.stiffness_range(law.of_joint(values, number))[slope] for number, law in laws]
        )
        gear_damping = np.array([values["gear_damping", number] for number, _ in laws])
        base = base_vector(model, values)
        damping = _form(motors, column("motor_viscous_friction"))
        damping += _form(torsions, gear_damping) + _form(links, column("link_viscous_friction"))
        of_motors, of_gears = _form(motors, column("motor_inertia")), _form(torsions, gears)
        for c, at in enumerate(links_at):
            mass, stiffness = of_motors.copy(), of_gears.copy()
            mass[-n:, -n:] += at.inertia(base)
            stiffness[-n:, -n:] += at.gravity(base)
            parts.append((mass, damping, stiffness))
            places.append((d, c))
    mass, damping, stiffness = (np.array(part) for part in zip(*parts, strict=True))
    loops = [joint.current_loop_hz for joint in description.joints]
    rigid = np.zeros((size, n))
    rigid[: size - n] = np.eye(n)[np.array(coordinates.elastic, dtype=int) - 1]
    rigid[size - n :] = model.transmission
    draw, condition_index = np.array(places).T
    return Plants(
        mass=mass,
        damping=damping,
        stiffness=stiffness,
        motors=motors,
        links=links,
        rigid=rigid,
        torque_per_volt=model.torque_per_volt,
        current_loop=np.array([2.0 * np.pi * hz if hz else np.inf for hz in loops]),
        draw=draw,
        condition=condition_index,
    )


def without_impossible(
    plants: Plants, draws: Sequence[Values]
) -> tuple[Plants, tuple[Values, ...]]:
    """Plants and draws without those whose inertia matrix no arm has.

    Raises `NotIdentifiable` if the estimates, the first draw, are among them.
    """
    is_possible = np.linalg.eigvalsh(plants.mass)[:, 0] > 0.0
    impossible = set(plants.draw[~is_possible].tolist())
    if 0 in impossible:
        raise NotIdentifiable(
            "the estimates have no positive definite inertia matrix at a posture of the design; "
            "record more motion of the joints whose inertia has no value"
        )
    kept = np.flatnonzero(~np.isin(plants.draw, list(impossible)))
    return plants.part(kept), tuple(d for i, d in enumerate(draws) if i not in impossible)


def base_vector(model: Arm, values: Values) -> FloatArray:
    """Base parameters of a motion: (n_base,)."""
    effective = set(model.base.effective)
    return np.array([values[key] if key in effective else 0.0 for key in model.base_names])


def _form(rows: FloatArray, weights: FloatArray) -> FloatArray:
    """Quadratic form of weighted rows over the coordinates."""
    return np.asarray(rows.T @ (weights[:, None] * rows))


@dataclass(frozen=True, slots=True, eq=False)
class LinksAt:
    """M(q) and dg/dq at a posture with a payload, linear in the base parameters."""

    inertia_per_base: FloatArray  # (n_joints, n_joints, n_base)
    gravity_per_base: FloatArray
    payload_inertia: FloatArray  # (n_joints, n_joints)
    payload_gravity: FloatArray

    @classmethod
    def of(cls, model: Arm, condition: Condition) -> LinksAt:
        """The matrices of a condition. Row i is the torque of link i, column j moves joint j."""
        n, q, load = model.n_joints, condition.posture, condition.payload
        posture, unit = np.tile(q, (n, 1)), np.eye(n)
        rest = np.zeros_like(posture)
        ahead, behind = posture + _GRAVITY_STEP * unit, posture - _GRAVITY_STEP * unit

        def columns(torques: FloatArray, others: FloatArray) -> FloatArray:
            return np.asarray(np.swapaxes(torques - others, 0, 1))

        at_rest = model.base_regressor(posture, rest, rest)
        inertia = columns(model.base_regressor(posture, rest, unit), at_rest)
        torques = [model.base_regressor(at, rest, rest) for at in (ahead, behind)]
        gravity = columns(*torques) / (2.0 * _GRAVITY_STEP)
        if load is None:
            return cls(inertia, gravity, np.zeros((n, n)), np.zeros((n, n)))
        # a payload is a part of the last link, whose parameters those of a chain have one by one
        chain = replace(model, kind="serial")
        vector = chain.payload_vector(load)
        torques = [chain.link_torques(vector, at, rest, rest) for at in (ahead, behind)]
        of_load = columns(*torques) / (2.0 * _GRAVITY_STEP)
        return cls(inertia, gravity, chain.inertia_matrix(vector, q), of_load)

    def inertia(self, base: FloatArray) -> FloatArray:
        """M(q), (n_joints, n_joints)."""
        return np.asarray(self.inertia_per_base @ base + self.payload_inertia)

    def gravity(self, base: FloatArray) -> FloatArray:
        """dg/dq, (n_joints, n_joints)."""
        return np.asarray(self.gravity_per_base @ base + self.payload_gravity)
