"""`strainwave check`: the input check alone, in the terminal, as JSON and in Python."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest
from rich.console import Console
from typer.testing import CliRunner

import strainwave as sw
from strainwave.cli import app
from strainwave.domain import Channel, Clause, Consistency, InputCheck, Place, Suspicion
from strainwave.domain.messages import templates
from strainwave.input_check.observations import EXPECTED
from strainwave.io.results import check_document
from strainwave.io.study import read_study, write_study
from strainwave.pipeline import identify
from strainwave.report.terminal import print_check

SMALL_ARM = Path(__file__).parent / "data" / "small-arm" / "study.toml"


@pytest.fixture(scope="module")
def reversed_study(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The small arm with a reversed accelerometer."""
    study = read_study(SMALL_ARM)
    files = tuple(replace(e, file=str(SMALL_ARM.parent / e.file)) for e in study.experiments)
    before = study.channels.get("a1", Channel("a1"))
    channels = {**study.channels, "a1": replace(before, scale=-before.scale)}
    path = tmp_path_factory.mktemp("reversed") / "study.toml"
    write_study(replace(study, experiments=files, channels=channels), path)
    return path


def printed(check: InputCheck) -> str:
    console = Console(width=160, no_color=True)
    with console.capture() as capture:
        print_check(check, console=console)
    return capture.get()


def test_every_kind_of_relation_has_a_text() -> None:
    kinds = {key.partition("/")[2] for key in templates() if key.startswith("relation/")}
    assert kinds == {"clipped", "readings", *EXPECTED}


def test_consistent_input() -> None:
    check = sw.check(SMALL_ARM)
    assert (check.status, check.exit_code, check.suspected) == ("consistent", 0, ())
    assert all(relation.is_consistent for relation in check.relations)
    text = printed(check)
    assert "reading / motor motion" in text
    assert "check: consistent (exit code 0)" in text


def test_an_accepted_fault_does_not_decide(reversed_study: Path) -> None:
    (fault,) = sw.check(reversed_study).suspected
    result = CliRunner().invoke(
        app, ["check", str(reversed_study), "--json", "--accept", fault.code]
    )
    document = json.loads(result.stdout)
    assert (result.exit_code, document["status"]) == (0, "consistent")
    assert [entry["accepted"] for entry in document["suspected"]] == [True]
    identification = identify(reversed_study, stages=("rigid",), options=[f"accept={fault.code}"])
    assert identification.verdict.status != "inconsistent-input"
    assert [each.accepted for each in identification.verdict.suspected] == [True]
    other = CliRunner().invoke(app, ["check", str(reversed_study), "--accept", "clipped"])
    assert other.exit_code == 3


def test_an_unknown_code_is_not_accepted(reversed_study: Path) -> None:
    result = CliRunner().invoke(app, ["check", str(reversed_study), "--accept", "sign"])
    assert result.exit_code != 0


def test_channels_in_no_relation_are_listed(tmp_path: Path) -> None:
    check = sw.check(SMALL_ARM)
    extended = replace(check, unchecked=("temperature1",))
    assert "not checked: temperature1" in printed(extended)
    assert check_document(extended)["unchecked"] == ["temperature1"]
    for relation in check.relations:  # the verdict follows from the printed numbers
        if relation.bound == "equal" and relation.expected is not None:
            assert abs(relation.measured - relation.expected) <= relation.accuracy


def test_a_fault_has_the_verdict_of_identify(reversed_study: Path) -> None:
    check = sw.check(reversed_study)
    assert (check.status, check.exit_code) == ("inconsistent-input", 3)
    result = sw.identify(reversed_study, stages="rigid")
    document = check_document(check)
    assert document["suspected"] == result.document["verdict"]["suspected"]
    assert [each["code"] for each in document["suspected"]] == ["wrong-sign"]
    contradictions = [r for r in document["relations"] if not r["consistent"]]
    assert {r["where"] for r in contradictions} == {"a1"}
    assert "a1" in printed(check).splitlines()[1]  # contradictions first


SUSPICIONS = [
    Suspicion(
        code=code,
        places=(place,),
        clause=Clause("text", text="observed"),
        remedy_clause=Clause("text", text="correct it"),
        factor=f,
    )
    for code, f in (("wrong-torque-constant", 1.1), ("wrong-unit", -1.0), ("misaligned", None))
    for place in (
        Place(channel="theta_m1"),
        Place(channel="a2"),
        Place(joint=2, key="gear_ratio"),
        Place(key="torque_per_volt"),
    )
]


@pytest.mark.parametrize("suspicion", SUSPICIONS, ids=lambda s: f"{s.code} {s.where} {s.factor}")
def test_no_suspected_fault_becomes_a_determined_result(
    suspicion: Suspicion, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(
        "strainwave.input_check.check_consistency",
        lambda logs, study: Consistency((suspicion,)),
    )
    monkeypatch.setattr(
        "strainwave.pipeline.fit_elastic_arm", lambda *_: pytest.fail("an elastic stage ran")
    )
    identification = identify(SMALL_ARM)
    verdict = identification.verdict
    assert (verdict.status, verdict.exit_code) == ("inconsistent-input", 3)
    assert verdict.suspected[0] == suspicion
    is_of_link = suspicion.places[0].channel == "a2"
    assert (identification.rigid is not None) == is_of_link  # which uses the motors alone


def test_stdout_is_json_only(reversed_study: Path) -> None:
    outcome = CliRunner().invoke(app, ["check", str(reversed_study), "--json"])
    assert outcome.exit_code == 3
    document = json.loads(outcome.stdout)
    assert document["status"] == "inconsistent-input"
    keys = {"relation", "where", "measured", "std", "expected", "accuracy", "bound", "consistent"}
    assert all(set(each) == keys for each in document["relations"])


def test_missing_logs_are_faults_of_the_input(tmp_path: Path) -> None:
    write_study(read_study(SMALL_ARM), tmp_path / "study.toml")
    with pytest.raises(sw.InvalidInput, match="does not exist"):
        sw.check(tmp_path / "study.toml")
