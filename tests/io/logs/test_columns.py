"""Columns of a log by name."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from strainwave.errors import InvalidInput
from strainwave.io.logs import columns
from strainwave.io.logs.tables import write_table


def test_columns_are_read_in_batches_in_the_order_of_the_log(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, wanted = tmp_path / "log.parquet", {f"c{k}": np.arange(5.0) + k for k in range(5)}
    write_table(path, wanted)
    monkeypatch.setattr(columns, "_MAX_BATCH_BYTES", 2 * 5 * 8)  # two columns
    read = dict(columns.read_columns(path))
    assert list(read) == list(wanted)
    for name, values in wanted.items():
        np.testing.assert_array_equal(read[name], values)
    assert set(dict(columns.read_columns(path, ["c3", "c1"]))) == {"c1", "c3"}


def test_a_column_that_the_log_lacks_is_refused(tmp_path: Path) -> None:
    write_table(tmp_path / "log.csv", {"a": np.arange(3.0)})
    with pytest.raises(InvalidInput, match="there is no column 'b'"):
        dict(columns.read_columns(tmp_path / "log.csv", ["a", "b"]))
