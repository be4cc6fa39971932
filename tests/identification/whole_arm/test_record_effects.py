"""Effects outside the core: estimated where the records contain them, removed elsewhere."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pytest

from effect_runs import rig
from record_effect_runs import CHANGES, From, Runs, fitted, runs
from strainwave.domain import ArmModel, EffectName, Log, Study
from strainwave.domain.arm.effects import RecordEffect, all_effects, effect_named
from strainwave.domain.arm.gear_laws import STIFFNESS
from strainwave.domain.arm.parameter_table import COULOMB, base_name, of_record
from strainwave.domain.keys import Key, Values
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.simulation import simulate
from strainwave.identification.whole_arm.problem.effect_unknowns import (
    add_effects,
    insignificant_effects,
    named_effects,
    remove_effects,
    sizes_of,
)
from strainwave.identification.whole_arm.problem.parameter_space import ParameterSpace, Prior
from strainwave.identification.whole_arm.problem.starting_values import Loads
from strainwave.identification.whole_arm.records.dataset import Dataset
from strainwave.identification.whole_arm.records.preparation import dataset_of
from strainwave.virtual.experiments import Simulator
from tuning_runs import shaken_study, simulated_logs, truth

PRIMARY = (COULOMB, "motor_inertia", STIFFNESS, "gear_damping")
GAINS = (0.04, -0.01, -0.03)
"""Relative change of the drive gain at each amplitude."""
ZERO = 0.05  # [rad] zero error of an encoder


@dataclass(frozen=True, slots=True)
class Case:
    """Records with one effect of a joint, and records without it."""

    effect: EffectName
    joint: int
    records: Runs
    sizes: Values
    plain: Runs
    by_record: Key | None = None  # parameter that changes by record

    @property
    def asked(self) -> tuple[tuple[EffectName, ...], ...]:
        """Effects to fit, for all joints up to the one of the effect."""
        return *[()] * (self.joint - 1), (self.effect,)

    def record(self) -> Dataset:
        """First record, on an arm with the effect."""
        arm = self.records.study.arm
        joints = list(arm.joints)
        joints[self.joint - 1] = replace(joints[self.joint - 1], effects=(self.effect,))
        return dataset_of(self.records.logs[0], Arm.of(arm.with_joints(joints)), 80.0)


def each(name: str, names: Sequence[str], changes: Sequence[float]) -> Values:
    """Changes in each record; two records have the same amplitude, one for each joint."""
    twice = [change for change in changes for _ in range(2)]
    return {(of_record(name, record), 1): c for record, c in zip(names, twice, strict=True)}


def warmed() -> Case:
    changed = runs((COULOMB, 1))
    sizes = each("friction_change", changed.names, CHANGES)
    return Case("friction-by-record", 1, changed, sizes, runs(), (COULOMB, 1))


def amplified() -> Case:
    gains = each("drive_gain_change", runs().names, GAINS)
    changed = runs().amplified(1, list(gains.values()))
    # a drive without voltage does not determine its gain
    sizes = {key: gain for key, gain in gains.items() if "prbs-j1" in key[0]}
    return Case("drive-gain-by-record", 1, changed, sizes, runs())


def turned(joint: int, *, vertical: bool) -> Case:
    reference = runs(vertical=vertical)
    ratio = reference.study.arm.joints[joint - 1].gear_ratio
    records = reference.beside({f"theta_m{joint}": -ZERO / ratio})
    return Case("encoder-zero", joint, records, {("encoder_zero", joint): ZERO}, reference)


CASES: dict[str, Callable[[], Case]] = {
    "friction": warmed,
    "gain": amplified,
    "zero of joint 2": lambda: turned(2, vertical=False),
    "zero under gravity": lambda: turned(1, vertical=True),
}
EACH = pytest.mark.parametrize("name", CASES)


@cache
def case(name: str) -> Case:
    return CASES[name]()


@cache
def model(name: str, *, named: bool) -> ArmModel:
    return fitted(case(name).records, *(case(name).asked if named else ()))


@cache
def plain(*asked: tuple[EffectName, ...], vertical: bool = False) -> ArmModel:
    return fitted(runs(vertical=vertical), *asked)


def test_every_effect_that_the_core_does_not_know_has_its_records() -> None:
    record_effects = {effect.name for effect in all_effects() if isinstance(effect, RecordEffect)}
    assert {case(name).effect for name in CASES} == record_effects


@EACH
def test_an_effect_that_the_model_lacks_is_named_first(name: str) -> None:
    fit, has = model(name, named=False), case(name)
    assert fit.criticism is not None
    first = fit.criticism.causes[0]
    assert (first.joint, first.effect) == (has.joint, has.effect)
    likely = [w.code for w in fit.warnings if w.code.endswith("-likely")]
    assert likely == [effect_named(has.effect).warning_code]


@EACH
def test_a_named_effect_is_recovered_and_removes_the_bias_of_the_others(name: str) -> None:
    fit, has = model(name, named=True), case(name)
    assert fit.status == "converged"
    size_keys = sizes_of((has.joint, has.effect), has.records.names)
    assert set(has.sizes) <= set(size_keys)
    assert all(
        fit.values[key] == pytest.approx(0.0, abs=1e-6) for key in set(size_keys) - set(has.sizes)
    )
    reported = {(p.name, p.joint): p for p in fit.parameters}
    for key, true in has.sizes.items():
        parameter = reported[key]
        assert parameter.value is not None
        assert parameter.std is not None
        assert abs(parameter.value - true) < 4.0 * parameter.std, key
    values = in_records(fit.values, has)
    for key, true in in_records(has.records.known | has.sizes, has).items():
        assert values[key] == pytest.approx(true, rel=0.1 if key in has.sizes else 0.005), key
    assert not [w for w in fit.warnings if w.code in ("only-together", "effect-left-out")]


def in_records(values: Mapping[Key, float], has: Case) -> Values:
    """Primary parameters and sizes; changes by record are relative to the mean over the records.

    Only the product of a parameter and its change is identifiable.
    """
    values_of_case: Values = {
        (name, joint): values[name, joint] for name in PRIMARY for joint in (1, 2)
    }
    if not has.by_record:
        return values_of_case | {key: values[key] for key in has.sizes}
    zero_change_value = values_of_case.pop(has.by_record)
    products = np.array([zero_change_value * (1.0 + values[key]) for key in has.sizes])
    changes = zip(has.sizes, (products / products.mean() - 1.0).tolist(), strict=True)
    return values_of_case | dict(changes) | {has.by_record: float(products.mean())}


def test_rigid_estimates_refer_to_the_records_of_the_rigid_step() -> None:
    """The Coulomb friction of the rigid step is wrong; its other parameters are correct."""
    has = case("friction")
    wrong = replace(has.records, known={**has.records.known, (COULOMB, 1): 0.045})
    fit = fitted(wrong, *has.asked)
    right = model("friction", named=True)
    for name in PRIMARY[1:]:
        assert fit.values[name, 1] == pytest.approx(right.values[name, 1], rel=1e-3), name
    for key in has.sizes:
        products = [m.values[COULOMB, 1] * (1.0 + m.values[key]) for m in (fit, right)]
        assert products[0] == pytest.approx(products[1], rel=1e-3)
    assert "friction_change[rigid step]" in {p.name for p in fit.parameters}
    assert "stages-disagree" not in {w.code for w in fit.warnings}


@EACH
def test_records_without_an_effect_show_none(name: str) -> None:
    has = case(name)
    vertical = has.plain.study.arm.gravity is not None
    without_it, asked = plain(vertical=vertical), plain(*has.asked, vertical=vertical)
    assert without_it.criticism is not None
    assert without_it.criticism.causes == ()
    assert not any(w.code.endswith("-likely") for w in without_it.warnings)
    left_out = [w.message.split()[0] for w in asked.warnings if w.code == "effect-left-out"]
    assert left_out == [has.effect]
    assert asked.values == without_it.values


@pytest.mark.parametrize("moving", [False, True])
@EACH
def test_derivatives_are_those_of_differences(name: str, *, moving: bool) -> None:
    has = case(name)
    record = replace(has.record(), begins_in_motion=moving)
    values, local = has.records.known | has.sizes, record.start()
    keys: list[Key] = [*has.sizes, (COULOMB, has.joint), ("motor_inertia", has.joint)]
    _, tangent = record.linearise(values, local, keys)
    assert tangent.shape[2] == len(keys) + len(local)
    for k, key in enumerate(keys, start=len(local)):
        if key[0] not in (base_name(key[0]), of_record(base_name(key[0]), record.log.name)):
            assert not tangent[..., k].any()  # belongs to another record
            continue
        step = 1e-5 * max(abs(values[key]), 1e-3)
        ends = [
            record.linearise(values | {key: values[key] + change}, local, ())[0]
            for change in (step, -step)
        ]
        slope = (ends[0] - ends[1]) / (2.0 * step)
        # rounding of the difference, and times of friction events
        assert np.linalg.norm(tangent[..., k] - slope) < 2e-3 * np.linalg.norm(slope), key


def test_a_parameter_without_information_stays_at_its_prior() -> None:
    """The zero of joint 1 of a horizontal arm is not identifiable."""
    model_without, model_with = plain(), plain(("encoder-zero",))
    assert [w.code for w in model_with.warnings] == ["effect-left-out"]
    assert model_with.values == model_without.values


def test_the_unknowns_of_records_have_a_prior_and_go_together() -> None:
    arm = Arm.of(
        replace(
            runs().study.arm,
            joints=tuple(
                replace(j, effects=("friction-by-record",)) for j in runs().study.arm.joints
            ),
        )
    )
    empty = ParameterSpace((), {}, Prior.empty(0))
    values: Values = {
        (name, j): v for j in (1, 2) for name, v in ((COULOMB, 0.05), (STIFFNESS, 2e4))
    }
    loads = Loads(torque=(30.0, 8.0), voltage=(10.0, 10.0))
    space, z = add_effects(empty, named_effects(arm), arm, values, loads, ["slow", "fast"])
    changes = ["friction_change[slow]", "friction_change[fast]"]
    assert space.keys == [(name, j) for j in (1, 2) for name in changes]
    np.testing.assert_array_equal(space.parameters(z), np.zeros(4))
    z[2:] = 1.0
    slope, residual = space.linearise_prior(z)
    std = effect_named("friction-by-record").prior_std
    assert std is not None
    np.testing.assert_allclose(slope, space.slope(z) / std)
    np.testing.assert_allclose(residual, space.parameters(z) / std)
    small_covariance = 1e-4 * np.eye(4)
    assert list(insignificant_effects(space, z, small_covariance)) == [(1, "friction-by-record")]
    assert remove_effects(space, {(1, "friction-by-record")}, arm).keys == space.keys[2:]
    assert remove_effects(space, {(1, "friction-by-record")}, arm).own_prior[0].shape == (2, 2)


def test_friction_in_a_record_that_has_no_size_is_the_joint_s() -> None:
    has = case("friction")
    without_effect = dataset_of(has.records.logs[0], Arm.of(has.records.study.arm), 80.0)
    runs_of = [
        record.run(has.records.known, record.start(), record.quantities())
        for record in (has.record(), without_effect)
    ]
    for name, run in runs_of[0].items():
        np.testing.assert_array_equal(run, runs_of[1][name])


def written(study: Study, values: Values, simulator: Simulator = simulate) -> list[Log]:
    return list(simulated_logs(study, values, simulator=simulator)[1])


def test_virtual_arms_change_from_record_to_record() -> None:
    true_values = truth()[1]
    changes = {("friction_change[prbs-j1]", 1): 0.2, ("friction_change[prbs-j2]", 1): -0.1}
    changed = written(shaken_study(rig(("friction-by-record",)), 8.0), true_values | changes)
    for log, factor in zip(changed, (1.2, 0.9), strict=True):
        reference = shaken_study(rig(()), 8.0)
        alike = written(reference, true_values | {(COULOMB, 1): factor * true_values[COULOMB, 1]})
        (expected,) = (log_of_record for log_of_record in alike if log_of_record.name == log.name)
        for name, samples in log.channels.items():
            np.testing.assert_array_equal(samples, expected.channels[name])


def test_virtual_encoders_have_zeros() -> None:
    true_values, ratio = truth()[1], 0.01
    study = shaken_study(rig(("encoder-zero",)), 8.0)
    changed = written(study, true_values | {("encoder_zero", 1): ZERO})
    posture = From((ZERO, 0.0))
    for log, expected in zip(
        changed, written(shaken_study(rig(()), 8.0), true_values, posture), strict=True
    ):
        for name, samples in log.channels.items():
            turned_by = ZERO / ratio if name == "theta_m1" else 0.0
            np.testing.assert_allclose(samples + turned_by, expected.channels[name], atol=1e-12)


def test_a_second_effect_is_named_in_addition_to_an_effect_by_record() -> None:
    """The change in the records of the rigid step is included once."""
    has = case("friction")
    turned_too = has.records.beside({"theta_m2": -ZERO / 0.01})
    fit = fitted(turned_too, *has.asked)
    likely = [w.where for w in fit.warnings if w.code == "encoder-zero-likely"]
    assert likely == ["joint 2"]
