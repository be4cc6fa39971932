from __future__ import annotations

import gzip
import io
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import scipy.io

import studies
from strainwave.domain import FloatArray, Log, Study
from strainwave.errors import InvalidInput
from strainwave.io.logs import read_log, read_logs, write_log
from strainwave.io.study import read_study


def read(folder: Path, log: str | bytes | None = None, study: str = studies.STUDY) -> Log:
    parsed = read_study(studies.write(folder, study, log))
    return read_log(parsed, parsed.experiments[0])


def renamed(folder: Path, name: str, data: bytes, study: str = studies.STUDY) -> Log:
    """Read the same study with its log under another name."""
    path = studies.write(folder, study.replace("motion.csv", name))
    (folder / name).write_bytes(data)
    parsed = read_study(path)
    return read_log(parsed, parsed.experiments[0])


def parquet(values: dict[str, FloatArray]) -> bytes:
    sink = io.BytesIO()
    pq.write_table(pa.table(values), sink)
    return sink.getvalue()


def expect(log: Log) -> None:
    """Compare the log with `studies.columns` to the precision of the CSV."""
    for name, values in studies.columns().items():
        actual = log.time if name == "t" else log.channels[name]
        np.testing.assert_allclose(actual, values, atol=1e-8)
    assert log.sample_time == pytest.approx(0.001)
    assert not log.warnings


@pytest.mark.parametrize("delimiter", [",", ";", "\t"])
def test_csv_is_read_with_any_delimiter(delimiter: str, tmp_path: Path) -> None:
    expect(read(tmp_path, studies.csv_text(studies.columns(), delimiter)))


def test_csv_from_spreadsheets_is_read(tmp_path: Path) -> None:
    text = studies.csv_text(studies.columns(), ";").replace(".", ",").replace("\n", "\r\n")
    log = read(tmp_path, b"\xef\xbb\xbf# rig 3\r\n\r\n" + text.encode())
    expect(log)


def test_quoted_names_are_read_and_unmapped_columns_ignored(tmp_path: Path) -> None:
    text = studies.csv_text(studies.columns() | {"t": studies.columns()["t"]})
    lines = text.splitlines()
    lines[0] = ", ".join(f'"{name}"' for name in lines[0].split(","))
    lines = [f"{line},{'note' if k == 0 else 'ok'}" for k, line in enumerate(lines)]
    expect(read(tmp_path, "\n".join(lines)))


def test_reads_gzip_parquet_mat_and_hdf5(tmp_path: Path) -> None:
    values = studies.columns()
    text = studies.csv_text(values).encode()
    expect(renamed(tmp_path, "log.csv.gz", gzip.compress(text)))
    expect(renamed(tmp_path, "log.parquet", parquet(values)))
    sink = io.BytesIO()
    scipy.io.savemat(sink, dict(values))
    expect(renamed(tmp_path, "log.mat", sink.getvalue()))
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "made.h5", "w") as file:
        for name, column in values.items():
            file[name] = column[:, None]  # MATLAB's vectors have two dimensions
    data = (tmp_path / "made.h5").read_bytes()
    expect(renamed(tmp_path, "log.h5", data))
    expect(renamed(tmp_path, "log.mat", data))  # v7.3 is HDF5


@pytest.mark.parametrize("name", ["log.csv", "log.csv.gz", "log.parquet"])
def test_written_tables_read_back_equal(name: str, tmp_path: Path) -> None:
    path = studies.write(tmp_path, studies.STUDY.replace("motion.csv", name))
    write_log(tmp_path / name, studies.columns())
    study = read_study(path)
    log = read_log(study, study.experiments[0])
    for channel, values in log.channels.items():
        np.testing.assert_array_equal(values, studies.columns()[channel])


def test_writing_an_unknown_file_type_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InvalidInput, match="cannot be written"):
        write_log(tmp_path / "log.xlsx", studies.columns())


def test_channels_apply_scale_offset_and_added_columns(tmp_path: Path) -> None:
    values = studies.columns()
    values = {"time_ms": 1000.0 * values["t"]} | values | {"push": np.full(40, 0.5)}
    del values["t"]
    text = studies.STUDY.replace('use = "motion"', 'use = "motion"\nadd = { u1 = "push" }')
    text += '[channels]\nt = { column = "time_ms", scale = 0.001 }\n'
    text += 'u1 = { column = "u1", scale = -2.0, offset = 3.0 }\n'
    log = read(tmp_path, studies.csv_text(values), text)
    np.testing.assert_allclose(log.channels["u1"], -2.0 * (studies.columns()["u1"] + 0.5) + 3.0)
    assert log.time[-1] == pytest.approx(0.039)


