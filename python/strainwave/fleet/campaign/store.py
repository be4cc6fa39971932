"""The store of a campaign: Parquet files, which Arrow reads as one table.

    runs/<run>.parquet               one row: the record of the run, written last
    parameters/<run>.parquet         one row per parameter
    results/<run>/result.json        the result
    runs/part-<hash>.parquet         many runs merged, `parameters/part-...` likewise

`run` is a hash of the task, so repeating it, by two campaigns or after a crash, gives one name and
one row. A merge writes the part before it deletes other files; rows that are in both are read once.
A file appears completely or not at all: local files are written to a temporary file,
flushed to the disk and renamed; an object store writes whole objects.
"""

from __future__ import annotations

import hashlib
import os
import tempfile
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
from pyarrow import fs

from strainwave.errors import InvalidInput
from strainwave.fleet.campaign.records import (
    OUTCOME_COLUMNS,
    PARAMETERS_SCHEMA,
    RUNS_SCHEMA,
    Outcome,
    Row,
    RunRecord,
)
from strainwave.fleet.campaign.study_files import file_system, is_url
from strainwave.io.system import replace_file, try_lock, unlock

_SCHEMAS = {"runs": RUNS_SCHEMA, "parameters": PARAMETERS_SCHEMA}
_MAX_TRIES = 50  # to read a store that other processes merge
_MIN_COMPRESSED_ROWS = 1000  # fewer take longer to compress than to write
_ORDER = {"runs": ["run", "started"], "parameters": ["run", "name", "joint"]}


@dataclass(frozen=True)
class Store:
    """A store at a path or a URL, which need not exist."""

    where: Path | str

    def write(self, record: RunRecord) -> None:
        """Write result, parameters, and last the row that makes the run count.

        OSError if that fails; no part of it can be read then.
        """
        run = record.row["run"]
        files = {f"runs/{run}.parquet": _table_bytes([record.row], RUNS_SCHEMA)}
        if record.result is not None:
            files = {
                f"results/{run}/result.json": record.result,
                f"parameters/{run}.parquet": _table_bytes(record.parameters, PARAMETERS_SCHEMA),
            } | files
        written_files: list[str] = []
        try:
            for name, data in files.items():
                self._put(name, data)
                written_files.append(name)
        except OSError:
            if self.recorded(run) is None:
                self._delete(written_files)
            raise

    def try_write(self, record: RunRecord) -> str:
        """Write a record; the reason if that fails, or ""."""
        try:
            self.write(record)
        except OSError as error:
            return error.strerror or str(error)
        return ""

    def recorded(self, run: str) -> Outcome | None:
        """The outcome of a recorded run; None if it is not recorded."""
        for _ in range(_MAX_TRIES):
            with suppress(FileNotFoundError):
                rows = self._rows("runs", [f"runs/{run}.parquet"], OUTCOME_COLUMNS)
                return Outcome(**rows.to_pylist()[0])
            parts = tuple(filter(_is_part, self._names("runs")))
            with suppress(FileNotFoundError):  # merged after the files were listed
                return _outcomes_of(self, parts).get(run)
        return None

    def table(self, kind: str, columns: Sequence[str] | None = None) -> pa.Table:
        """All rows of `runs` or `parameters`, each once: of a repeated run, the last.

        `columns` selects columns. Raises `InvalidInput` if a file is not a table of a store.
        """
        selected = list(_SCHEMAS[kind].names if columns is None else columns)
        needed = list(dict.fromkeys([*selected, *_ORDER[kind]]))
        for _ in range(_MAX_TRIES):
            names, again = self._names(kind), self._names(kind)
            if {*filter(_is_part, names)} != {*filter(_is_part, again)}:
                continue  # merged while the files were listed
            try:  # files of one run, which are newer, come first
                table = self._rows(kind, sorted(names, key=_is_part), needed)
            except FileNotFoundError:  # merged after the files were listed
                continue
            return _drop_duplicates(table, kind).select(selected)
        raise InvalidInput(
            f"the {kind} change while they are read",
            where=str(self.where),
            remedy="read them again",
        )

    def merge(self) -> None:
        """Merge all files into one part, if the store is local and no other process does so.

        OSError if a part cannot be written; the rows remain where they were.
        """
        if is_url(str(self.where)) or len(self._names("runs")) < 2:
            return
        lock = None
        with suppress(OSError):  # a file system without locks
            lock = try_lock(Path(self.where, ".lock"))
        if lock is None:
            return
        try:
            for kind in ("parameters", "runs"):  # so that every row has its parameters
                names = self._names(kind)
                if len(names) < 2:
                    continue
                data = _to_parquet(self.table(kind))
                part = f"{kind}/part-{hashlib.sha256(data).hexdigest()[:32]}.parquet"
                self._put(part, data)
                self._delete([name for name in names if name != part])
        finally:
            unlock(lock)

    def exists(self, name: str) -> bool:
        """Whether the store has a file."""
        system, root = self._folder
        return bool(system.get_file_info(f"{root}/{name}").is_file)

    @property
    def _folder(self) -> tuple[fs.FileSystem, str]:
        """Arrow's file system of the store, and the path of the store in it."""
        if not is_url(where := str(self.where)):
            return fs.LocalFileSystem(), Path(where).as_posix()
        system, path = file_system(where)
        if "file" in system.protocol:
            return fs.LocalFileSystem(), path
        system.invalidate_cache()  # other processes write
        return fs.PyFileSystem(fs.FSSpecHandler(system)), path.rstrip("/")

    def _names(self, kind: str) -> list[str]:
        """Files of `runs` or `parameters`, sorted; temporary files begin with a dot."""
        system, root = self._folder
        try:
            entries = system.get_file_info(fs.FileSelector(f"{root}/{kind}", allow_not_found=True))
        except FileNotFoundError:  # another process creates the folder just now
            return []
        names = sorted(entry.base_name for entry in entries if entry.extension == "parquet")
        return [f"{kind}/{name}" for name in names if not name.startswith(".")]

    def _rows(self, kind: str, names: Sequence[str], columns: Sequence[str]) -> pa.Table:
        """Rows of files in their order; columns that earlier versions lack are null."""
        import pyarrow.dataset as ds  # imports pandas, if that is installed; a worker only writes

        system, root = self._folder
        paths = [f"{root}/{name}" for name in names]
        files = ds.dataset(paths, schema=_SCHEMAS[kind], format="parquet", filesystem=system)
        try:
            return files.to_table(columns=list(columns), use_threads=len(names) > 1)
        except pa.ArrowInvalid as error:
            name = next((name for name in names if name in str(error)), kind)
            raise InvalidInput(
                f"is not a Parquet file ({error})",
                where=f"{self.where}/{name}",
                remedy="move it out of the store; its run is then repeated",
            ) from error

    def _put(self, name: str, data: bytes) -> None:
        system, root = self._folder
        if not isinstance(system, fs.LocalFileSystem):
            with system.open_output_stream(f"{root}/{name}") as stream:
                stream.write(data)
            return
        final = Path(root, name)
        final.parent.mkdir(parents=True, exist_ok=True)
        handle, temporary = tempfile.mkstemp(
            prefix=f".{final.name}.", suffix=".aside", dir=final.parent
        )
        try:
            with os.fdopen(handle, "wb") as file:
                file.write(data)
                file.flush()
                os.fsync(file.fileno())
            Path(temporary).chmod(0o644)
            replace_file(Path(temporary), final)
        except OSError:
            with suppress(OSError):
                Path(temporary).unlink()
            raise

    def _delete(self, names: Sequence[str]) -> None:
        system, root = self._folder
        for name in names:
            with suppress(FileNotFoundError):
                system.delete_file(f"{root}/{name}")


