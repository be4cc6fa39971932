"""Odd and malicious items of a served folder, drawn from a seed.

Each item is a folder with a small study that is complete but for one thing: a log, URDF, study file
or run that is damaged, huge, foreign, or no file at all. `Foreign` is what no answer may contain.
"""

from __future__ import annotations

import gzip
import io
import json
import os
import shutil
import socket
import sqlite3
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pyarrow as pa
import pyarrow.feather
import pyarrow.parquet
import scipy.io
import tomlkit

from strainwave.workbench.pages.check import run_check
from strainwave.workbench.runs import Runs

Columns = dict[str, np.ndarray[Any, Any]]

SECRET = "the-secret-of-another-user"
NUMBER = 271828.18
"""In every row of a foreign log; a figure of it would show the number."""
N_ROWS = 400
_TEXTS: tuple[str, ...] = (
    "",
    "NaN",
    "-Infinity",
    "1e999",
    "9" * 5000,
    "0x10",
    "١٢٣",
    "\u202e\ud800",
    "null",
)
_TEXTS += ("a\0b", "'\"", "../../foreign.csv", "/etc/passwd", "file:///etc/passwd", "~", "x" * 5000)
_TEXTS += ("<script>alert(1)</script>", "{{ 7 * 7 }}", "[" * 3000, "\r\n\r\n", "%2e%2e%2f")
ODD: tuple[Any, ...] = (*_TEXTS, None, True, 0, -1, 10**400, 1e308, float("nan"), float("inf"))
ODD += ([], [[]], [None], {}, {"a": {"b": []}}, [[1.0] * 300], list(range(3000)))
"""Values that a document or a request has in place of its own."""
_NAMES: tuple[str, ...] = (
    "a'b\"c",
    "x" * 246,
    "ü\n",
    "%2e%2e",
    "&amp;",
    "<b>",
    "\u202etxt",
    "a;b",
    "-rf",
    "a b",
)
_NAMES += (os.fsdecode(b"\xff\xfe"), "{{x}}", "$(id)", "con", "`", "\\..\\", "\x1b[2J", "é" * 123)
STUDY = """[arm]
kind = "planar-two-link"
link_length = 0.3
[[joint]]
spring = "linear"
gear_ratio = 0.01
torque_per_volt = 0.08
accelerometer_distance = 0.3
[[joint]]
spring = "linear"
gear_ratio = 0.01
torque_per_volt = 0.03
[[experiment]]
name = "motion"
file = "log.csv"
use = "motion"
control = ["servo", "servo"]
"""
URDF = """<robot name="arm"><link name="base"/><link name="one"><inertial><mass value="2"/>
<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="j" type="revolute"><parent link="base"/><child link="one"/><axis xyz="0 0 1"/>
<limit effort="1" velocity="1" lower="-1" upper="1"/></joint></robot>"""
SERIAL = """[arm]
kind = "serial"
urdf = "robot.urdf"
[[joint]]
spring = "rigid"
gear_ratio = 0.01
[[experiment]]
name = "motion"
file = "log.csv"
use = "motion"
control = ["servo"]
"""
RUN: dict[str, Any] = {"name": "one", "kind": "identify", "commands": [["identify", "study.toml"]]}
RUN |= {"created": "2026-01-01", "state": "done", "exit_code": 0}
RESULT = {
    "schema": 1,
    "status": "determined",
    "parameters": [{"name": "motor_inertia", "joint": 1, "value": 1e-4, "std": 1e-6}],
}


@dataclass(frozen=True, slots=True)
class Foreign:
    """Files outside of the served folder."""

    folder: Path

    def write(self) -> None:
        """Write a log, a text, and a URDF."""
        time = np.arange(N_ROWS) * 1e-3
        head = ",".join(("t", *columns())) + f",{SECRET}\n"
        rows = (",".join((f"{t:g}", *[f"{NUMBER + t}"] * 7)) for t in time)
        (self.folder / "foreign.csv").write_text(head + "\n".join(rows))
        (self.folder / "foreign.json").write_text(json.dumps({"status": SECRET, "name": SECRET}))
        (self.folder / "foreign.urdf").write_text(URDF.replace("arm", SECRET))

    @property
    def log(self) -> Path:
        """A log of another user."""
        return self.folder / "foreign.csv"


def columns() -> Columns:
    """A small motion of two joints."""
    t = np.arange(N_ROWS) * 1e-3
    angles = [20.0 * np.sin(2 * np.pi * hz * t) for hz in (4.0, 6.0)]
    drawn = {f"theta_m{i}": angle for i, angle in enumerate(angles, 1)}
    for i, angle in enumerate(angles, 1):
        rate = np.gradient(angle, 1e-3)
        drawn[f"u{i}"] = 1e-3 * np.gradient(rate, 1e-3) + 0.1 * np.sign(rate)
        drawn[f"a{i}"] = 3e-3 * np.gradient(rate, 1e-3) + np.cos(900.0 * t)
    return drawn


