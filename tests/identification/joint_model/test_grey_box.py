"""Physical parameters of a joint by regression on the equations of motion."""

from __future__ import annotations

from dataclasses import fields, replace
from typing import Any

import numpy as np
import pytest

from elastic_runs import SAMPLE, log_of, prbs_run, rig, rig_values, true_model
from joint_records import Case, case, truth_of
from strainwave.domain import Decoupled, Delay, FloatArray, Joint, JointModel, LinkSignals, Mode
from strainwave.domain.arm.description import unit_of
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.two_inertia import NAMES, anti_resonance, resonance
from strainwave.errors import NotIdentifiable
from strainwave.identification import decoupling
from strainwave.identification.joint_model import (
    PhysicalOptions,
    equations,
    fit_joint,
    grey_box,
    identify_joint,
    rigid_knowledge,
)
from strainwave.identification.joint_model.equations import RigidKnowledge
from strainwave.identification.joint_model.joint_estimate import JointEstimate
from strainwave.numerics import least_squares as ls
from strainwave.signals import link_motion as links

CASES = [(1, 1), (2, 1), (3, 2), (4, 2)]
WELL_IDENTIFIED = [NAMES.index(n) for n in ("motor_inertia", "link_inertia", "gear_stiffness")]


def found_in(one: Case, options: PhysicalOptions | None = None) -> JointModel:
    return identify_joint(one.records, one.model, Arm.of(one.study.arm), options)


def vector_of(model: JointModel) -> FloatArray:
    return np.array([model.values[name] for name in NAMES])


@pytest.fixture(scope="module")
def models() -> list[tuple[Case, JointModel]]:
    return [(case(*which), found_in(case(*which))) for which in CASES]


def test_noisy_records_give_the_joint_back(models: list[tuple[Case, JointModel]]) -> None:
    for joint_case, model in models:
        relative_error = vector_of(model) / joint_case.truth.vector - 1.0
        # the error of the rigid model is 0.1 %, by chance up to three times as large
        assert np.abs(relative_error[WELL_IDENTIFIED]).max() < 0.005
        assert abs(relative_error[NAMES.index("gear_damping")]) < 0.06
        friction = joint_case.values["motor_coulomb_friction", joint_case.decoupled.joint]
        assert model.values["motor_coulomb_friction"] == pytest.approx(friction, rel=0.02)
        total = next(p for p in model.parameters if p.name == "total_viscous_friction")
        expected = (
            joint_case.truth.motor_viscous_friction + 1e-4 * joint_case.truth.link_viscous_friction
        )
        assert total.value == pytest.approx(expected, rel=0.05)
        assert model.status != "implausible"


def test_deviations_are_those_of_the_errors(models: list[tuple[Case, JointModel]]) -> None:
    """The mean square of twelve normalised errors is near one."""
    normalised = []
    for joint_case, model in models:
        std = np.sqrt(np.diag(model.covariance))[: len(NAMES)]
        normalised.append(((vector_of(model) - joint_case.truth.vector) / std)[WELL_IDENTIFIED])
    size = float(np.sqrt(np.mean(np.square(normalised))))
    # errors of the three parameters are correlated: about four are independent
    assert 0.2 < size < 2.0


def test_frequencies_come_with_deviations(models: list[tuple[Case, JointModel]]) -> None:
    for joint_case, model in models:
        assert model.anti_resonance is not None
        assert model.resonance is not None
        for mode, true in (
            (model.anti_resonance, anti_resonance(joint_case.truth)),
            (model.resonance, resonance(joint_case.truth)),
        ):
            assert mode.frequency_hz == pytest.approx(true.frequency_hz, rel=2e-3)
            assert mode.frequency_std_hz is not None
            assert mode.frequency_std_hz < 0.005 * mode.frequency_hz


def test_two_records_at_once_are_no_worse() -> None:
    joint_case = case(1, 1)
    twice = identify_joint(joint_case.records * 2, joint_case.model, Arm.of(joint_case.study.arm))
    once = vector_of(found_in(joint_case))[WELL_IDENTIFIED]
    assert vector_of(twice)[WELL_IDENTIFIED] == pytest.approx(once, rel=1e-3)
    assert twice.experiments == ("prbs", "prbs")


