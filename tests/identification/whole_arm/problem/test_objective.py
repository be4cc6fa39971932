"""Objective of the whole-arm fit: derivatives, nuisance parameters of records, and weights."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import lfilter

from dask_processes import dask
from strainwave.domain import FloatArray
from strainwave.dynamics.arm import Arm
from strainwave.identification.whole_arm.inference.covariance import confidence_at
from strainwave.identification.whole_arm.problem import objective as objective_module
from strainwave.identification.whole_arm.problem.objective import (
    BLOCKS_PER_RECORD,
    Objective,
    costs_of,
)
from strainwave.identification.whole_arm.problem.parameter_space import ParameterSpace, Prior
from strainwave.identification.whole_arm.problem.starting_values import (
    add_settling_unknowns,
    add_stiffness_curves,
    space_of,
)
from strainwave.identification.whole_arm.problem.weighted_rows import Rows, Weights
from strainwave.identification.whole_arm.records.dataset import Dataset
from strainwave.identification.whole_arm.records.preparation import dataset_of
from strainwave.identification.whole_arm.search import Fit
from strainwave.identification.whole_arm.selection.candidate import held_out_scores
from strainwave.numerics.dask_cluster import Cluster, ClusterLost, connected
from strainwave.numerics.parallel import limited, one_blas_thread
from tuning_runs import (
    beginning,
    joint_models,
    later,
    linear_record,
    linear_search,
    rigid_model,
    shaken,
    simulated,
)

CUTOFF = 80.0
FACTORS = np.random.default_rng(0).choice([-1.0, 1.0], size=(2, 6))


SETTLING = (2e-4, 1.5e-4)


@cache
def rig(spring: str) -> tuple[ParameterSpace, tuple[Dataset, ...], FloatArray]:
    """Parameter space, two records of which one starts in motion, and the true coordinates."""
    study, true_values, (first, second) = shaken(spring, settling=SETTLING)
    space = space_of(
        rigid_model(study, true_values, 0.01),
        joint_models(study, true_values, 0.05, FACTORS),
        Arm.of(study.arm),
        largest_voltage=[10.0, 10.0],
        floor=0.002,
    )
    if spring == "three-slope":
        space = add_stiffness_curves(space, Arm.of(study.arm), (60.0, 15.0))
    space = add_settling_unknowns(space)
    records = (
        dataset_of(first, Arm.of(study.arm), CUTOFF),
        dataset_of(later(second, 900), Arm.of(study.arm), CUTOFF),
    )
    assert [record.begins_in_motion for record in records] == [False, True]
    return space, records, space.coordinates(true_values)


def cost_of(objective: Objective, z: FloatArray) -> float:
    linearised = objective.linearise(z)
    assert linearised is not None
    return linearised.cost


def factor_of(objective: Objective, z: FloatArray) -> FloatArray:
    linearised = objective.linearise(z)
    assert linearised is not None
    return linearised.factor


def with_records(objective: Objective, *records: Dataset) -> Objective:
    """Objective of other records, with the first weights and new nuisance parameters."""
    fresh = Objective.of(objective.space, records)
    return replace(fresh, weights=objective.weights[: len(records)])


def near_truth(spring: str) -> tuple[Objective, FloatArray]:
    """Objective with estimated weights and true initial states, and coordinates near the truth."""
    space, records, true = rig(spring)
    study, true_values, logs = shaken(spring, settling=SETTLING)
    initial_state = np.concatenate([beginning(study, true_values, logs[1], 900), np.zeros(2)])
    objective = Objective.of(space, records)
    objective.memory.record_parameters[1] = initial_state
    return objective.update_weights(true), true + 5e-4 * np.random.default_rng(1).normal(
        size=len(true)
    )


def scaled_columns(rows: Rows) -> FloatArray:
    """Derivatives in standard deviations, by the record's own unknowns, then by the shared ones."""
    evaluated = rows.evaluated
    shared = evaluated.columns[..., evaluated.n_initial :]
    columns = np.concatenate([evaluated.record_columns, shared], axis=2)
    return np.asarray(columns / rows.stds[:, None])


