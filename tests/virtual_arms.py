"""Arms with known parameters, and logs and signals of their motions."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from strainwave.domain import Experiment, FloatArray, Joint, Log, Signals, Study
from strainwave.domain.arm.kinds import change_arm_keys, single_joint
from strainwave.domain.keys import Values
from strainwave.dynamics import excitation, simulation
from strainwave.dynamics.arm import Arm
from strainwave.virtual import scara

MOTION = Experiment("motion", "motion.csv", "motion", ("servo", "servo"))
DRIVE = Experiment("drive", "drive.csv", "motion", ("servo",))
CLOCK = 1e-3
ELASTIC_JOINT: Values = {
    ("motor_inertia", 1): 1.5e-4,
    ("motor_viscous_friction", 1): 2e-4,
    ("motor_coulomb_friction", 1): 0.06,
    ("friction_offset", 1): 0.0,
    ("link_inertia", 1): 2.0,
    ("link_viscous_friction", 1): 0.5,
    ("gear_stiffness", 1): 25000.0,
    ("gear_damping", 1): 20.0,
}
"""One link on a linear gear."""


def rigid_two_link(gravity: float | None = None) -> Study:
    """The built-in rig with rigid gears."""
    study = scara.STIFF.study(Path("nowhere"), "rigid")
    return replace(study, arm=change_arm_keys(study.arm, gravity=gravity))


def rigid_drive(gravity: float | None = None) -> Study:
    """One rigid revolute joint with logged torque."""
    joint = Joint(spring="rigid", gear_ratio=0.5)
    return Study(arm=single_joint(joint, gravity=gravity), experiments=(DRIVE,))


def values_of(study: Study, seed: int) -> Values:
    """Parameters of the built-in rig, each changed by a factor of up to about two."""
    rng = np.random.default_rng(seed)
    spring = study.arm.joints[0].spring
    values = scara.STIFF.parameters(int(rng.integers(0, 6)), spring)
    for (name, joint), value in values.items():
        if joint is not None and name != "friction_offset" and "knee" not in name:
            values[name, joint] = value * float(np.exp(rng.uniform(-0.5, 0.5)))
    for joint in (1, 2):
        offset = 0.05 * values["motor_coulomb_friction", joint] * rng.normal()
        values["friction_offset", joint] = float(offset)
    if study.arm.gravity is not None:
        values["gravity_torque_1", None] = 31.0 * float(rng.uniform(0.7, 1.2))
        values["gravity_torque_2", None] = 9.81 * values["gamma", None] / scara.STIFF.link_length[0]
    return values


def rigid_truth(study: Study, values: Values) -> Values:
    """True parameters of the rigid model."""
    truth = dict(values)
    n = study.arm.joints[0].gear_ratio
    truth["rigid_inertia", 1] = values["alpha", None] + values["motor_inertia", 1] / n**2
    for number, joint in enumerate(study.arm.joints, start=1):
        link = joint.gear_ratio**2 * values["link_viscous_friction", number]
        total = values["motor_viscous_friction", number] + link
        truth["total_viscous_friction", number] = total
    return truth


def motion_log(study: Study, values: Values, seed: int, duration: float = 10.0) -> Log:
    """Log of drive and encoders of a smooth motion of both joints under servos."""
    rng = np.random.default_rng(1000 + seed)
    reference = np.column_stack(
        [
            excitation.smooth_motion(
                duration=duration,
                clock=CLOCK,
                top_hz=1.4,
                excursion=100.0,
                speed=150.0,
                rng=rng,
            )
            for _ in range(2)
        ]
    )
    start, held = (0.0, 0.0), (0.0, 0.0)
    if study.arm.gravity is not None:
        start = (-80.0, 50.0)
        q1, q2 = (n.gear_ratio * q for n, q in zip(study.arm.joints, start, strict=True))
        g2 = values["gravity_torque_2", None] * np.cos(q1 + q2)
        g1 = values["gravity_torque_1", None] * np.cos(q1) + g2
        held = tuple(
            joint.gear_ratio * g / joint.torque_per_command
            for joint, g in zip(study.arm.joints, (g1, g2), strict=True)
        )
    return servoed_log(study, values, reference, start, held)


def servoed_log(
    study: Study,
    values: Values,
    reference: FloatArray,
    start: tuple[float, ...] = (0.0, 0.0),
    held: tuple[float, ...] = (0.0, 0.0),
) -> Log:
    """Log of voltages and encoders of a servoed motion from static motor angles."""
    drive = simulation.Drive(
        tick=CLOCK,
        voltage=np.tile(held, (len(reference), 1)),
        reference=reference,
        servo=(True, True),
        motor_angle=start,
        initial_voltage=held,
    )
    run = simulation.simulate(
        Arm.of(study.arm),
        values,
        drive,
        sample_time=CLOCK,
        samples=len(reference),
        record=["voltage", "encoder"],
    )
    channels = {}
    for i in range(2):
        channels[f"u{i + 1}"] = np.ascontiguousarray(run["voltage"][:, i])
        channels[f"theta_m{i + 1}"] = np.ascontiguousarray(run["encoder"][:, i])
    return Log(MOTION, run.time, CLOCK, channels)


def exact_motion(
    n_joints: int, seed: int, duration: float = 12.0, amplitude: float = 30.0
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Time, motor angle, velocity and acceleration of a multisine, exact and unfiltered."""
    rng = np.random.default_rng(seed)
    time: FloatArray = CLOCK * np.arange(round(duration / CLOCK), dtype=np.float64)
    frequency = 2.0 * np.pi * np.array([0.17, 0.43, 0.71, 1.1])[:, None]
    angle, velocity, acceleration = (np.zeros((len(time), n_joints)) for _ in range(3))
    for i in range(n_joints):
        size = amplitude * rng.uniform(0.5, 1.0, (4, 1)) / np.array([1, 2, 3, 5])[:, None]
        phase = frequency * time + rng.uniform(0.0, 2.0 * np.pi, (4, 1))
        angle[:, i] = np.sum(size * np.sin(phase), axis=0)
        velocity[:, i] = np.sum(size * frequency * np.cos(phase), axis=0)
        acceleration[:, i] = -np.sum(size * frequency**2 * np.sin(phase), axis=0)
    return time, angle, velocity, acceleration


def exact_signals(
    motion: tuple[FloatArray, FloatArray, FloatArray, FloatArray],
    torque: FloatArray,
    direction: FloatArray | None = None,
) -> Signals:
    """Signals without noise and with a certain direction."""
    time, angle, velocity, acceleration = motion
    n_joints = angle.shape[1]
    return Signals(
        experiment=MOTION if n_joints == 2 else DRIVE,
        time=time,
        sample_time=CLOCK,
        motor_torque=torque,
        motor_angle=angle,
        motor_velocity=velocity,
        motor_acceleration=acceleration,
        direction=np.sign(velocity) if direction is None else direction,
        bandwidth_hz=100.0,
        angle_noise=np.zeros(n_joints),
        valid=np.ones(angle.shape, dtype=bool),
        torque_channel=tuple(f"torque{i + 1}" for i in range(n_joints)),
    )
