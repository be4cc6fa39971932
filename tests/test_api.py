"""The public API in a notebook or program, on records of a small arm simulated by MuJoCo."""

from __future__ import annotations

import copy
import inspect
import json
import os
import pickle
import subprocess
import sys
import threading
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import polars as pl
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

import strainwave as sw
from small_arm import FOLDER, STUDY, whole
from strainwave.domain import Identification
from strainwave.domain.study import Progress, ProgressEvent
from strainwave.dynamics.arm import Arm
from strainwave.export import arm_of
from strainwave.export.linear_models import joint_model, joint_model_covariance
from strainwave.identification.joint_model.agreement import motor_response
from strainwave.io import results
from strainwave.numerics import dask_cluster


@cache
def rigid() -> sw.Result:
    return sw.identify(STUDY, stages=("rigid",))


@pytest.fixture(params=["fresh", "read"])
def either(request: pytest.FixtureRequest, tmp_path: Path) -> sw.Result:
    """A fresh result, and the same result read from its file."""
    if request.param == "fresh":
        return whole()
    return sw.read_result(whole().save(tmp_path / "result.json").parent)


def tables(form: str) -> dict[str, Any]:
    """Return all logs of the study in memory."""
    logs: dict[str, Any] = {}
    for each in sw.read_study(STUDY).experiments:
        table = pq.read_table(FOLDER / each.file)
        match form:
            case "arrow":
                logs[each.name] = table
            case "pandas":
                logs[each.name] = table.to_pandas()
            case "polars":
                logs[each.name] = pl.from_arrow(table)
            case "arrays":
                logs[each.name] = {n: table[n].to_numpy() for n in table.column_names}
            case "path":
                logs[each.name] = str(FOLDER / each.file)
    return logs


def test_a_parameter_is_found_by_name_and_joint() -> None:
    result = rigid()
    beta = result["beta"]
    assert beta.value is not None
    assert beta.std is not None
    assert beta.ci95 is not None
    assert beta.ci95[0] < beta.value < beta.ci95[1]
    assert result["motor_inertia", 2].joint == 2
    assert result["motor_inertia 2"] == result.parameters["motor_inertia", 2]
    with pytest.raises(KeyError, match=r'did you mean .*"motor_inertia", 2'):
        result["motor_inertias", 2]
    with pytest.raises(KeyError, match=r'did you mean "motor_inertia", 2\?'):
        result["motor_inertia"]
    with pytest.raises(KeyError, match='no parameter "qwerty"; "beta"'):
        result["qwerty"]


def test_parameters_are_a_sequence_and_a_frame() -> None:
    table = rigid().parameters
    assert [one.label for one in table][: len(table)] == [one.label for one in table[:]]
    frame = table.to_frame()
    assert isinstance(frame, pd.DataFrame)
    beta = frame[frame["name"] == "beta"].iloc[0]
    assert beta["value"] == rigid()["beta"].value
    assert beta["ci95_low"] < beta["value"] < beta["ci95_high"]
    assert pd.isna(beta["joint"])
    assert len(frame) == len(table)


@pytest.mark.parametrize("form", ["arrow", "pandas", "polars", "arrays", "path"])
def test_data_in_memory_are_the_logs_of_the_files(form: str, tmp_path: Path) -> None:
    """The study path has no log files."""
    study = replace(sw.read_study(STUDY), path=tmp_path / "study.toml")
    logs = sw.read_logs(study, data=tables(form))
    for log, expected in zip(logs, sw.read_logs(STUDY), strict=True):
        np.testing.assert_array_equal(log.time, expected.time)
        assert log.channels.keys() == expected.channels.keys()
        for name, channel in log.channels.items():
            np.testing.assert_array_equal(channel, expected.channels[name])


def test_data_in_memory_give_the_same_result_as_files(tmp_path: Path) -> None:
    study = replace(sw.read_study(STUDY), path=tmp_path / "study.toml")
    result = sw.identify(study, data=tables("arrow"), stages=("rigid",))
    assert result.parameters == rigid().parameters


