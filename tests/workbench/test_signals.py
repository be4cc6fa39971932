"""Page "Signals": decimation, spectra, sequences, marks, windows."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from strainwave.domain import Experiment, FloatArray, Log
from strainwave.dynamics.arm import Arm
from strainwave.io.logs import write_log
from strainwave.io.study import read_study

pytest.importorskip("starlette")

from strainwave.workbench.pages.estimate import snapshot
from strainwave.workbench.pages.signal_figures import (
    ShownRecord,
    View,
    coherence_figure,
    spectrum_figure,
    time_figure,
)
from strainwave.workbench.pages.signals import marks_of, sequences_of
from strainwave.workbench.workspace import fingerprint

if TYPE_CHECKING:
    from starlette.testclient import TestClient

PATH = "arm/study.toml"
T = 1e-3


def log_with(channels: Mapping[str, FloatArray], *, control: str = "servo") -> Log:
    samples = len(next(iter(channels.values())))
    controls: Any = (control, control)
    experiment = Experiment("one", "one.csv", "motion", controls)
    return Log(experiment, np.arange(samples) * np.float64(T), T, channels)


def motors(samples: int) -> dict[str, FloatArray]:
    angle = 3.0 * np.sin(2.0 * np.pi * 0.7 * T * np.arange(samples))
    return {"theta_m1": angle, "theta_m2": 0.5 * angle, "u1": 2.0 * angle, "u2": angle}


def view_of(folder: Path, log: Log, *channels: str, **choices: Any) -> View:
    arm = read_study(folder / PATH).arm
    return View([ShownRecord("one", [log])], channels, arm, **choices)


def test_a_million_points_are_few_and_keep_their_peaks(folder: Path) -> None:
    values = np.random.default_rng(1).normal(size=1_000_000)
    values[123_456], values[654_321] = 50.0, -60.0
    log = log_with({"a1": values, **motors(1_000_000)})
    (panel,) = time_figure(view_of(folder, log, "a1"), (0.0, 1000.0), 1500).panels
    drawn: Any = panel.marks[0]
    assert len(drawn.x) <= 1500
    assert (drawn.y.min(), drawn.y.max()) == (-60.0, 50.0)


def test_a_zoom_shows_every_sample(folder: Path) -> None:
    log = log_with(motors(100_000))
    (panel,) = time_figure(view_of(folder, log, "u1"), (10.0, 10.5), 1500).panels
    drawn: Any = panel.marks[0]
    assert 501 <= len(drawn.x) <= 504
    assert drawn.x[0] <= 10.0
    assert drawn.x[-1] >= 10.5


def test_the_spectrum_of_a_sine_has_its_peak_and_power(folder: Path) -> None:
    time = T * np.arange(60_000)
    log = log_with({"u1": 3.0 * np.sin(2.0 * np.pi * 40.0 * time)})
    view = view_of(folder, log, "u1")
    (panel,) = spectrum_figure(view, log_frequency=True, log_magnitude=True).panels
    drawn: Any = panel.marks[0]
    assert drawn.x[np.argmax(drawn.y)] == pytest.approx(40.0, abs=0.2)


def test_linear_systems_are_coherent_and_noise_is_not() -> None:
    rng = np.random.default_rng(2)
    drive = rng.normal(size=40_000)
    channels = {"u1": drive, "theta_m1": T * np.cumsum(drive)}
    channels |= {"u2": rng.normal(size=40_000), "theta_m2": T * np.cumsum(rng.normal(size=40_000))}
    coherent, noise = (mark for mark in coherence_figure(log_with(channels), 2).marks)
    assert np.median(coherent.y) > 0.95  # type: ignore[union-attr]
    assert np.median(noise.y) < 0.5  # type: ignore[union-attr]


def test_saturation_standstill_and_a_spike_are_marked(folder: Path) -> None:
    arm = Arm.of(read_study(folder / PATH).arm)
    channels = motors(8000) | {"a1": np.random.default_rng(3).normal(size=8000) * 0.01}
    channels["u1"] = np.clip(channels["u1"] * 4.0, -10.0, 10.0)
    channels["theta_m2"][2000:3000] = channels["theta_m2"][2000]
    channels["a1"][5000] = 40.0
    kinds = {(mark.kind, mark.channel): mark for mark in marks_of(log_with(channels), arm)}
    assert ("saturation", "u1") in kinds
    assert kinds["spikes", "a1"].start == pytest.approx(5.0)
    standing = kinds["standstill", "theta_m2"]
    assert standing.start < 2.5 < standing.stop


def test_the_sequence_of_a_record_is_detected(client: TestClient) -> None:
    record = client.get(f"/api/record/{PATH}", params={"record": "prbs-j1"}).json()
    prbs = read_study_of(client).experiments
    wanted = next(e.prbs for e in prbs if e.name == "prbs-j1")
    assert wanted is not None
    (text,) = [line for line in record["sequences"] if line.startswith("u1")]
    assert f"order {wanted.order}" in text
    assert f"clock {1e3 * wanted.clock:g} ms" in text
    assert not sequences_of(log_with(motors(4000)))


def read_study_of(client: TestClient) -> Any:
    app: Any = client.app
    return read_study(app.state.workspace.folder / PATH)


def test_a_window_is_written_and_read_back(client: TestClient, folder: Path) -> None:
    study = folder / PATH
    study.write_text("# kept\n" + study.read_text())
    body = {"experiment": "motion", "start": 1.5, "stop": 6.0}
    assert client.post(f"/api/window/{PATH}", json=body).status_code == 200
    experiment = read_study(study).experiments[0]
    assert (experiment.start, experiment.stop) == (1.5, 6.0)
    assert study.read_text().startswith("# kept\n")
    record = client.get(f"/api/record/{PATH}", params={"record": "motion"}).json()
    assert record["window"] == [1.5, 6.0]
    assert record["stop"] > 9.0  # the viewer shows the whole record
    client.post(f"/api/window/{PATH}", json={"experiment": "motion", "start": None, "stop": None})
    assert read_study(study).experiments[0].start is None


@pytest.mark.parametrize("ends", [(5.0, 2.0), (500.0, 600.0), ("a", None)])
def test_an_empty_window_is_refused(client: TestClient, ends: tuple[Any, Any]) -> None:
    body = {"experiment": "motion", "start": ends[0], "stop": ends[1]}
    assert client.post(f"/api/window/{PATH}", json=body).status_code == 400


@pytest.mark.parametrize(
    "query",
    [
        {"channel": "nothing"},
        {},
        {"channel": "u1", "from": "x"},
        {"channel": "u1", "from": "3", "to": "3"},
        {"channel": "u1", "units": "miles"},
        {"channel": "u1", "steps": "{"},
        {"channel": "u1", "steps": "[1]"},
        {"channel": "u1", "steps": '[{"kind": "lowpass"}]'},
        {"channel": "u1", "steps": '[{"kind": "lowpass", "cutoff_hz": null}]'},
        {"channel": "u1", "steps": '[{"kind": "merge", "file": "../../out.csv"}]'},
    ],
)
def test_a_wrong_request_gives_a_sentence(client: TestClient, query: dict[str, str]) -> None:
    answer = client.get(f"/api/signal-time/{PATH}", params=query | {"record": "motion"})
    assert answer.status_code == 400
    assert answer.json()["error"]


def test_the_two_inputs_of_a_joint_have_a_spectrum(client: TestClient) -> None:
    query = {"experiment": "prbs-j2"}
    shown = client.get(f"/api/joint-spectrum/{PATH}", params=query).json()
    assert len(shown["figure"]["data"]) == 2
    assert all(check["message"] for check in shown["checks"])
    refused = client.get(f"/api/joint-spectrum/{PATH}", params={"experiment": "motion"})
    assert refused.status_code == 422


# --- records, panels and units ----------------------------------------------------------------


def time_of(client: TestClient, **query: Any) -> dict[str, Any]:
    answer = client.get(f"/api/signal-time/{PATH}", params=query)
    assert answer.status_code == 200, answer.json()
    figure: dict[str, Any] = answer.json()
    return figure


def test_records_are_overlaid_from_their_starts(client: TestClient, folder: Path) -> None:
    late = pandas_table(folder / "arm" / "motion-check.parquet")
    late["t"] = late["t"] + 100.0
    write_log(folder / "arm" / "motion-check.parquet", late)
    names = ["motion", "motion-check"]
    figure = time_of(client, record=names, channel=["u1", "a1"], panels="unit")
    lines = figure["data"]
    assert [line["name"] for line in lines] == [
        f"{channel}, {name}" for channel in ("u1 [V]", "a1 [m/s²]") for name in names
    ]
    assert all(0.0 <= line["x"][0] < 0.05 for line in lines)
    assert len({line["line"]["color"] for line in lines}) == 4
    assert figure["layout"]["xaxis"]["title"]["text"] == "time from the start of each record [s]"
    alone = time_of(client, record="motion-check", channel="u1")
    assert 100.0 <= alone["data"][0]["x"][0] < 100.1


def pandas_table(path: Path) -> dict[str, FloatArray]:
    import pyarrow.parquet as pq

    table = pq.read_table(path)
    return {name: table[name].to_numpy() for name in table.column_names}


@pytest.mark.parametrize(("panels", "count"), [("channel", 4), ("unit", 3)])
def test_channels_share_panels(panels: str, count: int, client: TestClient) -> None:
    channels = ["u1", "u2", "theta_m1", "a1"]
    figure = time_of(client, record="motion", channel=channels, panels=panels)
    assert len({line["yaxis"] for line in figure["data"]}) == count
    assert len(figure["data"]) == 4


@pytest.mark.parametrize(
    ("units", "factors", "names"),
    [
        ("deg", (57.29578, 57.29578), ("deg", "deg/s")),
        ("rpm", (57.29578, 9.549297), ("deg", "rpm")),
    ],
)
def test_angles_and_rates_have_the_chosen_units(
    units: str, factors: tuple[float, float], names: tuple[str, str], folder: Path
) -> None:
    channels = motors(500) | {"omega_m1": np.linspace(-3.0, 3.0, 500)}
    log = log_with(channels)
    figure = time_figure(
        view_of(folder, log, "theta_m1", "omega_m1", "u1", units=units), (0.0, 0.5), 1000
    )
    drawn: list[Any] = [panel.marks[0] for panel in figure.panels]
    for line, unit in zip(drawn, (*names, "V"), strict=True):
        assert f"[{unit}]" in line.name
    np.testing.assert_allclose(drawn[0].y, factors[0] * channels["theta_m1"], rtol=1e-6)
    np.testing.assert_allclose(drawn[1].y, factors[1] * channels["omega_m1"], rtol=1e-6)
    np.testing.assert_array_equal(drawn[2].y, channels["u1"])


def test_spectra_have_the_chosen_scales(client: TestClient) -> None:
    def types(**query: str) -> list[str | None]:
        query |= {"record": "motion", "channel": "a1"}
        layout = client.get(f"/api/signal-spectra/{PATH}", params=query).json()["spectra"]["layout"]
        return [layout[axis].get("type") for axis in ("xaxis", "yaxis")]

    assert types() == ["log", "log"]
    assert types(frequency="linear") == [None, "log"]
    assert types(magnitude="linear") == ["log", None]


# --- steps ------------------------------------------------------------------------------------


def steps_text(*steps: dict[str, Any]) -> str:
    return json.dumps(steps)


LOWPASS = {"kind": "lowpass", "cutoff_hz": 20.0}


def test_steps_are_shown_before_they_are_written(client: TestClient, folder: Path) -> None:
    query = {"record": "motion", "channel": "a1", "from": 1.0, "to": 2.0}
    figure = time_of(client, **query, steps=steps_text(LOWPASS), before="1")
    before, after = figure["data"]
    assert after["name"] == "a1 [m/s²]"
    assert before["name"] == "a1 [m/s²], before the steps"
    assert np.std(np.diff(after["y"])) < 0.5 * np.std(np.diff(before["y"]))
    assert [line["name"] for line in time_of(client, **query, before="1")["data"]] == ["a1 [m/s²]"]
    assert not read_study(folder / PATH).experiments[0].steps


def test_steps_are_written_and_comments_stay(client: TestClient, folder: Path) -> None:
    study = folder / PATH
    written = """\
