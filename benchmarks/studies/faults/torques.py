"""Efforts of other meanings, loads and locked joints, by the links that the torques need."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import gaussian_filter1d

from benchmarks.studies.faults.inputs import EFFORTS, Columns, Input
from strainwave.domain import FloatArray, channel_parts
from strainwave.domain.study import Channel, Control, Meaning, Payload
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.link_sensors import JointMotion
from strainwave.input_check.evidence import collect_evidence
from strainwave.input_check.torque_fit import fit_torques, torque_system
from strainwave.io.logs import read_logs

_TRACKING_LAG = 0.01  # [s] of the joints behind their set-point; the desired torque is that early
_SMOOTHING = 0.01  # [s] of the angles, before they are differentiated, and of wind-up torques
_WIND_UP = 0.3  # range [rad] of a motor at a locked output, by the stiffness of its gear
_LOAD_XYZ = (0.0, 0.05, 0.1)  # centre of mass [m] of a load, in the frame of the last link


def stating(given: Input, meaning: Meaning) -> Input:
    """With the meaning of all torques stated."""
    names = given.of_kinds(EFFORTS)
    channels = {name: Channel(name, meaning=meaning) for name in names}
    return replace(given, study=replace(given.study, channels=channels))


def without(given: Input, parts: Sequence[str]) -> Input | None:
    """Efforts without "gravity", or without "friction"; None if the torques fit no links."""
    model = _Model.of(given)
    if model is None:
        return None

    def subtract(model: _Model, motion: JointMotion, table: Columns) -> Columns:
        static, friction = model.gravity(motion), model.friction(motion)
        removed = np.zeros_like(static)
        removed += static if "gravity" in parts else 0.0
        removed += friction if "friction" in parts else 0.0
        return {
            effort: table[effort] - scale * removed[:, i]
            for i, effort, scale in _efforts(given, table)
        }

    return _computed(given, model, subtract)


def desired(given: Input) -> Input | None:
    """Efforts of a feed-forward model: rigid links along the set-point, without friction."""
    model = _Model.of(given)
    if model is None:
        return None

    def compute(model: _Model, motion: JointMotion, table: Columns) -> Columns:
        torques, early = model.inertial(motion), table["t"] + _TRACKING_LAG
        return {
            effort: np.interp(early, table["t"], scale * torques[:, i])
            for i, effort, scale in _efforts(given, table)
        }

    return _computed(given, model, compute)


@dataclass(frozen=True, slots=True)
class _Model:
    """Rigid links, and of each motor its rotor's inertia and friction, fitted to the torques."""

    arm: Arm
    links: FloatArray
    motors: FloatArray  # (n_joints, 4): inertia, Coulomb and viscous friction, offset

    @classmethod
    def of(cls, given: Input) -> _Model | None:
        links, arm = _links(given), Arm.of(given.study.arm)
        if links is None:
            return None
        model = cls(arm, links, np.zeros((arm.n_joints, 4)))
        for name, motion, table in _motions(given):
            if name in given.motions:
                for i, effort, scale in _efforts(given, table):
                    rest = table[effort] / scale - model.inertial(motion)[:, i]
                    columns = _motor_columns(motion, i)
                    model.motors[i] = np.linalg.lstsq(columns, rest, rcond=None)[0]
                break
        return model

    def gravity(self, motion: JointMotion) -> FloatArray:
        """Torques of the motors at rest: (n_samples, n_joints)."""
        rest = np.zeros_like(motion.velocity)
        return self.arm.motors_of(self.arm.link_torques(self.links, motion.angle, rest, rest))

    def inertial(self, motion: JointMotion) -> FloatArray:
        """Torques of the motors without friction: (n_samples, n_joints)."""
        links = self.arm.motors_of(
            self.arm.link_torques(self.links, motion.angle, motion.velocity, motion.acceleration)
        )
        return links + motion.acceleration * self.motors[:, 0]

    def friction(self, motion: JointMotion) -> FloatArray:
        """Torques of friction: (n_samples, n_joints)."""
        return np.column_stack(
            [_motor_columns(motion, i)[:, 1:3] @ row[1:3] for i, row in enumerate(self.motors)]
        )


