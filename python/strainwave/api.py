"""The public API: a study in, a result out that shows, plots and saves itself.

The names are loaded when they are first asked for; `strainwave.pipeline` and the stages below it
are for those who need the records themselves.
"""

from __future__ import annotations

import contextvars
import copy
import queue
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any, overload

from strainwave import pipeline
from strainwave.domain import Diagnostic, Identification, Options, Parameter, Study, Verdict
from strainwave.domain.progress import Progress, ProgressEvent, ignored
from strainwave.errors import Cancelled, InvalidInput
from strainwave.io import results
from strainwave.io.atomic_files import nearest, write_whole
from strainwave.io.logs.in_memory import Data
from strainwave.io.study import checked_study
from strainwave.io.study import read_study as _read_study
from strainwave.numerics.parallel import Stopped, limited

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from pandas import DataFrame

_POLL = 0.05  # [s] between two looks at whether the run is still wanted


def read_study(path: Path | str) -> Study:
    """Read and check a study file; its logs are looked for when they are needed.

    Parameters
    ----------
    path : Path or str

    Returns
    -------
    Study

    Raises
    ------
    InvalidInput
        Anything in the file is at fault.
    """
    return _read_study(path, logs_exist=False)


def identify(
    study: Study | Path | str,
    *,
    data: Data | None = None,
    stages: Sequence[str] = pipeline.STAGES,
    options: Options | Mapping[str, Mapping[str, Any]] | Sequence[str] | None = None,
    progress: Progress = ignored,
    cancel: threading.Event | Callable[[], bool] | None = None,
    threads: int | None = None,
) -> Result:
    """Identify an arm: every stage on one study.

    Parameters
    ----------
    study : Study, Path or str
        Built in code, or the study file.
    data : mapping, optional
        Experiment's name -> its log: a pandas, polars or Arrow table, a dictionary of arrays, or a
        path. Experiments that it does not name are read from the study's files.
    stages : sequence of str
        The first of "rigid", "decoupled", "tuned".
    options : Options, mapping or sequence of str, optional
        In place of the study's [options]: all of them, those that change (stage -> key -> value),
        or "stage.key=value" as on the command line.
    progress : callable
        Gets a `ProgressEvent`, in the thread of this call.
    cancel : threading.Event or callable, optional
        Set, or returning true, when the answer is not wanted any more.
    threads : int, optional
        That may work at a time; one per core without. Campaigns of many workers give 1.

    Returns
    -------
    Result
        Its `status` says what the data answered and what not.

    Raises
    ------
    InvalidInput
        The study, a log or an argument is at fault.
    Cancelled
        `cancel` asked for the end; the call returns within a second, whatever was running.
    """
    if threads is not None and threads < 1:
        raise InvalidInput(f"threads is {threads}", remedy="give at least 1, or leave it out")
    checked = _study_of(study, data or {})
    events: queue.SimpleQueue[ProgressEvent] = queue.SimpleQueue()
    asked = cancel.is_set if isinstance(cancel, threading.Event) else cancel

    def run() -> Identification:
        return pipeline.identify(
            checked,
            data=data,
            stages=stages,
            options=options,
            progress=events.put,
            threads=threads,
        )

    def follow() -> None:
        while not events.empty():
            progress(events.get())

    return Result.of(_beside(run, asked or (lambda: False), follow))


def read_result(path: Path | str) -> Result:
    """What an earlier run identified.

    Parameters
    ----------
    path : Path or str
        A result.json.

    Returns
    -------
    Result
        Equal to the one that was saved. Its plots and its report need the records' samples, which
        the file does not hold: identify again for these.

    Raises
    ------
    InvalidInput
        The file is missing, or no result of strainwave.
    """
    return Result(results.read_document(Path(path)))


