"""[options] of a study and --set: valid options and error messages."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import studies
from command_line import run_here
from strainwave.domain import (
    LinearOptions,
    LinkOptions,
    Options,
    PhysicalOptions,
    Study,
    WholeArmOptions,
)
from strainwave.domain.arm.parameters import whole_arm_parameter_names
from strainwave.domain.study import PUBLISHED_OPTIONS, changed_options
from strainwave.dynamics.arm import Arm
from strainwave.errors import InvalidInput
from strainwave.io.study import AS_PUBLISHED, read_study, with_options, write_study
from tuning_runs import joint_models, rigid_model, truth

INLINE = """
[options]
links = { time_constant = 0.1, order = 1 }
statespace = { method = "n4sid", order = 4, horizon = 25, decimation = 2, filter = "decimation" }
tuning = { as_published = true, ranges = { gear_stiffness = [0.5, 2] }, hold = ["beta"] }
"""
TABLES = """
[options.links]
time_constant = 0.1
order = 1
"""


def with_text(folder: Path, text: str) -> Study:
    return read_study(studies.write(folder, studies.STUDY + text))


def test_tables_of_options_are_read(tmp_path: Path) -> None:
    options = with_text(tmp_path, INLINE).options
    assert options.links == LinkOptions(0.1, 1)
    assert options.statespace == LinearOptions(
        4, method="n4sid", horizon=25, decimation=2, filter="decimation"
    )
    assert options.tuning == WholeArmOptions(
        as_published=True, ranges={"gear_stiffness": (0.5, 2.0)}, hold=("beta",)
    )
    assert options.physical == PhysicalOptions()
    assert with_text(tmp_path, TABLES).options == Options(links=LinkOptions(0.1, 1))


def test_options_have_defaults(tmp_path: Path) -> None:
    options = read_study(studies.write(tmp_path)).options
    assert options == Options()
    assert changed_options(options) == []


def test_options_read_back_as_written(tmp_path: Path) -> None:
    study = with_text(tmp_path, INLINE)
    write_study(study, tmp_path / "again.toml")
    assert read_study(tmp_path / "again.toml").options == study.options


FAULTS = {
    "unknown stage": ("link = { order = 1 }", r"line HERE, \[options\]: .*'link'.*mean 'links'"),
    "unknown key": (
        "links = { ordr = 1 }",
        r"line HERE, \[options.links\]: the key 'ordr' is unknown.*mean 'order'",
    ),
    "no table": ("links = 1", r"line HERE, \[options\]: 'links' is 1.*links = "),
    "out of range": ("links = { order = 3 }", r"line HERE.*'order' is 3, but it should be 1 or 2"),
    "wrong type": ("links = { order = true }", r"'order' is True"),
    "negative": ("links = { time_constant = -1 }", r"'time_constant' is -1.*greater than 0"),
    "not finite": ("tuning = { ranges = { beta = [0.5, inf] } }", r"'ranges' is .*finite number"),
    "no such method": ('statespace = { method = "cva" }', r"'cva', but it should be 'pem'"),
    "band upside down": (
        "statespace = { band_hz = [60.0, 5.0] }",
        r"line HERE, \[options.statespace\]: the band from 60 to 5 Hz is empty",
    ),
    "unknown parameter": (
        'tuning = { hold = ["gear_stifness"] }',
        r"'gear_stifness' is not a parameter.*mean 'gear_stiffness'",
    ),
    "parameter of no joint": (
        "tuning = { ranges = { 'gear_damping 3' = [0.5, 2] } }",
        r"'gear_damping 3' is not a parameter",
    ),
    "range beside the start": (
        "tuning = { ranges = { beta = [1.5, 2] } }",
        r"range of beta, 1.5 to 2 times.*does not contain the starting value",
    ),
    "range of an offset": (
        "tuning = { ranges = { friction_offset = [0.5, 2] } }",
        r"negative.*put it into hold",
    ),
}


@pytest.mark.parametrize(("text", "expected"), FAULTS.values(), ids=FAULTS)
def test_faults_name_file_line_and_key(text: str, expected: str, tmp_path: Path) -> None:
    line = len(studies.STUDY.splitlines()) + 2
    with pytest.raises(InvalidInput, match=expected.replace("line HERE", f"line {line}")) as fault:
        with_text(tmp_path, f"[options]\n{text}\n")
    assert "study.toml" in str(fault.value)
    assert fault.value.remedy


def test_flags_override_the_file(tmp_path: Path) -> None:
    study = with_options(
        with_text(tmp_path, INLINE),
        [
            "links.order=2",
            "statespace.method=moesp",
            'physical.route = "transfer-function"',
            "tuning.ranges={ 'gear_stiffness 2' = [0.9, 1.1] }",
            "tuning.as_published=false",
        ],
    )
    assert study.options.links == LinkOptions(0.1, 2)  # the other key of the file is unchanged
    assert study.options.statespace.method == "moesp"
    assert study.options.physical.route == "transfer-function"
    assert study.options.tuning.ranges == {"gear_stiffness 2": (0.9, 1.1)}
    assert not study.options.tuning.as_published


def test_as_published_gives_way_to_the_file_and_to_flags(tmp_path: Path) -> None:
    text = studies.STUDY.replace('spring = "linear"', 'spring = "three-slope"')
    text += "[options]\nlinks = { time_constant = 0.1 }\nstatespace = { order = 5 }\n"
    study = with_options(
        read_study(studies.write(tmp_path, text)), ["statespace.order=6", AS_PUBLISHED]
    )
    assert study.options == Options(
        links=LinkOptions(0.1, 1),
        statespace=replace(PUBLISHED_OPTIONS.statespace, order=6),
        physical=PhysicalOptions(route="transfer-function"),
        tuning=WholeArmOptions(as_published=True),
    )
    assert [joint.spring for joint in study.arm.joints] == ["linear", "linear"]
    rigid = study.arm.behind_rigid_gears()
    assert with_options(replace(study, arm=rigid), AS_PUBLISHED).arm == rigid


def test_as_published_refuses_other_arms(tmp_path: Path) -> None:
    text = studies.STUDY.replace('"planar-two-link"\nlink_length = 0.35', '"serial"')
    path = studies.write(tmp_path, text)
    with pytest.raises(InvalidInput, match=r"for two-link arms and single joints.*'serial'"):
        with_options(read_study(path), AS_PUBLISHED)
    process = run_here("identify", path, "--as-published", "--out", tmp_path / "out")
    assert process.returncode == 2
    assert process.stderr.count("\n") == 1
    assert not (tmp_path / "out").exists()


FLAG_FAULTS = {
    "no value": ("links.order", r"--set links.order: the option does not have the form"),
    "no stage": ("order=1", r"--set order=1: .* form STAGE.KEY=VALUE"),
    "not TOML": ("links.order=[1", r"--set links.order=\[1: '\[1' is not a TOML value"),
    "unknown stage": ("link.order=1", r"--set link.order=1: .*mean 'links'"),
    "unknown key": ("links.ordre=1", r"--set links.ordre=1: .*mean 'order'"),
    "out of range": ("links.order=3", r"--set links.order=3: 'order' is 3"),
    "unknown parameter": ('tuning.hold=["k"]', r"--set tuning.hold=.*'k' is not a parameter"),
    "two values": ("links.order=1\norder=2", r"more than one value"),
}


@pytest.mark.parametrize(("flag", "expected"), FLAG_FAULTS.values(), ids=FLAG_FAULTS)
def test_faults_of_a_flag_name_the_flag(flag: str, expected: str, tmp_path: Path) -> None:
    study = read_study(studies.write(tmp_path))
    with pytest.raises(InvalidInput, match=expected) as fault:
        with_options(study, [flag])
    assert fault.value.remedy


def test_options_can_be_records_or_tables(tmp_path: Path) -> None:
    study = with_text(tmp_path, INLINE)
    other = Options(links=LinkOptions(0.3))
    assert with_options(study, other).options == other
    changed = with_options(study, {"links": {"order": 2}}).options
    assert changed == replace(study.options, links=LinkOptions(0.1, 2))
    with pytest.raises(InvalidInput, match=r"options.links: the key 'orde' is unknown"):
        with_options(study, {"links": {"orde": 2}})
    with pytest.raises(InvalidInput, match="'k' is not a parameter"):
        with_options(study, Options(tuning=WholeArmOptions(hold=("k",))))


@pytest.mark.parametrize("spring", ["linear", "three-slope"])
def test_options_accept_all_parameters_of_the_fit(spring: str) -> None:
    from strainwave.identification.whole_arm.problem.starting_values import (
        add_stiffness_curves,
        space_of,
    )

    study, known = truth(spring)
    joints = joint_models(study, known, 0.01, np.zeros((2, 6)))
    rigid = rigid_model(study, known, 0.01)
    search = space_of(rigid, joints, Arm.of(study.arm), largest_voltage=[10.0, 10.0], floor=0.01)
    if spring == "three-slope":
        search = add_stiffness_curves(search, Arm.of(study.arm), [60.0, 20.0])
    fitted = {name if joint is None else f"{name} {joint}" for name, joint in search.keys}
    known_to_options = set(whole_arm_parameter_names(study.arm))
    assert fitted <= known_to_options
    everywhere = {name for name, _ in search.keys}
    if spring == "three-slope":  # one name for all slopes
        everywhere |= {"gear_stiffness"} | {f"gear_stiffness {joint}" for joint in (1, 2)}
    assert known_to_options == fitted | everywhere
