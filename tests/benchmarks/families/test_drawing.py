"""Arms of a family are reproducible and within their distribution; every key has an effect."""

from __future__ import annotations

from dataclasses import fields, replace
from typing import Any

import numpy as np
import pytest
from benchmarks.families.catalogue import GEAR_CATALOGUE, Friction
from benchmarks.families.causes import cause_names
from benchmarks.families.drawing import FAULTS, Sensors, VirtualArm

from benchmarks.families import Family, Recorded, draw, record

BASE = Family(arms=6)
CHANGED: dict[str, Any] = {
    "seed": 1,
    "sizes": (14,),
    "ratios": (90.0,),
    "springs": ("linear",),
    "counts": (3000,),
    "sample_times": (2.5e-4,),
    "payload": (0.1, 0.2),
    "gravity": 1.0,
    "friction": Friction(coulomb=(2.0, 3.0)),
    "sensors": Sensors(noise=(2.0, 3.0)),
    "faults": 1.0,
    "effects": ("dead-zone",),
}
SOME = range(40)


def arms(family: Family, numbers: range = range(6)) -> list[VirtualArm]:
    return [draw(family, number) for number in numbers]


def is_identical(one: Recorded, other: Recorded) -> bool:
    """Whether the logs are identical."""
    return all(
        np.array_equal(one.data[name][channel], other.data[name][channel])
        for name in one.data
        for channel in one.data[name]
    )


def test_seed_and_number_determine_an_arm_and_its_logs() -> None:
    family = replace(BASE, faults=1.0, effects=0.5, gravity=0.5)
    assert draw(family, 3) == draw(replace(family, arms=1000), 3)
    assert draw(family, 3) != draw(family, 4)
    assert draw(family, 3) != draw(replace(family, seed=1), 3)
    assert is_identical(record(draw(family, 3)), record(draw(family, 3)))


def test_all_keys_are_tested() -> None:
    assert {field.name for field in fields(Family)} == {*CHANGED, "arms"}


@pytest.mark.parametrize("key", CHANGED)
def test_every_key_changes_the_arms(key: str) -> None:
    assert arms(replace(BASE, **{key: CHANGED[key]})) != arms(BASE)


@pytest.mark.parametrize(
    ("key", "changed"),
    [
        ("friction", Friction(viscous=(2.0, 3.0))),
        ("sensors", Sensors(link=("encoder",))),
        ("sensors", Sensors(link=("none",))),
    ],
)
def test_every_key_of_inner_tables_changes_the_arms(key: str, changed: Any) -> None:
    assert arms(replace(BASE, **{key: changed})) != arms(BASE)


def test_faults_and_effects_do_not_change_the_arms() -> None:
    with_both = replace(BASE, faults=1.0, effects=1.0)
    for one, other in zip(arms(BASE), arms(with_both), strict=True):
        assert one.rig == other.rig


def test_arms_are_within_their_distribution() -> None:
    family = Family(
        arms=len(SOME),
        sizes=(20, 14),
        ratios=(50.0, 100.0),
        springs=("three-slope",),
        counts=(4096, 8192),
        sample_times=(1e-3, 5e-4),
    )
    for arm in arms(family, SOME):
        assert arm.rig.sample_time in family.sample_times
        assert arm.rig.study.arm.gravity is None
        for number, joint in enumerate(arm.rig.study.arm.joints, start=1):
            assert 1.0 / joint.gear_ratio == pytest.approx(50.0) or 1.0 / joint.gear_ratio == (
                pytest.approx(100.0)
            )
            assert joint.spring == "three-slope"
            assert joint.encoder_counts in family.counts
            knees = (arm.rig.values["gear_knee_t1", number], arm.rig.values["gear_knee_t2", number])
            assert knees in {GEAR_CATALOGUE[size][0] for size in family.sizes}
            assert joint.accelerometer_distance


