"""Records of a rigid chain with and without a load, by d'Alembert's principle.

tau_i = sum over bodies of m (a - g) . dv/d(dq_i) + (I dw + w x I w) . dw/d(dq_i)
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from serial_chains import rotation
from strainwave.domain import ArmDescription, Experiment, FloatArray, Joint, Origin, Study

SAMPLE_TIME = 2e-3
DURATION = 10.0  # [s]
GRAVITY = (0.0, 0.0, -9.81)
TURNED = (-0.5 * np.pi, 0.0, 0.0)
RATIO = 0.02
# of each motor: inertia, viscous and Coulomb friction, offset
MOTORS = ((2e-4, 1e-3, 0.05, 0.004), (2e-4, 1e-3, 0.05, -0.004), (1e-4, 5e-4, 0.02, 0.0))
BODIES = ((4.0, (0.0, 0.02, -0.05)), (5.0, (0.18, 0.01, 0.04)), (2.0, (0.1, -0.02, 0.03)))
NOISE = 0.02  # of the torques, relative to Coulomb friction


@dataclass(frozen=True)
class Load:
    """A body on the last link."""

    mass: float
    xyz: tuple[float, float, float] = (0.0, 0.0, 0.0)
    moments: tuple[float, float, float] = (0.0, 0.0, 0.0)  # about the centre


LOAD = Load(1.2, (0.05, 0.03, 0.11), (2e-3, 3e-3, 1.5e-3))


def arm(gravity: tuple[float, float, float] | None = GRAVITY, **joint: Any) -> ArmDescription:
    """A vertical axis, and two horizontal axes that are not parallel."""
    origins = (
        Origin((0.0, 0.0, 0.3)),
        Origin((0.06, 0.0, 0.1), TURNED),
        Origin((0.4, 0.0, -0.05), (0.3, 0.5, 0.1)),
    )
    joints = tuple(replace(Joint("rigid", RATIO, origin=origin), **joint) for origin in origins)
    return ArmDescription("serial", joints, gravity)


def study(folder: Path, *names: str, **changes: Any) -> Study:
    """A study whose motion records are passed in memory."""
    control = ("servo", "servo", "servo")
    records = tuple(Experiment(name, "", "motion", control) for name in names)  # type: ignore[arg-type]
    given = Study(arm=arm(), experiments=records, path=folder / "study.toml")
    return replace(given, **changes)


@dataclass(frozen=True)
class Motion:
    """sums of sines."""

    seed: int = 0
    size: float = 1.0
    duration: float = DURATION
    frequencies: tuple[float, ...] = (0.1, 0.2, 0.3, 0.5, 0.7)  # [Hz]
    moving: tuple[bool, bool, bool] = (True, True, True)

    def angles(self) -> tuple[FloatArray, list[FloatArray]]:
        """Time, and angle, velocity, acceleration of the links (n_samples, 3)."""
        rng = np.random.default_rng(self.seed)
        n = round(self.duration / SAMPLE_TIME)
        time = SAMPLE_TIME * np.arange(n, dtype=np.float64)
        w = 2.0 * np.pi * np.array(self.frequencies)
        phase = w * time[:, None]
        a, b = self.size * rng.normal(size=(2, len(w), 3)) / (1.0 + 2.0 * w[:, None]) * 1.2
        q = np.sin(phase) @ a + np.cos(phase) @ b
        dq = (w * np.cos(phase)) @ a - (w * np.sin(phase)) @ b
        ddq = -(w**2 * np.sin(phase)) @ a - (w**2 * np.cos(phase)) @ b
        return time, [x * self.moving for x in (q, dq, ddq)]


def moments_of(mass: float) -> tuple[float, float, float]:
    """Moments of inertia of a link about its centre."""
    return (mass * 0.007, mass * 0.008, mass * 0.005)


def link_torques(
    described: ArmDescription,
    bodies: list[list[Load]],
    q: FloatArray,
    dq: FloatArray,
    ddq: FloatArray,
) -> FloatArray:
    """Torques of the links, (n_samples, n_joints), of bodies on each link of a revolute chain."""
    torques = np.zeros(q.shape)
    R, p = np.tile(np.eye(3), (len(q), 1, 1)), np.zeros((len(q), 3))
    w, dw, a = (np.zeros((len(q), 3)) for _ in range(3))
    gravity = np.array(described.gravity or (0.0, 0.0, 0.0))
    axes, origins = [], []
    for i, joint in enumerate(described.joints):
        arm_to_joint = R @ np.array(joint.origin.xyz)
        a = a + np.cross(dw, arm_to_joint) + np.cross(w, np.cross(w, arm_to_joint))
        p = p + arm_to_joint
        R = R @ rotation(list(joint.origin.rpy))
        axis = R @ (np.array(joint.axis) / np.linalg.norm(joint.axis))
        dw = dw + axis * ddq[:, [i]] + np.cross(w, axis * dq[:, [i]])
        w = w + axis * dq[:, [i]]
        K = np.array([[0, -1, 0], [1, 0, 0], [0, 0, 0]], dtype=float)  # about z
        s, c = np.sin(q[:, i])[:, None, None], np.cos(q[:, i])[:, None, None]
        R = R @ (np.eye(3) + s * K + (1.0 - c) * K @ K)
        axes.append(axis)
        origins.append(p)
        for body in bodies[i]:
            centre = R @ np.array(body.xyz)
            force = a + np.cross(dw, centre) + np.cross(w, np.cross(w, centre)) - gravity
            inertia = R @ np.diag(body.moments) @ R.mT
            of_w, of_dw = ((inertia @ x[:, :, None])[:, :, 0] for x in (w, dw))
            moment = of_dw + np.cross(w, of_w)
            for j in range(i + 1):
                arm_of_force = np.cross(axes[j], p + centre - origins[j])
                torques[:, j] += np.sum(body.mass * force * arm_of_force + moment * axes[j], axis=1)
    return torques


def record(
    load: Load | None = None,
    motion: Motion = Motion(),
    *,
    described: ArmDescription | None = None,
    noise_seed: int = 0,
    noise: float = NOISE,
    links: Sequence[tuple[float, tuple[float, float, float]]] = BODIES,
) -> dict[str, FloatArray]:
    """Motor angles and torques of a motion, with noise and encoders of 8192 counts.

    `links` has mass and centre of each link.
    """
    described = described or arm()
    bodies = [[Load(mass, xyz, moments_of(mass))] for mass, xyz in links[: described.n_joints]]
    bodies[-1] += [load] if load else []
    rng = np.random.default_rng(noise_seed)
    time, whole = motion.angles()
    q, dq, ddq = (x[:, : described.n_joints] for x in whole)
    carried = link_torques(described, bodies, q, dq, ddq)
    columns = {"t": time}
    for i, joint in enumerate(described.joints):
        n, (inertia, viscous, coulomb, offset) = joint.gear_ratio, MOTORS[i]
        velocity = dq[:, i] / n
        torque = n * carried[:, i] + inertia * ddq[:, i] / n + viscous * velocity + offset
        torque += coulomb * np.tanh(velocity / 0.05)
        count = 2.0 * np.pi / 8192
        columns[f"theta_m{i + 1}"] = count * np.round(q[:, i] / n / count)
        size = coulomb * noise
        columns[f"torque{i + 1}"] = torque + size * rng.normal(size=len(time))
    return columns
