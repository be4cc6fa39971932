"""Complete runs on drawn arms and lab arms with few or mixed sensors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from benchmarks.studies.arms import draw_rig
from benchmarks.studies.lab import without_link_sensors
from benchmarks.studies.sensors import remove_channels, restrict_sensors

from strainwave.domain import Identification
from strainwave.domain.keys import Values
from strainwave.io.parameters import read_parameters
from strainwave.io.study import read_study
from strainwave.pipeline import identify
from strainwave.virtual.experiments import derived, simulate_study

SEED = 2  # seed of the drawn arm, which has linear gears
OMITTED = ("-held", "-3V", "-6V", "-8V")  # endings of the lab's records that are not needed
_OF_NO_ONE = ("motor_viscous_friction", "link_viscous_friction")  # only their sum is identified


def run(folder: Path, sensors: Sequence[str], seed: int = SEED) -> tuple[Identification, Values]:
    """Result for logs of a drawn arm with a set of sensors, and the true values."""
    rig = restrict_sensors(draw_rig(seed), sensors)
    simulate_study(
        rig.study,
        rig.values,
        folder,
        seed=seed,
        noise=rig.noise,
        as_recorded=False,
        sample_time=rig.sample_time,
    )
    remove_channels(folder, rig, sensors)
    study = read_study(folder / "study.toml")
    return identify(folder / "study.toml"), derived(rig.values, study.arm)


def check(found: Identification, known: Values, close: float) -> None:
    """Check that the result is determined, and that stiffness and inertia errors are small."""
    assert found.verdict.status == "determined", found.verdict.reasons
    assert found.whole_arm is not None
    errors = {
        p.label: abs(p.value / known[p.name, p.joint] - 1.0)
        for p in found.whole_arm.parameters
        if p.value is not None and p.name.startswith(("gear_stiffness", "motor_inertia", "beta"))
    }
    assert len(errors) >= 5
    assert max(errors.values()) < close, errors
    inside = [
        p.ci95[0] <= known[p.name, p.joint] <= p.ci95[1]
        for p in found.whole_arm.parameters
        if p.ci95 is not None and (p.name, p.joint) in known and p.name not in _OF_NO_ONE
    ]
    # of about twenty 95 % intervals, more than four miss the true value with a probability of 1/400
    assert np.sum(~np.array(inside)) <= 4


# tolerances: twice the errors that such sensors give for the built-in arm
@pytest.mark.parametrize(
    ("sensors", "method", "close"),
    [
        (("none",), "motor-response", 0.002),
        (("link1",), "motor-response", 0.002),
        (("link2",), "motor-response", 0.002),
        (("encoder+accelerometer",), "grey-box", 0.002),
        (("torque", "none"), "motor-response", 0.005),
        (("counts500", "none"), "motor-response", 0.01),
        (("1khz", "none"), "motor-response", 0.005),
    ],
    ids=lambda x: "+".join(x) if isinstance(x, tuple) else None,
)
def test_each_set_of_sensors_identifies_a_drawn_arm(
    tmp_path: Path, sensors: tuple[str, ...], method: str, close: float
) -> None:
    result, true_values = run(tmp_path, sensors)
    assert [joint.method for joint in result.joints] == [method] * 2
    check(result, true_values, close)


def test_steps_and_motions_alone_identify_a_drawn_arm(tmp_path: Path) -> None:
    result, true_values = run(tmp_path, ("none", "steps"))
    assert not result.joints  # only the whole-arm fit estimates gears
    check(result, true_values, 0.01)


@pytest.mark.parametrize("arm", ["scara-strainwave-3kg", "vertical-linear-0kg"])
def test_lab_arms_without_link_sensors(tmp_path: Path, shared_data: Path, arm: str) -> None:
    folder = shared_data / "lab" / arm
    without_link_sensors(folder, tmp_path)
    study = read_study(tmp_path / "study.toml")
    fitted = [e for e in study.experiments if not e.name.endswith(OMITTED)]
    study = replace(study, experiments=tuple(fitted))
    result = identify(study, options={"tuning": {"rival_effort": 0.0}})
    true_values = derived(read_parameters(folder / "truth.json"), study.arm)
    assert result.verdict.status == "determined", result.verdict.reasons
    assert result.whole_arm is not None
    assert all(joint.method == "motor-response" for joint in result.joints)
    springs = [p for p in result.whole_arm.parameters if p.name.startswith("gear_stiffness")]
    for p in springs:
        assert p.value == pytest.approx(true_values[p.name, p.joint], rel=0.005), p.label
    inside = [
        p.ci95[0] <= true_values[p.name, p.joint] <= p.ci95[1]
        for p in result.whole_arm.parameters
        if p.ci95 is not None and (p.name, p.joint) in true_values
    ]
    assert np.sum(~np.array(inside)) <= 2
