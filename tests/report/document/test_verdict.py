"""The verdict follows from the numbers, and every warning has a meaning and a remedy."""

from __future__ import annotations

import ast
from dataclasses import replace
from functools import cache
from pathlib import Path

import pytest

import strainwave
from elastic_results import elastic_identification
from results import identification, prediction
from strainwave.domain import (
    Activity,
    Clause,
    Diagnostic,
    Identification,
    Parameter,
    Place,
    Suspicion,
)
from strainwave.report.document.blocks import Callout, Facts, Paragraph, Table
from strainwave.report.document.verdict import (
    TROUBLESHOOTING_PAGE,
    advice,
    named,
    verdict,
    warnings_table,
)
from virtual_arms import rigid_drive

PACKAGE = Path(strainwave.__file__).parent
FAULT = Suspicion(
    code="wrong-unit",
    places=(Place(channel="u1"),),
    clause=Clause("text", text="u1 is 9.81 of it."),
    remedy_clause=Clause("text", text="Set scale = 9.81."),
)
OTHER_COMMANDS = ("excite", "export")  # their warnings are not in a report


def of(*parameters: Parameter, **changed: object) -> str:
    """The text of the verdict on these parameters."""
    one = identification()
    assert one.rigid is not None
    rigid = replace(one.rigid, parameters=parameters)
    result: Identification = replace(one, rigid=rigid, **changed)  # type: ignore[arg-type]
    return words_of(verdict(result))


def words_of(callout: Callout) -> str:
    """Spans, terms, facts and table cells, separated by vertical bars."""
    texts: list[str] = []
    for block in callout.blocks:
        if isinstance(block, Paragraph):
            texts += [span.text for span in block.spans]
        elif isinstance(block, Facts):
            texts += [f"|{term}||{fact}|" for term, fact in block.items]
        elif isinstance(block, Table):
            texts += [cell.text for row in block.rows if isinstance(row, tuple) for cell in row]
    return "|".join(["", *texts, ""])


def reported(
    name: str, value: float | None, half: float | None, joint: int | None = 1
) -> Parameter:
    interval = None if half is None or value is None else (value - half, value + half)
    return Parameter(name, joint, value, half, "-", "rigid", interval)


@pytest.mark.parametrize(
    ("value", "half", "title"),
    [
        (1.0, 0.009, "95 % half-width up to 1 %"),
        (1.0, 0.011, "95 % half-width up to 10 %"),
        (1.0, 0.5, "95 % half-width above 10 %"),
        (1.0, 1.5, "Not identified: the 95 % interval is wider than the value"),
        (1.0, None, "Not identified: the 95 % interval is wider than the value"),
        (None, None, "Not identified"),
        (-1.0, 0.1, "Rejected: reasons under Parameters"),
    ],
)
def test_each_parameter_is_classified_by_its_interval(
    value: float | None, half: float | None, title: str
) -> None:
    text = of(reported("gear_damping", value, half))
    assert f"|{title}||gear damping (1)|" in text, text


def test_identified_parameters_are_counted() -> None:
    alpha = reported("alpha", 1.0, 0.05, None)
    assert "All 2 parameters are identified, 1 with a 95 % half-width of 10 %" in of(
        alpha, reported("beta", 1.0, 0.2)
    )
    assert "1 of 2 parameters are identified, 1 with" in of(alpha, reported("beta", None, None))
    assert "No parameter was estimated." in of()
    nothing = "|Not determined| No parameter was estimated.|Nothing moved.|Not identified: rigid_"
    assert nothing in of(failures=(Clause("text", text="nothing moved"),))


def test_a_value_near_zero_has_its_own_class() -> None:
    active = (Activity(1, torque=1.0, velocity=50.0, acceleration=500.0),)
    text = of(reported("motor_coulomb_friction", 0.001, 0.015), activity=active)
    assert "|Zero within 2 % of the joint torque||motor coulomb friction (1)|" in text


def test_combinations_are_listed() -> None:
    places = Place(parameter="alpha"), Place(joint=1, parameter="gear_damping")
    pair = Diagnostic("only-together", places, spread=0.1)
    assert "Only the combination is identified||alpha and gear damping of joint 1|" in of(
        stage_warnings=(pair,)
    )


def test_names_are_grouped_over_the_joints() -> None:
    labels = [("alpha", None), ("link_inertia", 1), ("link_inertia", 2)]
    assert named(labels) == "alpha, link inertia (1, 2)"


def test_fits_of_check_records_are_a_table() -> None:
    text = of(checks=(prediction("a", 91.25, 99.0), prediction("b", 95.0, float("nan"))))
    assert "|rigid model, drive|3|95.0 %|91.2 %|torque1 in a|" in text
    motion = identification().study.experiments[:1]
    study = replace(identification().study, experiments=motion)
    assert "the study has no check record" in of(checks=(), study=study)
    assert "almost do not move in the check records" in of(checks=(prediction("a", float("nan")),))


def test_the_limit_of_the_rigid_model_is_stated_for_elastic_arms() -> None:
    note = "The rigid model, which predicts torque1, torque2, has no vibration of gears"
    checks = (prediction("a", 91.0, 99.0),)
    assert note in words_of(verdict(replace(elastic_identification(), checks=checks)))
    assert "vibration of gears" not in words_of(verdict(drive(checks=checks)))