def log_bytes(suffix: str) -> bytes:
    """A complete log in a format."""
    table = {"t": np.arange(N_ROWS) * 1e-3, **columns()}
    file = io.BytesIO()
    if suffix.startswith(".csv"):
        rows = [
            ",".join(table),
            *(",".join(f"{x:.9g}" for x in row) for row in zip(*table.values(), strict=True)),
        ]
        text = "\n".join(rows).encode()
        pack: dict[str, Callable[[bytes], bytes]] = {"": bytes, ".gz": gzip.compress}
        pack[".zst"] = lambda data: pa.compress(data, codec="zstd", asbytes=True)
        return pack[suffix.removeprefix(".csv")](text)
    if suffix == ".json":
        return json.dumps({name: values.tolist() for name, values in table.items()}).encode()
    if suffix == ".npz":
        np.savez(file, **table)  # type: ignore[arg-type]
    elif suffix == ".mat":
        scipy.io.savemat(file, table)
    elif suffix == ".h5":
        with h5py.File(file, "w") as h5:
            for name, values in table.items():
                h5[name] = values
    elif suffix == ".parquet":
        pa.parquet.write_table(pa.table(table), file)
    else:
        pa.feather.write_feather(pa.table(table), file)
    return file.getvalue()


FORMATS = (".csv", ".csv.gz", ".csv.zst", ".json", ".npz", ".mat", ".h5", ".parquet", ".feather")


