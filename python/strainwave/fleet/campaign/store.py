"""The store of a campaign: one Parquet file per run, merged into larger files.

    runs/<run>.parquet               one row: the record of the run, written last
    parameters/<run>.parquet         one row per parameter
    results/<run>/result.json        the result
    runs/part-<hash>.parquet         many runs merged, `parameters/part-...` likewise

`run` is a hash of the task, so repeating it, by two campaigns or after a crash, gives one name and
one row. A merge writes the part before it deletes the small files; rows that are in both are read
once.
"""

from __future__ import annotations

import hashlib
import io
import threading
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from strainwave.errors import InvalidInput
from strainwave.fleet.campaign.places import Folder, Place, place_of
from strainwave.fleet.campaign.records import (
    OUTCOME_COLUMNS,
    PARAMETERS_SCHEMA,
    RUNS_SCHEMA,
    Outcome,
    Row,
    RunRecord,
)

MERGE_AFTER = 1000
"""Number of runs after which a campaign merges small files."""

_MAX_MERGED_ROWS = {"runs": 20_000, "parameters": 500_000}  # larger parts are not rewritten
_MAX_TRIES = 50  # to read a store that other processes merge
_N_READERS = 8  # threads that read small files; more do not speed up a local disk
_SCHEMAS = {"runs": RUNS_SCHEMA, "parameters": PARAMETERS_SCHEMA}
_ORDER = {"runs": ["run", "started"], "parameters": ["run", "name", "joint"]}


