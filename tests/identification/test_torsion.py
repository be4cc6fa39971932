"""Stiffness from the torsion between two encoders, on a chain simulated in MuJoCo."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pytest
from benchmarks.studies.drawn_chains import simulate_chain
from benchmarks.studies.slow_motion import slow_chain

from strainwave.domain import FloatArray, Identification, Log, RigidModel, TorsionFit
from strainwave.domain.keys import Values
from strainwave.dynamics.arm import Arm
from strainwave.identification.torsion import fit_torsions
from strainwave.pipeline import identify
from strainwave.report.document import figures_of

SEED, JOINTS = 3, (1, 2)  # a chain with two joints under gravity


@dataclass(frozen=True)
class Case:
    """A result from slow motion, and the true values."""

    result: Identification
    values: Values

    @property
    def model(self) -> RigidModel:
        assert self.result.rigid is not None
        return self.result.rigid

    def fits(self, change: Callable[[Log], Log]) -> dict[int, TorsionFit]:
        """Estimates from changed logs, by joint."""
        logs = [change(log) for log in self.result.logs if log.experiment.use == "motion"]
        found, _ = fit_torsions(logs, self.model, Arm.of(self.result.study.arm), JOINTS)
        return {fit.joint: fit for fit in found}


@pytest.fixture(scope="module")
def case(tmp_path_factory: pytest.TempPathFactory) -> Case:
    folder, chain = tmp_path_factory.mktemp("slow"), slow_chain(SEED, [2, 3, 4])
    assert chain.engine == "mujoco"
    study = replace(chain.study, experiments=chain.study.experiments[:2])
    simulate_chain(replace(chain, study=study), folder, SEED)
    result = identify(folder / "study.toml", stages=("rigid", "decoupled"))
    return Case(result, chain.values)


def replaced(log: Log, joint: int, **channels: FloatArray | None) -> Log:
    """A log with other channels of a joint; None removes a channel."""
    changed = dict(log.channels)
    for name, values in channels.items():
        if values is None:
            changed.pop(f"{name}{joint}", None)
        else:
            changed[f"{name}{joint}"] = values
    return replace(log, channels=changed)


def deflection(log: Log, arm: Arm, joint: int) -> FloatArray:
    """theta_l - n theta_m."""
    n = arm.gear_ratios[joint - 1]
    return np.asarray(log.channels[f"theta_l{joint}"] - n * log.channels[f"theta_m{joint}"])


def test_the_intervals_contain_the_true_stiffness(case: Case) -> None:
    assert [fit.joint for fit in case.result.torsions] == list(JOINTS)
    for fit in case.result.torsions:
        p, true = fit.stiffness, case.values["gear_stiffness", fit.joint]
        assert p.value == pytest.approx(true, rel=2e-3)
        assert p.ci95 is not None
        assert p.ci95[0] < true < p.ci95[1]
        assert p.ci95[1] - p.ci95[0] < 0.01 * true
        assert fit.fit_percent > 95.0


def test_they_are_in_the_final_table_and_in_the_report(case: Case) -> None:
    keys = {("gear_stiffness", joint) for joint in JOINTS}
    assert keys <= set(case.result.verdict.identified)
    names = figures_of(case.result).keys()
    assert all(any(f"gear-joint-{joint}" in name for name in names) for joint in JOINTS), names


def test_a_torsion_sensor_gives_the_same(case: Case) -> None:
    arm = Arm.of(case.result.study.arm)

    def with_sensor(log: Log) -> Log:
        return replaced(log, 1, theta_l=None, deflection=deflection(log, arm, 1))

    (one, _), (other, _) = (
        sorted(case.fits(change).items()) for change in (lambda log: log, with_sensor)
    )
    assert other[1].stiffness.value == pytest.approx(one[1].stiffness.value, rel=1e-9)


def test_zero_and_delay_of_the_link_encoder_do_not_matter(case: Case) -> None:
    expected = case.fits(lambda log: log)[2].stiffness

    def late(log: Log) -> Log:
        angle = log.channels["theta_l2"]
        return replaced(log, 2, theta_l=0.3 + np.interp(log.time - 5e-4, log.time, angle))

    assert case.fits(late)[2].stiffness.value == pytest.approx(expected.value, rel=5e-3)


def test_a_torsion_without_relation_to_the_torque_gives_a_warning(case: Case) -> None:
    arm, random = Arm.of(case.result.study.arm), np.random.default_rng(1)

    def noise(log: Log) -> Log:
        return replaced(log, 2, theta_l=None, deflection=1e-3 * random.normal(size=len(log)))

    logs = [noise(log) for log in case.result.logs if log.experiment.use == "motion"]
    fits, warnings = fit_torsions(logs, case.model, arm, [2])
    assert not fits
    assert [warning.code for warning in warnings] == ["no-torsion"]


def test_joints_without_a_second_encoder_are_left_out(case: Case) -> None:
    assert case.fits(lambda log: replaced(log, 1, theta_l=None)).keys() == {2}
