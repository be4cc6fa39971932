"""Designed experiments satisfy their limits and identify the arm for which they were designed.

The simulator of this package stands for the rig, with the guessed parameters or with different
ones. The tests show that designs are sound, not that a rig behaves as simulated.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from strainwave import excite as design
from strainwave import pipeline
from strainwave.domain import Experiment, FloatArray, Joint, Servo, Study
from strainwave.domain.arm.kinds import change_arm_keys, single_joint
from strainwave.domain.arm.link_sensors.link_space import Quantity
from strainwave.domain.keys import Values
from strainwave.dynamics import excitation, simulation
from strainwave.dynamics.arm import Arm
from strainwave.errors import InvalidInput
from strainwave.excite import (
    fit_duration,
    motions,
    rigid_motion,
    voltages,
)
from strainwave.excite.files import HEADER_FILE, print_design, table_name, write
from strainwave.excite.guessed_arm import MIN_RESONANCE_LINES, GuessedArm, band_of
from strainwave.excite.motions import step_records
from strainwave.excite.plan import LimitBroken, Limits, Planned, limits_of
from strainwave.excite.voltages import voltage_record
from strainwave.io import logs
from strainwave.io.logs.tables import open_table
from strainwave.io.study import read_study
from strainwave.virtual import experiments as virtual
from strainwave.virtual import scara

ANY = (float("inf"), float("inf"))
LIMITS = Limits((1.2, 1.0), (180.0, 150.0), (10.0, 10.0), (90.0, 40.0))
STUDY = scara.STIFF.study(Path("nowhere"))
GUESS = scara.STIFF.parameters()


@pytest.fixture(scope="module")
def designed() -> design.Design:
    return design.design(STUDY, GUESS, LIMITS)


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """Coarser designs for tests of their messages: few periods and a short search."""
    monkeypatch.setattr(voltages, "_MAX_PERIODS", 12)
    monkeypatch.setattr(rigid_motion, "_N_RANDOM_SERIES", 12)
    monkeypatch.setattr(rigid_motion, "_MAX_ITERATIONS", 5)


def upright() -> tuple[Study, Values]:
    """The rig without disks in a vertical plane."""
    values = scara.STIFF.parameters(0)
    values["gravity_torque_1", None] = 31.0
    values["gravity_torque_2", None] = 9.81 * values["gamma", None] / scara.STIFF.link_length[0]
    return replace(STUDY, arm=change_arm_keys(STUDY.arm, gravity=9.81)), values


def drive(**changes: float) -> tuple[Study, Values]:
    """A single joint with a linear gear."""
    joint = Joint("linear", 0.02, torque_per_volt=0.05, encoder_counts=4096)
    servo = Servo("pi-velocity", 1e-3, (0.05,), (0.5,), 12.0)
    values: Values = {
        ("motor_inertia", 1): 1e-4,
        ("motor_viscous_friction", 1): 1e-4,
        ("motor_coulomb_friction", 1): 0.02,
        ("link_inertia", 1): 0.3,
        ("link_viscous_friction", 1): 0.0,
        ("gear_stiffness", 1): 3000.0,
        ("gear_damping", 1): 2.0,
    }
    for name, value in changes.items():
        values[name, None if name.startswith("gravity") else 1] = value
    return Study(arm=single_joint(joint, servo=servo), experiments=()), values


def worst_use(study: Study, values: Values, limits: Limits, record: design.Planned) -> float:
    """Largest value of a record over its limit, at four times the sampling rate of the design."""
    names: tuple[Quantity, ...] = (
        "link_angle",
        "motor_velocity",
        "voltage",
        "gear_torque",
    )
    run = simulation.simulate(
        Arm.of(study.arm),
        values,
        record.drive,
        sample_time=2.5e-4,
        samples=round(record.duration / 2.5e-4),
        record=names,
    )
    bounds = (limits.angle, limits.velocity, limits.voltage, limits.gear_torque)
    return max(
        float((np.abs(run[name]).max(axis=0) / bound).max())
        for name, bound in zip(names, bounds, strict=True)
    )


# --- the rigid motion ---------------------------------------------------------------------------


def test_the_gradient_of_the_search_is_that_of_the_cost() -> None:
    search = rigid_motion.MotionSearch(GuessedArm(Arm.of(STUDY.arm), GUESS, LIMITS), 8.0)
    point = np.random.default_rng(3).normal(size=search.n_unknowns)
    cost, gradient = search.with_gradient(point)
    assert cost == pytest.approx(float(search.cost(point[None])[0]), rel=1e-12)
    step = 1e-6  # central differences: their error is of second order, if no limit changes
    moved = [search.cost(point + sign * step * np.eye(len(point))) for sign in (1.0, -1.0)]
    expected = (moved[0] - moved[1]) / (2.0 * step)
    np.testing.assert_allclose(gradient, expected, atol=1e-5 * np.abs(expected).max())


def test_the_condition_number_is_a_third_of_that_of_the_built_in_motion(
    designed: design.Design,
) -> None:
    def built_in(seed: int) -> float:
        rng = np.random.default_rng(seed)
        velocity = np.column_stack(
            [
                0.01
                * excitation.smooth_motion(
                    duration=10.0,
                    clock=1e-3,
                    top_hz=1.0,
                    excursion=100.0 * LIMITS.angle[i],
                    speed=LIMITS.velocity[i],
                    rng=rng,
                )
                for i in range(2)
            ]
        )
        angle, acceleration = np.cumsum(velocity, 0) * 1e-3, np.gradient(velocity, 1e-3, axis=0)
        motion = angle, velocity, acceleration
        return float(rigid_motion.condition_number(Arm.of(STUDY.arm), LIMITS, motion))

    condition_number = designed.records[0].condition_number
    assert condition_number is not None
    # the built-in motions of ten seeds have 10 to 24
    assert 3.0 * condition_number < min(built_in(seed) for seed in range(10))


def test_derivatives_of_a_series_match_differences() -> None:
    rng = np.random.default_rng(3)
    series = rigid_motion.Fourier(
        4.0, rng.normal(size=2), rng.normal(size=(5, 2)), rng.normal(size=(5, 2))
    )
    time: FloatArray = np.linspace(0.0, 4.0, 40001)
    angle, velocity, acceleration = series.at(time)
    # the error of central differences is h^2/6 times a third derivative of 1e3, h = 1e-4 s
    np.testing.assert_allclose(np.gradient(angle, 1e-4, axis=0)[1:-1], velocity[1:-1], atol=1e-5)
    np.testing.assert_allclose(
        np.gradient(velocity, 1e-4, axis=0)[1:-1], acceleration[1:-1], atol=1e-4
    )
    np.testing.assert_allclose(angle[0], angle[-1], atol=1e-12)


def test_a_lead_in_connects_both_states() -> None:
    rng = np.random.default_rng(4)
    start, stop = rng.normal(size=(3, 2)), rng.normal(size=(3, 2))
    time: FloatArray = 1e-3 * np.arange(1500.0)
    way = motions.quintic(list(start), list(stop), time)
    for k in range(3):
        np.testing.assert_allclose(way[k][0], start[k], atol=1e-12)
        # the last tick is one tick before the end state
        np.testing.assert_allclose(way[k][-1], stop[k], atol=0.1)
    moved = np.cumsum(way[1], axis=0)[-1] * 1e-3
    np.testing.assert_allclose(start[0] + moved, stop[0], atol=5e-3)


@pytest.mark.parametrize("volts", [40.0, 2.0])
def test_every_point_of_the_search_is_feasible(volts: float) -> None:
    limits = replace(LIMITS, voltage=(volts, volts))
    search = rigid_motion.MotionSearch(GuessedArm(Arm.of(STUDY.arm), GUESS, limits), 5.0)
    rng = np.random.default_rng(0)
    limited = 0
    for point in 3.0 * rng.normal(size=(30, search.n_unknowns)):
        motion = search.feasible(point)[1]
        assert search.within(motion)
        room = np.abs(motion[0]).max(0) / (0.95 * np.array(limits.angle))
        pace = np.abs(motion[1]).max(0) / (0.9e-2 * np.array(limits.velocity))
        limited += bool((np.maximum(room, pace) < 0.999).any())
    # with 40 V angle and velocity are limiting, with 2 V the voltage
    assert (limited == 0) == (volts == 40.0)


# --- voltages -----------------------------------------------------------------------------------


@pytest.mark.parametrize("joint", [1, 2])
def test_a_prbs_covers_the_band(designed: design.Design, joint: int) -> None:
    record = next(r for r in designed.records if r.experiment.joint == joint)
    prbs, band = record.experiment.prbs, band_of(Arm.of(STUDY.arm), GUESS, joint)
    assert prbs is not None
    assert band is not None
    # held by the drive: ten samples per clock
    held = np.repeat(excitation.prbs(replace(prbs, periods=1)), 10)
    power = np.abs(np.fft.rfft(held)) ** 2
    frequency = np.fft.rfftfreq(len(held), prbs.clock / 10.0)
    inside = (frequency >= band.low_hz) & (frequency <= band.high_hz)
    assert power[inside].min() > 0.5 * power[inside].max()
    assert frequency[1] <= band.width_hz / MIN_RESONANCE_LINES
    assert frequency[1] <= band.low_hz


def test_the_band_matches_the_two_inertia_model() -> None:
    study, values = drive(motor_viscous_friction=0.0, gear_damping=1e-6)
    band = band_of(Arm.of(study.arm), values, 1)
    assert band is not None
    k, link, motor = 3000.0, 0.3, 1e-4 / 0.02**2
    assert band.anti_resonance_hz == pytest.approx(np.sqrt(k / link) / (2 * np.pi), rel=1e-9)
    assert band.resonance_hz == pytest.approx(np.sqrt(k / link + k / motor) / (2 * np.pi), rel=1e-9)
    assert band.width_hz == pytest.approx(1e-6 / 0.3 / (2 * np.pi))
    rigid = replace(
        study, arm=replace(study.arm, joints=(replace(study.arm.joints[0], spring="rigid"),))
    )
    assert band_of(Arm.of(rigid.arm), values, 1) is None


@pytest.mark.usefixtures("quick")
def test_a_multisine_is_flat_in_the_band_and_zero_outside() -> None:
    study, values = drive()
    limits = Limits((1.5,), (200.0,), (10.0,), ANY[:1])
    band = band_of(Arm.of(study.arm), values, 1)
    assert band is not None
    record = voltage_record(
        GuessedArm(Arm.of(study.arm), values, limits), band, 1, kind="multisine", seed=0
    )
    assert record.experiment.prbs is None
    u = record.drive.voltage[:, 0]
    samples = int(np.ceil(band.period / record.drive.tick))
    spectrum = np.abs(np.fft.rfft(u[:samples]))
    frequency = np.fft.rfftfreq(samples, record.drive.tick)
    inside = (frequency >= band.low_hz) & (frequency <= band.high_hz)
    np.testing.assert_allclose(spectrum[inside], spectrum[inside].mean(), rtol=1e-9)
    beyond = (frequency < 0.9 * band.low_hz) | (frequency > 1.02 * band.high_hz)
    assert spectrum[beyond].max() < 1e-9 * spectrum.max()
    assert np.abs(u).max() / u.std() < 1.8


@pytest.mark.usefixtures("quick")
def test_coarse_sensors_need_more_periods() -> None:
    study, values = drive()
    limits = Limits((3.0,), (200.0,), (2.0,), ANY[:1])
    band = band_of(Arm.of(study.arm), values, 1)
    assert band is not None
    coarse = replace(
        study, arm=replace(study.arm, joints=(replace(study.arm.joints[0], encoder_counts=200),))
    )
    fine, rough = (
        voltage_record(GuessedArm(Arm.of(s.arm), values, limits), band, 1, kind="multisine", seed=0)
        for s in (study, coarse)
    )
    assert rough.duration > 2.0 * fine.duration
    assert "encoder rounding" in rough.reasons[1]


def test_under_gravity_servos_hold_the_arm() -> None:
    study, values = upright()
    limits = replace(LIMITS, gear_torque=ANY)
    band = band_of(Arm.of(study.arm), values, 2)
    assert band is not None
    record = voltage_record(
        GuessedArm(Arm.of(study.arm), values, limits), band, 2, kind="prbs", seed=0
    )
    assert record.experiment.control == ("servo", "servo")
    assert worst_use(study, values, limits, record) < 1.005
    with pytest.raises(InvalidInput, match="multisine"):
        voltage_record(
            GuessedArm(Arm.of(study.arm), values, limits), band, 2, kind="multisine", seed=0
        )


# --- the whole design ---------------------------------------------------------------------------


def test_all_limits_hold(designed: design.Design) -> None:
    for record in designed.records:
        use = worst_use(STUDY, GUESS, LIMITS, record)
        # samples of 1 ms miss up to 0.5 % of the peak of a vibration of 30 Hz
        assert use < 1.005, record.experiment.name
        # records at full amplitude use their limits
        at_full = record.experiment.use in ("motion", "frequency")
        assert use > 0.8 or not at_full, record.experiment.name
    assert {w.code for w in designed.warnings} <= {"standing", "limit-broken"}
    assert all(w.where.startswith("sweep") for w in designed.warnings)


def names(plan: design.Design) -> list[str]:
    return [record.experiment.name for record in plan.records]


def test_every_use_and_validation_record_is_planned(designed: design.Design) -> None:
    uses = [(r.experiment.use, r.experiment.joint) for r in designed.records]
    assert uses.count(("motion", None)) == uses.count(("check", None)) == 1
    for joint in (1, 2):
        for use in ("frequency", "tuning", "check"):
            assert uses.count((use, joint)) == 1, use
        swept = [
            r.experiment.prbs.amplitude
            for r in designed.records
            if r.experiment.prbs is not None
            and (r.experiment.use, r.experiment.joint) == ("sweep", joint)
        ]
        full = next(r.experiment.prbs for r in designed.records if names_of(r) == f"prbs-j{joint}")
        assert full is not None
        # two significant digits
        shares = np.array(swept) / full.amplitude
        assert len(shares) >= 3
        np.testing.assert_allclose(shares, [0.2, 0.4, 0.6, 0.8][-len(shares) :], rtol=0.05)
        step, check = (
            next(r for r in designed.records if names_of(r) == f"{name}-j{joint}")
            for name in ("step", "step-check")
        )
        assert step.drive.reference[:, 2 - joint].any() == np.False_
        level, other = (np.abs(r.drive.reference).max() for r in (step, check))
        assert other == pytest.approx(
            0.7 * level, rel=0.2
        )  # each is reduced to the limits separately
        # the servo does not saturate
        assert max(step.predicted.voltage) < 10.0


def names_of(record: design.Planned) -> str:
    return record.experiment.name


def test_steps_are_reduced_to_the_limits_or_omitted() -> None:
    study, values = drive()
    band = band_of(Arm.of(study.arm), values, 1)
    assert band is not None
    wide, narrow, closed = (
        GuessedArm(Arm.of(study.arm), values, Limits((1.5,), (200.0,), (10.0,), (torque,)))
        for torque in (ANY[0], 8.0, 0.1)
    )
    assert step_records(wide, band, 1)[0].predicted.gear_torque[0] > 8.0
    assert 4.0 < step_records(narrow, band, 1)[0].predicted.gear_torque[0] <= 8.0
    with pytest.raises(LimitBroken, match=r"no step of joint 1 keeps .* gear torque of joint 1"):
        step_records(closed, band, 1)


@pytest.mark.usefixtures("quick")
def test_gear_torques_without_limit_give_a_warning() -> None:
    study, values = drive()
    free, limited = (
        design.design(study, values, Limits((1.5,), (200.0,), (10.0,), (torque,)))
        for torque in (ANY[0], 1e3)
    )
    assert "no-torque-limit" not in {w.code for w in limited.warnings}
    worst = max(float(r.predicted.gear_torque[0]) for r in limited.records)
    message = next(w.message for w in free.warnings if w.code == "no-torque-limit")
    assert f"reaches {worst:.3g} N m" in message


@pytest.mark.usefixtures("quick")
def test_intervals_depend_on_the_declared_sensors(
    capsys: pytest.CaptureFixture[str],
) -> None:
    bare, values = drive()
    bare = replace(
        bare, arm=replace(bare.arm, joints=(replace(bare.arm.joints[0], encoder_counts=1000),))
    )
    sensed = replace(
        bare,
        arm=replace(
            bare.arm,
            joints=(
                replace(bare.arm.joints[0], accelerometer_distance=0.3, accelerometer_hz=300.0),
            ),
        ),
    )
    limits = Limits((1.5,), (200.0,), (10.0,), ANY[:1])
    widths, printed = [], []
    for study in (bare, sensed):
        plan = design.design(study, values, limits)
        widths.append({p.name: p.std for p in plan.precision})
        print_design(plan, Path("designed"))
        printed.append(" ".join(capsys.readouterr().out.split()))
    for name in ("gear_stiffness", "gear_damping"):
        alone, more = (width[name] for width in widths)
        assert alone is not None
        assert more is not None
        assert alone > 1.3 * more
    assert "sensors: joint 1's encoder of 1000 counts and no link sensor" in printed[0]
    assert "sensors: joint 1's encoder of 1000 counts and accelerometer" in printed[1]


def test_a_virtual_arm_has_the_declared_sensors(tmp_path: Path) -> None:
    first, second = STUDY.arm.joints
    first = replace(first, accelerometer_distance=None, accelerometer_hz=None, gyro_hz=None)
    one = tuple(e for e in STUDY.experiments if e.name == "step-j1")
    study = replace(STUDY, arm=replace(STUDY.arm, joints=(first, second)), experiments=one)
    virtual.simulate_study(study, GUESS, tmp_path)
    written = read_study(tmp_path / "study.toml")
    channels = set(logs.read_log(written, written.experiments[0]).channels)
    assert {"a2", "gyro2"} <= channels
    assert not {"a1", "gyro1"} & channels


@pytest.mark.usefixtures("quick")
def test_narrow_limits_give_a_warning() -> None:
    study, values = drive()
    study = replace(
        study, arm=replace(study.arm, joints=(replace(study.arm.joints[0], spring="three-slope"),))
    )
    values |= {("gear_knee_t1", 1): 5.0, ("gear_knee_t2", 1): 20.0}
    # 0.4 V overcome the friction, and 20 % is margin
    plan = design.design(study, values, Limits((1.5,), (200.0,), (0.8,), ANY[:1]))
    codes = {(w.code, w.where) for w in plan.warnings}
    assert ("knee-not-reached", "prbs-j1") in codes
    assert ("standing", "motion") in codes


@pytest.mark.usefixtures("quick")
def test_a_poorly_conditioned_motion_gives_a_warning() -> None:
    study, values = drive(gravity_torque_1=1.0)
    study = replace(study, arm=change_arm_keys(study.arm, gravity=9.81))
    # within 0.02 rad gravity is similar to a friction offset
    plan = design.design(study, values, Limits((0.02,), (200.0,), (10.0,), ANY[:1]))
    assert ("poor-excitation", "motion") in {(w.code, w.where) for w in plan.warnings}


@pytest.mark.usefixtures("quick")
def test_a_slow_servo_gives_a_warning() -> None:
    study, values = drive(gear_stiffness=6e4)
    plan = design.design(study, values, Limits((1.5,), (200.0,), (10.0,), ANY[:1]))
    assert "slow-clock" in {w.code for w in plan.warnings}


@pytest.mark.usefixtures("quick")
def test_a_record_that_violates_a_limit_is_omitted_with_a_warning() -> None:
    """The motor's friction alone causes a gear torque of 1 N m, which fast voltages mostly avoid."""
    study, values = drive()
    plan = design.design(study, values, Limits((1.5,), (200.0,), (10.0,), (0.5,)))
    assert names(plan)[0] == "prbs-j1"
    assert not {"motion", "step-j1"} & set(names(plan))
    broken = [(w.code, w.where) for w in plan.warnings if w.code == "limit-broken"]
    assert ("limit-broken", "motion") in broken
    assert ("limit-broken", "step-j1") in broken
    message = next(w.message for w in plan.warnings if w.where == "motion")
    assert re.search(
        r"gear torque of joint 1 would be \S+ N m, above the limit of 0.5 \(--limit-torque\)",
        message,
    )
    assert "widen the limit" in message
    assert worst_use(study, values, plan.limits, plan.records[0]) < 1.005