def test_invalid_tables_are_refused() -> None:
    data = tables("arrays")
    first = next(iter(data))
    with pytest.raises(sw.InvalidInput, match="is not a table, but int"):
        sw.identify(STUDY, data={first: 3})
    with pytest.raises(sw.InvalidInput, match=rf"data\['{first}'\].*is not usable: text"):
        sw.identify(STUDY, data={first: data[first] | {"u1_counts": ["a", "b"]}}, stages=("rigid",))
    with pytest.raises(sw.InvalidInput, match="is not usable: a length other than"):
        sw.identify(STUDY, data={first: data[first] | {"u1_counts": np.ones(3)}}, stages=("rigid",))
    with pytest.raises(sw.InvalidInput, match="the study has no experiment 'another'"):
        sw.identify(STUDY, data={"another": data[first]})
    with_infinity = data[first] | {
        "u1_counts": np.where(np.arange(len(data[first]["u1_counts"])) == 7, np.inf, 1.0)
    }
    with pytest.raises(sw.InvalidInput, match=rf"data\['{first}'\].*row 8"):
        sw.identify(STUDY, data={first: with_infinity}, stages=("rigid",))
    with pytest.raises(sw.InvalidInput, match="two columns named"):
        sw.identify(STUDY, data={first: pa.table([[1.0], [2.0]], names=["t", "t"])})


def test_logs_are_those_of_the_stages() -> None:
    run = rigid().run
    assert run is not None
    logs = sw.read_logs(STUDY)
    assert [log.name for log in logs] == [log.name for log in run.logs]
    for log, of_run in zip(logs, run.logs, strict=True):
        np.testing.assert_array_equal(log.time, of_run.time)
        assert log.channels.keys() == of_run.channels.keys()
    (named,) = sw.read_logs(STUDY, sw.read_study(STUDY).experiments[:1])
    assert named.name == logs[0].name
    motor = 1e-3 * np.arange(1000.0)
    study = sw.Study(
        arm=sw.ArmDescription("single-joint", joints=(sw.Joint(spring="rigid", gear_ratio=0.01),)),
        experiments=(sw.Experiment("motion", "", "motion", ("open",)),),
    )
    table = {"t": motor, "tau_l1": np.sin(motor), "theta_m1": motor}
    (sensed,) = sw.read_logs(study, data={"motion": table})
    np.testing.assert_allclose(sensed.channels["torque1"], 0.01 * np.sin(motor))


def test_a_missing_log_is_reported_with_its_line(tmp_path: Path) -> None:
    path = tmp_path / "study.toml"
    path.write_text(STUDY.read_text())
    first = sw.read_study(path).experiments[0]
    lines = path.read_text().splitlines()
    number = 1 + next(k for k, line in enumerate(lines) if first.file in line)
    with pytest.raises(sw.InvalidInput, match=rf"study\.toml, line {number}\b"):
        sw.identify(path)


def test_a_result_reads_back_equal(tmp_path: Path) -> None:
    fresh = whole()
    path = fresh.save(tmp_path / "result.json")
    again = sw.read_result(path)
    assert again == fresh
    assert again.parameters == fresh.parameters
    assert again.verdict == fresh.verdict
    assert again.warnings == fresh.warnings
    assert again.status == fresh.status == "determined"
    assert again != rigid()
    again.save(tmp_path / "again.json")
    assert (tmp_path / "again.json").read_bytes() == path.read_bytes()
    for request in (
        lambda: again.report(tmp_path / "report.html"),
        lambda: again.residuals("motion-check"),
        lambda: again.plot("gear", joint=1),
    ):
        with pytest.raises(sw.InvalidInput, match=r"has no samples.*identify the study again"):
            request()
    assert fresh.report(tmp_path / "report.html").read_text().startswith("<!doctype html>")
    with pytest.raises(sw.InvalidInput, match=r"there is no figure 'bode joint 3'.*bode joint 1"):
        fresh.plot("bode", joint=3)
    with pytest.raises(sw.InvalidInput, match=r"no kind of figure 'bod'.*did you mean 'bode'"):
        fresh.plot("bod")  # type: ignore[arg-type]
    assert "gear_damping" in fresh._repr_html_()