@pytest.mark.parametrize("spring", ["linear", "three-slope"])
def test_the_gradient_is_that_of_the_cost(spring: str) -> None:
    two_records, z = near_truth(spring)
    # the record from standstill, which has constants only as nuisance parameters
    objective = with_records(two_records, two_records.records[0])
    factor = factor_of(objective, z)
    gradient = 2.0 * factor[:, :-1].T @ factor[:, -1]
    lengths = np.linalg.norm(factor[:, :-1], axis=0)
    for k, length in enumerate(lengths):
        step = np.zeros(len(z))
        step[k] = 0.01 / length  # changes the cost by 0.01 standard deviations
        difference = (cost_of(objective, z + step) - cost_of(objective, z - step)) / (2.0 * step[k])
        tolerance = 0.02 * abs(gradient[k]) + 0.02 * length
        assert abs(difference - gradient[k]) < tolerance, objective.space.unknowns[k]


@pytest.mark.parametrize("moving", [False, True])
@pytest.mark.parametrize("spring", ["linear", "three-slope"])
def test_derivatives_that_are_not_kept_are_computed_again(
    spring: str, monkeypatch: pytest.MonkeyPatch, *, moving: bool
) -> None:
    kept, z = near_truth(spring)
    dropped, _ = near_truth(spring)
    if moving:
        kept, dropped = kept.add_initial_states(0), dropped.add_initial_states(0)

    def results_of(objective: Objective) -> list[FloatArray]:
        fit = Fit.at(objective, z)
        factor = factor_of(objective, z)
        columns = objective.map_rows(z, lambda _, rows: rows.shared_columns)
        errors = [rows.errors for rows in objective.rows(z)]
        return [
            factor.T @ factor,
            *columns,
            *errors,
            *(rows.errors for rows in objective.update_weights(z).rows(z)),
            *(rows.errors for rows in objective.lengthen_steps(z).rows(z)),
            confidence_at(objective, z).combined,
            held_out_scores([fit]),
        ]

    expected = results_of(kept)
    monkeypatch.setattr(objective_module, "_MAX_CACHED_BYTES", 0)
    results = results_of(dropped)
    assert not any(rows.evaluated.is_differentiated for rows in dropped.rows(z))
    for result, one in zip(results, expected, strict=True):
        np.testing.assert_allclose(result, one, rtol=1e-9, atol=1e-9 * np.max(np.abs(one)))


def test_what_is_cached_is_freed_unless_the_next_search_shares_it() -> None:
    objective, z = near_truth("linear")
    cost = cost_of(objective, z)
    reweighted, other = objective.update_weights(z), objective.replace_records(objective.records)

    def has_cached() -> bool:
        return objective.memory.last is not None

    reweighted.free_ended(objective)
    assert has_cached()
    other.free_ended(objective, reweighted)
    assert not has_cached()
    assert cost_of(objective, z) == pytest.approx(cost, rel=1e-6)


@pytest.mark.parametrize("spring", ["linear", "three-slope"])
def test_the_cost_needs_no_derivatives(spring: str) -> None:
    objective, z = near_truth(spring)
    assert objective.cost(z) == pytest.approx(cost_of(objective, z), rel=1e-6)
    prior = replace(
        objective.space,
        unknowns=tuple(replace(one, prior_std=0.1 * one.scale) for one in objective.space.unknowns),
    )
    bound = objective.replace_unknowns(prior)
    assert bound.cost(z) == pytest.approx(cost_of(bound, z), rel=1e-6)


def test_costs_of_several_objectives_are_those_of_each() -> None:
    space, (record, _), z = rig("linear")
    coupling = next(k for k, key in enumerate(space.keys) if key[0] == "gamma")
    objectives = []
    for factor in (0.8, 0.9, 1.0, 1e3):  # the last one is impossible
        unknowns = [
            replace(one, start=factor * one.start, scale=factor * one.scale)
            if k == coupling
            else one
            for k, one in enumerate(space.unknowns)
        ]
        scaled = replace(space, unknowns=tuple(unknowns))
        objectives.append(Objective.of(scaled, [record, record]))
    costs = costs_of(objectives, z)
    alone = [one.cost(z) for one in objectives]
    assert costs[-1] is None
    assert alone[-1] is None
    assert len(set(alone)) == len(alone)
    for found in (costs[:-1], costs_of(objectives[:-1], z)):  # one by one, and at once
        assert found == pytest.approx(alone[:-1], rel=1e-9)


