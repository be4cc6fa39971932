"""The public interface: a study in, a result out that prints, plots, saves and exports itself."""

from __future__ import annotations

import contextvars
import copy
import queue
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Future
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, overload

import numpy as np
from numpy.typing import ArrayLike

from strainwave import pipeline
from strainwave.domain import (
    ComplexArray,
    Experiment,
    FloatArray,
    FrequencyResponse,
    Identification,
    InputCheck,
    Log,
    Options,
    Parameter,
    PayloadEstimate,
    Prediction,
    PublishedWarning,
    RigidModel,
    Study,
    Verdict,
)
from strainwave.domain.keys import label_of
from strainwave.domain.messages import percent, plus_minus
from strainwave.domain.results.distributions import CI95_STDS
from strainwave.domain.study import Progress, ProgressEvent, ignore_progress
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.rigid_prediction import inverse_dynamics
from strainwave.errors import Cancelled, InvalidInput, import_optional, suggest_name
from strainwave.fleet.monitoring import comparison
from strainwave.identification.validation import predict_rigid
from strainwave.io import results
from strainwave.io.atomic_files import write_whole
from strainwave.io.joint_covariance import JointCovariance
from strainwave.io.logs import read_log
from strainwave.io.logs.arrays import Data
from strainwave.io.study import check_study
from strainwave.io.study import read_study as _read_study
from strainwave.numerics.parallel import Stopped, limited
from strainwave.pipeline.inputs import read_records
from strainwave.signals import hygiene
from strainwave.signals.motor import detect_standing_motors, prepare_motor_signals

if TYPE_CHECKING:
    from control import StateSpace
    from matplotlib.figure import Figure
    from pandas import DataFrame

    from strainwave.export import IdentifiedArm
    from strainwave.pipeline.payload_stream import PayloadStream
    from strainwave.report.document import FigureKind
    from strainwave.tune.design import ServoDesign, ServoOptions

Key = str | tuple[str, int | None]

_POLL_S = 0.05  # [s] between two checks of `cancel`; a user notices delays above 0.1 s
_N_FREQUENCIES = 400  # of a response: smooth at the width of a screen
_DECADES_BEYOND_MODES = 1.0  # below the anti-resonance and above the resonance
_NEAR_KEYS = 3  # suggestions for a misspelled parameter


def read_study(path: Path | str) -> Study:
    """Read and check a study file; its logs need not exist yet."""
    return _read_study(path, logs_exist=False)


def identify(
    study: Study | Path | str,
    *,
    data: Data | None = None,
    stages: str | Sequence[str] = pipeline.STAGES,
    options: Options | Mapping[str, Mapping[str, Any]] | Sequence[str] | str | None = None,
    start: Path | str | Mapping[tuple[str, int | None], float] | None = None,
    progress: Progress = ignore_progress,
    cancel: threading.Event | Callable[[], bool] | None = None,
    threads: int | None = None,
    scheduler: str | None = None,
) -> Result:
    """Identify an arm from its logs.

    Parameters
    ----------
    study : Study, Path or str
        The study file, or a study built in code.
    data : mapping, optional
        Logs by the name of the experiment: pandas, polars or Arrow tables, dictionaries of arrays,
        or paths. Other experiments are read from the files of the study.
    stages : str or sequence of str
        The first of "rigid", "decoupled", "tuned": `stages="rigid"`, `stages=("rigid",
        "decoupled")`. All by default.
    options : Options, mapping, str or sequence of str, optional
        Replaces [options] of the study: `sw.Options(links={"order": 1})`. A mapping
        `{"links": {"order": 1}}` or texts `["links.order=1"]` change single options, and
        "as-published" selects the settings of the paper.
    start : Path, str or mapping, optional
        Parameters at which the whole-arm fit starts: a result.json or parameter file, or values by
        (name, joint). Other parameters start at the estimates of the earlier stages.
    progress : callable
        Receives a `ProgressEvent` in the thread of the caller.
    cancel : threading.Event or callable, optional
        The run ends when the event is set or the function returns true.
    threads : int, optional
        Number of threads; by default one per core.
    scheduler : str, optional
        Address of a Dask scheduler, "tcp://host:8786", whose workers evaluate the records of a
        large whole-arm fit.

    Returns
    -------
    Result
        `result.status` is "determined" if all primary parameters are identified.

    Raises
    ------
    InvalidInput
        The study, a log or an argument is at fault.
    Cancelled
        `cancel` ended the run; the call returns within a second.
    """
    if threads is not None and threads < 1:
        raise InvalidInput(f"threads is {threads}", remedy="give at least 1, or leave it out")
    checked = _study_of(study, data or {})
    events: queue.SimpleQueue[ProgressEvent] = queue.SimpleQueue()
    is_cancelled = cancel.is_set if isinstance(cancel, threading.Event) else cancel

    def run() -> Identification:
        return pipeline.identify(
            checked,
            data=data,
            stages=stages,
            options=options,
            start=Path(start) if isinstance(start, str) else start,
            progress=events.put,
            threads=threads,
            scheduler=scheduler,
        )

    def report_progress() -> None:
        while not events.empty():
            progress(events.get())

    return Result.of(_run_in_thread(run, is_cancelled or (lambda: False), report_progress))


