"""Simulate the experiments of a study on a virtual arm and write its logs and study file.

If the log of an experiment exists, its references and open-loop voltages are applied again. If a
plan exists, the plan is applied. Otherwise an excitation is chosen by the use of the experiment.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Protocol

import numpy as np

from strainwave import pipeline
from strainwave.domain import (
    ArmDescription,
    Experiment,
    FloatArray,
    Identification,
    Payload,
    Prbs,
    Study,
)
from strainwave.domain.arm.combinations import reported, value_of
from strainwave.domain.arm.link_sensors import SensorAxis, installed_axes
from strainwave.domain.arm.link_sensors.imu import ImuAccelerometers, ImuGyros, ImuSensor
from strainwave.domain.arm.link_sensors.link_space import Quantity
from strainwave.domain.arm.parameters import with_known_constants
from strainwave.domain.keys import Values
from strainwave.domain.study import ProgressEvent
from strainwave.dynamics import excitation
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.simulation import (
    Drive,
    SensorNoise,
    Trajectory,
    measure,
    record_inputs,
    simulate,
)
from strainwave.errors import InvalidInput
from strainwave.excite.files import read_applied
from strainwave.io import logs
from strainwave.io import study as studies
from strainwave.io.parameters import read_parameters
from strainwave.signals.recorded_input import recorded_drive
from strainwave.virtual.position_servos import record_servo
from strainwave.virtual.scara import SOFT, BuiltInArm

Progress = Callable[[str], None]

_FAST_SAMPLE_TIME = 2.5e-4  # [s] of records that resolve the vibration of the gears
_WRITABLE_FORMATS = (".csv", ".csv.gz", ".parquet")
MOTION_DURATION = 10.0  # [s]
_MAX_MOTION_HZ = 1.0  # 1/10 of the lowest anti-resonance of the built-in rig
_MAX_LINK_SPEED = 1.8  # [rad/s] of a motion
_MAX_LINK_EXCURSION = 1.2  # [rad] of a motion
_STEP_VOLTAGE_SHARES = {"tuning": 0.48, "check": 0.72}  # kp times the step over the limit
STEP_HOLD = 0.5  # [s] per level


def simulate_study_file(
    study_path: Path,
    parameters_path: Path,
    folder: Path,
    *,
    seed: int,
    ideal: bool,
    progress: Progress,
) -> int:
    """Simulate every experiment of a study file with the parameters of a file.

    `seed` is that of sensor noise and motions, `ideal` means sensors without errors, and `progress`
    receives the current activity. Returns the number of logs. Raises InvalidInput if a file, a
    parameter or the folder is invalid.
    """
    if folder.resolve() == study_path.resolve().parent:
        raise InvalidInput(
            "the simulated logs would overwrite the measured ones",
            where=f"--out {folder}",
            remedy="choose a directory other than that of the study",
        )
    study = studies.read_study(study_path, logs_exist=False)
    values = read_parameters(parameters_path)
    noise = None if ideal else SensorNoise()
    return simulate_study(study, values, folder, seed=seed, noise=noise, progress=progress)


def simulate_study(
    study: Study,
    values: Values,
    folder: Path,
    *,
    seed: int = 0,
    noise: SensorNoise | None = None,
    as_recorded: bool = True,
    simulator: Simulator = simulate,
    sample_time: float = _FAST_SAMPLE_TIME,
    progress: Progress = lambda _: None,
) -> int:
    """Simulate every experiment of a study; write its logs and study.toml to a folder.

    Without `noise` the sensors are ideal. With `as_recorded`, existing logs and plans determine the
    inputs. `simulator` is the engine. `sample_time` [s] is the largest of records that resolve the
    vibration of the gears. Returns the number of logs. Raises InvalidInput if a parameter is
    missing or impossible, if an experiment cannot be simulated, or if the folder cannot be written.
    """
    arm = Arm.of(with_known_constants(study.arm, values))
    experiments: list[Experiment] = []
    logs_columns = []
    for number, experiment in enumerate(study.experiments):
        progress(f"simulating {experiment.name}, {number + 1} of {len(study.experiments)}")
        rng = np.random.default_rng([seed, number])
        if arm.position_servo is not None:
            logs_columns.append(record_servo(study, arm, experiment, values, rng))
        else:
            plan = _existing_plan(study, arm, experiment, values) if as_recorded else None
            plan = plan or default_plan(study.path, arm, experiment, values, rng, sample_time)
            name, payload = experiment.name, experiment.payload
            columns = record_experiment(
                study, arm, plan, values, noise, rng, simulator, name, payload
            )
            logs_columns.append(columns)
        file = Path(experiment.file).name
        if not file.endswith(_WRITABLE_FORMATS):
            file = f"{Path(file).stem}.parquet"
        if file.casefold() in (each.file.casefold() for each in experiments):
            file = f"{number + 1}-{file}"  # the other one is of another folder, or has capitals
        experiments.append(replace(experiment, file=file, start=None, stop=None, add={}, steps=()))
    for experiment, columns in zip(experiments, logs_columns, strict=True):
        logs.write_log(folder / experiment.file, columns)
    copy = studies.copy_to(study, folder)
    copy = replace(copy, experiments=tuple(experiments), channels={})
    studies.write_study(copy, copy.path)
    return len(experiments)


def demonstrate(
    folder: Path,
    *,
    seed: int,
    progress: Progress,
    figures: bool = False,
    built_in: BuiltInArm = SOFT,
) -> tuple[Identification, Values]:
    """Simulate a built-in arm, identify it from the files, and write the report.

    The folder gets the logs, study.toml, result.json and report.html, with `figures` also all
    figures as files. The true values of the identified parameters are returned second.
    """
    values, study = built_in.parameters(), built_in.study(folder)
    simulate_study(
        study, values, folder, seed=seed, noise=SensorNoise(), as_recorded=False, progress=progress
    )

    def follow(event: ProgressEvent) -> None:
        progress(str(event))

    identification = pipeline.identify(folder / "study.toml", progress=follow)
    pipeline.write(identification, folder, figures=figures, progress=follow)
    return identification, derived(values, study.arm)


def derived(values: Values, arm: ArmDescription) -> Values:
    """Known values with the combinations that identification reports, (3), (18)."""
    return values | {key: value_of(row, values) for key, row in reported(arm).items()}


def _existing_plan(study: Study, arm: Arm, experiment: Experiment, values: Values) -> Plan | None:
    """Plan of an experiment from its log or its table of inputs; None if there is neither."""
    if study.log_path(experiment).exists():
        log = logs.read_log(study, replace(experiment, steps=experiment.merges))  # held inputs
        return Plan(recorded_drive(arm, log), log.sample_time, len(log))
    drive = read_applied(study.path.parent, arm, experiment, values)
    if drive is None:
        return None
    is_fast = experiment.use in ("frequency", "sweep") or experiment.joint is not None
    samples_per_tick = int(np.ceil(drive.tick / _FAST_SAMPLE_TIME - 1e-9)) if is_fast else 1
    return Plan(drive, drive.tick / samples_per_tick, samples_per_tick * len(drive.voltage))


@dataclass(frozen=True, slots=True)
class Plan:
    """One experiment to simulate."""

    drive: Drive
    sample_time: float  # [s]
    samples: int


def default_plan(
    path: Path,
    arm: Arm,
    experiment: Experiment,
    values: Values,
    rng: np.random.Generator,
    fast_sample: float,
) -> Plan:
    """Excitation of an experiment by its use.

    `path` is the study's, for messages; `values` give the voltage that holds the arm at the start.
    `fast_sample` [s] is the largest sample time of records that resolve the vibration of the gears.
    Raises InvalidInput if the experiment needs a missing servo, or if it would move joints in open
    loop without an input.
    """
    period = arm.servo.period if arm.servo else 1e-3
    if experiment.use in ("frequency", "sweep"):
        prbs = experiment.prbs or Prbs(10, 1e-3, 4, arm.servo.limit if arm.servo else 10.0)
        tick, excited = prbs.clock, excitation.prbs(prbs)
        sample_time = min(fast_sample, tick)
    elif experiment.joint is not None:
        tick, excited = period, _steps(path, arm, experiment)
        sample_time = min(fast_sample, tick)
    else:
        tick, excited = period, np.zeros(round(MOTION_DURATION / period))
        sample_time = tick
    voltage = np.zeros((len(excited), arm.n_joints))
    reference = np.zeros_like(voltage)
    for i in range(arm.n_joints):
        if experiment.joint == i + 1:
            (voltage if experiment.use in ("frequency", "sweep") else reference)[:, i] = excited
        elif experiment.joint is None and experiment.control[i] == "servo":
            reference[:, i] = smooth_reference(arm.joints[i].gear_ratio, tick, rng)
        elif experiment.joint is None:
            raise InvalidInput(
                f"experiment {experiment.name!r} moves joint {i + 1} in open loop and has no log",
                where=str(path),
                remedy='set its control to "servo", or provide a log with the input to apply',
            )
    start = (0.0,) * arm.n_joints
    drive = Drive(
        tick=tick,
        voltage=voltage,
        reference=reference,
        servo=tuple(control == "servo" for control in experiment.control),
        motor_angle=start,
        initial_voltage=arm.holding_voltage(values, start),
    )
    return Plan(drive, sample_time, round(len(excited) * tick / sample_time))


def smooth_reference(gear_ratio: float, tick: float, rng: np.random.Generator) -> FloatArray:
    """Velocity reference [rad/s, motor side] of a rigid-motion record, one value per tick."""
    return excitation.smooth_motion(
        duration=MOTION_DURATION,
        clock=tick,
        top_hz=_MAX_MOTION_HZ,
        excursion=_MAX_LINK_EXCURSION / abs(gear_ratio),
        speed=_MAX_LINK_SPEED / abs(gear_ratio),
        rng=rng,
    )


def _steps(path: Path, arm: Arm, experiment: Experiment) -> FloatArray:
    """A step of the reference and back that does not saturate the servo."""
    if arm.servo is None:
        raise InvalidInput(
            f"experiment {experiment.name!r} needs a servo",
            where=str(path),
            remedy="add a [servo] table",
        )
    kp = arm.servo.kp[(experiment.joint or 1) - 1]
    level = (
        _STEP_VOLTAGE_SHARES.get(experiment.use, _STEP_VOLTAGE_SHARES["tuning"])
        * arm.servo.limit
        / max(kp, 1e-9)
    )
    levels = np.array([0.0, level, 0.0])
    return excitation.steps(levels, hold=STEP_HOLD, clock=arm.servo.period)


class Simulator(Protocol):
    """Engine of a virtual arm: `strainwave.dynamics.simulation.simulate` or another one."""

    def __call__(
        self,
        arm: Arm,
        values: Values,
        drive: Drive,
        /,
        *,
        sample_time: float,
        samples: int,
        record: Sequence[Quantity],
    ) -> Trajectory:
        """Motion of the arm."""


def record_experiment(
    study: Study,
    arm: Arm,
    plan: Plan,
    values: Values,
    noise: SensorNoise | None,
    rng: np.random.Generator,
    simulator: Simulator,
    name: str = "",
    payload: Payload | None = None,
) -> dict[str, FloatArray]:
    """Simulate one experiment and return its log by channel.

    The channels of `study` state which links have encoders. `name` is that of the record, for
    record effects, `payload` the mass on the last link. Without `noise` the sensors are ideal.
    Raises InvalidInput if a parameter is missing or impossible, or if an IMU has no position and
    attitude.
    """
    axes = [
        axis for i in range(1, arm.n_joints + 1) for axis in installed_axes(arm, i, study.channels)
    ]
    for axis in axes:
        sensor = axis.sensor
        if isinstance(sensor, ImuSensor) and (sensor.xyz is None or sensor.rpy is None):
            raise InvalidInput(
                f"the IMU on link {axis.joint} has no position and attitude for the simulation",
                where=str(study.path),
                remedy="set its xyz and rpy; identification does not need them",
            )
    record: list[Quantity] = ["voltage", "encoder", "link_angle"]
    record += [name for axis in axes for name in axis.quantities]
    is_hanging = plan.drive.link_angle is None
    inputs = record_inputs(arm, values, name, hanging=is_hanging, payload=payload)
    trajectory = simulator(
        arm,
        inputs.values,
        inputs.shift_start(plan.drive),
        sample_time=plan.sample_time,
        samples=plan.samples,
        record=list(dict.fromkeys(record)),
    )
    measured = measure(trajectory, noise, rng)
    measured["encoder"] = inputs.read(measured["encoder"])
    measured["link_angle"] = inputs.read(measured["link_angle"], arm)
    columns = {"t": trajectory.time}
    for i, joint in enumerate(arm.joints):
        name = f"u{i + 1}" if joint.torque_per_volt else f"torque{i + 1}"
        columns[name] = measured["voltage"][:, i]
    for i in range(arm.n_joints):
        columns[f"theta_m{i + 1}"] = measured["encoder"][:, i]
    for axis in (axis for axis in axes if not axis.is_mounted):
        reading, count = axis.reading(measured, {}), axis.sensor.resolution
        columns[axis.channel] = count * np.round(reading / count) if count else reading
    imu_axes = [axis for axis in axes if axis.is_mounted]
    columns |= _imu_readings(imu_axes, trajectory, noise, rng)
    if any(plan.drive.servo):
        tick = np.floor(trajectory.time / plan.drive.tick + 1e-9).astype(int)
        for i in range(arm.n_joints):
            columns[f"ref{i + 1}"] = plan.drive.reference[tick, i]
    return columns


def _imu_readings(
    axes: Sequence[SensorAxis],
    trajectory: Trajectory,
    noise: SensorNoise | None,
    rng: np.random.Generator,
) -> dict[str, FloatArray]:
    """Readings of the axes of IMUs by channel. Gravity across the plane is part of the biases."""
    columns: dict[str, FloatArray] = {}
    kinds: tuple[tuple[type[ImuSensor], Quantity], ...] = (
        (ImuAccelerometers, "accelerometer"),
        (ImuGyros, "gyro"),
    )
    for kind, quantity in kinds:
        kind_axes = [axis for axis in axes if isinstance(axis.sensor, kind)]
        if not kind_axes:
            continue
        ideal = [axis.reading(trajectory.quantities, {}) for axis in kind_axes]
        readings = Trajectory(trajectory.time, {quantity: np.column_stack(ideal)})
        for axis, column in zip(kind_axes, measure(readings, noise, rng)[quantity].T, strict=True):
            columns[axis.channel] = column
    return columns
