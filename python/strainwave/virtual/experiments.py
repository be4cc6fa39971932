"""Simulate the experiments of a study on a virtual arm and write its logs and study file.

If the log of an experiment exists, its references and open-loop voltages are applied again. If a
plan exists, the plan is applied. Otherwise an excitation is chosen by the use of the experiment.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from strainwave import pipeline
from strainwave.domain import ArmDescription, Experiment, Identification, Study
from strainwave.domain.combinations import reported, value_of
from strainwave.domain.keys import Values
from strainwave.domain.options import ProgressEvent
from strainwave.domain.parameters import with_known_constants
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.simulation import SensorNoise, simulate
from strainwave.errors import InvalidInput
from strainwave.excite.command_table import read_applied
from strainwave.io import logs
from strainwave.io import study as studies
from strainwave.io.parameters import read_parameters
from strainwave.signals.recorded_input import recorded_drive
from strainwave.virtual.records import Plan, Simulator, default_plan, record_experiment
from strainwave.virtual.scara import SOFT, BuiltInArm

Progress = Callable[[str], None]

_FAST_SAMPLE_TIME = 2.5e-4  # [s] of records that resolve the vibration of the gears
_WRITABLE_FORMATS = (".csv", ".csv.gz", ".parquet")


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
    experiments = []
    logs_columns = []
    for number, experiment in enumerate(study.experiments):
        progress(f"simulating {experiment.name}, {number + 1} of {len(study.experiments)}")
        rng = np.random.default_rng([seed, number])
        plan = _existing_plan(study, arm, experiment, values) if as_recorded else None
        plan = plan or default_plan(study.path, arm, experiment, values, rng, sample_time)
        logs_columns.append(
            record_experiment(
                study, arm, plan, values, noise, rng, simulator, experiment.name, experiment.payload
            )
        )
        file = Path(experiment.file).name
        if not file.endswith(_WRITABLE_FORMATS):
            file = f"{Path(file).stem}.parquet"
        experiments.append(replace(experiment, file=file, start=None, stop=None, add={}))
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
        log = logs.read_log(study, experiment)
        return Plan(recorded_drive(arm, log), log.sample_time, len(log))
    drive = read_applied(study.path.parent, arm, experiment, values)
    if drive is None:
        return None
    is_fast = experiment.use in ("frequency", "sweep") or experiment.joint is not None
    samples_per_tick = int(np.ceil(drive.tick / _FAST_SAMPLE_TIME - 1e-9)) if is_fast else 1
    return Plan(drive, drive.tick / samples_per_tick, samples_per_tick * len(drive.voltage))
