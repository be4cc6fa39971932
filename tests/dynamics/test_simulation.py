from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from strainwave.domain import Experiment, FloatArray, Prbs, Study
from strainwave.domain.arm.kinds import change_arm_keys
from strainwave.domain.arm.link_sensors.link_space import Quantity
from strainwave.domain.keys import Values
from strainwave.dynamics.arm import MAX_TIME_STEP, Arm
from strainwave.dynamics.simulation import (
    Drive,
    SensorNoise,
    Trajectory,
    common_step,
    measure,
    simulate,
    simulate_arms,
)
from strainwave.errors import InvalidInput, NumericalFailure
from strainwave.io import logs
from strainwave.io.parameters import read_parameters
from strainwave.io.study import read_study
from strainwave.virtual import experiments as virtual
from strainwave.virtual import scara


def drive(samples: int, volts: float = 3.0) -> Drive:
    voltage = np.zeros((samples, 2))
    voltage[:, 0] = volts
    return Drive(1e-3, voltage, np.zeros_like(voltage), (False, False), (0.0, 0.0), (0.0, 0.0))


def fit(measured: FloatArray, simulated: FloatArray) -> float:
    scale = np.linalg.norm(measured - measured.mean())
    return float(100.0 * (1.0 - np.linalg.norm(measured - simulated) / scale))


def test_a_constant_voltage_accelerates_the_whole_arm() -> None:
    study, values = scara.STIFF.study(Path()), scara.STIFF.parameters()
    run = simulate(
        Arm.of(study.arm),
        values,
        drive(2001),
        sample_time=1e-3,
        samples=2001,
        record=["link_angle"],
    )
    # motor 1 drives with 0.24 N m minus 0.06 N m friction, 18 N m at the link
    assert run["link_angle"][-1, 0] > 1.0
    assert run.time[-1] == pytest.approx(2.0)


def test_missing_parameters_are_rejected_by_name() -> None:
    study = scara.STIFF.study(Path())
    arm = Arm.of(study.arm)
    vector = arm.parameter_vector(scara.STIFF.parameters())
    named = dict(zip(arm.parameter_names, vector, strict=True))
    assert named["gear_knee_t2", 1] == 25.0
    assert named["gravity_torque_1", None] == 0.0
    incomplete = scara.STIFF.parameters()
    del incomplete["gear_damping", 2]
    with pytest.raises(InvalidInput, match="missing parameters: gear_damping of joint 2"):
        arm.parameter_vector(incomplete)


def test_impossible_parameters_are_rejected_by_name() -> None:
    study = scara.STIFF.study(Path())
    cases: list[tuple[Values, str]] = [
        ({("motor_inertia", 1): -1.0}, "motor_inertia of joint 1 is -1, but must be positive"),
        ({("gamma", None): 5.0}, "gamma is 5, but must be smaller"),
        ({("gear_knee_t2", 1): 1.0}, "gear_knee_t2 of joint 1 is 1, but must be above"),
    ]
    for change, message in cases:
        values = scara.STIFF.parameters() | change
        with pytest.raises(InvalidInput, match=message):
            simulate(
                Arm.of(study.arm),
                values,
                drive(20),
                sample_time=1e-3,
                samples=20,
                record=["encoder"],
            )


def test_a_rigid_arm_is_simulated_from_its_rigid_model() -> None:
    study = scara.STIFF.study(Path(), "rigid")
    whole = scara.STIFF.parameters(spring="rigid")
    known = virtual.derived(whole, study.arm)
    sums = {
        name: known[name]
        for name in known
        if name[0] not in ("alpha", "motor_viscous_friction", "link_viscous_friction")
        and name != ("motor_inertia", 1)
    }
    record: list[Quantity] = ["link_angle"]
    runs = [
        simulate(
            Arm.of(study.arm), values, drive(400), sample_time=1e-3, samples=400, record=record
        )
        for values in (whole, sums)
    ]
    np.testing.assert_allclose(runs[0]["link_angle"], runs[1]["link_angle"], atol=1e-10)


def test_a_link_may_have_all_inertia_behind_a_rigid_gear() -> None:
    """Consistent bodies of measured arms leave no inertia for some rotors."""
    study = scara.STIFF.study(Path(), "rigid")
    values = scara.STIFF.parameters(spring="rigid")
    record: list[Quantity] = ["link_angle"]
    runs = [
        simulate(
            Arm.of(study.arm),
            values | {("motor_inertia", 2): rotor},
            drive(400),
            sample_time=1e-3,
            samples=400,
            record=record,
        )["link_angle"]
        for rotor in (0.0, 1e-12)
    ]
    assert np.ptp(runs[0]) > 0.01
    np.testing.assert_allclose(runs[0], runs[1], atol=1e-6)


