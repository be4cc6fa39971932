"""Gears from motor responses: impedance, search, and starting values without records."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
from benchmarks.studies.arms import draw_arm
from hypothesis import given
from hypothesis import strategies as st

from serial_chains import parameters_of, random_body
from strainwave.domain import (
    ArmDescription,
    ComplexArray,
    FloatArray,
    Joint,
    LinkSignals,
    LinkSummary,
    Origin,
    Study,
)
from strainwave.domain.keys import Values
from strainwave.dynamics.arm import Arm
from strainwave.errors import NotIdentifiable
from strainwave.identification.joint_model.motor_side import (
    models_from_catalogue,
    models_from_motors,
    search,
)
from strainwave.identification.joint_model.motor_side.arms import (
    ConsistentArms,
    LinearisedArms,
    Posture,
    family_of,
    posture_of,
)
from strainwave.identification.joint_model.motor_side.search import minima
from strainwave.identification.joint_model.motor_side.spectra import Piece, pieces, thin_lines
from strainwave.virtual.experiments import derived

BASE = ("alpha", "beta", "gamma")


def linear_arm(n: int, rng: np.random.Generator) -> LinearisedArms:
    """Random arm: parameters over two decades, positive definite inertia, arbitrary gravity."""
    factors = np.exp(rng.uniform(-2.3, 2.3, (6, n)))
    root, gravity = rng.normal(size=(n, n)), rng.normal(size=(n, n))
    coupling = np.eye(n) + np.tril(rng.uniform(-0.5, 0.5, (n, n)), -1)
    return LinearisedArms(
        transmission=coupling * rng.uniform(0.005, 0.1, n),
        motor_inertia=1e-4 * factors[0],
        motor_viscous_friction=1e-4 * factors[1],
        link_viscous_friction=0.3 * factors[2],
        gear_stiffness=1e4 * factors[3],
        gear_damping=10.0 * factors[4],
        inertia=root @ root.T + 0.1 * np.eye(n),
        gravity=5.0 * (gravity + gravity.T),
    )


def response(arm: LinearisedArms, s: complex) -> ComplexArray:
    """Response (n, n) of motor velocities to torques, from [theta_M, q_L, dtheta_M, dq_L]."""
    n, T = len(arm.transmission), arm.transmission
    K, D = (np.diag(x) for x in (arm.gear_stiffness, arm.gear_damping))
    mass = np.block(
        [[np.diag(arm.motor_inertia), np.zeros((n, n))], [np.zeros((n, n)), arm.inertia]]
    )
    spring = np.block([[T.T @ K @ T, -T.T @ K], [-K @ T, K + arm.gravity]])
    damper = np.block([[T.T @ D @ T, -T.T @ D], [-D @ T, D + np.diag(arm.link_viscous_friction)]])
    damper[:n, :n] += np.diag(arm.motor_viscous_friction)
    identity, zeros = np.eye(2 * n), np.zeros((2 * n, 2 * n))
    A = np.block(
        [[zeros, identity], [-np.linalg.solve(mass, spring), -np.linalg.solve(mass, damper)]]
    )
    B = np.vstack([np.zeros((2 * n, n)), np.linalg.solve(mass, np.eye(2 * n, n))])
    C = np.hstack([np.zeros((n, 2 * n)), np.eye(n, 2 * n)])
    return np.asarray(C @ np.linalg.solve(s * np.eye(4 * n) - A, B))


@given(st.integers(0, 2**32 - 1), st.sampled_from((1, 2, 3, 4)))
def test_the_motor_velocity_follows_from_its_torque_and_the_other_velocities(
    seed: int, n: int
) -> None:
    rng = np.random.default_rng(seed)
    arm = linear_arm(n, rng)
    s = np.asarray(2j * np.pi * np.geomspace(1.0, 100.0, 7), dtype=np.complex128)
    torque = complex_normal(rng, (7, n)) * 1e-2
    velocity = motion_of(arm, s, torque)
    for i in range(n):
        error = arm.motor(s, torque[:, i], velocity, i).error
        np.testing.assert_allclose(error, 0.0, atol=1e-7 * np.abs(velocity).max())


def motion_of(arm: LinearisedArms, s: ComplexArray, torque: ComplexArray) -> ComplexArray:
    """Velocities of the motors at their torques, (n_lines, n)."""
    pairs = zip(s.tolist(), torque, strict=True)
    return np.array([response(arm, each) @ drive for each, drive in pairs])


@given(st.integers(0, 2**32 - 1), st.sampled_from((1, 2, 3)))
def test_the_derivatives_are_limits_of_differences(seed: int, n: int) -> None:
    rng = np.random.default_rng(seed)
    arm = linear_arm(n, rng)
    names = [each.name for each in fields(arm)[1:]]
    sizes = {name: 1e-6 * getattr(arm, name)[None] for name in names}
    s = np.asarray(2j * np.pi * np.geomspace(1.0, 100.0, 7), dtype=np.complex128)
    torque, velocity = 1e-2 * complex_normal(rng, (7,)), complex_normal(rng, (7, n))
    above, below = (
        replace(arm, **{name: getattr(arm, name) + sign * sizes[name][0] for name in names})
        for sign in (1.0, -1.0)
    )
    for i in range(n):
        motion = arm.motor(s, torque, velocity, i)
        exact = motion.derivatives(LinearisedArms(arm.transmission, **sizes))
        high, low = (each.motor(s, torque, velocity, i) for each in (above, below))
        for derivative, name in zip(exact, ("error", "impedance"), strict=True):
            difference = (getattr(high, name) - getattr(low, name)) / 2.0
            scale = 1e-6 * np.abs(getattr(motion, name)).max()
            np.testing.assert_allclose(derivative[0], difference, rtol=1e-3, atol=1e-3 * scale)


def complex_normal(rng: np.random.Generator, shape: tuple[int, ...]) -> ComplexArray:
    return np.asarray(rng.normal(size=shape) + 1j * rng.normal(size=shape), dtype=np.complex128)


def known_family(study: Study, values: Values) -> ConsistentArms:
    """Arms with the rigid parameters of a drawn arm, which are exact."""
    arm = Arm.of(study.arm)
    parameters, n = derived(values, arm), arm.gear_ratios
    motor = np.array([parameters["motor_inertia", i] for i in (1, 2)])
    link = np.array([parameters["link_inertia", i] for i in (1, 2)])
    total = motor + n**2 * link
    return ConsistentArms(
        arm=arm,
        ratio=n,
        total_inertia=total,
        total_viscous=np.array([parameters["total_viscous_friction", i] for i in (1, 2)]),
        coulomb=np.array([parameters["motor_coulomb_friction", i] for i in (1, 2)]),
        base=np.array([parameters.get(key, 0.0) for key in arm.base_names]),
        known_share=np.array([np.nan, motor[1] / total[1]]),
        known_deviation=np.array([np.nan, 0.02]),
        viscous_std=np.zeros(2),
        base_per_motor=arm.base.links_per_motor,
    )


def exact_piece(
    family: ConsistentArms, values: Values, row: int, rng: np.random.Generator
) -> Piece:
    """Noise-free spectra of a record section in which one motor is driven and slides."""
    derived_values = derived(values, family.arm)
    angle = rng.uniform(-1.5, 1.5, 2)

    def of(name: str) -> FloatArray:
        return np.array([derived_values[name, i] for i in (1, 2)])

    base = np.array([derived_values.get(key, 0.0) for key in family.arm.base_names])
    posture = posture_of(family.arm, angle)
    arm = LinearisedArms(
        transmission=family.arm.transmission,
        motor_inertia=of("motor_inertia"),
        motor_viscous_friction=of("motor_viscous_friction"),
        link_viscous_friction=of("link_viscous_friction"),
        gear_stiffness=of("gear_stiffness"),
        gear_damping=of("gear_damping"),
        inertia=np.tensordot(base, posture.inertia, axes=1),
        gravity=np.tensordot(base, posture.gravity, axes=1),
    )
    s = np.asarray(2j * np.pi * np.geomspace(1.5, 150.0, 120), dtype=np.complex128)
    direction = complex_normal(rng, (120, 2))
    drive = np.zeros((120, 2), dtype=np.complex128)
    drive[:, row] = complex_normal(rng, (120,))
    velocity = motion_of(arm, s, drive)
    assert family.coulomb is not None
    torque = drive + family.coulomb * direction
    return Piece(f"prbs-j{row + 1}", s, torque, direction, velocity, angle, (row,))


@pytest.mark.parametrize("seed", [0, 2, 8])
def test_the_search_finds_the_gears_of_drawn_arms(seed: int) -> None:
    study, values = draw_arm(seed)  # linear gears
    for i, n in enumerate(
        Arm.of(study.arm).gear_ratios, start=1
    ):  # the ratio of the viscous frictions that the search assumes
        values["link_viscous_friction", i] = values["motor_viscous_friction", i] / n**2
    rng = np.random.default_rng(seed)
    family = known_family(study, values)
    records = [exact_piece(family, values, row, rng) for row in (0, 1)]
    best = minima(family, records, [thin_lines(piece, 40) for piece in records])[0]
    parts = family.parts(best.point)
    for i in (0, 1):
        # all parameters are exact, except the fixed ratio of the viscous frictions
        for name, close in (("gear_stiffness", 0.01), ("gear_damping", 0.05)):
            assert parts[name][i] == pytest.approx(values[name, i + 1], rel=close), name
        assert parts["motor_inertia"][i] == pytest.approx(values["motor_inertia", i + 1], rel=0.01)
    assert np.all(best.fit_percent > 99.0)


AXES = ((0.0, 0.0, 1.0), (0.0, 1.0, 0.0), (0.0, 1.0, 0.0), (1.0, 0.0, 0.0))
PLACES = ((0.0, 0.0, 0.2), (0.05, 0.0, 0.1), (0.35, 0.0, 0.0), (0.1, 0.0, 0.05))
RINGS_HZ = (12.0, 15.0, 18.0, 30.0)  # anti-resonances


def chain_arm(n: int) -> tuple[LinearisedArms, ConsistentArms, FloatArray]:
    """A chain of random bodies, the family of its exact rigid model, and its link parameters."""
    joints = [
        Joint("linear", 0.01, origin=Origin(place, (0.0, 0.0, 0.0)), axis=axis)
        for place, axis in zip(PLACES[:n], AXES[:n], strict=True)
    ]
    arm = Arm.of(ArmDescription("serial", tuple(joints), (0.0, 0.0, -9.81)))
    rng = np.random.default_rng(4)
    link = np.concatenate([parameters_of(random_body(rng)) for _ in range(n)])
    inertia, ratio = arm.link_inertias(link), arm.gear_ratios
    ring = 2.0 * np.pi * np.array(RINGS_HZ[:n])
    motor = ratio**2 * inertia * rng.uniform(0.4, 1.2, n)
    viscous, coulomb = np.full(n, 1e-4), np.full(n, 0.02)
    linear = LinearisedArms(
        transmission=arm.transmission,
        motor_inertia=motor,
        motor_viscous_friction=0.5 * viscous,
        link_viscous_friction=0.5 * viscous / ratio**2,
        gear_stiffness=ring**2 * inertia,
        gear_damping=0.1 * ring * inertia,
        inertia=np.diag(inertia),
        gravity=np.zeros((n, n)),
    )
    total = motor + ratio**2 * inertia
    in_sums = [c.motor[0] - 1 for c in arm.base.columns if c.motor and len(c.parts) > 1]
    known_share = motor / total
    known_share[in_sums] = np.nan
    base = arm.links_of_rigid() @ arm.base.rows @ np.concatenate([link, motor])
    deviation = np.full(n, 0.02)
    family = ConsistentArms(
        arm,
        ratio,
        total,
        viscous,
        coulomb,
        base,
        known_share,
        deviation,
        viscous_std=np.zeros(n),
        base_per_motor=arm.base.links_per_motor,
    )
    return linear, family, link


def chain_piece(
    linear: LinearisedArms,
    family: ConsistentArms,
    link: FloatArray,
    row: int,
    rng: np.random.Generator,
) -> Piece:
    """Noise-free spectra with one driven motor, in a random posture."""
    n = family.n_joints
    angle = rng.uniform(-1.0, 1.0, n)
    posture = posture_of(family.arm, angle)
    arm = replace(
        linear,
        inertia=np.tensordot(link, posture.inertia, axes=1),
        gravity=np.tensordot(link, posture.gravity, axes=1),
    )
    s = np.asarray(2j * np.pi * np.geomspace(1.5, 150.0, 60), dtype=np.complex128)
    drive = np.zeros((60, n), dtype=np.complex128)
    drive[:, row] = complex_normal(rng, (60,))
    direction = complex_normal(rng, (60, n))
    velocity = motion_of(arm, s, drive)
    return Piece(
        f"prbs-j{row + 1}", s, drive + 0.02 * direction, direction, velocity, angle, (row,)
    )


def test_the_search_finds_the_gears_of_a_spatial_chain(monkeypatch: pytest.MonkeyPatch) -> None:
    evaluated = []
    costs = search._costs

    def counted(
        family: ConsistentArms, points: FloatArray, pieces: Sequence[tuple[Piece, Posture]]
    ) -> FloatArray:
        evaluated.append(len(points))
        return costs(family, points, pieces)

    monkeypatch.setattr(search, "_costs", counted)
    linear, family, link = chain_arm(3)
    rng = np.random.default_rng(1)
    records = [chain_piece(linear, family, link, row, rng) for row in range(3)]
    best = minima(family, records, [thin_lines(piece, 40) for piece in records])[0]
    parts = family.parts(best.point)
    for name in ("gear_stiffness", "gear_damping", "motor_inertia"):
        np.testing.assert_allclose(parts[name], getattr(linear, name), rtol=1e-3, err_msg=name)
    # pairs of neighbours have (14 4)^2 + 14^2 4 points, the product of the joints 14^3 4^2 = 43,904
    assert sum(evaluated) < 5000


@pytest.mark.parametrize("n", [1, 2, 4])
def test_the_true_link_inertias_give_the_inertia_matrix_of_a_chain(n: int) -> None:
    linear, family, link = chain_arm(n)
    point = family.point(
        np.sqrt(linear.gear_stiffness / np.diag(linear.inertia)),
        linear.motor_inertia / np.asarray(family.total_inertia),
        0.05,
    )
    posture = posture_of(family.arm, np.random.default_rng(2).uniform(-1.5, 1.5, n))
    inertia = np.tensordot(link, posture.inertia, axes=1)
    scale = np.abs(inertia).max()
    np.testing.assert_allclose(family.linear(point, posture).inertia, inertia, atol=1e-9 * scale)


def test_a_stiffness_that_hardly_shows_stays_in_question() -> None:
    study, values = draw_arm(0)
    rng = np.random.default_rng(0)
    family = known_family(study, values)
    records = [exact_piece(family, values, row, rng) for row in (0, 1)]
    thinned_records = [thin_lines(piece, 40) for piece in records]
    sharp = minima(family, records, thinned_records)
    noisy = [
        replace(p, velocity=p.velocity + rng.normal(0.0, 30.0 * np.abs(p.velocity)))
        for p in thinned_records
    ]
    assert len(minima(family, noisy, noisy)) > len(sharp)


def test_a_motor_that_stands_is_refused_with_a_remedy() -> None:
    study, _ = draw_arm(0)
    n = 2000
    still: FloatArray = np.zeros((n, 2))
    signals = _signals(study, still, n)
    with pytest.raises(NotIdentifiable, match="joint 1 slide"):
        models_from_motors([signals], None, Arm.of(study.arm))
    assert not next(pieces(signals, Arm.of(study.arm), max_lines=40)).rows


def _signals(study: Study, still: FloatArray, n: int) -> LinkSignals:
    experiment = next(e for e in study.experiments if e.use == "frequency")
    return LinkSignals(
        experiment=experiment,
        time=np.asarray(2.5e-4 * np.arange(n), dtype=np.float64),
        sample_time=2.5e-4,
        motor_torque=still,
        motor_angle=still,
        motor_velocity=still,
        direction=still,
        sliding=still,
        link_angle=still,
        link_velocity=still,
        link_acceleration=still,
        valid=np.ones(n, dtype=bool),
        links=(LinkSummary("", 1, "motor"), LinkSummary("", 2, "motor")),
        held=(True, True),
        shared=(),
        bandwidth_hz=None,
    )


def test_without_a_rigid_model_there_is_no_catalogue() -> None:
    study, _ = draw_arm(0)
    with pytest.raises(NotIdentifiable, match='use = "motion"'):
        models_from_catalogue(None, Arm.of(replace(study, path=Path("study.toml")).arm))
    single = replace(
        study, arm=replace(study.arm, kind="single-joint", joints=study.arm.joints[:1])
    )
    assert family_of(None, Arm.of(single.arm)).total_inertia is None
