"""Commands of the command line: output, files and exit codes."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import typer

import compared_results
import studies
import visited_arms
from command_line import run_apart, run_here
from strainwave import cli
from strainwave.commands import command_texts
from strainwave.io.study import write_study
from strainwave.virtual import experiments as virtual
from strainwave.virtual import scara

FINISHED = ["result.json", "report.html"]


def test_the_demonstration_identifies_its_arm(demo: tuple[Path, str]) -> None:
    folder, printed = demo
    document = json.loads((folder / "result.json").read_text())
    truth = virtual.derived(scara.SOFT.parameters(), scara.SOFT.study(folder).arm)
    names = [p["name"] for p in document["parameters"]]
    # the gears have three slopes
    assert "gear_stiffness" not in names
    assert names.count("gear_stiffness_k3") == names.count("gear_knee_t2") == 2
    for p in document["parameters"]:
        name, joint = p["name"], p["joint"]
        if p["value"] is None:
            assert name in ("motor_viscous_friction", "link_viscous_friction")
        elif name == "gear_damping" or name.startswith(("motor_viscous", "link_viscous")):
            assert abs(p["value"] - truth[name, joint]) < max(
                4.0 * p["std"], 0.2 * truth[name, joint]
            )
        else:
            true = truth[name, joint]
            scale = truth["motor_coulomb_friction", joint] if true == 0.0 else true
            assert abs(p["value"] - true) < 0.03 * scale, p
            assert p["ci95"][0] < p["value"] < p["ci95"][1]
    assert "rigid_inertia" in printed
    assert str(folder / "report.html") in printed


def test_identify_reads_the_study_of_the_demonstration(
    demo: tuple[Path, str], tmp_path: Path
) -> None:
    folder, _ = demo
    out = tmp_path / "a" / "b"
    study = str(folder / "study.toml")
    process = run_here("identify", study, "--out", str(out), "--quiet", "--stages", "rigid")
    assert (process.returncode, process.stdout, process.stderr) == (0, "", "")
    assert sorted(p.name for p in out.iterdir()) == sorted(FINISHED)
    assert json.loads((out / "result.json").read_text())["status"] == "determined"
    again, first = (json.loads((f / "result.json").read_text()) for f in (out, folder))
    assert again["stages"]["rigid"] == first["stages"]["rigid"]
    assert again["study"] == first["study"]


def test_the_stages_option_takes_the_first_stages(demo: tuple[Path, str], tmp_path: Path) -> None:
    study = str(demo[0] / "study.toml")
    assert run_here("identify", study, "--out", str(tmp_path), "--stages", "rigid").returncode == 0
    process = run_here("identify", study, "--out", str(tmp_path / "x"), "--stages", "frobnicate")
    assert process.returncode == 2
    assert "frobnicate" in process.stderr
    assert "rigid" in process.stderr
    assert not (tmp_path / "x").exists()


@pytest.mark.parametrize(
    ("study", "log", "message"),
    [
        (studies.STUDY.replace("gear_ratio = 0.01", "gear_ratio = 100", 1), None, "0.01"),
        (studies.STUDY.replace("spring", "sprung", 1), None, "'spring'"),
        (studies.STUDY, "t,u1\n0.0,1.0\n0.001", "motion.csv"),
        (studies.STUDY, "", "motion.csv"),
    ],
)
def test_wrong_input_exits_with_two_and_one_message(
    study: str, log: str | None, message: str, tmp_path: Path
) -> None:
    path = studies.write(tmp_path, study, log)
    process = run_here("identify", str(path), "--out", str(tmp_path / "out"))
    assert process.returncode == 2
    assert message in process.stderr
    assert "Remedy:" in process.stderr
    assert "Traceback" not in process.stderr
    assert process.stderr.count("\n") == 1
    assert process.stdout == ""
    assert not (tmp_path / "out").exists()


def test_wrong_input_keeps_an_earlier_result(tmp_path: Path) -> None:
    path = studies.write(tmp_path, studies.STUDY, "")
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "result.json").write_text("earlier")
    assert run_here("identify", str(path), "--out", str(tmp_path / "out")).returncode == 2
    assert [p.read_text() for p in (tmp_path / "out").iterdir()] == ["earlier"]


def test_no_motion_exits_with_three_and_a_result(tmp_path: Path) -> None:
    text = studies.STUDY.replace('use = "motion"', 'use = "sweep"')
    # the logs hold no PRBS, which would be named first
    text = "\n".join(line for line in text.splitlines() if not line.startswith("prbs = "))
    study = str(studies.write(tmp_path, text))
    process = run_apart("identify", study, "--out", str(tmp_path / "out"))
    assert process.returncode == 3
    assert "motion" in process.stdout
    document = json.loads((tmp_path / "out" / "result.json").read_text())
    assert document["parameters"] == []
    assert "motion" in document["reason"]


def test_a_run_without_estimates_is_not_determined(demo: tuple[Path, str], tmp_path: Path) -> None:
    for path in demo[0].glob("*.parquet"):
        (tmp_path / path.name).symlink_to(path.resolve())
    text = (demo[0] / "study.toml").read_text().replace('use = "motion"', 'use = "check"')
    (tmp_path / "study.toml").write_text(text)
    out = tmp_path / "out"
    process = run_here(
        "identify", str(tmp_path / "study.toml"), "--out", str(out), "--stages", "rigid"
    )
    assert process.returncode == 3, process.stderr
    assert "verdict: not-determined (exit code 3)" in process.stdout
    document = json.loads((out / "result.json").read_text())
    assert document["status"] == "not-determined"
    assert {"beta", "rigid_inertia 1"} <= set(document["verdict"]["not_identified"])
    assert document["verdict"]["identified"] == []


def test_inconsistent_channels_exit_with_three(demo: tuple[Path, str], tmp_path: Path) -> None:
    """Accelerations in g: cause and remedy come first; the rigid step uses motor signals."""
    for path in demo[0].glob("*.parquet"):
        (tmp_path / path.name).symlink_to(path.resolve())
    text = (demo[0] / "study.toml").read_text()
    scales = "".join(f'a{j} = {{ column = "a{j}", scale = {1 / 9.80665:.6f} }}\n' for j in (1, 2))
    assert "[channels]" not in text
    (tmp_path / "study.toml").write_text(f"{text}\n[channels]\n{scales}")
    process = run_here("identify", str(tmp_path / "study.toml"), "--out", str(tmp_path / "out"))
    assert process.returncode == 3, process.stderr
    assert "verdict: inconsistent-input (exit code 3)" in process.stdout
    document = json.loads((tmp_path / "out" / "result.json").read_text())
    assert document["status"] == "inconsistent-input"
    suspected = document["verdict"]["suspected"]
    assert {one["code"] for one in suspected} == {"wrong-unit"}
    for one in suspected:
        assert one["factor"] == pytest.approx(1 / 9.80665, rel=0.02)
        assert one["remedy"] in " ".join(process.stdout.split())
    values = {(p["name"], p["joint"]): p["value"] for p in document["parameters"]}
    assert values["beta", None] is not None
    assert all(value is None for (name, _), value in values.items() if "gear" in name)
    page = (tmp_path / "out" / "report.html").read_text()
    assert "Inconsistent input" in page


def test_motion_without_reversal_exits_with_three(tmp_path: Path) -> None:
    """Motion in one direction does not separate Coulomb friction from friction offset."""
    t = 1e-3 * np.arange(12000)
    rate = 40.0 + 20.0 * np.sin(2.0 * t) + 9.0 * np.sin(5.3 * t)
    angle = 40.0 * t - 10.0 * np.cos(2.0 * t) - 9.0 / 5.3 * np.cos(5.3 * t)
    acceleration = 40.0 * np.cos(2.0 * t) + 9.0 * 5.3 * np.cos(5.3 * t)
    columns = {"t": t, "theta_m1": angle, "torque1": 0.02 * acceleration + 0.01 * rate + 0.3}
    study = '[arm]\nkind = "single-joint"\n[[joint]]\nspring = "rigid"\ngear_ratio = 1.0\n'
    study += (
        '[[experiment]]\nname = "m"\nfile = "motion.csv"\nuse = "motion"\ncontrol = ["servo"]\n'
    )
    path = studies.write(tmp_path, study, studies.csv_text(columns))
    process = run_here("identify", str(path), "--out", str(tmp_path / "out"))
    assert process.returncode == 3, process.stderr
    document = json.loads((tmp_path / "out" / "result.json").read_text())
    values = {p["name"]: p["value"] for p in document["parameters"]}
    assert document["status"] == "partly-determined"
    assert document["verdict"]["identified"] == ["inertia 1", "motor_viscous_friction 1"]
    assert values["inertia"] == pytest.approx(0.02, rel=1e-3)
    assert values["motor_coulomb_friction"] is None
    assert values["friction_offset"] is None
    assert {w["where"] for w in document["warnings"] if w["code"] == "not-identifiable"} == {
        "motor_coulomb_friction of joint 1",
        "friction_offset of joint 1",
    }


def test_simulate_runs_a_study_on_another_arm(demo: tuple[Path, str], tmp_path: Path) -> None:
    values = scara.SOFT.parameters(disks=3)
    document = {"parameters": [{"name": n, "joint": j, "value": v} for (n, j), v in values.items()]}
    (tmp_path / "p.json").write_text(json.dumps(document))
    study = str(demo[0] / "study.toml")
    parameters = ["--parameters", str(tmp_path / "p.json")]
    process = run_here("simulate", study, *parameters, "--out", str(tmp_path / "arm"), "--quiet")
    assert (process.returncode, process.stdout, process.stderr) == (0, "", "")
    simulated = str(tmp_path / "arm" / "study.toml")
    process = run_here("identify", simulated, "--out", str(tmp_path / "r"), "--stages", "rigid")
    assert process.returncode == 0
    result = json.loads((tmp_path / "r" / "result.json").read_text())
    beta = next(p["value"] for p in result["parameters"] if p["name"] == "beta")
    assert beta == pytest.approx(values["beta", None], rel=0.03)


def test_simulate_does_not_overwrite_its_study(tmp_path: Path) -> None:
    study = scara.SOFT.study(tmp_path)
    write_study(study, study.path)
    (tmp_path / "p.json").write_text('{"parameters": []}')
    arguments = ["simulate", str(study.path), "--parameters", str(tmp_path / "p.json")]
    process = run_here(*arguments, "--out", str(tmp_path))
    assert process.returncode == 2
    assert "a directory other than" in process.stderr


def test_excite_needs_assumed_parameters(tmp_path: Path) -> None:
    # the command needs no experiment
    study = replace(scara.SOFT.study(tmp_path, "rigid"), experiments=())
    write_study(study, study.path)
    values = scara.SOFT.parameters(spring="rigid")
    document = {"parameters": [{"name": n, "joint": j, "value": v} for (n, j), v in values.items()]}
    (tmp_path / "p.json").write_text(json.dumps(document))
    out = tmp_path / "designed"
    limits = ["--limit-angle", "1.2,1.0", "--limit-velocity", "180"]
    arguments = ["excite", str(study.path), *limits]
    guess = ["--parameters", str(tmp_path / "p.json")]
    faults = [
        ([*arguments, "--out", str(out)], "approximate parameters"),
        ([*arguments, *guess, "--out", str(tmp_path)], "a directory other than"),
        ([*arguments, *guess, "--out", str(out), "--kind", "noise"], "multisine"),
    ]
    for command, message in faults:
        process = run_here(*command)
        assert process.returncode == 2
        assert message in process.stderr
        assert process.stderr.count("\n") == 1
    assert not out.exists()
    process = run_here(*arguments, *guess, "--out", str(out))
    assert (process.returncode, process.stderr) == (0, "")
    assert "condition number" in process.stdout
    names = {"apply-motion-check.csv", "apply-motion.csv", "excitation.h", "study.toml"}
    names |= {"predicted.json", "trajectory-motion-check.json", "trajectory-motion.json"}
    assert {p.name for p in out.iterdir()} == names


def test_version_help_and_wrong_usage() -> None:
    import strainwave

    assert run_apart("--version").stdout == f"strainwave {strainwave.__version__}\n"
    assert "identify" in run_here("--help").stdout
    for command in ([], ["identify"], ["campaign"]):
        short, long = run_here(*command, "-h"), run_here(*command, "--help")
        assert short.returncode == long.returncode == 0
        assert short.stdout == long.stdout
    for command, hint in (
        (["identfy"], "identify"),
        (["export", "r", "--fromat", "c"], "--format"),
    ):
        wrong = run_here(*command)
        assert wrong.returncode == 2
        assert hint in wrong.stderr
        assert "Traceback" not in wrong.stderr


def test_help_shows_the_unit_or_the_form_of_each_value() -> None:
    root = typer.main.get_command(cli.app)
    commands = getattr(root, "commands")  # noqa: B009 - typer's group has no public type
    assert len(commands) > 10
    plain = [
        f"{name} {option.opts[0]}"
        for name, command in commands.items()
        for option in command.params
        if option.param_type_name == "option" and not option.is_flag and option.metavar is None
    ]
    assert plain == []
    assert "--bandwidth HZ" in run_here("tune", "--help").stdout


def test_the_commands_and_their_texts_have_the_same_options_and_defaults() -> None:
    commands = getattr(typer.main.get_command(cli.app), "commands")  # noqa: B009 - as above
    used = set()
    for name, texts in command_texts().items():
        for option in commands[name].params if name in commands else []:
            key = option.name.replace("_", "-")
            used.add((name, key))
            if key in texts and "value" in texts[key]:
                assert str(option.default) == texts[key]["value"], (name, key)
    own = {(name, key) for name in commands for key in command_texts().get(name, ())}
    assert own <= used


@pytest.mark.parametrize(
    ("words", "expected"), [("strainwave ide", "identify"), ("strainwave identify --se", "--set")]
)
def test_the_shell_completes_commands_and_options(
    words: str, expected: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("_STRAINWAVE_COMPLETE", "complete_bash")
    monkeypatch.setenv("COMP_WORDS", words)
    monkeypatch.setenv("COMP_CWORD", str(len(words.split()) - 1))
    assert run_here().stdout.split() == [expected]


def test_the_exit_code_of_compare_is_four_if_results_differ(tmp_path: Path) -> None:
    rng = np.random.default_rng(5)
    S = compared_results.covariance(rng)
    january, june = (
        str(compared_results.write(compared_results.drawn(rng, S), tmp_path / month))
        for month in ("january", "june")
    )
    worn = compared_results.drawn(rng, S, {"gear_stiffness 1": 0.98})
    november = str(compared_results.write(worn, tmp_path / "november") / "result.json")
    process = run_here("compare", january, june, "--out", str(tmp_path / "same"))
    assert (process.returncode, process.stderr) == (0, "")
    assert "no difference at the level of 5 %" in process.stdout
    assert {p.name for p in (tmp_path / "same").iterdir()} == {"comparison.html", "comparison.json"}
    process = run_here("compare", january, june, november, "--quiet")
    assert (process.returncode, process.stdout, process.stderr) == (4, "", "")


def test_compare_refuses_wrong_arguments(tmp_path: Path) -> None:
    S = compared_results.covariance(np.random.default_rng(5))
    document = compared_results.drawn(np.random.default_rng(0), S)
    one = str(compared_results.write(document, tmp_path / "one"))
    none = str(compared_results.write(document | {"parameters": []}, tmp_path / "none"))
    for arguments, code, message in (
        ((one,), 2, "needs two results"),
        ((one, one, "--level", "5"), 2, "not a probability"),
        ((one, str(tmp_path / "missing")), 2, "does not exist"),
        ((one, none), 3, "no comparison is possible"),
    ):
        process = run_here("compare", *arguments, "--out", str(tmp_path / "out"))
        assert process.returncode == code
        assert message in process.stderr
        assert process.stderr.count("\n") == 1
        assert not (tmp_path / "out").exists()


def test_the_exit_code_of_trend_is_four_if_an_arm_changes(tmp_path: Path) -> None:
    factors = {"arm-1": visited_arms.healthy, "arm-2": visited_arms.softening}
    store = str(visited_arms.fleet(tmp_path / "store", factors, seed=3))
    process = run_here("trend", store, "--out", str(tmp_path / "out"))
    assert (process.returncode, process.stderr) == (4, "")
    assert "1 of 2 arms changes at the level of 1 % per arm: arm-2" in process.stdout
    assert {p.name for p in (tmp_path / "out").iterdir()} == {"trend.html", "trend.json"}
    process = run_here("trend", store, "--arm", "(arm-1)/", "--quiet")
    assert (process.returncode, process.stdout, process.stderr) == (0, "", "")


def test_trend_refuses_wrong_arguments(tmp_path: Path) -> None:
    few = {"arm-1": visited_arms.healthy}
    store = str(visited_arms.fleet(tmp_path / "store", few, visits=3))
    for arguments, code, message in (
        ((str(tmp_path),), 2, "contains no runs"),
        ((store, "--arm", "("), 2, "not a regular expression"),
        ((store, "--covariates", str(tmp_path / "none.csv")), 2, "does not exist"),
        ((store,), 3, "enough visits"),
    ):
        process = run_here("trend", *arguments, "--out", str(tmp_path / "out"))
        assert process.returncode == code, process.stderr
        assert message in process.stderr
        assert process.stderr.count("\n") == 1
        assert not (tmp_path / "out").exists()