@pytest.mark.usefixtures("quick")
def test_an_excitation_below_friction_is_omitted_with_a_warning() -> None:
    study, values = drive()
    plan = design.design(study, values, Limits((0.02,), (200.0,), (10.0,), (0.01,)))
    reported = {w.where: w.message for w in plan.warnings if w.code == "limit-broken"}
    assert re.search(r"with \S+ V the gear torque of joint 1 would be", reported["prbs-j1"])


@pytest.mark.usefixtures("quick")
def test_designs_without_a_servo_are_in_open_loop() -> None:
    study, values = drive()
    limits = limits_of(
        replace(study, arm=replace(study.arm, servo=None)).arm, "1.5", "200", "10", None
    )
    plan = design.design(replace(study, arm=replace(study.arm, servo=None)), values, limits)
    # a linear gear has the same stiffness at all amplitudes
    assert {r.experiment.use for r in plan.records} == {"frequency"}
    assert {r.experiment.control for r in plan.records} == {("open",)}
    assert "no-servo" in {w.code for w in plan.warnings}
    assert 'kind = "pi-velocity", period [s], kp' in plan.warnings[0].message


@pytest.mark.usefixtures("quick")
def test_designs_under_gravity_without_a_servo_have_motions_alone() -> None:
    study, values = upright()
    plan = design.design(replace(study, arm=replace(study.arm, servo=None)), values, LIMITS)
    assert [r.experiment.use for r in plan.records] == ["motion", "check"]
    (warning,) = [w for w in plan.warnings if w.code == "no-servo"]
    assert "only motions, which the arm's own controller follows" in warning.message


