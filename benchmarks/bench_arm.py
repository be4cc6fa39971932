"""One step of the two-link arm with three-slope gears, against C, SciPy and MuJoCo.

All integrate the built-in arm, 10 V PRBS on joint 1, at 0.125 ms. The C loop has the same equations
and Runge-Kutta's method, with friction by the sign of the velocity: no sticking, no events.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import tempfile
from pathlib import Path

import numpy as np

from benchmarks.timing import Row, best_of
from strainwave import excitation, scara
from strainwave.records import FloatArray, Prbs
from strainwave.simulation import build_arm, parameter_vector

STEP = 1.25e-4
SECONDS = 1.023
STEPS = round(SECONDS / STEP)


def rows() -> list[Row]:
    single = _ours(arms=1)
    batch = _ours(arms=256)
    c_single, c_batch = _c_peer()
    few, many = _followed(15), _followed(25)
    return [
        Row("a step of one arm", single, "C, gcc -O3 -march=native -ffast-math", c_single),
        Row("a step of one arm", single, "SciPy solve_ivp RK45, rtol 1e-6", _scipy()),
        Row("a step of one arm", single, "MuJoCo, RK4", _mujoco()),
        Row("a step with 15 derivatives", few, "15 more simulations", 16.0 * single),
        Row("a step with 25 derivatives", many, "25 more simulations", 26.0 * single),
        Row(
            f"a step of an arm in a batch, {_cores()} cores",
            batch,
            "C, 16 side by side, 1 core",
            c_batch,
        ),
    ]


def _cores() -> int:
    return os.cpu_count() or 1


def _voltage() -> FloatArray:
    one = excitation.prbs(Prbs(10, 1e-3, 1, 10.0))
    return np.column_stack([np.append(one, 0.0), np.zeros(len(one) + 1)])


def _ours(arms: int) -> float:
    study = scara.study(Path())
    arm = build_arm(study)
    one = parameter_vector(arm, scara.parameters(), study)
    rng = np.random.default_rng(0)
    many = one * (1.0 + 0.05 * rng.standard_normal((arms, len(one))) * (arms > 1))
    voltage = _voltage()

    def run() -> None:
        arm.simulate(
            many,
            voltage,
            motor_angle=(0.0, 0.0),
            step=STEP,
            steps_per_tick=8,
            steps_per_sample=8,
            samples=STEPS // 8,
            record=["motor_velocity"],
        )

    return best_of(run) / (STEPS * arms)


def _followed(directions: int) -> float:
    study = scara.study(Path())
    arm = build_arm(study)
    values = parameter_vector(arm, scara.parameters(), study)
    names = [name for name in arm.parameter_names if not name[0].startswith("gravity")]
    voltage = _voltage()

    def run() -> None:
        arm.sensitivities(
            values,
            voltage,
            with_respect_to=names[:directions],
            motor_angle=(0.0, 0.0),
            step=STEP,
            steps_per_tick=8,
            steps_per_sample=8,
            samples=STEPS // 8,
            record=["motor_velocity"],
        )

    return best_of(run) / STEPS


def _c_peer() -> tuple[float | None, float | None]:
    """Compile and run the C loop; its two lines end in "N ns a step" and "N each"."""
    compiler = shutil.which("gcc")
    if compiler is None:
        return None, None
    source = Path(__file__).with_name("arm_peer.c")
    with tempfile.TemporaryDirectory() as folder:
        program = Path(folder) / "arm_peer"
        flags = ["-O3", "-march=native", "-ffast-math", "-fopenmp-simd"]
        subprocess.run([compiler, *flags, str(source), "-lm", "-o", str(program)], check=True)
        printed = subprocess.run([str(program)], check=True, capture_output=True, text=True).stdout
    single = re.search(r"([\d.]+) ns a step\n", printed)
    each = re.search(r"([\d.]+) each", printed)
    return (1e-9 * float(single[1]) if single else None, 1e-9 * float(each[1]) if each else None)


def _scipy() -> float:
    from scipy.integrate import solve_ivp

    values = scara.parameters(spring="linear")
    p = {name: value for (name, joint), value in values.items() if joint is None}
    joint = [{name: v for (name, j), v in values.items() if j == i} for i in (1, 2)]
    voltage = _voltage()
    n, e = 0.01, (0.08, 0.03)

    def field(t: float, x: FloatArray) -> list[float]:
        motor, link, torque = [], [], []
        u = voltage[int(t * 1000)]
        for i, j in enumerate(joint):
            transmitted = j["gear_stiffness"] * (n * x[i] - x[4 + i])
            transmitted += j["gear_damping"] * (n * x[2 + i] - x[6 + i])
            friction = j["motor_viscous_friction"] * x[2 + i]
            friction += j["motor_coulomb_friction"] * np.tanh(x[2 + i] / 0.1)
            motor.append((x[8 + i] - friction - n * transmitted) / j["motor_inertia"])
            link.append(transmitted - j["link_viscous_friction"] * x[6 + i])
            torque.append((e[i] * u[i] - x[8 + i]) * 2.0 * np.pi * 1000.0)
        s, c = np.sin(x[5]), np.cos(x[5])
        link[0] += p["gamma"] * s * x[7] * (2.0 * x[6] + x[7])
        link[1] -= p["gamma"] * s * x[6] ** 2
        m12, m22 = p["beta"] + p["gamma"] * c, p["beta"]
        m11 = p["alpha"] + m12 + p["gamma"] * c
        scale = 1.0 / (m11 * m22 - m12**2)
        a1, a2 = (m22 * link[0] - m12 * link[1]) * scale, (m11 * link[1] - m12 * link[0]) * scale
        return [x[2], x[3], *motor, x[6], x[7], a1, a2, *torque]

    # A tenth of the record is enough to tell: the work grows in proportion.
    part = 0.1
    time = best_of(lambda: solve_ivp(field, (0.0, part), np.zeros(10), rtol=1e-6), repeats=2)
    return time / (part / STEP)


_MJCF = """
<mujoco>
  <option timestep="{step}" integrator="RK4" gravity="0 0 0"/>
  <worldbody>
    <body><joint name="m1" axis="0 0 1" armature="1.5e-4" damping="2e-4" frictionloss="0.06"/>
      <inertial pos="0 0 0" mass="1e-3" diaginertia="1e-9 1e-9 1e-9"/></body>
    <body><joint name="m2" axis="0 0 1" armature="0.5e-4" damping="0.8e-4" frictionloss="0.03"/>
      <inertial pos="0 0 0" mass="1e-3" diaginertia="1e-9 1e-9 1e-9"/></body>
    <body><joint name="l1" axis="0 0 1" damping="0.5"/>
      <inertial pos="0.22 0 0" mass="8" diaginertia="0.12 0.12 0.12"/>
      <body pos="0.35 0 0"><joint name="l2" axis="0 0 1" damping="0.15"/>
        <inertial pos="0.25 0 0" mass="9" diaginertia="0.08 0.08 0.08"/></body></body>
  </worldbody>
  <tendon>
    <fixed stiffness="25000" damping="20">
      <joint joint="m1" coef="0.01"/><joint joint="l1" coef="-1"/></fixed>
    <fixed stiffness="6100" damping="4">
      <joint joint="m2" coef="0.01"/><joint joint="l2" coef="-1"/></fixed>
  </tendon>
  <actuator><motor joint="m1" gear="0.08"/><motor joint="m2" gear="0.03"/></actuator>
</mujoco>
"""


def _mujoco() -> float | None:
    try:
        import mujoco
    except ImportError:
        return None
    model = mujoco.MjModel.from_xml_string(_MJCF.format(step=STEP))
    data = mujoco.MjData(model)
    voltage = _voltage()

    def run() -> None:
        mujoco.mj_resetData(model, data)
        for k in range(STEPS):
            if k % 8 == 0:
                data.ctrl[:] = voltage[k // 8]
            mujoco.mj_step(model, data)

    return best_of(run, repeats=3) / STEPS
