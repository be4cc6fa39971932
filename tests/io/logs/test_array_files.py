"""Files of arrays: matrices either way, structs, groups, lists and records; hostile files."""

from __future__ import annotations

import gzip
import io
import json
import os
import pickle
import zipfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.feather
import pyarrow.parquet as pq
import pytest
import scipy.io

from strainwave.domain import FloatArray
from strainwave.errors import InvalidInput
from strainwave.io.logs import tables as table_module
from strainwave.io.logs.arrays import open_memory_table
from strainwave.io.logs.tables import LogTable, open_table

N = 50
TIME: FloatArray = np.linspace(0.0, 0.49, N)
ANGLES: FloatArray = np.sin(np.outer(TIME, [3.0, 5.0, 7.0]))
TORQUES: FloatArray = np.cos(np.outer(TIME, [3.0, 5.0, 7.0]))


def table_of(folder: Path, name: str, data: bytes) -> LogTable:
    (folder / name).write_bytes(data)
    return open_table(folder / name)


def npz(**arrays: Any) -> bytes:
    sink = io.BytesIO()
    np.savez(sink, **arrays)
    return sink.getvalue()


def npy(array: Any) -> bytes:
    sink = io.BytesIO()
    np.save(sink, array)
    return sink.getvalue()


def matlab(variables: dict[str, Any], **options: Any) -> bytes:
    sink = io.BytesIO()
    scipy.io.savemat(sink, variables, **options)
    return sink.getvalue()


def hdf5(folder: Path, content: dict[str, Any]) -> bytes:
    h5py = pytest.importorskip("h5py")
    with h5py.File(folder / "made.h5", "w") as file:
        for name, values in content.items():
            file[name] = values
    return (folder / "made.h5").read_bytes()


def lines(records: list[dict[str, Any]]) -> bytes:
    return "\n".join(json.dumps(record) for record in records).encode()


def expect(table: LogTable, columns: dict[str, FloatArray]) -> None:
    """Compare the columns; the others of the table are named by its notes alone."""
    assert list(table.names) == list(columns)
    for name, values in table.read(table.names).items():
        assert values.dtype == np.float64
        np.testing.assert_allclose(values, columns[name], rtol=1e-15, err_msg=name)


def columns(prefix: str, matrix: FloatArray) -> dict[str, FloatArray]:
    return {f"{prefix}[{k}]": column for k, column in enumerate(matrix.T)}


ALL = {"t": TIME} | columns("q", ANGLES) | columns("tau", TORQUES)
RECORDS = [
    {"t": t, "joint": {"q": q.tolist(), "on": True}, "mode": "RUN"}
    for t, q in zip(TIME, ANGLES, strict=True)
]


@pytest.mark.parametrize("is_transposed", [False, True])
@pytest.mark.parametrize("kind", ["mat", "npz", "h5", "memory"])
def test_matrices_are_read_whichever_way_they_are_stored(
    kind: str, is_transposed: bool, tmp_path: Path
) -> None:
    arrays: dict[str, Any] = {"t": TIME, "q": ANGLES, "tau": TORQUES}
    if is_transposed:
        arrays |= {"q": ANGLES.T, "tau": TORQUES.T, "t": TIME[:, None]}
    arrays |= {"gain": 3.0, "gains": np.ones(3), "image": np.ones((N, 40, 30), dtype=np.uint8)}
    if kind == "memory":
        table = open_memory_table(arrays, "data")
    else:
        data = {
            "mat": lambda: matlab(arrays),
            "npz": lambda: npz(**arrays),
            "h5": lambda: hdf5(tmp_path, arrays),
        }[kind]()
        table = table_of(tmp_path, f"log.{kind}", data)
    expect(replace(table, names=sorted(table.names)), dict(sorted(ALL.items())))
    assert set(table.omitted) == {"gain", "gains", "image"}


def test_the_other_lengths_orient_a_matrix_with_few_samples(tmp_path: Path) -> None:
    data = npz(t=TIME[:5], q=np.ones((7, 5)), tau=np.ones((7, 5)), u=np.ones(5))
    assert len(table_of(tmp_path, "log.npz", data).read(["q[6]"])["q[6]"]) == 5