def test_the_payload_determines_the_inertia() -> None:
    # base parameters of the rig at 0, 3 and 5 kg
    for disks, alpha, beta, gamma in [
        (0, 0.9972, 0.188, 0.2625),
        (3, 1.3647, 0.46175, 0.5775),
        (5, 1.6097, 0.64425, 0.7875),
    ]:
        values = scara.STIFF.parameters(disks)
        base = [values[name, None] for name in ("alpha", "beta", "gamma")]
        np.testing.assert_allclose(base, [alpha, beta, gamma], rtol=1e-12)
    with pytest.raises(InvalidInput, match="6 disks"):
        scara.STIFF.parameters(6)


@pytest.mark.parametrize(
    ("clocks", "step"),
    [
        ([1e-3, 1e-3], 1.25e-4),
        ([1e-3, 2.5e-4], 1.25e-4),
        ([1e-3, 1.5e-3], 1.25e-4),
        ([0.02], 1.25e-4),
    ],
)
def test_the_step_divides_every_clock(clocks: list[float], step: float) -> None:
    assert common_step(clocks) == pytest.approx(step)


def test_the_fastest_resonance_matches_the_eigenvalues() -> None:
    """One joint in closed form; two joints against the eigenvalues of the stretched and folded arm."""
    study, values = scara.STIFF.study(Path(), "linear"), scara.STIFF.parameters(0, "linear")
    one = replace(study, arm=replace(study.arm, kind="single-joint", joints=study.arm.joints[:1]))
    motor, link, k, n = 1.5e-3, 3.0, 2e4, study.arm.joints[0].gear_ratio
    alone: Values = {("motor_inertia", 1): motor, ("link_inertia", 1): link}
    alone["gear_stiffness", 1] = k
    expected = np.sqrt(k * (1.0 / link + n**2 / motor)) / (2.0 * np.pi)
    assert Arm.of(one.arm).fastest_resonance(alone) == pytest.approx(expected, rel=1e-12)
    alpha, beta, gamma = (values[name, None] for name in ("alpha", "beta", "gamma"))
    highest = 0.0
    for cosine in np.linspace(-1.0, 1.0, 21):
        coupled = beta + gamma * cosine
        links = np.array([[alpha + beta + 2.0 * gamma * cosine, coupled], [coupled, beta]])
        referred = [
            values["motor_inertia", i] / study.arm.joints[i - 1].gear_ratio ** 2 for i in (1, 2)
        ]
        spring = np.diag([values["gear_stiffness", i] for i in (1, 2)])
        flexible = (np.linalg.inv(links) + np.diag(1.0 / np.array(referred))) @ spring
        roots = np.linalg.eigvals(flexible).real
        highest = max(highest, float(np.sqrt(np.max(roots))) / (2.0 * np.pi))
    arm = Arm.of(study.arm)
    assert arm.fastest_resonance(values) == pytest.approx(highest, rel=1e-9)
    assert arm.fastest_resonance({}) == 0.0


def test_the_stable_step_of_one_joint_follows_its_pole() -> None:
    study = scara.STIFF.study(Path(), "linear")
    joint = study.arm.joints[0]
    one = Arm.of(replace(study.arm, kind="single-joint", joints=(joint,)))
    motor, link, k, d = 1.5e-3, 3.0, 2e4, 5.0
    values: Values = {("motor_inertia", 1): motor, ("link_inertia", 1): link}
    values |= {("gear_stiffness", 1): k, ("gear_damping", 1): d}
    per_inertia = 1.0 / link + joint.gear_ratio**2 / motor
    poles = np.roots([1.0, d * per_inertia, k * per_inertia])
    step = one.stable_time_step(values, np.zeros((1, 1)))
    assert step == pytest.approx(2.0 / np.abs(poles).max(), rel=1e-9)
    rigid = Arm.of(
        replace(study.arm, kind="single-joint", joints=(replace(joint, spring="rigid"),))
    )
    assert rigid.stable_time_step(values, np.zeros((1, 1))) == np.inf
    assert one.stable_time_step({}, np.zeros((1, 1))) == np.inf