steps = [
    # of the sensor
    { kind = "detrend", channels = ["a1"] },  # 0.2 m/s^2
    { kind = "lowpass", cutoff_hz = 80.0 },  # noise
]"""
    text = study.read_text().replace('name = "motion"', f'name = "motion"\n{written}', 1)
    study.write_text(text)
    resample = {"kind": "resample", "sample_time": 0.002}
    detrend = {"kind": "detrend", "channels": ["a1"]}

    def write(*steps: dict[str, Any]) -> None:
        body = {"experiment": "motion", "steps": steps}
        assert client.post(f"/api/steps/{PATH}", json=body).json() == {}
        record = client.get(f"/api/record/{PATH}", params={"record": "motion"}).json()
        assert record["steps"] == list(steps)

    write(detrend, LOWPASS | {"cutoff_hz": 90.0}, resample)
    assert "# of the sensor" in study.read_text()
    assert "# 0.2 m/s^2" in study.read_text()
    write(resample, detrend)
    assert "# 0.2 m/s^2" in study.read_text()
    write()
    assert study.read_text().count("steps") == 0
    write(LOWPASS)
    assert len(read_study(study).experiments[0].steps) == 1


@pytest.mark.parametrize(
    "steps",
    [
        None,
        "lowpass",
        [3],
        [{"kind": "lowpass"}],
        [{"kind": ["lowpass"]}],
        [{"kind": "lowpass", "cutoff_hz": "x"}],
        [{"kind": "detrend", "channels": ["theta_m1"]}],
        [{"kind": "merge", "file": "../../../etc/passwd"}],
        [{"kind": "merge", "file": "none.csv"}],
    ],
)
def test_wrong_steps_are_refused(steps: object, client: TestClient, folder: Path) -> None:
    text = (folder / PATH).read_text()
    answer = client.post(f"/api/steps/{PATH}", json={"experiment": "motion", "steps": steps})
    assert answer.status_code == 400
    assert answer.json()["error"]
    assert (folder / PATH).read_text() == text


def test_a_merged_log_outside_is_not_read(client: TestClient, folder: Path) -> None:
    (folder.parent / "outside.parquet").write_bytes(
        (folder / "arm" / "motion.parquet").read_bytes()
    )
    study = folder / PATH
    step = 'steps = [{ kind = "merge", file = "../../outside.parquet" }]'
    study.write_text(study.read_text().replace('name = "motion"', f'name = "motion"\n{step}', 1))
    answer = client.get(f"/api/record/{PATH}", params={"record": "motion"})
    assert answer.status_code == 400
    assert "leads out of the served folder" in answer.json()["error"]


def test_a_merged_log_is_shown_whole_and_followed(client: TestClient, folder: Path) -> None:
    columns = pandas_table(folder / "arm" / "motion.parquet")
    half = len(columns["t"]) // 2
    first, second = folder / "arm" / "motion.parquet", folder / "arm" / "second.parquet"
    write_log(first, {name: values[:half] for name, values in columns.items()})
    later = {
        name: values[half:] + (5.0 if name == "t" else 0.0) for name, values in columns.items()
    }
    write_log(second, later)
    body = {"experiment": "motion", "steps": [{"kind": "merge", "file": "second.parquet"}]}
    client.post(f"/api/steps/{PATH}", json=body)
    record = client.get(f"/api/record/{PATH}", params={"record": "motion"}).json()
    assert record["samples"] == len(columns["t"])
    assert record["files"] == ["motion.parquet", "second.parquet"]
    assert len(time_of(client, record="motion", channel="u1")["data"]) == 2  # a pause
    before = fingerprint(folder / PATH)
    write_log(second, later | {"u1": 2.0 * later["u1"]})
    assert fingerprint(folder / PATH) != before
    assert "../../second.parquet" in snapshot(folder / PATH)