@pytest.mark.parametrize("is_compressed", [False, True])
def test_structs_of_mat_files_are_read(is_compressed: bool, tmp_path: Path) -> None:
    log = {"t": TIME, "q": ANGLES, "set": {"tau": TORQUES.T, "name": "rig"}}
    table = table_of(tmp_path, "log.mat", matlab({"log": log}, do_compression=is_compressed))
    expect(table, {"log.t": TIME} | columns("log.q", ANGLES) | columns("log.set.tau", TORQUES))
    assert table.omitted == {"log.set.name": "text"}


def test_a_simulink_structure_with_time_is_read(tmp_path: Path) -> None:
    kinds = [("values", object), ("dimensions", object), ("label", object)]
    signals = np.empty((1, 2), dtype=kinds)
    signals[0, 0] = (ANGLES, 3.0, "q")
    signals[0, 1] = (TORQUES[:, :1], 1.0, "u")
    data = matlab({"simout": {"time": TIME[:, None], "signals": signals}, "tout": TIME})
    names = columns("simout.signals[0].values", ANGLES)
    names |= {"simout.signals[1].values": TORQUES[:, 0]}
    expect(table_of(tmp_path, "log.mat", data), {"simout.time": TIME} | names | {"tout": TIME})


@pytest.mark.parametrize("name", ["log.mat", "log.npy", "log.npz", "log.h5", "log.json"])
def test_a_matrix_alone_is_data(name: str, tmp_path: Path) -> None:
    rows = np.vstack([TIME, ANGLES.T])
    data = {
        "log.mat": lambda: matlab({"scope": rows}),
        "log.npy": lambda: npy(rows),
        "log.npz": lambda: npz(arr_0=rows),
        "log.h5": lambda: hdf5(tmp_path, {"run/scope": rows.T}),
        "log.json": lambda: json.dumps(rows.T.tolist()).encode(),
    }[name]()
    expect(table_of(tmp_path, name, data), columns("data", rows.T))


def test_the_name_of_a_matrix_of_one_quantity_is_kept(tmp_path: Path) -> None:
    expect(table_of(tmp_path, "log.mat", matlab({"q": ANGLES})), columns("q", ANGLES))


def test_groups_of_hdf5_and_structs_of_mat_7_3(tmp_path: Path) -> None:
    data = hdf5(tmp_path, {"robot/t": TIME, "robot/q": ANGLES, "robot/arm/tau": TORQUES})
    found = columns("robot/arm/tau", TORQUES) | columns("robot/q", ANGLES) | {"robot/t": TIME}
    expect(table_of(tmp_path, "log.hdf5", data), found)
    dotted = {name.replace("/", "."): values for name, values in found.items()}
    expect(table_of(tmp_path, "log.mat", data), dotted)


def test_fields_of_a_structured_array_are_columns(tmp_path: Path) -> None:
    array = np.zeros(N, dtype=[("t", "f8"), ("q", "f4", (3,))])
    array["t"], array["q"] = TIME, ANGLES
    found = {"t": TIME} | columns("q", ANGLES.astype("f4").astype(float))
    expect(table_of(tmp_path, "log.npy", npy(array)), found)


@pytest.mark.parametrize("name", ["log.parquet", "log.feather", "log.arrow"])
def test_lists_and_structs_of_arrow_files(name: str, tmp_path: Path) -> None:
    start = 1709287200_000_000_000
    stamps = pa.array(start + np.arange(N) * 10_000_000, pa.timestamp("ns", "UTC"))
    content = pa.table(
        {
            "timestamp": stamps,
            "observation.state": list(ANGLES),
            "action": pa.FixedSizeListArray.from_arrays(TORQUES.ravel(), 3),
            "joint": pa.array([{"q": a[0], "v": a.tolist()} for a in ANGLES]),
            "index": pa.array(np.arange(N)),
            "clock": [f"10:00:{t:06.3f}" for t in TIME],
            "task": ["pick"] * N,
            "done": [False] * N,
        }
    )
    sink = io.BytesIO()
    if name == "log.parquet":
        pq.write_table(content, sink)
    elif name == "log.feather":
        pyarrow.feather.write_feather(content, sink)
    else:
        with pa.ipc.new_stream(sink, content.schema) as writer:
            writer.write_table(content)
    table = table_of(tmp_path, name, sink.getvalue())
    assert table.clocks == {"timestamp": "datetime", "clock": "time"}
    assert table.omitted == {"task": "text", "done": "flags"}
    read = table.read(table.names)
    np.testing.assert_allclose(read.pop("timestamp") - start / 1e9, TIME, atol=3e-7)
    np.testing.assert_allclose(read.pop("clock") - 36000.0, TIME, atol=1e-9)
    named = columns("observation.state", ANGLES) | columns("action", TORQUES)
    named |= (
        {"joint.q": ANGLES[:, 0]}
        | columns("joint.v", ANGLES)
        | {"index": np.arange(N, dtype=float)}
    )
    assert read.keys() == named.keys()
    for column, values in read.items():
        np.testing.assert_array_equal(values, named[column])


