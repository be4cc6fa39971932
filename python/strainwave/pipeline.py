"""The only file that knows the order: logs -> signals -> rigid -> report.

Each stage is one function from records to one record; this file calls them, keeps the time, and
decides what happens when one cannot answer.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path

from strainwave import __version__, logs, result, rigid, signals, study, validation
from strainwave.errors import InvalidInput, NotIdentifiable
from strainwave.files import write_whole
from strainwave.records import Caution, Identification, Log, Prediction, RigidModel, Signals, Study

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
    predictions: dict[str, tuple[Prediction, ...]] = {}
    with run.timed("rigid", "rigid joints: least squares"):
        seen = {
            use: _signals(all_logs, use, the_study, run.warnings) for use in ("motion", "check")
        }
        try:
            model = rigid.fit(seen["motion"], the_study)
        except NotIdentifiable as failure:
            run.reasons.append(str(failure))
        else:
            run.warnings.extend(model.warnings)
            run.reasons.extend(_not_told(model))
    if model is not None and model.status != "not-identifiable":
        with run.timed("checks", "predicting the records it never saw"):
            for use, records in seen.items():
                predictions[use] = tuple(
                    validation.predict_rigid(model, record, the_study) for record in records
                )
                run.warnings.extend(c for made in predictions[use] for c in made.warnings)
    return run.finish(the_study, model, predictions.get("motion", ()), predictions.get("check", ()))


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

    begin = time.perf_counter()
    page = render(identification).encode()
    timing = {**identification.timing_s, "report": time.perf_counter() - begin}
    document = result.to_json(replace(identification, timing_s=timing))
    write_whole(folder, {"report.html": page, "result.json": document})


@dataclass
class _Run:
    """What accumulates while the stages run."""

    stages: tuple[str, ...]
    progress: Progress
    warnings: list[Caution] = field(default_factory=list)
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


def _signals(
    all_logs: Sequence[Log], use: str, the_study: Study, warnings: list[Caution]
) -> list[Signals]:
    """Motor-side signals of the records of one use, which have them."""
    found = []
    for log in all_logs:
        if log.experiment.use == use:
            found.append(signals.motor_side(log, the_study))
            warnings.extend(found[-1].warnings)
    return found


def _not_told(model: RigidModel) -> list[str]:
    """Why the question is not wholly answered, if it is not."""
    missing = [
        p.name if p.joint is None else f"{p.name} of joint {p.joint}"
        for p in model.parameters
        if p.value is None
    ]
    return [f"the motion records do not tell {', '.join(missing)}"] if missing else []
