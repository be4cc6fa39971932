"""The input check: defects of sensors and loggers, and the consistency of the channels."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from strainwave.domain import Consistency, Diagnostic, InputCheck, Log, Stage, Study
from strainwave.domain.diagnostics import merge_by_cause
from strainwave.dynamics.arm import Arm
from strainwave.errors import InvalidInput
from strainwave.io import logs
from strainwave.io.logs.in_memory import Data
from strainwave.io.study import read_study, with_options
from strainwave.numerics.parallel import one_blas_thread
from strainwave.pipeline.inputs import Inputs, with_sensed_torques
from strainwave.signals import consistency, hygiene


@dataclass(frozen=True, slots=True)
class CheckedInputs:
    """The records that the stages use, and the consistency of their channels."""

    inputs: Inputs
    consistency: Consistency
    warnings: tuple[Diagnostic, ...]


def check_inputs(
    study: Study, raw_logs: Sequence[Log], stages: tuple[Stage, ...] = ()
) -> CheckedInputs:
    """Mask defects of sensors and loggers, and check the consistency of the channels."""
    arm = Arm.of(study.arm)
    usable, warnings = hygiene.repair_records(raw_logs, arm)
    if raw_logs and not usable:
        raise _nothing_usable(study, warnings)
    warnings = (*(warning for log in raw_logs for warning in log.warnings), *warnings)
    inputs = Inputs(study, arm, usable, stages)
    agreement = consistency.check_consistency(usable, study)
    agreement = agreement.suspecting(accept=study.options.accept)
    return CheckedInputs(inputs, agreement, (*warnings, *agreement.warnings))


def _nothing_usable(study: Study, warnings: Sequence[Diagnostic]) -> InvalidInput:
    """The error for a study whose records are all excluded."""
    causes = "; ".join(dict.fromkeys(f"{each.where}: {each.observation}" for each in warnings))
    return InvalidInput(
        f"no record is usable ({causes})",
        where=str(study.path),
        remedy="correct the sensor or its cable, and record again",
    )


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
        given, raw_logs = with_sensed_torques(given, logs.read_logs(given, data=data))
        given = given.with_segments(log.experiment for log in raw_logs)
        checked = check_inputs(given, raw_logs)
    return InputCheck(
        study=given,
        relations=checked.consistency.relations,
        suspected=checked.consistency.suspected,
        warnings=merge_by_cause(dict.fromkeys(checked.warnings)),
        unchecked=checked.consistency.unchecked,
        seconds=time.perf_counter() - begin,
    )