def test_a_result_is_a_collection_of_parameters(either: sw.Result) -> None:
    assert len(either) == len(list(either)) == len(either.parameters) > 30
    assert ("beta", None) in either
    assert "beta" in either
    assert ("gear_stiffness_k1", 1) in either
    assert "gear_stiffness_k1" not in either
    assert ("gear_stiffness", 3) not in either
    assert either["beta"] in either
    assert 3 not in either
    keys = either.keys()
    assert keys == either._ipython_key_completions_()
    assert [either[key] for key in keys] == list(either)
    assert pickle.loads(pickle.dumps(either)) == either
    assert bool(sw.Result(either.document | {"parameters": []}))


def test_a_result_prints_its_table(either: sw.Result) -> None:
    text = str(either)
    assert "\ngear_stiffness_k1       1 " in text
    assert "fit (check) motion-check: u1 9" in text
    assert text.endswith("verdict: determined")
    assert repr(either) == f"<Result: determined, {len(either)} of {len(either)} parameters>"
    names = ("checks", "compare", "covariance", "export", "frequency_response", "state_space")
    assert set(names) <= set(dir(either))
    assert "Identify an arm" in str(inspect.getdoc(sw.identify))


def test_the_covariance_has_names(either: sw.Result) -> None:
    covariance = either.covariance
    assert covariance is not None
    frame = covariance.to_frame()
    assert list(frame.index) == list(frame.columns) == list(covariance.names)
    label = "gear_stiffness_k1 1"
    assert frame.loc[label, label] ** 0.5 == pytest.approx(either[label].std)
    assert np.abs(covariance.correlation).max() <= 1.0 + 1e-9


def test_a_joint_is_a_system_of_python_control(either: sw.Result) -> None:
    control = pytest.importorskip("control", reason="python-control is not installed")
    system = either.state_space(1)
    assert isinstance(system, control.StateSpace)
    assert system.input_labels == ["motor_torque", "interaction_torque"]
    assert system.output_labels == ["motor_velocity", "link_acceleration"]
    response = either.frequency_response(1)
    G = system(2j * np.pi * response.frequencies_hz)[0, 0]
    np.testing.assert_allclose(response.response, G, rtol=1e-9)
    with pytest.raises(sw.InvalidInput, match="there is no joint 3"):
        either.state_space(3)
    assert either.state_space().input_labels == ["motor_torque_1", "motor_torque_2"]


def test_without_python_control_the_message_has_the_command(
    either: sw.Result, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "control", None)
    with pytest.raises(sw.InvalidInput, match=r"Remedy: pip install control\."):
        either.state_space(1)


def test_a_frequency_response_has_bands(either: sw.Result) -> None:
    response = either.frequency_response(2)
    band = response.magnitude_band
    assert band is not None
    assert response.phase_band is not None
    assert (band[:, 0] < np.abs(response.response)).all()
    assert (band[:, 1] > np.abs(response.response)).all()
    measured = response.measured
    assert measured is not None
    assert measured.response.shape[1:] == (2, 2)
    model_response = either.frequency_response(2, measured.frequencies_hz)
    difference_db = 20.0 * np.log10(np.abs(model_response.response / measured.response[:, 0, 0]))
    assert abs(float(np.median(difference_db))) < 1.0  # [dB]
    assert len(response.plot().axes) == 2
    assert either.plot("bode", joint=2).axes
    assert either.plot().axes


def test_the_bands_of_a_response_are_those_of_drawn_parameters() -> None:
    """Compares the delta method with Monte Carlo samples from the covariance of the result."""
    result = whole()
    arm = arm_of(result.document, result.source)
    model = joint_model(arm, 1)
    S = joint_model_covariance(arm, 1, result.covariance)
    assert S is not None
    f = np.array([5.0, 20.0, 40.0, 100.0])
    rng = np.random.default_rng(3)
    samples = rng.multivariate_normal(model.vector, S, size=4000)
    G = np.array([motor_response(each, model.gear_ratio, f) for each in samples])
    std = result.frequency_response(1, f).magnitude_std
    assert std is not None
    np.testing.assert_allclose(np.abs(G).std(axis=0), std, rtol=0.06)  # 5 standard errors


def test_checks_have_a_fit_per_channel(either: sw.Result) -> None:
    checks = either.checks
    assert set(checks) == {"motion-check", "step-check-j1", "step-check-j2"}
    fit = checks["motion-check"]["omega_m1"]
    assert fit is not None
    assert fit > 99.0


