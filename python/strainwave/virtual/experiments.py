"""Experiments on a virtual arm: study and parameters in; logs and a study to identify from out.

An experiment whose log is there is run again with the log's references and open-loop voltages; one
that was planned and not recorded yet with what was planned; any other gets an excitation that fits
its use.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from strainwave import pipeline
from strainwave.domain import (
    ArmDescription,
    Experiment,
    FloatArray,
    Identification,
    Joint,
    Prbs,
    Study,
)
from strainwave.domain.combinations import reported, value_of
from strainwave.domain.parameters import Values
from strainwave.domain.progress import ProgressEvent
from strainwave.dynamics import excitation
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.mounting import Axis, axes_of, factors
from strainwave.dynamics.simulation import (
    Drive,
    Quantity,
    SensorNoise,
    Trajectory,
    measure,
    simulate,
)
from strainwave.errors import InvalidInput
from strainwave.experiment_design.command_table import read_applied
from strainwave.io import logs
from strainwave.io import study as studies
from strainwave.io.parameters import read_parameters
from strainwave.signals.recorded_input import recorded_drive
from strainwave.virtual import scara

Progress = Callable[[str], None]
Simulator = Callable[..., Trajectory]
"""Called as `strainwave.dynamics.simulation.simulate` is."""

_FAST_SAMPLE = 2.5e-4  # [s] where the gears' vibration is to be seen
_MOTION_SECONDS = 10.0
_MOTION_TOP_HZ = 1.0
_MOTION_SPEED = 1.8  # [rad/s] of a link
_MOTION_EXCURSION = 1.2  # [rad] of a link
_STEP_SHARE = {"tuning": 0.48, "check": 0.72}  # of the limit that kp times the step takes
_STEP_SECONDS = 0.5
_WRITABLE = (".csv", ".csv.gz", ".parquet")


@dataclass(frozen=True, slots=True)
class _Plan:
    """One experiment as it is to be run."""

    drive: Drive
    sample_time: float
    samples: int


def simulate_study_file(
    study_path: Path,
    parameters_path: Path,
    folder: Path,
    *,
    seed: int,
    ideal: bool,
    progress: Progress,
) -> int:
    """Run every experiment of a study file on an arm whose parameters a file holds.

    Parameters
    ----------
    study_path, parameters_path, folder : Path
    seed : int
        Of the sensors' noise and of the motions.
    ideal : bool
        Sensors without noise.
    progress : callable
        Called with what is being done.

    Returns
    -------
    int
        How many logs were written.

    Raises
    ------
    InvalidInput
        A file, a parameter or the folder is at fault.
    """
    if folder.resolve() == study_path.resolve().parent:
        raise InvalidInput(
            "would write simulated logs over the measured ones",
            where=f"--out {folder}",
            remedy="choose another directory than the study's",
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
    sample_time: float = _FAST_SAMPLE,
    progress: Progress = lambda _: None,
) -> int:
    """Run every experiment of a study on a virtual arm; write its logs and study.toml to a folder.

    Parameters
    ----------
    study : Study
    values : dict
        (name, joint) -> value.
    folder : Path
        Made where it does not exist.
    seed : int
    noise : SensorNoise, optional
        Ideal sensors without.
    as_recorded : bool
        Where an experiment's log exists, apply what was applied then, and where its plan exists,
        what was planned; not an excitation of its use.
    simulator : callable
        What the arm moves by.
    sample_time : float [s]
        At most, where the gears' vibration is to be seen.
    progress : callable

    Returns
    -------
    int
        How many logs were written.

    Raises
    ------
    InvalidInput
        A parameter is missing or impossible, an experiment cannot be simulated, or the folder
        cannot be written to.
    """
    arm = Arm.of(study.arm)
    experiments = []
    written = []
    for number, experiment in enumerate(study.experiments):
        progress(f"simulating {experiment.name}, {number + 1} of {len(study.experiments)}")
        rng = np.random.default_rng([seed, number])
        plan = _known(study, arm, experiment, values) if as_recorded else None
        plan = plan or _invent(study.path, arm, experiment, values, rng, sample_time)
        written.append(_columns(study, arm, plan, values, noise, rng, simulator))
        file = Path(experiment.file).name
        if not file.endswith(_WRITABLE):
            file = f"{Path(file).stem}.parquet"
        experiments.append(replace(experiment, file=file, start=None, stop=None, add={}))
    for experiment, columns in zip(experiments, written, strict=True):
        logs.write_log(folder / experiment.file, columns)
    copy = replace(study, path=folder / "study.toml", experiments=tuple(experiments), channels={})
    studies.write_study(copy, copy.path)
    return len(experiments)


def demonstrate(
    folder: Path, *, seed: int, progress: Progress, figures: bool = False
) -> tuple[Identification, Values]:
    """The main job on the built-in arm: simulate, identify from the files, report.

    Parameters
    ----------
    folder : Path
        Gets the logs, study.toml, result.json and report.html.
    seed : int
    progress : callable
    figures : bool
        Whether every figure becomes a file, too.

    Returns
    -------
    Identification
    dict
        The true values of what was identified, by (name, joint).
    """
    values = scara.parameters()
    study = scara.study(folder)
    simulate_study(
        study, values, folder, seed=seed, noise=SensorNoise(), as_recorded=False, progress=progress
    )

    def follow(event: ProgressEvent) -> None:
        progress(str(event))

    identification = pipeline.identify(folder / "study.toml", progress=follow)
    pipeline.write(identification, folder, figures=figures, progress=follow)
    return identification, derived(values, study.arm)


def derived(values: Values, arm: ArmDescription) -> Values:
    """Known values, with the combinations of them that identification reports.

    Parameters
    ----------
    values : dict
        (name, joint) -> value, as simulated.
    arm : ArmDescription

    Returns
    -------
    dict
        With `rigid_inertia`, `total_viscous_friction` and `link_inertia` (3), (18).
    """
    return values | {key: value_of(row, values) for key, row in reported(arm).items()}


def _known(study: Study, arm: Arm, experiment: Experiment, values: Values) -> _Plan | None:
    """What was applied, by the log, or what is to be, by the plan; None: there is neither."""
    if study.log_path(experiment).exists():
        log = logs.read_log(study, experiment)
        return _Plan(recorded_drive(arm, log), log.sample_time, len(log))
    drive = read_applied(study.path.parent, arm, experiment, values)
    if drive is None:
        return None
    fast = experiment.use in ("frequency", "sweep") or experiment.joint is not None
    looks = int(np.ceil(drive.tick / _FAST_SAMPLE - 1e-9)) if fast else 1  # a tick
    return _Plan(drive, drive.tick / looks, looks * len(drive.voltage))


def _invent(
    path: Path,
    arm: Arm,
    experiment: Experiment,
    values: Values,
    rng: np.random.Generator,
    fast_sample: float,
) -> _Plan:
    """An excitation that fits the experiment's use."""
    period = arm.servo.period if arm.servo else 1e-3
    if experiment.use in ("frequency", "sweep"):
        prbs = experiment.prbs or Prbs(10, 1e-3, 4, arm.servo.limit if arm.servo else 10.0)
        tick, excited = prbs.clock, excitation.prbs(prbs)
        sample_time = min(fast_sample, tick)
    elif experiment.joint is not None:
        tick, excited = period, _steps(path, arm, experiment)
        sample_time = min(fast_sample, tick)
    else:
        tick, excited = period, np.zeros(round(_MOTION_SECONDS / period))
        sample_time = tick
    voltage = np.zeros((len(excited), arm.n_joints))
    reference = np.zeros_like(voltage)
    for i in range(arm.n_joints):
        if experiment.joint == i + 1:
            (voltage if experiment.use in ("frequency", "sweep") else reference)[:, i] = excited
        elif experiment.joint is None and experiment.control[i] == "servo":
            reference[:, i] = _motion(arm, i, tick, rng)
        elif experiment.joint is None:
            raise InvalidInput(
                f"experiment {experiment.name!r} moves joint {i + 1} in open loop, without a log",
                where=str(path),
                remedy='set its control to "servo", or give a log whose input is applied again',
            )
    still = (0.0,) * arm.n_joints
    drive = Drive(
        tick=tick,
        voltage=voltage,
        reference=reference,
        servo=tuple(control == "servo" for control in experiment.control),
        motor_angle=still,
        initial_voltage=arm.holding_voltage(values, still),
    )
    return _Plan(drive, sample_time, round(len(excited) * tick / sample_time))