def test_nulls_are_nan_and_lists_of_other_lengths_refused(tmp_path: Path) -> None:
    rows = [None if k == 3 else row.tolist() for k, row in enumerate(ANGLES)]
    counts = pa.array([None if k == 5 else k for k in range(N)])
    sink = io.BytesIO()
    pq.write_table(pa.table({"q": rows, "count": counts}), sink)
    read = table_of(tmp_path, "log.parquet", sink.getvalue()).read(["q[1]", "count"])
    assert np.flatnonzero(np.isnan(read["q[1]"])).tolist() == [3]
    assert np.flatnonzero(np.isnan(read["count"])).tolist() == [5]
    np.testing.assert_array_equal(read["q[1]"][4:], ANGLES[4:, 1])
    rows[9] = [1.0]
    sink = io.BytesIO()
    pq.write_table(pa.table({"q": rows}), sink)
    with pytest.raises(InvalidInput, match=r"row 10: the lists differ in length: 1 values after 3"):
        table_of(tmp_path, "log.parquet", sink.getvalue()).read(["q[0]"])


@pytest.mark.parametrize(
    ("name", "document"),
    [
        ("log.json", json.dumps(RECORDS).encode()),
        ("log.jsonl", lines(RECORDS)),
        ("log.json", lines(RECORDS)),
        ("log.ndjson", b"\xef\xbb\xbf" + lines(RECORDS) + b"\n\n"),
        ("log.json", json.dumps({"t": TIME.tolist(), "joint": {"q": ANGLES.tolist()}}).encode()),
        (
            "log.json",
            json.dumps(
                {"t": dict(enumerate(TIME)), "joint.q": dict(enumerate(ANGLES.tolist()))}
            ).encode(),
        ),
    ],
)
def test_records_and_columns_of_json(name: str, document: bytes, tmp_path: Path) -> None:
    expect(table_of(tmp_path, name, document), {"t": TIME} | columns("joint.q", ANGLES))


def test_lists_of_joints_and_stamps_of_json(tmp_path: Path) -> None:
    records = [
        {"stamp": f"2024-03-01T10:00:{t:06.3f}Z", "joints": [{"q": q} for q in row], "u": None}
        for t, row in zip(TIME, ANGLES, strict=True)
    ]
    records[4]["joints"] = None
    table = table_of(tmp_path, "log.jsonl", lines(records))
    assert list(table.names) == ["stamp", "joints[0].q", "joints[1].q", "joints[2].q"]
    assert table.clocks == {"stamp": "datetime"}
    read = table.read(["stamp", "joints[2].q"])
    np.testing.assert_allclose(read["stamp"] - 1709287200.0, TIME, atol=5e-7)
    assert np.flatnonzero(np.isnan(read["joints[2].q"])).tolist() == [4]


def test_faults_of_json_are_located(tmp_path: Path) -> None:
    whole = lines(RECORDS)
    with pytest.raises(InvalidInput, match="line 50: the log is truncated: the line is not JSON"):
        table_of(tmp_path, "log.jsonl", whole[:-5])
    with pytest.raises(InvalidInput, match="line 2: the line is not JSON"):
        table_of(tmp_path, "log.jsonl", whole.replace(b"\n", b"\n]", 1))
    with pytest.raises(InvalidInput, match="is not JSON, or is damaged"):
        table_of(tmp_path, "log.json", b"[1, 2")
    with pytest.raises(InvalidInput, match="contains no array of numbers; it contains x"):
        table_of(tmp_path, "log.json", b'{"x": 3}')


# --- Hostile files --------------------------------------------------------------------------


