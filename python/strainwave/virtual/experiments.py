"""Experiments on a virtual arm: study and parameters in; logs and a study to identify from out.

An experiment whose log is there is run again with the log's references and open-loop voltages; one
that was planned and not recorded yet with what was planned; any other gets an excitation that fits
its use.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from strainwave import pipeline
from strainwave.domain import (
    ArmDescription,
    Experiment,
    Identification,
    Study,
)
from strainwave.domain.combinations import reported, value_of
from strainwave.domain.parameters import Values
from strainwave.domain.progress import ProgressEvent
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.simulation import (
    SensorNoise,
    simulate,
)
from strainwave.errors import InvalidInput
from strainwave.experiment_design.command_table import read_applied
from strainwave.io import logs
from strainwave.io import study as studies
from strainwave.io.parameters import read_parameters
from strainwave.signals.recorded_input import recorded_drive
from strainwave.virtual import scara
from strainwave.virtual.plans import Plan, invented
from strainwave.virtual.records import Simulator, recorded

Progress = Callable[[str], None]

_FAST_SAMPLE = 2.5e-4  # [s] where the gears' vibration is to be seen
_WRITABLE = (".csv", ".csv.gz", ".parquet")


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

    `seed`: Of the sensors' noise and of the motions. `ideal`: Sensors without noise. `progress`:
    Called with what is being done. Returns: How many logs were written. Raises `InvalidInput`: A
    file, a parameter or the folder is at fault.
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

    `values`: (name, joint) -> value. `folder`: Made where it does not exist. `noise`: Ideal sensors
    without. `as_recorded`: Where an experiment's log exists, apply what was applied then, and where
    its plan exists, what was planned; not an excitation of its use. `simulator`: What the arm moves
    by. `sample_time` [s]: At most, where the gears' vibration is to be seen. Returns: How many logs
    were written. Raises `InvalidInput`: A parameter is missing or impossible, an experiment cannot
    be simulated, or the folder cannot be written to.
    """
    arm = Arm.of(study.arm)
    experiments = []
    written = []
    for number, experiment in enumerate(study.experiments):
        progress(f"simulating {experiment.name}, {number + 1} of {len(study.experiments)}")
        rng = np.random.default_rng([seed, number])
        plan = _known(study, arm, experiment, values) if as_recorded else None
        plan = plan or invented(study.path, arm, experiment, values, rng, sample_time)
        written.append(recorded(study, arm, plan, values, noise, rng, simulator, experiment.name))
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

    `folder`: Gets the logs, study.toml, result.json and report.html. `figures`: Whether every
    figure becomes a file, too. Returns: The true values of what was identified, by (name, joint).
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

    `values`: (name, joint) -> value, as simulated. Returns: With `rigid_inertia`,
    `total_viscous_friction` and `link_inertia` (3), (18).
    """
    return values | {key: value_of(row, values) for key, row in reported(arm).items()}


def _known(study: Study, arm: Arm, experiment: Experiment, values: Values) -> Plan | None:
    """What was applied, by the log, or what is to be, by the plan; None: there is neither."""
    if study.log_path(experiment).exists():
        log = logs.read_log(study, experiment)
        return Plan(recorded_drive(arm, log), log.sample_time, len(log))
    drive = read_applied(study.path.parent, arm, experiment, values)
    if drive is None:
        return None
    fast = experiment.use in ("frequency", "sweep") or experiment.joint is not None
    looks = int(np.ceil(drive.tick / _FAST_SAMPLE - 1e-9)) if fast else 1  # a tick
    return Plan(drive, drive.tick / looks, looks * len(drive.voltage))
