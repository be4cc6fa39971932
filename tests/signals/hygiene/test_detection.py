"""Detection of synthetic defects of given position and size, and absence of false detections."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from benchmarks.families.sensor_defects import DEFECT_SIZES, Injected, injected
from hypothesis import assume, given
from hypothesis import strategies as st

from strainwave.domain import Experiment, FloatArray, Log
from strainwave.dynamics.arm import Arm
from strainwave.io.logs import read_logs
from strainwave.io.study import read_study
from strainwave.signals import hygiene
from strainwave.virtual import scara

SMALL_ARM = Path(__file__).parents[2] / "data" / "small-arm" / "study.toml"
SHARED = Path(__file__).parents[4] / "shared" / "data"
CERTAIN: dict[hygiene.Kind, float] = {
    "spikes": 10.0,
    "frozen": 50.0,
    "encoder-steps": 4096.0,
    "flat-tops": 0.9,
    "mains-hum": 0.1,
}
"""Sizes, in the units of `SIZES`, at which a defect is detected at any position."""

ARM = Arm.of(scara.STIFF.study(Path(), "linear").arm)
TIME: FloatArray = np.arange(12_000, dtype=np.float64) * 2.5e-4
COUNT = 2.0 * np.pi / 8192  # [rad] of the simulated encoder
rng = np.random.default_rng


@cache
def clean() -> tuple[Log, ...]:
    """A slow and a fast motion with encoder quantization and sensor noise."""
    return tuple(made(seed) for seed in (1, 2))


def made(seed: int) -> Log:
    noise = rng(seed)
    channels: dict[str, FloatArray] = {}
    w = 2.0 * np.pi * np.array([0.9, 2.3, 4.1, 7.7]) * (1.0 + 0.1 * noise.normal(size=4))
    for i in (1, 2):
        phase, amplitude = noise.uniform(0.0, 6.0, 4), 20.0 / w**1.5
        angle = np.sin(np.outer(TIME, w) + phase) @ amplitude
        acceleration = -np.sin(np.outer(TIME, w) + phase) @ (amplitude * w**2)
        channels[f"theta_m{i}"] = COUNT * np.round(angle / COUNT)
        channels[f"u{i}"] = 1e-2 * acceleration + 0.02 * noise.normal(size=len(TIME))
        channels[f"a{i}"] = digits(3e-3 * acceleration + 0.02 * noise.normal(size=len(TIME)), 2e-3)
        channels[f"gyro{i}"] = 1e-2 * np.gradient(angle, TIME) + 2e-3 * noise.normal(size=len(TIME))
    return record(channels, f"motion-{seed}")


def digits(values: FloatArray, step: float) -> FloatArray:
    return np.asarray(step * np.round(values / step))


def record(channels: dict[str, FloatArray], name: str = "record", control: str = "servo") -> Log:
    experiment = Experiment(name, f"{name}.csv", "motion", (control, control))  # type: ignore[arg-type]
    return Log(experiment, TIME[: len(channels["theta_m1"])], TIME[1], channels)


def found(log: Log) -> list[str]:
    return [f"{defect.kind} {defect.channel}" for defect in hygiene.detect_defects([log], ARM)[0]]


def with_channel(log: Log, name: str, x: FloatArray) -> Log:
    return replace(log, channels={**log.channels, name: x})


# --- detection of defects ---------------------------------------------------------------------


def test_every_kind_of_defect_has_a_detector_and_sizes() -> None:
    """Each kind of defect has a detector, sizes and a test size."""
    assert set(DEFECT_SIZES) == set(CERTAIN) == set(hygiene.DETECTORS)


@pytest.mark.parametrize("kind", sorted(hygiene.DETECTORS))
@given(seed=st.integers(0, 10_000), factor=st.floats(1.0, 4.0))
def test_a_large_defect_is_detected_at_any_position(
    kind: hygiene.Kind, seed: int, factor: float
) -> None:
    """A sufficiently large defect is detected at any position."""
    size = CERTAIN[kind] * (1.0 if kind == "flat-tops" else factor)
    if kind == "encoder-steps":
        size = round(size)
    drawn = injected(clean(), ARM, kind, size, rng(seed))
    assert drawn is not None
    assume(kind != "frozen" or not is_ambiguous(drawn))
    detections = zip(drawn.logs, hygiene.detect_defects(drawn.logs, ARM), strict=True)
    assert [
        log.name for log, record_defects in detections if drawn.named(record_defects)
    ] or kind == "flat-tops"


def is_ambiguous(drawn: Injected) -> bool:
    """Whether a frozen stretch looks the same as something that is not a defect."""
    return not missed_something(drawn) or rushed(drawn) or is_at_limit(drawn)


def missed_something(drawn: Injected) -> bool:
    """Whether the missed motion of a frozen angle exceeds the motion of the next few samples."""
    log = next(log for log in drawn.logs if log.name == drawn.record)
    x, (_, stop) = log.channels[drawn.channel], drawn.spans[0]
    after = float(np.abs(np.diff(x[stop : stop + 5])).max())
    return not drawn.channel.startswith("theta") or abs(x[stop] - x[stop - 1]) > 8 * after


def rushed(drawn: Injected) -> bool:
    """Whether the speed during a frozen stretch is three times the speed around it.

    Such a defect cannot be distinguished from an encoder step.
    """
    log = next(log for log in drawn.logs if log.name == drawn.record)
    x, (start, stop) = log.channels[drawn.channel], drawn.spans[0]
    sides = (x[max(0, start - 16) : start + 1], x[stop : stop + 17])
    fastest = max(float(np.ptp(side)) for side in sides) / 16.0
    missed = abs(x[stop] - x[stop - 1]) / (stop - start)
    return drawn.channel.startswith("theta") and missed > 3.0 * fastest


def is_at_limit(drawn: Injected) -> bool:
    """Whether a sensor is frozen at an end of its range, where saturation looks the same."""
    log = next(log for log in drawn.logs if log.name == drawn.record)
    x, (start, _) = log.channels[drawn.channel], drawn.spans[0]
    is_extreme = min(x[start] - x.min(), x.max() - x[start]) < 1e-3 * float(np.ptp(x))
    return not drawn.channel.startswith("theta") and is_extreme


@given(
    at=st.integers(1000, 11_000),
    shape=st.sampled_from([(1.0,), (1.0, 1.0), (1.0, 0.4, 1.3)]),
    size=st.floats(5.0, 1e4),
)
def test_a_spike_is_located_to_the_sample(at: int, shape: tuple[float, ...], size: float) -> None:
    x = clean()[0].channels["a1"].copy()
    x[at : at + len(shape)] += size * np.array(shape)
    record_defects = hygiene.detect_defects([with_channel(clean()[0], "a1", x)], ARM)[0]
    assert [(d.kind, d.channel, d.start, d.stop) for d in record_defects] == [
        ("spikes", "a1", at, at + len(shape))
    ]


@given(bits=st.integers(9, 12), seed=st.integers(0, 100))
def test_counter_overflows_are_removed(bits: int, seed: int) -> None:
    log = clean()[seed % 2]
    counts = np.round(log.channels["theta_m1"] / COUNT)
    wrapped = COUNT * np.mod(counts, 2**bits)
    n_wraps = np.count_nonzero(np.abs(np.diff(wrapped)) > COUNT * 2 ** (bits - 1))
    (usable,), warnings = hygiene.repair_records([with_channel(log, "theta_m1", wrapped)], ARM)
    if n_wraps > 1:
        assert [w.code for w in warnings] == ["encoder-steps"]
        error = usable.channels["theta_m1"] - log.channels["theta_m1"]
        assert np.ptp(error[~usable.masked["theta_m1"]]) < 1e-9


# --- no false detections ----------------------------------------------------------------------


@pytest.mark.parametrize("samples", [2, 40, 128, 129])
def test_a_record_of_any_length_is_examined(samples: int) -> None:
    ramp = np.linspace(0.0, 1.0, samples)
    repeated = {"theta_m1": ramp, "u1": np.full(samples, 2.0), "a1": np.full(samples, 0.3)}
    assert found(record(repeated)) == []


def test_a_repeated_reading_of_a_motor_is_not_a_step() -> None:
    """A log that is written faster than the encoder is read repeats a reading now and then."""
    read_at = np.arange(len(TIME)) - np.cumsum(np.arange(len(TIME)) % 1900 == 1000)
    late = 8.0 * np.sin(3.0 * TIME + 1.0)[read_at]
    log = with_channel(clean()[0], "theta_m1", late)
    assert not [name for name in found(log) if "theta_m1" in name]


def test_clean_logs_give_no_detection() -> None:
    """Logs without defects give no detection and no warning."""
    assert [found(log) for log in clean()] == [[], []]
    study = read_study(SMALL_ARM)
    assert hygiene.repair_records(read_logs(study), Arm.of(study.arm))[1] == ()


@pytest.mark.skipif(not SHARED.exists(), reason="the shared data are not there")
@pytest.mark.parametrize(
    "name",
    [
        "lab/scara-linear-5kg",
        "lab/scara-strainwave-3kg",
        "lab/vertical-linear-0kg",
        "real/emps",
        "real/dfki-double-pendulum",
        "real/ist-flexible-arm",
    ],
)
def test_shared_logs_give_no_warning_and_are_unchanged(name: str) -> None:
    """Shared logs give no warning and are unchanged."""
    study = read_study(SHARED / name / "study.toml")
    logs = read_logs(study)
    usable, warnings = hygiene.repair_records(logs, Arm.of(study.arm))
    assert warnings == ()
    assert usable == logs


@given(seed=st.integers(0, 1000), stands=st.integers(50, 2000), at=st.integers(1000, 9000))
def test_a_motor_at_standstill_is_not_frozen(seed: int, stands: int, at: int) -> None:
    log = made(seed)
    channels = dict(log.channels)
    # The motor stops and starts without a step of its velocity, as friction permits.
    rate = np.ones(len(TIME))
    ramp = 400
    rate[at : at + stands] = 0.0
    rate[at - ramp : at] = np.linspace(1.0, 0.0, ramp)
    rate[at + stands : at + stands + ramp] = np.linspace(0.0, 1.0, ramp)[: len(TIME) - at - stands]
    warped_time = np.cumsum(rate)
    for i in (1, 2):
        angle = np.interp(warped_time, np.arange(len(TIME)), channels[f"theta_m{i}"])
        channels[f"theta_m{i}"] = COUNT * np.round(angle / COUNT)
    assert found(record(channels)) == []


@given(
    seed=st.integers(0, 1000),
    clock=st.integers(1, 40),
    amplitude=st.floats(1.0, 10.0),
)
def test_a_pseudo_random_voltage_is_not_a_defect(seed: int, clock: int, amplitude: float) -> None:
    levels = rng(seed).integers(0, 2, len(TIME) // clock + 1)
    voltage = np.asarray(amplitude * (2.0 * np.repeat(levels, clock)[: len(TIME)] - 1.0))
    log = with_channel(clean()[0], "u1", voltage)
    for control in ("open", "servo"):
        assert found(record(dict(log.channels), control=control)) == []


@given(limit=st.floats(0.1, 0.9))
def test_a_servo_at_its_limit_is_not_a_defect(limit: float) -> None:
    u = clean()[0].channels["u1"]
    bound = limit * float(np.abs(u).max())
    assert found(with_channel(clean()[0], "u1", np.clip(u, -bound, bound))) == []


@given(height=st.floats(0.5, 20.0), at=st.integers(500, 11_000), decay=st.floats(10.0, 400.0))
def test_a_step_of_a_reference_is_not_a_spike(height: float, at: int, decay: float) -> None:
    since = np.clip(np.arange(len(TIME)) - at, 0, None)
    transient = np.where(np.arange(len(TIME)) >= at, height * np.exp(-since / decay), 0.0)
    u = clean()[0].channels["u1"] + transient
    assert found(with_channel(clean()[0], "u1", u)) == []


@given(step=st.floats(0.001, 0.05), seed=st.integers(0, 20))
def test_a_coarse_sensor_has_no_frozen_stretches_or_flat_tops(step: float, seed: int) -> None:
    log = made(seed)
    rate = log.channels["gyro1"]
    assert found(with_channel(log, "gyro1", digits(rate, step))) == []


@given(hz=st.floats(20.0, 80.0), damping=st.floats(0.01, 0.1), seed=st.integers(0, 1000))
def test_a_resonance_is_not_mains_hum(hz: float, damping: float, seed: int) -> None:
    logs = []
    w = 2.0 * np.pi * hz
    impulse_response = np.exp(-damping * w * TIME) * np.sin(w * TIME)
    for k, log in enumerate(clean()):
        force = rng([seed, k]).normal(size=len(TIME))
        n = 2 * len(TIME)
        vibration = np.fft.irfft(np.fft.rfft(force, n) * np.fft.rfft(impulse_response, n), n)[
            : len(TIME)
        ]
        a = log.channels["a1"] + vibration / np.std(vibration)
        logs.append(with_channel(log, "a1", a))
    assert hygiene.detect_defects(logs, ARM) == [[], []]
