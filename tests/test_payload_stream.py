"""Loads from samples in a loop: recovery, agreement with the record, window, refusals."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import load_records as records
import strainwave as sw
from strainwave.domain import Control, Experiment, FloatArray, FrictionTerm, Joint, Parameter, Study
from strainwave.domain.arm.kinds import planar_two_link
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.rigid_prediction import DELAY
from strainwave.errors import InvalidInput, NotIdentifiable
from strainwave.identification.payload import LoadFit
from strainwave.identification.payload_stream import LoadStream
from strainwave.pipeline.payload import KnownArm, known_arm
from strainwave.pipeline.payload_stream import PayloadStream

LOAD = records.LOAD
TRUTH = np.array([LOAD.mass, *LOAD.xyz])
CARRIED = records.record(LOAD, records.Motion(3))
Columns = dict[str, FloatArray]


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory) -> sw.Result:
    """The chain without a load, from two records of 10 s."""
    data = {f"r{k}": records.record(None, records.Motion(k), noise_seed=k) for k in (1, 2)}
    study = records.study(tmp_path_factory.mktemp("stream"), *data)
    return sw.identify(study, data=data, stages="rigid")


@pytest.fixture(scope="module")
def known(result: sw.Result) -> KnownArm:
    return known_arm(
        result._document, Path("result.json"), result.run.study if result.run else None
    )


def signals(columns: Columns) -> tuple[FloatArray, FloatArray]:
    """Motor angles and torques, (n_samples, 3)."""
    angle, torque = (
        np.column_stack([columns[f"{name}{i}"] for i in (1, 2, 3)])
        for name in ("theta_m", "torque")
    )
    return angle, torque


def feed(stream: LoadStream | PayloadStream, columns: Columns) -> None:
    for angle, torque in zip(*signals(columns), strict=True):
        stream.update(angle, torque)


def stream_of(known: KnownArm, **changes: object) -> LoadStream:
    prior = replace(known.prior, **changes)  # type: ignore[arg-type]
    return LoadStream(known.arm, prior, known.model, sample_time=records.SAMPLE_TIME)


def fit_of(stream: LoadStream, columns: Columns) -> LoadFit:
    feed(stream, columns)
    return stream.fit()


def test_stream_recovers_the_load_and_agrees_with_the_record(result: sw.Result) -> None:
    """Both have the truth inside, and differ by less than the wider interval."""
    stream = result.payload_stream(sample_time=records.SAMPLE_TIME)
    feed(stream, CARRIED)
    load = stream.estimate
    batch = result.payload(records.study(Path(), "l"), data={"l": CARRIED})
    pairs = zip((load.mass, *load.xyz), (batch.mass, *batch.xyz), TRUTH.tolist(), strict=True)
    for of_stream, of_record, true in pairs:
        assert of_stream is not None
        assert of_record is not None
        assert abs(of_stream.value - true) < 4.0 * of_stream.std
        assert abs(of_stream.value - of_record.value) < 3.0 * of_stream.std
    assert load.mass is not None
    assert load.mass.value == pytest.approx(LOAD.mass, rel=0.02)


def test_errors_of_the_stream_have_their_covariance(known: KnownArm) -> None:
    """Mean square of normalised errors over motions; one arm, so its error is common."""
    squares = []
    for seed in range(5):
        columns = records.record(LOAD, records.Motion(10 + seed), noise_seed=50 + seed)
        fit = fit_of(stream_of(known), columns)
        values, covariance = fit.about_centre
        squares += ((values[:4] - TRUTH) ** 2 / np.diag(covariance)[:4]).tolist()
    assert 0.2 < np.mean(squares) < 2.5  # chi-square of 20 correlated values: 0.48 to 1.7 if free


def test_errors_of_the_arm_widen_the_intervals(known: KnownArm) -> None:
    """The variance due to the arm grows with the arm's covariance, and is a part of the whole."""
    columns = records.record(LOAD, records.Motion(4))
    small, large = (
        fit_of(stream_of(known, covariance=k * known.prior.covariance), columns)
        for k in (1e-6, 100.0)
    )
    np.testing.assert_allclose(large.value, small.value, rtol=1e-2, atol=1e-4)
    assert np.all(large.stds > 1.5 * small.stds)


def test_the_window_forgets_an_earlier_load(result: sw.Result) -> None:
    stream = result.payload_stream(sample_time=records.SAMPLE_TIME, window=4.0)
    feed(stream, records.record(replace(LOAD, mass=3.0), records.Motion(5)))
    feed(stream, CARRIED)
    mass = stream.estimate.mass
    assert mass is not None
    assert abs(mass.value - LOAD.mass) < 4.0 * mass.std
    assert mass.std < 0.1


def test_a_change_within_the_window_widens_the_intervals(known: KnownArm) -> None:
    """Blocks before and after it disagree, which the jackknife counts."""
    heavy = records.record(replace(LOAD, mass=3.0), records.Motion(3))
    early = CARRIED["t"] < 0.4 * records.DURATION
    changed = {name: np.where(early, heavy[name], CARRIED[name]) for name in CARRIED}
    fit, steady = fit_of(stream_of(known), changed), fit_of(stream_of(known), CARRIED)
    assert fit.stds[0] > 10.0 * steady.stds[0]


