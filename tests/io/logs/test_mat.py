"""MAT files: listing of variables, and refusal of damaged files before SciPy reads them."""

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
from strainwave.io.logs import mat
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


@pytest.mark.parametrize("compressed", [False, True])
@pytest.mark.parametrize("kind", ["f8", "f4", "i1", "u2", "i4", "u8"])
def test_real_arrays_are_read_from_files_with_other_variables(kind: str, compressed: bool) -> None:
    column = (100.0 * COLUMN).astype(kind)
    data = written(OTHERS | {"t": column, "a_longer_name": column}, do_compression=compressed)
    names = mat.variables(data)
    assert {name for name, real in names.items() if real} == {"t", "a_longer_name", "flags"}
    assert set(names) == {*OTHERS, "t", "a_longer_name"}
    for name, values in mat.read(data, ["t", "a_longer_name"]).items():
        np.testing.assert_array_equal(values, column, err_msg=name)


def test_files_of_level_4_are_read() -> None:
    data = written({"t": COLUMN, "text": "an arm"}, format="4")
    assert mat.variables(data) == {"t": True, "text": False}
    np.testing.assert_array_equal(mat.read(data, ["t"])["t"], COLUMN)


def test_elements_of_an_unknown_type_are_refused(tmp_path: Path) -> None:
    """SciPy's reader accesses memory beyond its table for such elements and crashes."""
    data = bytearray(written({"t": COLUMN}))
    at = data.index(COLUMN.tobytes()) - 8
    assert data[at] == 9  # miDOUBLE
    data[at] = 200
    (tmp_path / "log.mat").write_bytes(data)
    with pytest.raises(InvalidInput, match="elements of type 200"):
        open_table(tmp_path / "log.mat")


@pytest.mark.parametrize("name", ["text", "struct", "turning"])
def test_the_error_states_the_variable_that_is_not_a_vector(name: str, tmp_path: Path) -> None:
    (tmp_path / "log.mat").write_bytes(written(OTHERS))
    with pytest.raises(InvalidInput, match="not a vector of numbers") as error:
        open_table(tmp_path / "log.mat").read([name])
    assert name in str(error.value)


@given(end=st.integers(5, len(written({"t": COLUMN})) - 1))
def test_a_file_that_ends_early_is_refused(end: int) -> None:
    content = written({"t": COLUMN})
    if end == 128:  # a header without variables is a valid file
        assert mat.variables(content[:end]) == {}
        return
    with pytest.raises(ValueError, match="it ends within"):
        mat.variables(content[:end])