def read_logs(
    study: Study | Path | str,
    experiments: Sequence[Experiment] | None = None,
    *,
    data: Data | None = None,
) -> tuple[Log, ...]:
    """Read the logs of a study, as the stages of `identify` get them.

    Channels are in SI units, within the window of the experiment and on a uniform clock. A record
    with pauses has one log per segment. Torques of rigid joints without a logged motor torque are
    those of the sensors behind the gears. Defects of sensors are not repaired; see
    `repair_records`. All experiments are read by default; `data` is that of `identify`. Raises
    `InvalidInput` if the study or a log is at fault.
    """
    return read_records(_study_of(study, data or {}), experiments, data=data)[1]


def check(study: Study | Path | str, *, data: Data | None = None) -> InputCheck:
    """Check whether the channels of a study agree with each other and with the study.

    Takes a second or two; `identify` makes the same check first. `data` is that of `identify`. The
    record has `status`, `relations`, `suspected` and `warnings`. Raises `InvalidInput` if the
    study or a log is at fault.
    """
    return pipeline.check_input(_study_of(study, data or {}), data=data)


def read_result(path: Path | str) -> Result:
    """Read a result.json, or the one in a directory.

    The result equals the one that was saved. The report, residuals and most figures need the
    samples of the records, which the file does not contain.
    """
    path = results.result_path(Path(path))
    return Result(results.read_document(path), source=path)


def compare(
    results: Sequence[Result | Path | str], level: float = 0.05
) -> comparison.ResultComparison:
    """Test whether results of one arm differ significantly.

    The first result is compared with each of the others. `level` is the probability of
    reporting a difference between results of an unchanged arm. Raises `InvalidInput` for fewer than
    two results and `NotIdentifiable` if they have no parameter in common.
    """
    loaded = [result if isinstance(result, Result) else read_result(result) for result in results]
    estimates = [comparison.estimates_of(each._document, each.source) for each in loaded]
    labels = [estimate.label for estimate in estimates]
    unique = [
        one if labels.count(one.label) == 1 else replace(one, label=f"{one.label} ({number})")
        for number, one in enumerate(estimates, start=1)
    ]
    return comparison.compare(unique, level)


