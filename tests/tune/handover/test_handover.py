"""The table of formats, and files of several formats."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from strainwave.domain import Joint
from strainwave.tune.closed_loop import Gains
from strainwave.tune.design import ServoDesign
from strainwave.tune.handover import FILES
from strainwave.tune.handover.json_document import Units
from strainwave.tune.handover.texts import (
    difference_equations,
    to_c_header,
    to_markdown,
    to_script,
)


def test_numbers_have_no_trace_of_numpy(filtered: ServoDesign) -> None:
    for to_file in FILES.values():
        assert "np.float" not in to_file(filtered)


def test_an_arm_without_shapers_has_every_file(design: ServoDesign) -> None:
    bare = replace(design, shapers=(), modes_hz=np.zeros((0, 2)))
    for to_file in FILES.values():
        assert "haper at" not in to_file(bare)
    assert "shaper" not in to_c_header(bare)


@pytest.mark.parametrize(
    ("joint", "expected"),
    [
        (Joint("rigid", 0.1, torque_per_volt=0.2), ("V s/rad", "V/rad", "N m")),
        (Joint("rigid", 0.1, torque_per_volt="unknown"), ("V s/rad", "V/rad", "N m")),
        (Joint("rigid", 0.1), ("N m s/rad", "N m/rad", "N m")),
        (Joint("rigid", 0.1, "prismatic"), ("N s/m", "N/m", "N")),
    ],
)
def test_units_follow_the_drive(joint: Joint, expected: tuple[str, ...]) -> None:
    units = Units.of(joint)
    assert (units.kp, units.ki, units.torque) == expected


def by_equations(gains: Gains, limit: float, inputs: np.ndarray) -> list[float]:
    """Inputs of the drive by the printed equations, from zero, for rows (r, w, y, ff)."""
    lines = [line for line, _ in difference_equations(gains, limit, Units("rad", "V", "N m"))]
    names = ["e", "s", "u", *(f"g{i}" for i in range(len(gains.filters) + 1))]
    signals = {name: np.zeros(len(inputs) + 2) for name in names}
    padded = np.vstack([np.zeros((2, 4)), inputs]).T
    signals |= dict(zip(("r", "w", "y", "ff"), padded, strict=True))
    for k in range(2, len(inputs) + 2):
        for line in lines:
            exec(line, {"min": min, "max": max}, signals | {"k": k})
        if abs(signals["u"][k]) >= limit:
            signals["s"][k] = signals["s"][k - 1]
    return [float(u) for u in signals["u"][2:]]


def test_the_printed_equations_are_the_law(filtered: ServoDesign) -> None:
    rng = np.random.default_rng(7)
    inputs = 0.04 * rng.standard_normal((300, 4)) * [1.0, 10.0, 1.0, 100.0]
    for gains in filtered.gains:
        law, x, expected = gains.law(), np.zeros(len(gains.law().A)), []
        for *now, ff in inputs:
            wanted = law.C @ x + law.D @ now + ff
            u = float(np.clip(wanted, -filtered.limits[0], filtered.limits[0]))
            held = law.holds & (u != wanted)
            x = np.where(held, x, law.A @ x + law.B @ now + law.E * (u - ff))
            expected.append(u)
        limited = np.mean(np.abs(expected) == filtered.limits[0])
        assert 0.02 < limited < 0.98
        # rounding of sums in another order
        found = by_equations(gains, filtered.limits[0], inputs)
        np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-10)


def test_script_and_text_print_the_equations(filtered: ServoDesign) -> None:
    script, text = to_script(filtered), to_markdown(filtered)
    for each in filtered.joints:
        units = Units.of(filtered.arm.joint(each.joint))
        for equation, remark in difference_equations(each.gains, filtered.limits[0], units):
            assert f"%   {equation}  % {remark}\n" in script
            assert f"    {equation}  # {remark}\n" in text


def test_the_text_has_margins_and_what_limits_them(design: ServoDesign) -> None:
    text = to_markdown(design)
    for each in design.joints:
        margins = each.results.margins
        assert f"| phase [deg] | 30 | {margins.phase_deg.min():.3g} |" in text
        reason = {"encoder": "The resolution of the motor encoder", "margins": "The margins with"}
        assert reason[each.limit] in text
    assert "| 1 | 0.3, -0.4 | none |" in text
