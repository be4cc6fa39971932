"""Delimited text: every dialect reads back equal, and each program's files are recognised."""

from __future__ import annotations

import gzip
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from strainwave.domain import FloatArray
from strainwave.errors import InvalidInput
from strainwave.io.logs import arrays, text
from strainwave.io.logs.tables import LogTable, open_table

TIME = 0.005 * np.arange(40)
ANGLE = np.sin(7.0 * TIME)
TORQUE = np.cos(11.0 * TIME)
ROWS = np.column_stack([TIME, ANGLE, TORQUE])


def table_of(folder: Path, text: str | bytes, name: str = "log.csv") -> LogTable:
    (folder / name).write_bytes(text.encode() if isinstance(text, str) else text)
    return open_table(folder / name)


def read_all(folder: Path, text: str | bytes) -> dict[str, FloatArray]:
    table = table_of(folder, text)
    return table.read(table.names)


def rows(delimiter: str = ",", decimal: str = ".", end: str = "") -> str:
    lines = [delimiter.join(f"{value:.9f}" for value in row) + end for row in ROWS]
    return "\n".join(lines).replace(".", decimal) + "\n"


def expect(table: LogTable, names: list[str], values: FloatArray = ROWS) -> None:
    assert list(table.names) == names
    read = table.read(names)
    for name, column in zip(names, values.T, strict=True):
        assert read[name].dtype == np.float64
        np.testing.assert_allclose(read[name], column, atol=1e-9, err_msg=name)


# --- Dialects -------------------------------------------------------------------------------


@dataclass(frozen=True)
class Dialect:
    delimiter: str
    decimal: str
    encoding: str
    header: str
    units: str
    trailing: int
    quotes: bool
    preamble: tuple[str, ...]
    footer: str
    newline: str


DIALECTS = st.builds(
    Dialect,
    delimiter=st.sampled_from([",", ";", "\t", " ", "   ", "|", "; "]),
    decimal=st.sampled_from([".", ","]),
    encoding=st.sampled_from(["utf-8", "utf-8-sig", "utf-16", "latin-1"]),
    header=st.sampled_from(["names", "#", "groups", "none"]),
    units=st.sampled_from(["none", "plain", "brackets"]),
    trailing=st.integers(0, 2),
    quotes=st.booleans(),
    preamble=st.sampled_from([(), ("rig 3",), ("File;x.tcscopex", "Start time;133", "")]),
    footer=st.sampled_from(["", "End of the record", "\nMean of all: see sheet 2"]),
    newline=st.sampled_from(["\n", "\r\n", "\r"]),
).filter(lambda d: not (d.delimiter == "," and d.decimal == ",") or d.quotes)
# a line of text above numbers may be a header
DIALECTS = DIALECTS.filter(lambda d: d.header != "none" or not d.preamble)
NUMBERS = st.floats(-1e30, 1e30) | st.integers(-(2**40), 2**40).map(float)


def write(dialect: Dialect, values: FloatArray, names: list[str]) -> bytes:
    def line(cells: list[str], quote: bool = dialect.quotes) -> str:
        marked = [f'"{cell}"' if quote else cell for cell in cells]
        blank = not dialect.delimiter.strip(" ")
        return dialect.delimiter.join(marked) + (
            "" if blank else dialect.delimiter * dialect.trailing
        )

    lines = list(dialect.preamble)
    if dialect.header == "groups":
        lines.append(line(["rig"] + [f"joint{k}" for k in range(1, len(names))]))
    if dialect.header != "none":
        lines.append(("# " if dialect.header == "#" else "") + line(names))
        units = ["s"] + ["rad/s", "N·m"] * len(names)
        if dialect.units == "brackets":
            units = [f"[{unit}]" for unit in units]
        if dialect.units != "none":
            lines.append(line(units[: len(names)]))
    lines += [line([repr(float(v)).replace(".", dialect.decimal) for v in row]) for row in values]
    return dialect.newline.join([*lines, *filter(None, [dialect.footer]), ""]).encode(
        dialect.encoding
    )


