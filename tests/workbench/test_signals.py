"""Page "Signals": decimation, spectra, sequences, marks, windows."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from strainwave.domain import Experiment, FloatArray, Log
from strainwave.dynamics.arm import Arm
from strainwave.io.study import read_study

pytest.importorskip("starlette")

from strainwave.workbench.pages.signal_figures import (
    ShownRecord,
    View,
    coherence_figure,
    spectrum_figure,
    time_figure,
)
from strainwave.workbench.pages.signals import marks_of, sequences_of

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


def view_of(folder: Path, log: Log, *channels: str, **choices: str) -> View:
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
        {"channel": "u1", "panels": "none"},
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
