"""Arms drawn from a joint covariance: its moments, bounds, bodies, files and refusals."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import exports
from strainwave.domain.arm.base_parameters import base_parameters
from strainwave.domain.arm.consistent_links import is_consistent
from strainwave.domain.keys import Key
from strainwave.errors import InvalidInput, NotIdentifiable
from strainwave.export import IdentifiedArm, completion, export_arm
from strainwave.export.randomisation import drawn_arms
from strainwave.io.joint_covariance import JointCovariance

N_DRAWS = 400


def two_links(folder: Path) -> IdentifiedArm:
    """A two-link arm; alpha and the stiffness of joint 1 are correlated by -0.8."""
    study = exports.two_links(folder)
    arm = exports.arm_of(study, exports.values_of(study))
    std = {p.label: p.std or 0.0 for p in arm.parameters}
    names = ("alpha", "gear_stiffness 1")
    correlation = np.array([[1.0, -0.8], [-0.8, 1.0]])
    sizes = np.array([std[name] for name in names])
    matrix = correlation * np.outer(sizes, sizes)
    return replace(arm, covariance=JointCovariance("tuned", names, matrix))


def with_std(arm: IdentifiedArm, key: Key, value: float, std: float) -> IdentifiedArm:
    changed = (replace(p, value=value, std=std) if p.key == key else p for p in arm.parameters)
    return replace(arm, parameters=tuple(changed))


def test_draws_have_the_covariance_of_the_result(tmp_path: Path) -> None:
    """Means within four standard errors; Fisher's z of the correlation within four."""
    arm = two_links(tmp_path)
    draws = drawn_arms(arm, N_DRAWS, seed=3)
    keys: list[Key] = [("alpha", None), ("gear_stiffness", 1), ("gear_damping", 2)]
    parameters = {p.key: p for p in arm.parameters}
    mean = np.array([parameters[key].value for key in keys], dtype=float)
    std = np.array([parameters[key].std for key in keys], dtype=float)
    normalised = (np.array([[d.identified[key] for key in keys] for d in draws]) - mean) / std
    assert np.abs(normalised.mean(axis=0)).max() < 4.0 / np.sqrt(N_DRAWS)
    assert np.abs(normalised.std(axis=0) - 1.0).max() < 4.0 / np.sqrt(2.0 * N_DRAWS)
    z = np.arctanh(np.corrcoef(normalised.T)[np.triu_indices(3, 1)])
    assert np.abs(z - np.arctanh([-0.8, 0.0, 0.0])).max() < 4.0 / np.sqrt(N_DRAWS - 3)


def test_the_seed_determines_the_draws(tmp_path: Path) -> None:
    arm = two_links(tmp_path)
    first, again, other = (drawn_arms(arm, 2, seed) for seed in (1, 1, 2))
    assert [d.identified for d in first] == [d.identified for d in again]
    assert first[0].identified != other[0].identified
    assert first[0].identified != first[1].identified


def test_a_value_at_its_bound_has_the_one_sided_interval(tmp_path: Path) -> None:
    arm = with_std(two_links(tmp_path), ("gear_damping", 1), 0.0, 0.5)
    drawn = [d.identified["gear_damping", 1] for d in drawn_arms(arm, N_DRAWS)]
    assert min(drawn) >= 0.0
    # 95 % are below 1.96 std; four standard errors of a share
    share = np.mean(np.array(drawn) < 1.96 * 0.5)
    assert abs(share - 0.95) < 4.0 * np.sqrt(0.95 * 0.05 / N_DRAWS)


def test_links_of_a_chain_are_bodies_with_the_drawn_base_parameters(tmp_path: Path) -> None:
    study, values = exports.chain(tmp_path, springs=("linear", "rigid", "linear"))
    base = base_parameters(study.arm)
    arm = exports.arm_of(study, values)
    keys = list(base.links)
    motors: list[Key] = [("motor_inertia", i) for i in (1, 2, 3)]
    of_parts = np.array([arm.standard[key] for key in (*keys, *motors)])
    estimates = base.rows @ of_parts
    std = 0.02 * np.abs(estimates) + 1e-4
    known = {p.key for p in arm.parameters}
    template = arm.parameters[0]
    added = tuple(
        replace(template, name=column.key[0], joint=column.key[1], value=value, std=s, ci95=None)
        for column, value, s in zip(base.columns, estimates.tolist(), std.tolist(), strict=True)
        if column.key not in known
    )
    arm = replace(arm, parameters=(*arm.parameters, *added))
    added_keys = [p.key for p in added]
    rows = base.rows[[column.key in added_keys for column in base.columns]]
    for drawn in drawn_arms(arm, 10, seed=4):
        links = completion.standard_links(drawn, 9.81)
        assert all(map(is_consistent, links))
        parts = np.array([drawn.standard[key] for key in (*keys, *motors)])
        wanted = np.array([drawn.identified[key] for key in added_keys])
        before = np.array([arm.identified[key] for key in added_keys])
        errors = (rows @ parts - wanted) / np.array([p.std for p in added])
        assert np.abs(errors).max() < 0.1
        assert np.abs(wanted - before).max() > 0.0


def test_the_files_of_randomised_exports(tmp_path: Path) -> None:
    arm = two_links(tmp_path)
    out = tmp_path / "new" / "arm.json"
    export_arm(arm, out, randomise=2, seed=5)
    names = {"arm.json", "arm-1.json", "arm-2.json", "arm.randomisation.json"}
    assert {path.name for path in out.parent.iterdir()} == names
    document = json.loads((out.parent / "arm.randomisation.json").read_text())
    labels = [(p["name"], p["joint"]) for p in document["parameters"]]
    factor = np.array(document["factor"])
    assert arm.covariance is not None
    assert np.allclose((factor @ factor.T)[:2, :2], arm.covariance.matrix, rtol=1e-9)
    assert np.allclose(factor, np.tril(factor))
    for name, values in zip(document["files"], document["draws"], strict=True):
        exported = json.loads((out.parent / name).read_text())["values"]
        at = labels.index(("gear_stiffness", 1))
        assert exported["gear_stiffness_1"] == values[at] != arm.identified["gear_stiffness", 1]
    assert np.array(document["links"]).shape == (2, 2, 10)


def test_results_without_intervals_or_bodies_are_refused(tmp_path: Path) -> None:
    arm = two_links(tmp_path)
    exact = replace(arm, parameters=tuple(replace(p, std=None) for p in arm.parameters))
    with pytest.raises(NotIdentifiable, match="no standard deviations"):
        drawn_arms(replace(exact, covariance=None), 1)
    # gamma^2 exceeds alpha beta in nearly every draw
    wide = with_std(arm, ("gamma", None), arm.identified["gamma", None], 1e3)
    with pytest.raises(NotIdentifiable, match="are arms"):
        drawn_arms(wide, 20)
    with pytest.raises(InvalidInput, match="-1"):
        export_arm(arm, tmp_path / "arm.xml", randomise=-1)
