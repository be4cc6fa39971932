"""Margins of known loops; responses of sampled plants against their exact discretisation."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import minimize_scalar

from servo_arms import exact_responses, loops_of, rig
from strainwave.domain import ComplexArray, FloatArray
from strainwave.export.randomisation import drawn_values
from strainwave.tune.cascade_tuning import Loops
from strainwave.tune.closed_loop import (
    Clock,
    Gains,
    SampledResponses,
    Steps,
    close,
    frequency_grid,
    low_pass,
    sample,
)
from strainwave.tune.margins import (
    LoopBand,
    Requirements,
    join,
    margins_of,
    open_loops,
)
from strainwave.tune.plants import Condition, Plants, PoleSums, plants_of

OMEGA = np.geomspace(0.1, 1e3, 4000)
# linear interpolation between 4000 frequencies of four decades: about the square of a step
INTERPOLATION = 1e-5
GAINS = [
    Gains(kp=0.3, ki=5.0, position_gain=10.0, period=1e-3),
    Gains(kp=0.2, ki=4.0, position_gain=12.0, period=1e-3),
]


@pytest.fixture(scope="module")
def plants() -> Plants:
    arm = rig()
    draws = drawn_values(arm, None, 2, np.random.default_rng(0))
    return plants_of(arm, draws, [Condition(np.zeros(2)), Condition(np.array([0.3, 1.8]))])


@pytest.mark.parametrize(("gain", "delay"), [(20.0, 0.01), (5.0, 0.2)])
def test_an_integrator_with_delay_has_its_closed_form_margins(gain: float, delay: float) -> None:
    def loop(omega: FloatArray) -> ComplexArray:
        return np.asarray(gain * np.exp(-1j * omega * delay) / (1j * omega))

    margins = margins_of(loop(OMEGA)[None], OMEGA)
    db = 20.0 * np.log10(np.pi / (2.0 * gain * delay))
    assert margins.gain_db[0] == pytest.approx(db, abs=1e-3)
    assert margins.gain_hz[0] == pytest.approx(0.25 / delay, rel=1e-4)
    assert margins.phase_deg[0] == pytest.approx(90.0 - np.degrees(gain * delay), abs=1e-3)
    assert margins.phase_hz[0] == pytest.approx(gain / (2.0 * np.pi), rel=INTERPOLATION)
    assert margins.bandwidth_hz[0] == pytest.approx(gain / (2.0 * np.pi), rel=INTERPOLATION)
    nearest = minimize_scalar(
        lambda x: abs(1.0 + loop(np.array(x))), bounds=(0.1 / delay, 3.0 / delay), method="bounded"
    )
    assert margins.modulus[0] == pytest.approx(nearest.fun, rel=1e-4)
    # the grid has the place of the minimum to a step
    assert margins.modulus_hz[0] == pytest.approx(nearest.x / (2.0 * np.pi), rel=3e-3)


def test_a_loop_that_needs_gain_has_a_margin_downwards() -> None:
    """2 (s + 1)^2 / s^3 is -4 at one radian per second: a quarter of the gain is the limit."""
    s = 1j * OMEGA
    margins = margins_of(np.array([2.0 * (s + 1.0) ** 2 / s**3]), OMEGA)
    assert margins.gain_db[0] == pytest.approx(20.0 * np.log10(4.0), abs=1e-3)
    assert margins.gain_hz[0] == pytest.approx(0.5 / np.pi, rel=1e-4)


@pytest.mark.parametrize("joint", [0, 1])
def test_encirclements_differ_by_the_unstable_poles(plants: Plants, joint: int) -> None:
    """Stable and unstable loops under drawn gains and filters, the other joint's loop closed."""
    loops = Loops.of(plants, Clock(1e-3, 0.4e-3))
    every = np.arange(len(plants))
    symmetric, rng = loops.responses.symmetric(every), np.random.default_rng(0)
    encirclements, unstable = [], []
    for _ in range(60):
        bandwidth = np.exp(rng.uniform(np.log(1.0), np.log(3e3)))
        kp, filters = 5e-3 * bandwidth, (low_pass(rng.uniform(20.0, 400.0), 1e-3),)
        gains = GAINS.copy()
        gains[joint] = Gains(
            kp=kp,
            ki=kp * bandwidth / rng.uniform(2.0, 10.0),
            position_gain=bandwidth / rng.uniform(2.5, 15.0),
            period=1e-3,
            filters=filters[: rng.integers(2)],
        )
        loop = loops.open_loops(symmetric, loops.controllers(gains))[joint]
        encirclements.append(margins_of(loop, loops.omega).encirclements)
        poles = close(loops.sampled, [each.law() for each in gains]).poles()
        unstable.append((np.abs(poles) > 1.0).sum(axis=1))
    of_loops, of_poles = (np.array(each) for each in (encirclements, unstable))
    assert {0, 2} <= set(of_poles.ravel().tolist())
    np.testing.assert_array_equal(np.diff(of_loops, axis=0), np.diff(of_poles, axis=0))


