"""The command `tune`: its page, its summary, its refusals."""

from __future__ import annotations

import io
import json
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
from rich.console import Console

import exports
import strainwave as sw
from command_line import Finished, run_here
from servo_arms import rig
from strainwave.domain import JointLimits
from strainwave.export import arm_of
from strainwave.io.study import read_study, write_study
from strainwave.tune import PAGE, read_payloads, read_postures, tune_document
from strainwave.tune.design import design_servo
from strainwave.tune.handover import FILES
from strainwave.tune.report import words
from strainwave.tune.report.page import render
from strainwave.tune.report.words import print_design

POSTURES = ("0,0", "0.3,1.8")
LOAD = "2,0.3,0,0"
FEW = sw.ServoOptions(postures=((0.0, 0.0),), draws=1)
QUICK = ("--draws", "1", "--posture", "0,0")


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory) -> Path:
    study = exports.two_links(tmp_path_factory.mktemp("rig"))
    return exports.write(study, exports.values_of(study))


@pytest.fixture(scope="module")
def design(result: Path) -> sw.ServoDesign:
    options = sw.ServoOptions(read_postures(POSTURES), read_payloads([LOAD]), draws=5, seed=2)
    return sw.read_result(result).tune(options)


@pytest.fixture(scope="module")
def tuned(result: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Finished, str]:
    """The command and its page."""
    out = tmp_path_factory.mktemp("tuned") / "new"
    postures = [text for posture in POSTURES for text in ("--posture", posture)]
    drawn = ("--draws", "5", "--seed", "2")
    finished = run_here("tune", result, "--out", out, *postures, "--payload", LOAD, *drawn)
    assert finished.stderr == ""
    assert finished.returncode == 0
    assert {path.name for path in out.iterdir()} == {
        PAGE,
        *FILES,
    }
    return finished, (out / "tune.html").read_text()


def refused(result: Path, tmp_path: Path, *options: str) -> str:
    """Message of a command that ends with exit code 2 and writes nothing."""
    finished = run_here("tune", result, "--out", tmp_path / "out", *options)
    assert finished.returncode == 2
    assert finished.stdout == ""
    assert not (tmp_path / "out").exists()
    return finished.stderr


def test_python_and_command_give_the_same_page(
    tuned: tuple[Finished, str], design: sw.ServoDesign
) -> None:
    assert render(design) == tuned[1]


def test_the_summary_has_current_servo_gains_margins_shapers_and_moves(
    tuned: tuple[Finished, str], design: sw.ServoDesign
) -> None:
    text = " ".join(tuned[0].stdout.split())
    assert text.startswith("your servo: joint 1 has ")
    assert re.search(
        r"your servo: joint 2 has [\d.]+ dB at [\d.]+ Hz, [\d.]+ degrees at [\d.]+ Hz, "
        r"modulus 0\.\d+, bandwidth [\d.]+ Hz",
        text,
    )
    for joint in design.joints:
        gains = joint.gains
        row = f"{joint.joint} designed {gains.kp:.4g} {gains.ki:.4g} {gains.position_gain:.4g}"
        assert row in text
        assert f"joint {joint.joint} is limited by its " in text
    for title in ("Gains", "Behaviour", "Worst margins", "Input shapers", "Moves of 0.05 rad"):
        assert title in text
    assert "recommended" in text
    assert "tune.html" in text


def test_the_page_has_the_numbers_of_the_design(
    tuned: tuple[Finished, str], design: sw.ServoDesign
) -> None:
    page = re.sub(r"<script.*?</script>", "", tuned[1], flags=re.DOTALL)
    text = " ".join(re.sub(r"<[^>]*>", " ", page).split())
    assert f"for all {design.n_plants} plants" in text
    for joint in design.joints:
        gains = joint.gains
        for value in (gains.kp, gains.ki, gains.position_gain):
            assert f" {value:.4g} " in text
        first = gains.slowed(design.first_share)
        assert f" {joint.joint} {first.kp:.4g} {first.ki:.4g} {first.position_gain:.4g} " in text
        margins = joint.results.margins
        for smallest in (margins.gain_db.min(), margins.phase_deg.min(), margins.modulus.min()):
            assert f" {smallest:.3g} " in text
        assert f" {joint.joint} designed {margins.bandwidth_hz.min():.3g} " in text
    for sentence in words.current_sentences(design):
        assert sentence[1:] in text
    best = design.shapers[0]
    assert f"{words.shaper_name(best)} " in text
    assert f" {1e3 * best.impulses.duration:.0f} {100.0 * best.vibration:.2g} recommended" in text
    for move in design.moves:
        assert f" {move.joint} planned {move.duration:.3g} {move.planned.settling:.3g} " in text
    for one in design.estimation:
        assert f" {one.joint} observer {1e6 * one.by_observer:.3g} " in text
        assert f" {one.joint} motor angle {1e6 * one.by_motor:.3g} " in text
    for each in design.dampings:
        assert f" {each.joint} designed {each.without[0]:.2g} " in text
        assert each.reason in text
    for sentence in words.observer_gaps(design):
        assert sentence[1:] in text
    assert "payload 2 kg" in text
    assert "emergency stop" in text
    assert f"{100.0 * design.first_share:.0f} % of the designed bandwidth" in text