def _motion(arm: Arm, i: int, tick: float, rng: np.random.Generator) -> FloatArray:
    n = arm.joints[i].gear_ratio
    return excitation.smooth_motion(
        duration=_MOTION_SECONDS,
        clock=tick,
        top_hz=_MOTION_TOP_HZ,
        excursion=_MOTION_EXCURSION / n,
        speed=_MOTION_SPEED / n,
        rng=rng,
    )


def _steps(path: Path, arm: Arm, experiment: Experiment) -> FloatArray:
    """There and back: a step of the reference that the servo can follow without its limit."""
    if arm.servo is None:
        raise InvalidInput(
            f"experiment {experiment.name!r} needs a servo",
            where=str(path),
            remedy="add a [servo] table",
        )
    kp = arm.servo.kp[(experiment.joint or 1) - 1]
    level = _STEP_SHARE.get(experiment.use, 0.48) * arm.servo.limit / max(kp, 1e-9)
    levels = np.array([0.0, level, 0.0])
    return excitation.steps(levels, hold=_STEP_SECONDS, clock=arm.servo.period)


def _columns(
    study: Study,
    arm: Arm,
    plan: _Plan,
    values: Values,
    noise: SensorNoise | None,
    rng: np.random.Generator,
    simulator: Simulator,
) -> dict[str, FloatArray]:
    """Run one experiment; its log by channel."""
    quantities: dict[str, Quantity] = {"theta_m": "encoder"}
    if any(joint.accelerometer_distance for joint in arm.joints):
        quantities["a"] = "accelerometer"
    if any(joint.gyro_hz for joint in arm.joints):
        quantities["gyro"] = "gyro"
    record: list[Quantity] = ["voltage", "link_angle", *quantities.values()]
    glued = [axis for i in range(1, arm.n_joints + 1) for axis in _glued(study.path, arm, i)]
    record += dict.fromkeys(name for axis in glued for name in axis.quantities)
    trajectory = simulator(
        arm, values, plan.drive, sample_time=plan.sample_time, samples=plan.samples, record=record
    )
    measured = measure(trajectory, noise, rng)
    columns = {"t": trajectory.time}
    for i, joint in enumerate(arm.joints):
        name = f"u{i + 1}" if joint.torque_per_volt else f"torque{i + 1}"
        columns[name] = measured["voltage"][:, i]
    for channel, quantity in quantities.items():
        for i, joint in enumerate(arm.joints):
            if _declares(joint, quantity):
                columns[f"{channel}{i + 1}"] = measured[quantity][:, i]
    columns |= _imus(arm, glued, trajectory, noise, rng)
    for i, joint in enumerate(arm.joints):
        link = measured["link_angle"][:, i]
        if f"theta_l{i + 1}" in study.channels:
            columns[f"theta_l{i + 1}"] = link
        if f"deflection{i + 1}" in study.channels:
            columns[f"deflection{i + 1}"] = link - joint.gear_ratio * measured["encoder"][:, i]
    if any(plan.drive.servo):
        at = np.floor(trajectory.time / plan.drive.tick + 1e-9).astype(int)
        for i in range(arm.n_joints):
            columns[f"ref{i + 1}"] = plan.drive.reference[at, i]
    return columns


