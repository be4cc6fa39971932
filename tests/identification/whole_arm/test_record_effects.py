"""Effects that the core does not know: found where records have them, left out where they do not."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from record_effect_runs import AMPLITUDES, CHANGES, Runs, fitted, runs
from strainwave.domain import ArmModel, EffectName
from strainwave.domain.effects import RecordEffect, all_effects, effect_named
from strainwave.domain.gear_laws import STIFFNESS
from strainwave.domain.parameter_table import base_name, of_record
from strainwave.domain.parameters import Values
from strainwave.dynamics.arm import Arm
from strainwave.identification.whole_arm.effects import idle, sizes_of, with_effects, without
from strainwave.identification.whole_arm.parametrisation import COULOMB, Key, ParameterSpace, Prior
from strainwave.identification.whole_arm.preparation import dataset_of

PRIMARY = ("motor_inertia", STIFFNESS, "gear_damping")
OF_RECORDS = [effect.name for effect in all_effects() if isinstance(effect, RecordEffect)]


@cache
def drawn(name: EffectName) -> tuple[Runs, Values]:
    """Records with an effect of joint 1, and its sizes."""
    if name == "friction-by-record":
        found = runs((COULOMB, 1))
        changes = dict(zip(AMPLITUDES, CHANGES, strict=True))
        sizes: Values = {}
        for log in found.logs:
            assert log.experiment.prbs is not None
            change = changes[log.experiment.prbs.amplitude]
            sizes[of_record("friction_change", log.name), 1] = change
        return found, sizes
    raise AssertionError(name)


@cache
def model(name: EffectName, *, named: bool) -> ArmModel:
    return fitted(drawn(name)[0], (name,) if named else ())


@cache
def model_without(name: EffectName | None = None) -> ArmModel:
    return fitted(runs(), (name,) if name else ())


@pytest.mark.parametrize("name", OF_RECORDS)
def test_an_effect_that_the_model_lacks_is_named_first(name: EffectName) -> None:
    found = model(name, named=False)
    assert found.criticism is not None
    first = found.criticism.score_tests[0]
    assert (first.joint, first.effect, first.evident) == (1, name, True)
    assert not any(one.evident for one in found.criticism.score_tests[1:])
    likely = [w.code for w in found.warnings if w.code.endswith("-likely")]
    assert likely == [effect_named(name).warning_code]


@pytest.mark.parametrize("name", OF_RECORDS)
def test_an_effect_that_the_study_names_is_found_and_mends_the_others(name: EffectName) -> None:
    found, (records, sizes) = model(name, named=True), drawn(name)
    assert found.status == "converged"
    assert list(sizes_of((1, name), records.names)) == list(sizes)
    reported = {(p.name, p.joint): p for p in found.parameters}
    for key, true in sizes.items():
        parameter = reported[key]
        assert parameter.value is not None
        assert parameter.std is not None
        assert abs(parameter.value - true) < 4.0 * parameter.std, key
        assert parameter.value == pytest.approx(true, rel=0.1), key
    for other in (*PRIMARY, COULOMB):
        assert found.values[other, 1] == pytest.approx(records.known[other, 1], rel=0.005), other
    assert not [w for w in found.warnings if w.code in ("only-together", "effect-left-out")]


@pytest.mark.parametrize("name", OF_RECORDS)
def test_records_without_an_effect_show_none(name: EffectName) -> None:
    plain, asked = model_without(), model_without(name)
    assert plain.criticism is not None
    assert not any(one.evident for one in plain.criticism.score_tests)
    assert not any(w.code.endswith("-likely") for w in plain.warnings)
    assert [w.message.split()[0] for w in asked.warnings if w.code == "effect-left-out"] == [name]
    assert asked.values == plain.values


@pytest.mark.parametrize("moving", [False, True])
@pytest.mark.parametrize("name", OF_RECORDS)
def test_derivatives_are_those_of_differences(name: EffectName, moving: bool) -> None:
    records, sizes = drawn(name)
    arm = records.study.arm
    joints = (replace(arm.joints[0], effects=(name,)), arm.joints[1])
    whole = Arm.of(replace(arm, joints=joints))
    record = replace(dataset_of(records.logs[0], whole, 80.0), moving=moving)
    values, local = records.known | sizes, record.start()
    keys: list[Key] = [*sizes, (COULOMB, 1), ("motor_inertia", 1)]
    _, tangent = record.linearised(values, local, keys)
    assert tangent.shape[2] == len(keys) + len(local)
    for k, key in enumerate(keys):
        if base_name(key[0]) != key[0] and not key[0].endswith(f"[{record.log.name}]"):
            assert not tangent[..., k].any()
            continue
        step = 1e-5 * max(abs(values[key]), 1e-3)
        ends = [
            record.linearised(values | {key: values[key] + s}, local, ())[0] for s in (step, -step)
        ]
        slope = (ends[0] - ends[1]) / (2.0 * step)
        # rounding in a difference of two runs, and the instants of friction's events
        assert np.linalg.norm(tangent[..., k] - slope) < 2e-3 * np.linalg.norm(slope), key


def test_the_unknowns_of_records_have_a_prior_and_go_together() -> None:
    arm = Arm.of(
        replace(
            runs().study.arm,
            joints=tuple(
                replace(j, effects=("friction-by-record",)) for j in runs().study.arm.joints
            ),
        )
    )
    empty = ParameterSpace((), {}, Prior(np.zeros((0, 0)), np.zeros(0), np.zeros((0, 0))))
    values: Values = {
        (name, j): v for j in (1, 2) for name, v in ((COULOMB, 0.05), (STIFFNESS, 2e4))
    }
    space, z = with_effects(empty, arm, values, [30.0, 8.0], ["slow", "fast"])
    changes = ["friction_change[slow]", "friction_change[fast]"]
    assert space.keys == [(name, j) for j in (1, 2) for name in changes]
    np.testing.assert_array_equal(space.parameters(z), np.zeros(4))
    z[2:] = 1.0
    slope, residual = space.beforehand(z)
    std = effect_named("friction-by-record").prior_std
    assert std is not None
    np.testing.assert_allclose(slope, space.slope(z) / std)
    np.testing.assert_allclose(residual, space.parameters(z) / std)
    sure = 1e-4 * np.eye(4)
    assert list(idle(space, z, sure)) == [(1, "friction-by-record")]
    assert without(space, {(1, "friction-by-record")}).keys == space.keys[2:]
    assert without(space, {(1, "friction-by-record")}).own_prior[0].shape == (2, 2)


def test_friction_in_a_record_that_has_no_size_is_the_joint_s() -> None:
    records, _ = drawn("friction-by-record")
    arm = records.study.arm
    joints = (replace(arm.joints[0], effects=("friction-by-record",)), arm.joints[1])
    record = dataset_of(records.logs[0], Arm.of(replace(arm, joints=joints)), 80.0)
    plain = dataset_of(records.logs[0], Arm.of(arm), 80.0)
    runs_of = [one.run(records.known, one.start(), one.quantities()) for one in (record, plain)]
    for name, run in runs_of[0].items():
        np.testing.assert_array_equal(run, runs_of[1][name])
