"""Servo designs of the built-in arm: what they promise holds for every plant."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from unittest.mock import patch

import numpy as np
import pytest

from servo_arms import exact_responses, loops_of, rig, vertical_rig
from strainwave.domain import JointLimits, Payload
from strainwave.domain.keys import Values
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.simulation import simulate
from strainwave.errors import InvalidInput, NotIdentifiable
from strainwave.export import IdentifiedArm
from strainwave.export.randomisation import drawn_values
from strainwave.tune import cascade_tuning, verification
from strainwave.tune import design as module
from strainwave.tune.cascade_tuning import MAX_RIPPLE_SHARE, Loops
from strainwave.tune.closed_loop import Gains, close, sample
from strainwave.tune.design import ServoDesign, ServoOptions, design_servo
from strainwave.tune.margins import Requirements
from strainwave.tune.plants import Plants, plants_of, without_impossible

POSTURES = ((0.0, 0.0), (0.4, 1.9))
LOAD = Payload(2.0, (0.3, 0.0, 0.0))
OPTIONS = ServoOptions(postures=POSTURES, payloads=(LOAD,), draws=4, seed=3)
FEW = replace(OPTIONS, draws=1, payloads=())


def without_shapers(arm: IdentifiedArm, options: ServoOptions) -> ServoDesign:
    """A design whose shapers, half of its time, are not of interest."""
    with patch.object(module, "_shapers", return_value=(np.zeros((0, 2)), ())):
        return design_servo(arm, None, options)


@cache
def designed() -> ServoDesign:
    return design_servo(rig(), None, OPTIONS)


def plants_behind(design: ServoDesign) -> Plants:
    """The plants of a design, drawn again."""
    options = design.options
    rng = np.random.default_rng(options.seed)
    draws = drawn_values(design.arm, None, options.draws, rng)
    return plants_of(design.arm, draws, design.conditions)


def largest_pole(design: ServoDesign, gains: list[Gains]) -> float:
    laws = [each.law() for each in gains]
    loop = close(sample(plants_behind(design), design.clock), laws)
    return float(np.abs(loop.poles()).max())


def refusal(options: ServoOptions, arm: IdentifiedArm | None = None) -> str:
    with pytest.raises(InvalidInput) as error:
        without_shapers(arm or rig(), options)
    return str(error.value)


def test_every_plant_is_a_draw_in_a_condition() -> None:
    design = designed()
    assert design.n_plants == 5 * 4  # the estimates and four draws; two postures, two loads
    pairs = set(zip(design.draw.tolist(), design.condition.tolist(), strict=True))
    assert pairs == {(d, c) for d in range(5) for c in range(4)}
    postures = {tuple(each.posture.tolist()) for each in design.conditions}
    assert postures == set(POSTURES)
    assert [each.payload for each in design.conditions] == [None, LOAD] * 2


def test_draws_without_a_definite_inertia_matrix_are_left_out() -> None:
    plants = plants_behind(designed())
    draws: list[Values] = [{("draw", i): float(i)} for i in range(5)]
    mass = plants.mass.copy()
    mass[(plants.draw == 2) & (plants.condition == 1)] *= -1.0
    kept, rest = without_impossible(replace(plants, mass=mass), draws)
    assert rest == (*draws[:2], *draws[3:])
    assert set(kept.draw.tolist()) == {0, 1, 3, 4}
    with pytest.raises(NotIdentifiable, match="no positive definite inertia matrix"):
        without_impossible(replace(plants, mass=-plants.mass), draws)


def test_all_plants_keep_the_required_margins() -> None:
    for joint in designed().joints:
        margins = joint.results.margins
        assert len(margins.gain_db) == designed().n_plants
        assert margins.gain_db.min() >= 6.0
        assert margins.phase_deg.min() >= 30.0
        assert margins.modulus.min() >= 0.5


def test_all_plants_are_stable() -> None:
    assert largest_pole(designed(), designed().gains) < 1.0


@pytest.mark.parametrize("joint", [0, 1])
def test_the_gain_margin_is_the_change_of_gain_that_is_unstable(joint: int) -> None:
    """Independent of responses: poles of the exact discretisation with a changed gain."""
    design = designed()
    gains, smallest = design.gains, design.joints[joint].results.margins.gain_db.min()

    def changed(db: float) -> float:
        factor = 10.0 ** (db / 20.0)
        scaled = list(gains)
        scaled[joint] = replace(
            gains[joint], kp=factor * gains[joint].kp, ki=factor * gains[joint].ki
        )
        return largest_pole(design, scaled)

    tolerance = 0.02  # [dB]; interpolation between frequencies
    assert max(changed(smallest - tolerance), changed(tolerance - smallest)) < 1.0
    assert max(changed(smallest + tolerance), changed(-smallest - tolerance)) > 1.0


@pytest.mark.parametrize("joint", [0, 1])
def test_the_modulus_margin_is_that_of_the_exact_plants(joint: int) -> None:
    design = designed()
    omega = np.geomspace(1.0, 0.99 * design.clock.nyquist, 400)
    z = np.exp(1j * omega * design.clock.period)
    responses = exact_responses(sample(plants_behind(design), design.clock), z)
    controllers = np.stack([gains.response(z) for gains in design.gains])
    loop = loops_of(responses, controllers)[joint]
    nearest = np.abs(1.0 + loop).min()
    assert nearest == pytest.approx(design.joints[joint].results.margins.modulus.min(), rel=0.01)


def test_gains_are_as_high_as_the_margins_allow() -> None:
    """A tenth more bandwidth violates a margin, without an encoder that limits the gain."""
    design = designed()
    for joint in design.joints:
        assert joint.limit == "margins"
        assert joint.results.margins.share(design.options.required).min() < 1.1


@pytest.mark.parametrize(
    "required",
    [Requirements(gain_db=12.0), Requirements(phase_deg=55.0), Requirements(modulus=0.75)],
    ids=["gain", "phase", "modulus"],
)
def test_a_higher_margin_never_gives_a_higher_bandwidth(required: Requirements) -> None:
    stricter = without_shapers(rig(), replace(OPTIONS, required=required))
    for strict, loose in zip(stricter.joints, designed().joints, strict=True):
        assert strict.gains.kp < loose.gains.kp
        assert strict.results.margins.share(required).min() >= 1.0


def test_a_coarse_encoder_limits_the_gain() -> None:
    counts = 1000
    design = without_shapers(rig(counts), FEW)
    for joint in design.joints:
        assert joint.limit == "encoder"
        ripple = joint.gains.kp * 2.0 * np.pi / counts / design.clock.period
        assert 0.85 * MAX_RIPPLE_SHARE < ripple / design.limits[0] <= MAX_RIPPLE_SHARE


def test_a_longer_delay_costs_bandwidth() -> None:
    slow, fast = (without_shapers(rig(), replace(FEW, delay=delay)) for delay in (1e-3, 0.0))
    for late, early in zip(slow.gains, fast.gains, strict=True):
        assert late.kp < 0.9 * early.kp
    assert (slow.clock.delay, fast.clock.delay) == (1e-3, 0.0)


def test_an_upright_arm_is_stabilised() -> None:
    upright = ServoOptions(postures=((np.pi / 2.0, 0.0),), draws=2)
    design = without_shapers(vertical_rig(), upright)
    plants = plants_behind(design)
    assert np.linalg.eigvalsh(plants.stiffness).min() < 0.0  # it falls without a servo
    assert largest_pole(design, design.gains) < 1.0
    first = [gains.slowed(design.first_share) for gains in design.gains]
    assert largest_pole(design, first) < 1.0
    for joint in design.joints:
        # the motor reaches the reference; gravity bends the gear by some per mille
        np.testing.assert_allclose(joint.results.steps.link[-1], 1.0, atol=5e-3)


def test_the_first_trial_has_gains_that_stabilise(monkeypatch: pytest.MonkeyPatch) -> None:
    upright = ServoOptions(postures=((np.pi / 2.0, 0.0),), draws=0)
    monkeypatch.setattr(module, "_FIRST_SHARES", (1e-3, 0.4, 0.5))
    design = without_shapers(vertical_rig(), upright)
    assert largest_pole(design, [gains.slowed(1e-3) for gains in design.gains]) > 1.0
    assert design.first_share == 0.4


def test_slower_gains_have_the_same_shape() -> None:
    """The loop of a double integrator depends on the frequency over the bandwidth alone."""
    gains = Gains(kp=2.0, ki=3.0, position_gain=4.0, period=1e-9)
    s = 1j * np.geomspace(0.1, 10.0, 20)
    loop, slowed = (
        each.response(np.exp(x * 1e-9)) / x**2
        for each, x in ((gains, s), (gains.slowed(0.25), 0.25 * s))
    )
    np.testing.assert_allclose(slowed, loop, rtol=1e-5)


def test_steps_end_at_the_reference_with_little_overshoot() -> None:
    for joint in designed().joints:
        steps = joint.results.steps
        np.testing.assert_allclose(steps.link[-1], 1.0, atol=0.02)
        assert steps.overshoot.max() <= 0.05
        # the study has no position loop: its servo follows a pulse of the velocity
        assert joint.current is not None
        assert joint.current_results is not None
        assert joint.current.position_gain == 0.0
        np.testing.assert_allclose(joint.current_results.steps.link[-1], 1.0, atol=0.02)


def test_the_current_servo_is_that_of_the_study() -> None:
    servo = rig().study.arm.servo
    assert servo is not None
    gains = [joint.current for joint in designed().joints]
    assert [each.kp for each in gains if each] == list(servo.kp)
    assert [each.ki for each in gains if each] == list(servo.ki)
    assert designed().n_unstable == 0
    study = rig().study
    wild = replace(study, arm=replace(study.arm, servo=replace(servo, kp=(5.0, 5.0))))
    unstable = without_shapers(replace(rig(), study=wild), FEW)
    assert unstable.n_unstable == unstable.n_plants == 4
    assert all(joint.current and not joint.current_results for joint in unstable.joints)


def test_planned_moves_settle_earlier_than_steps() -> None:
    design = designed()
    assert [move.joint for move in design.moves] == [1, 2]
    for move in design.moves:
        assert move.current is not None
        assert move.planned.settling < min(move.step.settling, move.current.settling)
        assert move.planned.vibration < 1e-3
        assert move.planned.overshoot < 5e-3
        assert move.planned.settling <= move.duration + 0.05
        assert move.planned.peak_voltage <= design.limits[move.joint - 1]


def torque_rig(*efforts: float) -> IdentifiedArm:
    """The rig with logged torques, without servo, and with limits of the efforts at its links."""
    arm = rig()
    joints = [replace(joint, torque_per_volt=None) for joint in arm.study.arm.joints]
    for i, effort in enumerate(efforts):
        joints[i] = replace(joints[i], limits=JointLimits(effort=effort))
    study = replace(arm.study, arm=replace(arm.study.arm, joints=tuple(joints), servo=None))
    return replace(arm, study=study)


@pytest.mark.parametrize(("efforts", "unknown"), [((), "1, 2"), ((80.0,), "2")])
def test_drives_without_a_limit_are_refused(efforts: tuple[float, ...], unknown: str) -> None:
    with pytest.raises(InvalidInput, match=f"drive of joint {unknown} is unknown") as error:
        without_shapers(torque_rig(*efforts), FEW)
    assert "effort" in (error.value.remedy or "")


def test_limits_of_the_efforts_are_those_of_the_drives() -> None:
    design = without_shapers(torque_rig(80.0, 30.0), FEW)
    assert design.limits.tolist() == pytest.approx([0.8, 0.3])  # [N m] behind a ratio of 0.01
    assert all(joint.current is None for joint in design.joints)
    for move in design.moves:
        for each in (move.step, move.planned):
            assert each.peak_voltage <= design.limits[move.joint - 1] * (1.0 + 1e-12)


def test_scaled_inputs_move_the_arm_as_they_are() -> None:
    """Limits that no input reaches do not change a motion."""
    arm, gains = torque_rig(80.0, 30.0), designed().gains
    gains = [replace(each, kp=0.05 * each.kp, ki=0.05 * each.ki) for each in gains]
    begin, end = np.zeros(2), np.array([0.05, 0.0])
    plan = verification.shortest_plan(arm, begin, end, gains[0].period, np.array([0.8, 0.3]))
    runs = []
    for limits in ([9.0, 9.0], [9.0, 2.0]):
        simulated = verification.Simulated.of(arm, np.array(limits))
        run = simulate(
            simulated.model,
            arm.values,
            simulated.follow(gains, plan),
            sample_time=gains[0].period,
            samples=len(plan.time),
            record=["link_angle", "voltage"],
        )
        runs.append((run["link_angle"], simulated.inputs(run["voltage"])))
    for plain, scaled in zip(*runs, strict=True):
        np.testing.assert_allclose(scaled, plain, rtol=1e-6, atol=1e-9)


def test_parts_of_the_plants_are_judged_as_all_of_them() -> None:
    loops = Loops.of(plants_behind(designed()), designed().clock)
    controllers = loops.controllers(designed().gains)
    whole = loops.judge(controllers)
    with patch.object(cascade_tuning, "_ENTRIES", 9 * len(loops.omega)):
        parts = loops.judge(controllers)
    for a, b in zip(whole, parts, strict=True):
        for name in ("gain_db", "phase_deg", "modulus_hz"):
            np.testing.assert_array_equal(getattr(a[0], name), getattr(b[0], name))
        for name in ("gain_db", "phase_deg", "distance"):
            np.testing.assert_allclose(getattr(a[1], name), getattr(b[1], name), rtol=1e-12)


def test_shapers_cover_the_modes_with_held_motors() -> None:
    design = designed()
    modes = plants_behind(design).resonances(with_held_motors=True)
    for interval, (omega, _) in zip(design.modes_hz, modes, strict=True):
        hz = omega / (2.0 * np.pi)
        assert hz.min() <= interval[0] < np.median(hz) < interval[1] <= hz.max()
    assert design.shapers[0].is_sufficient


def test_postures_are_drawn_within_the_limits() -> None:
    arm = rig()
    limits = JointLimits(lower=0.2, upper=0.9)
    joints = tuple(replace(joint, limits=limits) for joint in arm.study.arm.joints)
    study = replace(arm.study, arm=arm.study.arm.with_joints(joints))
    arm = replace(arm, study=study)
    design = without_shapers(arm, replace(FEW, postures=()))
    postures = np.array([each.posture for each in design.conditions])
    assert len(np.unique(postures, axis=0)) == 5
    assert postures.min() >= 0.2
    assert postures.max() <= 0.9
    message = refusal(replace(FEW, postures=((0.3, 1.0),)), arm)
    assert message.startswith("--posture: the angle 1 of joint 2 is outside its limits 0.2 to 0.9")


def test_the_required_bandwidth_is_reached_or_refused() -> None:
    message = refusal(replace(FEW, bandwidth_hz=1000.0))
    assert message.startswith("--bandwidth: the velocity loop of joint 1 reaches ")
    assert "limited by the margins" in message
    possible = float(message.split("require at most ")[1].split(" Hz")[0])
    with pytest.raises(InvalidInput):
        without_shapers(rig(), replace(FEW, bandwidth_hz=possible + 0.02))


def test_margins_that_no_gains_keep_are_refused() -> None:
    message = refusal(replace(FEW, required=Requirements(modulus=0.999)))
    assert "no gains of joint 1 stabilise all plants" in message
    assert "modulus margin of 0.999: the inertia at motor 1 is " in message


@pytest.mark.parametrize(
    ("options", "start"),
    [
        (replace(FEW, postures=((0.0,),)), "--posture: the posture has 1 angles"),
        (replace(FEW, delay=2e-3), "--delay: a delay of 0.002 s is not between zero and"),
        (replace(FEW, delay=-1e-4), "--delay: "),
        (replace(FEW, period=0.0), "--period: the period is 0."),
        (replace(FEW, draws=-1), "--draws: the number of draws is -1."),
        (replace(FEW, bandwidth_hz=-2.0), "--bandwidth: the bandwidth is -2."),
        (replace(FEW, payloads=(Payload(-1.0),)), "--payload: the mass is -1."),
        (replace(FEW, required=Requirements(gain_db=0.0)), "--gain-margin: "),
        (replace(FEW, required=Requirements(phase_deg=180.0)), "--phase-margin: "),
        (replace(FEW, required=Requirements(modulus=1.0)), "--modulus-margin: "),
    ],
)
def test_options_out_of_range_are_refused(options: ServoOptions, start: str) -> None:
    assert refusal(options).startswith(start)


@pytest.mark.parametrize("name", ["gear_stiffness", "motor_inertia", "link_viscous_friction"])
def test_a_missing_parameter_is_named(name: str) -> None:
    arm = rig()
    parameters = tuple(replace(p, value=None) if p.key == (name, 2) else p for p in arm.parameters)
    with pytest.raises(NotIdentifiable, match=rf"does not determine {name} 2"):
        without_shapers(replace(arm, parameters=parameters), FEW)


def test_a_planned_move_is_followed_at_its_time() -> None:
    """A reference that is a period late leaves an error of the velocity times the period."""
    arm, gains = rig(), designed().gains
    begin, end = np.zeros(2), np.array([0.05, 0.0])
    plan = verification.shortest_plan(arm, begin, end, gains[0].period, np.full(2, 10.0))
    run = simulate(
        Arm.of(arm.study.arm),
        arm.values,
        verification.Simulated.of(arm, np.full(2, 10.0)).follow(gains, plan),
        sample_time=gains[0].period,
        samples=len(plan.time),
        record=["link_angle"],
    )
    errors = np.abs(run["link_angle"] - plan.link_angle).max(axis=0)
    velocity = np.abs(np.diff(plan.link_angle[:, 0])).max()  # per period
    assert errors.max() < 0.3 * velocity