def test_residuals_are_measured_minus_predicted() -> None:
    result = whole()
    residuals = result.residuals("motion-check")
    assert residuals.channels == ("u1", "u2", "omega_m1", "omega_m2", "a1", "a2")
    assert residuals.values.shape == (len(residuals.time), 6)
    assert result.run is not None
    for check in result.run.checks:
        if check.experiment == "motion-check":
            rows = np.isin(residuals.time, check.time)
            columns = [residuals.channels.index(name) for name in check.channels]
            values = residuals.values[rows][:, columns]
            np.testing.assert_array_equal(values, check.measured - check.predicted)
    assert list(residuals.to_frame().columns) == list(residuals.channels)
    with pytest.raises(sw.InvalidInput, match=r"choose from: .*did you mean 'motion-check'"):
        result.residuals("motion-chek")


def test_a_result_exports_its_arm(either: sw.Result, tmp_path: Path) -> None:
    notes = either.export(tmp_path / "arm.urdf")
    assert any("the links include the rotors" in note for note in notes)
    assert (tmp_path / "arm.urdf").read_text().count("<inertial>") == 2
    either.export(str(tmp_path / "arm"), format="state-space")
    with pytest.raises(sw.InvalidInput, match="did you mean 'urdf'"):
        either.export(tmp_path / "arm", format="urd")


def test_a_record_is_predicted_as_in_the_checks(either: sw.Result) -> None:
    """By its name, and as a log that is not in the study."""
    log = pd.read_parquet(FOLDER / "motion-check.parquet")
    for record in ("motion-check", log, FOLDER / "motion-check.parquet"):
        prediction = either.predict(record)
        assert prediction.channels == ("u1", "u2")
        for channel, fit in prediction.fit_percent.items():
            # a window of the study does not apply to a log
            reported = either.checks["motion-check"][channel]
            assert fit == pytest.approx(reported, abs=1e-9 if isinstance(record, str) else 0.5)
    assert prediction.predicted.shape == prediction.measured.shape == (len(prediction.time), 2)
    with pytest.raises(sw.InvalidInput, match="motion-chek"):
        either.predict("motion-chek")


def test_inverse_dynamics_are_those_of_the_core(either: sw.Result) -> None:
    """Torques at the joints by the compiled chain, from the values of the rigid step."""
    rng, arm = np.random.default_rng(0), Arm.of(arm_of(either.document, either.source).study.arm)
    q, dq, ddq = rng.normal(size=(3, 20, 2))
    torque = either.inverse_dynamics(q, dq, ddq)
    rigid_values = either.document["stages"]["rigid"]["parameters"]
    values = {(p["name"], p["joint"]): p["value"] for p in rigid_values}
    rigid_arm = arm.behind_rigid_gears()
    vector = rigid_arm.parameter_vector(values)
    expected = rigid_arm.joints_of(rigid_arm.inverse_dynamics(vector, q, dq, ddq))
    np.testing.assert_allclose(torque, expected, rtol=1e-9)
    np.testing.assert_array_equal(either.inverse_dynamics(q[0], dq[0], ddq[0]), torque[0])
    for wrong in (q[:, :1], q[:3]):
        with pytest.raises(sw.InvalidInput, match=r"give three arrays \(n_samples, 2\)"):
            either.inverse_dynamics(wrong, dq, ddq)


def test_a_result_without_rigid_model_predicts_no_torque() -> None:
    document = whole().document
    del document["stages"]["rigid"]["prediction"]
    with pytest.raises(sw.InvalidInput, match='records of use = "motion"'):
        sw.Result(document, source=STUDY).inverse_dynamics([0, 0], [0, 0], [0, 0])


def test_only_serial_arms_have_base_parameters_apart_from_their_parameters() -> None:
    assert whole().base_parameters == []
    entries = [{"name": "Izz1R", "combination": {"Izz1": 1.0}, "value": 1.0}]
    result = sw.Result(whole().document | {"base_parameters": entries})
    assert result.base_parameters == entries


