"""Records simulated in MuJoCo and here: `python -m benchmarks.studies.exported_records RESULT...`.

Each RESULT is a directory that `strainwave identify` has written, with its study and logs in place.
The recorded references, PRBS and open-loop voltages drive the exported arm in MuJoCo, under the
servo of the study, and the identified arm in the simulation of strainwave. Printed are the largest
and the median difference of the motor velocities over the records: root mean square over that of
the simulation, over all motors and of the worst motor that moves.
"""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from rich.table import Table
from scipy.interpolate import interp1d

from benchmarks.console import Console
from strainwave.domain import FloatArray, Servo
from strainwave.domain.arm.effects import all_effects
from strainwave.domain.arm.link_sensors.link_space import Quantity
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.simulation import Drive, common_step, simulate
from strainwave.errors import InvalidInput, NumericalFailure
from strainwave.export import IdentifiedArm, export_arm, read_arm
from strainwave.export.completion import completed
from strainwave.export.linear_models import coordinates_of
from strainwave.export.mjcf_drives import Target
from strainwave.io.logs import read_logs
from strainwave.io.results import read_document, result_path
from strainwave.io.study import read_study
from strainwave.signals import hygiene
from strainwave.signals.recorded_input import (
    driven_by_voltage,
    missing_motor_signal,
    missing_recorded_input,
    recorded_drive,
)

MIN_MOVING_SHARE = 0.01  # of the fastest motor; slower motors are held by their servo, and stick
STARTING_TIME = 0.5  # [s] of a servo, which begins with an unknown history of commands
RECORDED: tuple[Quantity, ...] = ("motor_velocity", "motor_angle", "link_angle", "link_velocity")


@dataclass
class Controller:
    """The servo of a study, as the simulation has it, on angles without rounding."""

    servo: Servo
    active: tuple[bool, ...]
    integral: FloatArray
    last: FloatArray
    path: FloatArray

    @classmethod
    def at_rest(cls, servo: Servo, drive: Drive) -> Controller:
        angle, ki = np.array(drive.motor_angle), np.array(servo.ki)
        integral = np.divide(drive.initial_voltage, ki, out=np.zeros(len(ki)), where=ki > 0.0)
        return cls(servo, drive.servo, integral, angle, angle.copy())

    def command(self, reference: FloatArray, angle: FloatArray, added: FloatArray) -> FloatArray:
        servo, period = self.servo, self.servo.period
        wanted = reference
        if servo.position_gain is not None:
            wanted = reference + np.array(servo.position_gain) * (self.path - angle)
            self.path += reference * period
        error = wanted - (angle - self.last) / period
        integral = self.integral + error * period
        output = added + error * np.array(servo.kp) + integral * np.array(servo.ki)
        is_free = np.abs(output) <= servo.limit
        active = np.array(self.active)
        self.integral = np.where(active & is_free, integral, self.integral)
        self.last = angle
        limited = np.where(is_free, output, np.copysign(servo.limit, output))
        return np.where(active, limited, added)


def with_effects(arm: IdentifiedArm) -> IdentifiedArm:
    """The arm with the effects of its values, which the simulation must be told."""
    description = arm.study.arm
    for number in range(1, description.n_joints + 1):
        present = [
            effect.name
            for effect in all_effects()
            if effect.core_name and not effect.by_record and not effect.tested_law
            if any(arm.values.get((size, number)) for size in effect.sizes)
        ]
        description = description.with_joint(number, effects=tuple(present))
    return replace(arm, study=replace(arm.study, arm=description))


def in_mujoco(
    path: Path, model_arm: Arm, drive: Drive, n_samples: int, start: dict[Quantity, FloatArray]
) -> FloatArray:
    """Motor velocities (n_samples, n_joints) at the ticks of the drive."""
    import mujoco

    model = mujoco.MjModel.from_xml_path(str(path))
    data, coordinates = mujoco.MjData(model), coordinates_of(model_arm)
    joints = [f"motor_joint{i}" for i in coordinates.elastic]
    joints += model_arm.joint_names
    at = [model.joint(name).qposadr[0] for name in joints]
    elastic = [i - 1 for i in coordinates.elastic]
    data.qpos[at] = [*start["motor_angle"][elastic], *start["link_angle"]]
    data.qvel[at] = [*start["motor_velocity"][elastic], *start["link_velocity"]]
    if model.na:
        states = [int(a) for a in model.actuator_actadr if a >= 0]
        filtered = [i for i, a in enumerate(model.actuator_actadr[: model_arm.n_joints]) if a >= 0]
        data.act[states] = np.array(drive.initial_voltage)[filtered]
    servo = model_arm.servo if any(drive.servo) else None
    controller = Controller.at_rest(servo, drive) if servo else None
    clocks = [drive.tick, *([servo.period] if servo else [])]
    model.opt.timestep = common_step(clocks, model.opt.timestep)
    per_tick, *others = (round(clock / model.opt.timestep) for clock in clocks)
    per_servo = others[0] if others else per_tick
    unit = math.gcd(per_tick, per_servo)
    velocities = np.zeros((n_samples, model_arm.n_joints))
    voltage = np.zeros(model_arm.n_joints)
    for step in range(0, n_samples * per_tick, unit):
        k = step // per_tick
        if step % per_tick == 0:
            velocities[k] = coordinates.motor_angles @ data.qvel[at]
        if controller is not None and step % per_servo == 0:
            angle = coordinates.motor_angles @ data.qpos[at]
            voltage = controller.command(drive.reference[k], angle, drive.voltage[k])
        elif step % per_tick == 0:  # the servo holds its voltage
            voltage = np.where(drive.servo, voltage, drive.voltage[k])
        data.ctrl[:] = voltage
        mujoco.mj_step(model, data, unit)
    return velocities


