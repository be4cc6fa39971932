"""State-space estimates of other tools: samples in, (A, B, C, D) out."""

from __future__ import annotations

import contextlib
import io
from typing import Any

import numpy as np

from strainwave.domain import FloatArray

Matrices = tuple[FloatArray, FloatArray, FloatArray, FloatArray]


def slicot(
    u: FloatArray, y: FloatArray, order: int, horizon: int, *, all_samples: bool = False
) -> Matrices:
    """IB01AD with the fast Cholesky factorisation, and IB01BD on scaled signals.

    A and C by MOESP, B and D by N4SID; B and D by MOESP have errors of their own size here. With
    `all_samples`, IB01CD estimates B and the initial state by least squares over all samples.
    """
    import ctrlsys

    (samples, m), p = u.shape, y.shape[1]
    us, ys = u.std(axis=0), y.std(axis=0)
    scaled = np.asfortranarray(u / us), np.asfortranarray(y / ys)
    R = ctrlsys.ib01ad("M", "C", "N", "O", "N", "N", horizon, m, p, *scaled, 0.0, -1.0)[1]
    A, C, B, D, *_ = ctrlsys.ib01bd("C", "A", "K", horizon, order, m, p, samples, R, 0.0)
    if all_samples:
        A, B, C, D = (np.asfortranarray(part) for part in (A, B, C, D))
        _, B, *_ = ctrlsys.ib01cd("X", "C", "B", order, m, p, A, B, C, D, *scaled, 0.0)
        D = np.zeros_like(D)
    return A, B / us, C * ys[:, None], D * ys[:, None] / us


def nfoursid(u: FloatArray, y: FloatArray, order: int, horizon: int) -> Matrices:
    """Past-output MOESP in Python."""
    import pandas as pd
    from nfoursid.nfoursid import NFourSID

    names = [f"u{i}" for i in range(u.shape[1])], [f"y{i}" for i in range(y.shape[1])]
    frame = pd.DataFrame(np.column_stack([u, y]), columns=[*names[0], *names[1]])
    fit = NFourSID(frame, output_columns=names[1], input_columns=names[0], num_block_rows=horizon)
    fit.subspace_identification()
    model, _ = fit.system_identification(rank=order)
    return model.a, model.b, model.c, model.d


def sippy(u: FloatArray, y: FloatArray, order: int, horizon: int) -> Matrices:
    """N4SID in Python, without its printed output."""
    from sippy_unipi import system_identification

    with contextlib.redirect_stdout(io.StringIO()):
        model: Any = system_identification(y.T, u.T, "N4SID", SS_fixed_order=order, SS_f=horizon)
    return model.A, model.B, model.C, model.D


def jax_sysid(u: FloatArray, y: FloatArray, order: int, horizon: int) -> Matrices:
    """Simulation error by L-BFGS and automatic derivatives, from SLICOT's model."""
    from jax_sysid.models import LinearModel

    A, B, C, _ = slicot(u, y, order, horizon)
    us, ys = u.std(axis=0), y.std(axis=0)
    start = [A, B * us, C / ys[:, None]]
    with contextlib.redirect_stdout(io.StringIO()):
        model = LinearModel(order, y.shape[1], u.shape[1], feedthrough=False, ss=start)
        model.loss(rho_x0=0.0, rho_th=0.0, train_x0=True)
        model.optimization(adam_epochs=0, lbfgs_epochs=1000, iprint=-1)
        model.fit(y / ys, u / us)
    A, B, C, D = (np.asarray(part) for part in model.ssdata())
    return A, B / us, C * ys[:, None], (D * ys[:, None]) / us