@settings(suppress_health_check=[HealthCheck.too_slow, HealthCheck.function_scoped_fixture])
@given(dialect=DIALECTS, data=st.data())
def test_any_numbers_read_back_equal_in_any_dialect(
    dialect: Dialect, data: st.DataObject, tmp_path: Path
) -> None:
    n_columns = data.draw(st.integers(2, 5))
    row = st.lists(NUMBERS, min_size=n_columns, max_size=n_columns)
    values = np.array(data.draw(st.lists(row, min_size=16, max_size=24)))
    names = ["Zeit", "Winkel_ü", "Moment", "u1", "i1"][:n_columns]
    table = table_of(tmp_path, write(dialect, values, names))
    if dialect.header == "none":
        names = [f"data[{k}]" for k in range(n_columns)]
    assert list(table.names) == names
    for name, column in table.read(names).items():
        np.testing.assert_allclose(column, values[:, names.index(name)], rtol=1e-15)
    if dialect.units != "none" and dialect.header != "none":
        assert table.units["Zeit"] == "s"
        assert table.units["Winkel_ü"] == "rad/s"
    else:
        assert not table.units


# --- Files of programs ----------------------------------------------------------------------

LVM_HEAD = """LabVIEW Measurement\t
Writer_Version\t2
Reader_Version\t2
Separator\tTab
Decimal_Separator\t.
Multi_Headings\tNo
X_Columns\tOne
Time_Pref\tRelative
Operator\tlab
Date\t2024/03/01
Time\t10:04:33.5102
***End_of_Header***\t

Channels\t2\t
Samples\t40\t40\t
Date\t2024/03/01\t2024/03/01\t
Time\t10:04:33.51\t10:04:33.51\t
Y_Unit_Label\tdeg\tN m\t
X_Dimension\tTime\tTime\t
X0\t0.0000000000000000E+0\t0.0000000000000000E+0\t
Delta_X\t0.005000\t0.005000\t
***End_of_Header***\t\t\t
X_Value\tangle\ttorque\tComment
"""
TEKTRONIX_HEAD = """Model,MDO3024
Firmware Version,1.26

Waveform Type,ANALOG,
Point Format,Y,
Horizontal Units,s,
Sample Interval,0.005,
Record Length,40,
Vertical Units,V,V
TIME,CH1,CH2
"""
PROGRAMS: dict[str, tuple[str, list[str], dict[str, str]]] = {
    "LabVIEW": (
        LVM_HEAD + rows("\t"),
        ["X_Value", "angle", "torque"],
        {"angle": "deg", "torque": "N m"},
    ),
    "Tektronix": (TEKTRONIX_HEAD + rows(), ["TIME", "CH1", "CH2"], {"CH1": "V", "CH2": "V"}),
    "Rigol": (
        "X,CH1,CH2,Start,Increment,\nSequence,Volt,Volt,-3.0e-03,1.0e-06\n" + rows(end=",,"),
        ["X", "CH1", "CH2"],
        {"X": "Sequence", "CH1": "Volt", "CH2": "Volt"},
    ),
    "PicoScope": (
        "Time,Channel A,Channel B\n(ms),(V),(mV)\n\n" + rows(),
        ["Time", "Channel A", "Channel B"],
        {"Time": "ms", "Channel A": "V", "Channel B": "mV"},
    ),
    "spreadsheet": (
        "sep=;\nZeit [s];Winkel [°];Moment [Nm];\n" + rows(";", ",", ";"),
        ["Zeit [s]", "Winkel [°]", "Moment [Nm]"],
        {},
    ),
    "merged cells": (
        "Rig,Joint 1,,\ntime,value,torque\n" + rows(),
        ["time", "value", "torque"],
        {},
    ),
    "groups": (
        "Rig,Joint 1,Joint 2\ntime,angle,angle\ns,deg,deg\n" + rows(),
        ["time", "Joint 1 angle", "Joint 2 angle"],
        {"time": "s", "Joint 1 angle": "deg", "Joint 2 angle": "deg"},
    ),
    "column numbers": ("0,1,2\n" + rows(), ["data[0]", "data[1]", "data[2]"], {}),
    "rostopic": (
        "%time,field.position0,field.effort0\n" + rows(),
        ["%time", "field.position0", "field.effort0"],
        {},
    ),
    "units in names": (
        "# t [s] angle (rad)  torque [Nm]\n" + rows(" "),
        ["t [s]", "angle (rad)", "torque [Nm]"],
        {},
    ),
    "aligned": (
        "  time   position   torque\n"
        + "\n".join(f"  {a:12.9f}  {b:12.9f}   {c:12.9f} " for a, b, c in ROWS),
        ["time", "position", "torque"],
        {},
    ),
}


