"""A store of synthetic visits as tables of a campaign."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

LEVELS = {
    ("beta", None): (0.64, "kg m^2", 0.001, 0.0005),
    ("gear_stiffness", 1): (25000.0, "N m/rad", 0.002, 0.003),
    ("motor_coulomb_friction", 1): (0.06, "N m", 0.003, 0.03),
    ("total_viscous_friction", 1): (2.5e-4, "N m s/rad", 0.005, 0.03),
    ("motor_inertia", 1): (1.5e-4, "kg m^2", 0.002, 0.001),
    ("friction_offset", 1): (0.0, "N m", 1.0, 0.5),
}
"""Name and joint -> level, unit, standard deviation of a run and between visits, of the level."""

START = datetime(2026, 1, 5, 8, 0, tzinfo=UTC)

Factor = Callable[[str, int | None, int, int], float]
"""(name, joint, visit, visits) -> factor of the level."""


def healthy(name: str, joint: int | None, visit: int, visits: int) -> float:
    return 1.0


def softening(name: str, joint: int | None, visit: int, visits: int) -> float:
    """Step of -2 % in the stiffness after two thirds of the visits."""
    return 0.98 if name == "gear_stiffness" and visit >= 2 * visits // 3 else 1.0


def rubbing(name: str, joint: int | None, visit: int, visits: int) -> float:
    """Coulomb friction that grows by 40 % from the first visit to the last."""
    grown = 0.4 * visit / (visits - 1) if name == "motor_coulomb_friction" else 0.0
    return 1.0 + grown


def rows(
    arm: str, visits: int, rng: np.random.Generator, factor: Factor = healthy
) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """Rows of runs and parameters, one visit per week."""
    runs, parameters = [], []
    for visit in range(visits):
        run, study = f"{arm}-{visit}", f"fleet/{arm}/visit-{visit:03d}.toml"
        runs.append(
            {
                "run": run,
                "study": study,
                "study_sha256": run,
                "version": "0.1.0",
                "options_sha256": "0",
                "status": "determined",
                "exit_code": 0,
                "message": None,
                "started": (START + timedelta(days=7 * visit)).replace(tzinfo=None),
                "seconds": 5.0,
                "worker": "here:1",
                "result": f"results/{run}/result.json",
            }
        )
        for (name, joint), (level, unit, own, between) in LEVELS.items():
            scale = abs(level) or 1e-6
            std = scale * own * float(rng.uniform(0.7, 1.4))
            value = level * factor(name, joint, visit, visits)
            value += scale * between * rng.normal() + std * rng.normal()
            parameters.append(
                {
                    "run": run,
                    "study": study,
                    "name": name,
                    "joint": joint,
                    "value": value,
                    "std": std,
                    "ci95_low": value - 1.96 * std,
                    "ci95_high": value + 1.96 * std,
                    "unit": unit,
                    "stage": "tuned",
                }
            )
    return runs, parameters


def write(
    store: Path, runs: Sequence[Mapping[str, Any]], parameters: Sequence[Mapping[str, Any]]
) -> Path:
    """Write one file per run, as a campaign does."""
    for kind in ("runs", "parameters"):
        (store / kind).mkdir(parents=True, exist_ok=True)
    for row in runs:
        own = [one for one in parameters if one["run"] == row["run"]]
        for kind, table in (("runs", [row]), ("parameters", own)):
            if table:
                written = pa.Table.from_pylist([dict(one) for one in table])
                pq.write_table(written, store / kind / f"{row['run']}.parquet")
    return store


def fleet(store: Path, factors: Mapping[str, Factor], visits: int = 24, seed: int = 0) -> Path:
    """A store with one arm per factor."""
    rng = np.random.default_rng(seed)
    for arm, factor in factors.items():
        write(store, *rows(arm, visits, rng, factor))
    return store