def test_a_loop_without_crossings_has_no_limits() -> None:
    margins = margins_of(np.array([0.5 / (1.0 + 1j * OMEGA)]), OMEGA)
    assert margins.gain_db[0] == margins.phase_deg[0] == np.inf
    assert np.isnan(margins.gain_hz[0])
    assert margins.bandwidth_hz[0] == 0.0
    assert margins.modulus[0] > 1.0


def test_the_smallest_crossing_of_a_resonance_counts() -> None:
    """A light resonance behind the integrator adds crossings; the bandwidth is the last one."""
    s = 1j * OMEGA
    resonance = 100.0**2 / (s**2 + 2.0 * 0.02 * 100.0 * s + 100.0**2)
    margins = margins_of(np.array([10.0 / s * resonance]), OMEGA)
    # at the resonance the loop is -10 / (100 * 2 * 0.02); chords of its circle are 0.3 % short
    assert margins.gain_db[0] == pytest.approx(20.0 * np.log10(2.5), abs=0.03)
    assert margins.gain_hz[0] == pytest.approx(100.0 / (2.0 * np.pi), rel=1e-3)
    assert margins.bandwidth_hz[0] > 100.0 / (2.0 * np.pi)


def test_the_worst_plant_has_the_smallest_share_of_any_margin() -> None:
    s = 1j * OMEGA
    loops = [gain * np.exp(-0.01 * s) / s for gain in (10.0, 40.0, 20.0)]
    margins = margins_of(np.array(loops), OMEGA)
    for required in (Requirements(), Requirements(1e-3, 30.0, 1e-3), Requirements(1e-3, 1e-3, 0.5)):
        assert int(np.argmin(margins.share(required))) == 1
    share = margins.share(Requirements(gain_db=1e-3, phase_deg=60.0, modulus=1e-3))
    np.testing.assert_allclose(share, margins.phase_deg / 60.0)
    assert share[0] > 1.0 > np.float64(margins.share(Requirements(phase_deg=89.0))[1])


@pytest.mark.parametrize("delay", [0.0, 0.4e-3, 1e-3])
def test_sampled_responses_are_those_of_the_exact_discretisation(
    plants: Plants, delay: float
) -> None:
    clock = Clock(1e-3, delay)
    omega = frequency_grid(plants.resonances(), clock)[::10]
    omega = omega[omega < 0.9 * clock.nyquist]
    exact = exact_responses(sample(plants, clock), np.exp(1j * omega * clock.period))
    responses = full(SampledResponses.of(plants, omega, clock))
    for i in range(2):
        # of the aliases that are left out, those of the fourth sampling rate are 3e-4 at most
        error = np.abs(responses[..., i, i] / exact[..., i, i] - 1.0)
        assert error.max() < 5e-4
    size = np.abs(exact[..., 0, 0] * exact[..., 1, 1]) ** 0.5
    assert (np.abs(responses - exact)[..., 0, 1] / size).max() < 1e-5