def test_a_short_session_omits_sweeps_and_then_periods(designed: design.Design) -> None:
    records, total = designed.records, designed.duration
    assert fit_duration(records, total) == (records, ())
    few, omitted = fit_duration(records, 0.7 * total)
    assert 0.5 * total < sum(r.duration for r in few) <= 0.7 * total
    assert {r.experiment.name for r in few} | set(omitted) == {r.experiment.name for r in records}
    assert omitted
    assert all(name.startswith("sweep-") for name in omitted)
    kept = [r for r in records if r.experiment.use != "sweep"]
    kept = [with_periods(r, 7) for r in kept]
    longest = sum(r.duration for r in kept)
    short, _ = fit_duration(kept, 0.999 * longest)
    assert sum(r.duration for r in short) < longest
    for before, after in zip(kept, short, strict=True):
        n = len(after.drive.voltage)
        np.testing.assert_array_equal(before.drive.voltage[:n], after.drive.voltage)
        if prbs := after.experiment.prbs:
            assert prbs.periods >= 5
            assert n * after.drive.tick == pytest.approx(
                prbs.periods * (2**prbs.order - 1) * prbs.clock
            )
    with pytest.raises(InvalidInput, match=r"--minutes: the shortest plan takes .* minutes"):
        fit_duration(records, 10.0)


