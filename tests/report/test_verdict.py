"""The verdict says what the numbers say, and every warning has a remedy."""

from __future__ import annotations

import ast
import re
from dataclasses import replace
from pathlib import Path

import pytest

import strainwave
from results import identification, prediction
from strainwave.records import Caution, Identification, Parameter
from strainwave.report import remedies
from strainwave.report.verdict import named, verdict

PACKAGE = Path(strainwave.__file__).parent
ELSEWHERE = ("design", "export")  # their warnings never reach a report


def of(*parameters: Parameter, **changed: object) -> str:
    """The verdict on these parameters, without tags."""
    one = identification()
    assert one.rigid is not None
    rigid = replace(one.rigid, parameters=parameters)
    found: Identification = replace(one, rigid=rigid, **changed)  # type: ignore[arg-type]
    return re.sub(r"<[^>]+>", "|", verdict(found))


def told(name: str, value: float | None, half: float | None, joint: int | None = 1) -> Parameter:
    interval = None if half is None or value is None else (value - half, value + half)
    return Parameter(name, joint, value, half, "-", "rigid", interval)


@pytest.mark.parametrize(
    ("value", "half", "said"),
    [
        (1.0, 0.009, "Told to 1 % or better"),
        (1.0, 0.011, "Told to 10 % or better"),
        (-1.0, 0.5, "Told roughly"),
        (1.0, 1.5, "Not to be told from zero"),
        (0.0, 1.5, "Not to be told from zero"),
        (1.0, None, "Told without an interval"),
        (None, None, "Not told"),
    ],
)
def test_each_parameter_is_classed_by_its_interval(
    value: float | None, half: float | None, said: str
) -> None:
    text = of(told("gear_damping", value, half))
    assert re.search(rf"\|{said}[^|]*\|\|gear damping \(1\)\|", text), text


def test_it_counts_what_was_told() -> None:
    alpha = told("alpha", 1.0, 0.05, None)
    assert "All 2 parameters have a value, 1 of them to 10 %" in of(alpha, told("beta", 1.0, 0.2))
    assert "1 of 2 parameters have a value, 1 of them" in of(alpha, told("beta", None, None))
    assert "No parameter was found." in of()
    assert "Not everything could be told.| nothing moved" in of(reason="nothing moved")


def test_combinations_stand_beside_the_parameters() -> None:
    pair = Caution("only-together", "alpha and gear_damping of joint 1", "told only together")
    assert "Told only in combination||alpha and gear damping of joint 1|" in of(warnings=(pair,))


def test_names_are_gathered_over_the_joints() -> None:
    both = [told("link_inertia", 1.0, 0.1, joint) for joint in (1, 2)]
    assert named([told("alpha", 1.0, 0.1, None), *both]) == "alpha, link inertia (1, 2)"


def test_fits_of_the_records_it_never_saw() -> None:
    text = of(checks=(prediction("a", 91.25, 99.0), prediction("b", 95.0, float("nan"))))
    assert "at least 91.2 % (fit of torque1 in “a”), and 95.0 % in the middle of 3 channels" in text
    assert "No record was kept" in of(checks=())
    assert "hardly move" in of(checks=(prediction("a", float("nan")),))


def test_the_grade_is_that_of_the_middle() -> None:
    for middle, grade in ((96.0, "very well"), (86.0, "well"), (61.0, "in part"), (5.0, "badly")):
        text = of(checks=(prediction("a", 1.0, middle, 99.0),))
        assert f"foretells {grade}: it explains at least 1.0 %" in text


def test_only_what_is_found_and_foretold_is_green() -> None:
    one = replace(identification(), warnings=())
    assert one.rigid is not None
    fine = replace(one, rigid=replace(one.rigid, parameters=one.rigid.parameters[:1]))
    for found, mark in (
        (fine, ""),
        (one, "doubt"),  # a parameter was not told
        (replace(fine, checks=(prediction("a", 50.0),)), "doubt"),
        (replace(fine, warnings=identification().warnings), "doubt"),
        (replace(fine, warnings=(Caution("resampled", "a.csv", "uneven"),)), ""),
        (replace(fine, reason="nothing moved"), "bad"),
    ):
        assert f'class="verdict {mark}"' in verdict(found)


def test_the_most_serious_warning_is_named() -> None:
    mild = Caution("resampled", "a.csv", "uneven steps")
    grave = Caution("implausible", "data/b.csv", "negative")
    text = of(warnings=(mild, grave))
    assert "2 warnings|; the most serious, of b.csv: negative." in text
    assert "1 warning|; of a.csv: uneven steps." in of(warnings=(mild,))
    # what nobody has thought of comes before all
    unheard = Caution("unheard-of", "c", "odd")
    assert remedies.most_serious((grave, unheard)) is unheard


def test_warnings_stand_in_their_order_with_what_to_do() -> None:
    rows = remedies.warnings_table(
        [Caution("resampled", "a.csv", "uneven"), Caution("saturated", "b.csv", "at its limit")]
    )
    assert rows.index("b.csv") < rows.index("a.csv")
    assert "Lower the amplitude" in rows
    assert "See the message" in remedies.warnings_table([Caution("unheard-of", "c", "odd")])


def codes() -> set[str]:
    """Of every warning that a stage gives."""
    found: set[str] = set()
    for path in PACKAGE.rglob("*.py"):
        if path.relative_to(PACKAGE).parts[0] in ELSEWHERE:
            continue
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if not isinstance(node, ast.Call) or not isinstance(node.func, ast.Name):
                continue
            first = node.args[0] if node.args else None
            if isinstance(first, ast.Constant) and node.func.id in ("Caution", "Check", "tried"):
                found.add(str(first.value))
    return found


def test_every_warning_has_a_remedy() -> None:
    assert {"saturated", "sliding", "modes-failed"} <= codes()
    assert remedies.REMEDIES.keys() >= remedies.MILD
    assert codes() - remedies.REMEDIES.keys() == set()
