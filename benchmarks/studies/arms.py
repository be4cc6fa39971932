"""Draw arms at random, simulate their logs, and evaluate methods on them in a pool of processes."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from benchmarks.families.rigs import Rig
from strainwave.domain import Experiment, Prbs, Spring, Study
from strainwave.domain.keys import Values
from strainwave.dynamics.simulation import simulate
from strainwave.virtual import scara
from strainwave.virtual.experiments import Simulator, simulate_study

Work = Callable[[Path, Values], dict[str, Any]]
Change = Callable[[Path, Rig], None]
"""Changes a folder with logs and study before the work starts."""

SPREAD = 0.3  # half range of the logarithms of a drawn arm's parameters
SETTLING_SHARE = 0.5  # of the motors have a friction settling time
SETTLING = (5e-5, 2e-4)  # [s]
SPRINGS: tuple[Spring, ...] = ("linear", "three-slope")


def draw_arm(seed: int) -> tuple[Study, Values]:
    """Draw payload, gears, motors and friction around the built-in arm."""
    rng = np.random.default_rng([2009, seed])
    spring = SPRINGS[seed % len(SPRINGS)]
    values = scara.STIFF.parameters(int(rng.integers(0, scara.MAX_DISKS + 1)), spring)
    gears: dict[int, float] = {}
    for name, joint in list(values):
        if joint is None or name == "friction_offset":
            continue
        factor = float(np.exp(rng.uniform(-SPREAD, SPREAD)))
        if name.startswith("gear_stiffness"):  # one factor for all slopes, so that they still rise
            factor = gears.setdefault(joint, factor)
        values[name, joint] *= factor
    for joint in (1, 2):
        friction = values["motor_coulomb_friction", joint]
        values["friction_offset", joint] = float(rng.uniform(-0.05, 0.05)) * friction
        if rng.uniform() < SETTLING_SHARE:
            values["friction_settling_time", joint] = float(rng.uniform(*SETTLING))
    return replace(scara.STIFF.study(Path(), spring), experiments=_experiments(spring)), values


def draw_rig(seed: int) -> Rig:
    """Draw an arm with the built-in rig's sensors."""
    return Rig(*draw_arm(seed))


def _experiments(spring: Spring) -> tuple[Experiment, ...]:
    """The built-in rig's experiments, shorter; three-slope gears need a second amplitude."""
    experiments = []
    for experiment in scara.STIFF.study(Path(), spring).experiments:
        if experiment.use == "frequency":
            experiments.append(replace(experiment, prbs=Prbs(10, 1e-3, 2, 10.0)))
            if spring == "three-slope":
                name = f"sweep-j{experiment.joint}"
                sweep = replace(experiment, name=name, file=f"{name}.parquet", use="sweep")
                experiments.append(replace(sweep, prbs=Prbs(10, 1e-3, 2, 4.0)))
        elif experiment.use != "check":
            experiments.append(experiment)
    return tuple(experiments)


def run_on_logs(
    seed: int,
    work: Work,
    arm: Callable[[int], Rig] = draw_rig,
    simulator: Simulator = simulate,
    change: Change = lambda folder, rig: None,
) -> dict[str, Any]:
    """Simulate an arm's logs and call `work` with its study file and true values.

    A failure is returned as a result.
    """
    rig = arm(seed)
    study, values = rig.study, rig.values
    with TemporaryDirectory() as folder:
        simulate_study(
            study,
            values,
            Path(folder),
            seed=seed,
            noise=rig.noise,
            as_recorded=False,
            sample_time=rig.sample_time,
            simulator=simulator,
        )
        change(Path(folder), rig)
        try:
            result = work(Path(folder) / "study.toml", values)
        except Exception as failure:  # counted, so that the other arms run
            result = {"failure": f"{type(failure).__name__}: {failure}"}
    spring = study.arm.joints[0].spring
    return {"seed": seed, "spring": spring, "classes": rig.classes, **result}


def run_all(
    seeds: Sequence[int],
    evaluate: Callable[[int], dict[str, Any]],
    out: Path | None,
    at_once: int | None = None,
) -> Iterator[dict[str, Any]]:
    """Results of all arms as they finish, one process per core.

    `evaluate` takes an arm's seed. With `out`, results are kept as lines of JSON, and seeds in that
    file are not evaluated again.
    """
    lines = out.read_text().splitlines() if out is not None and out.exists() else []
    recorded = [json.loads(line) for line in lines]
    yield from (result for result in recorded if result["seed"] in seeds)
    done = {result["seed"] for result in recorded}
    remaining = [seed for seed in seeds if seed not in done]
    os.environ |= {"OPENBLAS_NUM_THREADS": "1"}
    with ProcessPoolExecutor(at_once or os.cpu_count(), mp_context=get_context("spawn")) as pool:
        for future in as_completed([pool.submit(evaluate, seed) for seed in remaining]):
            result = future.result()
            if out is not None:
                with out.open("a") as file:
                    file.write(json.dumps(result) + "\n")
            yield result