def full(responses: SampledResponses) -> ComplexArray:
    """Responses of all plants, (n_plants, n_omega, n_joints, n_joints)."""
    symmetric = responses.symmetric(np.arange(len(responses.motor_inertias)))[:, [[0, 1], [1, 2]]]
    return np.moveaxis(symmetric * responses.drive, 3, 1)


@pytest.mark.parametrize("friction", [1.0, 1e-9, 0.0])
def test_responses_are_those_of_the_equations_of_motion(plants: Plants, friction: float) -> None:
    """Without friction, the rigid motion of an arm without gravity has two equal poles."""
    arms = replace(plants, damping=friction * plants.damping)
    omega = np.geomspace(0.3, 3e3, 50)
    s = 1j * omega[:, None, None]
    system = s**2 * arms.mass[:, None] + s * arms.damping[:, None] + arms.stiffness[:, None]
    expected = np.moveaxis(arms.motors @ np.linalg.inv(system) @ arms.motors.T, 1, 3)
    responses = PoleSums.of(arms, omega).responses(omega, np.arange(len(arms)))
    size = np.abs(expected).max(axis=(1, 2))[:, None]
    # the accuracy of the sums over poles, and of the inverse between rigid motion and resonances
    error = np.abs(responses - expected[:, [0, 0, 1], [0, 1, 1]])
    np.testing.assert_array_less(error / size, 1e-8)


@pytest.mark.parametrize("joint", [0, 1])
def test_an_open_loop_has_the_other_loop_closed(plants: Plants, joint: int) -> None:
    """y / w = G P / (1 + C P) of the complete closed loop, with C = G (K + d), d the difference."""
    clock = Clock(1e-3, 0.4e-3)
    omega = np.geomspace(1.0, 0.9 * clock.nyquist, 60)
    z = np.exp(1j * omega * clock.period)
    sampled = sample(plants, clock)
    controllers = np.stack([gains.response(z) for gains in GAINS])
    responses = exact_responses(sampled, z) / plants.torque_per_volt  # symmetric
    symmetric = np.moveaxis(responses[..., [0, 0, 1], [0, 1, 1]], 2, 1)
    loops = open_loops(symmetric, controllers * plants.torque_per_volt[:, None])[joint]
    own = GAINS[joint]
    of_velocity = own.kp + own.ki * clock.period / (1.0 - 1.0 / z)
    expected = of_velocity * loops / controllers[joint] / (1.0 + loops)

    loop = close(sampled, [gains.law() for gains in GAINS], (joint,))
    system = z[:, None, None] * np.eye(loop.A.shape[1]) - loop.A[:, None]
    inputs = np.broadcast_to(loop.B[:, None, :, 0, 1:], (*system.shape[:3], 1)).astype(complex)
    motor = np.pad(sampled.motors[joint], (0, loop.A.shape[1] - sampled.A.shape[1]))
    response = (motor @ np.linalg.solve(system, inputs))[..., 0]
    np.testing.assert_allclose(response, expected, rtol=1e-6)
    alone = controllers[joint] * exact_responses(sampled, z)[..., joint, joint]
    assert np.abs(loops / alone - 1.0).max() > 0.01  # the coupling matters


def test_loops_of_six_joints_are_those_of_a_solution_at_each_frequency() -> None:
    rng = np.random.default_rng(0)
    parts = rng.standard_normal((4, 2, 3, 5, 6, 6))
    responses = parts[0, 0] + 1j * parts[1, 1]
    responses = responses + np.swapaxes(responses, 2, 3)
    factors = parts[2, 0, 0, :, 0].T + 1j * parts[3, 0, 0, :, 0].T
    first, second = np.triu_indices(6)
    symmetric = np.moveaxis(responses[..., first, second], 2, 1)
    np.testing.assert_allclose(
        open_loops(symmetric, factors), loops_of(responses, factors), rtol=1e-9
    )


