"""The arm with its equations: what follows from a description is worked out here, and once."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import fields
from functools import cached_property
from typing import Any

import numpy as np

from strainwave import _core
from strainwave.domain import ArmDescription, FloatArray, Joint
from strainwave.domain.combinations import (
    lumped_inertias,
    reported,
    rigid_body_columns,
    rigid_columns,
)
from strainwave.domain.effects import RecordEffect, effect_named
from strainwave.domain.kinds import Key, RigidColumn, Row, Values, kind_of
from strainwave.domain.parameters import completed
from strainwave.errors import InvalidInput, NumericalFailure

LONGEST_STEP = 1.25e-4
"""[s] Of the integrator, where no gear resonance asks for shorter ones."""
_STEPS_PER_PERIOD = 120.0
"""Of the fastest gear resonance: there w h = 0.05. The integrator, of fourth order, is then off by
(w h)^4/120 or 6e-8, the sensors' filters, of second, by (w h)^2/12 or 2e-4: a fiftieth of an
accelerometer's usual error of calibration. Records that are to be truths ask for shorter steps."""

_OPTIONAL = ("friction_offset", "friction_settling_time")


class Arm(ArmDescription):
    """An arm as its rig describes it, with its equations of motion (1)-(3), (5)-(7).

    A value: variants are `replace`d or `with_joints`. All arrays have the joints in order from the
    base; motions are those of the links, each relative to the one before it.
    """

    @classmethod
    def of(cls, description: ArmDescription) -> Arm:
        """The arm of a description."""
        return cls(**{f.name: getattr(description, f.name) for f in fields(description)})

    @cached_property
    def core(self) -> _core.Arm:
        """The compiled arm: kind, gears and effects, electronics, sensors."""
        joints = self.joints
        return _core.Arm(
            self.kind,
            [joint.law.core_name for joint in joints],
            [joint.gear_ratio for joint in joints],
            torque_per_volt=self.torque_per_volt.tolist(),
            link_length=self.link_length or 0.0,
            gravity=self.gravity or 0.0,
            current_loop_hz=[joint.current_loop_hz for joint in joints],
            encoder_counts=[joint.encoder_counts for joint in joints],
            accelerometer_distance=[joint.accelerometer_distance or 1.0 for joint in joints],
            accelerometer_hz=[joint.accelerometer_hz for joint in joints],
            gyro_hz=[joint.gyro_hz for joint in joints],
            effects=[_core_effects(joint) for joint in joints],
            **self._imu_bandwidths(),
        )

    def _imu_bandwidths(self) -> dict[str, Any]:
        """What the core needs to know of IMUs' low-passes; nothing where there is no IMU."""
        imus = [joint.imu for joint in self.joints]
        if not any(imus):
            return {}
        return {
            "imu_accelerometer_hz": [imu.accelerometer_hz if imu else None for imu in imus],
            "imu_gyro_hz": [imu.gyro_hz if imu else None for imu in imus],
        }

    @cached_property
    def gear_ratios(self) -> FloatArray:
        """n, link turns per motor turn: (n_joints,)."""
        return _constant([joint.gear_ratio for joint in self.joints])

    @cached_property
    def torque_per_volt(self) -> FloatArray:
        """E [N m/V] at the motors, or one where torque is commanded: (n_joints,)."""
        return _constant([joint.torque_per_volt or 1.0 for joint in self.joints])

    @cached_property
    def parameter_names(self) -> tuple[Key, ...]:
        """Parameters of a simulated arm, in the core's order."""
        return tuple(self.core.parameter_names)

    @cached_property
    def base_names(self) -> tuple[Key, ...]:
        """Those in which the links' inverse dynamics are linear, in the core's order."""
        still = np.zeros((1, self.n_joints))
        return self.parameter_names[: self.core.base_regressor(still, still, still).shape[2]]

    @cached_property
    def rigid_columns(self) -> tuple[RigidColumn, ...]:
        """The rigid model's unknowns: inertias, gravity, then friction joint by joint."""
        return rigid_columns(self)

    @cached_property
    def n_body(self) -> int:
        """How many of `rigid_columns` are not friction; they come first."""
        return len(rigid_body_columns(self))

    @cached_property
    def reported(self) -> Mapping[Key, Row]:
        """Combinations of parameters that results report, as rows over the parameters."""
        return reported(self)

    @cached_property
    def lumped_inertias(self) -> Mapping[Key, Row]:
        """Inertias that rigid motion does not separate into motor and link, as rows."""
        return lumped_inertias(self)

    def link_inertia(self, joint: int) -> Row:
        """m_L of a joint, from 1, the arm stretched, as a row over the parameters: (3)."""
        return kind_of(self).link_inertia(joint)

    def parameter_vector(self, values: Values) -> FloatArray:
        """Values by name as the core takes them.

        `values`: (name, joint) -> value. Returns (n_parameters,): In the order of
        `parameter_names`. Raises `InvalidInput`: A parameter the arm needs is not there.
        """
        known = self._effects_by_default | completed(values, self)
        missing = [key for key in self.parameter_names if key not in known and not _optional(key)]
        if missing:
            listed = ", ".join(
                f"{name} of joint {joint}" if joint else name for name, joint in missing
            )
            raise InvalidInput(
                f"the parameters lack {listed}",
                where="--parameters",
                remedy="give every parameter of docs/notation.md that this arm has",
            )
        return np.array([known.get(key, 0.0) for key in self.parameter_names])

    @property
    def _effects_by_default(self) -> Values:
        """Parameters of effects that values need not have, and of those of single records."""
        found: Values = {}
        for number, joint in enumerate(self.joints, start=1):
            for effect in map(effect_named, joint.named_effects):
                needs = effect.needs if isinstance(effect, RecordEffect) else effect.defaults
                found |= {(name, number): value for name, value in needs.items()}
        return found

    def base_regressor(
        self, angle: FloatArray, velocity: FloatArray, acceleration: FloatArray
    ) -> FloatArray:
        """The links' torques per base parameter: (S2).

        `angle`, `velocity`, `acceleration` (n_samples, n_joints) [rad, rad/s, rad/s^2]. Returns
        (n_samples, n_joints, n_base): Columns as in `base_names`.
        """
        motion = (np.ascontiguousarray(x) for x in (angle, velocity, acceleration))
        return self.core.base_regressor(*motion)

    def link_torques(
        self,
        base: FloatArray,
        angle: FloatArray,
        velocity: FloatArray,
        acceleration: FloatArray,
    ) -> FloatArray:
        """The links' torques, M(q) ddq + c(q, dq) + g(q).

        `base` (n_base,). `angle`, `velocity`, `acceleration` (n_samples, n_joints) [rad, rad/s,
        rad/s^2]. Returns (n_samples, n_joints) [N m].
        """
        rows = self.base_regressor(angle, velocity, acceleration)
        return np.asarray((rows.reshape(-1, len(base)) @ base).reshape(rows.shape[:2]))

    def rigid_regressor(
        self, angle: FloatArray, velocity: FloatArray, acceleration: FloatArray
    ) -> FloatArray:
        """Motor torques per inertia and gravity torque of the rigid model: (5), (S2), (S3).

        The core's regressor, brought to the motors; a motor's own inertia adds a column, unless
        it is part of a link's.

        `angle`, `velocity`, `acceleration` (n_samples, n_joints) [rad, rad/s, rad/s^2]. Returns
        (n_samples, n_joints, n_body): Columns as in `rigid_columns`, friction left out.
        """
        base = self.base_regressor(angle, velocity, acceleration)
        phi = np.zeros((*angle.shape, self.n_body))
        for k, column in enumerate(self.rigid_columns[: self.n_body]):
            key = next(iter(column.parts))
            if key in self.base_names:
                phi[:, :, k] = self.gear_ratios * base[:, :, self.base_names.index(key)]
            elif key[1] is not None:
                i = key[1] - 1
                phi[:, i, k] = acceleration[:, i] / self.gear_ratios[i]
        return phi

    def base_of_rigid(self, motor_share: float = 0.0) -> FloatArray:
        """How base parameters follow from the rigid model's unknowns: (n_base, n_body).

        `motor_share`: What motors have of the inertias that rigid motion does not separate from the
        links'. Returns (n_base, n_body).
        """
        rows = np.zeros((len(self.base_names), self.n_body))
        for k, column in enumerate(self.rigid_columns[: self.n_body]):
            share = motor_share if column.motor else 0.0
            for key, weight in column.parts.items():
                if key in self.base_names:
                    rows[self.base_names.index(key), k] = (1.0 - share) / weight
        return rows

    def motors_of_rigid(self, motor_share: float) -> FloatArray:
        """How motors' inertias follow from the rigid model's unknowns: (n_joints, n_body).

        `motor_share`: As of `base_of_rigid`; an unknown that is a motor's inertia alone is all the
        motor's. Returns (n_joints, n_body).
        """
        rows = np.zeros((self.n_joints, self.n_body))
        for k, column in enumerate(self.rigid_columns[: self.n_body]):
            if column.motor is not None:
                joint, weight = column.motor
                rows[joint - 1, k] = (motor_share if len(column.parts) > 1 else 1.0) / weight
        return rows

    def inertia_matrix(self, base: FloatArray, angle: FloatArray) -> FloatArray:
        """M(q) of the links, (3), out of the core's regressor.

        Column k is the torques of a unit acceleration of joint k, less those of gravity.

        `base` (n_base,). `angle` (n_joints,) [rad]. Returns (n_joints, n_joints) [kg m^2].
        """
        unit = np.eye(self.n_joints)
        at, still = np.tile(angle, (self.n_joints, 1)), np.zeros_like(unit)
        torque = self.link_torques(base, at, still, unit)
        return np.asarray(torque - self.link_torques(base, at, still, still)).T

    def torques_of_accelerations(
        self, base: FloatArray, angle: FloatArray, acceleration: FloatArray
    ) -> FloatArray:
        """What each joint's acceleration alone takes at every link: M_ij(q) ddq_j.

        `base` (n_base,). `angle`, `acceleration` (n_samples, n_joints) [rad, rad/s^2]. Returns
        (n_samples, n_joints, n_joints) [N m]: By link, and by the joint that accelerates.
        """
        weightless = np.where(self._pulled, 0.0, base)
        still = np.zeros_like(angle)
        found = np.empty((*angle.shape, self.n_joints))
        for j in range(self.n_joints):
            alone = still.copy()
            alone[:, j] = acceleration[:, j]
            found[:, :, j] = self.link_torques(weightless, angle, still, alone)
        return found

    def link_inertias(self, base: FloatArray) -> FloatArray:
        """m_L of each joint, the arm stretched: the diagonal of M(0).

        `base` (n_base,). Returns (n_joints,) [kg m^2].
        """
        return np.diagonal(self.inertia_matrix(base, np.zeros(self.n_joints))).copy()

    @cached_property
    def _pulled(self) -> tuple[bool, ...]:
        """Of each base parameter, whether it is gravity's."""
        return tuple(name.startswith("gravity") for name, _ in self.base_names)

    def holding_voltage(self, values: Values, motor_angle: tuple[float, ...]) -> tuple[float, ...]:
        """What keeps the arm up where it stands: gravity's torque over the torque per volt.

        `values`: (name, joint) -> value. `motor_angle` (n_joints,) [rad]. Returns (n_joints,) [V].
        Raises `InvalidInput`: A parameter is missing or impossible.
        """
        still = np.zeros((1, self.n_joints))
        angle = np.array([motor_angle]) * self.gear_ratios
        vector = self.parameter_vector(values)
        try:
            holding = self.core.inverse_dynamics(vector, angle, still, still)[0]
        except ValueError as error:
            raise InvalidInput(
                str(error), where="--parameters", remedy="mend that value"
            ) from error
        return tuple((holding / self.torque_per_volt).tolist())

    def inverse_dynamics(
        self,
        vector: FloatArray,
        angle: FloatArray,
        velocity: FloatArray,
        acceleration: FloatArray,
    ) -> FloatArray:
        """Motor torques of a motion behind rigid gears, (5), friction included.

        `vector` (n_parameters,): From `parameter_vector`. `angle`, `velocity`, `acceleration`
        (n_samples, n_joints) [rad, rad/s, rad/s^2]. Returns (n_samples, n_joints) [N m].
        """
        motion = (np.ascontiguousarray(x) for x in (angle, velocity, acceleration))
        return self.core.inverse_dynamics(vector, *motion)

    def longest_step(self, values: Values) -> float:
        """The integrator's longest step that the fastest gear resonance allows.

        `values`: (name, joint) -> value. Returns [s]: `LONGEST_STEP` where no resonance asks for
        less.
        """
        fastest = self.fastest_resonance(values)
        return min(LONGEST_STEP, 1.0 / (_STEPS_PER_PERIOD * fastest)) if fastest else LONGEST_STEP

    def fastest_resonance(self, values: Values) -> float:
        """The highest undamped natural frequency of motors and links on their stiffest springs.

        det(K - w^2 M) = 0 with M of the links, folded or stretched, and of the motors, J/n^2.

        `values`: (name, joint) -> value. Returns [Hz]: Zero where the values do not give it.
        """
        known, n = completed(values, self), self.n_joints
        numbers = range(1, n + 1)
        if not all(joint.elastic for joint in self.joints):
            return 0.0
        try:
            own = [joint.law.of_joint(known, i) for i, joint in enumerate(self.joints, start=1)]
            pairs = zip(self.joints, own, strict=True)
            k = np.diag([joint.law.stiffness_range(values)[1] for joint, values in pairs])
            motor = np.diag([known["motor_inertia", i] for i in numbers] / self.gear_ratios**2)
            base = [
                0.0 if pulled else known[key]
                for key, pulled in zip(self.base_names, self._pulled, strict=True)
            ]
        except KeyError:
            return 0.0
        stiffness, fastest = np.block([[k, -k], [-k, k]]), 0.0
        for bend in (np.pi, 0.0):
            angle = np.full(n, bend)
            angle[0] = 0.0
            link = self.inertia_matrix(np.array(base), angle)
            inertia = np.block([[link, np.zeros((n, n))], [np.zeros((n, n)), motor]])
            try:
                root = np.linalg.inv(np.linalg.cholesky(inertia))
            except np.linalg.LinAlgError:
                return 0.0  # an impossible arm: the core says what is wrong with it
            squared = float(np.linalg.eigvalsh(root @ stiffness @ root.T)[-1])
            fastest = max(fastest, float(np.sqrt(max(squared, 0.0)) / (2.0 * np.pi)))
        return fastest


def _core_effects(joint: Joint) -> list[str]:
    """The core's names of those of a joint's effects that it has, each once."""
    known = (effect_named(name).core_name for name in joint.named_effects)
    return list(dict.fromkeys(name for name in known if name is not None))


def _constant(values: list[float]) -> FloatArray:
    """An array that nobody changes."""
    array = np.array(values)
    array.setflags(write=False)
    return array


def _optional(key: Key) -> bool:
    """Whether a parameter is zero where it is not given."""
    return key[0] in _OPTIONAL or key[0].startswith("gravity_torque_")


@contextmanager
def core_errors() -> Iterator[None]:
    """The core's complaints as this package's errors."""
    try:
        yield
    except ValueError as error:
        raise InvalidInput(str(error), remedy="check the parameters and the study") from error
    except FloatingPointError as error:
        raise NumericalFailure(str(error)) from error