def test_reset_forgets_all_samples(known: KnownArm) -> None:
    stream = stream_of(known)
    feed(stream, records.record(replace(LOAD, mass=3.0), records.Motion(5)))
    stream.reset()
    with pytest.raises(NotIdentifiable, match="0 of 20 blocks"):
        stream.fit()
    np.testing.assert_array_equal(
        fit_of(stream, CARRIED).value, fit_of(stream_of(known), CARRIED).value
    )


@pytest.mark.parametrize("delay", [-1.5, 2.25])
def test_delays_of_torques_are_compensated(known: KnownArm, delay: float) -> None:
    """Torques that are late by a number of samples, with the term of the result, change little."""
    seconds = delay * records.SAMPLE_TIME
    size = Parameter("torque_delay", None, seconds, 1e-6, "s", "rigid")
    late = dict(CARRIED)
    for i in (1, 2, 3):
        late[f"torque{i}"] = np.interp(CARRIED["t"] - seconds, CARRIED["t"], CARRIED[f"torque{i}"])
    terms = (*known.prior.friction_terms, FrictionTerm(DELAY, None, size, 1.0))
    expected = fit_of(stream_of(known), CARRIED)
    fit = fit_of(stream_of(known, friction_terms=terms), late)
    assert np.all(np.abs(fit.value - expected.value) < expected.stds)


def test_an_arm_with_coupled_motors(known: KnownArm) -> None:
    """Coupled motors that move the same links give the same load."""
    coupling = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.5, 1.0]])
    coupled = Arm.of(replace(known.arm, coupling=tuple(map(tuple, coupling.tolist()))))
    raw = (
        known.arm.links_of_rigid(known.prior.motor_shares)
        @ known.prior.solution[: known.arm.n_body]
    )
    solution = np.zeros(len(coupled.rigid_columns))
    solution[: coupled.n_body] = coupled.base.rows[:, : len(raw)] @ raw
    count = len(solution)
    prior = replace(
        known.prior,
        solution=solution,
        covariance=1e-8 * np.eye(count),
        is_determined=np.ones(count, dtype=bool),
    )
    # torques without rotors and friction, by the identified links and the load
    _, motion = records.Motion(3).angles()
    motors = [coupled.motor_accelerations(x) for x in motion]
    model = replace(known.model, motion=np.stack(motors)[:, ::10])
    stream = LoadStream(coupled, prior, model, sample_time=records.SAMPLE_TIME)
    carried = records.link_torques(
        known.arm,
        [[records.Load(m, xyz, records.moments_of(m))] for m, xyz in records.BODIES[:2]]
        + [[records.Load(m, xyz, records.moments_of(m)) for m, xyz in records.BODIES[2:]] + [LOAD]],
        *motion,
    )
    for q, tau in zip(motors[0], coupled.motors_of(carried), strict=True):
        stream.update(q, tau)
    fit = stream.fit()
    assert fit.value[0] == pytest.approx(LOAD.mass, rel=0.1)


def test_refusals(known: KnownArm) -> None:
    stream = stream_of(known)
    with pytest.raises(ValueError, match="expected 3 angles and torques, got 2 and 3"):
        stream.update([0.0, 0.0], [0.0, 0.0, 0.0])
    with pytest.raises(NotIdentifiable, match="0 of 20 blocks"):
        stream.fit()
    with pytest.raises(InvalidInput, match="does not resolve the bandwidth"):
        LoadStream(known.arm, known.prior, known.model, sample_time=0.5)


def test_standstill_is_no_information(known: KnownArm) -> None:
    """Samples at rest fill no block of the window, so that it keeps the motion before them."""
    stream = stream_of(known)
    for _ in range(10000):
        stream.update([1.0, 2.0, 3.0], [0.5, 0.1, 0.1])
    with pytest.raises(NotIdentifiable, match="0 of 20 blocks"):
        stream.fit()


def test_a_planar_arm_has_a_chain_for_the_load(tmp_path: Path) -> None:
    """Its own program has sums of parameters; the load shows mass, centre and inertia in its plane."""
    load = records.Load(0.7, (0.28, 0.04, 0.05), (1e-3, 1e-3, 4e-3))
    described = planar_two_link([Joint("rigid", records.RATIO)] * 2, 0.35, 9.81)
    links = ((4.0, (0.2, 0.0, 0.0)), (2.0, (0.15, 0.0, 0.0)))

    def record_of(seed: int, carried: records.Load | None) -> Columns:
        motion = records.Motion(seed)
        return records.record(carried, motion, described=described, noise_seed=seed, links=links)

    data = {f"r{k}": record_of(k, None) for k in (1, 2)}
    control: tuple[Control, ...] = ("servo", "servo")
    experiments = tuple(Experiment(name, "", "motion", control) for name in data)
    study = Study(arm=described, experiments=experiments, path=tmp_path / "study.toml")
    stream = sw.identify(study, data=data, stages="rigid").payload_stream(
        sample_time=records.SAMPLE_TIME
    )
    columns = record_of(3, load)
    for k in range(len(columns["t"])):
        stream.update(
            *([columns[f"{name}{i}"][k] for i in (1, 2)] for name in ("theta_m", "torque"))
        )
    estimate = stream.estimate
    x, y, z = estimate.xyz
    zz = estimate.inertia_about_centre[5]
    for quantity, true in ((estimate.mass, 0.7), (x, 0.28), (y, 0.04), (zz, 4e-3)):
        assert quantity is not None
        assert abs(quantity.value - true) < 4.0 * quantity.std
    assert z is None
    assert estimate.inertia_about_centre[:5] == (None,) * 5
