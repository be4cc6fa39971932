"""Drawn odd and malicious items: every address and API answers, quickly, without foreign bytes.

`python -m benchmarks.workbench_safety` draws 300.
"""

from __future__ import annotations

import io
import zipfile
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("starlette")

from benchmarks.odd_items import KINDS, SECRET, Foreign, draw_items
from benchmarks.workbench_safety import client_of, fault_of, faults_of

SEED = 1
SLOW = 5.0  # [s] of the processor for one answer on a loaded machine; a bomb takes longer


def test_no_drawn_item_breaks_an_answer(tmp_path: Path) -> None:
    served = tmp_path / "served"
    items = draw_items(served, Foreign(tmp_path), len(set(KINDS)), SEED)
    rng = np.random.default_rng(SEED)
    with client_of(served) as client:  # one event loop for all requests
        client.get("/")  # loads the modules
        faults = [each for item in items for each in faults_of(client, served, item, rng, SLOW)]
    assert faults == []


def test_faults_of_answers_are_found() -> None:
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("one", SECRET * 9)
    assert fault_of(500, "text/plain", b"").startswith("status 500")
    assert fault_of(200, "text/plain", f"a {SECRET}".encode()).startswith("foreign")
    assert fault_of(200, "application/zip", packed.getvalue()).startswith("foreign")
    assert fault_of(200, "application/json", b"[NaN]").startswith("no JSON")
    assert fault_of(200, "application/json", b"[1]") == ""
