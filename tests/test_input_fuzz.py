"""Any input is either read or refused with a one-line message."""

from __future__ import annotations

import gzip
import io
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import scipy.io
import tomli_w
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

import studies
from strainwave.errors import InvalidInput
from strainwave.io.logs import read_logs
from strainwave.io.study import read_study

FEW = settings(max_examples=75, suppress_health_check=[HealthCheck.too_slow])


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("fuzz")


def read_or_refuse(folder: Path, study: bytes, name: str = "motion.csv", log: bytes = b"") -> None:
    (folder / "study.toml").write_bytes(study)
    (folder / name).write_bytes(log)
    error = None
    try:
        for log_read in read_logs(read_study(folder / "study.toml")):
            assert all(np.isfinite(values).all() for values in log_read.channels.values())
    except InvalidInput as refusal:
        error = refusal
    if error is not None:
        assert error.remedy
        assert error.where
        assert "\n" not in str(error)


def mutated(data: bytes) -> st.SearchStrategy[bytes]:
    """Draw copies of the data with some ranges removed, repeated or overwritten."""
    edit = st.tuples(st.integers(0, len(data)), st.integers(0, 40), st.binary(max_size=12))

    def apply(edits: list[tuple[int, int, bytes]]) -> bytes:
        result = data
        for at, length, new in edits:
            result = result[:at] + new + result[at + length :]
        return result

    return st.lists(edit, min_size=1, max_size=4).map(apply)


STUDY = studies.STUDY.encode()
CSV = studies.csv_text(studies.columns()).encode()


def _parquet() -> bytes:
    sink = io.BytesIO()
    pq.write_table(pa.table(studies.columns()), sink)
    return sink.getvalue()


def _mat() -> bytes:
    sink = io.BytesIO()
    scipy.io.savemat(sink, dict(studies.columns()))
    return sink.getvalue()


@FEW
@given(study=mutated(STUDY) | st.binary(max_size=200))
@example(study=b"\x00")
@example(study=b"[[arm]]\n")
@example(study=b"arm = 3\njoint = 4\nexperiment = 5\n")
@example(study=b"a." * 2000 + b"b = 1\n")
@example(study=b"x = " + b"[" * 3000)
@example(study=STUDY.replace(b'"motion.csv"', b'"\\u0000"'))
@example(study=STUDY.replace(b'"motion.csv"', b'"/"'))
@example(study=STUDY.replace(b"= 0.35", b"= 99999999999999999999999999999999"))
@example(study=STUDY.replace(b"= 0.35", b"= 1979-05-27"))
@example(study=STUDY.replace(b"order = 10", b"order = 100000000"))
def test_studies(study: bytes, folder: Path) -> None:
    read_or_refuse(folder, study, log=CSV)


values: st.SearchStrategy[Any] = st.recursive(
    st.booleans()
    | st.integers(-(2**62), 2**62)
    | st.floats()
    | st.text(st.characters(codec="utf-8"), max_size=8)
    | st.sampled_from(["linear", "motion", "servo", "planar-two-link", "motion.csv"]),
    lambda inner: (
        st.lists(inner, max_size=3)
        | st.dictionaries(st.sampled_from(["column", "order", "t"]), inner)
    ),
    max_leaves=4,
)
keys = st.sampled_from(
    [
        "kind",
        "link_length",
        "gravity",
        "spring",
        "gear_ratio",
        "motion",
        "name",
        "file",
        "use",
        "control",
        "joint",
        "prbs",
        "add",
        "start",
        "stop",
        "t",
        "u1",
        "theta_m1",
        "period",
        "kp",
        "ki",
        "limit",
    ]
)
tables = st.dictionaries(keys, values, max_size=6)


@FEW
@given(
    document=st.fixed_dictionaries(
        {},
        optional={
            "arm": tables | values,
            "joint": st.lists(tables, max_size=3) | values,
            "servo": tables | values,
            "channels": tables | values,
            "experiment": st.lists(tables, max_size=3) | values,
        },
    )
)
def test_structured_studies(document: dict[str, Any], folder: Path) -> None:
    read_or_refuse(folder, tomli_w.dumps(document).encode(), log=CSV)


@FEW
@given(log=mutated(CSV) | st.binary(max_size=300))
@example(log=b"\n" * 50)
@example(log=b"t" * 100_000)
@example(log=b'"t' + CSV)
@example(log=CSV.replace(b"0.039,", b'"0.039,'))
@example(log=CSV.replace(b"0.005,", b"1e400,"))
@example(log=CSV.replace(b"0.005,", b"1_0,"))
@example(log=CSV.replace(b"\n", b"\r"))
@example(log=b"t,u1,u2,theta_m1,theta_m2\n" + b"1e308,1e308,1e308,1e308,1e308\n" * 20)
def test_csv(log: bytes, folder: Path) -> None:
    read_or_refuse(folder, STUDY, log=log)


cell = st.floats(width=32) | st.sampled_from(
    ["", "x", "1e999", "0x1", "--1", "1,5", '"', "NaN", " 1 "]
)


@FEW
@given(
    rows=st.lists(st.lists(cell, min_size=5, max_size=6), min_size=14, max_size=20),
    increasing=st.booleans(),
)
def test_csv_of_drawn_cells(rows: list[list[Any]], increasing: bool, folder: Path) -> None:
    if increasing:
        rows = [[0.001 * k, *row[1:]] for k, row in enumerate(rows)]
    text = "t,u1,u2,theta_m1,theta_m2\n" + "\n".join(",".join(map(str, row)) for row in rows)
    read_or_refuse(folder, STUDY, log=text.encode())


@FEW
@given(data=st.data())
@pytest.mark.parametrize("name", ["log.parquet", "log.mat", "log.csv.gz", "log.h5"])
def test_binary_files(name: str, data: st.DataObject, folder: Path) -> None:
    valid = {"log.parquet": _parquet(), "log.mat": _mat(), "log.csv.gz": gzip.compress(CSV)}
    log = data.draw(mutated(valid.get(name, b"\x89HDF\r\n\x1a\n" + bytes(100))))
    read_or_refuse(folder, STUDY.replace(b"motion.csv", name.encode()), name, log)


@pytest.mark.parametrize("storage", ["MCAP", "SQLITE3"])
def test_a_spoilt_bag_is_read_or_refused(
    storage: str, tmp_path_factory: pytest.TempPathFactory
) -> None:
    pytest.importorskip("rosbags", reason="the extra `bags` is not installed")
    import bags

    folder = tmp_path_factory.mktemp("bag")
    bags.write(folder / "run", bags.of_columns(studies.columns()), storage)
    text = studies.STUDY.replace("motion.csv", "run") + bags.CHANNELS
    valid = {path.name: path.read_bytes() for path in (folder / "run").iterdir()}

    @settings(max_examples=30, suppress_health_check=[HealthCheck.too_slow])
    @given(data=st.data())
    def spoilt(data: st.DataObject) -> None:
        name = data.draw(st.sampled_from(sorted(valid)))
        for other, content in valid.items():
            (folder / "run" / other).write_bytes(content)
        read_or_refuse(folder, text.encode(), f"run/{name}", data.draw(mutated(valid[name])))

    spoilt()
