"""The same input gives the same result.json except time and paths, for any number of threads."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

STUDY = Path(__file__).parent / "data" / "small-arm" / "study.toml"
_RUN = """
import sys
import strainwave as sw
sw.identify(sys.argv[1], threads=int(sys.argv[2])).save(sys.argv[3])
"""


def result(out: Path, *, threads: int, blas: int) -> dict[str, Any]:
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": str(blas), "OMP_NUM_THREADS": str(blas)}
    subprocess.run(
        [sys.executable, "-c", _RUN, str(STUDY), str(threads), str(out)],
        env=environment,
        check=True,
        timeout=500,
    )
    document: dict[str, Any] = json.loads(out.read_text())
    for varying in ("created", "timing_s"):
        del document[varying]
    del document["study"]["path"]
    return document


def test_the_same_input_gives_the_same_result(tmp_path: Path) -> None:
    """Two processes with different numbers of threads, of this package and of BLAS."""
    one = result(tmp_path / "one.json", threads=1, blas=1)
    assert result(tmp_path / "other.json", threads=3, blas=4) == one