def mutated(data: bytes, rng: np.random.Generator) -> bytes:
    """Bytes with one kind of damage."""
    damaged, n = bytearray(data), len(data)
    at = int(rng.integers(n + 1))
    kind = rng.integers(7)
    if kind == 0:
        return data[:at]
    if kind == 1:
        for k in rng.integers(n, size=1 + n // 200):
            damaged[k] = rng.integers(256)
    elif kind == 2:
        damaged[at : at + 8] = b"\xff" * int(rng.choice([4, 8]))
    elif kind == 3:
        damaged[at:at] = rng.bytes(50)
    elif kind == 4:
        damaged[at:at] = data[: n // 2]
    elif kind == 5:
        damaged[at:at] = str(rng.choice(_TEXTS)).encode("utf-8", "surrogatepass")
    else:
        damaged[at:] = bytes(n - at)
    return bytes(damaged)


def places(value: Any, at: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Every place in nested tables and lists."""
    yield at
    if isinstance(value, dict | list):
        for key in value if isinstance(value, dict) else range(len(value)):
            yield from places(value[key], (*at, key))


def replaced(document: Any, rng: np.random.Generator) -> Any:
    """A document with an odd value at one place."""
    *parents, last = (
        None,
        *list(places(document))[rng.integers(1 + sum(1 for _ in places(document)) - 1)],
    )
    value = ODD[rng.integers(len(ODD))]
    if last is None:
        return value
    table = copy = json.loads(json.dumps(document))
    for key in parents[1:]:
        table = table[key]
    table[last] = value
    return copy


def nested(rng: np.random.Generator, name: str = "a") -> str:
    """JSON and TOML that nest too deeply."""
    depth = int(rng.integers(500, 100_000))
    return (
        f"{name} = {'[' * depth}{']' * depth}"
        if rng.random() < 0.5
        else f"[{'.'.join('a' * depth)}]"
    )


# --- Items ----------------------------------------------------------------------------------------


def base(folder: Path, study: str = STUDY, log: str = ".csv") -> Path:
    """The complete study; returns its log."""
    (folder / "study.toml").write_text(study.replace("log.csv", f"log{log}"))
    (folder / f"log{log}").write_bytes(log_bytes(log))
    return folder / f"log{log}"


def run_folder(folder: Path) -> Path:
    """A complete run."""
    run = Runs(folder / "study.toml").prepare("one")
    (run / "run.json").write_text(json.dumps(RUN))
    (run / "result.json").write_text(json.dumps(RESULT))
    return run


def odd_log(folder: Path, rng: np.random.Generator, _foreign: Foreign) -> None:
    log = base(folder, log=str(rng.choice(FORMATS)))
    log.write_bytes(mutated(log.read_bytes(), rng))


def odd_cells(folder: Path, rng: np.random.Generator, _foreign: Foreign) -> None:
    log = base(folder)
    lines = [line.split(",") for line in log.read_text().split("\n")]
    for _ in range(int(rng.integers(1, 5))):
        line = lines[rng.integers(len(lines))]
        line[rng.integers(len(line))] = str(rng.choice(_TEXTS))
    text = "\n".join(",".join(line) for line in lines)
    log.write_bytes(text.encode("utf-8", "surrogatepass"))


def bomb(folder: Path, rng: np.random.Generator, _foreign: Foreign) -> None:
    suffix = str(rng.choice([".csv.gz", ".csv.zst", ".mat", ".npz", ".h5", ".parquet"]))
    log, zeros = base(folder, log=suffix), np.zeros(30 << 20)
    file = io.BytesIO()
    if suffix == ".csv.gz":
        file.write(gzip.compress(bytes(100 << 20), 1))
    elif suffix == ".csv.zst":
        file.write(pa.compress(bytes(100 << 20), codec="zstd", asbytes=True))
    elif suffix == ".mat":
        scipy.io.savemat(file, {"t": zeros}, do_compression=True)
    elif suffix == ".npz":
        np.savez_compressed(file, t=zeros)
    elif suffix == ".h5":
        with h5py.File(file, "w") as h5:
            for name in ("t", *columns()):
                h5.create_dataset(name, (1 << 40,), "f8", chunks=(1 << 20,), compression="gzip")
    else:
        pa.parquet.write_table(pa.table({"t": zeros}), file, compression="zstd")
    log.write_bytes(file.getvalue())


def odd_study(folder: Path, rng: np.random.Generator, foreign: Foreign) -> None:
    base(folder)
    text = STUDY
    kind = rng.integers(5)
    if kind < 2:
        document = replaced(tomlkit.parse(STUDY).unwrap(), rng)
        with suppress(Exception):  # no TOML has this value
            text = tomlkit.dumps(document if isinstance(document, dict) else {"arm": document})
    elif kind == 2:
        (folder / "study.toml").write_bytes(mutated(text.encode(), rng))
        return
    elif kind == 3:
        text += nested(rng)
    else:
        names = (str(foreign.log), f"../../{foreign.log.name}", "/proc/self/environ", "/dev/zero")
        text = text.replace("log.csv", str(rng.choice(names)))
    (folder / "study.toml").write_bytes(text.encode("utf-8", "surrogatepass"))


def odd_urdf(folder: Path, rng: np.random.Generator, foreign: Foreign) -> None:
    base(folder, SERIAL)
    path = foreign.folder / "foreign.urdf"
    entity = f'<!DOCTYPE r [<!ENTITY x SYSTEM "file://{path}">]>' + URDF.replace("arm", "&x;")
    laughs = "".join(f'<!ENTITY l{k} "{f"&l{k - 1};" * 10 if k else "ha"}">' for k in range(12))
    texts = [entity, f"<!DOCTYPE r [{laughs}]>" + URDF.replace("arm", "&l11;")]
    texts += ["<a>" * 50_000, URDF.replace("2", "9" * 5000), URDF.replace('"1"', '"nan"')]
    texts += [URDF.replace('"base"', f'"{"x" * 100_000}"'), URDF.replace("revolute", "planar")]
    data = str(rng.choice(texts)).encode() if rng.random() < 0.6 else mutated(URDF.encode(), rng)
    (folder / "robot.urdf").write_bytes(data)
    if rng.random() < 0.2:
        (folder / "robot.urdf").unlink()
        (folder / "robot.urdf").symlink_to(path)


def odd_hdf5(folder: Path, rng: np.random.Generator, foreign: Foreign) -> None:
    log = base(folder, log=".h5")
    with h5py.File(log, "w") as h5:
        name, other = str(rng.choice(list(columns()))), str(foreign.log)
        kind = rng.integers(4)
        if kind == 0:
            h5[name] = h5py.ExternalLink(other, "/x")
        elif kind == 1:
            h5.create_dataset(name, (N_ROWS,), "f8", external=[(other, 0, 8 * N_ROWS)])
        elif kind == 2:
            layout = h5py.VirtualLayout((N_ROWS,), "f8")
            layout[:] = h5py.VirtualSource(other, "x", (N_ROWS,))
            h5.create_virtual_dataset(name, layout)
        else:
            h5[name] = h5py.SoftLink("/" + "/".join("a" * 3000))
        for each, values in ({"t": np.arange(N_ROWS) * 1e-3} | columns()).items():
            if each != name:
                h5[each] = values


def odd_bag(folder: Path, rng: np.random.Generator, foreign: Foreign) -> None:
    name = str(rng.choice(["bag", "log.db3", "log.mcap", "log.bag"]))
    base(folder, STUDY.replace("log.csv", name))
    path = folder / name
    if name == "bag":
        path.mkdir()
        (path / "metadata.yaml").write_bytes(
            mutated(b"rosbag2_bagfile_information:\n  version: 5\n", rng)
        )
        (path / "x.db3").symlink_to(foreign.log if rng.random() < 0.5 else path)
    elif name == "log.db3":
        with sqlite3.connect(path) as database:
            database.execute("CREATE TABLE topics (id INTEGER, name TEXT, type TEXT)")
            database.execute("INSERT INTO topics VALUES (1, ?, ?)", ("/x", "std_msgs/msg/String"))
        database.close()
        path.write_bytes(mutated(path.read_bytes(), rng))
    else:
        path.write_bytes((b"\x89MCAP0\r\n" if "m" in name else b"#ROSBAG V2.0\n") + rng.bytes(500))


def no_file(folder: Path, rng: np.random.Generator, foreign: Foreign) -> None:
    """A pipe, a socket, a folder, or a link in place of a file."""
    base(folder)
    run = run_folder(folder)
    names: tuple[str, ...] = (
        "log.csv",
        "study.toml",
        "values.json",
        "robot.urdf",
        "runs/.check.json",
    )
    names += tuple(
        f"runs/one/{name}" for name in (*("run.json", "result.json", "log.txt", "lock"),)
    )
    names += tuple(f"runs/one/{name}" for name in ("report.html", "predicted.json", "plan.csv"))
    path = folder / str(rng.choice(names))
    path.unlink(missing_ok=True)
    links: list[Path | str] = [
        foreign.log,
        foreign.folder / "foreign.json",
        foreign.folder,
        path,
        "/dev/zero",
    ]
    links += ["/proc/self/environ", folder / "nowhere", "/dev/tty", run]
    kind = rng.integers(4)
    if kind == 0:
        os.mkfifo(path)
    elif kind == 1:
        path.mkdir()
    elif kind == 2 and len(str(path)) < 100:
        with socket.socket(socket.AF_UNIX) as opened:
            opened.bind(str(path))
    else:
        path.symlink_to(links[rng.integers(len(links))])


def odd_run(folder: Path, rng: np.random.Generator, _foreign: Foreign) -> None:
    """A damaged file of a run."""
    base(folder)
    run = run_folder(folder)
    name = str(rng.choice(["run.json", "run.json", "result.json", "result.json", "predicted.json"]))
    document = RUN if name == "run.json" else RESULT
    text = json.dumps(replaced(document, rng))
    text = f"{'[' * 50_000}" if rng.random() < 0.1 else text
    (run / name).write_text(text.replace("Infinity", str(rng.choice(["Infinity", "1e999"]))))
    (run / "log.txt").write_bytes(mutated(b'{"activity": "fit", "percent": 1}\n' * 30, rng))
    (run / "plan.csv").write_bytes(mutated(log_bytes(".csv"), rng))
    (run / "report.html").write_bytes(mutated(b"<script>alert(1)</script>" * 9, rng))


def odd_check(folder: Path, rng: np.random.Generator, _foreign: Foreign) -> None:
    """A stored check with an odd value."""
    base(folder)
    run_check(folder / "study.toml")
    path = folder / "runs" / ".check.json"
    path.write_text(json.dumps(replaced(json.loads(path.read_text()), rng)))


def odd_names(folder: Path, rng: np.random.Generator, _foreign: Foreign) -> None:
    """Odd names of a log, a study, a folder and a run."""
    base(folder)
    name = _NAMES[rng.integers(len(_NAMES))]
    shutil.copyfile(folder / "log.csv", folder / f"{name}.csv")
    text = STUDY.replace('"log.csv"', json.dumps(f"{name}.csv")).replace(
        '"motion"\nf', f"{json.dumps(name)}\nf"
    )
    (folder / f"{name}.toml").write_bytes(text.encode("utf-8", "surrogatepass"))
    (folder / name).mkdir()
    shutil.copyfile(folder / "study.toml", folder / name / "study.toml")
    run_folder(folder).rename(folder / "runs" / name)


KINDS: tuple[Callable[[Path, np.random.Generator, Foreign], None], ...] = (
    *(odd_log, odd_cells, bomb, odd_study, odd_urdf, odd_hdf5, odd_bag, no_file, odd_run),
    *(odd_check, odd_names, odd_log, odd_study, no_file, odd_run),
)


def draw_items(served: Path, foreign: Foreign, count: int, seed: int) -> list[str]:
    """Write items into a folder; returns their names. Each follows from its number and the seed."""
    foreign.write()
    names = []
    for number in range(count):
        make = KINDS[number % len(KINDS)]
        names.append(f"{number:03}-{make.__name__}")
        (served / names[-1]).mkdir(parents=True)
        make(served / names[-1], np.random.default_rng([seed, number]), foreign)
    return names