def _declares(joint: Joint, quantity: Quantity) -> bool:
    """Whether a joint has the sensor that reads a quantity."""
    if quantity == "accelerometer":
        return joint.motion == "prismatic" or joint.accelerometer_distance is not None
    return quantity != "gyro" or joint.gyro_hz is not None


def _glued(path: Path, arm: Arm, joint: int) -> list[Axis]:
    """Every axis of a link's IMU."""
    imu = arm.joints[joint - 1].imu
    if imu is None:
        return []
    if imu.xyz is None or imu.rpy is None:
        raise InvalidInput(
            f"the IMU on link {joint} has no place to be simulated at",
            where=str(path),
            remedy="give its xyz and rpy; they may be left out again for identification",
        )
    kinds = ("ax", "ay", "az", "gx", "gy", "gz")
    return list(axes_of([f"{kind}{joint}" for kind in kinds], arm, joint))


def _imus(
    arm: Arm,
    axes: Sequence[Axis],
    trajectory: Trajectory,
    noise: SensorNoise | None,
    rng: np.random.Generator,
) -> dict[str, FloatArray]:
    """What the axes of IMUs write down, by channel; gravity across the plane is in their biases."""
    columns: dict[str, FloatArray] = {}
    kinds: tuple[tuple[str, Quantity], ...] = (("accelerometer", "accelerometer"), ("gyro", "gyro"))
    for kind, quantity in kinds:
        own = [axis for axis in axes if axis.kind == kind]
        if not own:
            continue
        ideal = [
            sum(
                count * trajectory[name][:, axis.joint - 1]
                for count, name in zip(factors(axis, arm, {}), axis.quantities, strict=True)
            )
            for axis in own
        ]
        readings = Trajectory(trajectory.time, {quantity: np.column_stack(ideal)})
        for axis, column in zip(own, measure(readings, noise, rng)[quantity].T, strict=True):
            columns[axis.channel] = column
    return columns
