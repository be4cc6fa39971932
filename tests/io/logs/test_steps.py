"""Preprocessing steps of a study: what they change, what they keep, and what they refuse."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import strainwave as sw
import studies
from strainwave.domain import ArmDescription, Experiment, FloatArray, Joint, Log, Study
from strainwave.domain.steps import Detrend, LowPass, Merge, Resample, Step
from strainwave.dynamics.simulation import SensorNoise
from strainwave.errors import InvalidInput
from strainwave.io.logs import read_log, read_logs, write_log
from strainwave.io.study import read_study, write_study
from strainwave.virtual import scara
from strainwave.virtual.experiments import derived, simulate_study

T = 0.001
JOINT = Joint(spring="rigid", gear_ratio=1.0)
PLANAR = ArmDescription(kind="single-joint", joints=(JOINT,))
RUN = Experiment("run", "run.csv", "motion", ("servo",))

Columns = dict[str, FloatArray]


def columns(samples: int = 8000) -> Columns:
    """Channels of a moving joint with noise."""
    t = T * np.arange(samples)
    rng = np.random.default_rng(3)
    values = {
        "theta_m1": np.sin(9.0 * t),
        "omega_m1": 9.0 * np.cos(9.0 * t),
        "torque1": np.cos(7.0 * t + 1.0),
        "gyro1": 9.0 * np.cos(9.0 * t),
    }
    return {"t": t} | {n: v + 1e-4 * rng.standard_normal(samples) for n, v in values.items()}


def read(folder: Path, data: Columns, *steps: Step, **window: float) -> tuple[Log, ...]:
    """The segments of a record with steps; a merged log is `second.csv` in the folder."""
    study = Study(
        arm=PLANAR,
        experiments=(replace(RUN, steps=steps, **window),),  # type: ignore[arg-type]
        path=folder / "study.toml",
    )
    return read_logs(study, data={"run": data})


def rows(data: Columns, selection: slice, shift: float = 0.0) -> Columns:
    return {n: v[selection] + (shift if n == "t" else 0.0) for n, v in data.items()}


def codes(log: Log) -> list[str]:
    return [warning.code for warning in log.warnings]


# --- merge ------------------------------------------------------------------------------------


def test_two_halves_of_a_log_are_the_whole(tmp_path: Path) -> None:
    data = columns()
    (whole,) = read(tmp_path, data)
    write_log(tmp_path / "second.csv", rows(data, slice(3000, None)))
    merged = read(tmp_path, rows(data, slice(3000)), Merge("second.csv"))
    assert len(merged) == 1
    assert codes(merged[0]) == ["preprocessed"]
    np.testing.assert_allclose(merged[0].time, whole.time, atol=1e-12)
    for name, values in whole.channels.items():
        np.testing.assert_allclose(merged[0].channels[name], values, atol=1e-12)


def test_stamps_that_restart_give_two_segments(tmp_path: Path) -> None:
    data = columns()
    write_log(tmp_path / "second.csv", rows(data, slice(3000, None), shift=-3.0))
    first, second = read(tmp_path, rows(data, slice(3000)), Merge("second.csv"))
    assert (first.name, second.name) == ("run/1", "run/2")
    assert (len(first), len(second)) == (3000, 5000)
    assert second.is_continuation
    assert codes(first) == ["split", "preprocessed"]


@pytest.mark.parametrize("missing", ["gyro1", "torque1"])
def test_a_merged_log_has_the_columns_of_the_first(missing: str, tmp_path: Path) -> None:
    data = columns()
    write_log(tmp_path / "second.csv", {n: v for n, v in data.items() if n != missing})
    with pytest.raises(InvalidInput, match=rf"second\.csv.*'{missing}'"):
        read(tmp_path, data, Merge("second.csv"))


def test_a_fault_of_a_merged_log_names_its_file_and_row(tmp_path: Path) -> None:
    data = columns()
    second = rows(data, slice(3000, None))
    second["torque1"] = np.where(np.arange(5000) == 17, np.inf, second["torque1"])
    write_log(tmp_path / "second.csv", second)
    with pytest.raises(InvalidInput, match=r"second\.csv, line 19, column 'torque1'"):
        read(tmp_path, rows(data, slice(3000)), Merge("second.csv"))


def test_logs_without_time_stamps_are_not_merged(tmp_path: Path) -> None:
    write_log(tmp_path / "second.csv", columns())
    study = Study(
        arm=PLANAR,
        experiments=(replace(RUN, steps=(Merge("second.csv"),)),),
        path=tmp_path / "study.toml",
        sample_rate=1000.0,
    )
    with pytest.raises(InvalidInput, match="without time stamps cannot be merged"):
        read_logs(study, data={"run": columns()})


# --- detrend ----------------------------------------------------------------------------------


@pytest.mark.parametrize("degree", [0, 1])
def test_an_added_offset_and_slope_are_removed(degree: int, tmp_path: Path) -> None:
    data = columns()
    step = Detrend(("gyro1",), degree)  # type: ignore[arg-type]
    (clean,) = read(tmp_path, data, step)
    faulty = data | {"gyro1": data["gyro1"] + 0.3 + 0.05 * degree * data["t"]}
    (log,) = read(tmp_path, faulty, step)
    np.testing.assert_allclose(log.channels["gyro1"], clean.channels["gyro1"], atol=1e-12)
    np.testing.assert_array_equal(log.channels["torque1"], clean.channels["torque1"])
    removed = "the mean 0.3" if degree == 0 else "a line from 0.2"
    assert f"removed: {removed}" in log.warnings[0].message


def test_all_segments_have_one_offset(tmp_path: Path) -> None:
    data = columns()
    data["gyro1"] = np.where(data["t"] < 3.0, 1.0, 5.0) + 0.1 * data["gyro1"]
    data["t"] = data["t"] + (data["t"] >= 3.0)
    first, second = read(tmp_path, data, Detrend(("gyro1",)))
    step = second.channels["gyro1"].mean() - first.channels["gyro1"].mean()
    assert step == pytest.approx(4.0, abs=0.1)


# --- filter and window ------------------------------------------------------------------------


def test_a_low_pass_filters_all_channels_alike(tmp_path: Path) -> None:
    data = columns()
    hum = {
        n: v + (np.sin(2.0 * np.pi * 200.0 * data["t"]) if n != "t" else 0.0)
        for n, v in data.items()
    }
    (plain,), (log,) = read(tmp_path, data), read(tmp_path, hum, LowPass(50.0))
    inside = slice(100, -100)
    for name, values in plain.channels.items():
        np.testing.assert_allclose(log.channels[name][inside], values[inside], atol=1e-3)


def test_the_window_is_cut_after_the_steps(tmp_path: Path) -> None:
    data = columns()
    (whole,) = read(tmp_path, data, LowPass(20.0), Detrend(("gyro1",)))
    (log,) = read(tmp_path, data, LowPass(20.0), Detrend(("gyro1",)), start=2.0, stop=5.0)
    assert (log.time[0], log.time[-1]) == pytest.approx((2.0, 5.0))
    for name, values in whole.channels.items():
        np.testing.assert_array_equal(log.channels[name], values[2000:5001])
    with pytest.raises(InvalidInput, match=r"the log extends from 0 to 7\.999 s"):
        read(tmp_path, data, LowPass(20.0), start=9.0)


@pytest.mark.parametrize("cutoff_hz", [0.5, 460.0])
def test_a_cut_off_outside_of_the_record_is_refused(cutoff_hz: float, tmp_path: Path) -> None:
    with pytest.raises(InvalidInput, match=r"can be filtered from 1\.25 to 450 Hz"):
        read(tmp_path, columns(), LowPass(cutoff_hz))


# --- resample ---------------------------------------------------------------------------------


@pytest.mark.parametrize("period", [0.002, 0.0025, 0.005])
def test_a_longer_period_keeps_the_motion_and_no_aliases(period: float, tmp_path: Path) -> None:
    data = columns()
    hum = data | {"gyro1": data["gyro1"] + np.sin(2.0 * np.pi * 390.0 * data["t"])}
    (log,) = read(tmp_path, hum, Resample(period))
    assert log.sample_time == pytest.approx(period, rel=1e-9)
    inside = slice(50, -50)
    expected = 9.0 * np.cos(9.0 * log.time)
    np.testing.assert_allclose(log.channels["gyro1"][inside], expected[inside], atol=2e-3)


def test_a_held_command_keeps_its_delay() -> None:
    from strainwave.domain import Lag
    from strainwave.io.logs.steps import apply_steps
    from strainwave.numerics.filters import apply_lags

    t = np.arange(20_000) * np.float64(T)
    command = np.sin(2.0 * np.pi * 2.0 * t) + np.sin(2.0 * np.pi * 15.0 * t)
    lags = [Lag(2, 4.0)]
    response = apply_lags(command, lags, T, held=True)
    experiment = replace(RUN, steps=(Resample(0.005),))
    log = Log(experiment, t, T, {"u1": command, "omega_m1": response})
    (resampled,), _ = apply_steps([log], experiment, Path("run.csv"))
    naive = command[::5][: len(resampled)]
    errors = [
        np.std((apply_lags(u, lags, 0.005, held=True) - resampled.channels["omega_m1"])[100:-100])
        for u in (resampled.channels["u1"], naive)
    ]
    assert errors[0] < 1e-3 * np.std(response)
    assert errors[1] > 1e-2 * np.std(response)


def test_a_shorter_period_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InvalidInput, match=r"0\.0005 s, but the record has a longer one, 0\.001 s"):
        read(tmp_path, columns(), Resample(0.0005))
    with pytest.raises(InvalidInput, match="leaves less than 16 samples"):
        read(tmp_path, columns(), Resample(2.0))


# --- study file -------------------------------------------------------------------------------


def with_steps(folder: Path, steps: str, study: str = studies.STUDY) -> Study:
    text = study.replace("[[experiment]]", f"[[experiment]]\nsteps = {steps}", 1)
    return read_study(studies.write(folder, text))


def test_steps_are_written_and_read_back(tmp_path: Path) -> None:
    study = with_steps(
        tmp_path,
        '[{ kind = "merge", file = "motion.csv" }, { kind = "detrend", channels = ["omega_m1"],'
        ' degree = 1 }, { kind = "lowpass", cutoff_hz = 80 }, { kind = "resample",'
        " sample_time = 0.002 }]",
    )
    expected = (Merge("motion.csv"), Detrend(("omega_m1",), 1), LowPass(80.0), Resample(0.002))
    assert study.experiments[0].steps == expected
    write_study(study, tmp_path / "again.toml")
    assert read_study(tmp_path / "again.toml").experiments == study.experiments


@pytest.mark.parametrize(
    ("steps", "message"),
    [
        ('"lowpass"', "it should be a list of tables"),
        ('[{ kind = "high" }]', "should be 'detrend', 'lowpass', 'resample' or 'merge'"),
        ("[{ cutoff_hz = 3.0 }]", "'kind' is None"),
        ('[{ kind = "lowpass" }]', r"step 1 \(lowpass\): the key 'cutoff_hz' is missing"),
        ('[{ kind = "lowpass", cutoff_hz = -1.0 }]', "'cutoff_hz' is -1.0, but"),
        ('[{ kind = "lowpass", cutoff_hz = 1e7 }]', "1e\\+07 Hz, which is outside"),
        ('[{ kind = "lowpass", cutoff_hz = 9.0, channels = ["a1"] }]', "'channels' is unknown"),
        ('[{ kind = "detrend", channels = [] }]', "'channels' is"),
        ('[{ kind = "detrend", channels = ["a9"] }]', "'a9' is not a channel"),
        ('[{ kind = "detrend", channels = ["theta_m1"] }]', "not a fault of a sensor"),
        ('[{ kind = "merge", file = "no.csv" }]', "the log file 'no.csv' does not exist"),
        (
            '[{ kind = "lowpass", cutoff_hz = 9.0 }, { kind = "merge", file = "motion.csv" }]',
            "'merge' follows 'lowpass'",
        ),
    ],
)
def test_a_wrong_step_is_refused_at_its_place(steps: str, message: str, tmp_path: Path) -> None:
    with pytest.raises(InvalidInput, match=message) as error:
        with_steps(tmp_path, steps)
    assert "[[experiment]] 1" in str(error.value)
    assert error.value.remedy


def test_gravity_is_not_detrended(tmp_path: Path) -> None:
    study = studies.STUDY.replace("[arm]", "[arm]\ngravity = 9.81", 1)
    with pytest.raises(InvalidInput, match="gravity has a mean in 'u1'"):
        with_steps(tmp_path, '[{ kind = "detrend", channels = ["u1"] }]', study)
    with_steps(tmp_path, '[{ kind = "detrend", channels = ["omega_m1"] }]', study)


# --- estimates --------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def virtual_arm(tmp_path_factory: pytest.TempPathFactory) -> Study:
    """Records of an arm with known parameters."""
    folder = tmp_path_factory.mktemp("steps")
    study = scara.STIFF.study(folder)
    chosen = tuple(e for e in study.experiments if e.name in ("motion", "prbs-j1", "prbs-j2"))
    study = replace(study, experiments=chosen)
    simulate_study(study, scara.STIFF.parameters(), folder, noise=SensorNoise(), as_recorded=False)
    return read_study(folder / "study.toml")


RESONANCE_HZ = 30.0  # the highest of the virtual arm


@pytest.mark.parametrize("step", [LowPass(5.0 * RESONANCE_HZ), Resample(0.002)])
def test_steps_above_the_band_do_not_bias_estimates(step: Step, virtual_arm: Study) -> None:
    study = replace(
        virtual_arm,
        experiments=tuple(replace(e, steps=(step,)) for e in virtual_arm.experiments),
    )
    result = sw.identify(study, stages=("rigid", "decoupled"))
    truth = derived(scara.STIFF.parameters(), study.arm)
    errors = {
        p.label: (p.value - truth[p.key]) / p.std
        for p in result.parameters
        if p.value is not None and p.std and p.key in truth and "viscous" not in p.name
    }
    assert {"alpha", "beta", "gamma", "motor_inertia 1", "link_inertia 2"} <= set(errors)
    assert all(abs(error) < 3.0 for error in errors.values()), errors
    assert "preprocessed" in [warning.code for warning in result.warnings]
    assert "sub-sampled" not in [warning.code for warning in result.warnings]


def test_a_detrended_offset_does_not_reach_the_estimates(virtual_arm: Study) -> None:
    motion = virtual_arm.experiments[0]
    log = read_log(virtual_arm, motion)
    columns = {"t": log.time} | dict(log.channels)
    faulty = columns | {"u1": columns["u1"] + 0.2}

    def offset(data: Columns, *steps: Step) -> float:
        study = replace(virtual_arm, experiments=(replace(motion, steps=steps),))
        result = sw.identify(study, data={motion.name: data}, stages=("rigid",))
        value = result["friction_offset", 1].value
        assert value is not None
        return value

    step = Detrend(("u1",))
    assert offset(faulty) - offset(columns) == pytest.approx(0.2 * 0.08, rel=1e-3)
    assert offset(faulty, step) == pytest.approx(offset(columns, step), abs=1e-9)


def test_a_simulated_record_has_no_steps(virtual_arm: Study, tmp_path: Path) -> None:
    motion = replace(virtual_arm.experiments[0], steps=(LowPass(20.0), Resample(0.01)))
    study = replace(virtual_arm, experiments=(motion,))
    simulate_study(study, scara.STIFF.parameters(), tmp_path, noise=SensorNoise())
    simulated = read_study(tmp_path / "study.toml")
    assert not simulated.experiments[0].steps
    log = read_log(simulated, simulated.experiments[0])
    logged = read_log(virtual_arm, virtual_arm.experiments[0])
    assert log.sample_time == pytest.approx(logged.sample_time)  # held inputs as logged
    np.testing.assert_allclose(log.channels["u1"], logged.channels["u1"], atol=0.05)


def test_records_with_one_step_share_its_note(virtual_arm: Study) -> None:
    steps = (LowPass(150.0),)
    study = replace(
        virtual_arm, experiments=tuple(replace(e, steps=steps) for e in virtual_arm.experiments)
    )
    warnings = sw.check(study).warnings
    (note,) = [warning for warning in warnings if warning.code == "preprocessed"]
    assert all(experiment.name in note.where for experiment in study.experiments)
