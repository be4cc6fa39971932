"""Whole-arm fits by other tools, on the records and from the start that ours has.

Linear gears, joints in open loop. A peer gets what a good engineer would give it: voltages through
the current loop exactly, both sides of a comparison through one zero-phase low-pass, every channel
over its noise, robust residuals, logarithms of the parameters.
"""

from __future__ import annotations

import ctypes
import subprocess
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import least_squares
from scipy.signal import butter, lfilter, sosfiltfilt

from strainwave.domain import FloatArray, Log, Parameter, Study
from strainwave.domain.parameters import Values
from strainwave.export.mjcf import to_mjcf
from strainwave.export.source import IdentifiedArm

NAMES = ("alpha", "beta", "gamma")
JOINT_NAMES = (
    "motor_inertia",
    "motor_viscous_friction",
    "motor_coulomb_friction",
    "link_viscous_friction",
    "gear_damping",
    "gear_stiffness",
)
KEYS: tuple[tuple[str, int | None], ...] = (
    *((name, None) for name in NAMES),
    *((name, joint) for joint in (1, 2) for name in JOINT_NAMES),
)
NOISE = np.array([0.5, 0.5, 0.1, 0.1])  # [rad/s], [m/s^2]: what a row may be off
SUBSTEPS = 2  # of a sample of 0.25 ms
CORNER = 0.05  # [rad/s] over which regularised friction changes its sign
EDGE = 0.05  # [s] of a record's ends, where the low-pass still rings
ROW = 8  # samples


@dataclass(frozen=True)
class Problem:
    """Records of an arm, where to start, and the bandwidth in which rows are compared."""

    study: Study
    logs: Sequence[Log]
    start: Values
    bandwidth_hz: float

    @cached_property
    def measured(self) -> list[FloatArray]:
        """(n_rows, 4) of each record: motor velocities and accelerations, behind the low-pass."""
        return [self.rows(_measured(log), log) for log in self.logs]

    def rows(self, samples: FloatArray, log: Log) -> FloatArray:
        """Low-pass, ends off, every eighth, mean off for a sensor's bias: (n_rows, k)."""
        sos = butter(3, self.bandwidth_hz, fs=1.0 / log.sample_time, output="sos")
        slow = sosfiltfilt(sos, samples, axis=0)
        edge = round(EDGE / log.sample_time)
        kept: FloatArray = slow[edge : len(slow) - edge : ROW]
        return np.asarray(kept - kept.mean(axis=0))

    def sensed(self, samples: FloatArray, log: Log) -> FloatArray:
        """Accelerations, the last half of columns of a group of four, as the sensors give them."""
        found = samples.copy()
        for i, joint in enumerate(self.study.arm.joints):
            b, a = butter(2, joint.accelerometer_hz or 300.0, fs=1.0 / log.sample_time)
            found[..., 2 + i] = lfilter(b, a, samples[..., 2 + i], axis=0)
        return found

    def torques(self, log: Log) -> FloatArray:
        """Motor torques at the begin, middle and end of every substep: (n, substeps, 3, 2)."""
        h = log.sample_time / SUBSTEPS
        e = np.array([joint.torque_per_volt or 1.0 for joint in self.study.arm.joints])
        w = 2.0 * np.pi * np.array([j.current_loop_hz or np.inf for j in self.study.arm.joints])
        goal = np.column_stack([log.channels["u1"], log.channels["u2"]]) * e
        found, now = np.empty((len(goal), SUBSTEPS, 3, 2)), np.zeros(2)
        for k, wanted in enumerate(goal):
            for s in range(SUBSTEPS):
                for part, share in enumerate((0.0, 0.5, 1.0)):
                    found[k, s, part] = wanted + (now - wanted) * np.exp(-w * h * share)
                now = found[k, s, 2]
        return found


def _measured(log: Log) -> FloatArray:
    angle = np.column_stack([log.channels["theta_m1"], log.channels["theta_m2"]])
    velocity = np.gradient(angle, log.sample_time, axis=0)
    return np.column_stack([velocity, log.channels["a1"], log.channels["a2"]])


