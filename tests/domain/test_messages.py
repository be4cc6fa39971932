"""Every message has a template, and every warning gives the values that its template needs."""

from __future__ import annotations

import ast
import pickle
import tomllib
from pathlib import Path
from string import Formatter

import pytest

import strainwave
from strainwave.domain import Clause, Diagnostic, Place, ValueRange
from strainwave.domain.messages import (
    catalogue,
    place_text,
    places_text,
    templates,
    text_of,
)

PACKAGE = Path(strainwave.__file__).parent
MEASUREMENT = 1.5
ALL = templates()
FAULTS = tomllib.loads((PACKAGE / "domain/faults.toml").read_text(encoding="utf-8"))
PARTS = FAULTS["parts"]
GIVEN_LATER = {"record", "steps", "other", "gain"}
"""Values that a warning or a cause adds to its clause."""


def fields_of(template: str) -> dict[str, bool]:
    """The fields of a template, and whether each has a number."""
    for name, part in PARTS.items():
        template = template.replace(f"{{{name}}}", part)
    return {name: bool(spec) for _, name, spec, _ in Formatter().parse(template) if name}


@pytest.mark.parametrize("key", ALL)
def test_every_template_renders(key: str) -> None:
    template = ALL[key]
    values = {
        name: MEASUREMENT if is_number else "x" for name, is_number in fields_of(template).items()
    }
    text = text_of(Clause(key, **values))
    assert text
    assert not set("{}|") & set(text)
    assert text[-1] not in ".; "


def test_every_warning_and_clause_gives_the_values_of_its_template() -> None:
    used = set()
    for path in PACKAGE.rglob("*.py"):
        for call in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if not isinstance(call, ast.Call) or ast.unparse(call.func) not in (
                "Diagnostic",
                "Clause",
            ):
                continue
            keys = [arg.value for arg in call.args if isinstance(arg, ast.Constant)]
            names = {keyword.arg for keyword in call.keywords}
            if not keys or None in names or len(keys) < len(call.args) - 1:
                continue
            key = "/".join(str(part) for part in keys if part)
            template = ALL.get(key)
            assert template is not None, (path.name, key)
            assert fields_of(template).keys() - GIVEN_LATER <= names, (path.name, key)
            used.add(key)
    of_warnings = {
        (code, variant) for code, each in catalogue().items() for variant in each["message"]
    }
    assert not {"/".join(filter(None, key)) for key in of_warnings} & FAULTS["templates"].keys()
    # the keys of relations come from their kinds, those of others from tables
    others = [key for key in ALL if not key.startswith("relation/")]
    assert len(used) > 0.6 * len(others)


def test_places_are_rendered_by_what_they_have() -> None:
    joint = Place(joint=2)
    assert place_text(Place(("prbs-j1",), joint=1)) == "prbs-j1, joint 1"
    assert place_text(Place(joint=1, parameter="gear_damping")) == "gear_damping of joint 1"
    assert place_text(Place(joint=2, key="gear_ratio")) == "joint 2 gear_ratio"
    assert place_text(Place(("a", "b"), channel="a1")) == "a1"
    assert places_text((Place(joint=1), joint)) == "joint 1, 2"
    assert places_text((Place(channel="a1"), Place(channel="a2"))) == "a1, a2"


def test_lists_have_commas_and_a_conjunction() -> None:
    records = tuple(Place.in_records(name) for name in ("a", "b", "c"))
    swapped = [
        text_of(Clause("swapped-channels", pairs=records[:n], joints=(1, 2))) for n in (1, 2, 3)
    ]
    assert [text.partition(":")[0] for text in swapped] == ["a", "a and b", "a, b and c"]


def test_a_span_is_one_number_where_its_ends_look_equal() -> None:
    assert f"{ValueRange(0.50, 0.504):.2f}" == "0.50"
    assert f"{ValueRange(0.5, 0.7):.1f}" == "0.5 to 0.7"


def test_warnings_can_be_compared_and_sent_to_other_processes() -> None:
    warning = Diagnostic("saturated", Place.in_records("motion"), channel="u1", share=0.1)
    assert pickle.loads(pickle.dumps(warning)) == warning
    assert len({warning, warning.at(Place.in_records("motion"))}) == 1
