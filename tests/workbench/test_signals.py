"""Page "Signals": records, panels, scales, windows, steps."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from strainwave.domain import FloatArray
from strainwave.io.logs import write_log
from strainwave.io.study import read_study

pytest.importorskip("starlette")

from strainwave.io.kept_files import fingerprint
from strainwave.workbench.pages.estimate import snapshot
from workbench_client import make_client

if TYPE_CHECKING:
    from starlette.testclient import TestClient

PATH = "arm/study.toml"


def test_the_sequence_of_a_record_is_detected(client: TestClient) -> None:
    record = client.get(f"/api/record/{PATH}", params={"record": "prbs-j1"}).json()
    prbs = read_study_of(client).experiments
    wanted = next(e.prbs for e in prbs if e.name == "prbs-j1")
    assert wanted is not None
    (text,) = [line for line in record["sequences"] if line.startswith("u1")]
    assert f"order {wanted.order}" in text
    assert f"clock {1e3 * wanted.clock:g} ms" in text


def read_study_of(client: TestClient) -> Any:
    app: Any = client.app
    return read_study(app.state.workspace.folder / PATH)


def test_commands_of_a_position_servo_are_angles(tmp_path: Path) -> None:
    """The logs have no motor torque, and the page shows them all the same."""
    time = 0.01 * np.arange(500)
    columns = {"t": time, "ref1": np.sin(time), "theta_m1": np.sin(time - 0.05)}
    write_log(tmp_path / "motion.csv", columns)
    (tmp_path / "study.toml").write_text(_SERVO_STUDY)
    client = make_client(tmp_path)
    record = client.get("/api/record/study.toml", params={"record": "motion"}).json()
    assert set(record["channels"]) == {"ref1", "theta_m1"}
    query = {"record": "motion", "channel": ["ref1", "theta_m1"], "panels": "unit"}
    figure = client.get("/api/signal-time/study.toml", params=query).text
    assert "ref1, theta_m1 [rad]" in figure


_SERVO_STUDY = """
[arm]
kind = "single-joint"

[[joint]]
spring = "rigid"
gear_ratio = 1.0

[servo]
kind = "position"
period = 0.001
kp = [10.0]
kd = ["unknown"]

[[experiment]]
name = "motion"
file = "motion.csv"
use = "motion"
control = ["servo"]
"""


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