def _motor_columns(motion: JointMotion, i: int) -> FloatArray:
    rate = motion.velocity[:, i]
    sign = np.tanh(rate / (0.02 * np.abs(rate).max() + 1e-12))
    return np.column_stack([motion.acceleration[:, i], sign, rate, np.ones(len(rate))])


def _computed(
    given: Input, model: _Model, compute: Callable[[_Model, JointMotion, Columns], Columns]
) -> Input:
    tables = {
        name: {**table, **compute(model, motion, table)} for name, motion, table in _motions(given)
    }
    return replace(given, tables=tables)


def loaded(given: Input, record: str) -> tuple[Input, Input] | None:
    """A load on the last link in one record: the input, and the one that states the load.

    Planar arms have no key for a load; the input without the fault then lacks the record.
    """
    links, arm = _links(given), Arm.of(given.study.arm)
    if links is None:
        return None
    stated, load = given.without_records(record), 0.3 * links
    if given.study.arm.kind == "serial":
        total = float(np.abs(links.reshape(arm.n_joints, -1)[:, 0]).sum())
        payload = Payload(max(1.0, 0.1 * total), _LOAD_XYZ)
        load = arm.payload_vector(payload)
        experiments = tuple(
            replace(e, payload=payload) if e.name == record else e for e in given.study.experiments
        )
        stated = replace(given, study=replace(given.study, experiments=experiments))
    tables = dict(given.tables)
    for name, motion, table in _motions(given):
        if name != record:
            continue
        torques = arm.motors_of(
            arm.link_torques(load, motion.angle, motion.velocity, motion.acceleration)
        )
        columns = dict(table)
        for i, effort, scale in _efforts(given, table):
            columns[effort] = table[effort] + scale * torques[:, i]
        tables[record] = columns
    if given.study.arm.kind == "serial":
        stated = replace(stated, tables=tables)
    return replace(given, tables=tables), stated


def locked(given: Input) -> Input:
    """Motors whose links are clamped: they wind up their gears by the logged torque."""

    def clamp(table: Columns) -> Columns:
        columns = {k: v for k, v in table.items() if channel_parts(k)[0] != "ref"}
        for i, effort, _ in _efforts(given, table):
            name, T = f"theta_m{i + 1}", float(np.median(np.diff(table["t"])))
            # the noise of the torque moves no motor
            torque = gaussian_filter1d(table[effort], _SMOOTHING / T)
            torque -= np.mean(torque)
            step = given.study.arm.joints[i].encoder_resolution or 1e-4
            wound = table[name][0] + _WIND_UP * torque / max(float(np.ptp(torque)), 1e-12)
            columns[name] = np.round(wound / step) * step
            if f"omega_m{i + 1}" in columns:
                columns[f"omega_m{i + 1}"] = np.gradient(columns[name], table["t"])
        return columns

    motors = given.motors_only()
    moving = motors.without_records(*(set(motors.tables) - set(motors.motions)))
    study = moving.study
    clamped: list[Control] = ["open"] * study.arm.n_joints
    opened = tuple(replace(e, control=tuple(clamped)) for e in study.experiments)
    return replace(moving, study=replace(study, experiments=opened)).changed(clamp)


def _efforts(given: Input, table: Columns) -> Iterator[tuple[int, str, float]]:
    """Joint from 0, effort channel, and effort per torque of each joint with an effort."""
    for i, joint in enumerate(given.study.arm.joints):
        for effort in given.efforts(i + 1)[:1]:
            if effort in table:
                yield i, effort, 1.0 / joint.torque_per_command if effort[0] == "u" else 1.0


def _motions(given: Input) -> Iterator[tuple[str, JointMotion, Columns]]:
    arm = Arm.of(given.study.arm)
    for name, table in given.tables.items():
        motors = np.column_stack([table[f"theta_m{i + 1}"] for i in range(arm.n_joints)])
        T = float(np.median(np.diff(table["t"])))
        smooth = gaussian_filter1d(motors, _SMOOTHING / T, axis=0)
        yield name, JointMotion.of_motors(smooth, arm, T), table


def _links(given: Input) -> FloatArray | None:
    logs = read_logs(given.study, data=given.tables)
    system = torque_system(collect_evidence(logs, given.study))
    return None if system is None else fit_torques(system).links