class Parameters(Sequence[Parameter]):
    """The final table: each parameter once, decided by the last stage that speaks of it."""

    def __init__(self, parameters: Sequence[Parameter]) -> None:
        self._parameters = tuple(parameters)

    def __len__(self) -> int:
        return len(self._parameters)

    @overload
    def __getitem__(self, index: int) -> Parameter: ...
    @overload
    def __getitem__(self, index: slice) -> Parameters: ...
    def __getitem__(self, index: int | slice) -> Parameter | Parameters:
        if isinstance(index, slice):
            return Parameters(self._parameters[index])
        return self._parameters[index]

    def __iter__(self) -> Iterator[Parameter]:
        return iter(self._parameters)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Parameters) and self._parameters == other._parameters

    def __hash__(self) -> int:
        return hash(self._parameters)

    def to_frame(self) -> DataFrame:
        """The table as a pandas frame.

        Returns
        -------
        pandas.DataFrame
            A row per parameter: name, joint, value, std, ci95_low, ci95_high, unit, stage.

        Raises
        ------
        InvalidInput
            pandas is not installed.
        """
        try:
            from pandas import DataFrame
        except ImportError as error:
            raise InvalidInput(
                "a frame needs pandas, which is not installed",
                remedy="pip install pandas, or iterate over the parameters",
            ) from error
        rows = []
        for one in self._parameters:
            low, high = one.ci95 or (None, None)
            row = asdict(one)
            del row["ci95"]
            rows.append(row | {"ci95_low": low, "ci95_high": high})
        columns = ["name", "joint", "value", "std", "ci95_low", "ci95_high", "unit", "stage"]
        numbers = dict.fromkeys(columns[2:6], "float64")
        return DataFrame(rows, columns=columns).astype(numbers | {"joint": "Int64"})

    def _repr_html_(self) -> str:
        from strainwave.presentation.notebook.tables import table_of_parameters

        return table_of_parameters(self._parameters)


