"""Physical parameters from simulated logs of known arms, and from a measured flexible arm."""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from strainwave.domain import Decoupled, RecordModel
from strainwave.domain.arm.base_parameters import link_inertia
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.two_inertia import TwoInertia, anti_resonance, resonance
from strainwave.identification import decoupling, rigid
from strainwave.identification.joint_model import identify_record
from strainwave.io.logs import read_log
from strainwave.io.study import read_study
from strainwave.signals import link_motion as links
from strainwave.signals import motor as signals

WELL_IDENTIFIED = ("motor_inertia", "link_inertia", "gear_stiffness")


@cache
def records_of(folder: Path) -> dict[str, RecordModel]:
    """Models of all frequency records of a lab arm."""
    study = read_study(folder / "study.toml")
    named = {e.name: e for e in study.experiments}
    model = rigid.fit_rigid(
        [signals.prepare_motor_signals(read_log(study, named["motion"]), Arm.of(study.arm))],
        Arm.of(study.arm),
    )
    models = {}
    for experiment in study.experiments:
        if experiment.use == "frequency":
            assert experiment.joint is not None
            link_signals = links.prepare_link_signals(
                read_log(study, experiment), Arm.of(study.arm)
            )
            joint = decoupling.decouple(link_signals, model, Arm.of(study.arm))[
                experiment.joint - 1
            ]
            models[experiment.name] = identify_record(link_signals, joint, model, Arm.of(study.arm))
    return models


def truth_of(folder: Path, decoupled: Decoupled, slope: int = 0) -> TwoInertia:
    """True parameters of the excited joint, with the link inertia in the record's posture."""
    truth = json.loads((folder / "truth.json").read_text())
    parameters, arm = truth["joints"][decoupled.joint - 1], read_study(folder / "study.toml").arm
    row = link_inertia(arm, decoupled.joint, np.array(decoupled.posture))
    return TwoInertia(
        motor_inertia=parameters["motor_inertia"],
        motor_viscous_friction=parameters["motor_viscous_friction"],
        link_inertia=sum(weight * truth[name] for (name, _), weight in row.items()),
        link_viscous_friction=parameters["link_viscous_friction"],
        gear_stiffness=parameters["gear_stiffness"][slope],
        gear_damping=parameters["gear_damping"],
        gear_ratio=0.01,
    )


@pytest.mark.parametrize(
    ("arm", "asked", "given"),
    [("scara-linear-5kg", 0.03, 0.01), ("vertical-linear-0kg", 0.04, 0.015)],
)
def test_linear_arms_come_back(shared_data: Path, arm: str, asked: float, given: float) -> None:
    folder = shared_data / "lab" / arm
    for name, record in records_of(folder).items():
        truth = truth_of(folder, record.signals)
        grey, linear = record.physical, record.transfer
        assert grey is not None, name
        assert linear is not None, name
        for key in WELL_IDENTIFIED:
            true = getattr(truth, key)
            # sensors on both sides of the gear allow less; under gravity, the inertia of motor 2
            # has a standard deviation of 0.9 %
            assert grey.values[key] == pytest.approx(true, rel=given), (name, key)
            assert linear.values[key] == pytest.approx(true, rel=asked), (name, key)
        assert grey.values["gear_damping"] == pytest.approx(truth.gear_damping, rel=0.05), name
        assert linear.values["gear_damping"] == pytest.approx(truth.gear_damping, rel=0.2), name
        for model in (grey, linear):
            assert model.anti_resonance is not None
            assert model.resonance is not None
            low, high = anti_resonance(truth).frequency_hz, resonance(truth).frequency_hz
            assert model.anti_resonance.frequency_hz == pytest.approx(low, rel=0.02), name
            assert model.resonance.frequency_hz == pytest.approx(high, rel=0.02), name


def test_deviations_hold_the_truth(shared_data: Path) -> None:
    """Normalised errors of inertias and stiffness in six linear records: 18 values."""
    normalised = []
    for arm in ("scara-linear-5kg", "vertical-linear-0kg"):
        folder = shared_data / "lab" / arm
        for record in records_of(folder).values():
            truth, model = truth_of(folder, record.signals), record.physical
            assert model is not None
            for key in WELL_IDENTIFIED:
                k = list(model.values).index(key)
                error = model.values[key] - getattr(truth, key)
                normalised.append(error / np.sqrt(model.covariance[k, k]))
    assert np.abs(normalised).max() < 3.0
    assert 0.1 < np.sqrt(np.mean(np.square(normalised))) < 2.0


def test_a_three_slope_gear_lies_between_its_slopes(shared_data: Path) -> None:
    folder = shared_data / "lab" / "scara-strainwave-3kg"
    for name, record in records_of(folder).items():
        soft, stiff = (truth_of(folder, record.signals, slope) for slope in (0, 2))
        for model in (record.physical, record.transfer):
            assert model is not None, name
            for key in ("motor_inertia", "link_inertia"):
                assert model.values[key] == pytest.approx(getattr(soft, key), rel=0.03), name
            assert soft.gear_stiffness < model.values["gear_stiffness"] < stiff.gear_stiffness
            for mode, mode_of in (
                (model.anti_resonance, anti_resonance),
                (model.resonance, resonance),
            ):
                assert mode is not None
                assert (
                    mode_of(soft).frequency_hz < mode.frequency_hz < mode_of(stiff).frequency_hz
                ), name
            assert "equivalent-stiffness" in {w.code for w in model.warnings}
