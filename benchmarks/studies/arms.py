"""Drawn arms, their simulated logs, and a pool of processes to try methods on them."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from strainwave.domain import Experiment, Prbs, Spring, Study
from strainwave.domain.parameters import Values
from strainwave.dynamics.simulation import simulate
from strainwave.virtual import scara
from strainwave.virtual.experiments import simulate_study
from strainwave.virtual.families.rigs import Rig
from strainwave.virtual.records import Simulator

Work = Callable[[Path, Values], dict[str, Any]]
Change = Callable[[Path, Rig], None]
"""Made of a folder with logs and study before work sees it."""

SPREAD = 0.3  # of the logarithms of a drawn arm's parameters, up and down
SETTLES = 2.0  # one arm in as many has friction that takes its time
SETTLING = (5e-5, 2e-4)  # [s]
SPRINGS: tuple[Spring, ...] = ("linear", "three-slope")


def drawn(seed: int) -> tuple[Study, Values]:
    """An arm unlike the built-in one: payload, gears, motors and friction by chance."""
    rng = np.random.default_rng([2009, seed])
    spring = SPRINGS[seed % len(SPRINGS)]
    values = scara.parameters(int(rng.integers(0, scara.MOST_DISKS + 1)), spring)
    gears: dict[int, float] = {}
    for name, joint in list(values):
        if joint is None or name == "friction_offset":
            continue
        factor = float(np.exp(rng.uniform(-SPREAD, SPREAD)))
        if name.startswith("gear_stiffness"):  # one for all slopes, so that they still rise
            factor = gears.setdefault(joint, factor)
        values[name, joint] *= factor
    for joint in (1, 2):
        friction = values["motor_coulomb_friction", joint]
        values["friction_offset", joint] = float(rng.uniform(-0.05, 0.05)) * friction
        if rng.uniform() * SETTLES < 1.0:
            values["friction_settling_time", joint] = float(rng.uniform(*SETTLING))
    return replace(scara.study(Path(), spring), experiments=_experiments(spring)), values


def rig(seed: int) -> Rig:
    """The same with the built-in rig's sensors."""
    return Rig(*drawn(seed))


def _experiments(spring: Spring) -> tuple[Experiment, ...]:
    """The built-in rig's, shorter; a curve needs records of more than one amplitude."""
    kept = []
    for own in scara.study(Path(), spring).experiments:
        if own.use == "frequency":
            kept.append(replace(own, prbs=Prbs(10, 1e-3, 2, 10.0)))
            if spring == "three-slope":
                name = f"sweep-j{own.joint}"
                small = replace(own, name=name, file=f"{name}.parquet", use="sweep")
                kept.append(replace(small, prbs=Prbs(10, 1e-3, 2, 4.0)))
        elif own.use != "check":
            kept.append(own)
    return tuple(kept)


def with_logs(
    seed: int,
    work: Work,
    arm: Callable[[int], Rig] = rig,
    simulator: Simulator = simulate,
    change: Change = lambda folder, rig: None,
) -> dict[str, Any]:
    """What `work` finds of a drawn arm's study file and its truth; failures are found as well."""
    own = arm(seed)
    study, values = own.study, own.values
    with TemporaryDirectory() as folder:
        simulate_study(
            study,
            values,
            Path(folder),
            seed=seed,
            noise=own.noise,
            as_recorded=False,
            sample_time=own.sample_time,
            simulator=simulator,
        )
        change(Path(folder), own)
        try:
            found = work(Path(folder) / "study.toml", values)
        except Exception as failure:  # a study reports, it does not stop
            found = {"failure": f"{type(failure).__name__}: {failure}"}
    spring = study.arm.joints[0].spring
    return {"seed": seed, "spring": spring, "classes": own.classes, **found}


def each(
    n_arms: int,
    found_by: Callable[[int], dict[str, Any]],
    out: Path | None,
    at_once: int | None = None,
) -> Iterator[dict[str, Any]]:
    """Every drawn arm's findings as they come, one process a core; kept as lines of JSON.

    `found_by` is `with_logs` for some work, and takes an arm's seed.
    """
    lines = out.read_text().splitlines() if out is not None and out.exists() else []
    before = [json.loads(line) for line in lines]
    yield from before
    done = {found["seed"] for found in before}
    left = [seed for seed in range(n_arms) if seed not in done]
    os.environ |= {"OPENBLAS_NUM_THREADS": "1"}
    with ProcessPoolExecutor(at_once or os.cpu_count(), mp_context=get_context("spawn")) as pool:
        for found in pool.map(found_by, left):
            if out is not None:
                with out.open("a") as file:
                    file.write(json.dumps(found) + "\n")
            yield found
