"""Observers and damped servos in the files of the hand-over."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np

from c_programs import output_of_c
from servo_arms import state_at_rest
from strainwave.domain import FloatArray
from strainwave.dynamics.simulation import simulate_arms
from strainwave.tune.design import ServoDesign
from strainwave.tune.handover.json_document import to_json
from strainwave.tune.handover.texts import to_c_header, to_markdown, to_script
from strainwave.tune.link_measurements import with_places
from strainwave.tune.observer import Observer
from strainwave.tune.verification import (
    PlannedInputs,
    Simulated,
    estimate_link,
    read_runs,
    shortest_plan,
)

_PROGRAM = """
#include <stdio.h>
#include "servo.h"

int main(void) {
  strainwave_observer link = STRAINWAVE_OBSERVER_2;
  double v[4], u, estimate[2], angle, link_angle;
  if (scanf("%lf %lf", &angle, &link_angle) != 2) return 1;
  strainwave_observer_reset(&link, angle, link_angle);
  while (scanf("%lf %lf %lf %lf", &u, &v[1], &v[2], &v[3]) == 4) {
    v[0] = 1e9; /* the input follows the estimate */
    strainwave_observer_estimate(&link, v, estimate);
    v[0] = u;
    strainwave_observer_advance(&link, v);
    printf("%.17g %.17g\\n", estimate[0], estimate[1]);
  }
  return 0;
}
""".replace("\\\\", "\\")


def simulated(design: ServoDesign, one: Observer) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Inputs (n, 4), link motion (n, 2) and motor angle (n,) of joint 2 in a planned move."""
    begin, i = design.conditions[0].posture, one.joint - 1
    plan = shortest_plan(design.arm, begin, begin + 0.05, design.clock.period, design.limits)
    drive = Simulated.of(design.arm, design.limits).follow(design.gains, plan)
    planned = plan.extended(len(drive.reference)).link_angle
    axes = [axis for each in one.measurements for axis in each.axes]
    names = {name for axis in axes for name in axis.quantities}
    runs = simulate_arms(
        with_places(design.arm), [design.arm.values], drive,
        sample_time=drive.tick, samples=len(planned),
        record=["voltage", "motor_angle", "link_angle", "link_velocity", *sorted(names)],
    )  # fmt: skip
    inputs = PlannedInputs.of(design.arm, planned, drive.tick)
    readings = read_runs(runs, one.measurements, i, np.random.default_rng(2))
    readings = readings[0] - inputs.known_readings(one)
    columns = [runs["voltage"][0, :, i], inputs.interaction(one), *readings.T]
    link = np.stack([runs[name][0, :, i] for name in ("link_angle", "link_velocity")], axis=1)
    return np.stack(columns, axis=1), link, runs["motor_angle"][0, :, i]


def test_the_compiled_observer_estimates_a_simulated_link(
    design: ServoDesign, tmp_path: Path
) -> None:
    """The C program, and the observer in Python, on the same log."""
    one = design.observers[1]
    assert len(one.measurements) == 2
    inputs, link, motor = simulated(design, one)
    (tmp_path / "servo.h").write_text(to_c_header(design))
    first = f"{float(motor[0])!r} {float(link[0, 0])!r}\n"
    text = first + "\n".join(" ".join(map(repr, row)) for row in inputs.tolist())
    printed = output_of_c(_PROGRAM, tmp_path, text)
    estimates = np.array([line.split() for line in printed.splitlines()], dtype=float)
    start = state_at_rest(one, motor[0], link[0, 0])[None]
    expected = estimate_link(one, inputs[None, :, 0], inputs[None, :, 2:], inputs[:, 1], start)[0]
    np.testing.assert_allclose(estimates, expected, rtol=0.0, atol=1e-9)
    rigid = motor * one.gear_ratio - link[:, 0]
    error = estimates[:, 0] - link[:, 0]
    assert np.sqrt(np.mean(error**2)) < 0.1 * np.sqrt(np.mean(rigid**2))


_SERVO_PROGRAM = """
#include <stdio.h>
#include "servo.h"

int main(void) {
  strainwave_servo joint = STRAINWAVE_SERVO_1_DAMPED;
  double r, w, y, ff;
  strainwave_servo_reset(&joint, 0.0, 0.0);
  while (scanf("%lf %lf %lf %lf", &r, &w, &y, &ff) == 4)
    printf("%.17g\\n", strainwave_servo_step(&joint, r, w, y, ff));
  return 0;
}
""".replace("\\\\", "\\")


def test_the_compiled_servo_with_feedback_is_its_law(design: ServoDesign, tmp_path: Path) -> None:
    one, rng = design.dampings[0], np.random.default_rng(9)
    assert (one.joint, one.reason) == (1, "")
    inputs = 1e-3 * np.cumsum(rng.normal(size=(300, 4)), axis=0)
    law, x, expected = one.law, np.zeros(len(one.law.A)), []
    for *now, ff in inputs:
        u = law.C @ x + law.D @ now + ff
        limited = np.clip(u, -design.limits[0], design.limits[0])
        new = law.A @ x + law.B @ now + law.E * (limited - ff)
        x = np.where(law.holds & (limited != u), x, new)
        expected.append(limited)
    (tmp_path / "servo.h").write_text(to_c_header(design))
    text = "\n".join(" ".join(map(repr, row)) for row in inputs.tolist())
    printed = output_of_c(_SERVO_PROGRAM, tmp_path, text)
    np.testing.assert_allclose(np.array(printed.split(), float), expected, rtol=1e-9, atol=1e-9)


def test_only_feedback_that_is_used_is_in_the_header(design: ServoDesign) -> None:
    first, *others = design.dampings
    changed = replace(design, dampings=(replace(first, reason="it gains nothing"), *others))
    text = to_c_header(changed)
    assert "SERVO_1_DAMPED" not in text
    assert ("SERVO_2_DAMPED" in text) == (not others[0].reason)


def test_the_document_has_observers_and_damping(design: ServoDesign) -> None:
    document = json.loads(to_json(design))
    for entry, one in zip(document["observers"], design.observers, strict=True):
        for name in "ABCD":
            assert entry[name] == getattr(one.system, name).tolist()
        assert [each["channels"] for each in entry["readings"]] == [
            list(each.channels) for each in one.measurements
        ]
        assert entry["unused"] == list(one.unused)
        assert entry["rms_errors"]["by_observer"] < entry["rms_errors"]["by_motor"]
    for entry, damping in zip(document["damping"], design.dampings, strict=True):
        assert entry["is_used"] == (not damping.reason)
        assert entry["ratio_with"]["least"] == damping.with_feedback[0]
        if not damping.reason:
            assert entry["law"]["A"] == damping.law.A.tolist()


def test_the_texts_have_observers_and_reasons(design: ServoDesign) -> None:
    reason = "it gains nothing"
    dampings = (replace(design.dampings[0], reason=reason), *design.dampings[1:])
    changed = replace(design, dampings=dampings)
    text, script = to_markdown(changed), to_script(changed)
    assert f"Not used: {reason}." in text
    assert "servo(1).damped" not in script
    for one in design.observers:
        assert f"observer({one.joint}).A = [" in script
        for cause in one.unused:
            assert f"Not used: {cause}." in text
        for each in one.measurements:
            assert f"| {each.name} | {', '.join(each.channels)} |" in text