class Parameters(Sequence[Parameter]):
    """Final table: one entry per parameter, from the last stage that estimates it.

    `parameters["beta"]` is a parameter of the arm, `parameters["gear_stiffness", 1]` one of a
    joint, `parameters[0]` the first of the table.
    """

    def __init__(self, parameters: Sequence[Parameter]) -> None:
        self._parameters = tuple(parameters)

    def __len__(self) -> int:
        return len(self._parameters)

    @overload
    def __getitem__(self, index: int | Key) -> Parameter: ...
    @overload
    def __getitem__(self, index: slice) -> Parameters: ...
    def __getitem__(self, index: int | slice | Key) -> Parameter | Parameters:
        if isinstance(index, slice):
            return Parameters(self._parameters[index])
        if isinstance(index, int):
            return self._parameters[index]
        parameter = self._find(index)
        if parameter is None:
            raise KeyError(self._describe_unknown(index))
        return parameter

    def __contains__(self, item: object) -> bool:
        if isinstance(item, Parameter):
            return item in self._parameters
        is_key = isinstance(item, str) or (isinstance(item, tuple) and len(item) == 2)
        return is_key and self._find(item) is not None  # type: ignore[arg-type]

    def __iter__(self) -> Iterator[Parameter]:
        return iter(self._parameters)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Parameters) and self._parameters == other._parameters

    def __hash__(self) -> int:
        return hash(self._parameters)

    def __str__(self) -> str:
        rows = [("parameter", "joint", "value", "±", "unit")]
        for p in self._parameters:
            value, std = plus_minus(p.value, p.std)
            cells = ("not identified", "") if p.value is None else (value, std)
            rows.append((p.name, "arm" if p.joint is None else str(p.joint), *cells, p.unit))
        widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
        lines = (
            f"{a:<{widths[0]}}  {b:<{widths[1]}}  {c:>{widths[2]}}  {d:>{widths[3]}}  {e}".rstrip()
            for a, b, c, d, e in rows
        )
        return "\n".join(lines)

    def keys(self) -> list[Key]:
        """Keys of all parameters: "beta", ("gear_stiffness", 1)."""
        return [p.name if p.joint is None else (p.name, p.joint) for p in self._parameters]

    def to_frame(self) -> DataFrame:
        """The table as a pandas frame, one row per parameter."""
        pandas = import_optional("pandas", "a data frame", "pandas")
        rows = []
        for p in self._parameters:
            interval = p.ci95 or (None, None)
            rows.append((p.name, p.joint, p.value, p.std, *interval, p.unit, p.stage, p.model_std))
        columns = ["name", "joint", "value", "std", "ci95_low", "ci95_high", "unit", "stage"]
        columns.append("model_std")
        types = dict.fromkeys([*columns[2:6], "model_std"], "float64") | {"joint": "Int64"}
        frame: DataFrame = pandas.DataFrame(rows, columns=columns).astype(types)
        return frame

    def _repr_html_(self) -> str:
        from strainwave.report.notebook import table_of_parameters

        return table_of_parameters(self._parameters)

    def _find(self, key: Key) -> Parameter | None:
        """A parameter by key, or by its name in the verdict: "gear_stiffness 1"."""
        label = key if isinstance(key, str) else label_of(*key)
        return next((p for p in self._parameters if p.label == label), None)

    def _describe_unknown(self, key: Key) -> str:
        import difflib

        name, joint = (key, None) if isinstance(key, str) else key
        labels = [p.label for p in self._parameters]
        matches = difflib.get_close_matches(label_of(name, joint), labels, _NEAR_KEYS)
        same = [p for p in self._parameters if p.name == name]
        near = Parameters(same or [p for p in self._parameters if p.label in matches]).keys()
        hint = " or ".join(map(_shown, near))
        listed = ", ".join(map(_shown, self.keys()))
        return f"no parameter {_shown(key)}; " + (f"did you mean {hint}?" if hint else listed)


def _shown(key: Key) -> str:
    """A key as it is written between brackets."""
    return f'"{key}"' if isinstance(key, str) else f'"{key[0]}", {key[1]}'