def test_only_samples_of_the_window_are_read(tmp_path: Path) -> None:
    text = studies.STUDY.replace('use = "motion"', 'use = "motion"\nstart = 0.01\nstop = 0.03')
    log = read(tmp_path, None, text)
    assert (log.time[0], log.time[-1], len(log)) == (pytest.approx(0.01), pytest.approx(0.03), 21)


# --- time -------------------------------------------------------------------------------------


def timed(folder: Path, time: FloatArray, of: FloatArray | None = None) -> Log:
    """Read a log with the stamps `time`, whose samples are from `of` or from the same times."""
    values = studies.columns(len(time)) | {"t": time}
    sample_times = time if of is None else of
    values["u1"] = np.sign(np.sin(300.0 * sample_times))
    values["theta_m1"] = np.sin(20.0 * sample_times)
    values["theta_m2"] = sample_times**2
    values["a1"] = np.cos(30.0 * sample_times)
    return renamed(folder, "log.parquet", parquet(values))


def test_rounded_stamps_are_uniform(tmp_path: Path) -> None:
    log = timed(tmp_path, np.round(0.00100002406 * np.arange(500), 6))
    assert not log.warnings
    assert log.sample_time == pytest.approx(0.00100002406, rel=1e-5)


def test_jittered_stamps_are_resampled_and_reported(tmp_path: Path) -> None:
    jitter = np.random.default_rng(0).uniform(0.0, 0.6, 600)
    log = timed(tmp_path, 0.001 * (np.arange(600) + jitter))
    assert [w.code for w in log.warnings] == ["resampled"]
    np.testing.assert_allclose(np.diff(log.time), log.sample_time)
    # monotone cubic interpolation of a 3 Hz sine at 1 kHz: error below the squared step
    np.testing.assert_allclose(log.channels["theta_m1"], np.sin(20.0 * log.time), atol=1e-3)
    assert set(np.unique(log.channels["u1"])) <= {-1.0, 1.0}  # commands are held, not interpolated


@pytest.mark.parametrize("jitter", [0.01, 0.03, 0.1, 0.3])
def test_jittered_stamps_are_moved_to_a_clock_of_round_numbers(
    jitter: float, tmp_path: Path
) -> None:
    """The samples are uniform and only the stamps jitter, so the samples do not change."""
    offsets = np.random.default_rng(1).uniform(-jitter, jitter, 600)
    sample_times: FloatArray = 0.00025 * np.arange(600, dtype=np.float64)
    log = timed(tmp_path, sample_times + 0.00025 * offsets, of=sample_times)
    assert [w.code for w in log.warnings] == (["resampled"] if jitter > 0.02 else [])
    assert log.sample_time == pytest.approx(0.00025, rel=1e-9)
    np.testing.assert_allclose(log.channels["theta_m1"], np.sin(20.0 * sample_times), atol=1e-9)


@pytest.mark.parametrize("spread", ["white", "random walk"])
@pytest.mark.parametrize("seed", range(4))
def test_irregular_stamps_are_resampled_to_the_nominal_period(
    spread: str, seed: int, tmp_path: Path
) -> None:
    """Jitter of 10 % of a period: the nominal period is recovered.

    The median step differs from it by up to 0.2 %.
    """
    noise = 0.1 * np.random.default_rng(seed).standard_normal(4000)
    if spread == "white":
        time = 0.00025 * (np.arange(4000) + noise)
    else:
        time = 0.00025 * np.cumsum(1.0 + noise)
    log = timed(tmp_path, time)
    assert log.sample_time == pytest.approx(0.00025, rel=1e-9)
    (warning,) = log.warnings
    assert warning.code == "resampled"
    assert "0.00025 s" in warning.message


def test_a_missing_sample_is_resampled_and_a_long_gap_is_not(tmp_path: Path) -> None:
    time = np.delete(0.001 * np.arange(200), [50, 51])
    assert [w.code for w in timed(tmp_path, time).warnings] == ["resampled"]
    time = np.delete(0.001 * np.arange(200), range(50, 70))
    log = timed(tmp_path, time)  # the longest segment
    assert [w.code for w in log.warnings] == ["split"]
    np.testing.assert_allclose(log.time, time[50:])


# --- faults -----------------------------------------------------------------------------------


def edited(line: int, text: str) -> str:
    """Return the log with one line replaced; lines count from 1."""
    lines = studies.csv_text(studies.columns()).splitlines()
    lines[line - 1] = text
    return "\n".join(lines) + "\n"


