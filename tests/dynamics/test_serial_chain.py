"""Serial chains compared with MuJoCo, and the names of their parameters."""

from typing import Any

import numpy as np
import pytest

from serial_chains import (
    GRAVITY,
    MOTOR,
    SAMPLES,
    Array,
    Joint,
    assert_close,
    chain,
    parameters_of,
    random_body,
    random_joints,
    rotation,
)

mujoco = pytest.importorskip("mujoco")

PAIRS = [(0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)]
FORCES, TURNING, RATES = (
    [f"{name}_{axis}" for axis in "xyz"]
    for name in ("specific_force", "angular_acceleration", "angular_rate")
)
PRODUCTS = [f"rate_product_{'xyz'[i]}{'xyz'[j]}" for i, j in PAIRS]


def in_plane(axis: Array) -> tuple[Array, Array]:
    """The two directions perpendicular to an axis in which a link's sensors are given."""
    x = np.array([1.0, 0.0, 0.0]) - axis[0] * axis
    x /= np.linalg.norm(x)
    return x, np.cross(axis, x)


def mujoco_chain(joints: list[Joint], bodies: list[dict[str, Any]], distance: float) -> Any:
    """The same chain for MuJoCo with two accelerometers and a gyro on each link."""
    spec = mujoco.MjSpec()
    spec.compiler.balanceinertia = False
    spec.option.gravity = GRAVITY
    parent = spec.worldbody
    for i, ((kind, position, rpy, axis), body) in enumerate(zip(joints, bodies, strict=True)):
        quaternion = np.empty(4)
        mujoco.mju_mat2Quat(quaternion, rotation(rpy).ravel())
        link = parent.add_body(name=f"link{i}", pos=position, quat=quaternion)
        link.explicitinertial = True
        link.mass, link.ipos = body["mass"], body["centre"]
        inertia = body["inertia"]
        link.fullinertia = [
            inertia[j, k] for j, k in [(0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)]
        ]
        unit = np.array(axis) / np.linalg.norm(axis)
        slides = kind == "prismatic"
        joint_type = mujoco.mjtJoint.mjJNT_SLIDE if slides else mujoco.mjtJoint.mjJNT_HINGE
        link.add_joint(name=f"joint{i}", type=joint_type, axis=unit)
        link.add_site(name=f"origin{i}")
        link.add_site(name=f"sensor{i}", pos=[0, 0, 0] if slides else distance * in_plane(unit)[0])
        for name, sensor in [
            (f"origin{i}", mujoco.mjtSensor.mjSENS_ACCELEROMETER),
            (f"sensor{i}", mujoco.mjtSensor.mjSENS_ACCELEROMETER),
            (f"origin{i}", mujoco.mjtSensor.mjSENS_GYRO),
        ]:
            spec.add_sensor(type=sensor, objtype=mujoco.mjtObj.mjOBJ_SITE, objname=name)
        parent = link
    return spec


@pytest.mark.parametrize("types", ["r", "p", "rr", "rp", "rpr", "rrrrrr", "rrprpr"])
def test_dynamics_match_mujoco(types: str) -> None:
    rng = np.random.default_rng(len(types))
    n = len(types)
    joints = random_joints(rng, n, types)
    bodies = [random_body(rng) for _ in range(n)]
    arm = chain(joints)
    base = np.concatenate([parameters_of(body) for body in bodies])
    parameters = np.concatenate([base, MOTOR * n])
    q, dq, ddq = rng.uniform(-2.0, 2.0, (3, SAMPLES, n))
    model = mujoco_chain(joints, bodies, 0.3).compile()
    data = mujoco.MjData(model)
    inertia, bias, torque = (
        np.empty((SAMPLES, n, n)),
        np.empty((SAMPLES, n)),
        np.empty((SAMPLES, n)),
    )
    gravity = np.empty((SAMPLES, n))
    for k in range(SAMPLES):
        data.qpos, data.qvel, data.qacc = q[k], 0.0, 0.0
        mujoco.mj_inverse(model, data)
        gravity[k] = data.qfrc_inverse
        data.qvel, data.qacc = dq[k], ddq[k]
        mujoco.mj_inverse(model, data)
        torque[k], bias[k] = data.qfrc_inverse, data.qfrc_bias
        mujoco.mj_fullM(model, data, inertia[k])
    assert_close(arm.inertia_matrix(base, q), inertia)
    assert_close(arm.bias_torques(parameters, q, dq), bias)
    assert_close(arm.bias_torques(parameters, q, 0 * dq), gravity)
    regressor = arm.base_regressor(q, dq, ddq)
    assert regressor.shape == (SAMPLES, n, 10 * n)
    assert_close(regressor @ base, torque)