@pytest.mark.parametrize("spring", ["linear", "three-slope"])
def test_rows_are_differences_in_deviations(spring: str) -> None:
    objective, z = near_truth(spring)
    h = 1e-6
    for k, (record, rows) in enumerate(zip(objective.records, objective.rows(z), strict=True)):
        local = objective.memory.record_parameters[k][: len(record.initial_states)]
        for i, parameter in enumerate(objective.space.unknowns):
            step = h * np.eye(len(z))[i]
            up, down = (
                simulated(record, objective.space.values(z + s), local) for s in (step, -step)
            )
            expected = (up - down) / (2.0 * h) / objective.weights[k].stds
            error = np.max(np.abs(scaled_columns(rows)[..., len(rows.step) + i] - expected))
            assert error < 1e-3 * np.max(np.abs(expected)) + 1e-3, parameter


def test_the_least_squares_problem_is_that_of_all_unknowns_together() -> None:
    """The reduced problem has the same decrease and step as the complete problem."""
    weighted, z = near_truth("linear")
    objective = replace(weighted, has_initial_weights=True)
    rows = objective.rows(z)
    factor = factor_of(objective, z)
    n = len(z)
    widths = [len(part.step) for part in rows]
    tables, residuals = [], []
    for k, part in enumerate(rows):
        columns = scaled_columns(part) * part.root[..., None]
        local, shared = np.split(columns.reshape(-1, columns.shape[2]), [widths[k]], axis=1)
        before, after = sum(widths[:k]), sum(widths[k + 1 :])
        parts = [np.zeros((len(local), before)), local, np.zeros((len(local), after)), shared]
        tables.append(np.column_stack(parts))
        residuals.append((part.residual * part.root).ravel())
    prior = objective.space.prior
    slope = prior.rows @ objective.space.slope(z)
    tables.append(np.column_stack([np.zeros((len(slope), sum(widths))), slope]))
    residuals.append(prior.rows @ objective.space.parameters(z) - prior.target)
    A, b = np.concatenate(tables), np.concatenate(residuals)
    scale = np.linalg.norm(A, axis=0)
    complete = np.linalg.lstsq(A / scale, -b)[0] / scale
    R, r = factor[:, :-1], factor[:, -1]
    reduced = np.linalg.lstsq(R / scale[-n:], -r)[0] / scale[-n:]
    std = np.sqrt(np.diag(np.linalg.inv(R.T @ R)))
    np.testing.assert_allclose(reduced / std, complete[-n:] / std, atol=1e-5)
    remaining_cost = float(np.sum((A @ complete + b) ** 2))
    assert np.sum((R @ reduced + r) ** 2) == pytest.approx(remaining_cost, rel=1e-8)


def test_an_added_bias_is_recovered_without_an_increase_of_the_cost() -> None:
    space, (record, _), true = rig("linear")
    names = [channel.channel for channel in record.channels]
    reference = Objective.of(space, [record]).update_weights(true)
    bias = np.zeros(len(names))
    bias[names.index("a1")], bias[names.index("a2")] = 0.7, -1.3
    biased = with_records(reference, replace(record, measured=record.measured + bias))
    constants = biased.rows(true)[0].step - reference.rows(true)[0].step
    np.testing.assert_allclose(constants, [0.7, -1.3], atol=1e-4)
    assert cost_of(biased, true) == pytest.approx(cost_of(reference, true), rel=1e-6)
    # a constant motor velocity is not a nuisance parameter
    bias[0], bias[2:] = 0.5, 0.0
    shifted_velocity = with_records(reference, replace(record, measured=record.measured + bias))
    assert cost_of(shifted_velocity, true) > 1.5 * cost_of(reference, true)


def test_only_where_a_record_begins_in_motion_is_moved() -> None:
    objective, z = near_truth("linear")
    before = [local.copy() for local in objective.memory.record_parameters]
    first = objective.records[1].start()
    objective.memory.record_parameters[1] = np.concatenate([first, np.zeros(2)])
    guessed = objective.evaluate(z)[1].initial_state_problem(objective.weights[1]).cost
    np.testing.assert_array_equal(objective.memory.record_parameters[0], before[0])
    assert np.any(objective.memory.record_parameters[1][:6] != first)
    true = replace(objective, memory=type(objective.memory)(before))
    from_truth = true.evaluate(z)[1].initial_state_problem(objective.weights[1]).cost
    assert guessed <= 1.05 * from_truth  # friction events cause several local minima


