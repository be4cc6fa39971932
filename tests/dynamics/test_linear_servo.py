"""Control laws in the simulation, against linear models and an independent loop in Python."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from strainwave.domain import ArmDescription, ControlLaw, FloatArray, LinearServo
from strainwave.domain.arm.description import MAX_LAW_STATES
from strainwave.domain.arm.link_sensors.link_space import Quantity
from strainwave.domain.keys import Values
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.simulation import Drive, sensitivities, simulate
from strainwave.errors import InvalidInput
from strainwave.export.source import IdentifiedArm
from strainwave.tune.closed_loop import Clock, Gains, close, notch, sample
from strainwave.tune.plants import Condition, plants_of
from strainwave.virtual import scara

PERIOD = 1e-3


def frictionless(arm: ArmDescription) -> tuple[ArmDescription, Values]:
    """The built-in arm with linear gears, without friction and quantisation."""
    joints = tuple(replace(joint, encoder_counts=None) for joint in arm.joints)
    values = scara.STIFF.parameters(spring="linear")
    for number in (1, 2):
        values["motor_coulomb_friction", number] = 0.0
        values["friction_offset", number] = 0.0
    return replace(arm, joints=joints), values


def observing(law: ControlLaw) -> ControlLaw:
    """The law with an additional state, a low-pass of the voltage that the output contains."""
    n = len(law.A)
    A, B = np.zeros((n + 1, n + 1)), np.vstack([law.B, np.zeros(3)])
    A[:n, :n], A[n, n] = law.A, 0.9
    return ControlLaw(
        A,
        B,
        np.append(law.C, -0.2),
        law.D,
        np.append(law.E, 0.1),
        np.append(law.holds, False),
    )


def laws() -> tuple[ControlLaw, ControlLaw]:
    """A cascade with a notch and an observer of the voltage, and a cascade."""
    filtered = Gains(0.15, 1.5, 10.0, PERIOD, (notch(40.0, 0.5, 0.1, PERIOD),)).law()
    return observing(filtered), Gains(0.08, 1.0, 10.0, PERIOD).law()


def driven(
    reference: FloatArray,
    limit: float,
    voltage: FloatArray | None = None,
    initial_voltage: tuple[float, float] = (0.0, 0.0),
    motor_angle: tuple[float, float] = (0.0, 0.0),
) -> Drive:
    return Drive(
        PERIOD,
        np.zeros_like(reference) if voltage is None else voltage,
        reference,
        (True, True),
        motor_angle,
        initial_voltage,
        linear_servo=LinearServo(laws(), PERIOD, limit),
    )


def small_steps(size: float, samples: int = 600) -> FloatArray:
    reference = np.zeros((samples, 2))
    reference[20:120, 0], reference[200:260, 0] = size, -size
    return reference


def test_closed_loop_equals_the_linear_model() -> None:
    """The motions are small, so that the inertia of the links is constant."""
    study = scara.STIFF.study(Path(), "linear")
    arm, values = frictionless(study.arm)
    source = IdentifiedArm(replace(study, arm=arm), (), "test")
    plants = plants_of(source, [values], [Condition(np.zeros(2))])
    sampled = sample(plants, Clock(PERIOD))
    closed = close(sampled, laws(), (0,))
    reference = small_steps(1e-3)
    angle = PERIOD * np.concatenate([[0.0], np.cumsum(reference[:-1, 0])])
    states = [np.zeros(closed.A.shape[1])]
    for inputs in np.column_stack([angle, reference[:, 0]])[:-1]:
        states.append(closed.A[0] @ states[-1] + closed.B[0, :, 0] @ inputs)
    motor = np.pad(sampled.motors[0], (0, closed.links.shape[1] - sampled.A.shape[1]))
    expected: dict[Quantity, FloatArray] = {
        "motor_angle": np.array(states) @ motor,
        "link_angle": np.array(states) @ closed.links[0],
    }
    run = simulate(
        Arm.of(arm),
        values,
        driven(reference, 100.0),
        sample_time=PERIOD,
        samples=len(reference),
        record=list(expected),
    )
    for name, angles in expected.items():
        # the error of the integrator is 1e-8, and falls with the fourth power of its step
        difference = np.abs(run[name][:, 0] - angles)
        assert difference.max() < 1e-7 * np.abs(angles).max(), name


def law_by_hand(
    law: ControlLaw,
    reference: FloatArray,
    encoder: FloatArray,
    feed_forward: FloatArray,
    start: float,
    limit: float,
) -> FloatArray:
    """Voltages of a law for recorded encoder readings."""
    x = law.rest() @ np.array([encoder[0], start])
    path, voltages = encoder[0], np.empty(len(encoder))
    for k, (w, y, volts) in enumerate(zip(reference, encoder, feed_forward, strict=True)):
        inputs = np.array([path, w, y])
        unlimited = law.C @ x + law.D @ inputs + volts
        voltages[k] = min(max(unlimited, -limit), limit)
        following = law.A @ x + law.B @ inputs + law.E * (voltages[k] - volts)
        x = np.where(law.holds & (abs(unlimited) > limit), x, following)
        path += PERIOD * w
    return voltages


def test_limited_laws_equal_a_loop_in_python() -> None:
    """On the arm with friction and encoders; its open loop with the voltages moves equally."""
    study, values = scara.STIFF.study(Path()), scara.STIFF.parameters()
    arm, limit, start = Arm.of(study.arm), 3.0, (0.4, -0.3)
    reference = np.column_stack([small_steps(60.0)[:, 0], -small_steps(40.0)[:, 0]])
    volts = np.column_stack([np.full(600, 0.2), 0.3 * np.sin(0.02 * np.arange(600))])
    drive = driven(reference, limit, volts, start, (5.0, -3.0))
    run = simulate(
        arm, values, drive, sample_time=PERIOD, samples=600, record=["voltage", "encoder"]
    )
    limited = np.abs(run["voltage"]) == limit
    assert np.all(limited.sum(axis=0) > 20)
    for i, law in enumerate(laws()):
        by_hand = law_by_hand(
            law, reference[:, i], run["encoder"][:, i], volts[:, i], start[i], limit
        )
        # rounding of angles over the period, times the gain
        np.testing.assert_allclose(run["voltage"][:, i], by_hand, rtol=0.0, atol=1e-9)
    replay = replace(drive, voltage=run["voltage"], servo=(False, False), linear_servo=None)
    repeated = simulate(
        arm, values, replay, sample_time=PERIOD, samples=600, record=["voltage", "encoder"]
    )
    np.testing.assert_array_equal(repeated["encoder"], run["encoder"])


def test_a_cascade_as_law_equals_the_servo_of_the_arm() -> None:
    """Joint 2 is not under servo."""
    study, values = scara.STIFF.study(Path()), scara.STIFF.parameters()
    servo = study.arm.servo
    assert servo is not None
    gains = (servo.kp, servo.ki, servo.position_gain or (0.0, 0.0))
    cascades = tuple(Gains(*one, servo.period).law() for one in zip(*gains, strict=True))
    drive = replace(driven(small_steps(60.0), servo.limit), servo=(True, False), linear_servo=None)
    of_law = replace(drive, linear_servo=LinearServo(cascades, servo.period, servo.limit))
    one, other = (
        simulate(
            Arm.of(study.arm), values, run, sample_time=PERIOD, samples=600, record=["voltage"]
        )
        for run in (drive, of_law)
    )
    np.testing.assert_allclose(other["voltage"], one["voltage"], rtol=0.0, atol=1e-9)
    assert not other["voltage"][:, 1].any()


def test_derivatives_include_the_laws() -> None:
    study = scara.STIFF.study(Path(), "linear")
    arm, values = frictionless(study.arm)
    core, drive = Arm.of(arm), driven(small_steps(5.0), 100.0)
    key = ("gear_stiffness", 1)
    (_, tangents), *_ = sensitivities(
        core, values, drive, [key], sample_time=PERIOD, samples=600, record=["voltage"]
    ).values()
    size = 1e-4 * values[key]
    ahead, behind = (
        simulate(
            core,
            {**values, key: values[key] + sign * size},
            drive,
            sample_time=PERIOD,
            samples=600,
            record=["voltage"],
        )["voltage"]
        for sign in (1.0, -1.0)
    )
    slope = (ahead - behind) / (2.0 * size)
    largest = np.abs(slope).max()
    # the second order of the difference
    np.testing.assert_allclose(tangents[..., 0], slope, rtol=0.0, atol=1e-5 * largest)


@pytest.mark.parametrize("law", [*laws(), Gains(0.1, 1e-3, 0.0, PERIOD).law()])
def test_laws_with_integrator_rest_at_any_voltage(law: ControlLaw) -> None:
    rest = law.rest()
    for angle, volts in ((1.0, 0.0), (0.0, 1.0), (-20.0, 7.0)):
        x, inputs = rest @ np.array([angle, volts]), np.array([angle, 0.0, angle])
        following = law.A @ x + law.B @ inputs + law.E * volts
        scale = 1.0 + np.abs(x).max() * np.abs(law.A).max()
        np.testing.assert_allclose(following, x, rtol=0.0, atol=1e-12 * scale)
        assert law.C @ x + law.D @ inputs == pytest.approx(volts, abs=1e-9)


def test_laws_without_integrator_rest_without_voltage() -> None:
    law = Gains(0.1, 0.0, 0.0, PERIOD, (notch(40.0, 0.5, 0.1, PERIOD),)).law()
    x = law.rest() @ np.array([2.0, 5.0])
    inputs = np.array([2.0, 0.0, 2.0])
    assert law.C @ x + law.D @ inputs == pytest.approx(0.0, abs=1e-9)
    np.testing.assert_allclose(law.A @ x + law.B @ inputs, x, rtol=0.0, atol=1e-9)


def test_proportional_law_has_no_states() -> None:
    none = np.zeros(0)
    law = ControlLaw(
        np.zeros((0, 0)),
        np.zeros((0, 3)),
        none,
        np.array([2.0, 0.0, -2.0]),
        none,
        np.zeros(0, dtype=bool),
    )
    assert law.rest().shape == (0, 2)
    drive = replace(
        driven(small_steps(1.0), 10.0), linear_servo=LinearServo((law, law), PERIOD, 10.0)
    )
    study = scara.STIFF.study(Path())
    run = simulate(
        Arm.of(study.arm),
        scara.STIFF.parameters(),
        drive,
        sample_time=PERIOD,
        samples=600,
        record=["voltage"],
    )
    assert np.abs(run["voltage"][:, 0]).max() > 0.1


def test_laws_that_do_not_fit_are_rejected() -> None:
    study, values = scara.STIFF.study(Path()), scara.STIFF.parameters()
    one = LinearServo(laws()[:1], PERIOD, 10.0)
    drive = replace(driven(small_steps(1.0), 10.0), linear_servo=one)
    with pytest.raises(InvalidInput, match="expected 2 control laws, got 1"):
        simulate(
            Arm.of(study.arm), values, drive, sample_time=PERIOD, samples=10, record=["voltage"]
        )
    filters = tuple(notch(hz, 0.5, 0.1, PERIOD) for hz in range(20, 28))
    with pytest.raises(InvalidInput, match=f"18 states, but at most {MAX_LAW_STATES}"):
        LinearServo((Gains(0.1, 1.0, 0.0, PERIOD, filters).law(),), PERIOD, 10.0)
    wrong = replace(laws()[0], holds=np.zeros(2, dtype=bool))
    drive = replace(drive, linear_servo=LinearServo((wrong, wrong), PERIOD, 10.0))
    with pytest.raises(InvalidInput, match="expected a law with A"):
        simulate(
            Arm.of(study.arm), values, drive, sample_time=PERIOD, samples=10, record=["voltage"]
        )
