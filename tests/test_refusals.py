"""Refusals of invalid input: one message, exit code 2, no output, also with runs in parallel."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import pytest

import refused_studies
from strainwave import pipeline
from strainwave.errors import InvalidInput


@pytest.mark.parametrize("kind", ["an infinite value in a CSV log", "a damaged Parquet log"])
def test_parallel_runs_all_exit_with_two(kind: str) -> None:
    """Threads that outlive a refusal could change the exit code or write output."""
    refusals = refused_studies.runs_of(kind, runs=4, at_once=2, samples=4000)
    assert Counter(run.code for run in refusals) == {2: 4}, [run.message for run in refusals]
    assert {run.lines for run in refusals} == {1}
    assert not any(run.has_output for run in refusals)


@pytest.mark.parametrize("kind", sorted(refused_studies.KINDS))
def test_every_kind_of_fault_is_refused(kind: str, tmp_path: Path) -> None:
    """Within this process; the message states the remedy."""
    ending, damage = refused_studies.KINDS[kind]
    study = refused_studies.study_in(tmp_path, ending, samples=400)
    arguments = damage(tmp_path)
    stages = tuple(arguments[1:]) or ("rigid",)
    with pytest.raises(InvalidInput, match="Remedy:"):
        pipeline.identify(study, stages=stages)
