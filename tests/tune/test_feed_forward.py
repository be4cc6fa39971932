"""Feed-forward of elastic arms, verified by simulations of the compiled core."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import exports
from strainwave.domain import FloatArray, JointLimits, Parameter, Payload, Study
from strainwave.domain.arm.kinds import change_arm_keys
from strainwave.domain.arm.kinds.base import LINK_PARAMETERS
from strainwave.domain.keys import Values
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.simulation import Drive, simulate
from strainwave.errors import InvalidInput
from strainwave.export import IdentifiedArm
from strainwave.io.parameters import read_parameters
from strainwave.io.study import read_study
from strainwave.tune.feed_forward import (
    FeedForward,
    LinkMotion,
    feed_forward,
    point_to_point,
)
from strainwave.tune.plants import Condition, plants_of
from strainwave.virtual import scara

PERIOD = 1e-3
COUNT = 2.0 * np.pi / 8192  # [rad] of the encoders of the rig
FRICTION = "motor_coulomb_friction"
# A voltage that is held for 1 ms leaves the path between two ticks: 3.5e-6 of a move of 0.5 s.
SMOOTH_TOLERANCE = 5e-6
# The motor's velocity jumps at a knee, but a held voltage accelerates the motor over a period.
KNEE_TOLERANCE = 2e-4


def identified(study: Study, values: Values, ci95: float | None = None) -> IdentifiedArm:
    """A result with these values; Coulomb friction with intervals of a relative half-width.

    With a half-width of one, the feed-forward compensates no dry friction.
    """
    parameters = tuple(
        Parameter(
            name,
            joint,
            value,
            None,
            "",
            "tuned",
            ((1.0 - ci95) * value, (1.0 + ci95) * value) if ci95 and name == FRICTION else None,
        )
        for (name, joint), value in values.items()
    )
    return IdentifiedArm(study, parameters, "result.json")


def without_friction(values: Values) -> Values:
    return values | {key: 0.0 for key in values if key[0] == FRICTION}


def rig(spring: str = "linear", disks: int = 5) -> tuple[Study, Values]:
    return scara.STIFF.study(Path("nowhere"), spring), scara.STIFF.parameters(disks, spring)


def vertical_rig(spring: str = "linear") -> tuple[Study, Values]:
    study, values = rig(spring, 1)
    moment = values["gamma", None] / scara.STIFF.link_length[0]
    values |= {("gravity_torque_1", None): 31.0, ("gravity_torque_2", None): 9.81 * moment}
    return replace(study, arm=change_arm_keys(study.arm, gravity=9.81)), values


def move(*joints: tuple[float, float], duration: float = 0.5) -> LinkMotion:
    begin, end = np.array(joints).T
    return point_to_point(begin, end, duration, PERIOD)


def drive_of(result: FeedForward) -> Drive:
    """The voltages alone, without a servo."""
    return Drive(
        tick=PERIOD,
        voltage=result.voltage,
        reference=np.zeros_like(result.voltage),
        servo=(False,) * result.voltage.shape[1],
        motor_angle=tuple(result.motor_angle[0]),
        initial_voltage=tuple(result.voltage[0]),
    )


def link_error(study: Study, values: Values, result: FeedForward, drive: Drive) -> FloatArray:
    """Largest error of each link over the largest move of a link."""
    run = simulate(
        Arm.of(study.arm),
        values,
        drive,
        sample_time=PERIOD,
        samples=len(result.time),
        record=["link_angle"],
    )
    size = np.ptp(result.link_angle, axis=0).max()
    return np.asarray(np.abs(run["link_angle"] - result.link_angle).max(axis=0) / size)


def open_loop_error(
    study: Study, values: Values, motion: LinkMotion, known: Values | None = None
) -> float:
    """Error of voltages from the parameters `known`, or from the true values."""
    result = feed_forward(identified(study, known or values), motion)
    return float(link_error(study, values, result, drive_of(result)).max())


def test_a_polynomial_move_rests_at_both_ends() -> None:
    motion = move((0.3, 1.1), (2.0, -0.5), duration=0.8)
    ends = motion.derivatives(motion.time[[0, -1]])
    np.testing.assert_allclose(ends[0], [[0.3, 2.0], [1.1, -0.5]], rtol=1e-12)
    # by derivatives of the size of the move over powers of its duration
    assert np.all(np.abs(ends[1:, :, 0]) < 1e-9 / 0.8 ** np.arange(1, 5)[:, None])
    speed = np.abs(motion.derivatives(motion.time)[1]).max(axis=0)
    np.testing.assert_allclose(speed, [2.4609375 * 0.8 / 0.8, 2.4609375 * 2.5 / 0.8], rtol=1e-6)


@pytest.mark.parametrize(
    ("spring", "tolerance"), [("linear", SMOOTH_TOLERANCE), ("three-slope", KNEE_TOLERANCE)]
)
def test_links_follow_in_open_loop(spring: str, tolerance: float) -> None:
    study, values = rig(spring)
    motion = move((0.0, 0.25), (0.1, -0.1))
    assert open_loop_error(study, without_friction(values), motion) < tolerance


@pytest.mark.parametrize(
    ("spring", "tolerance"), [("linear", SMOOTH_TOLERANCE), ("three-slope", KNEE_TOLERANCE)]
)
def test_links_follow_against_gravity(spring: str, tolerance: float) -> None:
    study, values = vertical_rig(spring)
    motion = move((-1.2, -0.9), (0.3, 0.6), duration=0.7)
    assert open_loop_error(study, without_friction(values), motion) < tolerance


def test_a_serial_chain_follows(shared_data: Path, tmp_path: Path) -> None:
    folder = shared_data.parent / "serial" / "chain3-imu"
    if not folder.is_dir():
        pytest.skip("no ../shared/serial beside the project")
    study = read_study(folder / "study.toml")
    truth = json.loads((folder / "truth.json").read_text())
    drives = tmp_path / "drives.json"
    drives.write_text(json.dumps({"joints": truth["joints"]}))
    values = read_parameters(drives)
    for number, link in enumerate(truth["links"], start=1):
        moments = ("m", "mx", "my", "mz", "Ixx", "Ixy", "Iyy", "Ixz", "Iyz", "Izz")
        values |= {
            (f"link_{name}", number): link[short]
            for name, short in zip(LINK_PARAMETERS, moments, strict=True)
        }
    motion = move((0.2, 0.6), (-0.5, -0.2), (0.4, 0.0), duration=1.0)
    assert open_loop_error(study, without_friction(values), motion) < SMOOTH_TOLERANCE


@pytest.mark.parametrize("motions", exports.MOTIONS)
@pytest.mark.parametrize("coupling", [None, exports.COUPLING])
@pytest.mark.parametrize("spring", ["linear", "rigid"])
def test_rigid_coupled_and_prismatic_joints_follow(
    spring: str, coupling: tuple[tuple[float, ...], ...] | None, motions: exports.Motions
) -> None:
    study, values = exports.chain(Path("nowhere"), (spring,) * 3, motions, coupling)
    motion = move((0.2, 0.5), (-0.3, -0.1), (0.4, 0.2), duration=1.0)
    assert open_loop_error(study, values, motion) < SMOOTH_TOLERANCE


def test_gear_damping_and_current_loop_matter() -> None:
    """Parts of the model that a simpler feed-forward leaves out."""
    study, values = rig()
    values, motion = without_friction(values), move((0.0, 0.25), (0.1, -0.1))
    complete = open_loop_error(study, values, motion)
    undamped = values | {key: 0.0 for key in values if key[0] == "gear_damping"}
    assert open_loop_error(study, values, motion, undamped) > 2.0 * complete
    slow = replace(study, arm=study.arm.with_joints(
        replace(joint, current_loop_hz=200.0) for joint in study.arm.joints
    ))  # fmt: skip
    leading = feed_forward(identified(slow, values), motion)
    late = feed_forward(identified(study, values), motion)
    of_leading, of_late = (
        link_error(slow, values, result, drive_of(result)).max() for result in (leading, late)
    )
    assert of_leading < 0.05 * of_late


EFFECTS = {
    "kinematic-error": {
        "kinematic_error_cos": 1e-4,
        "kinematic_error_sin": -5e-5,
        "kinematic_error_order": 2.0,
    },
    "torque-ripple": {
        "torque_ripple_cos": 0.01,
        "torque_ripple_sin": 0.005,
        "torque_ripple_order": 2.0,
    },
    "power-friction": {"power_friction": 0.02, "power_exponent": 0.5},
    "ground-spring": {"ground_stiffness": 20.0, "ground_preload": 3.0},
    "tilt": {"tilt_sin": 2.0, "tilt_cos": 3.0},
    "drive-gain": {"drive_gain": 0.1},
    "drive-lag": {"drive_lag": 5e-4},
    "stribeck": {"stribeck_friction": 0.02, "stribeck_velocity": 5.0},
    "load-friction": {"load_friction": 0.1},
}
DRY = ("stribeck", "load-friction")


def with_effect(study: Study, values: Values, effect: str) -> tuple[Study, Values]:
    arm = study.arm
    for number in (1, 2):
        arm = arm.with_joint(number, effects=(effect,))
        values = values | {(name, number): size for name, size in EFFECTS[effect].items()}
    return replace(study, arm=arm), values


@pytest.mark.parametrize("effect", [name for name in EFFECTS if name not in DRY])
def test_identified_effects_are_compensated(effect: str) -> None:
    study, values = rig()
    affected, true_values = with_effect(study, without_friction(values), effect)
    motion = move((0.1, 0.35), (-0.2, -0.4))
    # ripple and kinematic error turn by up to 0.25 rad in a period: Simpson's rule is less exact
    assert open_loop_error(affected, true_values, motion) < 4.0 * SMOOTH_TOLERANCE
    plain = feed_forward(identified(study, values, ci95=1.0), motion)
    assert link_error(affected, true_values, plain, drive_of(plain)).max() > 1e-3


def servo_error(
    study: Study, values: Values, result: FeedForward, voltage: FloatArray
) -> FloatArray:
    """Link errors under the servo of the study, with a voltage in addition."""
    servo = study.arm.servo
    assert servo is not None
    gains = np.array(servo.position_gain or (0.0, 0.0))
    drive = replace(
        drive_of(result),
        voltage=voltage,
        reference=result.servo_reference(gains),
        servo=(True, True),
        initial_voltage=(0.0, 0.0),
    )
    return link_error(study, values, result, drive)


@pytest.mark.parametrize("effect", [None, *DRY])
@pytest.mark.parametrize("position_gain", [None, (20.0, 20.0)])
@pytest.mark.parametrize("spring", ["linear", "three-slope"])
def test_tracking_errors_under_the_servo_fall(
    spring: str, position_gain: tuple[float, float] | None, effect: str | None
) -> None:
    """By at least 30 in all, and by 3 by the compensation of dry friction."""
    study, values = rig(spring)
    if effect:
        study, values = with_effect(study, values, effect)
    servo = study.arm.servo
    assert servo is not None
    servo = replace(servo, position_gain=position_gain)
    study = replace(study, arm=replace(study.arm, servo=servo))
    motion = move((0.0, 0.4), (0.0, -0.3), duration=0.7)
    arm = identified(study, values)
    result = feed_forward(arm, motion)
    sliding = feed_forward(identified(study, values, ci95=1.0), motion)
    servo_alone = servo_error(study, values, result, np.zeros_like(result.voltage))
    without_compensation = servo_error(study, values, result, sliding.voltage)
    complete = servo_error(study, values, result, result.voltage)
    assert np.all(complete < servo_alone / 30.0)
    assert np.all(complete < without_compensation / 3.0)
    careful = feed_forward(identified(study, values, ci95=0.1), motion)
    assert np.all(servo_error(study, values, result, careful.voltage) < servo_alone / 20.0)


def sign_changes(samples: FloatArray, tolerance: float) -> int:
    signs = np.sign(samples[np.abs(samples) > tolerance])
    return int(np.sum(signs[1:] != signs[:-1]))


def friction_voltage(
    study: Study, values: Values, motion: LinkMotion, ci95: float | None
) -> FloatArray:
    """The part of the voltage that compensates dry friction."""
    complete, sliding = (
        feed_forward(identified(study, values, each), motion) for each in (ci95, 1.0)
    )
    return np.asarray(complete.voltage - sliding.voltage)


@settings(max_examples=20)
@given(
    st.tuples(st.floats(-0.3, 0.3), st.floats(-0.3, 0.3)),
    st.tuples(st.floats(-0.3, 0.3), st.floats(-0.3, 0.3)),
    st.floats(0.0, 0.5),
)
def test_friction_compensation_does_not_chatter(
    begin: tuple[float, float], end: tuple[float, float], ci95: float
) -> None:
    study, values = rig("three-slope")
    study = replace(study, arm=replace(study.arm, servo=None))  # without a limit of the voltage
    motion = point_to_point(np.array(begin), np.array(end), 0.5, PERIOD)
    voltage = friction_voltage(study, values, motion, ci95 or None)
    reference = feed_forward(identified(study, values), motion).reference_velocity
    friction = np.array([values[FRICTION, 1] / 0.08, values[FRICTION, 2] / 0.03])
    # the part is a difference of voltages up to 10 V
    assert np.all(np.abs(voltage) <= (1.0 - ci95) * friction + 1e-9)
    for i in range(2):
        # a hundredth of a count per period, far above rounding
        velocity = sign_changes(reference[:, i], 0.01 * COUNT / PERIOD)
        compensation = sign_changes(voltage[:, i], 0.02 * friction[i])
        assert compensation <= velocity
    np.testing.assert_allclose(voltage[0], 0.0, atol=0.02 * friction.min())


@settings(max_examples=20)
@given(
    st.floats(-0.5, 0.5), st.floats(0.05, 0.5), st.floats(0.3, 1.0),
    st.floats(5e3, 5e4), st.floats(0.0, 40.0),
)  # fmt: skip
def test_torsion_transmits_the_torque_of_the_link(
    begin: float, size: float, duration: float, stiffness: float, damping: float
) -> None:
    """T(delta) + d_G ddelta = tau for one joint in a vertical plane, to second order in d_G/k."""
    study, values = exports.single(Path("nowhere"), spring="linear", gravity=9.81)
    values |= {("gear_stiffness", 1): stiffness, ("gear_damping", 1): damping}
    motion = move((begin, begin + size), duration=duration)
    result = feed_forward(identified(study, values), motion)
    q, dq, ddq = motion.derivatives(motion.time)[:3, :, 0]
    torque = 3.0 * ddq + 0.1 * dq + 11.0 * np.cos(q)
    delta = 0.1 * result.motor_angle[:, 0] - q
    remainder = stiffness * delta + damping * np.gradient(delta, PERIOD) - torque
    second = np.gradient(np.gradient(torque, PERIOD), PERIOD)
    third = np.abs(np.gradient(second, PERIOD)).max()
    ratio = damping / stiffness
    differences = ratio * PERIOD**2 / 6 * third  # central differences of the torsion
    bound = 1.1 * (ratio**2 * np.abs(second).max() + differences) + 1e-9  # [N m]
    assert np.abs(remainder[1:-1]).max() < bound


def test_a_payload_on_a_planar_arm_equals_heavier_links() -> None:
    study, values = vertical_rig()
    m, (l1, _), x = 1.5, scara.STIFF.link_length, 0.25
    loaded = values | {
        ("alpha", None): values["alpha", None] + m * l1**2,
        ("beta", None): values["beta", None] + m * x**2,
        ("gamma", None): values["gamma", None] + m * l1 * x,
        ("gravity_torque_1", None): values["gravity_torque_1", None] + 9.81 * m * l1,
        ("gravity_torque_2", None): values["gravity_torque_2", None] + 9.81 * m * x,
    }
    posture, payload = np.array([-1.2, 0.4]), Payload(m, (x, 0.0, 0.0))
    arm = identified(study, values)
    carried = plants_of(arm, [values], [Condition(posture, payload)])
    heavier = plants_of(arm, [loaded], [Condition(posture)])
    np.testing.assert_allclose(carried.mass, heavier.mass, rtol=1e-9)
    # central differences of torques of up to 50 N m
    np.testing.assert_allclose(carried.stiffness, heavier.stiffness, rtol=1e-9, atol=1e-7)


def test_the_share_of_friction_follows_from_its_interval() -> None:
    study, values = rig()
    motion = move((0.0, 0.25), (0.1, -0.1))
    exact, shared = (friction_voltage(study, values, motion, each) for each in (None, 0.2))
    np.testing.assert_allclose(shared, 0.8 * exact, atol=1e-9)


def test_friction_changes_its_sign_within_a_count_or_the_change_of_a_period() -> None:
    study, values = rig()
    motion = move((0.0, 0.25), (0.1, -0.1))
    velocity = feed_forward(identified(study, values), motion).reference_velocity
    arm = study.arm.with_joints(replace(j, encoder_counts=None) for j in study.arm.joints)
    largest = np.abs(np.diff(velocity, axis=0)).max(axis=0)
    full = np.array([values[FRICTION, 1] / 0.08, values[FRICTION, 2] / 0.03])
    middle = slice(200, 300)  # where the velocity changes least in a period
    for joints, transition in ((study.arm, COUNT / PERIOD), (arm, largest)):
        voltage = friction_voltage(replace(study, arm=joints), values, motion, None)
        expected = full * np.tanh(velocity / transition)
        np.testing.assert_allclose(voltage[middle], expected[middle], rtol=2e-2)


def test_effects_that_do_not_follow_from_the_reference_have_no_compensation() -> None:
    study, values = rig()
    motion = move((0, 0.1), (0, 0.1))
    plain = feed_forward(identified(study, values), motion)
    arm = study.arm.with_joint(1, effects=("hysteresis", "stribeck"))
    values |= {("hysteresis_torque", 1): 1.0, ("hysteresis_twist", 1): 1e-4}
    result = feed_forward(identified(replace(study, arm=arm), values), motion)
    np.testing.assert_array_equal(result.voltage, plain.voltage)


def test_a_curve_that_is_identified_in_part_has_its_first_slopes() -> None:
    study, values = rig("three-slope")
    part = {key: v for key, v in values.items() if key not in {
        ("gear_stiffness_k3", 1), ("gear_knee_t2", 1)
    }}  # fmt: skip
    motion = move((0.0, 0.1), (0.0, 0.0), duration=1.0)  # below the second knee
    known, full = (feed_forward(identified(study, v), motion) for v in (part, values))
    np.testing.assert_array_equal(known.voltage, full.voltage)


@pytest.mark.parametrize(
    ("limits", "problem"),
    [
        (JointLimits(upper=0.2), "beyond the upper position limit of 0.2 rad"),
        (
            JointLimits(lower=0.05),
            "needs 0 rad at 0 s, beyond the lower position limit of 0.05 rad",
        ),
        (JointLimits(velocity=1.0), "beyond the velocity limit of 1 rad/s"),
        (JointLimits(effort=5.0), "beyond the effort limit of 5 N m"),
    ],
)
def test_motions_beyond_the_limits_of_a_joint_are_refused(
    limits: JointLimits, problem: str
) -> None:
    study, values = rig()
    arm = study.arm.with_joint(2, limits=limits)
    with pytest.raises(InvalidInput, match="joint 2 needs") as refusal:
        feed_forward(identified(replace(study, arm=arm), values), move((0, 0.25), (0, 0.25)))
    assert problem in str(refusal.value)


def test_motions_beyond_the_voltage_of_the_servo_are_refused() -> None:
    study, values = rig()
    with pytest.raises(InvalidInput, match=r"joint 1 needs .* V at .* s, beyond the voltage limit"):
        feed_forward(identified(study, values), move((0, 1.0), (0, 0.0)))


@pytest.mark.parametrize("name", ["motor_inertia", "gear_stiffness", "gear_damping", FRICTION])
def test_missing_parameters_are_named(name: str) -> None:
    study, values = rig()
    del values[name, 2]
    with pytest.raises(InvalidInput, match=f"{name} of joint 2 is missing"):
        feed_forward(identified(study, values), move((0, 0.1), (0, 0.1)))


def test_a_kinematic_error_that_reverses_the_gear_is_refused() -> None:
    study, values = with_effect(*rig(), "kinematic-error")
    values["kinematic_error_cos", 2] = 0.006
    with pytest.raises(InvalidInput, match="kinematic error of joint 2 reverses the gear"):
        feed_forward(identified(study, values), move((0, 0.1), (0, 0.1)))


def test_motions_shorter_than_a_period_are_refused() -> None:
    with pytest.raises(InvalidInput, match="shorter than the servo period"):
        point_to_point(np.zeros(2), np.ones(2), 1e-4, PERIOD)