def with_periods(record: Planned, periods: int) -> Planned:
    """The record with other periods of its PRBS."""
    prbs, drive = record.experiment.prbs, record.drive
    if prbs is None:
        return record
    one = len(drive.voltage) // prbs.periods
    voltage, reference = (np.tile(x[:one], (periods, 1)) for x in (drive.voltage, drive.reference))
    experiment = replace(record.experiment, prbs=replace(prbs, periods=periods))
    longer = replace(drive, voltage=voltage, reference=reference)
    return replace(record, experiment=experiment, drive=longer)


def only(designed: design.Design, *chosen: str) -> design.Design:
    """Design with some of its records, to simulate only what a test needs."""
    records = tuple(r for r in designed.records if names_of(r) in chosen)
    study = replace(designed.study, experiments=tuple(r.experiment for r in records))
    return replace(designed, study=study, records=records)


def test_planned_inputs_are_simulated(designed: design.Design, tmp_path: Path) -> None:
    designed = only(designed, "motion", "motion-check", "prbs-j1", "step-j1", "step-check-j2")
    write(designed, tmp_path / "plan")
    study = read_study(tmp_path / "plan" / "study.toml", logs_exist=False)
    virtual.simulate_study(study, GUESS, tmp_path / "run")
    again = read_study(tmp_path / "run" / "study.toml")
    for record, experiment in zip(designed.records, again.experiments, strict=True):
        log = logs.read_log(again, experiment)
        # the files have nine digits
        assert log.time[-1] == pytest.approx(record.duration, abs=2e-3)
        if record.motor_angle is not None:
            ticks = np.arange(len(record.motor_angle)) * round(record.drive.tick / log.sample_time)
            for i in range(2):
                meant = record.motor_angle[:, i]
                followed = log.channels[f"theta_m{i + 1}"][ticks]
                # the servo lags, more so after steps; another motion would differ by its full range
                share = 0.05 if record.experiment.joint is None else 0.5
                if meant.any():
                    assert np.abs(followed - meant).max() < share * np.ptp(meant)
        elif record.experiment.control == ("open", "open"):
            j = record.experiment.joint or 0
            looks = round(record.drive.tick / log.sample_time)
            wanted = np.repeat(record.drive.voltage[:, j - 1], looks)
            np.testing.assert_allclose(log.channels[f"u{j}"], wanted, rtol=1e-8)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("t [s],u1 [V]\n0,1\n0.001,2\n0.005,1\n", r"no column t \[s\]"),
        ("u1 [V],x\n1,2\n2,1\n", r"no column t \[s\]"),
        ("t [s],x\n0,1\n0.001,2\n", "no non-zero input"),
    ],
)
def test_damaged_tables_are_rejected(text: str, expected: str, tmp_path: Path) -> None:
    study, values = drive()
    experiment = Experiment("p", "p.csv", "frequency", ("open",), joint=1)
    study = replace(study, path=tmp_path / "study.toml", experiments=(experiment,))
    (tmp_path / "apply-p.csv").write_text(text)
    with pytest.raises(InvalidInput, match=expected):
        virtual.simulate_study(study, values, tmp_path / "out")