def test_the_integrator_is_stable_at_the_stable_step_and_not_far_above() -> None:
    """A stiff, lightly damped joint, for which the usual step is too long."""
    study, values = scara.STIFF.study(Path(), "linear"), scara.STIFF.parameters(0, "linear")
    arm, stiff = Arm.of(study.arm), dict(values)
    for joint in (1, 2):
        stiff["gear_stiffness", joint] *= 1e3
        stiff["gear_damping", joint] = 1e-3
    step = arm.stable_time_step(stiff, np.array([[0.0, 0.0], [0.0, np.pi]]))
    assert step < 0.5e-3

    def largest(longest: float) -> float:
        run = simulate_arms(
            arm,
            [stiff],
            drive(400),
            sample_time=1e-3,
            samples=400,
            record=("torsion",),
            max_time_step=longest,
        )
        return float(np.abs(run["torsion"]).max())

    fine = largest(0.1 * step)
    assert largest(step) < 3.0 * fine
    with pytest.raises(NumericalFailure, match="diverged"):
        largest(2.0 * step)


def test_the_time_step_resolves_the_fastest_resonance() -> None:
    """Ten times the stiffness; the error against much shorter steps is below the sensor resolution."""
    study, values = scara.STIFF.study(Path(), "linear"), scara.STIFF.parameters(0, "linear")
    arm = Arm.of(study.arm)
    assert arm.max_time_step(values) == MAX_TIME_STEP
    stiff = dict(values)
    for joint in (1, 2):
        stiff["gear_stiffness", joint] *= 10.0
    step = arm.max_time_step(stiff)
    assert step == pytest.approx(1.0 / (120.0 * arm.fastest_resonance(stiff)))
    record: tuple[Quantity, ...] = ("motor_angle", "accelerometer")
    pushed = drive(200)

    def run(longest: float) -> dict[Quantity, FloatArray]:
        recorded = simulate_arms(
            Arm.of(study.arm),
            [stiff],
            pushed,
            sample_time=1e-3,
            samples=200,
            record=record,
            max_time_step=longest,
        )
        return {name: recorded[name][0] for name in record}

    exact = run(2e-6)

    def error(simulated: Trajectory | dict[Quantity, FloatArray]) -> float:
        sizes = (np.std(simulated[name] - exact[name], axis=0) for name in record)
        return max(
            float(np.max(size / np.std(exact[name], axis=0)))
            for size, name in zip(sizes, record, strict=True)
        )

    default, shorter = (
        error(
            simulate(
                Arm.of(study.arm),
                stiff,
                pushed,
                sample_time=1e-3,
                samples=200,
                record=record,
                max_time_step=longest,
            )
        )
        for longest in (MAX_TIME_STEP, 1e-5)
    )
    assert default < 5e-4
    assert default < 0.2 * error(run(MAX_TIME_STEP))
    assert shorter < 0.2 * default
    # the second-order sensor filters have a quarter of the error at half the step
    assert 1.7 < np.log2(error(run(4e-5)) / error(run(2e-5))) < 2.3


def test_clocks_without_a_common_step_are_rejected() -> None:
    with pytest.raises(InvalidInput, match="no common step"):
        common_step([1e-3, 1e-3 * np.pi])


def test_a_servo_must_be_described() -> None:
    study = replace(
        scara.STIFF.study(Path()), arm=replace(scara.STIFF.study(Path()).arm, servo=None)
    )
    held = replace(drive(20), servo=(True, True))
    with pytest.raises(InvalidInput, match="no servo"):
        simulate(
            Arm.of(study.arm),
            scara.STIFF.parameters(),
            held,
            sample_time=1e-3,
            samples=20,
            record=["encoder"],
        )


def test_sensors_add_bias_noise_and_rounding() -> None:
    study = scara.STIFF.study(Path())
    record: list[Quantity] = ["accelerometer", "gyro", "encoder"]
    run = simulate(
        Arm.of(study.arm),
        scara.STIFF.parameters(),
        drive(4000, 0.0),
        sample_time=1e-3,
        samples=4000,
        record=record,
    )
    noise = SensorNoise(accelerometer_bits=12)
    read = measure(run, noise, np.random.default_rng(0))
    clean = measure(run, None, np.random.default_rng(0))
    np.testing.assert_array_equal(clean["accelerometer"], run["accelerometer"])
    count = 2.0 * noise.accelerometer_range / 2**12
    np.testing.assert_allclose(
        read["accelerometer"] / count, np.round(read["accelerometer"] / count)
    )
    # white noise up to half the sampling rate, and quantisation noise
    expected = np.hypot(noise.accelerometer_density * np.sqrt(500.0), count / np.sqrt(12.0))
    assert read["accelerometer"].std(axis=0) == pytest.approx(expected, rel=0.05)
    assert read["gyro"].std(axis=0) == pytest.approx(noise.gyro_std, rel=0.05)
    assert np.abs(read["accelerometer"].mean(axis=0)).max() > 0.0
    np.testing.assert_array_equal(read["encoder"], run["encoder"])