class _Trap:
    def __reduce__(self) -> tuple[Any, ...]:
        return os.abort, ()


def test_objects_are_never_unpickled(tmp_path: Path) -> None:
    trap = np.array([_Trap(), _Trap()], dtype=object)
    for name, data in (("log.npz", npz(x=trap)), ("log.npy", npy(trap))):
        with pytest.raises(InvalidInput, match="Object arrays cannot be loaded"):
            table_of(tmp_path, name, data)
    table = table_of(tmp_path, "log.npz", npz(x=trap, t=TIME))
    assert list(table.names) == ["t"]
    assert "Object arrays" in table.omitted["x"]
    with pytest.raises(InvalidInput, match="is not a NumPy file"):
        table_of(tmp_path, "log.npy", pickle.dumps(_Trap()))


@pytest.mark.parametrize("kind", ["external dataset", "external link", "virtual dataset"])
def test_hdf5_that_refers_to_another_file_is_refused(kind: str, tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    secret = tmp_path / "secret.bin"
    secret.write_bytes(TIME.tobytes())
    with h5py.File(tmp_path / "other.h5", "w") as other:
        other["x"] = TIME
    with h5py.File(tmp_path / "log.h5", "w") as file:
        group = file.create_group("run")
        group["t"] = TIME
        if kind == "external dataset":
            group.create_dataset("x", (N,), "f8", external=[(str(secret), 0, 8 * N)])
        elif kind == "external link":
            group["x"] = h5py.ExternalLink(str(tmp_path / "other.h5"), "x")
        else:
            layout = h5py.VirtualLayout((N,), "f8")
            layout[:] = h5py.VirtualSource(str(tmp_path / "other.h5"), "x", (N,))
            group.create_virtual_dataset("x", layout)
    with pytest.raises(InvalidInput, match="'run/x' refers to another file"):
        open_table(tmp_path / "log.h5")


def test_the_unpacked_size_is_limited(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    h5py = pytest.importorskip("h5py")
    monkeypatch.setattr(table_module, "MAX_UNPACKED_BYTES", 1 << 20)
    zeros = np.zeros(1 << 18)
    sink = io.BytesIO()
    with zipfile.ZipFile(sink, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("t.npy", npy(zeros))
    text = b"t,u\n" + b"0,0\n" * (1 << 20)
    with h5py.File(tmp_path / "made.h5", "w") as file:
        file.create_dataset("t", data=zeros, compression="gzip")
    parquet = io.BytesIO()
    pq.write_table(pa.table({"t": zeros}), parquet)
    files = {
        "log.csv.gz": gzip.compress(text),
        "log.csv.zst": pa.compress(text, codec="zstd", asbytes=True),
        "log.npz": sink.getvalue(),
        "log.mat": matlab({"t": zeros}, do_compression=True),
        "log.h5": (tmp_path / "made.h5").read_bytes(),
        "log.parquet": parquet.getvalue(),
    }
    for name, data in files.items():
        assert len(data) < 1 << 17
        with pytest.raises(InvalidInput, match="unpacks to more than 1 MiB, the limit of a log"):
            table_of(tmp_path, name, data).read(["t"])


@pytest.mark.parametrize(("name", "codec"), [("log.csv.gz", "gzip"), ("log.csv.zst", "zstd")])
def test_no_log_unpacks_to_hundreds_of_times_its_size(
    tmp_path: Path, name: str, codec: str
) -> None:
    data = pa.compress(bytes(100 << 20), codec=codec, asbytes=True)
    with pytest.raises(InvalidInput, match="unpacks to more than 200 times its size"):
        table_of(tmp_path, name, data)


def test_a_log_that_is_no_regular_file_is_refused_without_waiting(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.csv")
    (tmp_path / "device.csv").symlink_to("/dev/zero")
    (tmp_path / "folder.csv").mkdir()
    for name in ("pipe.csv", "device.csv"):
        with pytest.raises(InvalidInput, match="is not a regular file"):
            open_table(tmp_path / name)
    with pytest.raises(InvalidInput, match="is a directory"):
        open_table(tmp_path / "folder.csv")


def test_a_spreadsheet_must_be_saved_as_csv(tmp_path: Path) -> None:
    with pytest.raises(InvalidInput, match="Remedy: save the sheet as CSV"):
        table_of(tmp_path, "log.xlsx", b"PK")