def differences(
    arm: IdentifiedArm, result: Path, path: Path, seconds: float
) -> Iterator[tuple[str, float, float]]:
    """Record, difference over all motors, and of the worst motor that moves."""
    joints = tuple(replace(joint, encoder_counts=None) for joint in arm.study.arm.joints)
    study = replace(arm.study, arm=arm.study.arm.with_joints(joints))
    model = Arm.of(study.arm)
    document = read_document(result_path(result))
    logs, _ = hygiene.repair_records(read_logs(read_study(document["study"]["path"])), model)
    for log in logs:
        if log.experiment.payload is not None or missing_motor_signal(model, log):
            continue
        drive = recorded_drive(model, log)
        if missing_recorded_input(model, log):
            _, drive = driven_by_voltage(model, log)
        n_samples = min(len(log), round(seconds / drive.tick))
        names: tuple[Quantity, ...] = (
            "motor_velocity",
            "motor_angle",
            "link_angle",
            "link_velocity",
        )
        ours = simulate(
            model, arm.values, drive, sample_time=drive.tick, samples=n_samples, record=names
        )
        start = {name: ours[name][0] for name in names}
        theirs = in_mujoco(path, model, drive, n_samples, start)
        velocity = ours["motor_velocity"]
        size = np.linalg.norm(velocity, axis=0)
        error = np.linalg.norm(theirs - velocity, axis=0)
        moves = size > MIN_MOVING_SHARE * size.max()
        if not moves.any():
            continue
        total = float(np.linalg.norm(error) / np.linalg.norm(size))
        yield log.name, total, float(np.max(error[moves] / size[moves]))


def servo_fits(result: Path, path: Path) -> Iterator[tuple[str, float]]:
    """Record, and fit [%] of the measured angles by the exported position servos in MuJoCo.

    Commands are interpolated. The first half second, in which the motion starts, does not count.
    """
    import mujoco

    model = mujoco.MjModel.from_xml_path(str(path))
    study = read_study(read_document(result_path(result))["study"]["path"])
    for log in read_logs(study):
        if log.experiment.payload is not None:
            continue
        numbers = range(1, study.arm.n_joints + 1)
        reference, angle = (
            np.column_stack([log.channels[f"{name}{i}"] for i in numbers])
            for name in ("ref", "theta_m")
        )
        time = log.sample_time * np.arange(len(log))
        path_of = interp1d(time, reference, axis=0)
        data = mujoco.MjData(model)
        data.qpos[:], data.qvel[:] = angle[0], (angle[3] - angle[0]) / (3.0 * log.sample_time)
        simulated = np.zeros_like(angle)
        for k, instant in enumerate(time):
            while data.time < instant - 0.5 * model.opt.timestep:
                data.ctrl[:] = path_of(min(data.time, time[-1]))
                mujoco.mj_step(model, data)
            simulated[k] = data.qpos
        counts = time > STARTING_TIME
        measured, error = angle[counts], (angle - simulated)[counts]
        spread = np.linalg.norm(measured - measured.mean(axis=0))
        yield log.name, float(100.0 * (1.0 - np.linalg.norm(error) / spread))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("results", type=Path, nargs="+")
    parser.add_argument("--seconds", type=float, default=5.0, help="of each record")
    parser.add_argument("--records", action="store_true", help="print every record")
    arguments = parser.parse_args()
    columns = ("result", "records", "all motors [%]", "worst motor [%]", "median [%]", "seconds")
    table = Table(*columns, box=None)
    for path in arguments.results:
        begin = time.perf_counter()
        with TemporaryDirectory() as folder:
            out = Path(folder) / "arm.xml"
            identified = read_arm(path)
            export_arm(identified, out)
            if identified.study.arm.position_servo is not None:
                for name, fit in servo_fits(path, out):
                    table.add_row(path.name, name, f"fit of angles {fit:.1f} %")
                continue
            arm = with_effects(completed(identified, "mjcf", Target().effects))
            try:
                rows = list(differences(arm, path, out, arguments.seconds))
            except (InvalidInput, NumericalFailure) as error:
                table.add_row(path.name, str(error))
                continue
        if arguments.records:
            for name, total, worst in rows:
                table.add_row("", name, f"{100 * total:.3f}", f"{100 * worst:.3f}")
        percent = 100.0 * np.array([row[1:] for row in rows])
        elapsed = f"{time.perf_counter() - begin:.0f}"
        largest, median = percent.max(axis=0), np.median(percent[:, 1])
        cells = f"{largest[0]:.2f}", f"{largest[1]:.2f}", f"{median:.3f}", elapsed
        table.add_row(path.name, str(len(rows)), *cells)
    Console().print(table)


if __name__ == "__main__":
    main()