def test_every_use_has_a_default_excitation(tmp_path: Path) -> None:
    study = scara.STIFF.study(tmp_path)
    assert virtual.simulate_study(study, scara.STIFF.parameters(), tmp_path, seed=3) == len(
        study.experiments
    )
    back = read_study(tmp_path / "study.toml")
    assert back.arm.joints == study.arm.joints
    for log in logs.read_logs(back):
        assert {"u1", "theta_m2", "a1", "gyro2"} <= set(log.channels)
        if log.experiment.use == "frequency":
            one, period = log.channels[f"u{log.experiment.joint}"], round(1.023 / log.sample_time)
            assert set(np.unique(one)) == {-10.0, 10.0}
            np.testing.assert_array_equal(one[:period], one[period : 2 * period])
        if log.experiment.use == "motion":
            link = 0.01 * np.ptp(log.channels["theta_m1"])
            assert 0.5 < link < 2.5


def test_the_seed_determines_motion_and_noise(tmp_path: Path) -> None:
    study = replace(
        scara.STIFF.study(tmp_path), experiments=scara.STIFF.study(tmp_path).experiments[:1]
    )
    for name, seed, noise in [("a", 1, None), ("b", 1, SensorNoise()), ("c", 2, None)]:
        virtual.simulate_study(
            study, scara.STIFF.parameters(), tmp_path / name, seed=seed, noise=noise
        )
    a, b, c = (logs.read_logs(read_study(tmp_path / name / "study.toml"))[0] for name in "abc")
    np.testing.assert_array_equal(a.channels["theta_m1"], b.channels["theta_m1"])
    assert not np.array_equal(a.channels["a1"], b.channels["a1"])
    assert not np.array_equal(a.channels["theta_m1"], c.channels["theta_m1"])


def test_an_arm_under_gravity_starts_in_equilibrium(tmp_path: Path) -> None:
    study = scara.STIFF.study(tmp_path)
    upright = replace(study, arm=change_arm_keys(study.arm, gravity=9.81))
    values = scara.STIFF.parameters(0) | {
        ("gravity_torque_1", None): 31.0,
        ("gravity_torque_2", None): 7.4,
    }
    step = tuple(e for e in upright.experiments if e.name == "step-j1")
    virtual.simulate_study(replace(upright, experiments=step), values, tmp_path)
    log = logs.read_logs(read_study(tmp_path / "study.toml"))[0]
    assert np.ptp(log.channels["theta_m1"][:100]) == 0.0
    assert log.channels["u1"][0] == pytest.approx(0.01 * 38.4 / 0.08)
    assert log.channels["a1"][0] == pytest.approx(9.81, rel=1e-5)  # specific force


def test_open_loop_motion_without_a_log_is_rejected(tmp_path: Path) -> None:
    study = scara.STIFF.study(tmp_path)
    free = Experiment("free", "free.csv", "motion", ("open", "open"))
    with pytest.raises(InvalidInput, match="moves joint 1 in open loop and has no log"):
        virtual.simulate_study(
            replace(study, experiments=(free,)), scara.STIFF.parameters(), tmp_path
        )
    assert not list(tmp_path.iterdir())


def _lab(shared_data: Path, name: str) -> Study:
    return read_study(shared_data / "lab" / name / "study.toml")


