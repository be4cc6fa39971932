"""The arm with its equations of motion: everything that follows from a description."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import fields, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from strainwave import _core
from strainwave.domain import ArmDescription, BoolArray, FloatArray, Joint, Payload
from strainwave.domain.arm.base_parameters import (
    MOTOR_INERTIA,
    BaseParameters,
    base_parameters,
    core_arm,
    link_inertia,
    transmission,
)
from strainwave.domain.arm.combinations import (
    FRICTION_COLUMNS,
    lumped_inertias,
    reported,
    rigid_columns,
    shared_viscous_friction,
)
from strainwave.domain.arm.effects import OF_RIGID_JOINTS, effect_named
from strainwave.domain.arm.kinds import RigidColumn, kind_of
from strainwave.domain.arm.kinds.base import LINK_PARAMETERS
from strainwave.domain.arm.link_sensors import low_passes
from strainwave.domain.arm.parameter_table import family_of
from strainwave.domain.arm.parameters import complete_values
from strainwave.domain.keys import JointNumber, Key, Row, Values
from strainwave.errors import InvalidInput, NumericalFailure

MAX_TIME_STEP = 1.25e-4
"""Upper limit [s] of the integrator's time step. Fast gear resonances need shorter steps."""

# Time steps per period of the fastest gear resonance, so that w h = 0.05. The relative error of the
# fourth-order integrator is (w h)^4/120 = 6e-8, that of the second-order sensor filters is
# (w h)^2/12 = 2e-4: 1/50 of a usual calibration error. Reference solutions use shorter steps.
_STEPS_PER_PERIOD = 120.0
# Largest |pole| h of the fourth-order integrator. It is stable up to 2.6 for any damping.
_STABLE_STEP = 2.0

# [kg m^2] of a rotor whose link behind a rigid gear has all inertia: the core divides by it
_NO_INERTIA = float(np.finfo(float).eps)
_ZERO_BY_DEFAULT = ("friction_offset", "friction_settling_time")