class Result:
    """What a run identified: result.json as an object.

    Parameters
    ----------
    document : mapping
        In the layout of docs/result.md.
    run : Identification, optional
        The records behind it, where the run was just made; plots and the report need them.
    """

    def __init__(self, document: Mapping[str, Any], run: Identification | None = None) -> None:
        self._document = dict(document)
        self._parameters = Parameters(results.parameters_of(document))
        self.run = run

    @classmethod
    def of(cls, run: Identification) -> Result:
        """The result of a run."""
        return cls(results.to_document(run), run)

    @property
    def status(self) -> str:
        """What the data answered, as the exit code of the command line says it."""
        return str(self._document["status"])

    @property
    def reason(self) -> str | None:
        """Why the status is not "determined"."""
        reason = self._document["reason"]
        return None if reason is None else str(reason)

    @property
    def verdict(self) -> Verdict:
        """Which parameters are identified, which are not, and what is suspected of the input."""
        return results.verdict_of(self._document)

    @property
    def parameters(self) -> Parameters:
        """The final table; `result["gear_stiffness", 1]` takes one of it."""
        return self._parameters

    @property
    def warnings(self) -> tuple[Diagnostic, ...]:
        """What the reader must know to trust, or not trust, the numbers."""
        return results.warnings_of(self._document)

    @property
    def document(self) -> dict[str, Any]:
        """All of it as plain JSON values, in the layout of docs/result.md."""
        return copy.deepcopy(self._document)

    def __getitem__(self, key: str | tuple[str, int | None]) -> Parameter:
        """One parameter of the final table.

        Parameters
        ----------
        key : str or (str, int)
            "beta" of the arm, ("gear_stiffness", 1) of a joint.

        Raises
        ------
        KeyError
            The table has no such parameter; near names are listed.
        """
        name, joint = (key, None) if isinstance(key, str) else key
        for one in self._parameters:
            if (one.name, one.joint) == (name, joint):
                return one
        labels = [one.label for one in self._parameters]
        wanted = name if joint is None else f"{name} {joint}"
        hint = nearest(wanted, labels) or f"; there are {', '.join(labels)}"
        raise KeyError(f"no parameter {wanted!r}{hint}")

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Result) and self._document == other._document

    __hash__ = None  # type: ignore[assignment]

    def __repr__(self) -> str:
        known = sum(one.value is not None for one in self._parameters)
        return f"<Result: {self.status}, {known} of {len(self._parameters)} parameters>"

    def _repr_html_(self) -> str:
        from html import escape

        said = self.status if self.reason is None else f"{self.status}: {self.reason}"
        return f"<p>{escape(said)}</p>{self._parameters._repr_html_()}"

    def plot(self, kind: str, *, joint: int | None = None, experiment: str | None = None) -> Figure:
        """One of the report's figures.

        Parameters
        ----------
        kind : str
            The beginning of a figure's name: "bode", "gear", "check", "correlations", ...
        joint : int, optional
            From 1, where there is one figure per joint.
        experiment : str, optional
            Where there is one figure per record.

        Returns
        -------
        matplotlib.figure.Figure

        Raises
        ------
        InvalidInput
            There is no such figure, or the result was read from a file.
        """
        from strainwave.presentation.matplotlib_backend import draw
        from strainwave.presentation.report import figures_of, slug

        drawn = figures_of(self._needs_run("plots"))
        wanted = [kind]
        wanted += [f"joint-{joint}"] if joint is not None else []
        wanted += [experiment] if experiment is not None else []
        prefix = slug(" ".join(wanted))
        for name, one in drawn.items():
            if name == prefix or name.startswith(f"{prefix}-"):
                return draw(one)
        raise InvalidInput(
            f"there is no figure {prefix!r}", remedy=f"choose from: {', '.join(drawn)}"
        )

    def report(self, path: Path | str) -> Path:
        """Write the report: one HTML file.

        Parameters
        ----------
        path : Path or str

        Returns
        -------
        Path

        Raises
        ------
        InvalidInput
            The file cannot be written, or the result was read from a file.
        """
        from strainwave.presentation.report import render

        path = Path(path)
        page = render(self._needs_run("the report")).encode()
        write_whole(path.parent, {path.name: page})
        return path

    def save(self, path: Path | str) -> Path:
        """Write result.json, which `read_result` reads back to an equal result.

        Parameters
        ----------
        path : Path or str

        Returns
        -------
        Path

        Raises
        ------
        InvalidInput
            The file cannot be written.
        """
        path = Path(path)
        write_whole(path.parent, {path.name: results.to_json(self._document)})
        return path

    def _needs_run(self, what: str) -> Identification:
        if self.run is None:
            raise InvalidInput(
                f"{what} need the records' samples, which result.json does not hold",
                remedy="identify the study again; the report was written beside the result",
            )
        return self.run


def _study_of(study: Study | Path | str, data: Data) -> Study:
    """The study, checked; files must be there for the experiments whose data are not given."""
    if isinstance(study, Study):
        return checked_study(study, list(data))
    if not data:  # faults are named by their lines
        return _read_study(study)
    return checked_study(_read_study(study, logs_exist=False), list(data))


def _beside(
    work: Callable[[], Identification], asked: Callable[[], bool], follow: Callable[[], None]
) -> Identification:
    """Work in a thread of its own, so that this one can give it up, and follows it meanwhile.

    Compiled code and SciPy cannot be interrupted. Where the work is given up, what runs ends at
    its next look, and nobody waits for it.
    """
    given_up = threading.Event()
    done: list[Identification] = []
    failed: list[BaseException] = []

    def job() -> None:
        try:
            with limited(cancelled=given_up.is_set):
                done.append(work())
        except Stopped:
            failed.append(Cancelled())
        except BaseException as error:  # raised again where it is waited for
            failed.append(error)

    context = contextvars.copy_context()  # NumPy's error state, decimal's precision and the like
    thread = threading.Thread(target=context.run, args=(job,), name="strainwave", daemon=True)
    thread.start()
    try:
        while thread.is_alive():
            thread.join(_POLL)
            follow()
            if asked():
                raise Cancelled
        follow()  # what was said between the last look and the end
    finally:
        given_up.set()
    if failed:
        raise failed[0]
    return done[0]
