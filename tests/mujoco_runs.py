"""Exported arms in MuJoCo under the voltages of a simulation."""

from __future__ import annotations

from types import ModuleType

import numpy as np

import exports
from strainwave.domain import FloatArray, Prbs, Study
from strainwave.domain.arm.link_sensors.link_space import Quantity
from strainwave.domain.keys import Values
from strainwave.dynamics import excitation
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.simulation import Drive, simulate
from strainwave.export.linear_models import coordinates_of
from strainwave.export.mjcf import to_mjcf

TICK = 1e-3
RECORDED: list[Quantity] = ["motor_velocity", "link_velocity", "link_angle"]


def drive(study: Study, amplitude: float, seconds: float = 0.4) -> Drive:
    """Pseudo-random voltages on all joints, from standstill."""
    samples = round(seconds / TICK)
    sequence = excitation.prbs(Prbs(10, TICK, 1, amplitude))
    shifted = [np.roll(sequence, 341 * i)[:samples] for i in range(study.arm.n_joints)]
    voltage = np.column_stack(shifted)
    still = (0.0,) * study.arm.n_joints
    off = (False,) * study.arm.n_joints
    # MuJoCo starts with untwisted gears at zero link angles
    return Drive(
        TICK, voltage, 0.0 * voltage, off, still, still, link_angle=still, link_velocity=still
    )


def in_mujoco(
    mujoco: ModuleType, study: Study, values: Values, applied: Drive
) -> dict[Quantity, FloatArray]:
    """Velocities and angles of the exported arm in MuJoCo under the same voltages."""
    arm = exports.arm_of(study, values)
    model = mujoco.MjModel.from_xml_string(to_mjcf(arm).data.decode())
    data = mujoco.MjData(model)
    numbers = range(1, study.arm.n_joints + 1)
    links = [data.joint(f"joint{i}") for i in numbers]
    coordinates = coordinates_of(study.arm)
    motors = [data.joint(f"motor_joint{i}") for i in coordinates.elastic]
    found: dict[Quantity, list[FloatArray]] = {name: [] for name in RECORDED}
    for voltage in applied.voltage:
        velocities = [each.qvel[0] for each in (*motors, *links)]
        found["motor_velocity"].append(coordinates.motor_angles @ velocities)
        found["link_velocity"].append(np.array([link.qvel[0] for link in links]))
        found["link_angle"].append(np.array([link.qpos[0] for link in links]))
        data.ctrl[:] = voltage
        mujoco.mj_step(model, data, round(TICK / model.opt.timestep))
    return {name: np.array(rows) for name, rows in found.items()}


def largest_difference(
    mujoco: ModuleType,
    study: Study,
    values: Values,
    amplitude: float,
    exported: Values | None = None,
) -> float:
    """Largest relative difference (root mean square) over all quantities and joints.

    The file has the values `exported`, if not those of the simulation.
    """
    applied = drive(study, amplitude)
    ours = simulate(
        Arm.of(study.arm),
        values,
        applied,
        sample_time=TICK,
        samples=len(applied.voltage),
        record=RECORDED,
    )
    theirs = in_mujoco(mujoco, study, exported or values, applied)
    off = [
        np.linalg.norm(theirs[name] - ours[name], axis=0) / np.linalg.norm(ours[name], axis=0)
        for name in RECORDED
    ]
    return float(np.max(off))


def frictionless(values: Values) -> Values:
    return {
        (name, joint): 0.0 if name == "motor_coulomb_friction" else value
        for (name, joint), value in values.items()
    }