def test_a_record_alone_starts_from_all_and_ends_where_it_would() -> None:
    joint_case = case(*CASES[0])
    ((signals, decoupled),) = joint_case.records
    name = signals.experiment.name
    copy = replace(signals, experiment=replace(signals.experiment, name="again"))
    fit = fit_joint(
        [(signals, decoupled), (copy, decoupled)], joint_case.model, Arm.of(joint_case.study.arm)
    )
    reference = found_in(joint_case)
    for each in (name, "again"):
        record_model = fit.of_record(each)
        assert record_model.experiments == (each,)
        std = np.sqrt(np.diag(reference.covariance))
        assert (
            np.abs((vector_of(record_model) - vector_of(reference)) / std[: len(NAMES)]).max() < 0.1
        )
        np.testing.assert_allclose(np.sqrt(np.diag(record_model.covariance)), std, rtol=0.1)
    single = fit_joint(joint_case.records, joint_case.model, Arm.of(joint_case.study.arm))
    assert single.of_record(name) is single.model


def test_the_rigid_models_errors_are_counted() -> None:
    """The uncertainty of beta enters the interaction torque of joint 2, and so its estimates."""
    joint_case = case(3, 2)
    doubtful = replace(joint_case.model, covariance=25.0 * joint_case.model.covariance)
    certain_fit, uncertain_fit = (
        identify_joint(joint_case.records, model, Arm.of(joint_case.study.arm))
        for model in (joint_case.model, doubtful)
    )
    k = NAMES.index("link_inertia")
    assert uncertain_fit.covariance[k, k] > 4.0 * certain_fit.covariance[k, k]


def test_the_uncertainty_of_a_removed_delay_is_included() -> None:
    """A sensor delay D acts like gear damping k D: the uncertainty of a removed delay is added."""
    record_case = case(1)
    number = record_case.decoupled.joint
    index = NAMES.index("gear_damping")

    def having_removed(value: float) -> JointModel:
        delays = tuple(Delay(value if j == number else 0.0, 3e-5) for j in (1, 2))
        signals = replace(record_case.signals, removed_delay=delays)
        return identify_joint(
            [(signals, record_case.decoupled)], record_case.model, Arm.of(record_case.study.arm)
        )

    reference, none, removed = found_in(record_case), having_removed(0.0), having_removed(1e-3)
    np.testing.assert_array_equal(none.covariance, reference.covariance)
    added = removed.covariance - reference.covariance
    expected = (reference.values["gear_stiffness"] * 3e-5) ** 2
    assert added[index, index] == pytest.approx(expected, rel=1e-9)
    assert np.count_nonzero(added) == 1
    reported = next(p for p in removed.parameters if p.name == "gear_damping")
    assert reported.std == pytest.approx(np.sqrt(removed.covariance[index, index]))


def test_slow_sampling_does_not_bias_the_estimates() -> None:
    """Ideal sensors at 1 kHz; linear interpolation would bias the motor inertia by 1 %."""
    study = rig(counts=None)
    values = rig_values(study)
    run = prbs_run(study, both=True)
    log = log_of(run)
    slow = {name: channel[::4] for name, channel in log.channels.items()}
    signals = links.prepare_link_signals(
        replace(log, time=log.time[::4], sample_time=4.0 * SAMPLE, channels=slow), Arm.of(study.arm)
    )
    model = true_model(study, values)
    decoupled = decoupling.decouple(signals, model, Arm.of(study.arm))[0]
    estimate = vector_of(identify_joint([(signals, decoupled)], model, Arm.of(study.arm)))
    relative_error = estimate / truth_of(values, 1).vector - 1.0
    assert np.abs(relative_error[WELL_IDENTIFIED]).max() < 0.002
    assert abs(relative_error[NAMES.index("gear_damping")]) < 0.01


