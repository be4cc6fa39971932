"""False alarms and detection delays of `strainwave trend`: `python -m benchmarks.trend`.

Unchanged arms have 12 parameters with correlated scatter between visits; in half of them every
other parameter depends on temperature. Worn arms change after 20 visits and are tested after each
further visit.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from datetime import UTC, datetime, timedelta

import numpy as np
from rich.table import Table

from benchmarks.console import Console
from strainwave.domain import FloatArray
from strainwave.fleet.monitoring.shapes import ParameterSeries, fit_change
from strainwave.fleet.monitoring.trend import trend
from strainwave.fleet.monitoring.visits import ArmHistory, Histories, ParameterHistory, Visit

PARAMETERS = 12
HEALTHY = 20  # visits before wear
PATIENCE = 40  # visits after which a change counts as not detected
LEVEL = 0.01  # probability of a false alarm per arm

Wear = Callable[[FloatArray], FloatArray]
"""Visits since the change began, from zero -> share of its full size."""


def step(since: FloatArray) -> FloatArray:
    return np.asarray((since >= 0.0).astype(np.float64))


def ramp(since: FloatArray) -> FloatArray:
    """Full size after ten visits, continuing at the same rate."""
    return np.asarray(np.maximum(since + 1.0, 0.0) / 10.0)


CASES: list[tuple[str, float, float, float, str, Wear]] = [
    (fault, size, std, between, name, wear)
    for fault, size, std, scatters in (
        ("stiffness -2 %", -0.02, 0.002, (0.0, 0.002, 0.005, 0.01)),
        ("friction +10 %", 0.10, 0.003, (0.01, 0.02, 0.04)),
    )
    for between in scatters
    for name, wear in (("step", step), ("ramp over 10 visits", ramp))
]
"""Fault, relative size, relative std of a run and between visits, and course over the visits."""


def healthy_arm(rng: np.random.Generator, visits: int) -> Histories:
    """History of an arm that does not change."""
    time = 7.0 * np.arange(visits) + rng.uniform(0.0, 2.0, visits)
    warm = rng.integers(2) == 1
    temperature = 20.0 + 5.0 * np.sin(2.0 * np.pi * time / 365.0) + rng.normal(size=visits)
    covariates = temperature[:, None] if warm else np.empty((visits, 0))
    mixed = rng.normal(size=(PARAMETERS, PARAMETERS)) + 2.0 * np.eye(PARAMETERS)
    common = rng.normal(size=(visits, PARAMETERS)) @ mixed.T / np.sqrt(PARAMETERS + 4.0)
    start = datetime(2026, 1, 1, tzinfo=UTC)
    visit_list = tuple(
        Visit(f"{k}", "arm", start + timedelta(days=float(t))) for k, t in enumerate(time)
    )
    parameters = []
    for k in range(PARAMETERS):
        between = float(rng.choice([0.0, 0.5, 2.0, 8.0]))  # [std of a run]
        std = np.exp(0.4 * rng.normal(size=visits))
        value = 1000.0 + between * common[:, k] + std * rng.normal(size=visits)
        if warm and k % 2:
            value -= 3.0 * temperature
        series = ParameterSeries(time, value, std, covariates)
        parameters.append(ParameterHistory(f"p{k}", None, "", "tuned", visit_list, series))
    return Histories(
        (ArmHistory("arm", visit_list, tuple(parameters)),),
        ("temperature",) if warm else (),
    )


def false_alarms(rng: np.random.Generator, arms: int) -> dict[int, tuple[int, int]]:
    """Number of visits -> number of arms and of false alarms."""
    counts: dict[int, tuple[int, int]] = {}
    for k in range(arms):
        visits = (8, 12, 20, 40)[k % 4]
        alarm = trend(healthy_arm(rng, visits), LEVEL).concern
        n_arms, n_alarms = counts.get(visits, (0, 0))
        counts[visits] = n_arms + 1, n_alarms + alarm
    return counts


def delay(rng: np.random.Generator, size: float, run_std: float, between: float, wear: Wear) -> int:
    """Visits from the first with a change until its detection; at most `PATIENCE`."""
    n = HEALTHY + PATIENCE
    since = np.arange(n) - HEALTHY
    std = np.full(n, run_std)
    value = 1.0 + size * wear(since.astype(np.float64))
    value += between * rng.normal(size=n) + run_std * rng.normal(size=n)
    for visits in range(HEALTHY + 1, n):
        past = slice(0, visits)
        series = ParameterSeries(
            7.0 * np.arange(visits, dtype=np.float64),
            value[past],
            std[past],
            np.empty((visits, 0)),
        )
        change = fit_change(series, rng)
        if change is not None and PARAMETERS * change.p < LEVEL:
            return visits - HEALTHY
    return PATIENCE


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--arms", type=int, default=1000)
    parser.add_argument("--faults", type=int, default=100, help="of each case")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    rng = np.random.default_rng(options.seed)
    console = Console()
    table = Table("visits", "unchanged arms", "alarms", "share [%]", box=None)
    counts = false_alarms(rng, options.arms)
    for visits, (arms, alarms) in counts.items():
        table.add_row(f"{visits}", f"{arms}", f"{alarms}", f"{100.0 * alarms / arms:.2f}")
    arms, alarms = (sum(pair[k] for pair in counts.values()) for k in (0, 1))
    table.add_row("all", f"{arms}", f"{alarms}", f"{100.0 * alarms / arms:.2f}")
    console.print(table)
    table = Table("fault", "course", "run [%]", "between [%]", box=None)
    for head in ("median delay", "90 %", f"not within {PATIENCE}"):
        table.add_column(head, justify="right")
    for fault, size, run_std, between, name, wear in CASES:
        delays = [delay(rng, size, run_std, between, wear) for _ in range(options.faults)]
        undetected = sum(visits == PATIENCE for visits in delays)
        median, most = np.percentile(delays, [50, 90], method="higher")
        cells = (
            fault,
            name,
            f"{100 * run_std:g}",
            f"{100 * between:g}",
            f"{median}",
            f"{most}",
            f"{undetected}",
        )
        table.add_row(*cells)
    console.print(table)


if __name__ == "__main__":
    main()