def test_the_page_has_a_figure_of_each_loop_step_and_move(tuned: tuple[Finished, str]) -> None:
    found = re.search(r'<script type="application/json" id="figures">(.*?)</script>', tuned[1])
    assert found is not None
    figures = json.loads(found[1])
    kinds = ("loop", "step", "observer", "move")
    assert figures.keys() == {f"{kind}-{i}" for kind in kinds for i in (1, 2)} | {"shapers"}
    assert sum(len(json.dumps(figure)) for figure in figures.values()) < 1_000_000
    for figure in figures.values():
        assert all(len(trace["x"]) <= 1100 for trace in figure["data"])


def test_figures_compare_the_servos(tuned: tuple[Finished, str]) -> None:
    found = re.search(r'<script type="application/json" id="figures">(.*?)</script>', tuned[1])
    assert found is not None
    for key, figure in json.loads(found[1]).items():
        names = {trace.get("name") for trace in figure["data"] if trace.get("name")}
        expected = {
            "loop": {"current", "designed", "required distance"},
            "step": {"current", "designed"},
            "move": {"step", "planned"},
            "observer": {"motor", "observer"},
        }
        assert expected.get(key.partition("-")[0], names) <= names


def printed(design: sw.ServoDesign) -> str:
    console = Console(width=80, record=True, highlight=False, file=io.StringIO())
    print_design(design, Path("tune.html"), console=console)
    return " ".join(console.export_text().split())


def test_an_arm_without_servo_and_voltages_has_torque_gains() -> None:
    arm, limits = rig(), JointLimits(effort=50.0)
    joints = tuple(
        replace(joint, torque_per_volt=None, limits=limits) for joint in arm.study.arm.joints
    )
    study = replace(arm.study, arm=replace(arm.study.arm, joints=joints, servo=None))
    design = design_servo(replace(arm, study=study), None, FEW)
    page, text = render(design), printed(design)
    for part in ("kp [N m s/rad]", "ki [N m/rad]"):
        assert part in page
        assert part in text
    assert "The study has no servo" in page
    assert "your servo" not in text
    assert "0.5 N m" in page
    for to_file in FILES.values():
        assert not re.search(r"\b(inf|nan)\b", to_file(design))


def test_an_unstable_servo_is_reported() -> None:
    arm = rig()
    servo = arm.study.arm.servo
    assert servo is not None
    study = replace(arm.study, arm=replace(arm.study.arm, servo=replace(servo, kp=(5.0, 5.0))))
    design = design_servo(replace(arm, study=study), None, FEW)
    assert printed(design).startswith("your servo is unstable for 2 of 2 plants Gains")
    assert "Your servo is unstable for 2 of 2 plants." in render(design)


def test_python_writes_the_page_and_reports_progress(result: Path, tmp_path: Path) -> None:
    seen: list[str] = []
    design = sw.read_result(result).tune(FEW, out=tmp_path / "new", progress=seen.append)
    assert (tmp_path / "new" / "tune.html").read_text() == render(design)
    assert seen[0] == "drawing plants"
    assert seen[-1] == "writing the report"


def test_quiet_prints_nothing(result: Path, tmp_path: Path) -> None:
    finished = run_here("tune", result.parent, "--out", tmp_path, *QUICK, "--quiet")
    assert (finished.returncode, finished.stdout, finished.stderr) == (0, "", "")
    assert (tmp_path / "tune.html").exists()


def test_margins_and_clock_are_options(result: Path, tmp_path: Path) -> None:
    margins = ("--gain-margin", "9", "--phase-margin", "41", "--modulus-margin", "0.61")
    clock = ("--period", "0.002", "--delay", "0.0015")
    finished = run_here("tune", result, "--out", tmp_path, *QUICK, *margins, *clock)
    assert finished.returncode == 0
    page = (tmp_path / "tune.html").read_text()
    assert (
        "a gain margin of 9 dB, a phase margin of 41 degrees and a modulus margin of 0.61" in page
    )
    assert "2 ms" in page
    assert "1.5 ms from an encoder reading" in page


def test_another_study_gives_the_servo(result: Path, tmp_path: Path) -> None:
    study = read_study(result.parent / "study.toml", logs_exist=False)
    servo = study.arm.servo
    assert servo is not None
    other = tmp_path / "other.toml"
    arm = replace(study.arm, servo=replace(servo, kp=(0.2, 0.123)))
    write_study(replace(study, arm=arm, path=other), other)
    finished = run_here("tune", result, "--out", tmp_path, *QUICK, "--study", other)
    assert finished.returncode == 0
    assert re.search(r"2 +current +0\.123 ", finished.stdout)


