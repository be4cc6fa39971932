"""The built-in arms have the base parameters, anti-resonances and gear loads they are chosen for."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import pytest

from reproduction.rig import Rig, equivalent, run_steps
from strainwave.dynamics.two_inertia import anti_resonance
from strainwave.errors import InvalidInput
from strainwave.io.study import read_study
from strainwave.virtual import scara
from strainwave.virtual.experiments import simulate_study


@pytest.mark.parametrize(
    ("disks", "alpha", "beta", "gamma"),
    [(0, 0.997, 0.188, 0.263), (3, 1.365, 0.462, 0.578), (5, 1.610, 0.644, 0.788)],
)
def test_base_parameters_match_the_published_values(
    disks: int, alpha: float, beta: float, gamma: float
) -> None:
    values = scara.STIFF.parameters(disks)
    for name, expected in (("alpha", alpha), ("beta", beta), ("gamma", gamma)):
        assert values[name, None] == pytest.approx(expected, abs=6e-4)  # three decimals published


def test_stiff_arm_has_decoupled_anti_resonances_between_10_and_30_hz() -> None:
    values = scara.STIFF.parameters(5)
    link = values["alpha", None] + values["beta", None] + 2.0 * values["gamma", None]
    for joint, inertia, published in (
        (1, link, (10.3, 13.9)),
        (2, values["beta", None], (13.6, 16.7)),
    ):
        for slope, hz in zip(("k1", "k3"), published, strict=True):
            k = values[f"gear_stiffness_{slope}", joint]
            assert math.sqrt(k / inertia) / (2.0 * math.pi) == pytest.approx(hz, abs=0.06)


@pytest.mark.parametrize("joint", [1, 2])
def test_prbs_and_steps_load_the_soft_gears_beyond_the_last_knee(joint: int) -> None:
    """K_eq / K3 = 1 - 0.8 c / rms torque, with c the offset of the third slope, is 0.9 or more."""
    rig = Rig(0, built_in=scara.SOFT)
    run = rig.prbs(joint, periods=1)
    steps = run_steps(rig.arm, run.values, rig.tuning_steps(joint), joint)
    stiffest = run.values["gear_stiffness_k3", joint]
    assert run.truth.gear_stiffness > 0.9 * stiffest
    stepped = equivalent(rig.arm, run.values, steps, joint)
    assert stepped.gear_stiffness == pytest.approx(run.truth.gear_stiffness, rel=0.05)
    assert 8.0 < anti_resonance(run.truth).frequency_hz < 20.0


def test_joint_2_of_the_soft_arm_hardly_moves_under_the_prbs_of_joint_1() -> None:
    """The source requires a cosine of 0.999 for a constant inertia."""
    run = Rig(0, built_in=scara.SOFT).prbs(1, periods=1)
    assert math.cos(0.02 * max(abs(run.log.channels["theta_m2"]))) > 0.999


def test_experiments_cover_every_use() -> None:
    uses = [experiment.use for experiment in scara.SOFT.study(Path("x")).experiments]
    assert {use: uses.count(use) for use in sorted(set(uses))} == {
        "check": 3,
        "frequency": 2,
        "motion": 1,
        "tuning": 2,
    }


def test_more_than_five_disks_are_rejected() -> None:
    with pytest.raises(InvalidInput, match="0 to 5"):
        scara.SOFT.parameters(6)


def test_logs_with_equal_names_are_written_to_different_files(tmp_path: Path) -> None:
    """Windows and macOS make no difference between capitals and small letters."""
    study = scara.SOFT.study(tmp_path, "rigid")
    first = next(each for each in study.experiments if each.use == "motion")
    files = ("day-1/log.csv", "day-2/log.csv", "day-2/LOG.csv")
    experiments = tuple(
        replace(first, name=f"{k}", file=file, use="motion") for k, file in enumerate(files)
    )
    values = scara.SOFT.parameters()
    simulate_study(replace(study, experiments=experiments), values, tmp_path, as_recorded=False)
    written = [each.file for each in read_study(tmp_path / "study.toml").experiments]
    assert written == ["log.csv", "2-log.csv", "3-LOG.csv"]
    assert sorted(each.name for each in tmp_path.glob("*.csv")) == sorted(written)