def test_written_designs_read_back(designed: design.Design, tmp_path: Path) -> None:
    write(designed, tmp_path)
    again = read_study(tmp_path / "study.toml", logs_exist=False)
    assert again.experiments == designed.study.experiments
    assert again.arm.joints == STUDY.arm.joints
    header = (tmp_path / HEADER_FILE).read_text()
    for record in designed.records:
        table = open_table(tmp_path / table_name(record.experiment))
        columns = table.read(table.names)
        time = columns.pop("t [s]")
        np.testing.assert_allclose(
            time, record.drive.tick * np.arange(len(record.drive.voltage)), rtol=1e-8
        )
        joint = record.experiment.joint
        if joint and record.motor_angle is None:
            assert list(columns) == [f"u{joint} [V]"]
            np.testing.assert_allclose(
                columns[f"u{joint} [V]"], record.drive.voltage[:, joint - 1], rtol=1e-8
            )
        else:
            reference = columns["ref2 [rad/s]"]
            np.testing.assert_allclose(reference, record.drive.reference[:, 1], rtol=1e-8)
            assert len(columns) == 4
            # nine digits of an angle of 100 rad
            moved = np.cumsum(reference[:-1]) * record.drive.tick
            np.testing.assert_allclose(columns["theta_m2 [rad]"][1:], moved, atol=1e-5)
        for name, values in columns.items():
            array = record.experiment.name.replace("-", "_") + "_" + name.split()[0]
            text = re.search(rf"double {array}\[(\d+)\] = {{ /\*.*?\*/\n(.*?)}};", header, re.S)
            assert text is not None
            assert int(text[1]) == len(values)
            listed = [float(v) for v in text[2].replace("\n", "").strip(",").split(",")]
            np.testing.assert_array_equal(listed, values)