class Arm(ArmDescription):
    """An arm description with its equations of motion (1)-(3), (5)-(7).

    An immutable value: `replace` and `with_joints` make variants. Arrays hold the joints in order
    from the base. Motions (n_samples, n_joints) [rad, rad/s, rad/s^2] are those of the links, each
    relative to the previous link. `base` is the vector (n_base,) of base parameters in the order of
    `base_names`.
    """

    @classmethod
    def of(cls, description: ArmDescription) -> Arm:
        """The arm of a description."""
        return cls(**{f.name: getattr(description, f.name) for f in fields(description)})

    @cached_property
    def core(self) -> _core.Arm:
        """The compiled arm: kind, gears and effects, electronics, sensors."""
        joints = self.joints
        passes = [low_passes(joint) for joint in joints]
        names = {name for one in passes for name in one}
        return core_arm(
            self,
            [joint.law.core_name for joint in joints],
            torque_per_volt=self.torque_per_volt.tolist(),
            current_loop_hz=[joint.current_loop_hz for joint in joints],
            encoder_counts=[joint.encoder_counts for joint in joints],
            accelerometer_distance=[joint.accelerometer_distance or 1.0 for joint in joints],
            effects=[_core_effects(joint) for joint in joints],
            **{name: [one.get(name) for one in passes] for name in names},
        )

    @cached_property
    def gear_ratios(self) -> FloatArray:
        """Turns of each link per turn of its own motor, the diagonal of C N: (n_joints,)."""
        return _constant(np.diagonal(self.transmission).tolist())

    @cached_property
    def is_elastic(self) -> BoolArray:
        """Whether each gear is elastic: (n_joints,)."""
        return np.array([joint.elastic for joint in self.joints])

    @cached_property
    def transmission(self) -> FloatArray:
        """C N: link angles per motor angle, (n_joints, n_joints)."""
        return _constant(transmission(self).tolist())

    def links_of(self, motors: FloatArray) -> FloatArray:
        """Link motion of a motor motion behind rigid gears, C N theta_M: (..., n_joints)."""
        if self.coupling is None:
            return np.asarray(motors * self.gear_ratios)
        return np.asarray(motors @ self.transmission.T)

    def motors_of(self, torques: FloatArray) -> FloatArray:
        """Motor torques that balance torques of the links, N C^T T: (..., n_joints)."""
        if self.coupling is None:
            return np.asarray(torques * self.gear_ratios)
        return np.asarray(torques @ self.transmission)

    def joints_of(self, torques: FloatArray) -> FloatArray:
        """Joint torques that motor torques balance, the inverse of `motors_of`: (..., n_joints)."""
        return np.asarray(torques @ self._inverse_transmission)

    @cached_property
    def _inverse_transmission(self) -> FloatArray:
        return np.asarray(np.linalg.inv(self.transmission))

    @cached_property
    def torque_per_volt(self) -> FloatArray:
        """Torque per volt e [N m/V], motor side: (n_joints,). One if the input is a torque."""
        return _constant([joint.torque_per_command for joint in self.joints])

    @cached_property
    def parameter_names(self) -> tuple[Key, ...]:
        """Parameters of a simulated arm in the order of the core."""
        return tuple(self.core.parameter_names)

    @cached_property
    def base_names(self) -> tuple[Key, ...]:
        """Base parameters, which come first in the core; the links' torques are linear in them."""
        return self.base.links

    @cached_property
    def rigid_columns(self) -> tuple[RigidColumn, ...]:
        """Unknowns of the rigid model: inertias and gravity, friction joint by joint, and of links.

        The latter are viscous frictions of links that several motors turn.
        """
        return rigid_columns(self)

    @cached_property
    def base(self) -> BaseParameters:
        """Base parameters of rigid motion; they come first in `rigid_columns`."""
        return base_parameters(self)

    @property
    def n_body(self) -> int:
        """Number of `rigid_columns` that are not friction."""
        return len(self.base.columns)

    def joint_friction(self, solution: FloatArray) -> FloatArray:
        """Viscous friction, Coulomb friction, offset of joints in a rigid model: (n_joints, 3)."""
        stop = self.n_body + FRICTION_COLUMNS * self.n_joints
        return solution[self.n_body : stop].reshape(self.n_joints, FRICTION_COLUMNS)

    @property
    def n_shared(self) -> int:
        """Number of the last `rigid_columns`, viscous frictions of links that motors share."""
        return len(self.shared_links)

    @cached_property
    def shared_links(self) -> tuple[int, ...]:
        """Links, from 0, of these columns."""
        return tuple((column.joint or 1) - 1 for column in shared_viscous_friction(self).columns)

    def shared_friction_regressor(self, motor_velocity: FloatArray) -> FloatArray:
        """Motor torques per viscous friction of links that motors share: (..., n_joints, n)."""
        torques = motor_velocity[..., None, None, :] @ shared_viscous_friction(self).matrices
        return np.asarray(np.swapaxes(torques[..., 0, :], -1, -2))

    @cached_property
    def reported(self) -> Mapping[Key, Row]:
        """Combinations of parameters that results report, as rows over the parameters."""
        return reported(self)

    @cached_property
    def lumped_inertias(self) -> Mapping[Key, Row]:
        """Inertias that rigid motion does not separate into motor and link, as rows."""
        return lumped_inertias(self)

    def link_inertia(self, joint: JointNumber) -> Row:
        """m_L of (3) for a joint with the arm stretched: a row over the parameters."""
        return link_inertia(self, joint)

    def parameter_vector(self, values: Values) -> FloatArray:
        """Values by name and joint as the vector (n_parameters,) in the order of `parameter_names`.

        Raises InvalidInput if a required parameter is missing.
        """
        known: Values = {}
        for number, joint in enumerate(self.joints, start=1):
            for effect in map(effect_named, joint.named_effects):
                known |= {(name, number): value for name, value in effect.defaults.items()}
        known |= complete_values(values, self)
        for number, joint in enumerate(self.joints, start=1):
            if not joint.elastic and known.get((MOTOR_INERTIA, number)) == 0.0:
                known[MOTOR_INERTIA, number] = _NO_INERTIA
        missing = [k for k in self.parameter_names if k not in known and not _is_zero_by_default(k)]
        if missing:
            names = (f"{name} of joint {joint}" if joint else name for name, joint in missing)
            listed = ", ".join(names)
            raise InvalidInput(
                f"missing parameters: {listed}",
                where="--parameters",
                remedy="add these parameters; docs/notation.md describes them",
            )
        return np.array([known.get(key, 0.0) for key in self.parameter_names])

    def base_regressor(
        self, angle: FloatArray, velocity: FloatArray, acceleration: FloatArray
    ) -> FloatArray:
        """Torques of the links per base parameter, (S2): (n_samples, n_joints, n_base)."""
        return self.core.base_regressor(*_contiguous(angle, velocity, acceleration))

    def link_motion(
        self, angle: FloatArray, velocity: FloatArray, acceleration: FloatArray
    ) -> FloatArray:
        """Rates, angular accelerations, specific forces of the links: (n_samples, n_joints, 9)."""
        return self.core.link_motion(*_contiguous(angle, velocity, acceleration))

    def link_attitudes(self, angle: FloatArray) -> FloatArray:
        """Axes of the base's frame in those of the links: (n_samples, n_joints, 3, 3) columns."""
        angle, rest = np.ascontiguousarray(angle), np.zeros_like(angle)
        axes = np.empty((*angle.shape, 3, 3))
        for k, axis in enumerate(np.eye(3)):
            chain = replace(self, kind="serial", gravity=tuple(-axis))
            axes[..., k] = chain.core.link_motion(angle, rest, rest)[..., 6:]
        return axes

    def link_motion_derivatives(
        self, angle: FloatArray, velocity: FloatArray, acceleration: FloatArray
    ) -> list[FloatArray]:
        """Derivatives of `link_motion` by angle, velocity and acceleration of each joint."""
        return self.core.link_motion_derivatives(*_contiguous(angle, velocity, acceleration))

    def link_torques(
        self, base: FloatArray, angle: FloatArray, velocity: FloatArray, acceleration: FloatArray
    ) -> FloatArray:
        """Torques of the links, M(q) ddq + c(q, dq) + g(q): (n_samples, n_joints) [N m]."""
        motion = _contiguous(angle, velocity, acceleration)
        return self.core.link_torques(np.ascontiguousarray(base), *motion)

    def payload_vector(self, payload: Payload | None) -> FloatArray:
        """Parameters of the links that a payload adds: (n_base,); zero without one."""
        vector = np.zeros(len(self.base_names))
        if payload is not None:
            names: list[Key] = [(f"link_{name}", self.n_joints) for name in LINK_PARAMETERS]
            carried: Values = dict(zip(names, payload.parameters, strict=True))
            rows = kind_of(self).standard_rows(self) if self.has_planar_program else {}
            for k, key in enumerate(self.base_names):
                row = rows.get(key, {key: 1.0})
                vector[k] = math.fsum(w * carried.get(part, 0.0) for part, w in row.items())
        return vector

    def payload_torques(
        self, payload: Payload, angle: FloatArray, velocity: FloatArray, acceleration: FloatArray
    ) -> FloatArray:
        """Motor torques that move a payload behind rigid gears: (n_samples, n_joints) [N m]."""
        vector = self.payload_vector(payload)
        return self.motors_of(self.link_torques(vector, angle, velocity, acceleration))

    def rigid_regressor(
        self, angle: FloatArray, velocity: FloatArray, acceleration: FloatArray
    ) -> FloatArray:
        """Motor torques per base parameter, (5), (S2), (S3): (n_samples, n_joints, n_body)."""
        parameters = self.base.particular()
        n_links = len(self.base.links)
        q, dq, ddq, links = _contiguous(angle, velocity, acceleration, parameters[:n_links])
        torques = self.core.motor_regressor(q, dq, ddq, links, self.transmission)
        self.add_rotor_torques(torques, acceleration, parameters[n_links:])
        return torques

    def add_rotor_torques(
        self, torques: FloatArray, links: FloatArray, inertias: FloatArray
    ) -> None:
        """Add the torques of the rotors per base parameter to those in `torques`.

        `torques` is (n_samples, n_joints, n_body), `links` (n_samples, n_joints) the acceleration
        behind rigid gears, and `inertias` (n_joints, n_body) those of the motors. Most are zero.
        """
        accelerations = self.motor_accelerations(links)
        for i, k in zip(*np.nonzero(inertias), strict=True):
            torques[:, i, k] += accelerations[:, i] * inertias[i, k]

    def motor_accelerations(self, links: FloatArray) -> FloatArray:
        """Motor motion of a link motion behind rigid gears, (C N)^-1 q: (..., n_joints)."""
        if self.coupling is None:
            return np.asarray(links / self.gear_ratios)
        return np.asarray(links @ self._inverse_transmission.T)

    def link_velocity_limits(self, motors: FloatArray) -> FloatArray:
        """Link speeds [rad/s] up to which no motor exceeds its limit in `motors` (n_joints,)."""
        links = motors * np.abs(self.gear_ratios)
        if not self.is_coupled:
            return np.asarray(links)
        fastest = np.abs(np.linalg.inv(self.transmission)) @ links
        return np.asarray(links * np.min(motors / fastest))

    def links_of_rigid(self, motor_share: float | FloatArray = 0.0) -> FloatArray:
        """Link parameters that have given base parameters: (n_links, n_body).

        `motor_share` is the share of the motors in inertias that rigid motion does not separate.
        """
        return self.base.particular(motor_share)[: len(self.base.links)]

    def motors_of_rigid(self, motor_share: float | FloatArray) -> FloatArray:
        """Motor inertias that have given base parameters: (n_joints, n_body)."""
        return self.base.particular(motor_share)[len(self.base.links) :]

    def inertia_matrix(self, base: FloatArray, angle: FloatArray) -> FloatArray:
        """M(q) of the links, (3): (n_joints, n_joints) [kg m^2]."""
        return np.asarray(self.inertia_matrices(base, angle[None])[0])

    def inertia_matrices(self, base: FloatArray, angles: FloatArray) -> FloatArray:
        """M(q) at several link angles (n_postures, n_joints): (n_postures, n_joints, n_joints)."""
        return self.core.inertia_matrix(*_contiguous(base, angles))

    def link_inertias(self, base: FloatArray) -> FloatArray:
        """m_L of each joint, the diagonal of M(0): (n_joints,) [kg m^2]."""
        return np.diagonal(self.inertia_matrix(base, np.zeros(self.n_joints))).copy()

    def holding_voltage(self, values: Values, motor_angle: tuple[float, ...]) -> tuple[float, ...]:
        """Voltage [V] of each joint that balances gravity at the motor angles [rad].

        Raises InvalidInput if a parameter is missing or impossible.
        """
        rest = np.zeros((1, self.n_joints))
        angle = self.links_of(np.array([motor_angle]))
        vector = self.parameter_vector(values)
        try:
            torque = self.core.inverse_dynamics(vector, angle, rest, rest)[0]
        except ValueError as error:
            raise InvalidInput(
                str(error), where="--parameters", remedy="correct that value"
            ) from error
        return tuple((torque / self.torque_per_volt).tolist())

    def inverse_dynamics(
        self, vector: FloatArray, angle: FloatArray, velocity: FloatArray, acceleration: FloatArray
    ) -> FloatArray:
        """Motor torques of a motion with rigid gears, (5), friction included.

        `vector` is the result of `parameter_vector`.
        """
        return self.core.inverse_dynamics(vector, *_contiguous(angle, velocity, acceleration))

    def max_time_step(self, values: Values) -> float:
        """Longest time step [s] of the integrator that resolves the fastest gear resonance.

        `MAX_TIME_STEP` if no resonance needs a shorter step.
        """
        fastest = self.fastest_resonance(values)
        return min(MAX_TIME_STEP, 1.0 / (_STEPS_PER_PERIOD * fastest)) if fastest else MAX_TIME_STEP

    def fastest_resonance(self, values: Values) -> float:
        """Highest undamped natural frequency [Hz] of motors and links with the stiffest slopes.

            det(K - w^2 M) = 0

        M contains the links, folded or stretched, and the motors, seen from the links. Zero if the
        values do not determine the frequency.
        """
        postures = np.zeros((2, self.n_joints))
        postures[0, 1:] = np.pi
        gears = self._gear_equations(values, postures)
        if gears is None:
            return 0.0
        squared = np.linalg.eigvals(np.linalg.solve(gears.inertia, gears.stiffness)).real
        return float(np.sqrt(squared.max(initial=0.0)) / (2.0 * np.pi))

    def stable_time_step(self, values: Values, angles: FloatArray) -> float:
        """Longest time step [s] for which the integrator is stable at the link angles.

        `angles` (n_postures, n_joints) [rad]. Infinite if the values do not determine it, or if no
        gear is elastic.
        """
        gears = self._gear_equations(values, angles)
        if gears is None:
            return np.inf
        n = len(gears.stiffness)
        rates = np.zeros((len(angles), 2 * n, 2 * n))
        rates[:, :n, n:] = np.eye(n)
        of_motion = np.hstack([gears.stiffness, gears.damping])
        rates[:, n:] = -np.linalg.solve(gears.inertia, of_motion)
        fastest = float(np.abs(np.linalg.eigvals(rates)).max(initial=0.0))
        return _STABLE_STEP / fastest if fastest else np.inf

    def _gear_equations(self, values: Values, angles: FloatArray) -> _GearEquations | None:
        """Equations of small motions about link angles; None if the values do not determine them.

        Coordinates are the links and the outputs of elastic gears. Rigid gears connect motors to
        links.
        """
        known, n = complete_values(values, self), self.n_joints
        stiffness, damping = np.zeros(n), np.zeros(n)
        try:
            for i, joint in enumerate(self.joints, start=1):
                if joint.elastic:
                    stiffness[i - 1] = joint.law.stiffness_range(joint.law.of_joint(known, i))[1]
                    damping[i - 1] = known.get(("gear_damping", i), 0.0)
            by_links = self.motor_accelerations(np.eye(n))
            motors = np.diag([known["motor_inertia", i + 1] for i in range(n)])
            base = [
                known.get(key, 0.0) if _is_zero_by_default(key) else known[key]
                for key in self.base_names
            ]
        except KeyError:
            return None
        outputs = np.eye(n)[:, self.is_elastic]
        of_motors = by_links @ motors @ by_links.T
        # torsion and output of each gear over links and outputs of elastic gears
        torsion = np.hstack([-np.diag(self.is_elastic.astype(float)), outputs])
        output = np.hstack([np.diag((~self.is_elastic).astype(float)), outputs])
        inertia = np.tile(output.T @ of_motors @ output, (len(angles), 1, 1))
        inertia[:, :n, :n] += self.inertia_matrices(np.array(base), angles)
        if (np.linalg.eigvalsh(inertia) <= 0.0).any():
            return None  # an impossible arm: the core reports the fault
        of_gears = ((torsion.T * k) @ torsion for k in (stiffness, damping))
        return _GearEquations(inertia, *of_gears)