def test_sensors_match_mujoco() -> None:
    rng = np.random.default_rng(3)
    types = "rrpr"
    n, distance = len(types), 0.3
    joints = random_joints(rng, n, types)
    bodies = [random_body(rng) for _ in range(n)]
    arm = chain(joints, accelerometer_distance=[distance] * n)
    parameters = np.concatenate([parameters_of(body) for body in bodies] + [MOTOR] * n)
    motion = ["link_angle", "link_velocity", "link_acceleration"]
    experiment = arm.experiment(
        rng.uniform(-5.0, 5.0, (10, n)),
        motor_angle=rng.uniform(-20.0, 20.0, n).tolist(),
        link_velocity=rng.uniform(-1.0, 1.0, n).tolist(),
        step=1e-4,
        steps_per_tick=10,
        steps_per_sample=10,
        samples=10,
        record=[*motion, "accelerometer", "gyro", *FORCES, *TURNING, *PRODUCTS, *RATES],
    )
    (record,) = arm.simulate(parameters[None], [experiment])
    model = mujoco_chain(joints, bodies, distance).compile()
    data = mujoco.MjData(model)
    for k in range(10):
        data.qpos, data.qvel, data.qacc = (record[name][k] for name in motion)
        mujoco.mj_inverse(model, data)
        readings = data.sensordata.reshape(n, 3, 3)
        for i, (kind, _, _, axis) in enumerate(joints):
            unit = np.array(axis) / np.linalg.norm(axis)
            x, y = in_plane(unit)
            at_origin, at_sensor, rate = readings[i]
            across = unit if kind == "prismatic" else y
            expected = [across @ at_sensor, unit @ rate]
            products = [rate[j] * rate[m] for j, m in PAIRS]
            names = ["accelerometer", "gyro", *FORCES, *PRODUCTS, *RATES]
            simulated = [record[name][k, i] for name in names]
            np.testing.assert_allclose(
                simulated, [*expected, *at_origin, *products, *rate], rtol=1e-10, atol=1e-9
            )
            # the other accelerometer determines the part of the angular acceleration across x
            place = np.zeros(3) if kind == "prismatic" else distance * x
            turning = np.array([record[name][k, i] for name in TURNING])
            reading = at_origin + np.cross(turning, place) + np.cross(rate, np.cross(rate, place))
            np.testing.assert_allclose(reading, at_sensor, rtol=1e-10, atol=1e-9)


MATRIX = [[1.0, 0.0, 0.4], [-0.3, 1.0, 0.0], [0.2, -0.5, 0.8]]
"""A transmission between the last motors and joints of a chain."""


