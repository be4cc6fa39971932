"""`[family]` of a campaign.toml: valid keys and error messages."""

from __future__ import annotations

import tomllib
from dataclasses import fields
from pathlib import Path

import pytest
from benchmarks.families.catalogue import Friction
from benchmarks.families.drawing import FAULTS, Sensors

from benchmarks.families import Family, family_of, fields_of
from strainwave.errors import InvalidInput

PATH = Path("campaign.toml")
EXAMPLES = Path(__file__).parents[3] / "benchmarks" / "families"


def read(text: str) -> Family:
    whole = f'stages = ["rigid"]\n\n[family]\n{text}\n'
    return family_of(tomllib.loads(whole)["family"], PATH, whole)


def test_keys_have_defaults() -> None:
    assert read("arms = 3") == Family(arms=3)


def test_a_family_converts_back_to_its_table() -> None:
    family = read(
        'arms = 3\nsizes = [14, 20]\nfaults = ["late-sensors"]\n'
        'sensors = { noise = [0.5, 2.0], link = ["none"] }\nfriction = { viscous = [1.0, 3.0] }'
    )
    assert family_of(fields_of(family), PATH, "") == family


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("", "the key 'arms' is missing"),
        ("arms = 0", "'arms' is 0"),
        ("arms = 3\nsees = 4", "the key 'sees' is unknown"),
        ("arms = 3\nsizes = [15]", "'sizes' contains the unknown value 15"),
        ("arms = 3\nsizes = []", "'sizes' is []"),
        ("arms = 3\nratios = [0.01]", "'ratios' is [0.01]"),
        ('arms = 3\nsprings = ["cubic"]', "'springs' contains the unknown value 'cubic'"),
        ("arms = 3\ncounts = [3]", "'counts' is [3]"),
        ("arms = 3\nsample_times = [0.5]", "'sample_times' is [0.5]"),
        ("arms = 3\ngravity = 1.5", "'gravity' is 1.5"),
        ("arms = 3\nfaults = 2.0", "'faults' is 2.0"),
        ('arms = 3\nfaults = ["late"]', "'faults' contains the unknown value 'late'"),
        ('arms = 3\neffects = ["friction"]', "'effects' contains the unknown value 'friction'"),
        ("arms = 3\npayload = [2.0, 1.0]", "the range of 'payload' from 2 to 1 is empty"),
        ("arms = 3\npayload = 2.0", "'payload' is 2.0"),
        ("arms = 3\nfriction = { coulomb = [2.0, 1.0] }", "the range of 'friction' from 2 to 1"),
        ("arms = 3\nfriction = { viscous = [2.0, 1.0] }", "the range of 'friction' from 2 to 1"),
        ("arms = 3\nsensors = { noise = [2.0, 1.0] }", "the range of 'sensors' from 2 to 1"),
        ("arms = 3\nfriction = { dry = 1.0 }", "the key 'dry' is unknown"),
        ('arms = 3\nsensors = { link = ["camera"] }', "'link' is ['camera']"),
        ("arms = 3\nseed = -1", "'seed' is -1"),
    ],
)
def test_errors_name_place_and_cause(text: str, expected: str) -> None:
    with pytest.raises(InvalidInput) as refused:
        read(text)
    message = str(refused.value)
    assert expected in message
    assert "campaign.toml, line" in message
    assert "[family]" in message
    assert refused.value.remedy
    assert "\n" not in message


def test_every_key_and_kind_is_documented() -> None:
    page = (Path(__file__).parents[3] / "docs" / "families.md").read_text()
    keys = [field.name for record in (Family, Friction, Sensors) for field in fields(record)]
    assert [name for name in (*keys, *FAULTS) if f"`{name}`" not in page] == []


def test_examples_describe_families_of_a_thousand() -> None:
    tables = {
        name: tomllib.loads((EXAMPLES / f"{name}.toml").read_text())["family"]
        for name in ("clean", "faulty")
    }
    clean, faulty = (family_of(table, PATH, "") for table in tables.values())
    assert (clean.arms, clean.faults, faulty.arms, faulty.faults) == (1000, 0.0, 1000, 1.0)