def test_the_records_identify_an_arm_other_than_the_guess(
    designed: design.Design, tmp_path: Path
) -> None:
    """Rigid parameters within 1 % with noisy sensors, on an arm that differs by 5 to 15 % from the guess."""
    rng = np.random.default_rng(7)
    truth = {key: value * float(rng.uniform(0.85, 1.15)) for key, value in GUESS.items()}
    for name in ("alpha", "beta", "gamma"):
        truth[name, None] = 0.95 * GUESS[name, None]
    designed = only(designed, "motion", "motion-check", "prbs-j1")
    write(designed, tmp_path)
    for number, record in enumerate(designed.records):
        samples = round(record.duration / 1e-3)
        run = simulation.simulate(
            Arm.of(STUDY.arm),
            truth,
            record.drive,
            sample_time=1e-3,
            samples=samples,
            record=["voltage", "encoder", "accelerometer"],
        )
        readings = simulation.measure(run, simulation.SensorNoise(), np.random.default_rng(number))
        columns = {"t": run.time}
        for i in range(2):
            columns[f"u{i + 1}"] = readings["voltage"][:, i]
            columns[f"theta_m{i + 1}"] = readings["encoder"][:, i]
            columns[f"a{i + 1}"] = readings["accelerometer"][:, i]
        logs.write_log(tmp_path / record.experiment.file, columns)
    result = pipeline.identify(tmp_path / "study.toml", stages=("rigid",))
    assert result.rigid is not None
    rigid = truth["alpha", None] + truth["motor_inertia", 1] / 0.01**2
    expected: Values = {("rigid_inertia", 1): rigid}
    expected["motor_inertia", 2] = truth["motor_inertia", 2]
    expected["beta", None] = truth["beta", None]
    expected["gamma", None] = truth["gamma", None]
    for joint in (1, 2):
        viscous = truth["motor_viscous_friction", joint]
        viscous += 0.01**2 * truth["link_viscous_friction", joint]
        expected["total_viscous_friction", joint] = viscous
        expected["motor_coulomb_friction", joint] = truth["motor_coulomb_friction", joint]
    for key, value in expected.items():
        assert result.rigid.value(*key) == pytest.approx(value, rel=0.01), key


