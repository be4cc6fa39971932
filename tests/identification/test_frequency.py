"""Frequency responses of known systems, with noise, distortion and resonances."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import lfilter

from elastic_runs import log_of, prbs_run, rig, rig_values, true_model
from strainwave.domain import ComplexArray, Decoupled, FloatArray
from strainwave.dynamics.arm import Arm
from strainwave.errors import InvalidInput, NotIdentifiable
from strainwave.identification import decoupling, frequency
from strainwave.io.logs import read_log
from strainwave.io.study import read_study
from strainwave.signals import link_motion as links

PERIOD = 500
B, A = [0.2, 0.1], [1.0, -0.7]


def true_response(frequencies: FloatArray, T: float = 1.0) -> ComplexArray:
    z = np.exp(-2j * np.pi * frequencies * T)
    return np.asarray((B[0] + B[1] * z) / (1.0 + A[1] * z))


def noisy_periods(
    seed: int, noise: float, count: int = 6, scale: float = 1.0
) -> tuple[FloatArray, FloatArray]:
    rng = np.random.default_rng(seed)
    u = np.tile(rng.normal(size=PERIOD), count)
    y = lfilter(B, A, u) * scale + noise * rng.normal(size=len(u))
    return u[:, None], y[:, None]


# --- periods ----------------------------------------------------------------------------------


def test_whole_periods_give_the_exact_response() -> None:
    estimate = frequency.by_periods([noisy_periods(0, 0.0)], 1.0, PERIOD, 1)
    # after one period, the transient is 0.7^500
    assert estimate.response[:, 0, 0] == pytest.approx(
        true_response(estimate.frequencies_hz), abs=1e-9
    )
    assert estimate.coherence == pytest.approx(1.0)
    assert estimate.n_averages == 5
    assert estimate.distortion_variance is None


def test_the_noise_variance_is_that_of_the_errors() -> None:
    squares = []
    for seed in range(30):
        estimate = frequency.by_periods([noisy_periods(seed, 0.05)], 1.0, PERIOD, 1)
        error = np.abs(estimate.response[:, 0, 0] - true_response(estimate.frequencies_hz)) ** 2
        assert estimate.noise_variance is not None
        squares.append(np.median(error / estimate.noise_variance[:, 0, 0]))
    # |error|^2 / variance estimate with 2 x 4 degrees of freedom is F(2, 8), with median 0.757
    assert np.mean(squares) == pytest.approx(0.757, rel=0.1)


def test_two_inputs_come_apart_over_two_records() -> None:
    rng = np.random.default_rng(1)
    pairs = []
    for _ in range(2):
        u = np.tile(rng.normal(size=(PERIOD, 2)), (3, 1))
        y = np.column_stack([lfilter(B, A, u[:, 0]) + 3.0 * u[:, 1], u[:, 1] - u[:, 0]])
        pairs.append((u, y))
    estimate = frequency.by_periods(pairs, 1.0, PERIOD, 1)
    truth = true_response(estimate.frequencies_hz)
    assert estimate.response[:, 0, 0] == pytest.approx(truth, abs=1e-7)
    assert estimate.response[:, 0, 1] == pytest.approx(3.0, abs=1e-7)
    assert estimate.response[:, 1] == pytest.approx(np.tile([-1.0, 1.0], (len(truth), 1)), abs=1e-7)


def test_distortion_is_the_difference_between_records_beyond_noise() -> None:
    linear = frequency.by_periods([noisy_periods(k, 0.05) for k in range(6)], 1.0, PERIOD, 1)
    scales = 1.0 + 0.2 * np.array([-1.0, -0.6, -0.2, 0.2, 0.6, 1.0])
    pairs = [noisy_periods(k, 0.05, scale=float(s)) for k, s in enumerate(scales)]
    nonlinear = frequency.by_periods(pairs, 1.0, PERIOD, 1)
    assert linear.distortion_variance is not None
    assert nonlinear.distortion_variance is not None
    relative = (
        nonlinear.distortion_variance[:, 0, 0]
        / np.abs(true_response(nonlinear.frequencies_hz)) ** 2
    )
    assert np.median(relative) == pytest.approx(np.var(scales, ddof=1), rel=0.5)
    assert np.median(linear.distortion_variance) < 0.1 * np.median(nonlinear.distortion_variance)


# --- Welch ------------------------------------------------------------------------------------


def test_welch_comes_near_with_the_coherence_the_noise_leaves() -> None:
    rng = np.random.default_rng(3)
    u = rng.normal(size=(60000, 2))
    clean = lfilter(B, A, u[:, 0]) + 0.5 * u[:, 1]
    y = clean + 0.3 * rng.normal(size=len(u))
    estimate = frequency.by_welch([(u, y[:, None])], 1.0, 512)
    truth = true_response(estimate.frequencies_hz)
    error = np.abs(estimate.response[:, 0, 0] - truth) ** 2
    assert estimate.noise_variance is not None
    assert np.mean(error / estimate.noise_variance[:, 0, 0]) == pytest.approx(1.0, rel=0.25)
    expected_coherence = (np.abs(truth) ** 2 + 0.25) / (np.abs(truth) ** 2 + 0.25 + 0.09)
    assert estimate.coherence is not None
    assert estimate.coherence[:, 0] == pytest.approx(expected_coherence, abs=0.1)
    assert estimate.method == "welch"


# --- resonances -------------------------------------------------------------------------------


def two_inertias(f: FloatArray) -> ComplexArray:
    m_M, m_L, k, d_G, n = 1.5e-4, 3.829, 25000.0, 20.0, 0.01
    s = 2j * np.pi * f
    spring = k + d_G * s
    link = m_L * s + spring / s
    return np.asarray(1.0 / (m_M * s + 2e-4 + n**2 * (spring / s) * (1.0 - spring / s / link)))


def test_resonances_of_a_known_joint_to_rounding() -> None:
    f = np.arange(1.0, 80.0, 0.25)
    estimate = frequency.resonance(f, two_inertias(f))
    total_inertia = 1.5e-4 + 3.829e-4
    anti = np.sqrt(25000.0 / 3.829)
    assert estimate.anti_resonance_hz == pytest.approx(anti / (2.0 * np.pi), rel=1e-9)
    assert estimate.anti_resonance_damping == pytest.approx(20.0 / (2.0 * 3.829 * anti), rel=1e-7)
    ratio = estimate.resonance_hz / estimate.anti_resonance_hz
    # D_M changes it slightly.
    assert ratio == pytest.approx(np.sqrt(total_inertia / 1.5e-4), rel=1e-3)


def test_noise_and_weights_move_a_resonance_little() -> None:
    f = np.arange(1.0, 80.0, 0.5)
    truth = two_inertias(f)
    rng = np.random.default_rng(0)
    std = 0.02 * np.median(np.abs(truth)) * np.ones(len(f))
    noise = std * (rng.normal(size=len(f)) + 1j * rng.normal(size=len(f))) / np.sqrt(2.0)
    estimate = frequency.resonance(f, np.asarray(truth + noise, dtype=complex), std**2, (4.0, 60.0))
    exact = frequency.resonance(f, truth)
    assert estimate.anti_resonance_hz == pytest.approx(exact.anti_resonance_hz, rel=0.01)
    assert estimate.resonance_hz == pytest.approx(exact.resonance_hz, rel=0.01)


def test_a_flat_response_has_no_resonance() -> None:
    f = np.arange(1.0, 50.0, 0.5)
    inertia = np.asarray(1.0 / (2j * np.pi * f), dtype=complex)
    with pytest.raises(NotIdentifiable, match="no dip"):
        frequency.resonance(f, inertia)
    with pytest.raises(NotIdentifiable, match="too few"):
        frequency.resonance(f, inertia, band_hz=(10.0, 12.0))


# --- records ----------------------------------------------------------------------------------


@cache
def joint_records(joint: int) -> tuple[Decoupled, ...]:
    study = rig()
    model = true_model(study, rig_values(study))
    records = []
    for excited in (1, 2):
        run = prbs_run(study, excited)
        link_signals = links.prepare_link_signals(
            log_of(run, excited, seed=excited), Arm.of(study.arm)
        )
        records.append(decoupling.decouple(link_signals, model, Arm.of(study.arm))[joint - 1])
    return tuple(records)


@pytest.mark.parametrize("joint", [1, 2])
def test_the_decoupled_joint_has_the_resonances_of_a_two_inertia_system(joint: int) -> None:
    estimate = frequency.estimate_response(joint_records(joint))
    assert estimate.method == "periods"
    assert estimate.noise_variance is not None
    resonances = frequency.resonance(
        estimate.frequencies_hz,
        estimate.response[:, 0, 0],
        estimate.noise_variance[:, 0, 0],
        (5.0, 45.0),
    )
    values = rig_values(rig())
    m_L = [3.82895, 0.64425][joint - 1]
    k, m_M = values["gear_stiffness", joint], values["motor_inertia", joint]
    anti = np.sqrt(k / m_L) / (2.0 * np.pi)
    assert resonances.anti_resonance_hz == pytest.approx(anti, rel=0.01)
    assert resonances.resonance_hz == pytest.approx(
        anti * np.sqrt(1.0 + 1e-4 * m_L / m_M), rel=0.02
    )


def test_options_choose_inputs_and_segments() -> None:
    records = joint_records(1)[:1]
    alone = frequency.estimate_response(records, frequency.FrequencyOptions(inputs=1))
    assert alone.response.shape[2] == 1
    assert alone.method == "periods"
    assert alone.n_averages == 2
    everything = frequency.estimate_response(
        records, frequency.FrequencyOptions(inputs=1, transient_periods=0)
    )
    assert everything.n_averages == 3
    short = frequency.estimate_response(records, frequency.FrequencyOptions(segment=0.5))
    assert short.method == "welch"
    assert short.frequencies_hz[0] == pytest.approx(2.0)


def test_responses_of_incompatible_records_are_refused() -> None:
    first = joint_records(1)[0]
    with pytest.raises(InvalidInput, match="no record"):
        frequency.estimate_response([])
    with pytest.raises(InvalidInput, match="different joints"):
        frequency.estimate_response([first, replace(first, joint=2)])
    with pytest.raises(InvalidInput, match="sampling periods differ"):
        frequency.estimate_response([first, replace(first, sample_time=1e-3)])
    with pytest.raises(NotIdentifiable, match="records"):
        frequency.by_periods([(first.inputs, first.outputs)], first.sample_time, 4092, 1)
    with pytest.raises(NotIdentifiable, match="segments"):
        frequency.by_welch([(first.inputs, first.outputs)], first.sample_time, len(first.time))


def test_lab_resonances_are_those_of_the_arm(shared_data: Path) -> None:
    folder = shared_data / "lab" / "scara-linear-5kg"
    study = read_study(folder / "study.toml")
    model = true_model(study, rig_values(study))
    records = []
    for experiment in study.experiments:
        if experiment.use == "frequency":
            link_signals = links.prepare_link_signals(
                read_log(study, experiment), Arm.of(study.arm)
            )
            records.append(decoupling.decouple(link_signals, model, Arm.of(study.arm)))
    # sqrt(k / m_L) and sqrt(k (1 / m_L + n^2 / m_M)) from truth.json, divided by 2 pi
    for i, (anti, res) in enumerate([(12.860, 24.242), (15.487, 23.428)]):
        estimate = frequency.estimate_response([r[i] for r in records])
        assert estimate.noise_variance is not None
        resonances = frequency.resonance(
            estimate.frequencies_hz,
            estimate.response[:, 0, 0],
            estimate.noise_variance[:, 0, 0],
            (5.0, 45.0),
        )
        assert resonances.anti_resonance_hz == pytest.approx(anti, rel=0.01)
        assert resonances.resonance_hz == pytest.approx(res, rel=0.02)
