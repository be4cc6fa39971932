"""What the stages of a run start from, and the reporter of their times and progress.

The input check: defects of sensors and loggers, and the consistency of the channels.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TypeVar

import numpy as np

from strainwave import input_check
from strainwave.domain import (
    Clause,
    Consistency,
    Diagnostic,
    Experiment,
    InputCheck,
    Log,
    Place,
    Stage,
    Study,
    Use,
)
from strainwave.domain.arm.parameters import complete_values
from strainwave.domain.keys import Key, Values, label_of
from strainwave.domain.results.identification import merge_by_cause
from strainwave.domain.study import Progress, ProgressEvent
from strainwave.dynamics.arm import Arm
from strainwave.errors import InvalidInput, NumericalFailure
from strainwave.io import logs
from strainwave.io.logs.arrays import Data
from strainwave.io.study import read_study, with_options
from strainwave.numerics.parallel import one_blas_thread
from strainwave.signals import hygiene

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class Inputs:
    """A study, its arm, its usable records and the requested stages."""

    study: Study
    arm: Arm
    logs: tuple[Log, ...]
    stages: tuple[Stage, ...]
    start: Mapping[Key, float] = field(default_factory=dict)  # of the whole-arm fit, if given

    def logs_of(self, *uses: Use) -> list[Log]:
        """Records of the given uses, in the order of the study."""
        return [log for log in self.logs if log.experiment.use in uses]

    @property
    def place(self) -> Place:
        """The study file."""
        return Place(file=str(self.study.path))


def with_sensed_torques(study: Study, logs: Sequence[Log]) -> tuple[Study, tuple[Log, ...]]:
    """Take torques of rigid joints from sensors behind the gears where logs lack those of motors.

    The channel `torque{i}` is then that of the sensor, on the motor's side of the gear: N C' tau_l.
    Raises InvalidInput if other logs have the torque of that motor, which includes its friction.
    """
    arm, numbers = Arm.of(study.arm), range(1, study.arm.n_joints + 1)

    def has_motor(log: Log, i: int) -> bool:
        return f"torque{i}" in log.channels or f"u{i}" in log.channels

    sensed = [i for i in numbers if not any(has_motor(log, i) for log in logs)]
    for log in logs:
        lacking = [i for i in numbers if i not in sensed and not has_motor(log, i)]
        if lacking:
            raise InvalidInput(
                f"the log has only the sensor's torque of joint {lacking[0]}, and others have that "
                "of the motor",
                where=log.name,
                remedy=f"remove torque{lacking[0]} from [channels] to use the sensor of all logs, "
                "or remove this log",
            )
    if not sensed or not logs or study.arm.position_servo is not None:
        return study, tuple(logs)
    if arm.is_coupled and len(sensed) < arm.n_joints:
        raise InvalidInput(
            f"joint {sensed[0]} has only the torque of its sensor, but motors turn several joints",
            where=str(study.path),
            remedy="log the torques of all sensors (tau_l), or those of all motors",
        )
    converted = []
    for log in logs:
        none = np.zeros(len(log))
        at_links = np.column_stack([log.channels.get(f"tau_l{i}", none) for i in numbers])
        at_motors = arm.motors_of(at_links)
        channels = {f"torque{i}": at_motors[:, i - 1] for i in sensed}
        masked = {
            f"torque{i}": log.masked[f"tau_l{i}"] for i in sensed if f"tau_l{i}" in log.masked
        }
        place = Place.in_records(log.name)
        converted.append(
            replace(
                log,
                channels={**log.channels, **channels},
                masked={**log.masked, **masked},
                warnings=(*log.warnings, Diagnostic("torque-at-link", place, joints=tuple(sensed))),
            )
        )
    described = study.arm
    for i in sensed:
        described = described.with_joint(i, torque_at_link=True)
    return replace(study, arm=described), tuple(converted)


def read_records(
    study: Study, experiments: Sequence[Experiment] | None = None, *, data: Data | None = None
) -> tuple[Study, tuple[Log, ...]]:
    """The logs of a study, and the study with one experiment per log; see `logs.read_logs`."""
    study, read = with_sensed_torques(study, logs.read_logs(study, experiments, data=data))
    return study.with_segments(log.experiment for log in read), read


def read_start(start: Path | Mapping[Key, float] | None, study: Study) -> Values:
    """Values at which the whole-arm fit starts, from a parameter file or as they are.

    Other values of a result.json, such as combinations and sensor constants, are left out. Raises
    InvalidInput if none of the values is a parameter of the arm.
    """
    if start is None:
        return {}
    from strainwave.io.parameters import read_parameters

    values = read_parameters(start) if isinstance(start, Path) else dict(start)
    arm = study.arm.with_selected_laws(values.keys())
    given = complete_values(values, arm)
    known = set(Arm.of(arm).parameter_names)
    values = {key: value for key, value in given.items() if key in known}
    if not values:
        names = ", ".join(label_of(*key) for key in list(known)[:4])
        raise InvalidInput(
            "no value is a parameter of this arm",
            where=str(start) if isinstance(start, Path) else "start",
            remedy=f"give parameters such as {names}",
        )
    return values


def check_inputs(
    study: Study, raw_logs: Sequence[Log], stages: tuple[Stage, ...] = ()
) -> tuple[Inputs, Consistency]:
    """Mask defects of sensors and loggers, and check the consistency of the channels.

    Returns the records that the stages use, and the consistency with the warnings of both checks.
    """
    arm = Arm.of(study.arm)
    usable, warnings = hygiene.repair_records(raw_logs, arm)
    if raw_logs and not usable:
        causes = "; ".join(dict.fromkeys(f"{each.where}: {each.observation}" for each in warnings))
        raise InvalidInput(
            f"no record is usable ({causes})",
            where=str(study.path),
            remedy="correct the sensor or its cable, and record again",
        )
    warnings = (*(warning for log in raw_logs for warning in log.warnings), *warnings)
    agreement = Consistency()  # no relation of a position servo holds for all parameter values
    if study.arm.position_servo is None:
        agreement = input_check.check_consistency(usable, study)
    agreement = agreement.suspecting(accept=study.options.accept)
    agreement = replace(agreement, warnings=(*warnings, *agreement.warnings))
    return Inputs(study, arm, usable, stages), agreement


def check_input(
    study: Study | Path, *, data: Data | None = None, options: Sequence[str] | None = None
) -> InputCheck:
    """Check the input of a study without identification.

    `options` changes those of the study, as in `identify`; `data` maps names of experiments to
    logs, tables in memory or paths that replace the study's files. Raises `InvalidInput` if the
    study or a log is invalid. Input that contradicts itself raises no error: `suspected` lists the
    faults.
    """
    begin = time.perf_counter()
    with one_blas_thread():
        given = study if isinstance(study, Study) else read_study(study)
        given = given if options is None else with_options(given, options)
        given, raw_logs = read_records(given, data=data)
        _, consistency = check_inputs(given, raw_logs)
    return InputCheck(
        study=given,
        relations=consistency.relations,
        suspected=consistency.suspected,
        warnings=merge_by_cause(dict.fromkeys(consistency.warnings)),
        unchecked=consistency.unchecked,
        seconds=time.perf_counter() - begin,
    )


def attempt(stage: Callable[[], T], failed: Callable[[Clause], T]) -> T:
    """The result of a stage, or of `failed` with the reason if its computation fails."""
    try:
        return stage()
    except NumericalFailure as failure:
        return failed(Clause("numerical-failure", reason=str(failure)))


class Reporter:
    """Measures the times of the parts of a run and reports its progress."""

    def __init__(self, stages: Sequence[Stage], progress: Progress) -> None:
        self.timing_s: dict[str, float] = {}
        planned = ["read", "consistency", "rigid", "checks"]
        if "decoupled" in stages:
            planned.append("decoupled")
        if "tuned" in stages:
            planned += ["tuned", "checks"]
        self._planned = [*planned, "report"]
        self._progress = progress
        self._n_started = 0  # parts started or skipped
        self._fraction = 0.0  # completed part of the run, from 0 to 1

    @contextmanager
    def time_part(self, part: str, activity: str) -> Iterator[None]:
        """Report the start of a part and measure its time."""
        self.report(part, activity)
        with self.measure_time(part):
            yield

    @contextmanager
    def measure_time(self, part: str) -> Iterator[None]:
        """Measure the time of a part that runs in parallel to another part."""
        begin = time.perf_counter()
        yield
        self.timing_s[part] = self.timing_s.get(part, 0.0) + time.perf_counter() - begin

    def report(self, part: str, activity: str, within: float = 0.0) -> None:
        """Report progress; `within` is the completed part of this part, from 0 to 1.

        Planned parts before this one that have not started count as skipped.
        """
        if part in self._planned[self._n_started :]:
            self._n_started = self._planned.index(part, self._n_started) + 1
        parts = len(self._planned)
        fraction = (self._n_started - 1 + min(within, 1.0)) / parts
        self._fraction = max(self._fraction, fraction)  # never decreases if a part takes longer
        self._progress(ProgressEvent(part, self._fraction, activity, self._n_started, parts))
