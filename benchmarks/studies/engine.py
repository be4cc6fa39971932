"""Errors on drawn arms whose logs MuJoCo made: `python -m benchmarks.studies.engine --arms 12`.

Nothing of a log is ours but the excitation and the noise: motion and friction are MuJoCo's, in
steps a fifth of the samples', filters are SciPy's; current loop, servo and encoder are below.
MuJoCo's own first-order actuators lag half a step too much, and its friction takes two steps to
stop a motor.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from rich.console import Console
from rich.table import Table
from scipy.signal import butter, cont2discrete, lfilter, lfilter_zi

from benchmarks.studies.arms import drawn, each, with_logs
from strainwave.domain import Control, Experiment, FloatArray, Joint, Parameter, Prbs, Study, Use
from strainwave.domain.parameters import Values
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.simulation import Drive, Quantity, Trajectory
from strainwave.export.mjcf import to_mjcf
from strainwave.export.source import IdentifiedArm
from strainwave.io.study import read_study
from strainwave.pipeline import identify
from strainwave.virtual import scara
from strainwave.virtual.experiments import derived
from strainwave.virtual.families.rigs import Rig

STEP = 5e-5  # [s] of the engine


class Plant:
    """An arm of the engine; what has more to it than the exported model overrides this."""

    def __init__(self, arm: Arm, values: Values) -> None:
        self.arm, self.values = arm, values

    def edited(self, mjcf: str) -> str:
        """The model's XML."""
        return mjcf

    def begin(self, model: Any, data: Any, drive: Drive) -> None:
        """Before the first step: links hang at standstill on their gears."""
        _hang(self.arm, self.values, drive, data)

    def bandwidths(self) -> list[float]:
        """Of the joints' current loops [Hz]; infinite where a current is there at once."""
        return [joint.current_loop_hz or np.inf for joint in self.arm.joints]

    def amplified(self, commanded: FloatArray) -> FloatArray:
        """The voltage that drives the motors."""
        return commanded

    def act(self, model: Any, data: Any) -> None:
        """Torques and friction that hold for the next step."""