def test_sizes_that_do_not_fit_are_refused() -> None:
    loops = np.ones((3, 5), dtype=complex)
    with pytest.raises(ValueError, match="4 frequencies, got 10 numbers"):
        margins_of(loops, OMEGA[:4])
    with pytest.raises(ValueError, match="all pairs of 2 joints"):
        open_loops(np.ones((7, 2, 5), dtype=complex), loops[:2])


def test_bands_contain_all_loops_and_begin_with_the_estimates() -> None:
    s = 1j * OMEGA
    loops = np.array([gain / s**2 / (1.0 + 0.01 * s) for gain in (10.0, 20.0, 5.0)])
    band = LoopBand.of(loops, OMEGA)
    np.testing.assert_allclose(band.gain_db[:, 1], 20.0 * np.log10(np.abs(loops[0])))
    np.testing.assert_allclose(np.diff(band.gain_db, axis=1)[:, 0], 20.0 * np.log10(2.0))
    np.testing.assert_allclose(np.diff(band.gain_db, axis=1)[:, 1], 20.0 * np.log10(2.0))
    # continuous through -180 degrees, alike for all
    phase = -180.0 - np.degrees(np.arctan(0.01 * OMEGA))
    np.testing.assert_allclose(band.phase_deg, np.tile(phase[:, None], 3), atol=1e-9)
    np.testing.assert_allclose(band.distance[:, 0], np.abs(1.0 + loops).min(axis=0))
    np.testing.assert_allclose(band.distance[:, 2], np.abs(1.0 + loops).max(axis=0))


@pytest.mark.parametrize("by_velocity", [False, True])
def test_steps_equal_the_recursion_sample_by_sample(plants: Plants, by_velocity: bool) -> None:
    sampled = sample(plants, Clock(1e-3, 0.4e-3))
    gains = [replace(each, position_gain=0.0) if by_velocity else each for each in GAINS]
    laws = [each.law() for each in gains]
    loop = close(sampled, laws, (1,))
    (steps,) = Steps.of(loop, gains[1:])
    reference = np.zeros((len(steps.time), 2))
    reference[slice(1) if by_velocity else slice(None), int(by_velocity)] = (
        1e3 if by_velocity else 1.0
    )
    state = np.zeros(loop.A.shape[:2])
    link = np.empty((len(state), len(reference)))
    for k, now in enumerate(reference):
        link[:, k] = state @ loop.links[0] / loop.ratios
        state = (loop.A @ state[..., None])[..., 0] + loop.B[:, :, 0] @ now
    np.testing.assert_allclose(steps.link[:, 0], link.min(axis=0), atol=1e-9)
    np.testing.assert_allclose(steps.link[:, 1], link[0], atol=1e-9)
    np.testing.assert_allclose(steps.overshoot, np.maximum(link.max(axis=1) - 1.0, 0.0), atol=1e-9)
    parts = [
        Steps.of(close(sampled.part(half), laws, (0, 1)), gains)[1]
        for half in (slice(len(plants) // 2), slice(len(plants) // 2, None))
    ]
    joined = join(parts, "time", ("link",))
    np.testing.assert_allclose(joined.link, steps.link, atol=1e-12)
    np.testing.assert_array_equal(joined.settling, steps.settling)


@pytest.mark.parametrize("factor", [0.5, 3.0])
def test_stability_is_that_of_lapacks_poles(plants: Plants, factor: float) -> None:
    """Also where a loop without position loop has a pole at one, and near the stability limit."""
    sampled = sample(plants, Clock(1e-3, 0.4e-3))
    gains = [replace(each, kp=factor * each.kp, position_gain=0.0) for each in GAINS]
    loop = close(sampled, [each.law() for each in gains])
    largest = np.abs(np.linalg.eigvals(loop.A)).max(axis=1)
    np.testing.assert_array_equal(loop.are_stable(), largest < 1.0 + 1e-6)
    for limit in np.outer(np.sort(largest), [1.0 - 1e-7, 1.0 + 1e-7]).ravel().tolist():
        np.testing.assert_array_equal(loop.are_stable(limit), largest < limit)
