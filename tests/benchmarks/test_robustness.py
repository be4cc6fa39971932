"""Robustness figures of runs with known outcomes."""

from __future__ import annotations

import json
from typing import Any

import pytest
from benchmarks.robustness import OUTCOMES, Run, judge_promise, runs_of, tables, wilson

Row = dict[str, Any]


def run_of(name: str, **keys: Any) -> Row:
    row = {
        "run": name,
        "study": f"campaign.toml#{name}",
        "status": "determined",
        "exit_code": 0,
        "seconds": 4.0,
        "identified": ["alpha", "gear_damping 1", "friction_offset 1"],
        "suspected": [],
        "warnings": [],
        "classes": {"size": "small"},
    } | keys
    return row | {"classes": json.dumps(row["classes"]) if row["classes"] else None}


def estimate(run: str, name: str, value: float | None, half: float, true: float = 1.0) -> Row:
    joint = None if name == "alpha" else 1
    low, high = (None, None) if value is None else (value - half, value + half)
    row = {"run": run, "name": name, "joint": joint, "value": value, "true_value": true}
    return row | {"ci95_low": low, "ci95_high": high}


def single_run(row: Row, *parameters: Row) -> Run:
    (run,) = runs_of([row], parameters)
    return run


@pytest.mark.parametrize(
    ("name", "value", "half", "accurate", "wrong"),
    [
        ("alpha", 1.009, 0.0, True, False),  # close
        ("alpha", 1.03, 0.04, True, False),  # inside its interval
        ("alpha", 1.03, 0.0, False, False),  # neither, and not wrong
        ("alpha", 1.06, 0.01, False, True),
        ("alpha", 0.94, 0.01, False, True),
        ("alpha", 1.5, 0.6, True, False),  # far, inside its wide interval
        ("gear_damping", 1.04, 0.0, True, False),
        ("gear_damping", 1.06, 0.0, False, True),
    ],
)
def test_an_estimate_is_judged_by_error_and_interval(
    name: str, value: float, half: float, accurate: bool, wrong: bool
) -> None:
    run = single_run(run_of("a"), estimate("a", name, value, half))
    (result,) = run.estimates
    assert (result.is_accurate, result.is_wrong) == (accurate, wrong)
    assert (run.is_identified, run.is_silently_wrong) == (accurate, wrong)


def test_only_identified_primary_parameters_count() -> None:
    rows = [
        estimate("a", "friction_offset", 2.0, 0.0),  # not primary
        estimate("a", "gear_stiffness_k3", 2.0, 0.0),  # not identified
        estimate("a", "gear_damping", None, 0.0),
    ]
    assert not single_run(run_of("a"), *rows).estimates


def test_a_wrong_value_without_the_verdict_is_not_silent() -> None:
    wrong = estimate("a", "alpha", 2.0, 0.1)
    assert not single_run(run_of("a", status="partly-determined"), wrong).is_silently_wrong


FAULT = {"fault": "angle-sign", "fault_codes": ["wrong-sign"]}
RIGHT, WRONG = estimate("a", "alpha", 1.0, 0.1), estimate("a", "alpha", 2.0, 0.1)


@pytest.mark.parametrize(
    ("keys", "parameter", "outcome"),
    [
        ({"suspected": ["wrong-sign"]}, RIGHT, "named"),
        ({"warnings": ["wrong-sign"]}, RIGHT, "named"),
        ({"suspected": ["wrong-unit"]}, RIGHT, "other code"),
        ({"status": "failed", "exit_code": 2}, RIGHT, "refused"),
        ({"status": "failed", "exit_code": 1}, RIGHT, "failed"),
        ({"warnings": ["stribeck"]}, RIGHT, "harmless"),
        ({"status": "partly-determined"}, WRONG, "not determined"),
        ({"status": "partly-determined"}, RIGHT, "not determined"),
        ({}, WRONG, "silent"),
    ],
)
def test_outcome_of_a_fault(keys: Row, parameter: Row, outcome: str) -> None:
    run = single_run(run_of("a", classes=FAULT, **keys), parameter)
    assert run.group == "faulty"
    assert run.outcome == outcome
    assert outcome in OUTCOMES


def test_any_suspicion_names_a_fault_without_code() -> None:
    late = {"fault": "late-sensors", "fault_codes": []}
    assert single_run(run_of("a", classes=late, suspected=["misaligned"]), RIGHT).outcome == "named"
    assert single_run(run_of("a", classes=late), RIGHT).outcome == "harmless"


def test_groups_are_those_drawn() -> None:
    assert single_run(run_of("a"), RIGHT).group == "clean"
    assert single_run(run_of("a", classes={"effect": "backlash"}), RIGHT).group == "with an effect"
    assert single_run(run_of("a", classes=None, status="failed")).group == "never opened"


def test_runs_of_study_files_and_repeated_rows_do_not_count() -> None:
    study_run = run_of("b", study="rigs/study.toml", classes=None)
    without_truth = estimate("b", "alpha", 2.0, 0.0) | {"true_value": None}
    assert len(runs_of([run_of("a"), run_of("a"), study_run], [RIGHT, without_truth])) == 1


def test_tables_count_known_cases() -> None:
    rows = [run_of(str(k), classes=FAULT if k % 2 else {"size": "small"}) for k in range(20)]
    values = [estimate(str(k), "alpha", 2.0 if k == 3 else 1.0, 0.1) for k in range(20)]
    verdicts, published, faults, silent = tables(runs_of(rows, values))

    def cells(table: Any) -> list[list[str]]:
        return [list(row) for row in zip(*(column.cells for column in table.columns), strict=True)]

    assert cells(verdicts)[0] == ["clean", "10", "100.0", "100.0", "4.0"]
    assert cells(verdicts)[1] == ["faulty", "10", "100.0", "90.0", "4.0"]
    assert cells(published)[1][:5] == ["faulty", "inertias", "10", "90.0", "90.0"]
    harmless, silent_column = OUTCOMES.index("harmless") + 2, OUTCOMES.index("silent") + 2
    assert cells(faults)[0][0] == "angle-sign"
    assert (cells(faults)[0][harmless], cells(faults)[0][silent_column]) == ("9", "1")
    assert [row[:4] for row in cells(silent)] == [
        ["clean", "10", "0", "0"],
        ["faulty", "10", "1", "1e+02"],
    ]
    assert [row[-1] for row in cells(silent)] == ["too few runs", "BROKEN"]


def test_wilson_interval_of_a_rare_event() -> None:
    """Of 0 in 1,000: z^2 / (n + z^2)."""
    low, high = wilson(0, 1000)
    assert low == pytest.approx(0.0, abs=1e-12)
    assert high == pytest.approx(1.96**2 / (1000.0 + 1.96**2), rel=1e-3)


@pytest.mark.parametrize(
    ("wrong", "runs", "verdict"),
    [
        (2, 1000, "kept"),
        (3, 1000, "BROKEN"),
        (0, 999, "too few runs"),
        (1, 999, "too few runs"),
        (20, 500, "BROKEN"),
    ],
)
def test_a_promise_per_thousand_needs_a_thousand_runs(wrong: int, runs: int, verdict: str) -> None:
    assert judge_promise(wrong, runs, 2) == verdict