@pytest.mark.parametrize(
    ("name", "experiments"),
    [
        ("scara-linear-5kg", ["motion", "prbs-j1-held", "step-check-j1", "step-j2"]),
        ("scara-strainwave-3kg", ["motion-check", "step-j1", "sweep-j1-8V"]),
        ("vertical-linear-0kg", ["motion", "step-j2"]),
    ],
)
def test_logs_of_an_independent_engine_are_reproduced(
    name: str, experiments: list[str], shared_data: Path, tmp_path: Path
) -> None:
    """Logs of another engine, simulated again with the true parameters and the servo."""
    study = _lab(shared_data, name)
    chosen = tuple(e for e in study.experiments if e.name in experiments)
    values = read_parameters(shared_data / "lab" / name / "truth.json")
    virtual.simulate_study(replace(study, experiments=chosen), values, tmp_path)
    again = read_study(tmp_path / "study.toml")
    for ours, theirs in zip(logs.read_logs(again), logs.read_logs(study, chosen), strict=True):
        joint = ours.experiment.joint or 1
        assert fit(theirs.channels[f"theta_m{joint}"], ours.channels[f"theta_m{joint}"]) > 95.0
        speed = (
            np.gradient(theirs.channels[f"gyro{joint}"]),
            np.gradient(ours.channels[f"gyro{joint}"]),
        )
        assert np.corrcoef(*speed)[0, 1] > 0.0
        if ours.experiment.control[joint - 1] == "servo":
            assert fit(theirs.channels[f"u{joint}"], ours.channels[f"u{joint}"]) > 95.0


def test_the_servo_reproduces_the_logged_voltage(shared_data: Path) -> None:
    """The control law on logged encoder and reference gives the logged voltage exactly."""
    study = _lab(shared_data, "scara-linear-5kg")
    servo = study.arm.servo
    assert servo is not None
    log = logs.read_log(study, study.experiments[0])
    count = 2.0 * np.pi / 8192
    for i in (1, 2):
        angle = count * np.round(log.channels[f"theta_m{i}"] / count)
        error = log.channels[f"ref{i}"] - np.diff(angle, prepend=angle[0]) / servo.period
        expected = servo.kp[i - 1] * error + servo.ki[i - 1] * np.cumsum(error) * servo.period
        assert np.abs(expected).max() < servo.limit
        np.testing.assert_allclose(log.channels[f"u{i}"], expected, atol=2e-5)


def test_a_position_loop_corrects_the_reference(tmp_path: Path) -> None:
    """The control law on simulated encoder and reference gives the simulated voltage."""
    study = scara.STIFF.study(tmp_path)
    servo = study.arm.servo
    assert servo is not None
    arm = replace(study.arm, servo=replace(servo, position_gain=(8.0, 5.0)))
    ticks = 400
    time = servo.period * np.arange(ticks)
    reference = np.column_stack([20.0 * np.sin(9.0 * time), 30.0 * np.sin(14.0 * time)])
    moved = Drive(
        tick=servo.period,
        voltage=np.zeros((ticks, 2)),
        reference=reference,
        servo=(True, True),
        motor_angle=(0.3, -0.2),
        initial_voltage=(0.0, 0.0),
    )
    ran = simulate(
        Arm.of(arm),
        scara.STIFF.parameters(),
        moved,
        sample_time=servo.period,
        samples=ticks,
        record=["encoder", "voltage"],
    )
    for i, gain in enumerate((8.0, 5.0)):
        angle, r = ran["encoder"][:, i], reference[:, i]
        path = angle[0] + servo.period * (np.cumsum(r) - r)
        error = r + gain * (path - angle) - np.diff(angle, prepend=angle[0]) / servo.period
        expected = servo.kp[i] * error + servo.ki[i] * np.cumsum(error) * servo.period
        assert np.abs(expected).max() < servo.limit
        np.testing.assert_allclose(ran["voltage"][:, i], expected, atol=1e-9)


def test_a_prbs_adds_to_the_servo_voltage(tmp_path: Path) -> None:
    study = scara.STIFF.study(tmp_path)
    prbs = Prbs(order=8, clock=1e-3, periods=2, amplitude=8.0)
    ridden = Experiment("p", "p.parquet", "frequency", ("servo", "servo"), joint=1, prbs=prbs)
    virtual.simulate_study(
        replace(study, experiments=(ridden,)), scara.STIFF.parameters(), tmp_path
    )
    log = logs.read_logs(read_study(tmp_path / "study.toml"))[0]
    u = log.channels["u1"]
    assert np.abs(u).max() > 8.0  # PRBS and servo
    assert np.abs(u).max() <= 10.0
    assert np.ptp(log.channels["u2"]) > 0.0


def test_parameters_round_trip_through_a_result_like_file(tmp_path: Path) -> None:
    values = scara.STIFF.parameters()
    entries = [{"name": name, "joint": joint, "value": v} for (name, joint), v in values.items()]
    (tmp_path / "p.json").write_text(json.dumps({"parameters": entries}))
    assert read_parameters(tmp_path / "p.json") == values
