"""Response of the driven motor: closed forms of its modes, and the true arm against its record."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from elastic_runs import log_of, prbs_run, rig, rig_values
from strainwave.domain import ArmModel, Joint, Log, SearchEnd, Study
from strainwave.domain.arm.kinds import single_joint
from strainwave.domain.keys import Values
from strainwave.dynamics.arm import Arm
from strainwave.identification.motor_responses import modes_of_motor, motor_responses
from strainwave.report.document import bode
from strainwave.report.figures import Line, Markers


def _arm_model(values: Values) -> ArmModel:
    nothing: dict[str, Any] = {"fit_percent": {}, "initial_fit_percent": {}}
    return ArmModel(
        (),
        values,
        np.zeros((0, 0)),
        **nothing,
        simulated=(),
        initial=(),
        iterations=1,
        end=SearchEnd.CONVERGED,
    )


@pytest.fixture(scope="module")
def recorded() -> tuple[Study, Values, Log]:
    """Record of joint 1 with motor 2 free, and the arm that produced it."""
    study = rig()
    return study, rig_values(study), log_of(prbs_run(study), seed=1)


@given(
    ring=st.floats(3.0, 80.0),
    share=st.floats(0.1, 0.9),
    inertia=st.floats(1e-3, 10.0),
    ratio=st.sampled_from([1.0, 0.02, 0.01, -0.00625]),
)
def test_one_joint_has_the_modes_of_the_closed_form(
    ring: float, share: float, inertia: float, ratio: float
) -> None:
    """Without damping, zeros are sqrt(k / m_L) and poles sqrt(k (1 / m_L + n^2 / m_M))."""
    joint = Joint(spring="linear", gear_ratio=ratio, torque_per_volt=0.1)
    study = Study(arm=single_joint(joint), experiments=())
    link, motor = (1.0 - share) * inertia, share * inertia * ratio**2
    k = (2.0 * np.pi * ring) ** 2 * link
    values: Values = {
        ("link_inertia", 1): link,
        ("motor_inertia", 1): motor,
        ("gear_stiffness", 1): k,
        ("gear_damping", 1): 1e-6 * k,
    }
    zeros, poles = modes_of_motor(values, Arm.of(study.arm), np.zeros(1), 1, servoed=False)
    assert zeros == pytest.approx([ring], rel=1e-4)
    expected = np.sqrt(k * (1.0 / link + ratio**2 / motor)) / (2.0 * np.pi)
    assert poles == pytest.approx([expected], rel=1e-4)


def test_modes_of_the_rig_are_those_of_its_linear_motion() -> None:
    """Coupled modes of the arm with 5 kg, computed by an independent tool."""
    study = rig()
    zeros, poles = modes_of_motor(
        rig_values(study), Arm.of(study.arm), np.zeros(2), 1, servoed=False
    )
    assert zeros[0] == pytest.approx(14.7, abs=0.05)
    assert poles[0] == pytest.approx(21.9, abs=0.05)


def test_a_servo_lies_between_a_free_and_a_held_motor() -> None:
    """Zero gains give a free motor and very high gains a held motor."""
    study = rig()
    assert study.arm.servo is not None
    servoed_zeros = []
    for factor in (0.0, 1.0, 100.0, None):
        servo = study.arm.servo
        scaled_servo = (
            None
            if factor is None
            else replace(
                servo,
                kp=tuple(factor * k for k in servo.kp),
                ki=tuple(factor * k for k in servo.ki),
            )
        )
        zeros, _ = modes_of_motor(
            rig_values(study),
            Arm.of(replace(study, arm=replace(study.arm, servo=scaled_servo)).arm),
            np.zeros(2),
            1,
            servoed=True,
        )
        servoed_zeros.append(float(zeros[0]))
    free_zero = modes_of_motor(rig_values(study), Arm.of(study.arm), np.zeros(2), 1, servoed=False)[
        0
    ][0]
    assert servoed_zeros[0] == pytest.approx(free_zero)
    assert servoed_zeros[1] < 0.99 * free_zero
    assert servoed_zeros[2] == pytest.approx(servoed_zeros[3], rel=0.03)
    assert servoed_zeros[3] < 0.75 * free_zero


def test_the_true_arm_answers_as_its_record_and_another_does_not(
    recorded: tuple[Study, Values, Log],
) -> None:
    study, values, log = recorded
    (response,) = motor_responses([log], _arm_model(values), (), Arm.of(study.arm))
    (softer,) = motor_responses(
        [log],
        _arm_model({**values, ("gear_stiffness", 1): 0.8 * values["gear_stiffness", 1]}),
        (),
        Arm.of(study.arm),
    )
    near_resonance = (response.frequencies_hz > 5.0) & (response.frequencies_hz < 40.0)

    def left(fitted: np.ndarray) -> float:
        relative_error = np.abs(response.measured - fitted)[near_resonance] / np.abs(
            response.measured[near_resonance]
        )
        return float(np.median(relative_error))

    assert response.condition == "others-free"
    assert left(response.fitted) < 0.01
    assert left(softer.fitted) > 0.05
    dip = response.frequencies_hz[near_resonance][
        np.argmin(np.abs(response.measured[near_resonance]))
    ]
    assert response.anti_resonances_hz[0] == pytest.approx(dip, rel=0.15)


def test_the_figure_shows_both_and_marks_the_modes(recorded: tuple[Study, Values, Log]) -> None:
    study, values, log = recorded
    (response,) = motor_responses([log], _arm_model(values), (), Arm.of(study.arm))
    figure = bode.motor_figure(response)
    names = {mark.name for mark in figure.marks if isinstance(mark, Line | Markers)}
    assert {"measured", "fitted arm, simulated"} <= names
    positions = [line.x for line in figure.uprights]
    assert set(positions) == {*response.anti_resonances_hz, *response.resonances_hz}
    assert f"{response.anti_resonances_hz[0]:.4g}" in bode.describe_motor(response)