@dataclass(frozen=True)
class Store:
    """A store at a path or a URL."""

    place: Place
    _parts: dict[str, dict[str, Outcome]] = field(default_factory=dict, repr=False)
    _mutex: Any = field(default_factory=threading.Lock, repr=False)

    @classmethod
    def at(cls, where: Path | str) -> Store:
        """The store at a path or URL, which need not exist."""
        return cls(place_of(where))

    def write(self, record: RunRecord) -> None:
        """Write result, parameters, and last the row that makes the run count.

        OSError if that fails; no part of it can be read then.
        """
        run = record.row["run"]
        files = {f"runs/{run}.parquet": _table_bytes([record.row], RUNS_SCHEMA)}
        if record.result is not None:
            parameters = _table_bytes(record.parameters, PARAMETERS_SCHEMA)
            files = {
                f"results/{run}/result.json": record.result,
                f"parameters/{run}.parquet": parameters,
            } | files
        written_files: list[str] = []
        try:
            for name, data in files.items():
                self.place.put(name, data)
                written_files.append(name)
        except OSError:
            if self.recorded(run) is None:
                self.place.delete(written_files)
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
        unmerged = self._of_file(f"runs/{run}.parquet").get(run)
        with self._mutex:
            rows = self._in_parts(run)
            if unmerged is None and not rows:
                names = {*filter(_is_part, self.place.names("runs", ".parquet"))}
                new = names - self._parts.keys()
                self._parts.update({name: self._of_file(name) for name in new})
                for name in self._parts.keys() - names:
                    del self._parts[name]
                rows = self._in_parts(run)
        rows += [unmerged] if unmerged else []
        return max(rows, key=lambda row: row.started, default=None)

    def _in_parts(self, run: str) -> list[Outcome]:
        return [part[run] for part in self._parts.values() if run in part]

    def _of_file(self, name: str) -> dict[str, Outcome]:
        try:
            rows = self._table(name, OUTCOME_COLUMNS).to_pylist()
        except FileNotFoundError:
            return {}
        return {row["run"]: Outcome(**row) for row in rows}

    def table(self, kind: str, columns: Sequence[str] | None = None) -> pa.Table:
        """All rows of `runs` or `parameters`, each once: of a repeated run, the last.

        `columns` selects columns. Raises `InvalidInput` if a file is not a table of a store.
        """
        read_columns = None if columns is None else list(dict.fromkeys([*columns, *_ORDER[kind]]))
        for _ in range(_MAX_TRIES):
            names, again = (self.place.names(kind, ".parquet") for _ in range(2))
            if {*filter(_is_part, names)} != {*filter(_is_part, again)}:
                continue  # merged while the files were listed
            try:
                # small files, which are newer, come first
                with ThreadPoolExecutor(_N_READERS) as pool:
                    ordered = sorted(names, key=_is_part)
                    tables = list(pool.map(lambda name: self._table(name, read_columns), ordered))
            except FileNotFoundError:  # merged after the files were listed
                continue
            schema = _SCHEMAS[kind]
            if read_columns is not None:
                schema = pa.schema([schema.field(name) for name in read_columns])
            table = _drop_duplicates(_concatenated(tables, schema), kind)
            return table if columns is None else table.select(list(columns))
        raise InvalidInput(
            f"the {kind} change while they are read",
            where=str(self.place),
            remedy="read them again",
        )

    def _table(self, name: str, columns: Sequence[str] | None = None) -> pa.Table:
        try:
            file = pq.ParquetFile(pa.BufferReader(self.place.get(name)))
            existing = None
            if columns is not None:
                existing = [column for column in columns if column in file.schema_arrow.names]
            return file.read(columns=existing, use_threads=False)
        except pa.ArrowInvalid as error:
            raise InvalidInput(
                f"is not a Parquet file ({error})",
                where=f"{self.place}/{name}",
                remedy="move it out of the store; its run is then repeated",
            ) from error

    def merge(self, *, at_least: int = 2) -> int:
        """Merge small files into parts, if the store is local and no other process does so.

        Nothing happens below `at_least` small files of runs. Returns the number of runs that were
        in small files. OSError if a part cannot be written; the rows remain where they were.
        """
        if not isinstance(self.place, Folder) or not self.place.path.is_dir():
            return 0
        small = [n for n in self.place.names("runs", ".parquet") if not _is_part(n)]
        if len(small) < at_least:
            return 0
        with self.place.lock() as held:
            if not held:
                return 0
            n_merged = 0
            for kind in ("parameters", "runs"):  # so that every row has its parameters
                n_merged = self._merge(kind)
                self.place.sweep(kind)
        return n_merged

    def _merge(self, kind: str) -> int:
        """Merge the files of a kind; returns the number of small files in the new part."""
        names = self.place.names(kind, ".parquet")
        merged_names = [
            n for n in names if not _is_part(n) or self._rows(n) < _MAX_MERGED_ROWS[kind]
        ]
        tables = {name: self._table(name) for name in merged_names}
        merged_runs = pa.chunked_array(
            [t["run"].combine_chunks() for t in tables.values()], pa.string()
        )
        for name in set(names) - set(merged_names):  # a repeated run is also in a large part
            runs = self._table(name, ["run"])["run"]
            if pc.any(pc.is_in(runs, value_set=merged_runs)).as_py():
                tables[name] = self._table(name)
        if len(tables) < 2:
            return 0
        ordered = [tables[name] for name in sorted(tables, key=_is_part)]
        data = _to_parquet(_drop_duplicates(_concatenated(ordered, _SCHEMAS[kind]), kind))
        part = f"{kind}/part-{hashlib.sha256(data).hexdigest()[:32]}.parquet"
        self.place.put(part, data)
        self.place.delete(name for name in tables if name != part)
        return sum(not _is_part(name) for name in tables)

    def _rows(self, name: str) -> int:
        return int(pq.read_metadata(pa.BufferReader(self.place.get(name))).num_rows)


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
    store = Store.at(where)
    if not store.place.names("runs", ".parquet"):
        raise InvalidInput(
            "contains no runs",
            where=str(where),
            remedy="name the store that strainwave campaign wrote, its --out",
        )
    return store


def _is_part(name: str) -> bool:
    return name.rsplit("/", 1)[-1].startswith("part-")


def _table_bytes(rows: Sequence[Row], schema: pa.Schema) -> bytes:
    return _to_parquet(pa.Table.from_pylist(list(rows), schema=schema))


def _to_parquet(table: pa.Table) -> bytes:
    out = io.BytesIO()
    large = table.num_rows > MERGE_AFTER
    pq.write_table(
        table,
        out,
        compression="zstd" if large else "none",
        use_dictionary=large,
        write_statistics=large,
    )
    return out.getvalue()


def _concatenated(tables: Sequence[pa.Table], schema: pa.Schema) -> pa.Table:
    """The rows with the columns of a schema; columns that earlier versions lack are null."""
    joined = pa.concat_tables([schema.empty_table(), *tables], promote_options="permissive")
    return joined.select(schema.names).cast(schema)


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