def test_factors_are_within_their_bounds() -> None:
    friction = Friction(coulomb=(2.0, 3.0), viscous=(0.2, 0.5))
    sensors = Sensors(noise=(4.0, 5.0))
    family = replace(BASE, friction=friction, sensors=sensors)
    alone = replace(BASE, friction=replace(friction, coulomb=(1.0, 1.0)))
    for number in range(6):
        plain, scaled, other = draw(BASE, number), draw(family, number), draw(alone, number)
        noise = scaled.rig.noise.accelerometer_density / plain.rig.noise.accelerometer_density
        assert 4.0 <= noise <= 5.0
        assert scaled.rig.noise.accelerometer_range <= 5.0 * plain.rig.noise.accelerometer_range
        # earlier random numbers do not depend on the factors
        key = ("motor_viscous_friction", 1)
        assert 0.2 <= other.rig.values[key] / plain.rig.values[key] <= 0.5
        key = ("motor_coulomb_friction", 1)
        assert 2.0 <= scaled.rig.values[key] / plain.rig.values[key] <= 3.0


def test_a_payload_is_a_point_mass_at_the_tip() -> None:
    loaded = replace(BASE, payload=(2.0, 2.0))
    for number in range(6):
        plain, with_payload = draw(BASE, number).rig.values, draw(loaded, number).rig.values
        added = {
            name: with_payload[name, None] - plain[name, None]
            for name in ("alpha", "beta", "gamma")
        }
        assert added["gamma"] ** 2 == pytest.approx(added["alpha"] * added["beta"])
        length = draw(BASE, number).rig.study.arm.joints[1].origin.xyz[0]
        assert added["alpha"] == pytest.approx(2.0 * length**2)


def test_shares_match_the_description() -> None:
    family = Family(arms=100, gravity=0.3, faults=0.5)
    drawn = arms(family, range(100))
    upright = sum(arm.rig.study.arm.gravity is not None for arm in drawn)
    assert 15 <= upright <= 45  # three standard deviations of a binomial count
    assert 35 <= sum(arm.fault is not None for arm in drawn) <= 65
    assert all(arm.fault is None for arm in arms(BASE))


def test_only_listed_kinds_are_drawn() -> None:
    family = replace(BASE, faults=("spikes", "gear-ratio"), effects=("stribeck", "dead-zone"))
    drawn = arms(family, SOME)
    assert {arm.fault for arm in drawn} == {"spikes", "gear-ratio"}
    assert {arm.cause.name for arm in drawn} == {"stribeck", "dead-zone"}


def test_all_kinds_are_drawn_by_default() -> None:
    drawn = arms(Family(arms=400, faults=1.0), range(400))
    assert {arm.fault for arm in drawn} == set(FAULTS)


@pytest.mark.parametrize("name", cause_names())
def test_effects_change_the_logs_but_not_the_study(name: str) -> None:
    plain, with_effect = draw(BASE, 1), draw(replace(BASE, effects=(name,)), 1)
    recorded = record(with_effect)
    assert recorded.study == plain.rig.study
    assert recorded.classes["effect"] == name
    assert not is_identical(recorded, record(plain))


@pytest.mark.parametrize(
    ("link", "channels"),
    [
        ("accelerometer", {"a1", "a2"}),
        ("gyro", {"gyro1", "gyro2"}),
        ("accelerometer-and-gyro", {"a1", "a2", "gyro1", "gyro2"}),
        ("encoder", {"theta_l1", "theta_l2"}),
        ("none", set()),
    ],
)
def test_channels_match_the_drawn_link_sensors(link: Any, channels: set[str]) -> None:
    recorded = record(draw(replace(BASE, sensors=Sensors(link=(link,))), 0))
    common = {"t", "u1", "u2", "theta_m1", "theta_m2", "ref1", "ref2"}
    assert set(recorded.data["motion"]) == common | channels
    assert recorded.classes["link sensors"] == link
    assert {name for name in channels if name.startswith("theta_l")} == set(recorded.study.channels)


def test_true_values_include_reported_combinations() -> None:
    arm = draw(replace(BASE, effects=("friction-by-record",)), 0)
    assert ("rigid_inertia", 1) in arm.truth
    assert ("motor_coulomb_friction", arm.cause.joint) not in arm.truth
    assert ("motor_coulomb_friction", 3 - arm.cause.joint) in arm.truth
