"""PRBS records of the virtual rig with elastic gears, and their true motion."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from strainwave.domain import Experiment, FloatArray, Log, Parameter, Prbs, RigidModel, Study
from strainwave.domain.arm.kinds import change_arm_keys
from strainwave.domain.keys import Values
from strainwave.dynamics import excitation, simulation
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.simulation import Drive, SensorNoise, Trajectory
from strainwave.virtual import scara

SAMPLE = 2.5e-4
PRBS = Prbs(order=10, clock=1e-3, periods=3, amplitude=10.0)


def rig(gravity: float | None = None, *, counts: float | None = 8192.0) -> Study:
    study = scara.STIFF.study(Path("nowhere"), "linear")
    joints = tuple(replace(joint, encoder_counts=counts) for joint in study.arm.joints)
    return replace(study, arm=change_arm_keys(study.arm.with_joints(joints), gravity=gravity))


def rig_values(study: Study) -> Values:
    values = scara.STIFF.parameters(5, "linear")
    if study.arm.gravity is not None:
        values["gravity_torque_1", None] = 60.0
        values["gravity_torque_2", None] = 9.81 * values["gamma", None] / scara.STIFF.link_length[0]
    return values


def prbs_run(
    study: Study, joint: int = 1, *, both: bool = False, values: Values | None = None
) -> Trajectory:
    """Open-loop PRBS on one joint, or on both with a shift of a third of the sequence."""
    values = values or rig_values(study)
    sequence = excitation.prbs(PRBS)
    voltage = np.zeros((len(sequence), 2))
    voltage[:, joint - 1] = sequence
    if both:
        voltage[:, 2 - joint] = np.roll(sequence, 341)
    drive = Drive(1e-3, voltage, np.zeros_like(voltage), (False, False), (0.0, 0.0), (0.0, 0.0))
    return simulation.simulate(
        Arm.of(study.arm),
        values,
        drive,
        sample_time=SAMPLE,
        samples=round(len(sequence) * 1e-3 / SAMPLE),
        record=[
            "voltage",
            "motor_torque",
            "encoder",
            "accelerometer",
            "motor_velocity",
            "link_angle",
            "link_velocity",
            "link_acceleration",
            "gear_torque",
        ],
    )


def log_of(run: Trajectory, joint: int = 1, seed: int | None = None) -> Log:
    """Log of a run with ideal sensors, or with bias and noise of a seed."""
    noise = None if seed is None else SensorNoise()
    measured = simulation.measure(run, noise, np.random.default_rng(seed))
    channels: dict[str, FloatArray] = {}
    for i in range(2):
        channels[f"u{i + 1}"] = measured["voltage"][:, i]
        channels[f"theta_m{i + 1}"] = measured["encoder"][:, i]
        channels[f"a{i + 1}"] = measured["accelerometer"][:, i]
    experiment = Experiment("prbs", "prbs.csv", "frequency", ("open", "open"), joint, PRBS)
    return Log(experiment, run.time, SAMPLE, channels)


def true_model(study: Study, values: Values) -> RigidModel:
    """Rigid model with the true parameters."""
    n = [joint.gear_ratio for joint in study.arm.joints]
    truth = dict(values)
    truth["rigid_inertia", 1] = values["alpha", None] + values["motor_inertia", 1] / n[0] ** 2
    for joint in (1, 2):
        truth["total_viscous_friction", joint] = (
            values["motor_viscous_friction", joint]
            + n[joint - 1] ** 2 * values["link_viscous_friction", joint]
        )
    parameters = tuple(
        Parameter(c.name, c.joint, truth[c.name, c.joint], 0.0, c.unit, "rigid")
        for c in Arm.of(study.arm).rigid_columns
    )
    return RigidModel(
        parameters=parameters,
        solution=np.array([p.value for p in parameters], dtype=float),
        covariance=np.zeros((len(parameters), len(parameters))),
        condition_number=1.0,
        fit_percent={},
        bandwidth_hz=10.0,
        decimation=1,
        n_rows=1,
        status="determined",
    )
