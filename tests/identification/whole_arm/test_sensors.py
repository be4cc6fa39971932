"""Late link sensors and such out of scale, in the whole-arm fit."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from strainwave.domain import ArmModel, Log, Study, TuningOptions
from strainwave.domain.parameters import Values
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.link_sensors import moved
from strainwave.identification.whole_arm import tune
from strainwave.identification.whole_arm.parametrisation import Key
from strainwave.identification.whole_arm.preparation import dataset_of
from tuning_runs import joint_models, rigid_model, shaken

FACTORS = np.random.default_rng(0).choice([-1.0, 1.0], size=(2, 6))
CUTOFF = 80.0


def read_so(log: Log, late: tuple[float, float], scale: tuple[float, float]) -> Log:
    """The log of a rig whose accelerometers are so late [s] and read so many times the motion."""
    channels = dict(log.channels)
    for i in (1, 2):
        ahead = -late[i - 1] / log.sample_time
        channels[f"a{i}"] = scale[i - 1] * moved(channels[f"a{i}"], ahead)
    return replace(log, channels=channels)


@cache
def tuned(
    late: tuple[float, float] = (0.0, 0.0),
    scale: tuple[float, float] = (1.0, 1.0),
    *,
    reported: bool = False,
) -> tuple[Study, Values, ArmModel]:
    study, known, logs = shaken()
    records = [read_so(log, late, scale) for log in logs]
    joints = joint_models(study, known, 0.05, FACTORS)
    begin: dict[Key, float] = {("accelerometer_delay", i): late[i - 1] for i in (1, 2)}
    start = begin if reported else None
    model = tune(
        records, rigid_model(study, known, 0.01, 1.0), joints, Arm.of(study.arm), start=start
    )
    return study, known, model


def constants(model: ArmModel) -> set[Key]:
    return {(p.name, p.joint) for p in model.parameters if p.name.startswith("accelerometer")}


def test_a_clean_rig_has_no_sensor_constants() -> None:
    """So that its intervals are as narrow, and its fit as quick, as without any of this."""
    _, _, model = tuned()
    assert constants(model) == set()
    assert not {c.code for c in model.warnings} & {"sensor-delay", "sensor-scale"}


@pytest.mark.parametrize(
    ("late", "scale", "reported"),
    [
        ((1e-3, 1e-3), (1.0, 1.0), False),
        ((-0.4e-3, 3e-3), (1.0, 1.0), True),
        ((0.0, 0.0), (1.03, 0.95), False),
        ((0.7e-3, 0.0), (0.96, 1.02), False),
    ],
)
def test_late_sensors_and_wrong_scales_are_found_and_corrected(
    late: tuple[float, float], scale: tuple[float, float], reported: bool
) -> None:
    _, known, model = tuned(late, scale, reported=reported)
    assert model.status == "converged"
    found = {(p.name, p.joint): p for p in model.parameters}
    wrong = {("accelerometer_delay", i): d for i, d in enumerate(late, 1) if d}
    wrong |= {("accelerometer_scale", i): s for i, s in enumerate(scale, 1) if s != 1.0}
    assert wrong.keys() <= constants(model)
    for (name, joint), true in (*wrong.items(), *known.items()):
        p = found.get((name, joint))
        if p is None or p.value is None or p.std is None or p.ci95 is None:
            continue
        assert abs(p.value - true) < 4.0 * p.std, (name, joint)
    for key in wrong:
        assert found[key].unit == ("s" if key[0].endswith("delay") else "1")
    # a tenth of a per cent of what 1 ms alone would move gear damping by
    for i in (1, 2):
        damping = found["gear_damping", i].value
        assert damping == pytest.approx(known["gear_damping", i], rel=0.03)
    said = {(c.code, c.where) for c in model.warnings}
    for name, joint in wrong:
        assert (f"sensor-{name.rsplit('_', 1)[1]}", f"joint {joint}") in said


def test_what_is_held_is_not_estimated() -> None:
    study, known, logs = shaken()
    records = [read_so(log, (1e-3, 1e-3), (1.0, 1.0)) for log in logs]
    joints = joint_models(study, known, 0.05, FACTORS)
    options = TuningOptions(hold=("accelerometer_delay 1",))
    model = tune(records, rigid_model(study, known, 0.01, 1.0), joints, Arm.of(study.arm), options)
    found = constants(model)
    assert ("accelerometer_delay", 1) not in found
    assert ("accelerometer_delay", 2) in found


def test_an_end_of_the_range_is_a_bound() -> None:
    _, _, model = tuned((0.0, 0.0), (1.25, 1.0))
    assert model.status == "at-bounds"
    assert "accelerometer_scale of joint 1" in {
        c.where for c in model.warnings if c.code == "at-bounds"
    }


def test_derivatives_are_those_of_the_difference() -> None:
    """Of simulated less measured channels, where both agree: on a noise-free record."""
    study, known, logs = shaken(noisy=False, counts=False)
    values = dict(known)
    late, scale = 0.6e-3, 1.03
    record = dataset_of(read_so(logs[0], (late, late), (scale, 1.0)), Arm.of(study.arm), CUTOFF)
    values |= {("accelerometer_delay", 1): late, ("accelerometer_delay", 2): late}
    values["accelerometer_scale", 1] = scale
    keys: list[Key] = [
        ("accelerometer_delay", 1),
        ("gear_stiffness", 1),
        ("accelerometer_scale", 1),
        ("accelerometer_delay", 2),
    ]

    def difference(changed: Values) -> np.ndarray:
        return record.linearised(changed, np.zeros(0), [])[0] - record.observed(changed)

    _, tangent = record.linearised(values, np.zeros(0), keys)
    for k, key in enumerate(keys):
        h = {"gear_stiffness": 5.0}.get(key[0], 2e-5)
        ends = [difference({**values, key: values[key] + sign * h}) for sign in (1.0, -1.0)]
        slope = (ends[0] - ends[1]) / (2.0 * h)
        # what the measured slope has beside the simulated one: the integrator's error
        size = np.max(np.abs(slope))
        assert np.max(np.abs(tangent[..., k] - slope)[10:-10]) < 0.02 * size, key


def test_a_scale_that_is_nothing_does_not_stay() -> None:
    study, known, _ = shaken()
    joints = joint_models(study, known, 0.05, FACTORS)
    rigid = rigid_model(study, known, 0.01, 1.0)
    start: dict[Key, float] = {("accelerometer_scale", 1): 1.0}
    model = tune(shaken()[2], rigid, joints, Arm.of(study.arm), start=start)
    assert constants(model) == set()