@pytest.mark.parametrize(("joint", "first"), [(1, 900), (1, 300), (1, 400), (2, 400), (2, 900)])
def test_initial_states_of_a_moving_record_are_recovered(joint: int, first: int) -> None:
    """The initial state converges from unloaded gears to the true state."""
    space, _, true = rig("linear")
    study, true_values, logs = shaken("linear", settling=SETTLING)
    record = dataset_of(later(logs[joint - 1], first), Arm.of(study.arm), CUTOFF)
    objective = Objective.of(space, [record])
    objective.rows(true)
    initial_state, estimate = (
        beginning(study, true_values, logs[joint - 1], first),
        objective.memory.record_parameters[0][:6],
    )

    def off(local: FloatArray) -> FloatArray:
        error = simulated(record, space.values(true), local) - record.measured
        return np.asarray(np.std(error, axis=0) / np.std(record.measured, axis=0))

    assert np.all(off(estimate) < 0.02)
    assert np.linalg.norm(off(estimate)) < 0.1 * np.linalg.norm(off(record.start()))
    # the initial motor velocity also accounts for the torque before the record
    assert np.all(np.abs(estimate - initial_state)[2:4] < 1e-3)


def test_where_there_is_no_arm_there_is_no_problem() -> None:
    space, records, true = rig("linear")
    z = true.copy()
    z[space.keys.index(("alpha", None))] = -np.log(3.0)
    z[space.keys.index(("beta", None))] = np.log(3.0)
    z[space.keys.index(("gamma", None))] = np.log(3.0)
    objective = Objective.of(space, records)
    assert np.isfinite(cost_of(objective, true))
    values = space.values(z)
    # the inertia matrix of the links is not positive definite
    ratio = values["gamma", None] ** 2 / (values["alpha", None] * values["beta", None])
    assert ratio > 1.0
    assert objective.linearise(z) is None


# Tests without an arm: channels that are linear in three unknowns.

WHITE = 0.05


def coloured(
    rng: np.random.Generator, shape: tuple[int, ...], pole: float = 0.0, size: float = WHITE
) -> FloatArray:
    """First-order noise with a given standard deviation along the first axis."""
    white = rng.normal(0.0, size * np.sqrt(1.0 - pole**2), (shape[0] + 200, *shape[1:]))
    return np.asarray(lfilter([1.0], [1.0, -pole], white, axis=0)[200:])


TRUTH = np.array([1.0, -2.0, 0.5])


def linear_residual(
    errors: Sequence[FloatArray], *, noise: float = 1e-6, prior: Prior | None = None
) -> Objective:
    rng = np.random.default_rng(7)
    records = []
    for error in errors:
        table = rng.normal(size=(*error.shape, 3))
        records.append(linear_record(table, table @ TRUTH + error, noise=noise))
    return Objective.of(linear_search(3, prior), records)


def test_deviations_and_repetitions_are_those_of_the_errors() -> None:
    rng = np.random.default_rng(2)
    errors = [
        coloured(rng, (4000, 2)) * np.array([1.0, 10.0]),
        coloured(rng, (4000, 2), 0.8),
    ]
    objective = linear_residual(errors).update_weights(TRUTH)
    np.testing.assert_allclose(objective.weights[0].stds, [WHITE, 10.0 * WHITE], rtol=0.06)
    np.testing.assert_allclose(objective.weights[1].stds, WHITE, rtol=0.15)
    np.testing.assert_allclose(objective.weights[0].rows_per_error, 1.0, atol=0.2)
    # (1 + a) / (1 - a); the sum ends at the first negative correlation
    np.testing.assert_allclose(objective.weights[1].rows_per_error, 9.0, rtol=0.35)


def test_no_model_is_better_than_its_sensors() -> None:
    errors = [1e-9 * np.random.default_rng(3).normal(size=(500, 1))]
    signal_std = float(np.std(linear_residual(errors).records[0].measured))
    exact = linear_residual(errors, noise=1e-12).update_weights(TRUTH)
    np.testing.assert_allclose(exact.weights[0].stds, 1e-3 * signal_std)
    noisy = linear_residual(errors, noise=0.3).update_weights(TRUTH)
    np.testing.assert_allclose(noisy.weights[0].stds, 0.3)


