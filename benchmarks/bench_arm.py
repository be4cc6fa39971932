"""One step of the two-link arm with three-slope gears, against C, SciPy and MuJoCo.

All integrate the built-in arm under a 10 V PRBS on joint 1 at 0.125 ms. The C loop has the same
equations and the same Runge-Kutta method; its friction follows the sign of the velocity, without
stiction and events.
"""

from __future__ import annotations

import math
import shutil
import subprocess
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.timing import Row, best_of
from strainwave.domain import FloatArray, Parameter, Prbs
from strainwave.dynamics import excitation
from strainwave.dynamics.arm import Arm
from strainwave.export.mjcf import to_mjcf
from strainwave.export.source import IdentifiedArm
from strainwave.virtual import scara

STEP = 1.25e-4  # [s]
SECONDS = 1.023
STEPS = round(SECONDS / STEP)


def rows() -> list[Row]:
    single, few, many = _time_step(), _time_derivatives(15), _time_derivatives(25)
    return [
        Row("a step of one arm", single, "C, gcc, best of its flags", _c_peer()),
        Row("a step of one arm", single, "SciPy solve_ivp RK45, rtol 1e-6", _scipy()),
        Row("a step of one arm", single, "MuJoCo, RK4", _mujoco()),
        Row("a step with 15 derivatives", few, "15 more simulations", 16.0 * single),
        Row("a step with 25 derivatives", many, "25 more simulations", 26.0 * single),
    ]


def _voltage() -> FloatArray:
    period = excitation.prbs(Prbs(10, 1e-3, 1, 10.0))
    return np.column_stack([np.append(period, 0.0), np.zeros(len(period) + 1)])


def _time_step() -> float:
    rig = Arm.of(scara.STIFF.study(Path()).arm)
    values = rig.parameter_vector(scara.STIFF.parameters())[None, :]
    experiment = rig.core.experiment(**_experiment())
    return best_of(lambda: rig.core.simulate(values, [experiment])) / STEPS


def _time_derivatives(count: int) -> float:
    rig = Arm.of(scara.STIFF.study(Path()).arm)
    values = rig.parameter_vector(scara.STIFF.parameters())
    names = [name for name in rig.parameter_names if not name[0].startswith("gravity")][:count]
    experiment = rig.core.experiment(**_experiment())
    return best_of(lambda: rig.core.sensitivities(values, experiment, names)) / STEPS


def _experiment() -> dict[str, Any]:
    return {
        "voltage": _voltage(),
        "motor_angle": (0.0, 0.0),
        "step": STEP,
        "steps_per_tick": 8,
        "steps_per_sample": 8,
        "samples": STEPS // 8,
        "record": ["motor_velocity"],
    }


_FLAGS = (
    "-O3 -march=native -ffast-math",
    "-O3 -march=native -ffast-math -fno-ipa-sra",
    "-O2 -march=native -ffast-math -fno-ipa-sra",
)
"""The fastest of these depends on the compiler."""

_C_RUNS = 40
"""Runs of 7 x 1 ms per set of flags; other processes disturb most runs of a busy machine."""


def _c_peer() -> float | None:
    """Time of a step of the C loop [s]."""
    compiler = shutil.which("gcc")
    if compiler is None:
        return None
    source = Path(__file__).with_name("arm_peer.c")
    times = []
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "arm_values.h").write_text(_c_values())
        program = str(Path(folder) / "arm_peer")
        for flags in _FLAGS:
            build = [compiler, *flags.split(), "-I", folder, str(source), "-lm", "-o", program]
            subprocess.run(build, check=True)
            for _ in range(_C_RUNS):  # of as many steps as ours
                command = [program, str(STEPS)]
                run = subprocess.run(command, check=True, capture_output=True, text=True)
                times.append(1e-9 * float(run.stdout))
    return min(times)


