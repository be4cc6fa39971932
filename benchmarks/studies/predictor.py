"""Rows as they are, or predicted from their own past: `python -m benchmarks.studies.predictor`.

The whole-arm fit weighs a channel's errors as if they were white, with a count of how often they
repeat each other. A predictor has a model of the noise: here an autoregression of each channel's
errors in each record, through which rows and derivatives pass before they count (Box and Jenkins'
structure, one step from the plain minimum). Told are the errors of both, by parameter.
"""

from __future__ import annotations

import argparse
from collections import defaultdict
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table
from scipy.linalg import solve_toeplitz
from scipy.signal import lfilter

from benchmarks.studies.arms import each, with_logs
from strainwave import pipeline
from strainwave.domain import FloatArray
from strainwave.domain.parameters import Values
from strainwave.dynamics.arm import Arm
from strainwave.identification.whole_arm import Fit, fitted
from strainwave.identification.whole_arm.objective import Rows
from strainwave.io import logs
from strainwave.io.study import read_study

ORDER = 12  # of the noise models
WAYS = ("rows", "predictor")


def tried(path: Path, values: Values) -> dict[str, Any]:
    """Relative errors both ways."""
    study = read_study(path)
    before = pipeline.identify(path, stages=("rigid", "decoupled"))
    fit = fitted(logs.read_logs(study), before.rigid, before.joints, Arm.of(study.arm))
    space = fit.objective.space
    ends = {"rows": fit.z, "predictor": space.moved(fit.z, _step(fit))}
    found: dict[str, Any] = {}
    for way, z in ends.items():
        pairs = zip(space.keys, space.parameters(z).tolist(), strict=True)
        found[way] = {
            f"{name} {joint or ''}".strip(): value / true - 1.0
            for (name, joint), value in pairs
            if (true := values.get((name, joint), 0.0)) != 0.0
        }
    return found


def _step(fit: Fit) -> FloatArray:
    """From the plain minimum to that of the errors that the past does not predict."""
    prior = fit.objective.space.prior
    slope = prior.rows @ fit.objective.space.slope(fit.z)
    off = prior.rows @ fit.objective.space.parameters(fit.z) - prior.target
    tables = [np.column_stack([slope, off])]
    for rows in fit.objective.rows(fit.z):
        n_own = rows.local.shape[2]
        factor = np.linalg.qr(_predicted(rows), mode="r")
        tables.append(np.asarray(factor)[n_own:, n_own:])
    table = np.concatenate(tables)
    return np.asarray(np.linalg.lstsq(table[:, :-1], -table[:, -1])[0])


def _predicted(rows: Rows) -> FloatArray:
    """[local shared residual] of one record, each channel through the filter that whitens it."""
    table = np.concatenate([rows.local, rows.shared, rows.residual[..., None]], axis=2)
    white = []
    for channel in range(table.shape[1]):
        errors = rows.residual[:, channel] - rows.residual[:, channel].mean()
        if not np.any(errors):  # a motor that stands
            continue
        products = np.array([errors[: len(errors) - k] @ errors[k:] for k in range(ORDER + 1)])
        past = solve_toeplitz(products[:-1], products[1:])
        passed = lfilter(np.concatenate([[1.0], -past]), [1.0], table[:, channel], axis=0)[ORDER:]
        white.append(passed / np.std(passed[:, -1]))
    return np.concatenate(white)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--arms", type=int, default=40)
    parser.add_argument("--out", type=Path, help="lines of JSON, from which a run goes on")
    chosen = parser.parse_args()
    errors: dict[str, dict[str, list[float]]] = {way: defaultdict(list) for way in WAYS}
    for found in each(chosen.arms, partial(with_logs, work=tried), chosen.out):
        for way in WAYS:
            for name, error in found.get(way, {}).items():
                errors[way][name].append(error)
    table = Table("parameter", *(f"rms error %, {way}" for way in WAYS), box=None)
    for name in errors["rows"]:
        sizes = [np.sqrt(np.mean(np.square(errors[way][name]))) for way in WAYS]
        table.add_row(name, *(f"{100.0 * size:.3g}" for size in sizes))
    Console().print(table)


if __name__ == "__main__":
    main()