FAULTS: dict[str, tuple[str | bytes, str]] = {
    "empty": ("", "is empty"),
    "header only": ("t,u1,u2,theta_m1,theta_m2\n", "line 1: there is no row of numbers"),
    "two rows": (
        "\n".join(studies.csv_text(studies.columns()).splitlines()[:3]),
        r"has 2 row\(s\)",
    ),
    "no header": (
        "\n".join(studies.csv_text(studies.columns()).splitlines()[1:]),
        r"no column 't', which .*the file has: data\[0\], data\[1\]",
    ),
    "same name twice": (edited(1, "t,u1,u1,theta_m1,theta_m2,a1"), "two columns named 'u1'"),
    "missing column": (
        edited(1, "t,u1,u2,theta_m1,thetam2,a1"),
        r"no column 'theta_m2'.*mean 'thetam2'",
    ),
    "no input": (
        edited(1, "t,x,u2,theta_m1,theta_m2,a1"),
        "no column 'u1', and no column 'torque1'",
    ),
    "infinite": (
        edited(9, "0.007,0,0,-inf,-0.03,1"),
        r"line 9, column 'theta_m1': the value is -inf",
    ),
    "text": (
        edited(9, "0.007,0,0,high,-0.03,1"),
        r"line 9, column 'theta_m1': 'high' is not a number",
    ),
    "too few values": (edited(9, "0.007,0,0"), r"line 9: 3 values where the header names 6"),
    "cut off": (edited(41, "0.039,0.1,0.9,0.3"), r"line 41: the log is truncated: 4 values"),
    "time stands": (
        studies.csv_text(studies.columns() | {"t": np.repeat(0.01 * np.arange(10), 4)}),
        r"line 3: 30 of 40 rows repeat the time stamp of the row before: the stamps are coarser",
    ),
    "UTF-16 without an end": (b"\xff\xfet\0,", "is not valid UTF-16"),
    "null bytes": (
        edited(9, "0.007,0,0,\0,-0.03,1"),
        r"line 9, column 'theta_m1': .*is not a number",
    ),
    "still": (
        studies.csv_text(studies.columns() | {"theta_m1": np.ones(40), "theta_m2": np.ones(40)}),
        "'theta_m1' never changes",
    ),
    "no excitation": (
        studies.csv_text(studies.columns() | {"u1": np.ones(40), "u2": np.zeros(40)}),
        "no motor input changes",
    ),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_the_error_locates_every_fault(fault: str, tmp_path: Path) -> None:
    log, message = FAULTS[fault]
    with pytest.raises(InvalidInput, match=message) as error:
        read(tmp_path, log)
    assert "motion.csv" in str(error.value)
    assert "Remedy: " in str(error.value)


@pytest.mark.parametrize(
    ("name", "data", "said"),
    [
        ("log.parquet", b"t,u1\n1,2\n", "is not a Parquet file"),
        ("log.parquet", parquet(studies.columns())[:-40], "is not a Parquet file"),
        (
            "log.parquet",
            parquet(studies.columns() | {"u1": np.array(["x"] * 40)}),
            "'u1'.* is not usable: text",
        ),
        ("log.parquet", b"", "is not a Parquet file"),
        ("log.csv.gz", b"t,u1\n", "cannot be unpacked"),
        (
            "log.csv.gz",
            gzip.compress(studies.csv_text(studies.columns()).encode())[:-20],
            "unpacked",
        ),
        ("log.mat", b"MATLAB 5.0 MAT-file", "is not a MAT file"),
        ("log.h5", b"\x89HDF but not really", "is not an HDF5 file"),
        ("log.xlsx", b"PK", "has an unknown file type"),
    ],
)
def test_a_file_of_another_type_is_refused(
    name: str, data: bytes, said: str, tmp_path: Path
) -> None:
    with pytest.raises(InvalidInput, match=said):
        renamed(tmp_path, name, data)


def test_the_error_states_the_row_of_an_infinity_in_a_parquet_file(tmp_path: Path) -> None:
    sink = io.BytesIO()
    columns = dict(studies.columns())
    columns["u1"] = np.where(np.arange(40) == 6, np.inf, columns["u1"])
    pq.write_table(pa.table(columns), sink)
    with pytest.raises(InvalidInput, match=r"row 7, column 'u1': the value is inf"):
        renamed(tmp_path, "log.parquet", sink.getvalue())


def test_hdf5_without_h5py_gives_the_install_command(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(__import__("sys").modules, "h5py", None)
    with pytest.raises(InvalidInput, match="pip install h5py"):
        renamed(tmp_path, "log.h5", b"\x89HDF\r\n\x1a\n")


def test_an_empty_window_states_the_time_range_of_the_log(tmp_path: Path) -> None:
    text = studies.STUDY.replace('use = "motion"', 'use = "motion"\nstart = 7.0')
    with pytest.raises(
        InvalidInput, match=r"window from 7 to inf s: the log extends from 0 to 0.039 s"
    ):
        read(tmp_path, None, text)


def test_a_channel_map_must_name_a_column(tmp_path: Path) -> None:
    text = studies.STUDY + '[channels]\ntheta_m2 = "pos_2"\n'
    message = r"no column 'pos_2', which .channels. names for 'theta_m2'"
    with pytest.raises(InvalidInput, match=message):
        read(tmp_path, None, text)
    text = studies.STUDY.replace('use = "motion"', 'use = "motion"\nadd = { u1 = "push" }')
    with pytest.raises(InvalidInput, match="no column 'push', which the study adds to 'u1'"):
        read(tmp_path, None, text)
    text = studies.STUDY + '[channels]\nu1 = "u_1"\n'
    with pytest.raises(
        InvalidInput, match=r"no column 'u_1', which .* for 'u1'.*did you mean 'u1'"
    ):
        read(tmp_path, None, text)


def test_a_mapped_column_may_be_missing_from_some_logs_but_not_from_all(tmp_path: Path) -> None:
    columns = studies.columns()
    text = studies.STUDY.replace('"prbs"\nfile = "motion.csv"', '"prbs"\nfile = "prbs.csv"')
    text += '[channels]\na2 = "accel_2"\n'
    (tmp_path / "prbs.csv").write_text(studies.csv_text(columns))
    motion_log = studies.csv_text({**columns, "Accel2": columns["a1"]})
    message = r"no log has the column 'accel_2', .* for 'a2'.*did you mean 'Accel2'"
    with pytest.raises(InvalidInput, match=message):
        read_logs(read_study(studies.write(tmp_path, text, motion_log)))
    (tmp_path / "prbs.csv").write_text(studies.csv_text({**columns, "accel_2": columns["a1"]}))
    motion, prbs = read_logs(read_study(studies.write(tmp_path, text)))
    assert "a2" not in motion.channels
    np.testing.assert_allclose(prbs.channels["a2"], columns["a1"], atol=1e-8)


def test_a_voltage_needs_its_torque(tmp_path: Path) -> None:
    text = studies.STUDY.replace("torque_per_volt = 0.03\n", "")
    with pytest.raises(InvalidInput, match="joint 2 has a voltage log but no torque_per_volt"):
        read(tmp_path, None, text)


def test_a_constant_sensor_gives_a_warning_but_an_unused_joint_does_not(tmp_path: Path) -> None:
    values = studies.columns() | {"a1": np.full(40, 0.13), "u2": np.zeros(40)}
    log = read(tmp_path, studies.csv_text(values))
    assert [(w.code, "'a1'" in w.message) for w in log.warnings] == [("constant-channel", True)]


@pytest.mark.parametrize(("range_", "has_failed"), [(0.009, False), (0.1, True)])
def test_the_velocity_of_a_motor_at_rest_may_be_constant(
    range_: float, has_failed: bool, tmp_path: Path
) -> None:
    angle = range_ * np.linspace(-0.5, 0.5, 40)
    values = studies.columns() | {"omega_m2": np.zeros(40), "theta_m2": angle}
    log = read(tmp_path, studies.csv_text(values))
    assert [w.code for w in log.warnings] == ["constant-channel"] * has_failed


def test_the_excited_joint_must_move(tmp_path: Path) -> None:
    values = studies.columns() | {"theta_m1": np.ones(40)}
    study: Study = read_study(studies.write(tmp_path, log=studies.csv_text(values)))
    read_log(study, study.experiments[0])
    with pytest.raises(InvalidInput, match=r"'theta_m1' never changes.*exchange .* 'theta_m2'"):
        read_log(study, study.experiments[1])


def test_reads_every_log_of_the_measured_data(shared_data: Path) -> None:
    codes = {}
    for path in sorted(shared_data.glob("*/*/study.toml")):
        logs = read_logs(read_study(path))
        codes[path.parent.name] = {warning.code for log in logs for warning in log.warnings}
    assert codes.pop("dfki-double-pendulum") == {"resampled"}
    assert not any(codes.values())