def _c_values() -> str:
    """The built-in arm's parameters as the C loop's constants; knees by their torsion."""
    values, joints = scara.STIFF.parameters(), scara.STIFF.study(Path()).arm.joints

    def pair(name: str) -> list[float]:
        return [values[name, joint] for joint in (1, 2)]

    slopes = [pair(f"gear_stiffness_k{k}") for k in (1, 2, 3)]
    (first, second) = (pair("gear_knee_t1"), pair("gear_knee_t2"))
    lower = [t / k for t, k in zip(first, slopes[0], strict=True)]
    upper = [
        x + (t2 - t1) / k for x, t1, t2, k in zip(lower, first, second, slopes[1], strict=True)
    ]
    entries = {
        "n": [joint.gear_ratio for joint in joints],
        "mobility": [1.0 / m for m in pair("motor_inertia")],
        "d_m": pair("motor_viscous_friction"),
        "f": pair("motor_coulomb_friction"),
        "d_l": pair("link_viscous_friction"),
        "d_g": pair("gear_damping"),
        "k": [list(column) for column in zip(*slopes, strict=True)],
        "knee": [list(column) for column in zip(lower, upper, strict=True)],
    }
    arm = [f".{name} = {values[name, None]!r}" for name in ("alpha", "beta", "gamma")]
    arm += [f".{name} = {_braced(value)}" for name, value in entries.items()]
    torque = [10.0 * joint.torque_per_command for joint in joints]
    return (
        f"static const Arm ARM = {{{', '.join(arm)}}};\n"
        f"static const double TORQUE[2] = {_braced(torque)};\n"
    )


def _braced(value: object) -> str:
    return repr(value).replace("[", "{").replace("]", "}")


def _scipy() -> float:
    """The same arm; friction is regularised, because SciPy has no set-valued friction."""
    from scipy.integrate import solve_ivp

    values, joints = scara.STIFF.parameters(), scara.STIFF.study(Path()).arm.joints
    p = {name: value for (name, joint), value in values.items() if joint is None}
    joint = [{name: v for (name, j), v in values.items() if j == i} for i in (1, 2)]
    voltage = _voltage()
    n, e = [j.gear_ratio for j in joints], [j.torque_per_command for j in joints]
    loop = [2.0 * np.pi * (j.current_loop_hz or np.inf) for j in joints]

    def transmitted(j: dict[str, float], torsion: float) -> float:
        k1, k2, k3 = (j[f"gear_stiffness_k{k}"] for k in (1, 2, 3))
        first = j["gear_knee_t1"] / k1
        second = first + (j["gear_knee_t2"] - j["gear_knee_t1"]) / k2
        x = abs(torsion)
        size = k1 * x + (k2 - k1) * max(x - first, 0.0) + (k3 - k2) * max(x - second, 0.0)
        return math.copysign(size, torsion)

    def field(t: float, x: FloatArray) -> list[float]:
        motor, link, torque = [], [], []
        u = voltage[int(t * 1000)]
        for i, j in enumerate(joint):
            gear = transmitted(j, n[i] * x[i] - x[4 + i])
            gear += j["gear_damping"] * (n[i] * x[2 + i] - x[6 + i])
            friction = j["motor_viscous_friction"] * x[2 + i]
            friction += j["motor_coulomb_friction"] * math.tanh(x[2 + i] / 0.1)
            motor.append((x[8 + i] - friction - n[i] * gear) / j["motor_inertia"])
            link.append(gear - j["link_viscous_friction"] * x[6 + i])
            torque.append((e[i] * u[i] - x[8 + i]) * loop[i])
        s, c = math.sin(x[5]), math.cos(x[5])
        link[0] += p["gamma"] * s * x[7] * (2.0 * x[6] + x[7])
        link[1] -= p["gamma"] * s * x[6] ** 2
        m12, m22 = p["beta"] + p["gamma"] * c, p["beta"]
        m11 = p["alpha"] + m12 + p["gamma"] * c
        scale = 1.0 / (m11 * m22 - m12**2)
        a1, a2 = (m22 * link[0] - m12 * link[1]) * scale, (m11 * link[1] - m12 * link[0]) * scale
        return [x[2], x[3], *motor, x[6], x[7], a1, a2, *torque]

    # A tenth of the record suffices, because the work is proportional to its length.
    part = 0.1
    time = best_of(lambda: solve_ivp(field, (0.0, part), np.zeros(10), rtol=1e-6), repeats=2)
    return time / (part / STEP)


def _mujoco() -> float | None:
    """The same arm as `export` writes it: three slopes, current loop, friction by constraint."""
    try:
        import mujoco
    except ImportError:
        return None
    parameters = tuple(
        Parameter(name, joint, value, 0.0, "1", "tuned")
        for (name, joint), value in scara.STIFF.parameters().items()
    )
    arm = IdentifiedArm(scara.STIFF.study(Path()), parameters, "truth")
    model = mujoco.MjModel.from_xml_string(to_mjcf(arm).data.decode())
    model.opt.timestep = STEP
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_RK4
    data = mujoco.MjData(model)
    voltage = _voltage()

    def run() -> None:
        mujoco.mj_resetData(model, data)
        for k in range(STEPS):
            if k % 8 == 0:
                data.ctrl[:] = voltage[k // 8]
            mujoco.mj_step(model, data)

    return best_of(run, repeats=3) / STEPS