def test_results_are_compared(either: sw.Result, tmp_path: Path) -> None:
    document = either.document
    changed_parameter = next(p for p in document["parameters"] if p["name"] == "gear_stiffness_k1")
    changed_parameter["value"] *= 0.98
    worn_path = sw.Result(document).save(tmp_path / "worn" / "result.json")
    comparison = either.compare(worn_path)
    assert comparison.differs
    assert "gear_stiffness_k1 1" in repr(comparison)
    frame = comparison.to_frame()
    changed = frame[frame["verdict"] == "differs"]
    assert list(changed["name"]) == ["gear_stiffness_k1"]
    assert "verdict: the results differ" in str(comparison)
    assert not sw.compare([either, either]).differs
    assert sw.compare([either, worn_path, worn_path]).homogeneity is not None


def test_a_figure_is_found_by_the_name_of_its_experiment() -> None:
    """Also if the name contains characters that are invalid in file names."""
    run = rigid().run
    assert run is not None
    prediction = replace(run.fitted[0], experiment="Slow motion (1)")
    result = sw.Result.of(replace(run, fitted=(prediction,)))
    assert result.plot("fitted", experiment="Slow motion (1)").axes
    with pytest.raises(sw.InvalidInput, match="there is no figure 'fitted Slow motion"):
        result.plot("fitted", experiment="Slow motion (2)")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{", "is not JSON"),
        ("[1]", 'has no key "schema"'),
        ('{"schema": "strainwave/result/9"}', "has the schema"),
    ],
)
def test_other_files_are_refused(text: str, message: str, tmp_path: Path) -> None:
    (tmp_path / "r.json").write_text(text)
    with pytest.raises(sw.InvalidInput, match=message):
        sw.read_result(tmp_path / "r.json")
    with pytest.raises(sw.InvalidInput, match="does not exist"):
        sw.read_result(tmp_path / "none.json")


def test_an_incomplete_result_is_refused() -> None:
    with pytest.raises(sw.InvalidInput, match="parameters, entry 1: 'joint' is invalid"):
        sw.Result({"schema": results.SCHEMA, "parameters": [{"name": "beta"}]})


def test_progress_is_reported_in_the_thread_of_the_caller() -> None:
    events: list[ProgressEvent] = []
    threads = set[int]()

    def follow(event: ProgressEvent) -> None:
        events.append(event)
        threads.add(threading.get_ident())

    sw.identify(STUDY, stages=("rigid",), progress=follow)
    assert [event.stage for event in events][:3] == ["read", "consistency", "rigid"]
    fractions = [event.fraction for event in events]
    assert fractions == sorted(fractions)
    assert threads == {threading.get_ident()}


def test_progress_at_the_very_end_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    """The event arrives after the last check of the queue and before the thread ends."""
    last = ProgressEvent("tuned", 1.0, "the last word", 8, 8)
    identification = rigid().run
    started, checked = threading.Event(), threading.Event()
    workers: list[threading.Thread] = []

    def work(*_: object, progress: Progress, **__: object) -> Identification | None:
        workers.append(threading.current_thread())
        started.set()
        checked.wait()
        progress(last)
        return identification

    def asked() -> bool:
        started.wait()
        checked.set()
        workers[0].join()
        return False

    events: list[ProgressEvent] = []
    monkeypatch.setattr("strainwave.pipeline.identify", work)
    sw.identify(STUDY, progress=events.append, cancel=asked)
    assert events == [last]


@pytest.mark.parametrize("stage", ["read", "rigid", "decoupled", "tuned"])
def test_cancel_ends_every_stage(stage: str) -> None:
    wanted = threading.Event()

    def follow(event: ProgressEvent) -> None:
        if event.stage == stage:
            wanted.set()

    with pytest.raises(sw.Cancelled):
        sw.identify(STUDY, progress=follow, cancel=wanted)
    for thread in threading.enumerate():
        if thread.name == "strainwave":  # a cancelled thread ends at its next check
            thread.join(60.0)
            assert not thread.is_alive()