@pytest.mark.parametrize("program", PROGRAMS)
def test_files_of_programs_are_recognised(program: str, tmp_path: Path) -> None:
    text, names, units = PROGRAMS[program]
    for name in ("log.csv", "log.dat", "log.txt.gz"):
        table = table_of(tmp_path, gzip.compress(text.encode()) if "gz" in name else text, name)
        expect(table, names)
        assert dict(table.units) == units


def test_a_twincat_scope_has_pairs_of_columns(tmp_path: Path) -> None:
    head = (
        "Name\tScope Project\nFile\tx.tcscopex\n\nName\tMAIN.fPos\tName\tMAIN.fTorque\n"
        "Data-Type\tREAL64\tData-Type\tREAL64\nSampleTime[ms]\t5\tSampleTime[ms]\t5\n"
        "Unit\tdeg\tUnit\tNm\nScaleFactor\t1\tScaleFactor\t1\n\n"
    )
    values = np.column_stack([1e3 * TIME, ANGLE, 1e3 * TIME, TORQUE])
    text = head + "\n".join("\t".join(f"{v:.9f}" for v in row) for row in values)
    table = table_of(tmp_path, text)
    expect(table, ["time", "MAIN.fPos", "MAIN.fTorque.time", "MAIN.fTorque"], values)
    assert table.units == {"MAIN.fPos": "deg", "MAIN.fTorque": "Nm"}


def test_a_long_preamble_is_skipped(tmp_path: Path) -> None:
    text = "".join(f"comment {k};value {k}\n" for k in range(9000)) + "t;a;b\n" + rows(";")
    expect(table_of(tmp_path, text), ["t", "a", "b"])


