"""Subspace methods: noise-free data, channel units, several records and errors."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from strainwave.domain import FloatArray, InputOutput, StateSpace
from strainwave.errors import InvalidInput, NotIdentifiable
from strainwave.statespace import frequency_response, remove_means, subspace
from strainwave.statespace._scaled import Stack, stack
from strainwave.statespace.subspace import Factors, realise
from two_inertia import SAMPLE_TIME, TwoInertia, excitation, simulate, state_space

ARM = TwoInertia()
FREQUENCIES = np.linspace(5.0, 400.0, 50)
GAIN = np.array([[0.0, 1e-3], [0.3, 0.5], [0.001, 0.3]])
NOISE = np.array([0.3, 0.005])  # [rad/s], 1 % of the motor velocity and of the link velocity


def response_error(model: StateSpace, truth: StateSpace) -> float:
    """Largest error of any channel, relative to the largest response of the channel."""
    response = frequency_response(model, FREQUENCIES).response
    true_response = frequency_response(truth, FREQUENCIES).response
    return float(
        (np.abs(response - true_response).max(axis=0) / np.abs(true_response).max(axis=0)).max()
    )


@pytest.mark.parametrize("method", ["moesp", "n4sid", "predictor", "auto"])
@pytest.mark.parametrize("seed", [0, 1])
def test_exact_data_give_the_exact_model(
    method: Literal["moesp", "n4sid", "predictor"], seed: int
) -> None:
    truth, rng = ARM.sampled(), np.random.default_rng(seed)
    data = simulate(truth, excitation(rng, 800), initial_state=np.array([1e-4, 5.0, 0.05]))
    model = subspace(data, 3, method=method)
    # Rounding of 1e-16 times the condition number of a Hankel matrix of lightly damped data, about
    # 1e4.
    assert response_error(model, truth) < 1e-9
    assert min(model.fit_percent) > 100.0 - 1e-7


@pytest.mark.parametrize("method", ["moesp", "predictor"])
def test_estimate_agrees_with_dense_matrices(method: Literal["moesp", "predictor"]) -> None:
    """Singular values and poles by their definition from the Hankel matrix of two records."""
    truth, past, rng = ARM.sampled(GAIN), 8, np.random.default_rng(5)
    records = [
        simulate(truth, excitation(rng, n), NOISE * rng.standard_normal((n, 2))) for n in (300, 200)
    ]
    data = stack(records)
    realisation, singular_values = realise(Factors(data), 3, method, past, (False, False))
    if method == "moesp":
        rows = hankel(data, 2 * past)
        w, future = rows[:, :past].reshape(len(rows), -1), rows[:, past:]
        u, y = future[..., :2].reshape(len(rows), -1), future[..., 2:].reshape(len(rows), -1)
        Q = np.linalg.qr(w - u @ np.linalg.lstsq(u, w)[0])[0]
        _, s, Vt = np.linalg.svd(Q.T @ (y - u @ np.linalg.lstsq(u, y)[0]))
        observability = Vt[:3].T * np.sqrt(s[:3])
        A = np.linalg.lstsq(observability[:-2], observability[2:])[0]
    else:
        rows = hankel(data, past + 1)
        z, u, y = rows[:, -2::-1].reshape(len(rows), -1), rows[:, -1, :2], rows[:, -1, 2:]
        M = np.linalg.lstsq(np.hstack([u, z]), y)[0][2:].T
        shifted = [np.pad(M[:, 4 * j :], ((0, 0), (0, 4 * j))) for j in range(past)]
        U, s, _ = np.linalg.svd(np.vstack(shifted) @ z.T, full_matrices=False)
        to_state = (U[:, :3].T @ np.vstack(shifted)) / np.sqrt(s[:3, None])
        next_z = np.hstack([u, y, z[:, :-4]])
        x, next_x = z @ to_state.T, next_z @ to_state.T
        A = np.linalg.lstsq(np.hstack([x, u]), next_x)[0][:3].T
    # the estimate is from Z'Z, which squares the condition number of about 1e3
    np.testing.assert_allclose(singular_values, s, rtol=1e-8)
    poles, expected = (np.sort_complex(np.linalg.eigvals(a)) for a in (realisation.A, A))
    np.testing.assert_allclose(poles, expected, rtol=1e-8)


def hankel(data: Stack, depth: int) -> FloatArray:
    """Windows (n_rows, depth, n_channels) of samples within one record."""
    windows = [
        np.lib.stride_tricks.sliding_window_view(data.samples[record], depth, axis=0)
        for record in data.rows()
    ]
    return np.concatenate(windows).transpose(0, 2, 1)


@given(
    st.tuples(*[st.floats(-6.0, 6.0)] * 4),
    st.integers(0, 2**32 - 1),
)
def test_units_of_channels_do_not_matter(powers: tuple[float, ...], seed: int) -> None:
    factor = 10.0 ** np.array(powers)
    rng = np.random.default_rng(seed)
    truth = ARM.sampled(GAIN)
    data = simulate(truth, excitation(rng, 300), NOISE * rng.standard_normal((300, 2)))
    scaled = InputOutput(
        data.inputs * factor[:2], data.outputs * factor[2:], SAMPLE_TIME, data.hold
    )
    plain = frequency_response(subspace(data, 3), FREQUENCIES).response
    other = frequency_response(subspace(scaled, 3), FREQUENCIES).response
    rescaled = other * factor[:2] / factor[2:, None]
    # Rounding only: the estimation error is larger.
    np.testing.assert_allclose(rescaled, plain, rtol=1e-5, atol=1e-7 * np.abs(plain).max())


def test_records_are_never_joined() -> None:
    truth, rng = ARM.sampled(), np.random.default_rng(3)
    starts = (np.zeros(3), np.array([1e-3, 40.0, 0.4]), np.array([0.0, -40.0, -0.4]))
    records = [simulate(truth, excitation(rng, 250), initial_state=x) for x in starts]
    model = subspace(records, 3)
    assert response_error(model, truth) < 1e-9
    assert model.initial_states.shape == (3, 3)


def test_singular_values_show_the_order() -> None:
    rng = np.random.default_rng(0)
    model = subspace(simulate(ARM.sampled(), excitation(rng, 800)))
    assert model.order == 3


def test_error_falls_with_the_root_of_the_length() -> None:
    truth = ARM.sampled(GAIN)
    errors = []
    for samples in (2000, 32000):
        each = []
        for seed in range(6):
            rng = np.random.default_rng(seed)
            noise = NOISE * rng.standard_normal((samples, 2))
            data = simulate(truth, excitation(rng, samples), noise)
            each.append(response_error(subspace(data, 3, horizon=20), truth))
        errors.append(np.sqrt(np.mean(np.square(each))))
    # Sixteen times the data reduce the error to a quarter; the scatter of six seeds is about 30 %.
    assert 2.5 < errors[0] / errors[1] < 6.0


def test_horizon_and_feedthrough_are_heard() -> None:
    rng = np.random.default_rng(0)
    data = simulate(ARM.sampled(GAIN), excitation(rng, 500), NOISE * rng.standard_normal((500, 2)))
    assert subspace(data, 3, horizon=17).horizon == 17
    default = subspace(data, 3)
    assert not default.D[:, 0].any()  # inputs with zero-order hold act one sample later
    assert default.D[:, 1].all()
    assert subspace(data, 3, feedthrough=(True, True)).D.all()
    assert not subspace(data, 3, feedthrough=(False, False)).D.any()


def test_constant_and_repeated_channels_do_not_break() -> None:
    rng = np.random.default_rng(0)
    data = simulate(ARM.sampled(GAIN), excitation(rng, 400), NOISE * rng.standard_normal((400, 2)))
    silent = data.inputs * [1.0, 0.0]
    repeated = data.inputs[:, [0, 0]]
    for inputs in (silent, repeated):
        model = subspace(InputOutput(inputs, data.outputs, SAMPLE_TIME), 3)
        assert np.isfinite(model.A).all()
        assert np.abs(model.B).max() < 1.0  # 0.3 with all inputs
        assert (model.B[:, 1] == 0.0).all() == (inputs is silent)


def test_the_mean_of_each_record_is_subtracted() -> None:
    rng = np.random.default_rng(0)
    data = simulate(ARM.sampled(), excitation(rng, 200))
    lifted = replace(data, outputs=data.outputs + np.array([100.0, -3.0]))
    for record in remove_means([data, lifted]):
        np.testing.assert_allclose(record.outputs.mean(axis=0), 0.0, atol=1e-12)
        np.testing.assert_allclose(record.inputs.mean(axis=0), 0.0, atol=1e-12)
    one, other = remove_means([data, lifted])
    np.testing.assert_allclose(one.outputs, other.outputs, atol=1e-11)


def test_short_records_are_not_identifiable() -> None:
    data = simulate(ARM.sampled(), excitation(np.random.default_rng(0), 400))
    with pytest.raises(NotIdentifiable, match="12 samples in 1 records are too few"):
        subspace(data.window(0, 12), 3)
    with pytest.raises(NotIdentifiable, match="horizon of 120 samples"):
        subspace(data, 3, horizon=120)
    with pytest.raises(InvalidInput, match="a horizon of at least 4, got 3"):
        subspace(data, 6, horizon=3)


def test_first_order_by_hand() -> None:
    """y[k+1] = 0.9 y[k] + 2 u[k]."""
    truth = state_space(
        np.array([[0.9]]), np.array([[2.0]]), np.eye(1), np.zeros((1, 1)), hold=("zero",)
    )
    u = np.random.default_rng(0).standard_normal((60, 1))
    model = subspace(simulate(truth, u), 1)
    assert model.A[0, 0] == pytest.approx(0.9, rel=1e-9)
    assert model.C[0, 0] * model.B[0, 0] == pytest.approx(2.0, rel=1e-9)


BAD = [
    ({"inputs": np.zeros(10)}, "expected inputs of shape"),
    ({"outputs": np.zeros((9, 2))}, "as many samples of outputs as of inputs"),
    ({"outputs": np.full((10, 2), np.nan)}, "finite outputs"),
    ({"sample_time": 0.0}, "sample time > 0"),
    ({"hold": ("zero",)}, "a hold for each of 2 inputs"),
    ({"hold": ("zero", "linear")}, "hold zero or first"),
    ({"inputs": np.zeros((0, 2)), "outputs": np.zeros((0, 2))}, "expected samples, got none"),
]


@pytest.mark.parametrize(("change", "message"), BAD)
def test_data_that_do_not_fit_are_refused(change: dict[str, object], message: str) -> None:
    fields: dict[str, object] = {
        "inputs": np.zeros((10, 2)),
        "outputs": np.zeros((10, 2)),
        "sample_time": SAMPLE_TIME,
    }
    record = InputOutput(**{**fields, **change})  # type: ignore[arg-type]
    with pytest.raises(InvalidInput, match=message):
        subspace(record, 2)


def test_records_of_different_kinds_are_refused() -> None:
    one = InputOutput(np.ones((50, 2)), np.ones((50, 2)), 1e-3)
    with pytest.raises(InvalidInput, match="record 2: expected sample time as in record 1"):
        subspace([one, InputOutput(one.inputs, one.outputs, 2e-3)], 2)
    with pytest.raises(InvalidInput, match="record 2: expected inputs as in record 1"):
        subspace([one, InputOutput(one.inputs[:, :1], one.outputs, 1e-3)], 2)
    with pytest.raises(InvalidInput, match="at least one record"):
        subspace([], 2)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"order": 0}, "order of at least 1"),
        ({"horizon": 0}, "horizon of at least 1"),
        ({"method": "cva"}, "expected method"),
        ({"feedthrough": (True,)}, "feedthrough for each of 2 inputs"),
    ],
)
def test_options_that_make_no_sense_are_refused(options: dict[str, object], message: str) -> None:
    rng = np.random.default_rng(0)
    data = simulate(ARM.sampled(), excitation(rng, 100))
    with pytest.raises(InvalidInput, match=message):
        subspace(data, **options)  # type: ignore[arg-type]