def casadi(problem: Problem, run: Callable[..., None]) -> Values:
    """SciPy's optimiser on C that CasADi generates: the step and its derivatives, looped in C.

    `run` is what `generated` gives, once for an arm.
    """
    studied = len(KEYS)
    start = np.array([problem.start[key] for key in KEYS])
    torques = [np.ascontiguousarray(problem.torques(log)) for log in problem.logs]

    def simulated(z: FloatArray) -> tuple[FloatArray, FloatArray]:
        p = start * np.exp(z)
        residuals, slopes = [], []
        for log, tau, measured in zip(problem.logs, torques, problem.measured, strict=True):
            samples = np.empty((len(tau), 4, 1 + studied))
            run(len(tau), tau.ctypes.data, p.ctypes.data, samples.ctypes.data)
            sensed = problem.sensed(samples.transpose(0, 2, 1), log)
            rows = problem.rows(sensed.reshape(len(tau), -1), log).reshape(-1, 1 + studied, 4)
            residuals.append((rows[:, 0] - measured) / NOISE)
            slopes.append((rows[:, 1:] / NOISE).transpose(0, 2, 1) * p)
        return (
            np.concatenate(residuals).ravel(),
            np.concatenate([s.reshape(-1, studied) for s in slopes]),
        )

    last: dict[str, Any] = {}

    def both(z: FloatArray) -> tuple[FloatArray, FloatArray]:
        if "z" not in last or not np.array_equal(last["z"], z):
            last.update(z=z.copy(), found=simulated(z))
        found: tuple[FloatArray, FloatArray] = last["found"]
        return found

    solved = least_squares(
        lambda z: both(z)[0],
        np.zeros(studied),
        lambda z: both(z)[1],
        loss="soft_l1",
        x_scale="jac",
        ftol=1e-6,
    )
    return dict(zip(KEYS, (start * np.exp(solved.x)).tolist(), strict=True))


def generated(study: Study) -> Callable[..., None]:
    """void run(n, torques, parameters, samples): compiled from CasADi's C."""
    import casadi as ca

    step = _step(study)
    folder = Path(tempfile.mkdtemp(prefix="strainwave-casadi-"))
    generator = ca.CodeGenerator("arm_sample.c", {"casadi_int": "long long int"})
    generator.add(step)
    generator.generate(str(folder) + "/")
    sizes = step.sz_arg(), step.sz_res(), step.sz_iw(), step.sz_w()
    k = 1 + len(KEYS)
    (folder / "run.c").write_text(
        f"""
#include <string.h>
#include "arm_sample.c"
void run(long long n, const double *tau, const double *p, double *out) {{
  static _Thread_local double X[8 * {k}], Y[8 * {k}], w[{sizes[3] or 1}];
  long long iw[{sizes[2] or 1}];
  const double *arg[{sizes[0]}];
  double *res[{sizes[1]}];
  memset(X, 0, sizeof X);
  for (long long i = 0; i < n; i++) {{
    arg[0] = X, arg[1] = tau + {SUBSTEPS * 6} * i, arg[2] = p;
    res[0] = Y, res[1] = out + {4 * k} * i;
    arm_sample(arg, res, iw, w, 0);
    memcpy(X, Y, sizeof X);
  }}
}}
"""
    )
    library = folder / "run.so"
    flags = ["-O3", "-march=native", "-ffast-math", "-shared", "-fPIC", "-Wl,-Bsymbolic"]
    build = ["gcc", *flags, str(folder / "run.c"), "-lm", "-o", str(library)]
    subprocess.run(build, check=True)
    run = ctypes.CDLL(str(library)).run
    run.argtypes = [ctypes.c_longlong, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_void_p]
    run.restype = None
    compiled: Callable[..., None] = run
    return compiled


def _step(study: Study) -> Any:
    """(X, torques, p) -> (X after a sample, Y before it); columns: value and derivatives."""
    import casadi as ca

    n = [joint.gear_ratio for joint in study.arm.joints]
    reach = [joint.accelerometer_distance or 1.0 for joint in study.arm.joints]
    l1 = study.arm.link_length or 0.0
    p, x = ca.SX.sym("p", len(KEYS)), ca.SX.sym("x", 8)
    tau = ca.SX.sym("tau", SUBSTEPS * 6)
    alpha, beta, gamma = p[0], p[1], p[2]
    joint = [
        dict(zip(JOINT_NAMES, ca.vertsplit(p[3 + 6 * i : 9 + 6 * i]), strict=True)) for i in (0, 1)
    ]

    def field(x: Any, torque: Any) -> Any:
        motor, link = [], []
        for i, own in enumerate(joint):
            gear = own["gear_stiffness"] * (n[i] * x[i] - x[4 + i])
            gear += own["gear_damping"] * (n[i] * x[2 + i] - x[6 + i])
            friction = own["motor_viscous_friction"] * x[2 + i]
            friction += own["motor_coulomb_friction"] * ca.tanh(x[2 + i] / CORNER)
            motor.append((torque[i] - friction - n[i] * gear) / own["motor_inertia"])
            link.append(gear - own["link_viscous_friction"] * x[6 + i])
        s, c = ca.sin(x[5]), ca.cos(x[5])
        r1 = link[0] + gamma * s * x[7] * (2.0 * x[6] + x[7])
        r2 = link[1] - gamma * s * x[6] ** 2
        m12 = beta + gamma * c
        m11 = alpha + m12 + gamma * c
        scale = 1.0 / (m11 * beta - m12**2)
        accelerations = (beta * r1 - m12 * r2) * scale, (m11 * r2 - m12 * r1) * scale
        return ca.vertcat(x[2:4], *motor, x[6:8], *accelerations)

    now, h = x, 2.5e-4 / SUBSTEPS
    for s in range(SUBSTEPS):
        begin, middle, end = (tau[6 * s + 2 * k : 6 * s + 2 * k + 2] for k in range(3))
        k1 = field(now, begin)
        k2 = field(now + 0.5 * h * k1, middle)
        k3 = field(now + 0.5 * h * k2, middle)
        k4 = field(now + h * k3, end)
        now = now + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
    rate = field(x, tau[0:2])
    dd1, dd2 = rate[6], rate[7]
    tangential = l1 * (dd1 * ca.cos(x[5]) + x[6] ** 2 * ca.sin(x[5]))
    y = ca.vertcat(x[2:4], reach[0] * dd1, reach[1] * (dd1 + dd2) + tangential)
    # of the state with respect to the parameters, before and after; Y by rows, as NumPy has it
    S = ca.SX.sym("S", 8, len(KEYS))
    after = [ca.jacobian(out, x) @ S + ca.jacobian(out, p) for out in (now, y)]
    found = [
        ca.cse(ca.horzcat(now, after[0])),
        ca.cse(ca.horzcat(y, after[1]).T),
    ]
    return ca.Function("arm_sample", [ca.horzcat(x, S), tau, p], found)


