"""Errors on drawn arms simulated in MuJoCo: `python -m benchmarks.studies.engine --arms 12`.

Of a log only excitation and noise come from strainwave. MuJoCo computes motion and friction in
steps of a fifth of the sampling period, SciPy the filters; current loop, servo and encoder are in
this module. MuJoCo's own first-order actuators lag half a step too much, and its friction takes
two steps to stop a motor.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, cast
from xml.etree import ElementTree

import mujoco
import numpy as np
from rich.table import Table
from scipy.signal import butter, cont2discrete, lfilter, lfilter_zi

from benchmarks.console import Console, share_of
from benchmarks.families.rigs import Rig
from benchmarks.studies.arms import draw_arm, run_all, run_on_logs
from strainwave.domain import Control, Experiment, FloatArray, Joint, Parameter, Prbs, Study, Use
from strainwave.domain.arm.kinds import change_arm_keys
from strainwave.domain.arm.link_sensors.link_space import Quantity
from strainwave.domain.keys import Values
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.simulation import Drive, Trajectory
from strainwave.export.mjcf import to_mjcf
from strainwave.export.source import IdentifiedArm
from strainwave.io.study import read_study
from strainwave.pipeline import identify
from strainwave.virtual import scara
from strainwave.virtual.experiments import derived

STEP = 5e-5  # [s] time step of MuJoCo


class Plant:
    """An arm in MuJoCo; arms that differ from the exported model override its methods."""

    def __init__(self, arm: Arm, values: Values) -> None:
        self.arm, self.values = arm, values

    def edited(self, mjcf: str) -> str:
        """Change the model's XML."""
        return mjcf

    def begin(self, model: Any, data: Any, drive: Drive) -> None:
        """Set the initial state: links at standstill on their gears."""
        _hang(self.arm, self.values, drive, data)

    def bandwidths(self) -> list[float]:
        """Bandwidths of the current loops [Hz]; infinite without one."""
        return [joint.current_loop_hz or np.inf for joint in self.arm.joints]

    def amplified(self, commanded: FloatArray) -> FloatArray:
        """Output of the amplifiers [V]."""
        return commanded

    def act(self, model: Any, data: Any) -> None:
        """Set torques and friction for the next step."""


