"""The plant of the servo study: MuJoCo under sampled laws against the compiled core."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from strainwave.domain.arm.description import LinearServo
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.simulation import Drive, simulate
from strainwave.tune.closed_loop import Gains, low_pass
from strainwave.tune.shapers import Impulses
from strainwave.virtual import scara

PERIOD = 1e-3
pytest.importorskip("mujoco", reason="MuJoCo is not installed")


def drive(limit: float) -> Drive:
    gains = Gains(0.3, 5.0, 10.0, PERIOD, (low_pass(150.0, PERIOD),))
    reference = np.zeros((300, 2))
    reference[20:80, 0], reference[60:120, 1] = 30.0, -20.0
    return Drive(
        tick=PERIOD,
        voltage=np.zeros_like(reference),
        reference=reference,
        servo=(True, True),
        motor_angle=(0.0, 0.0),
        initial_voltage=(0.0, 0.0),
        linear_servo=LinearServo((gains.law(), gains.law()), PERIOD, limit),
    )


@pytest.mark.parametrize("limit", [100.0, 4.0])
def test_laws_in_mujoco_are_those_of_the_core(limit: float) -> None:
    from benchmarks.studies.engine import in_mujoco

    arm, values = (
        Arm.of(scara.STIFF.study(Path(), "linear").arm),
        scara.STIFF.parameters(5, "linear"),
    )
    options = {"sample_time": PERIOD, "samples": 300, "record": ["link_angle", "voltage"]}
    core = simulate(arm, values, drive(limit), **options)  # type: ignore[arg-type]
    mujoco = in_mujoco(arm, values, drive(limit), **options)  # type: ignore[arg-type]
    size = np.abs(core["link_angle"]).max()
    np.testing.assert_allclose(mujoco["link_angle"], core["link_angle"], atol=5e-3 * size)
    assert np.abs(mujoco["voltage"]).max() <= limit


def test_a_delay_moves_the_voltages_by_its_time() -> None:
    from benchmarks.studies.engine import STEP, in_mujoco

    arm, values = (
        Arm.of(scara.STIFF.study(Path(), "linear").arm),
        scara.STIFF.parameters(5, "linear"),
    )
    runs = [
        in_mujoco(
            arm,
            values,
            drive(100.0),
            sample_time=STEP,
            samples=440,
            record=["voltage"],
            delay=delay,
        )["voltage"][:, 0]
        for delay in (0.0, 4e-4)
    ]
    first = [int(np.flatnonzero(np.abs(run) > 1e-9)[0]) for run in runs]
    assert first[1] - first[0] == round(4e-4 / STEP)


def test_a_shaped_reference_is_the_sum_of_delayed_shares() -> None:
    from benchmarks.studies.servo_moves.moves import shaped_reference

    reference = np.eye(6, 1)
    impulses = Impulses(np.array([0.6, 0.4]), np.array([0.0, 2e-3]))
    np.testing.assert_allclose(
        shaped_reference(reference, impulses, PERIOD)[:, 0], [0.6, 0, 0.4, 0, 0, 0]
    )


def test_the_page_has_the_moves_and_loops() -> None:
    from benchmarks.studies.servo_moves.moves import Move
    from benchmarks.studies.servo_moves.page import render
    from benchmarks.studies.servo_moves.sweep import Loop

    time = PERIOD * np.arange(1000, dtype=np.float64)
    share = np.asarray(1.0 - np.exp(-time / 0.02), dtype=np.float64)
    move = Move(1, 0.05, "step", np.asarray(time, dtype=np.float64), share)
    assert move.cells()[:2] == ("0.079", "0")
    assert float(move.cells()[2]) < 1e-6
    omega = np.geomspace(1.0, 1000.0, 400)
    response = np.asarray(10.0 / (1j * omega * (1.0 + 1j * omega / 20.0)), dtype=complex)
    loop = Loop(1, "measured", omega, response)
    page = render([("the arm", [move], "tracked", [loop])])
    assert all(text in page for text in ("0.079", "tracked", "measured", "Joint 1: open loop"))
    assert float(loop.cells()[1]) == pytest.approx(66.0, abs=1.0)