@dataclass(frozen=True, slots=True, eq=False)
class JointResponse:
    """Frequency response of one joint alone, motor torque to motor velocity."""

    joint: int
    frequencies_hz: FloatArray  # (n_frequencies,)
    response: ComplexArray  # (n_frequencies,) of the identified model [rad/s/(N m)]
    magnitude_std: FloatArray | None  # (n_frequencies,); None: a standard deviation is missing
    phase_std: FloatArray | None  # (n_frequencies,) [rad]
    measured: FrequencyResponse | None  # nonparametric, of the records at full amplitude

    @property
    def magnitude_band(self) -> FloatArray | None:
        """Lower and upper limit of the magnitude with 95 % confidence, (n_frequencies, 2)."""
        return _band(np.abs(self.response), self.magnitude_std)

    @property
    def phase_band(self) -> FloatArray | None:
        """Lower and upper limit of the phase [rad] with 95 % confidence, (n_frequencies, 2)."""
        return _band(np.angle(self.response), self.phase_std)

    def plot(self) -> Figure:
        """Bode plot with 95 % bands."""
        from strainwave.report.figures import curves
        from strainwave.report.matplotlib_backend import draw

        f, stds = self.frequencies_hz, (self.magnitude_std, self.phase_std)
        drawn = [curves.Curve("identified model", f, self.response, *stds)]
        if self.measured is not None:
            G = self.measured.response[:, 0, 0]
            drawn.append(curves.Curve("measured", self.measured.frequencies_hz, G))
        caption = f"Joint {self.joint} alone: motor torque to motor velocity"
        return draw(curves.bode(drawn, caption))


def _band(value: FloatArray, std: FloatArray | None) -> FloatArray | None:
    if std is None:
        return None
    return np.column_stack([value - CI95_STDS * std, value + CI95_STDS * std])


@dataclass(frozen=True, slots=True, eq=False)
class Residuals:
    """Measured minus predicted channels of one record."""

    experiment: str
    time: FloatArray  # (n_samples,) [s]
    channels: tuple[str, ...]
    values: FloatArray  # (n_samples, n_channels) in the units of the channels; NaN: not predicted

    def to_frame(self) -> DataFrame:
        """The residuals as a pandas frame over time."""
        pandas = import_optional("pandas", "a data frame", "pandas")
        index = pandas.Index(self.time, name="time")
        frame: DataFrame = pandas.DataFrame(self.values, index=index, columns=self.channels)
        return frame