def in_mujoco(
    arm: Arm,
    values: Values,
    drive: Drive,
    *,
    sample_time: float,
    samples: int,
    record: Sequence[Quantity],
    plant: Callable[[Arm, Values], Plant] = Plant,
    delay: float = 0.0,
    step: float = STEP,
) -> Trajectory:
    """Simulate one experiment, with the interface of `strainwave.dynamics.simulation.simulate`.

    `delay` [s] is that of the voltages after the encoder readings, `step` [s] the time step; rigid
    joints need no short one.
    """
    simulated = plant(arm, values)
    with_frames = not {"specific_force_x", "gear_torque"}.isdisjoint(record)
    model = _model(arm, values, simulated, step, with_frames=with_frames)
    data = mujoco.MjData(model)
    joints = range(1, arm.n_joints + 1)
    simulated.begin(model, data, drive)
    per_tick, per_sample = round(drive.tick / step), round(sample_time / step)
    n = (samples - 1) * per_sample + 1
    servo = _LawServo(arm, drive) if drive.linear_servo else _Servo(arm, drive)
    current, late = _CurrentLoop(simulated, drive, step), round(delay / step)
    commanded = np.array(drive.initial_voltage)
    sensor_data = np.empty((n, model.nsensordata))
    voltage = np.empty((n, arm.n_joints))
    motors = [model.joint(_motor_joint(arm, i)).qposadr[0] for i in joints]
    turns = np.array([1.0 if joint.elastic else 1.0 / joint.gear_ratio for joint in arm.joints])
    for k in range(n):
        if k % per_tick == 0:
            following = servo.command(k // per_tick, turns * data.qpos[motors])
        if k % per_tick == late:
            commanded = following
        voltage[k] = commanded
        data.ctrl[:] = current.over_step(simulated.amplified(commanded))
        simulated.act(model, data)
        mujoco.mj_step(model, data)  # sensor data are those before the step
        sensor_data[k] = data.sensordata
    if not np.all(np.isfinite(sensor_data)):
        raise FloatingPointError("MuJoCo diverged")

    def sensor(name: str, component: int) -> FloatArray:
        columns = [model.sensor(f"{name}{i}").adr[0] + component for i in joints]
        return np.asarray(sensor_data[:, columns])

    def motor_angle() -> FloatArray:
        return sensor("theta_m", 0) if arm.joints[0].elastic else turns * sensor("theta_l", 0)

    def gear_torque() -> FloatArray:
        axes = np.array([joint.axis for joint in arm.joints])
        return np.asarray(sum(sensor("carried", k) * axes[:, k] for k in range(3)))

    def frames() -> dict[Quantity, FloatArray]:
        signals = _link_signals(sensor)
        passes = {
            "specific_force": [j.imu.accelerometer_hz if j.imu else None for j in arm.joints],
            "angular_rate": [j.imu.gyro_hz if j.imu else None for j in arm.joints],
        }
        for name in ("angular_acceleration", "rate_product"):
            passes[name] = passes["specific_force"]
        return {
            name: _filter(values, 2, passes[name.rpartition("_")[0]], step)[::per_sample]
            for name, values in signals.items()
        }

    quantities: dict[Quantity, Callable[[], FloatArray]] = {
        "voltage": lambda: voltage,
        "link_angle": lambda: sensor("theta_l", 0),
        "encoder": lambda: _quantise(motor_angle(), arm.joints),
        "gear_torque": gear_torque,
        "accelerometer": lambda: _filter(
            sensor("a", 1), 2, [j.accelerometer_hz for j in arm.joints], step
        ),
        "gyro": lambda: _filter(sensor("gyro", 2), 1, [j.gyro_hz for j in arm.joints], step),
    }
    time: FloatArray = sample_time * np.arange(samples, dtype=np.float64)
    of_frames = frames() if not quantities.keys() >= set(record) else {}
    readings = {name: quantities[name]()[::per_sample] for name in record if name in quantities}
    return Trajectory(time, readings | {n: of_frames[n] for n in record if n not in readings})


def _link_signals(sensor: Callable[[str, int], FloatArray]) -> dict[Quantity, FloatArray]:
    """Motion of the links' frames per step: specific force, rate and its slope, products."""
    force, rate = ([sensor(name, k) for k in range(3)] for name in ("force", "rate"))
    in_base = [sensor("turning", k) for k in range(3)]
    slope = [sum(sensor(f"axis_{x}", k) * in_base[k] for k in range(3)) for x in "xyz"]
    signals: dict[str, FloatArray] = {}
    for k, x in enumerate("xyz"):
        signals[f"specific_force_{x}"] = force[k]
        signals[f"angular_acceleration_{x}"] = np.asarray(slope[k])
        signals[f"angular_rate_{x}"] = rate[k]
        for j, y in enumerate("xyz"[k:], start=k):
            signals[f"rate_product_{x}{y}"] = rate[k] * rate[j]
    return cast("dict[Quantity, FloatArray]", signals)


def _with_frames(mjcf: str) -> str:
    """The model with sensors of the motion of the links' frames, and of what joints carry."""
    root = ElementTree.fromstring(mjcf)
    sensors = root.find("sensor")
    kinds = {
        "accelerometer": "force",
        "gyro": "rate",
        "frameangacc": "turning",
        "torque": "carried",
        **{f"frame{x}axis": f"axis_{x}" for x in "xyz"},
    }
    for body in root.iter("body"):
        name = body.get("name", "")
        if sensors is None or not name.startswith("link"):
            continue
        number = name.removeprefix("link")
        ElementTree.SubElement(body, "site", name=f"frame{number}")
        for kind, tag in kinds.items():
            sensor = ElementTree.SubElement(sensors, kind, name=f"{tag}{number}")
            if kind.startswith("frame"):
                sensor.set("objtype", "site")
                sensor.set("objname", f"frame{number}")
            else:
                sensor.set("site", f"frame{number}")
    return ElementTree.tostring(root, encoding="unicode")


def _model(arm: Arm, values: Values, plant: Plant, step: float, *, with_frames: bool) -> Any:
    parameters = tuple(
        Parameter(name, joint, value, 0.0, "1", "tuned") for (name, joint), value in values.items()
    )
    # _CurrentLoop simulates the current loops
    joints = tuple(replace(joint, current_loop_hz=None) for joint in arm.joints)
    study = Study(arm=arm.with_joints(joints), experiments=())
    text = to_mjcf(IdentifiedArm(study, parameters, "truth")).data.decode()
    text = plant.edited(text)
    model = mujoco.MjModel.from_xml_string(_with_frames(text) if with_frames else text)
    model.opt.timestep = step
    for i in range(1, arm.n_joints + 1):
        at = model.joint(_motor_joint(arm, i)).dofadr[0]
        model.dof_solref[at] = 2.0 * max(settling(values, i), step), 1.0
    return model


def _motor_joint(arm: Arm, joint: int) -> str:
    """Name of the joint that a motor turns: its own, or that of the link behind a rigid gear."""
    return f"motor_joint{joint}" if arm.joints[joint - 1].elastic else f"joint{joint}"


def settling(values: Values, joint: int) -> float:
    """Friction settling time [s], at least a step of MuJoCo."""
    return max(values.get(("friction_settling_time", joint), 0.0), STEP)


def _hang(arm: Arm, values: Values, drive: Drive, data: Any) -> None:
    """Set links to standstill on their gears; under gravity, gears are linear."""
    motor = np.array(drive.motor_angle)
    link = arm.links_of(motor)
    if arm.gravity and arm.joints[0].elastic:
        base = arm.parameter_vector(values)[: len(arm.base_names)]
        stiffness = [values["gear_stiffness", i + 1] for i in range(arm.n_joints)]
        at_rest = np.zeros((1, arm.n_joints))
        for _ in range(100):
            load = arm.link_torques(base, link[None], at_rest, at_rest)[0]
            link = arm.links_of(motor) - load / stiffness
    for i in range(arm.n_joints):
        data.joint(f"joint{i + 1}").qpos[0] = link[i]
        if arm.joints[i].elastic:
            data.joint(f"motor_joint{i + 1}").qpos[0] = motor[i]


class _CurrentLoop:
    """Equivalent voltages of first-order current loops."""

    def __init__(self, plant: Plant, drive: Drive, step: float) -> None:
        x = 2.0 * np.pi * np.array(plant.bandwidths()) * step
        self.decay, self.mean = np.exp(-x), -np.expm1(-x) / x
        self.state = np.array(drive.initial_voltage)

    def over_step(self, voltage: FloatArray) -> FloatArray:
        """Mean over the next step of MuJoCo."""
        distance = self.state - voltage
        self.state = voltage + self.decay * distance
        return np.asarray(voltage + self.mean * distance)


class _Servo:
    """u = kp e + ki integral(e), e = reference - encoder difference over a period."""

    def __init__(self, arm: Arm, drive: Drive) -> None:
        self.arm, self.drive = arm, drive
        self.previous = _quantise(np.array([drive.motor_angle]), arm.joints)[0]
        ki = np.array(arm.servo.ki) if arm.servo else np.ones(arm.n_joints)
        # the integral holds the arm at the start
        self.integral = np.where(drive.servo, drive.initial_voltage / ki, 0.0)

    def command(self, tick: int, angle: FloatArray) -> FloatArray:
        tick = min(tick, len(self.drive.voltage) - 1)
        voltage: FloatArray = self.drive.voltage[tick].copy()
        servo = self.arm.servo
        if servo is None:
            return voltage
        encoder = _quantise(angle[None], self.arm.joints)[0]
        error = self.drive.reference[tick] - (encoder - self.previous) / servo.period
        self.previous = encoder
        integral = self.integral + error * servo.period
        unlimited = voltage + servo.kp * error + servo.ki * integral
        is_limited = np.abs(unlimited) > servo.limit
        self.integral = np.where(is_limited, self.integral, integral)
        limited = np.clip(unlimited, -servo.limit, servo.limit)
        return np.asarray(np.where(self.drive.servo, limited, voltage))


class _LawServo:
    """Sampled laws v = C x + D (r, w, y), x+ = A x + B (r, w, y) + E v, of all joints."""

    def __init__(self, arm: Arm, drive: Drive) -> None:
        self.arm, self.drive = arm, drive
        self.path = _quantise(np.array([drive.motor_angle]), arm.joints)[0]
        servo = drive.linear_servo
        assert servo is not None
        self.servo = servo
        starts = zip(servo.laws, self.path, drive.initial_voltage, strict=True)
        held = drive.voltage[0]
        self.states = [
            law.rest() @ (angle, volts - ff)
            for (law, angle, volts), ff in zip(starts, held, strict=True)
        ]

    def command(self, tick: int, angle: FloatArray) -> FloatArray:
        tick = min(tick, len(self.drive.voltage) - 1)
        encoder = _quantise(angle[None], self.arm.joints)[0]
        output = np.empty(len(encoder))
        for i, law in enumerate(self.servo.laws):
            feed_forward, rate = self.drive.voltage[tick, i], self.drive.reference[tick, i]
            inputs, x = np.array([self.path[i], rate, encoder[i]]), self.states[i]
            wanted = law.C @ x + law.D @ inputs + feed_forward
            output[i] = np.clip(wanted, -self.servo.limit, self.servo.limit)
            following = law.A @ x + law.B @ inputs + law.E * (output[i] - feed_forward)
            holds = law.holds & (output[i] != wanted)
            self.states[i] = np.where(holds, x, following)
            self.path[i] += rate * self.servo.period
        return output


def _quantise(angle: FloatArray, joints: Sequence[Joint]) -> FloatArray:
    count = 2.0 * np.pi / np.array([joint.encoder_counts or np.inf for joint in joints])
    return np.asarray(count * np.round(angle / count))


def _filter(
    x: FloatArray, order: int, bandwidths: Sequence[float | None], step: float
) -> FloatArray:
    """Apply continuous Butterworth filters to signals joined by straight lines between steps.

    A bilinear filter of 1 kHz would be 2 us late, ten times the resolution of good records.
    """
    filtered = x.copy()
    for i, hz in enumerate(bandwidths):
        if hz:
            analog = butter(order, 2.0 * np.pi * hz, analog=True)
            numerator, a, _ = cont2discrete(analog, step, method="foh")
            b = np.ravel(numerator)
            filtered[:, i] = lfilter(b, a, x[:, i], zi=lfilter_zi(b, a) * x[0, i])[0]
    return filtered


KINDS = ("linear", "three-slope", "vertical")
LIMITS = {
    "inertias": (0.2, 0.2, 0.5),
    "stiffness": (0.2, 0.2, 0.5),
    "knees": (0.5, 0.5, 0.5),
    "gear damping": (0.6, 0.6, 2.0),
    "Coulomb friction": (0.3, 0.3, 0.5),
    "total viscous friction": (2.0, 2.0, 2.0),
}
"""Largest permitted errors [%], for each of `KINDS`."""
_AMPLITUDES = (2.0, 3.0, 4.0, 6.0, 8.0)  # [V] of the sweep records of three-slope gears
_GRAVITY = 9.81  # [m/s^2]
_FIRST_MOMENT = (2.5, 3.5)  # [kg m] of the whole arm about the first axis


def lab_arm(seed: int) -> tuple[Study, Values]:
    """Draw an arm with a full set of experiments: linear, three-slope, vertical in turn."""
    kind = KINDS[seed % len(KINDS)]
    study, values = draw_arm(2 * seed + (kind == "three-slope"))
    free: tuple[Control, Control] = ("open", "open")
    held: dict[int, tuple[Control, Control]] = {1: ("open", "servo"), 2: ("servo", "open")}
    both: tuple[Control, Control] = ("servo", "servo")
    experiments = [
        e for e in scara.STIFF.study(Path()).experiments if e.use in ("motion", "tuning")
    ]

    def record(name: str, use: Use, j: int, volt: float, control: tuple[Control, Control]) -> None:
        prbs = Prbs(10, 1e-3, 4, volt)
        name = f"{name}-j{j}"
        experiments.append(Experiment(name, f"{name}.parquet", use, control, joint=j, prbs=prbs))

    for j in (1, 2):
        if kind == "vertical":
            record("prbs", "frequency", j, 5.0, both)
            continue
        record("prbs", "frequency", j, 10.0, free)
        record("prbs-held", "frequency", j, 10.0, held[j])
        for volt in _AMPLITUDES if kind == "three-slope" else ():
            record(f"sweep-{volt:g}V", "sweep", j, volt, free)
    if kind == "vertical":
        study = replace(study, arm=change_arm_keys(study.arm, gravity=_GRAVITY))
        first_moment = float(np.random.default_rng([1986, seed]).uniform(*_FIRST_MOMENT))
        values["gravity_torque_1", None] = _GRAVITY * first_moment
        values["gravity_torque_2", None] = (
            _GRAVITY * values["gamma", None] / scara.STIFF.link_length[0]
        )
    return replace(study, experiments=tuple(experiments)), values


def lab_rig(seed: int) -> Rig:
    """Draw such an arm with the built-in rig's sensors."""
    return Rig(*lab_arm(seed))


def evaluate(path: Path, values: Values) -> dict[str, Any]:
    """Errors [%] and standard deviations [%] of the whole-arm fit."""
    identification = identify(path)
    whole_arm = identification.whole_arm
    if whole_arm is None:
        return {"failure": identification.reason}
    study = read_study(path)
    true_values = derived(values, study.arm)
    for joint in range(1, study.arm.n_joints + 1):
        true_values["friction_settling_time", joint] = settling(values, joint)
    rows = []
    for p in whole_arm.parameters:
        true = true_values.get((p.name, p.joint), 0.0)
        if p.value is None or p.std is None or p.ci95 is None:
            continue
        size = 0.01 * (abs(true) or 1.0)
        inside = p.ci95[0] <= true <= p.ci95[1]
        rows.append([p.name, p.joint, (p.value - true) / size, p.std / size, inside])
    warnings = [warning.code for warning in identification.warnings]
    return {"status": whole_arm.status, "parameters": rows, "warnings": warnings}


def group(name: str) -> str | None:
    """Entry of `LIMITS` of a parameter."""
    if name in ("alpha", "beta", "gamma") or name.endswith("inertia"):
        return "inertias"
    starts = {
        "gear_stiffness": "stiffness",
        "gear_knee": "knees",
        "gear_damping": "gear damping",
        "motor_coulomb": "Coulomb friction",
        "total_viscous": "total viscous friction",
    }
    return next((kind for start, kind in starts.items() if name.startswith(start)), None)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--arms", type=int, default=12)
    parser.add_argument("--out", type=Path, help="lines of JSON; a repeated run continues")
    options = parser.parse_args()
    console = Console()
    table = Table("arm", "kind", *LIMITS, "inside", "status", box=None)
    by_kind = {kind: list[tuple[dict[str, float], list[bool]]]() for kind in KINDS}
    work = partial(run_on_logs, work=evaluate, arm=lab_rig, simulator=in_mujoco)
    for result in run_all(range(options.arms), work, options.out):
        kind = result["seed"] % len(KINDS)
        if "failure" in result:
            console.print(f"arm {result['seed']}, {KINDS[kind]}: {result['failure']}")
            continue
        largest: dict[str, float] = {}
        for name, _, error, _, _ in result["parameters"]:
            row = group(name)
            if row is not None:
                largest[row] = max(largest.get(row, 0.0), abs(error))
        cells = [_cell(largest.get(name), limits[kind]) for name, limits in LIMITS.items()]
        inside = [parameter[4] for parameter in result["parameters"]]
        share = f"{sum(inside)}/{len(inside)}"
        table.add_row(str(result["seed"]), KINDS[kind], *cells, share, result["status"])
        by_kind[KINDS[kind]].append((largest, inside))
    console.print(table)
    summary = Table("kind", "arms", *LIMITS, "inside", box=None, title="largest errors [%]")
    for name, arms in by_kind.items():
        largest = {
            key: max(errors[key] for errors, _ in arms) for key in (arms[0][0] if arms else ())
        }
        cells = [f"{largest[key]:.2g}" if key in largest else "" for key in LIMITS]
        share = share_of([one for _, inside in arms for one in inside])
        summary.add_row(name, str(len(arms)), *cells, share)
    console.print(summary)


def _cell(error: float | None, limit: float) -> str:
    if error is None:
        return ""
    return f"{error:.2g}" if error <= limit else f"[bold]{error:.2g}[/bold] > {limit:g}"


if __name__ == "__main__":
    main()
