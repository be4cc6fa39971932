"""Cubic gears: estimated where the records determine them, otherwise linear."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np

from elastic_results import elastic_identification
from extensions import added
from strainwave.domain import ArmModel, FloatArray, Log, Study
from strainwave.domain.arm import gear_laws
from strainwave.domain.arm.gear_laws import CUBIC, STIFFNESS, GearLaw, GearParameter
from strainwave.domain.keys import Values
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.simulation import SensorNoise
from strainwave.identification.whole_arm import fit_whole_arm
from strainwave.report.document import gears
from strainwave.virtual import scara
from strainwave.virtual.experiments import derived
from tuning_runs import joint_models, rigid_model, shaken_study, simulated_logs

STIFFENING = {1: 6e8, 2: 2e8}
"""k_3 [N m/rad^3]: at least a sixth of the linear torque at the largest torsion of the records."""
FACTORS = np.random.default_rng(0).choice([-1.0, 1.0], size=(2, 6))


@cache
def run(cubic: bool, spring: str = "cubic") -> tuple[Values, ArmModel]:
    study, true_values, records = shaken(cubic, spring)
    joints = joint_models(study, true_values, 0.05, FACTORS)
    return true_values, fit_whole_arm(
        records, rigid_model(study, true_values, 0.01, 1.0), joints, Arm.of(study.arm)
    )


def shaken(cubic: bool, spring: str) -> tuple[Study, Values, tuple[Log, ...]]:
    """Open-loop records of 0.5 s, one for each joint."""
    study = scara.STIFF.study(Path("nowhere"), spring)
    values = scara.STIFF.parameters(5, spring)
    values |= {(CUBIC, joint): k if cubic else 0.0 for joint, k in STIFFENING.items()}
    written, logs = simulated_logs(shaken_study(study, 10.0), values, noise=SensorNoise())
    return written, derived(values, study.arm), logs


def test_a_stiffening_gear_is_recovered() -> None:
    true_values, model = run(True)
    assert model.status == "converged"
    estimates = {(p.name, p.joint): p for p in model.parameters}
    for joint in (1, 2):
        for name, tolerance in ((STIFFNESS, 0.005), (CUBIC, 0.1)):
            p, true = estimates[name, joint], true_values[name, joint]
            assert p.value is not None
            assert p.std is not None
            assert abs(p.value / true - 1.0) < tolerance, (name, joint)
            assert abs(p.value - true) < 4.0 * p.std, (name, joint)
        assert estimates[CUBIC, joint].unit == "N m/rad^3"
    assert not [w for w in model.warnings if w.code == "not-reached"]


def test_a_gear_that_does_not_stiffen_is_linear() -> None:
    true_values, model = run(False)
    assert model.status == "converged"
    estimates = {(p.name, p.joint): p for p in model.parameters}
    for joint in (1, 2):
        assert estimates[CUBIC, joint].value is None
        assert model.values[CUBIC, joint] == 0.0
        p, true = estimates[STIFFNESS, joint], true_values[STIFFNESS, joint]
        assert p.value is not None
        assert p.std is not None
        assert abs(p.value - true) < 4.0 * p.std
        assert p.std < 0.002 * true  # as for a linear gear
    warned_places = [w.where for w in model.warnings if w.code == "not-reached"]
    assert warned_places == [f"{CUBIC} of joint {joint}" for joint in (1, 2)]
    assert model.covariance.shape == (len(model.parameters),) * 2


class Hardening(GearLaw):
    """Gear law that is not part of the package, with the minimum of definitions."""

    name = "hardening"
    core_name = "cubic"
    parameters = (GearParameter(STIFFNESS, is_slope=True), GearParameter(CUBIC, by_load=True))
    simpler = "linear"

    def torque(self, values: Mapping[str, float], torsion: FloatArray) -> FloatArray:
        return values[STIFFNESS] * torsion + values[CUBIC] * torsion**3

    def stiffness(self, values: Mapping[str, float], torsion: FloatArray) -> FloatArray:
        return values[STIFFNESS] + 3.0 * values[CUBIC] * torsion**2

    def jacobian(self, values: Mapping[str, float], torsion: FloatArray) -> FloatArray:
        return np.column_stack([torsion, torsion**3])

    def starts(self, stiffness: float, largest_torque: float) -> dict[str, float]:
        return {STIFFNESS: stiffness, CUBIC: 0.2 * stiffness**3 / largest_torque**2}


def test_a_law_from_elsewhere_is_fitted_and_drawn() -> None:
    with added(gear_laws.LAWS, Hardening()):
        true_values, model = run(True, "hardening")
        study = scara.STIFF.study(Path("nowhere"), "hardening")
        result = replace(elastic_identification(), study=study, whole_arm=model)
        curves = gears.stiffness_curves(result)
        estimates = {p.label: p for p in result.parameters}
    assert model.status == "converged"
    assert [curve.law.name for curve in curves] == ["hardening"] * 2
    for joint, curve in enumerate(curves, start=1):
        assert tuple(curve.values) == (STIFFNESS, CUBIC)
        for name in curve.values:
            p = estimates[f"{name} {joint}"]
            assert p.stage == "tuned"
            assert p.value is not None
            assert p.std is not None
            assert abs(p.value - true_values[name, joint]) < 4.0 * p.std