def test_repeated_rows_count_once() -> None:
    errors = [coloured(np.random.default_rng(4), (600, 2))]
    std = np.array([0.1, 0.1])
    objective = replace(linear_residual(errors), weights=(Weights(std, np.ones(2)),))
    for repeats in (1.0, 6.0):
        thinned = replace(objective, weights=(Weights(std, np.full(2, repeats)),))
        z = TRUTH + 0.02
        assert cost_of(thinned, z) == pytest.approx(cost_of(objective, z) / repeats)
        products = [factor_of(m, z) for m in (thinned, objective)]
        np.testing.assert_allclose(
            products[0].T @ products[0], products[1].T @ products[1] / repeats, rtol=1e-9
        )


def test_the_loss_is_soft() -> None:
    """Robust loss: the square of small residuals, twice the magnitude of large ones."""
    table = np.ones((1, 1, 1))
    for residual, loss in [(1e-3, 1e-6), (1.0, 2.0 * (np.sqrt(2.0) - 1.0)), (1e4, 2e4 - 2.0)]:
        record = linear_record(table, np.zeros((1, 1)))
        objective = Objective.of(linear_search(1), [record])
        objective = replace(objective, weights=(Weights(np.ones(1), np.ones(1)),))
        z = np.array([residual])
        assert cost_of(objective, z) == pytest.approx(loss, rel=1e-3)
        rows = objective.rows(z)[0]
        slope = 2.0 * float((rows.root**2 * rows.residual)[0, 0])
        h = 1e-4 * residual
        difference = (cost_of(objective, z + h) - cost_of(objective, z - h)) / (2.0 * h)
        assert slope == pytest.approx(difference, rel=1e-4)


def test_outliers_have_little_say() -> None:
    rng = np.random.default_rng(5)
    error = coloured(rng, (800, 1))
    with_outliers = error.copy()
    with_outliers[::40] += 100.0 * WHITE
    objective = linear_residual([with_outliers])
    steps = []
    for z in (TRUTH,) * 2:
        objective = objective.update_weights(z)
        R = factor_of(objective, z)
        steps.append(np.linalg.lstsq(R[:, :-1], -R[:, -1])[0])
    # the error of least squares would be about 100 WHITE sqrt(20) / 800
    assert np.max(np.abs(steps[-1])) < 3.0 * WHITE / np.sqrt(800.0)


def test_the_prior_is_part_of_the_cost() -> None:
    prior = Prior(np.array([[0.0, 20.0, 0.0]]), np.array([-30.0]), np.eye(1))
    errors = [coloured(np.random.default_rng(6), (300, 1))]
    without_prior, with_prior = linear_residual(errors), linear_residual(errors, prior=prior)
    z = TRUTH + np.array([0.1, 0.2, -0.1])
    added = (20.0 * z[1] + 30.0) ** 2
    assert cost_of(with_prior, z) - cost_of(without_prior, z) == pytest.approx(added)
    first, second = (factor_of(m, z) for m in (with_prior, without_prior))
    difference = first.T @ first - second.T @ second
    row = np.array([0.0, 20.0, 0.0, 20.0 * z[1] + 30.0])
    np.testing.assert_allclose(
        difference, np.outer(row, row), atol=1e-8 * np.max(np.abs(difference))
    )


def test_stretches_are_counted_through_all_records() -> None:
    errors = [np.zeros((n, 1)) for n in (100, 57)]
    blocks = linear_residual(errors).blocks()
    assert [len(block) for block in blocks] == [100, 57]
    labels = np.concatenate(blocks)
    assert np.all(np.diff(labels) >= 0)
    assert sorted(set(labels.tolist())) == list(range(2 * BLOCKS_PER_RECORD))
    counts = np.bincount(labels)
    assert set(counts[:BLOCKS_PER_RECORD]) == {10}
    assert set(counts[BLOCKS_PER_RECORD:]) == {5, 6}


def test_other_unknowns_leave_records_and_weights() -> None:
    errors = [coloured(np.random.default_rng(9), (300, 1))]
    objective = linear_residual(errors).update_weights(TRUTH)
    with_fixed_parameter = objective.replace_unknowns(
        objective.space.fix_values({("p2", None): 0.5})
    )
    assert with_fixed_parameter.weights == objective.weights
    assert factor_of(with_fixed_parameter, TRUTH[:2]).shape == (3, 3)
    # the copy has its own nuisance parameters
    assert with_fixed_parameter.memory.record_parameters is not objective.memory.record_parameters
    np.testing.assert_array_equal(
        with_fixed_parameter.memory.record_parameters, objective.memory.record_parameters
    )