def test_check_records_without_a_model_are_not_called_missing() -> None:
    """A study with check records that were not predicted does have check records."""
    names = "motion-check, step-check-j1, step-check-j2"
    text = of(checks=(), suspected=(FAULT,))
    assert f"3 check records were not predicted because the input is inconsistent: {names}" in text
    assert "3 check records were not predicted because no model was estimated" in of(checks=())
    assert "no check record" not in text


@pytest.mark.parametrize(
    ("changes", "title", "mark"),
    [
        ({}, "Determined", "good"),
        ({"failures": (Clause("text", text="nothing moved"),)}, "Partly determined", "doubt"),
        ({"rigid": None}, "Not determined", "bad"),
        ({"suspected": (FAULT,)}, "Inconsistent input", "bad"),
    ],
)
def test_the_status_has_its_colour(changes: dict[str, object], title: str, mark: str) -> None:
    callout = verdict(drive(**changes))
    lead = callout.blocks[0]
    assert callout.mark == mark
    assert isinstance(lead, Paragraph)
    assert (lead.spans[0].text, lead.spans[0].mark) == (title, mark)


def test_only_check_records_that_load_the_gears_validate_the_elastic_model() -> None:
    one = elastic_identification()
    steps = replace(prediction("steps", 99.0, 99.0), channels=("omega_m1", "a1"))
    steps = replace(steps, fit_percent={"omega_m1": 99.0, "a1": 98.0})
    slow = replace(steps, stiffness_effect={1: {"a1": 0.03}, 2: {"a1": 0.04}})
    half = replace(steps, stiffness_effect={1: {"a1": 0.2}, 2: {"a1": 0.04}})
    for checks in ((), (prediction("a", 99.0),), (slow,), (half,)):
        text = words_of(verdict(replace(one, checks=checks)))
        assert "elastic model, motion" not in text
        assert not checks or "Elastic model not validated" in text
        assert not replace(one, checks=checks).verdict.validated.elastic
    full = replace(one, checks=(replace(steps, stiffness_effect={1: {"a1": 0.2}, 2: {"a1": 0.3}}),))
    assert full.verdict.validated.elastic
    assert not full.verdict.validated.rigid
    text = words_of(verdict(full))
    assert "|elastic model, motion|2|98.5 %|98.0 %|a1 in steps|" in text
    assert "not validated" not in text


def drive(**changed: object) -> Identification:
    """A rigid drive with all parameters identified."""
    one = identification()
    assert one.rigid is not None
    names = ("inertia", "motor_viscous_friction", "motor_coulomb_friction")
    rigid = replace(one.rigid, parameters=tuple(reported(name, 1.0, 0.01) for name in names))
    fine = replace(one, study=rigid_drive(), stage_warnings=(), rigid=rigid)
    return replace(fine, **changed)  # type: ignore[arg-type]


def test_faults_of_the_input_are_listed_with_their_corrections() -> None:
    text = words_of(verdict(drive(suspected=(FAULT,))))
    assert "|Inconsistent input|" in text
    assert "|u1|u1 is 9.81 of it.|Set scale = 9.81.|" in text


def test_the_most_serious_warning_is_named() -> None:
    mild = Diagnostic("constant-channel", Place(file="data/a.csv"), channel="a1")
    grave = Diagnostic("not-tuned", Place(file="data/b.toml"), reason="no voltages")
    text = of(stage_warnings=(mild, grave), checks=())
    assert "2 warnings|; most serious: b.toml: No voltages." in text
    text = of(stage_warnings=(mild,), checks=())
    assert "1 warning|: a.csv: The channel 'a1' never changes." in text


def test_warnings_are_sorted_by_severity_with_meaning_and_remedy() -> None:
    warnings, where = warnings_table(
        [
            Diagnostic("friction-settles", Place(joint=1), time=1e-4),
            Diagnostic("saturated", Place.in_records("b"), channel="u1", share=0.1),
        ]
    )
    assert isinstance(warnings, Table)
    assert isinstance(where, Paragraph)
    assert TROUBLESHOOTING_PAGE in [span.text for span in where.spans]
    first, second = ([cell.text for cell in row] for row in warnings.rows if isinstance(row, tuple))
    assert (first[0], second[0]) == ("b", "joint 1")
    assert (
        first[1]
        == "u1 is at its limit for 10.0 % of the record; these samples are not used. Record a slower motion."
    )
    assert "excluded" in first[2]
    assert first[3] == "Record a slower motion, or correct limit in [servo]."  # without marks


CONSTRUCTORS = ("Diagnostic", "Check", "_check", "attempt")


@cache
def codes() -> set[str]:
    """The code of every warning that a stage gives."""
    names: set[str] = set()
    for path in PACKAGE.rglob("*.py"):
        if path.relative_to(PACKAGE).parts[0] in OTHER_COMMANDS:
            continue
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if not isinstance(node, ast.Call) or not node.args:
                continue
            function, first = ast.unparse(node.func), node.args[0]
            if isinstance(first, ast.Constant) and function in CONSTRUCTORS:
                names.add(str(first.value))
    return names


def test_every_warning_has_a_meaning_and_a_remedy() -> None:
    assert {"saturated", "sliding", "modes-failed"} <= codes()
    assert all(one.meaning and one.remedy for one in advice().values())
    assert codes() - advice().keys() == set()