def test_uncertain_friction_increases_the_standard_deviations(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Uncertain friction at reversals within an encoder count increases standard deviations."""
    joint_case = case(*CASES[0])
    reference = np.sqrt(np.diag(found_in(joint_case).covariance))
    monkeypatch.setattr(equations, "_SIGN_FRICTION_STD", equations._STICTION_STD)
    alike = np.sqrt(np.diag(found_in(joint_case).covariance))
    assert np.all(reference > 0.99 * alike)
    assert np.max(reference / alike) > 1.02


def test_a_band_may_be_set() -> None:
    joint_case = case(1, 1)
    model = found_in(joint_case, PhysicalOptions(band_hz=(5.0, 45.0)))
    assert model.band_hz == (5.0, 45.0)
    assert model.values != found_in(joint_case).values


def test_the_search_may_begin_elsewhere(models: list[tuple[Case, JointModel]]) -> None:
    joint_case, model = models[0]
    restarted = identify_joint(
        joint_case.records,
        joint_case.model,
        Arm.of(joint_case.study.arm),
        search_from_hz=model.band_hz,
    )
    # the bands agree to 5 %, a small part of a standard deviation
    np.testing.assert_allclose(restarted.band_hz, model.band_hz, rtol=0.05)
    difference = np.abs(vector_of(restarted) - vector_of(model))[WELL_IDENTIFIED]
    assert (difference < 0.3 * np.sqrt(np.diag(model.covariance))[WELL_IDENTIFIED]).all()
    assert restarted.values != model.values


def test_the_rigid_models_equations_may_be_left_out() -> None:
    joint_case = case(1, 1)
    with_rigid, without = (
        found_in(joint_case),
        found_in(joint_case, PhysicalOptions(use_rigid=False)),
    )
    weight = np.zeros(len(NAMES) + 1)
    weight[NAMES.index("motor_viscous_friction")] = 1.0
    weight[NAMES.index("link_viscous_friction")] = 1e-4
    variances = [float(weight @ m.covariance @ weight) for m in (with_rigid, without)]
    assert variances[1] > 2.0 * variances[0]


def test_without_a_rigid_model_the_data_speak_alone() -> None:
    joint_case = case(1, 1)
    model = identify_joint(joint_case.records, None, Arm.of(joint_case.study.arm))
    relative_error = vector_of(model) / joint_case.truth.vector - 1.0
    assert np.abs(relative_error[WELL_IDENTIFIED]).max() < 0.01


def test_a_link_without_sensor_is_refused() -> None:
    joint_case = case(1, 1)
    links = tuple(replace(link, source="motor") for link in joint_case.signals.links)
    blind = replace(joint_case.signals, links=links)
    with pytest.raises(NotIdentifiable, match="no sensor"):
        identify_joint(
            [(blind, joint_case.decoupled)], joint_case.model, Arm.of(joint_case.study.arm)
        )


def test_unidentified_and_implausible_values_have_warnings() -> None:
    joint = Joint(spring="three-slope", gear_ratio=0.01)
    values = dict(zip(NAMES, [1e-4, 1e-4, -3.0, 0.5, 2e4, 20.0], strict=True))
    covariance = np.diag([1e-6, 9e-5, 0.1, 0.01, 10.0, 0.1]) ** 2
    reported = (True,) * 5 + (False,)
    mode = Mode(-1.0 + 60.0j, 9.5, 0.02, None, None)
    estimate = JointEstimate(joint, 1, ("x",), values, covariance, reported)
    model = estimate.to_model("grey-box", (mode, mode), (1.0, 30.0), {})
    estimates = {p.name: p.value for p in model.parameters}
    assert estimates["motor_viscous_friction"] is None  # standard deviation 90 %
    assert estimates["link_viscous_friction"] == 0.5  # standard deviation 2 %
    assert estimates["gear_damping"] is None
    assert estimates["link_inertia"] == -3.0
    assert estimates["total_viscous_friction"] == pytest.approx(1.5e-4)
    assert model.status == "implausible"
    codes = {(warning.code, warning.where.split()[0]) for warning in model.warnings}
    assert codes == {
        ("not-identifiable", "motor_viscous_friction"),
        ("not-identifiable", "gear_damping"),
        ("implausible", "link_inertia"),
        ("equivalent-stiffness", "gear_stiffness"),
    }


def test_units() -> None:
    revolute = Joint(spring="linear", gear_ratio=0.01)
    sliding = replace(revolute, motion="prismatic")
    names = ("link_inertia", "motor_coulomb_friction", "gear_stiffness", "gear_damping")
    assert [unit_of(n, revolute) for n in names] == ["kg m^2", "N m", "N m/rad", "N m s/rad"]
    assert [unit_of(n, sliding) for n in names] == ["kg", "N", "N/m", "N s/m"]


def test_friction_in_windows_is_eliminated_as_among_all_unknowns() -> None:
    """Elimination agrees with least squares over the parameters and all friction unknowns."""
    joint_case = case(1, 1)
    signals = [joint_case.signals]
    rigid_values = rigid_knowledge(
        joint_case.model, Arm.of(joint_case.study.arm), joint_case.decoupled.joint, signals
    )
    weighted = grey_box.solve(
        joint_case.records, Arm.of(joint_case.study.arm), rigid_values, (5.0, 45.0)
    ).in_band
    solved, root = weighted.equations, weighted.root
    friction_columns = np.zeros((len(root), len(solved.local_deviation)))
    friction_columns[solved.local[0].rows] = solved.local[0].columns.dense()
    scale = np.linalg.norm(solved.shared * root[:, None], axis=0)
    columns = np.hstack([solved.shared / scale, friction_columns * solved.local_deviation])
    priors = np.eye(columns.shape[1])[len(scale) :]
    target = np.concatenate([solved.target * root, np.zeros(len(priors))])
    solution = np.linalg.lstsq(np.vstack([columns * root[:, None], priors]), target)[0]
    factor = ls.factorise(solved, root)
    assert friction_columns.shape[1] > 100
    np.testing.assert_allclose(factor.value, solution[:7] / scale, rtol=1e-7)
    np.testing.assert_allclose(
        factor.local, solution[7:] * solved.local_deviation, atol=1e-7 * np.abs(solution).max()
    )


def longer(one: Case, times: int) -> tuple[LinkSignals, Decoupled]:
    """Record repeated several times."""
    n = len(one.signals.time)

    def tiled(columns: LinkSignals | Decoupled) -> dict[str, Any]:
        every = {f.name: getattr(columns, f.name) for f in fields(columns)}
        return {
            name: np.concatenate([value] * times)
            for name, value in every.items()
            if isinstance(value, np.ndarray) and len(value) == n
        }

    return (
        replace(one.signals, **tiled(one.signals)),
        replace(one.decoupled, **tiled(one.decoupled)),
    )


def test_work_arrays_grow_with_the_record_and_no_faster() -> None:
    """Size of the equations for records two and four times as long."""
    joint_case = case(1, 1)
    sizes = []
    for times in (2, 4):
        signals, decoupled = longer(joint_case, times)
        piece = equations._piece(signals, decoupled, Arm.of(joint_case.study.arm), (5.0, 45.0))
        assembled = equations._assemble([piece], RigidKnowledge(None, None, None), TRIED)
        local = assembled.local[0].columns
        sizes.append(assembled.shared.size + local.entries.size + local.first.size)
    assert sizes[1] < 2.2 * sizes[0]  # the excluded edges are a larger part of the shorter record


TRIED = np.array([1e-4, 1e-4, 0.05, 3.0, 1.0, 1e-4, 1e-3])
"""Approximate parameters at which the equations are evaluated."""


def test_the_band_of_a_long_record_is_looked_for_in_its_middle(
    monkeypatch: pytest.MonkeyPatch, models: list[tuple[Case, JointModel]]
) -> None:
    joint_case, full_model = models[0]
    n = len(joint_case.signals.time)
    lengths: list[int] = []
    reference = equations._piece

    def counted(signals: LinkSignals, *rest: Any) -> Any:
        lengths.append(len(signals.time))
        return reference(signals, *rest)

    monkeypatch.setattr(equations, "_piece", counted)
    monkeypatch.setattr(grey_box, "_MAX_SEARCH_SAMPLES", 2 * n // 3)
    fit = found_in(joint_case)
    # the complete record is used for the selected band and its neighbours only
    assert lengths.count(2 * n // 3) == len(lengths) - 3 > 0
    std = np.sqrt(np.diag(full_model.covariance))[: len(NAMES)]
    assert np.abs((vector_of(fit) - vector_of(full_model)) / std).max() < 0.2


def test_the_complete_record_is_searched_if_its_middle_gives_another_band(
    monkeypatch: pytest.MonkeyPatch, models: list[tuple[Case, JointModel]]
) -> None:
    joint_case, full_model = models[0]
    n = len(joint_case.signals.time)
    monkeypatch.setattr(grey_box, "_MAX_SEARCH_SAMPLES", n - 1)
    reference = grey_box._search_band

    def misled(records: Any, study: Any, known: Any, search: Any) -> Any:
        if len(records[0][0].time) == n:
            return reference(records, study, known, search)
        return equations.equations_in(records, study, known, (9.0, 18.0))

    monkeypatch.setattr(grey_box, "_search_band", misled)
    fit = found_in(joint_case)
    assert fit.band_hz == full_model.band_hz
    assert fit.values == full_model.values
