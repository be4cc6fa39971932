"""Feedback of the torsion: damping, margins and tracking, on linear and on simulated arms."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from unittest.mock import patch

import numpy as np
import pytest

from servo_arms import rig
from strainwave.domain import ControlLaw, FloatArray
from strainwave.domain.arm.description import LinearServo
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.simulation import Drive, simulate
from strainwave.export.randomisation import drawn_values
from strainwave.tune import damping as module
from strainwave.tune.closed_loop import close, sample
from strainwave.tune.damping import MIN_RATIO
from strainwave.tune.design import ServoDesign, ServoOptions, design_servo
from strainwave.tune.plants import plants_of
from strainwave.tune.verification import Simulated, shortest_plan

OPTIONS = ServoOptions(postures=((0.0, 0.0), (0.4, 1.9)), draws=3, seed=3)
BEGIN = np.array([0.4, 1.9])


@cache
def designed() -> ServoDesign:
    return design_servo(rig(8192), None, OPTIONS)


def laws(design: ServoDesign) -> tuple[list[ControlLaw], list[ControlLaw]]:
    """Laws of all joints without and with the feedback."""
    return [each.law() for each in design.gains], [one.law for one in design.dampings]


def test_the_least_damping_of_all_plants_rises() -> None:
    for one in designed().dampings:
        assert not one.reason
        assert one.with_feedback[0] >= MIN_RATIO * one.without[0]


def test_all_loops_keep_their_margins() -> None:
    for one in designed().dampings:
        assert one.margins is not None
        assert len(one.margins.gain_db) == designed().n_plants
        assert one.margins.share(designed().options.required).min() >= 1.0


def test_the_damping_is_that_of_the_exact_plants() -> None:
    """The least damping again, from plants that are drawn again, mode by mode."""
    design = designed()
    draws = drawn_values(design.arm, None, OPTIONS.draws, np.random.default_rng(OPTIONS.seed))
    plants = plants_of(design.arm, draws, design.conditions)
    highest = 1.1 * max(omega.max() for omega, _ in plants.resonances(with_held_motors=True))
    for each, name in zip(laws(design), ("without", "with_feedback"), strict=True):
        loop = close(sample(plants, design.clock), each)
        assert np.abs(loop.poles()).max() < 1.0
        ratios = []
        for pole in loop.poles().ravel().tolist():
            rate = np.log(pole + 0j) / design.clock.period if pole else complex(-np.inf)
            if rate.imag > 0.0 and abs(rate) < highest:
                ratios.append(-rate.real / abs(rate))
        assert min(ratios) == pytest.approx(getattr(design.dampings[0], name)[0], rel=1e-9)


def decay(design: ServoDesign, each: list[ControlLaw]) -> FloatArray:
    """Energy of the links' velocity (n_joints,) after both links start 1 mrad off.

    On the arm without dry friction, which stops motors in small motions.
    """
    values = {
        key: 0.0 if key[0] == "motor_coulomb_friction" else value
        for key, value in design.arm.values.items()
    }
    model = Arm.of(design.arm.study.arm)
    motors = BEGIN / model.gear_ratios
    drive = Drive(
        tick=design.clock.period,
        voltage=np.zeros((1500, 2)),
        reference=np.zeros((1500, 2)),
        servo=(True, True),
        motor_angle=tuple(motors.tolist()),
        initial_voltage=(0.0, 0.0),
        link_angle=tuple((BEGIN + 1e-3).tolist()),
        linear_servo=LinearServo(tuple(each), design.clock.period, design.limits[0]),
    )
    run = simulate(
        model, values, drive, sample_time=drive.tick, samples=1500, record=["link_velocity"]
    )
    return np.asarray((run["link_velocity"] ** 2).sum(axis=0))


def test_simulated_links_decay_faster() -> None:
    plain, damped = (decay(designed(), each) for each in laws(designed()))
    assert (damped < 0.8 * plain).all()


def test_planned_moves_are_followed_as_without_it() -> None:
    """The feedback does not oppose the torsion of the motion that the feed-forward drives."""
    design = designed()
    plan = shortest_plan(design.arm, BEGIN, BEGIN + 0.05, design.clock.period, design.limits)
    drive = Simulated.of(design.arm, design.limits).follow(design.gains, plan)
    planned = plan.extended(len(drive.reference)).link_angle
    model = Arm.of(design.arm.study.arm)

    def error(each: list[ControlLaw]) -> FloatArray:
        servo = LinearServo(tuple(each), design.clock.period, design.limits[0])
        moved = replace(drive, linear_servo=servo)
        run = simulate(
            model, design.arm.values, moved,
            sample_time=drive.tick, samples=len(planned), record=["link_angle"],
        )  # fmt: skip
        return np.asarray(np.sqrt(np.mean((run["link_angle"] - planned) ** 2, axis=0)))

    plain, damped = (error(each) for each in laws(design))
    assert (damped < 2.0 * plain).all()


def test_a_feedback_that_gains_too_little_is_not_used() -> None:
    with patch.object(module, "MIN_RATIO", 10.0):
        design = design_servo(rig(8192), None, replace(OPTIONS, draws=1))
    for one, gains in zip(design.dampings, design.gains, strict=True):
        assert one.gains == (0.0, 0.0)
        assert "changes the least damping ratio of all plants" in one.reason
        assert one.margins is None
        assert one.law.A.tolist() == gains.law().A.tolist()