@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
@pytest.mark.parametrize("delimiter", [",", " "])
def test_a_text_is_read_in_pieces(
    delimiter: str, end: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(text, "_PIECE_BYTES", 100)
    written = (delimiter.join("tab") + "\n" + rows(delimiter)).replace("\n", end)
    expect(table_of(tmp_path, written), ["t", "a", "b"])


def test_zstandard_is_unpacked(tmp_path: Path) -> None:
    packed = pa.compress(("t,a,b\n" + rows()).encode(), codec="zstd", asbytes=True)
    expect(table_of(tmp_path, packed, "log.tsv.zst"), ["t", "a", "b"])
    with pytest.raises(InvalidInput, match="cannot be unpacked"):
        table_of(tmp_path, packed[:-9], "log.tsv.zst")


# --- Cells ----------------------------------------------------------------------------------


def test_text_and_flags_are_left_out_with_a_note(tmp_path: Path) -> None:
    lines = rows().splitlines()
    text = "t,a,b,state,enabled,spare\n" + "\n".join(f"{line},RUN,True," for line in lines)
    table = table_of(tmp_path, text)
    expect(table, ["t", "a", "b"])
    assert dict(table.omitted) == {"state": "text", "enabled": "flags", "spare": "no values"}
    assert any("text: state" in note for note in table.notes)
    error = table.missing_column_error("state", "which [channels] names for 'u1'")
    assert "'state', which [channels] names for 'u1', is not usable: text" in str(error)


@pytest.mark.parametrize("cell", ["", "nan", "NaN", "NA", " ", "null", "#N/A", "-nan(ind)"])
def test_missing_cells_are_nan(cell: str, tmp_path: Path) -> None:
    lines = rows().splitlines()
    lines[7] = f"{TIME[7]:.9f},{cell},{TORQUE[7]:.9f}"
    read = table_of(tmp_path, "t,a,b\n" + "\n".join(lines)).read(["t", "a", "b"])
    assert np.flatnonzero(np.isnan(read["a"])).tolist() == [7]
    np.testing.assert_allclose(read["b"], TORQUE, atol=1e-9)


@pytest.mark.parametrize(
    ("stamp", "clock", "first"),
    [
        ("2024-03-01T10:00:{:06.3f}Z", "datetime", 1709287200.0),
        ("2024-03-01 10:00:{:09.6f}", "datetime", 1709287200.0),
        ("2024-03-01T12:00:{:06.3f}+02:00", "datetime", 1709287200.0),
        ("01.03.2024 10:00:{:06.3f}", "datetime", 1709287200.0),
        ("3/1/2024 10:00:{:06.3f} AM", "datetime", 1709287200.0),
        ("01-Mar-2024 10:00:{:06.3f}", "datetime", 1709287200.0),
        ("10:00:{:06.3f}", "time", 36000.0),
        ("22:00:{:06.3f}", "time", 79200.0),
    ],
)
def test_stamps_are_read_in_seconds(stamp: str, clock: str, first: float, tmp_path: Path) -> None:
    lines = [f"{stamp.format(t)};{a:.6f};{c:.6f}" for t, a, c in ROWS]
    table = table_of(tmp_path, "stamp;a;b\n" + "\n".join(lines))
    assert table.clocks == {"stamp": clock}
    # seconds since 1970 have a resolution of 2.4e-7 s
    np.testing.assert_allclose(table.read(["stamp"])["stamp"] - first, TIME, atol=5e-7)


def test_a_date_and_a_clock_in_two_columns_are_read(tmp_path: Path) -> None:
    lines = [f"2024-03-01 10:00:{t:06.3f} {a:.6f} {c:.6f}" for t, a, c in ROWS]
    table = table_of(tmp_path, "date clock a b\n" + "\n".join(lines), "log.log")
    assert table.clocks == {"date": "date", "clock": "time"}
    read = table.read(table.names)
    assert set(read["date"]) == {1709251200.0}
    np.testing.assert_allclose(read["clock"], 36000.0 + TIME, atol=1e-9)


# --- Faults ---------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("t,a,b\nx,y,z\nof text\n", "line 3: there is no row of numbers"),
        ("t,a,b,c\n" + rows(), "line 1: 4 columns are named, but the rows have 3 values"),
        ("t,a\n" + rows(), "line 1: 2 columns are named, but the rows have 3 values"),
        ("t,a,b\n0.0,bad,1.0\n" + rows(), "line 2, column 2: 'bad' is not a number"),
        ("t,a,b\n" + rows() + "0.2,0.1", "line 42: the log is truncated: 2 values"),
        ("t,a,b\n" + rows() + "0.2,0.1,x1\n" + rows(), "line 42, column 'b': 'x1' is not a number"),
        (b"\xff\xfet\x00,", "is not valid UTF-16"),
    ],
)
def test_the_error_states_the_line(text: Any, message: str, tmp_path: Path) -> None:
    with pytest.raises(InvalidInput, match=message) as error:
        read_all(tmp_path, text)
    assert error.value.remedy


def test_a_note_at_the_end_is_reported(tmp_path: Path) -> None:
    table = table_of(tmp_path, "t,a,b\n" + rows() + "\nMax,1.0,1.0\nrecorded by the lab\n")
    expect(table, ["t", "a", "b"])
    assert "the last 2 line(s) contain no numbers and are not read" in table.notes


def test_arrow_keeps_no_reference_to_python_objects() -> None:
    """Arrow's reader copies its input.

    Its threads need the interpreter to release a Python object, possibly after its shutdown.
    """
    data = b"t,u1\n" * 1000
    assert arrays.arrow_reader(data).read_buffer().address != pa.py_buffer(data).address
    assert arrays.arrow_reader(data).read() == data
