"""The saturation check detects clipped sensors and ignores reversals, rests and slow peaks."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from strainwave.domain import Experiment, FloatArray, Joint, Log, Place, Study
from strainwave.domain.arm.kinds import single_joint
from strainwave.dynamics.arm import Arm
from strainwave.input_check import observations

TIME = np.arange(8000) / 4000.0


def find_clipped_channels(
    values: FloatArray, channel: str = "theta_l1", motor: FloatArray | None = None
) -> list[str]:
    joint = Joint(spring="linear", gear_ratio=0.01, torque_per_volt=0.1)
    study = Study(arm=single_joint(joint), experiments=())
    step = Experiment("step", "step.csv", "tuning", ("servo",), joint=1)
    channels = {channel: values} | ({} if motor is None else {"theta_m1": motor})
    log = Log(step, TIME, TIME[1], channels)
    clippings = observations.measure_clipping([log], Arm.of(study.arm))
    return [suspicion.where for _, suspicion in clippings if suspicion is not None]


def rounded(angle: FloatArray, counts: int) -> FloatArray:
    return np.round(angle / (2.0 * np.pi) * counts) * (2.0 * np.pi / counts)


@given(
    size=st.floats(0.01, 1.0),
    hz=st.floats(0.6, 20.0),
    decay=st.floats(0.0, 6.0),
    counts=st.sampled_from([2048, 8192, 131072, 1048576]),
)
def test_reversals_of_an_angle_are_not_clipping(
    size: float, hz: float, decay: float, counts: int
) -> None:
    swing = size * np.exp(-decay * TIME) * np.sin(2.0 * np.pi * hz * TIME)
    assert find_clipped_channels(rounded(swing, counts)) == []


@given(share=st.floats(0.4, 0.8), hz=st.floats(0.6, 20.0))
def test_a_saturated_angle_is_reported_as_clipped(share: float, hz: float) -> None:
    swing = np.sin(2.0 * np.pi * 1.0137 * hz * TIME)  # The period is not a whole number of samples.
    clipped = rounded(np.clip(swing, -share, share), 131072)
    assert find_clipped_channels(clipped) == ["theta_l1"]
    assert find_clipped_channels(clipped, motor=100.0 * swing) == ["theta_l1"]


@given(
    size=st.floats(0.05, 1.0),
    rise=st.floats(0.05, 0.4),
    counts=st.sampled_from([8192, 131072, 1048576]),
)
def test_an_angle_at_rest_after_a_step_is_not_clipped(
    size: float, rise: float, counts: int
) -> None:
    edges = np.clip((TIME - 0.3) / rise, 0.0, 1.0) - np.clip((TIME - 1.0) / rise, 0.0, 1.0)
    angle = size * edges**2 * (3.0 - 2.0 * edges)
    assert find_clipped_channels(rounded(angle, counts), motor=100.0 * angle) == []


def of_16_bits(acceleration: FloatArray, noise: float, seed: int = 0) -> FloatArray:
    count = 40.0 / 2**16
    noisy = acceleration + noise * count * np.random.default_rng(seed).standard_normal(len(TIME))
    return np.asarray(count * np.round(noisy / count))


@given(
    size=st.floats(3.0, 20.0),
    hz=st.floats(0.6, 3.0),
    noise=st.floats(0.0, 2.0),
    seed=st.integers(0, 1000),
)
def test_a_slow_peak_of_an_accelerometer_is_not_clipping(
    size: float, hz: float, noise: float, seed: int
) -> None:
    a = of_16_bits(size * np.sin(2.0 * np.pi * hz * TIME), noise, seed)
    assert find_clipped_channels(a, "a1") == []


@given(
    size=st.floats(3.0, 20.0),
    hz=st.floats(0.6, 3.0),
    noise=st.floats(0.0, 2.0),
    share=st.floats(0.4, 0.9),
)
def test_a_saturated_accelerometer_is_reported_as_clipped(
    size: float, hz: float, noise: float, share: float
) -> None:
    a = of_16_bits(size * np.sin(2.0 * np.pi * 1.0137 * hz * TIME), noise)
    assert find_clipped_channels(np.clip(a, -share * size, share * size), "a1") == ["a1"]


def standing(
    encoder: FloatArray, others: dict[str, FloatArray], control: str = "servo"
) -> list[str]:
    """Records in which the encoder of a joint stands still; it moves in a second record."""
    arm = Arm.of(single_joint(Joint(spring="linear", gear_ratio=0.01, torque_per_volt=0.1)))
    tables = {
        "first": {"theta_m1": encoder, **others},
        "second": {"theta_m1": RATE, "ref1": RATE, "omega_m1": RATE},
    }
    logs = [
        Log(Experiment(name, name, "motion", (control,)), TIME, TIME[1], table)  # type: ignore[arg-type]
        for name, table in tables.items()
    ]
    found = observations.measure_standing_encoders(logs, arm)
    places = [place for _, fault in found if fault is not None for place in fault.places]
    return [record for place in places for record in place.experiments]


RATE = np.asarray(np.cos(2.0 * np.pi * TIME), dtype=np.float64)
REST = np.zeros_like(TIME)
DITHER = 1e-3 * np.round(0.5 + 0.5 * np.sin(40.0 * TIME))


@given(kind=st.sampled_from(["ref1", "omega_m1", "theta_l1"]), size=st.floats(0.2, 50.0))
def test_a_standing_encoder_contradicts_a_channel_of_motion(kind: str, size: float) -> None:
    assert standing(DITHER, {kind: size * RATE}) == ["first"]
    assert standing(REST, {kind: size * RATE}) == ["first"]
    assert standing(np.round(RATE, 2), {kind: size * RATE}) == []


@given(noise=st.floats(0.0, 0.05), seed=st.integers(0, 1000))
def test_a_joint_at_rest_is_no_standing_encoder(noise: float, seed: int) -> None:
    torque = np.random.default_rng(seed).standard_normal(len(TIME))
    rate = noise * np.random.default_rng(seed).standard_normal(len(TIME))
    assert standing(DITHER, {"ref1": REST, "omega_m1": rate, "torque1": torque}) == []
    # no servo follows the reference
    assert standing(DITHER, {"ref1": RATE, "torque1": torque}, "open") == []


def test_an_encoder_that_follows_no_motion_is_unknown_in_all_records() -> None:
    arm = Arm.of(single_joint(Joint(spring="linear", gear_ratio=0.01, torque_per_volt=0.1)))
    logs = [
        Log(
            Experiment(name, name, "motion", ("servo",)),
            TIME,
            TIME[1],
            {"theta_m1": DITHER, "ref1": rate},
        )
        for name, rate in (("moves", RATE), ("rests", REST))
    ]
    ((relation, fault),) = observations.measure_standing_encoders(logs, arm)
    assert not relation.is_consistent
    assert fault is not None
    assert fault.places == (Place(channel="theta_m1"),)