def test_cancel_does_not_wait_for_compiled_code(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The work never checks for cancellation."""
    started, release = threading.Event(), threading.Event()

    def endless(*_: object, **__: object) -> None:
        started.set()
        release.wait()

    monkeypatch.setattr("strainwave.pipeline.identify", endless)
    with pytest.raises(sw.Cancelled):
        sw.identify(STUDY, cancel=started)
    assert not release.is_set()
    release.set()


def test_cancel_may_be_a_function() -> None:
    with pytest.raises(sw.Cancelled):
        sw.identify(STUDY, cancel=lambda: True)


def test_an_error_in_progress_is_raised() -> None:
    def follow(_event: ProgressEvent) -> None:
        raise RuntimeError("no")

    with pytest.raises(RuntimeError, match="no"):
        sw.identify(STUDY, progress=follow)


ON_ONE_THREAD = """
import sys
import threading
import strainwave as sw

before, counts = threading.active_count(), []
result = sw.identify(
    sys.argv[1], threads=1, progress=lambda _: counts.append(threading.active_count() - before)
)
assert max(counts) <= 1, counts  # the thread of the run
result.save(sys.argv[2])
"""


def test_the_same_input_gives_the_same_result_for_any_number_of_threads(tmp_path: Path) -> None:
    """Two processes with other numbers of threads, of this package and of BLAS.

    The files are equal except for time and paths.
    """
    blas = "4" if os.environ.get("OPENBLAS_NUM_THREADS") == "1" else "1"
    subprocess.run(
        [sys.executable, "-c", ON_ONE_THREAD, str(STUDY), str(tmp_path / "one.json")],
        env={**os.environ, "OPENBLAS_NUM_THREADS": blas, "OMP_NUM_THREADS": blas},
        check=True,
        timeout=500,
    )
    whole().save(tmp_path / "three.json")
    documents = [json.loads((tmp_path / name).read_text()) for name in ("one.json", "three.json")]
    for document in documents:
        for varying in ("created", "timing_s"):
            del document[varying]
        del document["study"]["path"]
    assert documents[0] == documents[1]


def test_a_scheduler_that_does_not_answer_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("distributed")
    monkeypatch.setattr(dask_cluster, "_CONNECT_TIMEOUT_S", 0.3)
    with pytest.raises(sw.InvalidInput, match="no Dask scheduler answers") as caught:
        sw.identify(STUDY, scheduler="tcp://127.0.0.1:1")
    assert caught.value.where == "tcp://127.0.0.1:1"


def test_no_threads_are_refused() -> None:
    with pytest.raises(sw.InvalidInput, match="threads is 0"):
        sw.identify(STUDY, threads=0)


def test_every_public_name_exists_and_is_listed() -> None:
    for name in sw.__all__:
        assert getattr(sw, name) is not None
    assert set(sw.__all__) <= set(dir(sw))
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        sw.nothing  # noqa: B018
    with pytest.raises(AttributeError, match="did you mean 'read_result'"):
        sw.read_results  # noqa: B018


def test_stages_may_be_one_text() -> None:
    assert sw.identify(STUDY, stages="rigid").parameters == rigid().parameters
    with pytest.raises(sw.InvalidInput, match=r"cannot run the stages rigit.*did you mean 'rigid'"):
        sw.identify(STUDY, stages="rigit")


def test_options_are_typed_and_name_the_nearest() -> None:
    typed = sw.Options(rigid=sw.RigidOptions(bandwidth_hz=20.0))
    assert sw.Options(rigid={"bandwidth_hz": 20.0}) == typed  # type: ignore[arg-type]
    results = [
        sw.identify(STUDY, stages="rigid", options=options)
        for options in (typed, {"rigid": {"bandwidth_hz": 20.0}}, ["rigid.bandwidth_hz=20.0"])
    ]
    assert results[0].parameters == results[1].parameters == results[2].parameters
    assert results[0].parameters != rigid().parameters
    with pytest.raises(sw.InvalidInput, match=r"no option 'linkz'.*did you mean 'links'"):
        sw.Options(linkz={"order": 1})  # type: ignore[call-arg]
    with pytest.raises(sw.InvalidInput, match=r"no option 'ordr'.*did you mean 'order'"):
        sw.Options(links={"ordr": 1})  # type: ignore[arg-type]
    with pytest.raises(sw.InvalidInput, match="did you mean 'links'"):
        sw.identify(STUDY, stages="rigid", options={"linkz": {"order": 1}})
    with pytest.raises(sw.InvalidInput, match="'order' is 7"):
        sw.identify(STUDY, stages="rigid", options=sw.Options(links=sw.LinkOptions(order=7)))  # type: ignore[arg-type]
    assert list(inspect.signature(sw.Options).parameters)[:2] == ["rigid", "links"]
    assert pickle.loads(pickle.dumps(typed)) == copy.deepcopy(typed) == typed
