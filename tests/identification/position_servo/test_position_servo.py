"""Position servos: the simulated law, recovery with honest intervals, and refusals."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import strainwave as sw
from strainwave.domain import (
    ArmDescription,
    Experiment,
    Joint,
    Payload,
    PositionServo,
    Study,
)
from strainwave.domain.arm.description import UNKNOWN, Unknown
from strainwave.domain.arm.kinds import single_joint
from strainwave.domain.keys import FloatArray, Key, Values
from strainwave.dynamics.arm import Arm
from strainwave.errors import InvalidInput
from strainwave.identification.position_servo.loop import ServoLoop
from strainwave.identification.position_servo.records import (
    ReferenceHold,
    Segment,
    ServoRecord,
    common_period,
)
from strainwave.virtual.position_servos import record_servo

KP, SAMPLE_TIME, PERIOD = 12.0, 0.005, 0.002
COUNTS = 4096.0
TRUTH: Mapping[Key, float] = {
    ("inertia", 1): 0.012,
    ("gravity_torque_1", None): 0.5,
    ("motor_coulomb_friction", 1): 0.04,
    ("friction_offset", 1): 0.0,
    ("motor_viscous_friction", 1): 0.05,
    ("servo_kp", 1): KP,
    ("servo_kd", 1): 0.15,
    ("servo_damping", 1): 0.2,
    ("servo_delay", 1): 0.013,  # the middle of the cell of 1 ms that 5 ms and 2 ms leave open
    ("torque_limit", 1): 2.0,
}
LOADS = {
    "loaded": Payload(0.15, (0.2, 0.0, 0.0)),
    "light": Payload(0.001, (0.2, 0.0, 0.0)),  # 0.002 N m of 0.5 N m
}


def servo_arm(kp: float | Unknown = KP, kd: float | Unknown = UNKNOWN) -> ArmDescription:
    servo = PositionServo("position", PERIOD, (kp,), (kd,))
    arm = single_joint(Joint("rigid", 1.0, encoder_counts=COUNTS, effects=()), 9.81)
    return replace(arm, position_servo=servo)


def commands(seed: int, duration: float = 8.0) -> FloatArray:
    """Slow waves with faster ones on top, and steps that reach the torque limit."""
    rng = np.random.default_rng(seed)
    time = SAMPLE_TIME * np.arange(round(duration / SAMPLE_TIME))
    lines = np.array([0.25, 0.6, 1.1, 1.9, 3.1, 4.3])
    sizes = np.array([0.3, 0.2, 0.1, 0.06, 0.04, 0.03])
    phases = rng.uniform(0.0, 2.0 * np.pi, 6)
    waves = np.sin(2.0 * np.pi * np.outer(time, lines) + phases) @ sizes
    return np.asarray(waves + 0.25 * np.sign(np.sin(1.7 * time)))


def slow_commands(seed: int) -> FloatArray:
    """Waves of 0.04 to 0.12 Hz; the arm falls into its first position."""
    rng = np.random.default_rng(seed)
    time = SAMPLE_TIME * np.arange(round(20.0 / SAMPLE_TIME))
    waves = np.sin(2.0 * np.pi * np.outer(time, [0.04, 0.08, 0.12]) + rng.uniform(0.0, 6.28, 3))
    return np.asarray(0.2 * waves.sum(axis=1))


def virtual_logs(
    arm: ArmDescription,
    seeds: Mapping[str, int],
    commanded: Callable[[int], FloatArray] = commands,
    truth: Mapping[Key, float] = TRUTH,
) -> tuple[Study, dict[str, dict[str, FloatArray]]]:
    """A study of records, with the loads of their names, and their logs."""
    experiments = tuple(
        Experiment(name, "", "motion", ("servo",), payload=LOADS.get(name)) for name in seeds
    )
    study, data = Study(arm=arm, experiments=experiments), {}
    assert arm.position_servo is not None
    loop = ServoLoop(Arm.of(arm), arm.position_servo, ReferenceHold.HELD)
    values: Values = {**truth, ("velocity_lag", 1): 1.0}
    for experiment in experiments:
        reference = commanded(seeds[experiment.name])[:, None]
        time: FloatArray = SAMPLE_TIME * np.arange(len(reference), dtype=np.float64)
        record = ServoRecord(
            experiment.name, time, reference, 0.0 * reference, reference, experiment.payload
        )
        start = np.array([reference[0, 0], 0.0])
        run = loop.simulate(loop.prepare(values, record), Segment(record, 0, len(time)), start)
        count = 2.0 * np.pi / COUNTS
        angle = count * np.round(run.angle[:, 0] / count)
        data[experiment.name] = {"t": time, "ref1": reference[:, 0], "theta_m1": angle}
    return study, data


def test_the_law_without_friction_is_the_exact_discrete_one() -> None:
    """A held PD law on a free inertia: its difference equation, solved exactly."""
    inertia, kd = 0.012, 0.15
    arm = Arm.of(replace(servo_arm(), gravity=None))
    values: Values = dict(TRUTH) | {
        ("inertia", 1): inertia,
        ("motor_coulomb_friction", 1): 0.0,
        ("motor_viscous_friction", 1): 0.0,
        ("servo_kd", 1): kd,
        ("servo_delay", 1): 0.0,
        ("torque_limit", 1): 1e3,
        ("velocity_lag", 1): 1.0,
    }
    time: FloatArray = PERIOD * np.arange(400, dtype=np.float64)
    reference = np.where(time > 0.1, 0.3, 0.0)[:, None]
    record = ServoRecord("step", time, reference, 0.0 * reference, reference, None)
    assert arm.position_servo is not None
    loop = ServoLoop(arm, arm.position_servo, ReferenceHold.LINEAR)
    run = loop.simulate(loop.prepare(values, record), Segment(record, 0, len(time)), np.zeros(2))
    angle, velocity, last, exact = 0.0, 0.0, 0.0, []
    for target in reference[:, 0]:
        exact.append(angle)
        torque = KP * (target - angle) - kd * (angle - last) / PERIOD
        last = angle
        angle += velocity * PERIOD + 0.5 * torque / inertia * PERIOD**2
        velocity += torque / inertia * PERIOD
    # rounding alone: the torque is constant in a period, for which the integrator is exact
    np.testing.assert_allclose(run.angle[:, 0], exact, atol=1e-9)


def test_a_slow_motion_leaves_delay_and_inertia_open() -> None:
    """A delay acts as damping kp * delay, and the torque of the inertia is below a count."""
    study, data = virtual_logs(servo_arm(), {"one": 1}, slow_commands)
    log = data["one"]
    settled = log["t"] > 1.0
    cut = {name: values[settled] for name, values in log.items()}
    result = sw.identify(study, data={"one": cut | {"t": cut["t"] - cut["t"][0]}})
    for name in ("servo_delay", "inertia", "servo_damping", "motor_coulomb_friction"):
        low, high = result[name, 1].ci95 or (-np.inf, np.inf)
        assert low < TRUTH[name, 1] < high, name
        assert high - low > 0.006 or name != "servo_delay"
    assert result["motor_coulomb_friction", 1].value == pytest.approx(0.04, rel=0.05)


@pytest.mark.parametrize("known", ["kp", "load", "nothing"])
def test_recovers_a_servo(known: str) -> None:
    seeds = {"one": 1, "two": 2, "loaded": 3} if known == "load" else {"one": 1, "two": 2}
    study, data = virtual_logs(servo_arm(KP if known == "kp" else UNKNOWN), seeds)
    result = sw.identify(study, data=data)
    assert result.verdict.status == "determined"
    for (name, joint), true in TRUTH.items():
        per = KP if known == "nothing" and name != "servo_delay" else 1.0
        if name == "servo_kp" and known != "load":
            if known == "nothing":
                assert result[name, joint].value is None
            continue
        parameter = result[name, joint]
        assert parameter.ci95 is not None, name
        low, high = parameter.ci95
        # an interval of 95 % widened by half: ten parameters in three studies must all pass
        centre, half = 0.5 * (low + high), 0.75 * (high - low)
        assert abs(true / per - centre) < half, (name, true / per, parameter)
        assert parameter.per == ("kp" if per == KP else None)
    codes = {warning.code for warning in result.warnings}
    assert ("servo-undetermined" in codes) == (known == "nothing")


def test_values_share_the_error_of_their_scale() -> None:
    """A light weight determines the scale to some percent, and ratios are ten times as exact."""
    study, data = virtual_logs(servo_arm(UNKNOWN), {"one": 1, "two": 2, "light": 3})
    result = sw.identify(study, data=data)
    joint = result.covariance
    assert joint is not None
    stds = [result[name].std for name in joint.names]
    np.testing.assert_allclose(np.sqrt(np.diag(joint.matrix)), np.array(stds, dtype=float))
    assert np.linalg.eigvalsh(joint.correlation)[0] > -1e-9
    correlation, at = joint.correlation, joint.names.index
    gain = at("servo_kp 1")
    for name in ("inertia 1", "gravity_torque_1", "torque_limit 1"):
        assert correlation[at(name), gain] > 0.95, name
    assert abs(correlation[at("servo_delay 1"), gain]) < 0.3


@pytest.mark.parametrize("factor", [1.0, 0.8])
def test_a_payload_checks_the_stated_gain(factor: float) -> None:
    """Values are those with the stated gain, without errors by the contradiction."""
    study, data = virtual_logs(servo_arm(), {"one": 1, "loaded": 3})
    servo = PositionServo("position", PERIOD, (factor * KP,), (UNKNOWN,))
    study = replace(study, arm=replace(study.arm, position_servo=servo))
    result = sw.identify(study, data=data)
    messages = [w.message for w in result.warnings if w.code == "servo-gain-contradicted"]
    assert len(messages) == (factor != 1.0)
    for message in messages:
        match = re.search(r"\((.+) to (.+)\), and the stated one is (.+?)[;,:|]", message)
        assert match is not None
        low, high, stated = map(float, match.groups())
        assert low < KP < high
        assert stated == pytest.approx(factor * KP)
    inertia = result["inertia", 1]
    assert inertia.value is not None
    assert inertia.std is not None
    assert abs(inertia.value - factor * TRUTH["inertia", 1]) < 3.0 * inertia.std


def test_a_known_kd_separates_friction_from_it() -> None:
    """Without steps the output reaches no limit, where the two differ."""
    small = dict(TRUTH) | {("torque_limit", 1): 50.0}
    cases: list[tuple[float | Unknown, bool]] = [(0.15, True), (UNKNOWN, False)]
    for kd, is_known in cases:
        study, data = virtual_logs(servo_arm(KP, kd), {"one": 1, "two": 2}, truth=small)
        result = sw.identify(study, data=data)
        viscous = result["motor_viscous_friction", 1]
        assert (viscous.value is not None) == is_known
        assert result["torque_limit", 1].value is None
        assert result["servo_damping", 1].value == pytest.approx(0.2, rel=0.03)
    assert "motor_viscous_friction 1" not in str(result.verdict.identified)


def test_a_virtual_run_repeats_the_commands(tmp_path: Path) -> None:
    study, data = virtual_logs(servo_arm(), {"one": 1})
    np.savetxt(
        tmp_path / "one.csv",
        np.column_stack(list(data["one"].values())),
        delimiter=",",
        header="t,ref1,theta_m1",
        comments="",
    )
    experiment = replace(study.experiments[0], file="one.csv")
    on_disk = replace(study, path=tmp_path / "study.toml", experiments=(experiment,))
    rng = np.random.default_rng(0)
    columns = record_servo(on_disk, Arm.of(study.arm), experiment, dict(TRUTH), rng)
    np.testing.assert_allclose(columns["ref1"], data["one"]["ref1"])
    # the log has the same law, so that only rounding to counts differs
    count = 2.0 * np.pi / COUNTS
    assert np.max(np.abs(columns["theta_m1"] - data["one"]["theta_m1"])) <= 1.001 * count


def test_refuses_a_command_that_is_the_position() -> None:
    study, data = virtual_logs(servo_arm(), {"one": 1})
    data["one"]["ref1"] = data["one"]["theta_m1"]
    with pytest.raises(InvalidInput, match="never differs from the position"):
        sw.identify(study, data=data)


def test_a_motion_of_few_counts_determines_nothing() -> None:
    study, data = virtual_logs(servo_arm(), {"one": 1})
    count = 2.0 * np.pi / COUNTS
    data["one"]["theta_m1"] = count * np.round(2.0 * data["one"]["theta_m1"])
    result = sw.identify(study, data=data)
    assert result.verdict.status == "not-determined"
    assert "counts of its encoder" in (result.reason or "")


@pytest.mark.parametrize(
    ("servo", "message"),
    [
        ({"kp": (1.0, 2.0)}, "'kp' has 2 value"),
        ({"limit": (1.0, 2.0)}, "'limit' has 2 value"),
        ({"delay": (0.01, 0.01)}, "'delay' has 2 value"),
        ({"output": "current"}, "'torque_constant' is missing"),
        ({"stall_torque": (1.0,)}, "'stall_torque' is given"),
        ({"kind": "pid"}, "'kind' is 'pid'"),
        ({"kp": ("none",)}, "'kp' is"),
        ({"delay": 0.3}, "outside the range"),
    ],
)
def test_refuses_a_wrong_servo(servo: dict[str, object], message: str, tmp_path: Path) -> None:
    import tomli_w

    table = {"kind": "position", "period": 0.002, "kp": [1.0], "kd": ["unknown"]} | servo
    document = {
        "arm": {"kind": "single-joint"},
        "joint": [{"spring": "rigid", "gear_ratio": 1.0}],
        "servo": table,
        "experiment": [{"name": "a", "file": "a.csv", "use": "motion", "control": ["servo"]}],
    }
    path = tmp_path / "study.toml"
    path.write_text(tomli_w.dumps(document))
    with pytest.raises(InvalidInput, match=message) as error:
        sw.read_study(path)
    assert "study.toml" in str(error.value)


def test_common_periods_of_clocks() -> None:
    assert common_period(0.002, 0.005) == pytest.approx(0.001)
    assert common_period(0.005, 0.005) == pytest.approx(0.005)
    assert common_period(0.001, 0.02) == pytest.approx(0.001)
    assert common_period(0.002, 0.00317) == pytest.approx(0.00025)  # no common one


def test_a_shared_servo_is_within_its_intervals(shared_data: Path, tmp_path: Path) -> None:
    """Servo of an independent simulator, with soft friction: within three standard deviations."""
    folder = shared_data.parent / "servos" / "servo-11-3"
    if not folder.exists():
        pytest.skip("no ../shared/servos beside the project")
    result = sw.identify(folder / "study.toml")
    truth = json.loads((folder / "truth.json").read_text())
    checked = 0
    for parameter in result.parameters:
        if parameter.name in truth and parameter.value is not None and parameter.std:
            checked += 1
            error = abs(parameter.value - truth[parameter.name]) / parameter.std
            assert error < 3.0, (parameter.name, error)
    assert checked >= 8
    page = tmp_path / "report.html"
    result.report(page)
    text = page.read_text(encoding="utf-8")
    assert "servo loop, angles" in text
    assert "Not validated" not in text


def test_recovers_the_gear_of_an_elastic_joint() -> None:
    truth = {
        ("motor_share", 1): 0.4,
        ("gear_stiffness", 1): 60.0,
        ("gear_damping", 1): 0.02,
    }
    elastic = servo_arm().with_joint(1, spring="linear")
    study, data = virtual_logs(elastic, {"one": 1, "two": 2}, truth=dict(TRUTH) | truth)
    result = sw.identify(study, data=data)
    inertia = TRUTH["inertia", 1]
    for name, true in (
        ("gear_stiffness", 60.0),
        ("motor_inertia", 0.4 * inertia),
        ("link_inertia", 0.6 * inertia),
    ):
        parameter = result[name, 1]
        assert parameter.value is not None
        assert parameter.std is not None
        # three standard deviations, of a value that records of 16 s determine to some percent
        assert abs(parameter.value - true) < 3.0 * parameter.std
        assert parameter.std < 0.03 * true