class Result:
    """Result of an identification.

    `result["gear_stiffness", 1]` is a parameter of a joint, `result["beta"]` one of the arm;
    `print(result)` shows the table. `document` has the layout of docs/result.md. `run` is the
    identification behind a fresh result; a result that was read from a file has none.
    """

    def __init__(
        self,
        document: Mapping[str, Any],
        run: Identification | None = None,
        source: Path | None = None,
    ) -> None:
        self._document = dict(document)
        self.parameters = Parameters(results.parameters_of(document))
        """The final table of parameters."""
        self.run = run
        self.source = source or Path(str(document.get("study", {}).get("path", "")))

    @classmethod
    def of(cls, run: Identification) -> Result:
        """The result of a run."""
        return cls(results.to_document(run), run)

    @property
    def status(self) -> str:
        """One of "determined", "partly-determined", "not-determined", "inconsistent-input"."""
        return self.verdict.status

    @property
    def reason(self) -> str | None:
        """Why the status is not "determined"."""
        return "; ".join(self.verdict.reasons) or None

    @cached_property
    def verdict(self) -> Verdict:
        """Identified, unidentified and rejected parameters, and suspected faults of the input."""
        return results.verdict_of(self._document)

    @cached_property
    def covariance(self) -> JointCovariance | None:
        """Covariance of the estimates with the names of rows and columns; `.to_frame()`."""
        return results.covariance_of(self._document)

    @property
    def checks(self) -> dict[str, dict[str, float | None]]:
        """Fit [%] of each channel of each validation record; None: the channel does not vary."""
        return results.checks_of(self._document)

    @cached_property
    def warnings(self) -> tuple[PublishedWarning, ...]:
        """Warnings on the data and the estimates."""
        return results.warnings_of(self._document)

    @property
    def document(self) -> dict[str, Any]:
        """The result as plain JSON values, in the layout of docs/result.md."""
        return copy.deepcopy(self._document)

    def keys(self) -> list[Key]:
        """Keys of all parameters: "beta", ("gear_stiffness", 1)."""
        return self.parameters.keys()

    _ipython_key_completions_ = keys

    def __len__(self) -> int:
        return len(self.parameters)

    def __bool__(self) -> bool:
        return True  # also without parameters

    def __iter__(self) -> Iterator[Parameter]:
        return iter(self.parameters)

    def __contains__(self, key: object) -> bool:
        return key in self.parameters

    def __getitem__(self, key: Key) -> Parameter:
        """A parameter by name, or by name and joint; KeyError names the nearest keys."""
        return self.parameters[key]

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Result) and self._document == other._document

    __hash__ = None  # type: ignore[assignment]

    def __repr__(self) -> str:
        known = sum(p.value is not None for p in self.parameters)
        return f"<Result: {self.status}, {known} of {len(self.parameters)} parameters>"

    def __str__(self) -> str:
        lines = [str(self.parameters)]
        for experiment, fits in self.checks.items():
            listed = ", ".join(
                f"{channel} {percent(float('nan') if fit is None else fit)}"
                for channel, fit in fits.items()
            )
            lines.append(f"fit (check) {experiment}: {listed}")
        lines += [f"warning [{w.code}] {w.where}" for w in self.warnings]
        reason = "" if self.reason is None else f": {self.reason}"
        return "\n".join([*lines, f"verdict: {self.status}{reason}"])

    def _repr_html_(self) -> str:
        from html import escape

        text = self.status if self.reason is None else f"{self.status}: {self.reason}"
        return f"<p>{escape(text)}</p>{self.parameters._repr_html_()}"

    def state_space(self, joint: int | None = None) -> StateSpace:
        """Linear model of one joint alone, or of the whole arm, as a python-control object.

        Inputs of a joint: motor torque minus Coulomb friction, interaction torque at the link
        [N m]. Outputs: motor velocity [rad/s], link acceleration [rad/s^2]. States: torsion, motor
        velocity, link velocity. The whole arm, at zero link angles, has these inputs, without
        interaction torques, and outputs for every joint. A gear with several slopes has the middle
        one. Raises `InvalidInput` if python-control is missing, the gear of the joint is rigid, or
        a parameter is not identified.
        """
        from strainwave.export.linear_models import SIGNALS, linear_arm, state_space

        control = import_optional("control", "a state-space object", "control")
        matrices: Iterable[FloatArray]
        if joint is None:
            arm = linear_arm(self._arm())
            name, matrices = "arm", arm.matrices.values()
            signals = {key: list(getattr(arm, key)) for key in SIGNALS}
        else:
            name, matrices = f"joint_{joint}", state_space(self._arm(), joint)
            signals = {key: list(names) for key, names in SIGNALS.items()}
        system: StateSpace = control.ss(*matrices, name=name, **signals)
        return system

    def frequency_response(
        self, joint: int, frequencies_hz: Sequence[float] | FloatArray | None = None
    ) -> JointResponse:
        """Response of one joint alone, motor torque to motor velocity, with 95 % bands.

        By default the frequencies range from a tenth of the anti-resonance to ten times the
        resonance. Errors as for `state_space`, except that python-control is not needed.
        """
        from strainwave.dynamics.two_inertia import anti_resonance, resonance
        from strainwave.export.linear_models import joint_model, joint_model_covariance
        from strainwave.identification.joint_model.agreement import motor_response
        from strainwave.report.document.bode import response_stds

        arm = self._arm()
        model = joint_model(arm, joint)
        if frequencies_hz is None:
            factor = 10.0**_DECADES_BEYOND_MODES
            low, high = (mode(model).frequency_hz for mode in (anti_resonance, resonance))
            frequencies_hz = np.geomspace(low / factor, high * factor, _N_FREQUENCIES)
        f = np.array(frequencies_hz)
        G = motor_response(model.vector, model.gear_ratio, f)
        covariance = joint_model_covariance(arm, joint, self.covariance)
        magnitude_std, phase_std = None, None
        if covariance is not None:
            relative, phase_std = response_stds(model.vector, covariance, model.gear_ratio, f, G)
            magnitude_std = np.abs(G) * relative
        measured = results.response_of(self._document, joint)
        return JointResponse(joint, f, G, magnitude_std, phase_std, measured)

    def residuals(self, experiment: str) -> Residuals:
        """Measured minus predicted channels of a record, over the samples that are predicted.

        Validation records have motor signals predicted by the rigid model and motion predicted by
        the elastic model. A result that was read from a file has no samples: `InvalidInput`.
        """
        run = self._needs_run("residuals")
        whole_arm = () if run.whole_arm is None else run.whole_arm.simulated
        predictions = (*run.checks, *whole_arm, *run.fitted)
        selected = [prediction for prediction in predictions if prediction.experiment == experiment]
        if not selected:
            names = list(dict.fromkeys(prediction.experiment for prediction in predictions))
            raise InvalidInput(
                f"no prediction of the experiment {experiment!r}",
                remedy=f"choose from: {', '.join(names)}{suggest_name(experiment, names)}",
            )
        time = np.unique(np.concatenate([prediction.time for prediction in selected]))
        columns: dict[str, FloatArray] = {}
        for prediction in selected:
            rows = np.searchsorted(time, prediction.time)
            for k, channel in enumerate(prediction.channels):
                if channel not in columns:
                    columns[channel] = np.full(len(time), np.nan)
                    columns[channel][rows] = prediction.measured[:, k] - prediction.predicted[:, k]
        return Residuals(experiment, time, tuple(columns), np.column_stack(list(columns.values())))

    @property
    def base_parameters(self) -> list[dict[str, Any]]:
        """Entries with name, combination, value, std, ci95, unit and stage, as in result.json.

        Empty for arms whose parameters are base parameters.
        """
        return copy.deepcopy(self._document.get("base_parameters", []))

    def inverse_dynamics(self, q: ArrayLike, dq: ArrayLike, ddq: ArrayLike) -> FloatArray:
        """Torque at the joints [N m; N of prismatic joints] for a motion of the joints.

        `q`, `dq`, `ddq`, each (n_samples, n_joints) or (n_joints,) [rad, rad/s, rad/s^2], are those
        of the links. The model is that of the rigid step with all its friction; dry friction is
        zero at zero velocity. The torque of the motors is the result times the gear ratio. Raises
        `InvalidInput` if the result has no rigid model or the shapes differ.
        """
        arm, model = self._rigid_model()
        motion = [np.asarray(x, dtype=np.float64) for x in (q, dq, ddq)]
        shape = motion[0].shape
        if any(x.shape != shape for x in motion) or shape[-1:] != (arm.n_joints,) or len(shape) > 2:
            raise InvalidInput(
                f"q, dq and ddq have the shapes {', '.join(str(x.shape) for x in motion)}",
                remedy=f"give three arrays (n_samples, {arm.n_joints}) or ({arm.n_joints},)",
            )
        motors = [arm.motor_accelerations(x.reshape(-1, arm.n_joints)) for x in motion]
        return arm.joints_of(inverse_dynamics(arm, model, motors)).reshape(shape)

    def predict(self, record: Any) -> Prediction:
        """Predict the torques of a record from its motion, with the fit [%] of each.

        `record` is the name of an experiment of the study, or a log that was not in it: a pandas,
        polars or Arrow table, a dictionary of arrays, or a path. A log has the columns that the
        study's [channels] name; a result read from a file needs the study file for that. Predicted
        and measured torques are those within the bandwidth of the rigid model.
        """
        from strainwave.export.source import study_file_of

        arm, model = self._rigid_model()
        if self.run is None:  # the logs need [channels] of the study file
            study, _ = study_file_of(self._document, results.result_path(self.source))
        else:
            study = self.run.study
        name = record if isinstance(record, str) else None
        named = [each for each in study.experiments if each.name == name]
        logs = [log for log in (self.run.logs if self.run else ()) if log.name == name]
        if not logs:
            control = ("servo",) * arm.n_joints
            new = Experiment("record", "record", "check", control)  # type: ignore[arg-type]
            logs = [read_log(study, *named)] if named else [read_log(study, new, record)]
        usable, warnings = hygiene.repair_records(logs, arm)
        if not usable:
            raise InvalidInput(
                f"the record is not usable: {'; '.join(each.observation for each in warnings)}",
                where=str(record) if isinstance(record, str | Path) else "predict",
                remedy="correct the sensor or its cable, and record again",
            )
        signals = prepare_motor_signals(usable[0], arm)
        stands = detect_standing_motors([model.motion[0], signals.motor_angle])[1]
        signals = replace(signals, direction=np.where(stands, 0.0, signals.direction))
        return predict_rigid(model, signals, arm)

    def compare(
        self, other: Result | Path | str, level: float = 0.05
    ) -> comparison.ResultComparison:
        """Test whether another result of the same arm differs significantly; see `compare`."""
        return compare([self, other], level)

    def export(
        self,
        path: Path | str,
        format: str | None = None,
        *,
        randomise: int = 0,
        seed: int = 0,
        mujoco: str | None = None,
    ) -> tuple[str, ...]:
        """Write the arm for another program; returns notes on the parts that the format loses.

        The ending of `path` determines the format: .xml (MuJoCo), .urdf, .m and .mat (MATLAB), .h
        (C), .json; or `format` does, see docs/export.md. `randomise` arms drawn from the joint
        covariance follow in files of their own. `mujoco` is the version that an MJCF is for.
        """
        from strainwave.export import export_arm

        options: dict[str, Any] = {"randomise": randomise, "seed": seed, "mujoco": mujoco}
        written = export_arm(self._arm(), Path(path), form=format, **options)
        return (*(each.message for each in written.warnings), *written.notes)

    def tune(
        self,
        options: ServoOptions | None = None,
        *,
        out: Path | str | None = None,
        progress: Callable[[str], None] = lambda _: None,
    ) -> ServoDesign:
        """Design servo gains and input shapers that hold for the uncertain arm.

        `sw.ServoOptions` has postures, payloads, required margins and the clock. The report
        tune.html is written into the directory `out`, if there is one. Raises `NotIdentifiable` if
        a parameter is missing, and `InvalidInput` if no gains keep the margins.
        """
        from strainwave.tune import tune_document
        from strainwave.tune.design import ServoOptions

        folder = None if out is None else Path(out)
        options = options or ServoOptions()
        return tune_document(self._document, self._arm(), options, folder, progress)

    def payload(
        self,
        study: Study | Path | str,
        *,
        data: Data | None = None,
        progress: Callable[[str], None] = lambda _: None,
    ) -> PayloadEstimate:
        """Estimate the load that the records of a study of this arm carry.

        The load has mass, centre of mass and inertia with intervals that contain the errors of the
        arm; None: not determined. The motion records are fitted, all records if there are none. If
        they state their payload, the record has `torque_scale`, the factor by which the stated
        torques are wrong. `data` is that of `identify`. Raises `InvalidInput` if the study is not
        of this arm, or a log is at fault, and `NotIdentifiable` if the arm or the load is not
        determined.
        """
        from strainwave.pipeline.payload import estimate_payload

        identified = None if self.run is None else self.run.study
        return estimate_payload(
            self._document,
            self.source,
            _study_of(study, data or {}, of_load=True),
            identified=identified,
            data=data,
            progress=progress,
        )

    def payload_stream(self, *, sample_time: float, window: float = 10.0) -> PayloadStream:
        """A stream that estimates the load from samples in a loop, as `payload` does from records.

        `sample_time` [s] is the period of the samples, `window` [s] the time of motion whose
        samples count. `update(angle, torque)` takes one sample, `estimate` is the load so far.
        Raises `InvalidInput` if the samples are too slow for the arm's model, and `NotIdentifiable`
        if the arm is not determined.
        """
        from strainwave.pipeline.payload_stream import PayloadStream

        identified = None if self.run is None else self.run.study
        return PayloadStream(
            self._document,
            self.source,
            identified=identified,
            sample_time=sample_time,
            window=window,
        )

    def plot(
        self,
        kind: FigureKind = "parameters",
        *,
        joint: int | None = None,
        experiment: str | None = None,
        part: str | None = None,
    ) -> Figure:
        """One of the figures of the report; an unknown one raises `InvalidInput` with a list.

        "parameters" shows the standard deviation of each parameter relative to its value. `part` is
        "slope" or "torsion" of a gear, "time" or "spectrum" of an interaction, a channel of the
        residuals.
        """
        from strainwave.report.document import FIGURE_KINDS, FigureName, find_figure
        from strainwave.report.matplotlib_backend import draw
        from strainwave.report.notebook import certainty

        if kind not in FIGURE_KINDS:
            raise InvalidInput(
                f"there is no kind of figure {kind!r}",
                remedy=f"choose from: {', '.join(FIGURE_KINDS)}{suggest_name(kind, FIGURE_KINDS)}",
            )
        if kind == "parameters":
            return draw(certainty(self.parameters))
        if kind == "bode" and joint is not None and self.run is None:
            return self.frequency_response(joint).plot()
        run = self._needs_run('figures other than plot("bode", joint=1)')
        return draw(find_figure(run, FigureName(kind, joint, experiment, part)))

    def report(self, path: Path | str) -> Path:
        """Write the report, one HTML file; `InvalidInput` for a result read from a file."""
        from strainwave.report.document import render

        path = Path(path)
        page = render(self._needs_run("the report")).encode()
        write_whole(path.parent, {path.name: page})
        return path

    def save(self, path: Path | str) -> Path:
        """Write result.json, which `read_result` reads back to an equal result."""
        path = Path(path)
        write_whole(path.parent, {path.name: results.to_json(self._document)})
        return path

    def _arm(self) -> IdentifiedArm:
        from strainwave.export import arm_of

        study = None if self.run is None else self.run.study
        return arm_of(self._document, self.source, identified=study)

    def _rigid_model(self) -> tuple[Arm, RigidModel]:
        arm = self._arm().with_identified_drives()
        if arm.rigid is None:
            raise InvalidInput(
                "has no rigid model, which predicts torques",
                where=f"{self.source}: stages.rigid.prediction",
                remedy='identify again, with records of use = "motion"',
            )
        return Arm.of(arm.study.arm), arm.rigid

    def _needs_run(self, subject: str) -> Identification:
        if self.run is None:
            raise InvalidInput(
                f"{subject} cannot be made from result.json, which has no samples of the records",
                remedy="identify the study again, or keep the fresh result by pickle.dump",
            )
        return self.run