def test_the_summary_states_durations_and_reasons(
    designed: design.Design, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    print_design(designed, tmp_path)
    printed = " ".join(capsys.readouterr().out.split())
    total = f"{len(designed.records)} records of {designed.duration / 60.0:.1f} minutes together"
    assert printed.startswith(total)
    for record in designed.records:
        assert f"{record.experiment.name}: {record.duration:.1f} s" in printed
        assert record.experiment.file in printed
    assert "noise" in printed


# --- refusals -----------------------------------------------------------------------------------


def no_voltage() -> None:
    limits_of(replace(STUDY, arm=replace(STUDY.arm, servo=None)).arm, "1", "1", None, None)


def too_weak_to_hold() -> None:
    study, values = upright()
    design.design(study, values, replace(LIMITS, voltage=(2.0, 2.0)))


def immovable() -> None:
    study, values = drive()
    design.design(study, values, Limits((1.5,), (200.0,), (10.0,), (0.1,)))


def missing_stiffness() -> None:
    lacking = {key: value for key, value in GUESS.items() if key != ("gear_stiffness_k2", 1)}
    design.design(STUDY, lacking, LIMITS)


@pytest.mark.usefixtures("quick")
@pytest.mark.parametrize(
    ("ask", "expected"),
    [
        (no_voltage, r"--limit-voltage: .*add the \[servo\]"),
        (too_weak_to_hold, "hold"),
        (immovable, r"satisfies the limits.*gear torque of joint 1 would be .* limit of 0.1"),
        (missing_stiffness, "gear_stiffness_k2 of joint 1"),
        (lambda: limits_of(STUDY.arm, "1,2,3", "1", None, None), "--limit-angle"),
        (lambda: limits_of(STUDY.arm, "69", "180", None, None), "69 degrees are 1.204 rad"),
        (lambda: limits_of(STUDY.arm, "1,0.9", "3000", None, None), "3000 rpm are 314.2"),
        (lambda: limits_of(STUDY.arm, "1", "fast", None, None), "--limit-velocity"),
        (lambda: limits_of(STUDY.arm, "1", "1", "-3", None), "--limit-voltage"),
        (lambda: limits_of(STUDY.arm, "1", "1", None, "nan"), "--limit-torque"),
    ],
)
def test_impossible_designs_are_rejected(ask: Callable[[], object], expected: str) -> None:
    with pytest.raises(InvalidInput, match=expected):
        ask()


def test_limits_are_for_all_joints_or_one_each() -> None:
    assert limits_of(STUDY.arm, "1.2,0.9", "180", "24,8", None) == Limits(
        (1.2, 0.9), (180.0, 180.0), (10.0, 8.0), ANY
    )
