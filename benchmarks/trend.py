"""False alarms and delays of `strainwave trend`: `python -m benchmarks.trend`.

Healthy arms of 12 parameters with correlated scatter between visits, half of them with a
temperature that every other parameter follows; then arms that wear after 20 healthy visits, looked
at after each visit.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from datetime import UTC, datetime, timedelta

import numpy as np
from rich.console import Console
from rich.table import Table

from strainwave.domain import FloatArray
from strainwave.monitoring.shapes import Series, change_of
from strainwave.monitoring.trend import trend
from strainwave.monitoring.visits import ArmHistory, Histories, ParameterHistory, Visit

PARAMETERS = 12
HEALTHY = 20  # visits before wear
PATIENCE = 40  # visits after which a fault counts as not named
LEVEL = 0.01

Wear = Callable[[FloatArray], FloatArray]
"""Visits since the fault began, from zero -> share of its full size."""


def step(since: FloatArray) -> FloatArray:
    return np.asarray((since >= 0.0).astype(np.float64))


def ramp(since: FloatArray) -> FloatArray:
    """The full size after ten visits, and on at the same pace."""
    return np.asarray(np.maximum(since + 1.0, 0.0) / 10.0)


CASES: list[tuple[str, float, float, float, str, Wear]] = [
    (what, size, own, between, name, wear)
    for what, size, own, scatters in (
        ("stiffness -2 %", -0.02, 0.002, (0.0, 0.002, 0.005, 0.01)),
        ("friction +10 %", 0.10, 0.003, (0.01, 0.02, 0.04)),
    )
    for between in scatters
    for name, wear in (("step", step), ("ramp over 10 visits", ramp))
]
"""Fault, size, deviation of a run, deviation between visits (of the value), and how it comes."""


def healthy_arm(rng: np.random.Generator, visits: int) -> Histories:
    """An arm that does not change."""
    time = 7.0 * np.arange(visits) + rng.uniform(0.0, 2.0, visits)
    warm = rng.integers(2) == 1
    temperature = 20.0 + 5.0 * np.sin(2.0 * np.pi * time / 365.0) + rng.normal(size=visits)
    covariates = temperature[:, None] if warm else np.empty((visits, 0))
    mixed = rng.normal(size=(PARAMETERS, PARAMETERS)) + 2.0 * np.eye(PARAMETERS)
    common = rng.normal(size=(visits, PARAMETERS)) @ mixed.T / np.sqrt(PARAMETERS + 4.0)
    start = datetime(2026, 1, 1, tzinfo=UTC)
    seen = tuple(Visit(f"{k}", "arm", start + timedelta(days=float(t))) for k, t in enumerate(time))
    parameters = []
    for k in range(PARAMETERS):
        between = float(rng.choice([0.0, 0.5, 2.0, 8.0]))  # runs' own deviations
        std = np.exp(0.4 * rng.normal(size=visits))
        value = 1000.0 + between * common[:, k] + std * rng.normal(size=visits)
        if warm and k % 2:
            value -= 3.0 * temperature
        series = Series(time, value, std, covariates)
        parameters.append(ParameterHistory(f"p{k}", None, "", "tuned", seen, series))
    return Histories(
        (ArmHistory("arm", seen, tuple(parameters)),), ("temperature",) if warm else (), "recorded"
    )


def false_alarms(rng: np.random.Generator, arms: int) -> dict[int, tuple[int, int]]:
    """Visits -> arms, and those named though they do not change."""
    found: dict[int, tuple[int, int]] = {}
    for k in range(arms):
        visits = (8, 12, 20, 40)[k % 4]
        named = trend(healthy_arm(rng, visits), LEVEL).concern
        before = found.get(visits, (0, 0))
        found[visits] = before[0] + 1, before[1] + named
    return found


def delay(rng: np.random.Generator, size: float, own: float, between: float, wear: Wear) -> int:
    """Visits from the first with a fault until it is named; `PATIENCE` where it is not."""
    n = HEALTHY + PATIENCE
    since = np.arange(n) - HEALTHY
    std = np.full(n, own)
    value = 1.0 + size * wear(since.astype(np.float64))
    value += between * rng.normal(size=n) + own * rng.normal(size=n)
    for visits in range(HEALTHY + 1, n):
        seen = slice(0, visits)
        series = Series(
            7.0 * np.arange(visits, dtype=np.float64),
            value[seen],
            std[seen],
            np.empty((visits, 0)),
        )
        change = change_of(series, rng)
        if change is not None and PARAMETERS * change.p < LEVEL:
            return visits - HEALTHY
    return PATIENCE


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--arms", type=int, default=1000)
    parser.add_argument("--faults", type=int, default=100, help="of each case")
    parser.add_argument("--seed", type=int, default=0)
    chosen = parser.parse_args()
    rng = np.random.default_rng(chosen.seed)
    console = Console()
    table = Table("visits", "healthy arms", "named", "share [%]", box=None)
    counted = false_alarms(rng, chosen.arms)
    for visits, (arms, named) in counted.items():
        table.add_row(f"{visits}", f"{arms}", f"{named}", f"{100.0 * named / arms:.2f}")
    arms, named = (sum(each[k] for each in counted.values()) for k in (0, 1))
    table.add_row("all", f"{arms}", f"{named}", f"{100.0 * named / arms:.2f}")
    console.print(table)
    table = Table("fault", "comes as", "run [%]", "between [%]", box=None)
    for head in ("median delay", "90 %", f"not within {PATIENCE}"):
        table.add_column(head, justify="right")
    for what, size, own, between, name, wear in CASES:
        delays = [delay(rng, size, own, between, wear) for _ in range(chosen.faults)]
        late = sum(each == PATIENCE for each in delays)
        middle, most = np.percentile(delays, [50, 90], method="higher")
        cells = (
            what,
            name,
            f"{100 * own:g}",
            f"{100 * between:g}",
            f"{middle}",
            f"{most}",
            f"{late}",
        )
        table.add_row(*cells)
    console.print(table)


if __name__ == "__main__":
    main()
