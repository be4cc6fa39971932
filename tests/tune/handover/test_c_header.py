"""The compiled servo and shaper against the control law and a convolution in Python."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from c_programs import output_of_c
from servo_arms import correct, predict, state_at_rest
from strainwave.domain import ControlLaw, FloatArray
from strainwave.tune.closed_loop import Gains
from strainwave.tune.design import ServoDesign
from strainwave.tune.handover.texts import to_c_header

SAMPLES = 2000
START = (0.7, -1.2)  # motor angle [rad], voltage [V] at rest

_PROGRAM = """
#include <math.h>
#include <stdio.h>
#include "servo.h"
#include "servo.h"

int main(void) {
  strainwave_servo joints[] = {STRAINWAVE_SERVO_1, STRAINWAVE_SERVO_2};
  strainwave_shaper shaper;
  double r, w, y, ff;
  strainwave_servo_reset(&joints[0], 0.7, -1.2);
  strainwave_servo_reset(&joints[1], 0.7, -1.2);
  strainwave_shaper_reset(&shaper, 0.7);
  while (scanf("%lf %lf %lf %lf", &r, &w, &y, &ff) == 4)
    printf("%.17g %.17g %.17g\\n", strainwave_servo_step(&joints[0], r, w, y, ff),
           strainwave_servo_step(&joints[1], r, w, y, ff), strainwave_shaper_step(&shaper, r));
  return fabs(strainwave_servo_period - 1e-3) < 1e-15 ? 0 : 1;
}
"""


class Observing(Gains):
    """Gains whose law has a further state, a low-pass of the voltage that the output contains."""

    def law(self) -> ControlLaw:
        law = Gains.law(self)
        n = len(law.A)
        A = np.zeros((n + 1, n + 1))
        A[:n, :n], A[n, n] = law.A, 0.9
        return ControlLaw(
            A,
            np.vstack([law.B, np.zeros(3)]),
            np.append(law.C, -0.2),
            law.D,
            np.append(law.E, 0.1),
            np.append(law.holds, False),
            (*law.names, "voltage"),
        )


@pytest.fixture(scope="module")
def observing(filtered: ServoDesign) -> ServoDesign:
    """The second joint has a law that depends on the limited voltage."""
    first, second = filtered.joints
    g = second.gains
    gains = Observing(g.kp, g.ki, g.position_gain, g.period)
    return replace(filtered, joints=(first, replace(second, gains=gains)))


def signals(period: float) -> FloatArray:
    """Rows (r, w, y, feed-forward); the motor follows the reference with an error and noise."""
    rng = np.random.default_rng(11)
    time = period * np.arange(SAMPLES)
    w = 4.0 * np.sin(9.0 * time)
    r = START[0] + period * np.concatenate([[0.0], np.cumsum(w[:-1])])
    y = r - 1.2 * np.sin(14.0 * time) + 1e-3 * rng.standard_normal(SAMPLES)
    return np.column_stack([r, w, y, 3.0 * np.sin(5.0 * time)])


def by_hand(law: ControlLaw, inputs: FloatArray, limit: float) -> FloatArray:
    """Voltages of a law, in plain loops."""
    n = len(law.A)
    rest = law.rest()
    x = [float(rest[i] @ START) for i in range(n)]
    voltages = []
    for *now, ff in inputs.tolist():
        u = ff
        for j in range(3):
            u += law.D[j] * now[j]
        for i in range(n):
            u += law.C[i] * x[i]
        is_limited = abs(u) > limit
        u = float(np.clip(u, -limit, limit))
        new = []
        for i in range(n):
            moved = law.E[i] * (u - ff)
            for j in range(3):
                moved += law.B[i, j] * now[j]
            for j in range(n):
                moved += law.A[i, j] * x[j]
            new.append(x[i] if is_limited and law.holds[i] else moved)
        x = new
        voltages.append(u)
    return np.array(voltages)


def run(design: ServoDesign, inputs: FloatArray, folder: Path) -> FloatArray:
    """Columns that a strictly compiled program with the header prints."""
    (folder / "servo.h").write_text(to_c_header(design))
    text = "\n".join(" ".join(map(repr, row)) for row in inputs.tolist())
    printed = output_of_c(_PROGRAM, folder, text)
    return np.array([line.split() for line in printed.splitlines()], dtype=float)


def test_the_compiled_servo_is_the_law(observing: ServoDesign, tmp_path: Path) -> None:
    inputs = signals(observing.clock.period)
    printed = run(observing, inputs, tmp_path)
    for i, gains in enumerate(observing.gains):
        expected = by_hand(gains.law(), inputs, observing.limits[0])
        share = np.mean(np.abs(expected) == observing.limits[0])
        assert 0.1 < share < 0.9
        np.testing.assert_allclose(printed[:, i], expected, rtol=0.0, atol=1e-12)
    weights = observing.shapers[0].impulses.amplitudes
    padded = np.concatenate([np.full(len(weights), START[0]), inputs[:, 0]])
    shaped = np.convolve(padded, weights)[len(weights) : len(padded)]
    np.testing.assert_allclose(printed[:, 2], shaped, rtol=0.0, atol=1e-14)


def test_the_reset_holds_angle_and_voltage(design: ServoDesign, tmp_path: Path) -> None:
    inputs = np.tile([START[0], 0.0, START[0], 0.0], (50, 1))
    printed = run(design, inputs, tmp_path)
    np.testing.assert_allclose(printed[:, :2], START[1], atol=1e-9)
    np.testing.assert_allclose(printed[:, 2], START[0], atol=1e-14)


def test_names_cannot_end_a_comment(design: ServoDesign) -> None:
    arm = design.arm.study.arm.with_joint(1, name="a*/b")
    source = replace(design.arm, study=replace(design.arm.study, arm=arm))
    assert "a* /b" in to_c_header(replace(design, arm=source))


_OBSERVER_PROGRAM = """
#include <stdio.h>
#include "servo.h"