@pytest.mark.parametrize("types", ["rpr", "rrpr", "prrrp", "rrrrrr", "rrprprr"])
def test_elastic_motion_matches_mujoco(types: str) -> None:
    """With a transmission and ratios of both signs, MuJoCo's tendons are the same gears."""
    n = len(types)
    rng = np.random.default_rng([n, 4])
    joints = random_joints(rng, n, types)
    bodies = [random_body(rng) for _ in range(n)]
    ratio = rng.uniform(0.01, 0.03, n) * np.where(np.arange(n) % 2, -1.0, 1.0)
    transmission = np.eye(n)
    transmission[-3:, -3:] = MATRIX
    inertia, viscous, link_viscous, stiffness, damping = 1.5e-4, 3e-4, 0.4, 1.5e4, 12.0
    drive = [inertia, viscous, 0.0, 0.0, link_viscous, stiffness, damping, 0.0]
    motor_angle = rng.uniform(-20.0, 20.0, n)
    link_angle = transmission @ (ratio * motor_angle) + rng.uniform(-1e-3, 1e-3, n)
    ticks, steps, step = 40, 8, 1.25e-4
    torque = rng.uniform(-1.0, 1.0, (ticks, n))
    arm = chain(joints, gear_ratio=ratio, transmission=transmission.tolist())
    experiment = arm.experiment(
        torque,
        motor_angle=motor_angle.tolist(),
        link_angle=link_angle.tolist(),
        step=step,
        steps_per_tick=steps,
        steps_per_sample=steps,
        samples=ticks,
        record=["motor_angle", "link_angle", "motor_velocity", "torsion", "gear_torque"],
    )
    parameters = np.concatenate([parameters_of(body) for body in bodies] + [drive] * n)
    (record,) = arm.simulate(parameters[None], [experiment])
    spec = mujoco_chain(joints, bodies, 0.3)
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_RK4
    spec.option.timestep = step
    for i in range(n):
        spec.joint(f"joint{i}").damping = [link_viscous, 0.0, 0.0]
        rotor = spec.worldbody.add_body(name=f"rotor{i}", mass=1.0, inertia=[inertia] * 3)
        rotor.explicitinertial = True
        rotor.add_joint(name=f"motor{i}", axis=[0, 0, 1], damping=[viscous, 0.0, 0.0])
    for i in range(n):
        gear = spec.add_tendon(
            stiffness=[stiffness, 0.0, 0.0], damping=[damping, 0.0, 0.0], springlength=[0.0, 0.0]
        )
        gear.wrap_joint(f"joint{i}", -1.0)
        for j in range(n):
            if transmission[i, j]:
                gear.wrap_joint(f"motor{j}", transmission[i, j] * ratio[j])
    model = spec.compile()
    data = mujoco.MjData(model)
    links, motors = (
        [model.joint(f"{name}{i}").id for i in range(n)] for name in ("joint", "motor")
    )
    data.qpos[links], data.qpos[motors] = link_angle, motor_angle
    for k in range(ticks):
        torsion = transmission @ (ratio * data.qpos[motors]) - data.qpos[links]
        for name, expected, size in [
            ("motor_angle", data.qpos[motors], 20.0),
            ("link_angle", data.qpos[links], 1.0),
            ("motor_velocity", data.qvel[motors], 50.0),
            ("torsion", torsion, 1.0),
        ]:
            # rounding, amplified in some 300 steps
            np.testing.assert_allclose(record[name][k], expected, atol=1e-10 * size)
        data.qfrc_applied[motors] = torque[k]
        mujoco.mj_step(model, data, nstep=steps)


def test_parameters_are_ten_per_link_then_those_of_joints() -> None:
    arm = chain([("revolute", [0.0] * 3, [0.0] * 3, [0.0, 0.0, 1.0])] * 2)
    names = arm.parameter_names
    assert [name for name, _ in names[:10]] == [
        "link_mass",
        "link_first_moment_x",
        "link_first_moment_y",
        "link_first_moment_z",
        "link_inertia_xx",
        "link_inertia_xy",
        "link_inertia_yy",
        "link_inertia_xz",
        "link_inertia_yz",
        "link_inertia_zz",
    ]
    assert [joint for _, joint in names] == [1] * 10 + [2] * 10 + [1] * 8 + [2] * 8
    assert names[20] == ("motor_inertia", 1)


def test_invalid_chains_are_rejected() -> None:
    joint = ("revolute", [0.0] * 3, [0.0] * 3, [0.0, 0.0, 1.0])
    with pytest.raises(ValueError, match="a chain has 1 to 7 joints, got 8"):
        chain([joint] * 8)
    with pytest.raises(ValueError, match="the axis of joint 2 has no direction"):
        chain([joint, ("revolute", [0.0] * 3, [0.0] * 3, [0.0] * 3)])
    with pytest.raises(ValueError, match='no joint of type "helical"'):
        chain([("helical", *joint[1:])])
    with pytest.raises(ValueError, match=r"must be square, with .* and not singular"):
        chain([joint] * 2, transmission=[[1.0, 2.0], [2.0, 4.0]])
    with pytest.raises(ValueError, match="transmission matrix must be square"):
        chain([joint] * 2, transmission=[[1.0, 2.0, 0.0], [2.0, 4.0, 1.0]])
    with pytest.raises(ValueError, match="couples joints 1 and 2, of which one has a rigid gear"):
        chain([joint] * 2, springs=["linear", "rigid"], transmission=[[1.0, 0.5], [0.0, 1.0]])
    with pytest.raises(ValueError, match="the gear ratio of joint 2 is zero"):
        chain([joint] * 2, gear_ratio=[0.01, 0.0])
    body = [1.0, 0.1, 0.0, 0.0, 0.02, 0.0, 0.03, 0.0, 0.0, 0.03]
    still = np.zeros((1, 1))
    for place, value, message in [
        (0, 0.0, "link_mass of joint 1 is 0, but must be positive"),
        (9, -0.03, "must be such that the inertia matrix is positive definite in every posture"),
    ]:
        values = [*body]
        values[place] = value
        with pytest.raises(ValueError, match=message):
            chain([joint]).bias_torques(np.array(values + MOTOR), still, still)