def mujoco_sysid(problem: Problem) -> Values:
    """MuJoCo's own least squares, rollouts and finite differences on all cores."""
    import mujoco
    from mujoco import sysid

    step = 1.25e-4
    study = replace(
        problem.study,
        arm=replace(
            problem.study.arm,
            joints=tuple(replace(j, current_loop_hz=None) for j in problem.study.arm.joints),
        ),
    )

    def values(z: FloatArray) -> Values:
        found = problem.start | {
            key: problem.start[key] * float(np.exp(at)) for key, at in zip(KEYS, z, strict=True)
        }
        return found

    def text(z: FloatArray) -> str:
        parameters = tuple(
            Parameter(name, joint, value, 0.0, "1", "start")
            for (name, joint), value in values(z).items()
        )
        return to_mjcf(IdentifiedArm(study, parameters, "start")).data.decode()

    def build(params: Any, spec: Any) -> Any:
        model = mujoco.MjModel.from_xml_string(text(params.as_vector()))
        model.opt.timestep = step
        return model

    spec = mujoco.MjSpec.from_string(text(np.zeros(len(KEYS))))
    spec.option.timestep = step
    model = spec.compile()
    channels = [("omega_m1", 0), ("omega_m2", 0), ("a1", 1), ("a2", 1)]
    at = [model.sensor(name).adr[0] + part for name, part in channels]
    sequences = [_sequence(problem, log, model, study, step) for log in problem.logs]
    by_length = {id(s[1]): log for s, log in zip(sequences, problem.logs, strict=True)}
    measured = {id(s[1]): m for s, m in zip(sequences, problem.measured, strict=True)}

    def compare(
        params: Any, predicted: Any, target: Any, model: Any, return_all: bool, **_: Any
    ) -> Any:
        log = by_length[id(target)]
        samples = predicted.data[:, at][:: round(log.sample_time / step)][: len(log)]
        rows = problem.rows(problem.sensed(samples, log), log)
        return ((rows - measured[id(target)]) / NOISE).ravel(), predicted, predicted

    groups = sysid.ModelSequences(
        "arm",
        spec,
        [log.name for log in problem.logs],
        [s[2] for s in sequences],
        [s[0] for s in sequences],
        [s[1] for s in sequences],
    )
    residual = sysid.build_residual_fn(
        models_sequences=[groups],
        build_model=build,
        modify_residual=compare,
        resample_true=False,
    )
    params = sysid.ParameterDict(
        {
            f"{name}_{joint}": sysid.Parameter(f"{name}_{joint}", 0.0, -2.0, 2.0)
            for name, joint in KEYS
        }
    )
    found, _ = sysid.optimize(
        params, residual, optimizer="mujoco", verbose=False, max_iters=30, eps=1e-5
    )
    ended = values(found.as_vector())
    return {key: ended[key] for key in KEYS}


def _sequence(
    problem: Problem, log: Log, model: Any, study: Study, step: float
) -> tuple[Any, Any, FloatArray]:
    """What drives a rollout, what it is compared with, and where it begins."""
    from mujoco import sysid

    per_sample = round(log.sample_time / step)
    e = np.array([joint.torque_per_volt or 1.0 for joint in study.arm.joints])
    tau = problem.torques(log)  # Simpson's mean over each step is what an impulse needs
    mean = (tau[:, :, 0] + 4.0 * tau[:, :, 1] + tau[:, :, 2]) / 6.0
    control = np.repeat(mean, per_sample // SUBSTEPS, axis=1).reshape(-1, 2) / e
    times = step * np.arange(len(control))
    names = [model.actuator(i).name for i in range(model.nu)]
    driven = sysid.TimeSeries.from_control_names(times, control, model, names)
    seen = np.zeros((len(control), model.nsensordata))
    sensed = sysid.TimeSeries.from_names(times, seen, model)
    return driven, sensed, sysid.create_initial_state(model, np.zeros(model.nq))