int main(void) {
  strainwave_observer link = STRAINWAVE_OBSERVER_2;
  double v[4], u, estimate[2];
  strainwave_observer_reset(&link, 0.5, 0.01);
  while (scanf("%lf %lf %lf %lf", &u, &v[1], &v[2], &v[3]) == 4) {
    v[0] = 1e9; /* the input follows the estimate */
    strainwave_observer_estimate(&link, v, estimate);
    v[0] = u;
    strainwave_observer_advance(&link, v);
    printf("%.17g %.17g\\\\n", estimate[0], estimate[1]);
  }
  return 0;
}
""".replace("\\\\", "\\")


def test_the_compiled_observer_is_the_recursion(design: ServoDesign, tmp_path: Path) -> None:
    observer = design.observers[1]
    assert [one.name for one in observer.measurements] == ["motor encoder", "accelerometer"]
    rng = np.random.default_rng(8)
    inputs = rng.normal(size=(300, 4)) * [1.0, 2.0, 0.1, 0.3]
    x, expected = state_at_rest(observer, 0.5, 0.01), []
    for voltage, torque, *readings in inputs:
        estimate = correct(observer, x, np.array(readings), torque)
        expected.append(estimate[2:4])
        x = predict(observer, estimate, voltage, torque)
    (tmp_path / "servo.h").write_text(to_c_header(design))
    text = "\n".join(" ".join(map(repr, row)) for row in inputs.tolist())
    printed = output_of_c(_OBSERVER_PROGRAM, tmp_path, text)
    found = np.array([line.split() for line in printed.splitlines()], dtype=float)
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-12)


def test_the_damped_law_is_a_servo_of_its_own(design: ServoDesign) -> None:
    text = to_c_header(design)
    for one in design.dampings:
        assert (f"SERVO_{one.joint}_DAMPED" in text) == (not one.reason)
