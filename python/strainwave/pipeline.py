"""The only file that knows the order: logs -> signals -> rigid -> report.

Each stage is one function from records to one record; this file calls them, keeps the time, and
decides what happens when one cannot answer.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path

from strainwave import __version__, logs, result, rigid, signals, study, validation
from strainwave.errors import InvalidInput, NotIdentifiable
from strainwave.files import write_whole
from strainwave.records import Identification, Log, Prediction, RigidModel, Study, Warning

STAGES = ("rigid",)
"""All stages, in order; a run takes a prefix of them."""

Progress = Callable[[str], None]
"""Called with what is being done, at the start of each part."""


def check_stages(names: Sequence[str]) -> tuple[str, ...]:
    """The stages to run, checked to be a prefix of all.

    Parameters
    ----------
    names : sequence of str

    Returns
    -------
    tuple of str

    Raises
    ------
    InvalidInput
        A stage that does not exist, or one whose predecessors are missing.
    """
    stages = tuple(names)
    if not stages or stages != STAGES[: len(stages)]:
        raise InvalidInput(
            f"cannot run the stages {', '.join(stages) or '(none)'}",
            where="--stages",
            remedy=f"name a beginning of this list, in its order: {', '.join(STAGES)}",
        )
    return stages


def identify(
    study_path: Path, *, stages: Sequence[str] = STAGES, progress: Progress = lambda _: None
) -> Identification:
    """Logs to models: every stage on one study.

    Parameters
    ----------
    study_path : Path
        The study file.
    stages : sequence of str
        A prefix of `STAGES`.
    progress : callable
        Told what is being done.

    Returns
    -------
    Identification
        With a `reason` where the data could not answer the whole question.

    Raises
    ------
    InvalidInput
        The study, a log or an argument is at fault.
    """
    run = _Run(check_stages(stages), progress)
    with run.timed("read", "reading the logs"):
        the_study = study.read_study(study_path)
        all_logs = logs.read_logs(the_study)
    for log in all_logs:
        run.warnings.extend(log.warnings)

    model: RigidModel | None = None
    fitted: tuple[Prediction, ...] = ()
    checks: tuple[Prediction, ...] = ()
    with run.timed("rigid", "rigid joints: least squares"):
        try:
            motion = [signals.motor_side(log, the_study) for log in _used_for(all_logs, "motion")]
            model = rigid.fit(motion, the_study)
            run.warnings.extend(model.warnings)
        except NotIdentifiable as failure:
            run.reasons.append(failure.reason)
    if model is not None:
        with run.timed("checks", "predicting the records it never saw"):
            fitted = _predictions(model, _used_for(all_logs, "motion"), the_study)
            checks = _predictions(model, _used_for(all_logs, "check"), the_study)
    return run.finish(the_study, model, fitted, checks)


def write(identification: Identification, folder: Path) -> None:
    """Result and report, both whole or neither.

    Parameters
    ----------
    identification : Identification
    folder : Path
        Made where it does not exist; an earlier result in it is replaced.

    Raises
    ------
    InvalidInput
        The folder cannot be written to.
    """
    from strainwave.report import render

    write_whole(
        folder,
        {
            "report.html": render(identification).encode(),
            "result.json": result.to_json(identification),
        },
    )


@dataclass
class _Run:
    """What accumulates while the stages run."""

    stages: tuple[str, ...]
    progress: Progress
    warnings: list[Warning] = field(default_factory=list)
    reasons: list[str] = field(default_factory=list)
    timing_s: dict[str, float] = field(default_factory=dict)

    @contextmanager
    def timed(self, part: str, said: str) -> Iterator[None]:
        self.progress(said)
        begin = time.perf_counter()
        yield
        self.timing_s[part] = time.perf_counter() - begin

    def finish(
        self,
        the_study: Study,
        model: RigidModel | None,
        fitted: tuple[Prediction, ...],
        checks: tuple[Prediction, ...],
    ) -> Identification:
        return Identification(
            study=the_study,
            created=datetime.now(UTC).isoformat(timespec="seconds"),
            version=__version__,
            stages=self.stages,
            rigid=model,
            fitted=fitted,
            checks=checks,
            warnings=tuple(self.warnings),
            timing_s=self.timing_s,
            reason="; ".join(self.reasons) or None,
        )


def _used_for(all_logs: Sequence[Log], use: str) -> list[Log]:
    return [log for log in all_logs if log.experiment.use == use]


def _predictions(
    model: RigidModel, chosen: Sequence[Log], the_study: Study
) -> tuple[Prediction, ...]:
    return tuple(validation.predict_rigid(model, log, the_study) for log in chosen)
