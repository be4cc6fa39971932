"""Refusals end as refusals: many at a time, each with its message, exit code 2 and nothing left."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import pytest
from benchmarks.studies import refusals

from strainwave import pipeline
from strainwave.errors import InvalidInput


@pytest.mark.parametrize("kind", ["a NaN in a CSV log", "a damaged Parquet log"])
def test_refusals_beside_each_other_all_exit_with_two(kind: str) -> None:
    found = refusals.of_kind(kind, runs=6, at_once=3, samples=4000)
    assert Counter(one.code for one in found) == {2: 6}, [one.said for one in found]
    assert {one.lines for one in found} == {1}
    assert not any(one.left for one in found)


@pytest.mark.parametrize("kind", sorted(refusals.KINDS))
def test_every_kind_of_fault_is_refused(kind: str, tmp_path: Path) -> None:
    """Without a process of its own: the message names the file, the place and the remedy."""
    ending, spoil = refusals.KINDS[kind]
    study = refusals.study_in(tmp_path, ending, samples=400)
    more = spoil(tmp_path)
    stages = tuple(more[1:]) or ("rigid",)
    with pytest.raises(InvalidInput, match="Remedy:"):
        pipeline.identify(study, stages=stages)