def read_runs(store: Path | str) -> pa.Table:
    """The runs of a campaign's store, one row each; see docs/campaign.md for the columns.

    `store` is a folder or a URL. Raises `InvalidInput` if there is no store.
    """
    return _open_existing(store).table("runs")


def read_parameters(store: Path | str) -> pa.Table:
    """The parameters of all runs of a campaign's store, one row each.

    `store` is a folder or a URL. Raises `InvalidInput` if there is no store.
    """
    existing = _open_existing(store)
    parameters = existing.table("parameters")  # first: rows of runs are written after them
    runs = existing.table("runs", ["run"])["run"]
    return parameters.filter(pc.is_in(parameters["run"], value_set=runs.combine_chunks()))


def _open_existing(where: Path | str) -> Store:
    store = Store(where)
    if not store._names("runs"):
        raise InvalidInput(
            "contains no runs",
            where=str(where),
            remedy="name the store that strainwave campaign wrote, its --out",
        )
    return store


@lru_cache(maxsize=4)
def _outcomes_of(store: Store, parts: tuple[str, ...]) -> dict[str, Outcome]:
    """Outcomes of the runs in parts, which do not change, by run."""
    rows = store._rows("runs", parts, OUTCOME_COLUMNS).sort_by("started")
    return {row["run"]: Outcome(**row) for row in rows.to_pylist()}


def _is_part(name: str) -> bool:
    return name.rsplit("/", 1)[-1].startswith("part-")


def _table_bytes(rows: Sequence[Row], schema: pa.Schema) -> bytes:
    return _to_parquet(pa.Table.from_pylist(list(rows), schema=schema))


def _to_parquet(table: pa.Table) -> bytes:
    stream, is_large = pa.BufferOutputStream(), table.num_rows > _MIN_COMPRESSED_ROWS
    pq.write_table(
        table,
        stream,
        compression="zstd" if is_large else "none",
        use_dictionary=is_large,
        write_statistics=is_large,
    )
    return bytes(stream.getvalue())


def _drop_duplicates(table: pa.Table, kind: str) -> pa.Table:
    """Each run once, the last one started; of parameters, the first in the table."""
    if table.num_rows == 0:
        return table
    table = table.combine_chunks()  # taking rows from many chunks is slow
    numbered = table.append_column("_row", pa.array(range(table.num_rows), pa.int64()))
    if kind == "runs":
        by_time = numbered.sort_by([("started", "descending"), ("_row", "ascending")])
        last = by_time.group_by("run", use_threads=False).aggregate([("_row", "first")])
        rows = last["_row_first"]
    else:
        rows = numbered.group_by(_ORDER[kind]).aggregate([("_row", "min")])["_row_min"]
    if len(rows) == table.num_rows:
        return table
    values = rows.combine_chunks()
    return table.take(values.take(pc.sort_indices(values)))
