"""Motion records with and without a payload -> torques per volt of the drives."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

from strainwave.domain import Clause, Diagnostic, DriveGains, Log, Study
from strainwave.dynamics.arm import Arm
from strainwave.errors import NotIdentifiable
from strainwave.identification import rigid
from strainwave.numerics.parallel import run_parallel
from strainwave.pipeline.reporter import Reporter
from strainwave.signals import hygiene
from strainwave.signals.motor import prepare_motor_signals


@dataclass(frozen=True, slots=True)
class DriveStage:
    """The study with the estimated torques per volt, on which the other stages build."""

    study: Study
    gains: DriveGains | None = None
    warnings: tuple[Diagnostic, ...] = ()
    failures: tuple[Clause, ...] = ()


def estimate_drives(study: Study, raw_logs: Sequence[Log], reporter: Reporter) -> DriveStage:
    """Estimate the unknown torques per volt of a study's arm.

    If the records do not determine them, the study is returned as it is, with the failure.
    """
    arm = Arm.of(study.arm)
    with reporter.time_part("rigid", "unknown drives: motions with and without payload"):
        usable, _ = hygiene.repair_records(raw_logs, arm)
        motions = [log for log in usable if log.experiment.use == "motion"]
        try:
            signals = run_parallel([partial(prepare_motor_signals, log, arm) for log in motions])
            gains = rigid.estimate_drive_gains(signals, arm)
        except NotIdentifiable as failure:
            return DriveStage(study, failures=(Clause("text", text=str(failure)),))
    return DriveStage(replace(study, arm=gains.of(study.arm)), gains, gains.warnings)