def test_known_weights_predict_how_the_cost_bends() -> None:
    """R'R is half the second derivative of the cost; guessed weights give larger values."""
    rng = np.random.default_rng(4)
    table, errors = rng.normal(size=(4000, 1, 2)), rng.normal(size=(4000, 1))
    record = linear_record(table, table @ np.array([1.0, -2.0]) + errors)
    z = np.array([1.0, -2.0])
    weighted = Objective.of(linear_search(2), [record]).update_weights(z)
    std, repeats = weighted.weights[0].stds[0], weighted.weights[0].rows_per_error[0]
    slope = table[:, 0] / std
    curvature = (1.0 + (errors / std) ** 2) ** -1.5 / repeats
    second = slope.T @ (curvature * slope)
    predicted = factor_of(weighted, z)[:, :-1]
    np.testing.assert_allclose(predicted.T @ predicted, second, atol=0.05 * np.max(second))
    guess = factor_of(replace(weighted, has_initial_weights=True), z)[:, :-1]
    assert np.all(np.diag(guess.T @ guess) > 1.3 * np.diag(second))


def test_the_integrator_step_error_is_corrected() -> None:
    """The correction is exact at its point, accurate nearby, and independent of repetition."""
    two_records, z = near_truth("three-slope")
    objective = with_records(two_records, two_records.records[0])
    record = objective.records[0]
    short = replace(record, max_time_step=1.0 / (120.0 * record.cutoff_hz))

    def left(of: Objective, at: FloatArray) -> FloatArray:
        exact = simulated(short, objective.space.values(at), np.zeros(0)) - record.measured
        return np.asarray(of.evaluate(at)[0].difference - exact)

    once = objective.correct_step_error(z)
    twice = once.correct_step_error(z)
    before = np.std(left(objective, z), axis=0)
    for corrected in (once, twice):
        np.testing.assert_allclose(left(corrected, z), 0.0, atol=1e-9 * np.max(record.measured))
        # stored simulations equal new ones
        without_memory = replace(
            corrected, memory=Objective.of(objective.space, objective.records).memory
        )
        np.testing.assert_allclose(
            without_memory.evaluate(z)[0].difference, corrected.evaluate(z)[0].difference, atol=1e-9
        )
    nearby = z + 1e-4
    assert np.all(np.std(left(once, nearby), axis=0) < 0.3 * before)


def evaluated_at(objective: Objective, z: FloatArray) -> list[FloatArray]:
    """Costs, factors, residuals and record parameters of evaluations near z."""
    numbers = []
    for point in (z, z + 1e-3):
        linearised = objective.linearise(point)
        assert linearised is not None
        numbers += [np.array([linearised.cost, objective.cost(point)]), linearised.factor]
    numbers += [rows.errors for rows in objective.rows(z + 1e-3)]
    numbers += [rows.errors for rows in objective.rows(z)]  # no longer cached
    corrected = objective.update_weights(z).correct_step_error(z)
    linearised = corrected.linearise(z)
    assert linearised is not None
    numbers += [linearised.factor, *(rows.errors for rows in corrected.rows(z))]
    numbers += [each.difference for each in corrected.evaluate(z + 2e-3)]
    return [*numbers, *objective.memory.record_parameters, *corrected.memory.record_parameters]


def test_a_cluster_gives_the_numbers_of_threads_until_it_is_lost(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One of two workers is killed after the first pass; its records are evaluated again."""
    monkeypatch.setattr(objective_module, "_MAX_CACHED_BYTES", 0)  # every problem is large
    space, records, z = rig("linear")
    assert [record.begins_in_motion for record in records].count(True) == 1
    with one_blas_thread():
        expected = evaluated_at(Objective.of(space, records), z)
        with dask(tmp_path) as it, connected(it.address) as client:
            cluster = Cluster(client)
            with limited(cluster=cluster):
                for _ in range(2):
                    numbers = evaluated_at(Objective.of(space, records), z)
                    assert all(map(np.array_equal, numbers, expected))
                    it.workers[0].kill()
                    it.workers[0].wait()
                it.scheduler.kill()
                with pytest.raises(ClusterLost):
                    Objective.of(space, records).linearise(z)