def test_draws_follow_the_joint_covariance(result: Path) -> None:
    """Stiffnesses with a third of their value as standard deviation spread the modes."""
    document = json.loads(result.read_text())
    names = ["gear_stiffness 1", "gear_stiffness 2"]
    values = {f"{p['name']} {p['joint']}": p["value"] for p in document["parameters"]}
    matrix = [[(values[names[i]] / 3.0) ** 2 * (i == j) for j in range(2)] for i in range(2)]
    covariance = {"stage": "tuned", "names": names, "matrix": matrix}
    options = replace(FEW, draws=10)
    narrow, wide = (
        tune_document(document | extra, arm_of(document | extra, result), options)
        for extra in ({}, {"covariance": covariance})
    )
    ratios = [each.modes_hz[0, 1] / each.modes_hz[0, 0] for each in (narrow, wide)]
    assert ratios[0] < 1.1
    assert ratios[1] > 1.3


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--posture", "0"), "--posture: the posture has 1 angles, but the arm has 2 joints"),
        (("--posture", "0,1,2"), "--posture: the posture has 3 angles"),
        (("--posture", "0,up"), "--posture: 'up' in '0,up' is not a number"),
        (("--posture", "0,nan"), "--posture: 'nan' in '0,nan' is not a number"),
        (("--posture", ""), "--posture: '' in '' is not a number"),
        (("--payload", "2,0.1"), "--payload: '2,0.1' has 2 of the four numbers mass,x,y,z"),
        (("--payload", "2,a,0,0"), "--payload: 'a' in '2,a,0,0' is not a number"),
        (("--payload", "-2,0,0,0"), "--payload: the mass is -2"),
        (("--payload", "0,0,0,0"), "--payload: the mass is 0"),
        (("--draws", "-1"), "--draws: the number of draws is -1"),
        (("--period", "0"), "--period: the period is 0"),
        (("--period", "inf"), "--period: the period is inf"),
        (("--delay", "0.1"), "--delay: a delay of 0.1 s is not between zero and the servo period"),
        (("--bandwidth", "0"), "--bandwidth: the bandwidth is 0"),
        (("--gain-margin", "-3"), "--gain-margin: the gain margin is -3"),
        (("--phase-margin", "200"), "--phase-margin: the phase margin is 200"),
        (("--modulus-margin", "1.5"), "--modulus-margin: the modulus margin is 1.5"),
    ],
)
def test_bad_options_are_one_sentence(
    result: Path, tmp_path: Path, options: tuple[str, ...], message: str
) -> None:
    text = refused(result, tmp_path, *options)
    assert text.startswith(f"strainwave: {message}")
    assert "Remedy: " in text
    assert len(text.splitlines()) == 1


@pytest.mark.parametrize("option", ["--draws", "--seed", "--period", "--bandwidth"])
def test_options_that_are_no_numbers_are_refused(result: Path, tmp_path: Path, option: str) -> None:
    assert option in refused(result, tmp_path, option, "many")


def test_a_bandwidth_out_of_reach_is_refused(result: Path, tmp_path: Path) -> None:
    text = refused(result, tmp_path, *QUICK, "--bandwidth", "900")
    assert "--bandwidth: the velocity loop of joint 1 reaches" in text


def test_a_missing_result_is_refused(tmp_path: Path) -> None:
    assert "nowhere" in refused(tmp_path / "nowhere.json", tmp_path)


def without(name: str) -> Callable[[dict[str, object]], bool]:
    return lambda entry: not (entry["name"] == name and entry["joint"] == 1)


def test_a_result_without_a_gear_has_exit_code_3(result: Path, tmp_path: Path) -> None:
    document = json.loads(result.read_text())
    document["parameters"] = list(filter(without("gear_damping"), document["parameters"]))
    path = tmp_path / "result.json"
    path.write_text(json.dumps(document))
    study = result.parent / "study.toml"
    finished = run_here("tune", path, "--out", tmp_path / "out", *QUICK, "--study", study)
    assert finished.returncode == 3
    assert "does not determine gear_damping 1" in finished.stderr
    assert not (tmp_path / "out").exists()


def test_the_tables_fit_eighty_columns(design: sw.ServoDesign) -> None:
    console = Console(width=80, record=True, highlight=False, file=io.StringIO())
    print_design(design, Path("tune.html"), console=console)
    lines = console.export_text().splitlines()
    heads = [line for line in lines if line.startswith("joint ")]
    sentences = [*words.observer_gaps(design), *words.damping_sentences(design)]
    # a table wraps no head
    assert len(heads) == 6 + len(design.joints) + len(sentences)
    assert max(map(len, lines)) <= 80