class _GearEquations(NamedTuple):
    """Matrices of M q'' + D q' + K q = 0, (n, n)."""

    inertia: FloatArray  # (n_postures, n, n)
    stiffness: FloatArray
    damping: FloatArray


def _core_effects(joint: Joint) -> list[str]:
    effects = map(effect_named, joint.named_effects)
    known = (
        e.core_name
        for e in effects
        if joint.elastic or not (e.needs_elastic_gear and e.name in OF_RIGID_JOINTS)
    )
    return list(dict.fromkeys(name for name in known if name is not None))


def _contiguous(*motion: FloatArray) -> Iterator[FloatArray]:
    """Arrays as the core reads them."""
    return map(np.ascontiguousarray, motion)


def _constant(values: list[Any]) -> FloatArray:
    """A read-only array."""
    array = np.array(values)
    array.setflags(write=False)
    return array


def _is_zero_by_default(key: Key) -> bool:
    return key[0] in _ZERO_BY_DEFAULT or family_of(key[0]) == "gravity"


@contextmanager
def core_errors() -> Iterator[None]:
    """Convert errors of the core into InvalidInput and NumericalFailure."""
    try:
        yield
    except ValueError as error:
        raise InvalidInput(str(error), remedy="check the parameters and the study") from error
    except FloatingPointError as error:
        raise NumericalFailure(str(error)) from error