def _study_of(study: Study | Path | str, data: Data, *, of_load: bool = False) -> Study:
    """The checked study; experiments without data need their files."""
    if isinstance(study, Study):
        return check_study(study, list(data), of_load=of_load)
    if not data:  # messages name the line of the study file
        return _read_study(study, of_load=of_load)
    read = _read_study(study, logs_exist=False, of_load=of_load)
    return check_study(read, list(data), of_load=of_load)


def _run_in_thread(
    work: Callable[[], Identification],
    is_cancelled: Callable[[], bool],
    report_progress: Callable[[], None],
) -> Identification:
    """Run `work` in a thread that this thread can abandon, and report its progress here.

    Compiled code and SciPy cannot be interrupted. Abandoned work ends when it next checks.
    """
    is_abandoned = threading.Event()
    outcome: Future[Identification] = Future()

    def job() -> None:
        try:
            with limited(cancelled=is_abandoned.is_set):
                outcome.set_result(work())
        except Stopped:
            outcome.set_exception(Cancelled())
        except BaseException as error:  # raised again in the thread of the caller
            outcome.set_exception(error)

    context = contextvars.copy_context()  # for example the error state of NumPy
    thread = threading.Thread(target=context.run, args=(job,), name="strainwave", daemon=True)
    thread.start()
    try:
        while thread.is_alive():
            thread.join(_POLL_S)
            report_progress()
            if is_cancelled():
                raise Cancelled
        report_progress()  # events after the last check
    finally:
        is_abandoned.set()
    return outcome.result()
