"""Trends of a fleet: detection, false-alarm rate, order, files and terminal output."""

from __future__ import annotations

import io
import json
import secrets
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from benchmarks.trend import CASES, PATIENCE, delay, false_alarms, healthy_arm, step
from rich.console import Console
from scipy import stats

import visited_arms
from strainwave.errors import InvalidInput, NotIdentifiable
from strainwave.fleet.monitoring import trend as output
from strainwave.fleet.monitoring.trend import Trend, trend
from strainwave.fleet.monitoring.visits import Histories, read_histories

FAILURE_P = 1e-4  # probability that a test with a fresh seed fails by chance


@pytest.fixture(scope="module")
def fleet(tmp_path_factory: pytest.TempPathFactory) -> Trend:
    factors = {
        "arm-<1>": visited_arms.healthy,
        "arm-2": visited_arms.softening,
        "arm-3": visited_arms.rubbing,
        "arm-4": visited_arms.healthy,
    }
    store = visited_arms.fleet(tmp_path_factory.mktemp("store"), factors, seed=3)
    return trend(read_histories(store))


def test_changed_arms_come_first(fleet: Trend) -> None:
    concerns = {arm.history.arm: fleet.concerns(arm) for arm in fleet.arms}
    assert list(concerns)[:2] == ["arm-3", "arm-2"]
    assert [one.history.label for one in concerns["arm-3"]] == ["motor_coulomb_friction 1"]
    (stiffness,) = concerns["arm-2"]
    assert stiffness.history.label == "gear_stiffness 1"
    assert stiffness.words == "step at 2026-04-27"  # visit 16, one visit per week
    assert stiffness.percent == pytest.approx(-2.0, abs=0.5)
    assert not concerns["arm-<1>"]
    assert not concerns["arm-4"]
    assert [arm.p for arm in fleet.arms] == sorted(arm.p for arm in fleet.arms)
    assert fleet.concern


def test_the_same_store_gives_the_same_result(fleet: Trend) -> None:
    again = trend(Histories(tuple(arm.history for arm in fleet.arms), ()))
    assert [arm.p for arm in again.arms] == [arm.p for arm in fleet.arms]


def test_the_false_alarm_rate_is_at_most_the_level() -> None:
    """100 arms with 12 correlated parameters, at the default level of 1 %."""
    seed = secrets.randbits(32)
    counts = false_alarms(np.random.default_rng(seed), 100)
    n_alarms = sum(alarms for _, alarms in counts.values())
    assert n_alarms <= stats.binom.ppf(1.0 - FAILURE_P, 100, 0.012), seed


def test_a_loss_of_stiffness_is_detected_within_few_visits() -> None:
    name, size, noise_std, between_std, _, wear = CASES[2]
    assert (name, between_std, wear) == ("stiffness -2 %", 0.002, step)
    rng = np.random.default_rng(1)
    delays = [delay(rng, size, noise_std, between_std, wear) for _ in range(20)]
    assert np.median(delays) <= 2
    assert max(delays) < PATIENCE


def test_refusals(tmp_path: Path) -> None:
    histories = healthy_arm(np.random.default_rng(0), 10)
    with pytest.raises(InvalidInput, match="not a probability"):
        trend(histories, level=1.0)
    few = visited_arms.fleet(tmp_path, {"a": visited_arms.healthy}, visits=4)
    with pytest.raises(NotIdentifiable, match=r"at most 4 visit.*unless --arm names it"):
        trend(read_histories(few))


def test_many_arms_of_one_visit_bring_a_hint(fleet: Trend) -> None:
    """Each visit has its own folder, and --arm is missing."""
    arm = fleet.arms[0].history
    single_visits = [replace(arm, arm=visit.run, visits=(visit,)) for visit in arm.visits]
    notes = trend(Histories((arm, *single_visits), ())).notes
    assert len(notes) == 1
    assert notes[0].startswith("24 of 25 arms have one visit; an arm is the folder")
    assert "--arm" in notes[0]
    assert "such as 'fleet/arm-3/" in notes[0]
    assert not fleet.notes or "--arm '" not in " ".join(fleet.notes)


def test_the_document_contains_every_visit(fleet: Trend, tmp_path: Path) -> None:
    output.write(fleet, tmp_path)
    document = json.loads((tmp_path / "trend.json").read_text())
    assert document["schema"] == "strainwave/trend/1"
    assert document["concern"] is True
    worst = document["arms"][0]["parameters"][0]
    assert (worst["name"], worst["joint"]) == ("motor_coulomb_friction", 1)
    assert worst["change"]["kind"] in ("drift", "drift since", "step")
    assert len(worst["visits"]) == document["arms"][0]["visits"] == 24
    assert worst["drift"]["per_day"] * 161 == pytest.approx(0.4 * 0.06, rel=0.3)


def test_the_page_has_a_row_per_arm_and_escapes_names(fleet: Trend) -> None:
    page = output.render(fleet)
    assert "arm-<1>" not in page
    assert "arm-&lt;1&gt;" in page
    assert "2 of 4 arms change at the level of 1 % per arm: arm-3, arm-2." in page
    assert 'id="arm-arm-3"' in page
    assert page.count('class="plot"') >= 6


def test_the_terminal_lists_the_fleet(fleet: Trend) -> None:
    text = io.StringIO()
    output.print_trend(fleet, Path("out"), console=Console(file=text, width=100, highlight=False))
    lines = text.getvalue().splitlines()
    assert lines[1].split()[:4] == ["arm-3", "24", "motor_coulomb_friction", "1"]
    assert "step at 2026-04-27" in lines[2]
    assert any(line.startswith("verdict: 2 of 4 arms change") for line in lines)
    assert "written: out/trend.html" in text.getvalue()


def test_a_step_of_all_torques_is_one_factor(tmp_path: Path) -> None:
    """From visit 12 on, the torque constant of the study is 5 % larger."""

    def rescaled(name: str, joint: int | None, visit: int, visits: int) -> float:
        return 1.05 if visit >= 12 else 1.0

    factors = {"arm-1": rescaled, "arm-2": visited_arms.rubbing}
    result = trend(read_histories(visited_arms.fleet(tmp_path, factors, seed=4)))
    by_name = {arm.history.arm: arm.factor for arm in result.arms}
    assert by_name["arm-1"] is not None
    assert by_name["arm-1"].value == pytest.approx(1.05, abs=0.005)
    assert by_name["arm-2"] is None
    (note,) = [note for note in result.notes if "torque_per_volt" in note]
    assert note.startswith("arm-1: all torque-like parameters differ by one factor, 1.0")
