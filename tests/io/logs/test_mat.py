"""MAT files: real arrays and structs, and refusal of damaged files."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.io
from hypothesis import given
from hypothesis import strategies as st

from strainwave.errors import InvalidInput
from strainwave.io.logs.array_files import read_mat
from strainwave.io.logs.tables import open_table

COLUMN = np.linspace(0.0, 1.0, 31)
OTHERS: dict[str, Any] = {
    "text": "an arm",
    "cell": np.array([COLUMN, "x"], dtype=object),
    "struct": {"a": COLUMN, "b": {"c": 1.0}},
    "turning": 1j * COLUMN,
    "flags": np.array([True, False]),
}


def written(variables: dict[str, Any], **how: Any) -> bytes:
    sink = io.BytesIO()
    scipy.io.savemat(sink, variables, **how)
    return sink.getvalue()


def read(data: bytes) -> dict[str, Any]:
    return dict(read_mat(data, lambda size: None))


@pytest.mark.parametrize("compressed", [False, True])
@pytest.mark.parametrize("kind", ["f8", "f4", "i1", "u2", "i4", "u8"])
def test_real_arrays_are_read_from_files_with_other_variables(kind: str, compressed: bool) -> None:
    column = (100.0 * COLUMN).astype(kind)
    matrix = np.column_stack([column, column[::-1]])
    data = written(OTHERS | {"t": column, "a_longer_name": matrix}, do_compression=compressed)
    content = read(data)
    kinds = {name: array.dtype.kind for name, array in content.items() if not array.size}
    assert kinds == {"text": "U", "cell": "O", "turning": "c", "flags": "b"}
    assert content.keys() - kinds == {"t", "a_longer_name", "struct.a", "struct.b.c"}
    np.testing.assert_array_equal(content["t"].ravel(), column)
    np.testing.assert_array_equal(content["a_longer_name"], matrix)
    np.testing.assert_array_equal(content["struct.a"].ravel(), COLUMN)


def test_files_of_level_4_are_read() -> None:
    content = read(written({"t": COLUMN, "text": "an arm"}, format="4"))
    assert content["text"].dtype.kind == "U"
    np.testing.assert_array_equal(content["t"].ravel(), COLUMN)


def test_elements_of_an_unknown_type_are_refused(tmp_path: Path) -> None:
    """SciPy's reader accesses memory beyond its table for such elements and crashes."""
    data = bytearray(written({"t": COLUMN}))
    at = data.index(COLUMN.tobytes()) - 8
    assert data[at] == 9  # miDOUBLE
    data[at] = 200
    (tmp_path / "log.mat").write_bytes(data)
    with pytest.raises(InvalidInput, match="elements of type 200"):
        open_table(tmp_path / "log.mat")


@pytest.mark.parametrize("name", ["text", "cell", "turning", "flags", "struct.b.c"])
def test_the_error_states_the_variable_that_is_not_usable(name: str, tmp_path: Path) -> None:
    (tmp_path / "log.mat").write_bytes(written(OTHERS | {"t": COLUMN}))
    table = open_table(tmp_path / "log.mat")
    error = table.missing_column_error(name, "which [channels] names for 'u1'")
    assert f"'{name}', which [channels] names for 'u1', is not usable" in str(error)


@given(end=st.integers(5, len(written({"t": COLUMN})) - 1))
def test_a_file_that_ends_early_is_refused(end: int) -> None:
    content = written({"t": COLUMN})
    if end == 128:  # a header without variables is a valid file
        assert read(content[:end]) == {}
        return
    with pytest.raises(ValueError, match="it ends within"):
        read(content[:end])