def in_mujoco(
    arm: Arm,
    values: Values,
    drive: Drive,
    *,
    sample_time: float,
    samples: int,
    record: Sequence[Quantity],
    plant: Callable[[Arm, Values], Plant] = Plant,
) -> Trajectory:
    """One experiment, as `strainwave.dynamics.simulation.simulate` runs it."""
    own = plant(arm, values)
    model = _model(arm, values, own)
    data = mujoco.MjData(model)
    joints = range(1, arm.n_joints + 1)
    own.begin(model, data, drive)
    per_tick, per_sample = round(drive.tick / STEP), round(sample_time / STEP)
    n = (samples - 1) * per_sample + 1
    servo, current = _Servo(arm, drive), _CurrentLoop(own, drive)
    seen = np.empty((n, model.nsensordata))
    voltage = np.empty((n, arm.n_joints))
    motors = [model.joint(f"motor_joint{i}").qposadr[0] for i in joints]
    for k in range(n):
        if k % per_tick == 0:
            commanded = servo.command(k // per_tick, data.qpos[motors])
        voltage[k] = commanded
        data.ctrl[:] = current.over_step(own.amplified(commanded))
        own.act(model, data)
        mujoco.mj_step(model, data)  # leaves the sensors as they were before it
        seen[k] = data.sensordata
    if not np.all(np.isfinite(seen)):
        raise FloatingPointError("MuJoCo diverged")

    def sensed(name: str, component: int) -> FloatArray:
        at = [model.sensor(f"{name}{i}").adr[0] + component for i in joints]
        return np.asarray(seen[:, at])

    made: dict[Quantity, Callable[[], FloatArray]] = {
        "voltage": lambda: voltage,
        "link_angle": lambda: sensed("theta_l", 0),
        "encoder": lambda: _rounded(sensed("theta_m", 0), arm.joints),
        "accelerometer": lambda: _filtered(
            sensed("a", 1), 2, [j.accelerometer_hz for j in arm.joints]
        ),
        "gyro": lambda: _filtered(sensed("gyro", 2), 1, [j.gyro_hz for j in arm.joints]),
    }
    time: FloatArray = sample_time * np.arange(samples, dtype=np.float64)
    return Trajectory(time, {name: made[name]()[::per_sample] for name in record})


def _model(arm: Arm, values: Values, own: Plant) -> Any:
    parameters = tuple(
        Parameter(name, joint, value, 0.0, "1", "truth") for (name, joint), value in values.items()
    )
    # currents are followed here
    joints = tuple(replace(joint, current_loop_hz=None) for joint in arm.joints)
    study = Study(arm=arm.with_joints(joints), experiments=())
    text = to_mjcf(IdentifiedArm(study, parameters, "truth")).data.decode()
    model = mujoco.MjModel.from_xml_string(own.edited(text))
    model.opt.timestep = STEP
    for i in range(1, arm.n_joints + 1):
        at = model.joint(f"motor_joint{i}").dofadr[0]
        model.dof_solref[at] = 2.0 * settling(values, i), 1.0
    return model


def settling(values: Values, joint: int) -> float:
    """How long friction takes to stop a motor [s]: the engine needs a step at least."""
    return max(values.get(("friction_settling_time", joint), 0.0), STEP)


def _hang(arm: Arm, values: Values, drive: Drive, data: Any) -> None:
    """Links at standstill on their gears, of linear stiffness where gravity pulls."""
    motor = np.array(drive.motor_angle)
    unloaded = motor * [joint.gear_ratio for joint in arm.joints]
    link = unloaded
    for _ in range(100 if arm.gravity else 0):
        outer = values["gravity_torque_2", None] * np.cos(link[0] + link[1])
        inner = values["gravity_torque_1", None] * np.cos(link[0])
        stiffness = [values["gear_stiffness", i] for i in (1, 2)]
        link = unloaded - np.array([inner + outer, outer]) / stiffness
    for i in range(arm.n_joints):
        data.joint(f"joint{i + 1}").qpos[0] = link[i]
        data.joint(f"motor_joint{i + 1}").qpos[0] = motor[i]


class _CurrentLoop:
    """Voltages that would bring a current at once where the loop's own lags."""

    def __init__(self, plant: Plant, drive: Drive) -> None:
        x = 2.0 * np.pi * np.array(plant.bandwidths()) * STEP
        self.left, self.mean = np.exp(-x), -np.expm1(-x) / x
        self.now = np.array(drive.initial_voltage)

    def over_step(self, voltage: FloatArray) -> FloatArray:
        """Their mean over the engine's next step."""
        distance = self.now - voltage
        self.now = voltage + self.left * distance
        return np.asarray(voltage + self.mean * distance)


class _Servo:
    """u = kp e + ki integral(e), e = reference - encoder difference over a period."""

    def __init__(self, arm: Arm, drive: Drive) -> None:
        self.arm, self.drive = arm, drive
        self.last = _rounded(np.array([drive.motor_angle]), arm.joints)[0]
        ki = np.array(arm.servo.ki) if arm.servo else np.ones(arm.n_joints)
        # what holds the arm at the start is in the integral
        self.integral = np.where(drive.servo, drive.initial_voltage / ki, 0.0)

    def command(self, tick: int, angle: FloatArray) -> FloatArray:
        tick = min(tick, len(self.drive.voltage) - 1)
        voltage: FloatArray = self.drive.voltage[tick].copy()
        servo = self.arm.servo
        if servo is None:
            return voltage
        encoder = _rounded(angle[None], self.arm.joints)[0]
        error = self.drive.reference[tick] - (encoder - self.last) / servo.period
        self.last = encoder
        integral = self.integral + error * servo.period
        wanted = voltage + servo.kp * error + servo.ki * integral
        limited = np.abs(wanted) > servo.limit
        self.integral = np.where(limited, self.integral, integral)
        limited_to = np.clip(wanted, -servo.limit, servo.limit)
        return np.asarray(np.where(self.drive.servo, limited_to, voltage))


def _rounded(angle: FloatArray, joints: Sequence[Joint]) -> FloatArray:
    count = 2.0 * np.pi / np.array([joint.encoder_counts or np.inf for joint in joints])
    return np.asarray(count * np.round(angle / count))


def _filtered(x: FloatArray, order: int, bandwidths: Sequence[float | None]) -> FloatArray:
    """Behind continuous filters, signals being straight lines between the engine's steps.

    A bilinear one of 1 kHz would be 2 us late, ten times what a good encoder's records see.
    """
    found = x.copy()
    for i, hz in enumerate(bandwidths):
        if hz:
            analog = butter(order, 2.0 * np.pi * hz, analog=True)
            numerator, a, _ = cont2discrete(analog, STEP, method="foh")
            b = np.ravel(numerator)
            found[:, i] = lfilter(b, a, x[:, i], zi=lfilter_zi(b, a) * x[0, i])[0]
    return found


KINDS = ("linear", "three-slope", "vertical")
LIMITS = {
    "inertias": (0.2, 0.2, 0.5),
    "stiffness": (0.2, 0.2, 0.5),
    "knees": (0.5, 0.5, 0.5),
    "gear damping": (0.6, 0.6, 2.0),
    "Coulomb friction": (0.3, 0.3, 0.5),
    "total viscous friction": (2.0, 2.0, 2.0),
}
"""Largest errors [%] that are asked for, kind by kind of `KINDS`."""
_AMPLITUDES = (2.0, 3.0, 4.0, 6.0, 8.0)  # [V] of the records that show a curve
_GRAVITY = 9.81  # [m/s^2]
_LEVER = (2.5, 3.5)  # [kg m] of the whole arm's mass about the first axis


def lab_arm(seed: int) -> tuple[Study, Values]:
    """A drawn arm with the experiments of a whole lab: linear, three slopes, upright in turn."""
    kind = KINDS[seed % len(KINDS)]
    study, values = drawn(2 * seed + (kind == "three-slope"))
    free: tuple[Control, Control] = ("open", "open")
    held: dict[int, tuple[Control, Control]] = {1: ("open", "servo"), 2: ("servo", "open")}
    both: tuple[Control, Control] = ("servo", "servo")
    experiments = [e for e in scara.study(Path()).experiments if e.use in ("motion", "tuning")]

    def record(name: str, use: Use, j: int, volt: float, control: tuple[Control, Control]) -> None:
        prbs = Prbs(10, 1e-3, 4, volt)
        own = Experiment(f"{name}-j{j}", f"{name}-j{j}.parquet", use, control, joint=j, prbs=prbs)
        experiments.append(own)

    for j in (1, 2):
        if kind == "vertical":
            record("prbs", "frequency", j, 5.0, both)
            continue
        record("prbs", "frequency", j, 10.0, free)
        record("prbs-held", "frequency", j, 10.0, held[j])
        for volt in _AMPLITUDES if kind == "three-slope" else ():
            record(f"sweep-{volt:g}V", "sweep", j, volt, free)
    if kind == "vertical":
        study = replace(study, arm=replace(study.arm, gravity=_GRAVITY))
        lever = float(np.random.default_rng([1986, seed]).uniform(*_LEVER))
        values["gravity_torque_1", None] = _GRAVITY * lever
        values["gravity_torque_2", None] = _GRAVITY * values["gamma", None] / scara.LINK_LENGTH[0]
    return replace(study, experiments=tuple(experiments)), values


def lab_rig(seed: int) -> Rig:
    """The same with the built-in rig's sensors."""
    return Rig(*lab_arm(seed))


def tried(path: Path, values: Values) -> dict[str, Any]:
    """Errors [%] and deviations [%] of what the whole-arm fit reported."""
    identification = identify(path)
    tuned = identification.tuned
    if tuned is None:
        return {"failure": identification.reason}
    study = read_study(path)
    known = derived(values, study.arm)
    for joint in range(1, study.arm.n_joints + 1):
        known["friction_settling_time", joint] = settling(values, joint)
    rows = []
    for p in tuned.parameters:
        true = known.get((p.name, p.joint), 0.0)
        if p.value is None or p.std is None or p.ci95 is None:
            continue
        size = 0.01 * (abs(true) or 1.0)
        inside = p.ci95[0] <= true <= p.ci95[1]
        rows.append([p.name, p.joint, (p.value - true) / size, p.std / size, inside])
    warnings = [warning.code for warning in identification.warnings]
    return {"status": tuned.status, "parameters": rows, "warnings": warnings}


def group(name: str) -> str | None:
    """Which of `LIMITS` a parameter falls under."""
    if name in ("alpha", "beta", "gamma") or name.endswith("inertia"):
        return "inertias"
    starts = {
        "gear_stiffness": "stiffness",
        "gear_knee": "knees",
        "gear_damping": "gear damping",
        "motor_coulomb": "Coulomb friction",
        "total_viscous": "total viscous friction",
    }
    return next((own for start, own in starts.items() if name.startswith(start)), None)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--arms", type=int, default=12)
    parser.add_argument("--out", type=Path, help="lines of JSON, from which a run goes on")
    chosen = parser.parse_args()
    console = Console()
    table = Table("arm", "kind", *LIMITS, "inside", "status", box=None)
    work = partial(with_logs, work=tried, arm=lab_rig, simulator=in_mujoco)
    for found in each(chosen.arms, work, chosen.out):
        place = found["seed"] % len(KINDS)
        if "failure" in found:
            console.print(f"arm {found['seed']}, {KINDS[place]}: {found['failure']}")
            continue
        worst: dict[str, float] = {}
        for name, _, error, _, _ in found["parameters"]:
            own = group(name)
            if own is not None:
                worst[own] = max(worst.get(own, 0.0), abs(error))
        cells = [_cell(worst.get(name), limits[place]) for name, limits in LIMITS.items()]
        inside = [row[4] for row in found["parameters"]]
        share = f"{sum(inside)}/{len(inside)}"
        table.add_row(str(found["seed"]), KINDS[place], *cells, share, found["status"])
    console.print(table)


def _cell(error: float | None, limit: float) -> str:
    if error is None:
        return ""
    return f"{error:.2g}" if error <= limit else f"[bold]{error:.2g}[/bold] > {limit:g}"


if __name__ == "__main__":
    main()
