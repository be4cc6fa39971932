"""The whole-arm fit, against SciPy's optimiser on the very same simulations and derivatives.

Linear gears also against SciPy's optimiser on C that CasADi generates, and mujoco.sysid, where
those are installed. The error is the largest of inertias and stiffness, relative to the truth.

Starts are 5 % off in inertia and stiffness and 1.4 to 3 times in friction and damping; a curve
starts as one slope with its knees 40 % off. Longer and more records show how the time grows.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from scipy.optimize import least_squares

from benchmarks.peers.whole_arm import NAMES, Problem, casadi, generated, mujoco_sysid
from benchmarks.timing import Row, best_of
from strainwave.domain import (
    Control,
    Experiment,
    FloatArray,
    JointModel,
    Log,
    Parameter,
    Prbs,
    RigidModel,
    Spring,
    Study,
    WholeArmOptions,
)
from strainwave.domain.arm.gear_laws import KNEES, SLOPES
from strainwave.domain.keys import Values
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.simulation import SensorNoise
from strainwave.identification.whole_arm import fit_whole_arm
from strainwave.identification.whole_arm.problem.objective import Objective
from strainwave.identification.whole_arm.problem.starting_values import (
    add_stiffness_curves,
    space_of,
)
from strainwave.identification.whole_arm.problem.weighted_rows import Rows
from strainwave.identification.whole_arm.records.preparation import dataset_of
from strainwave.io.logs import read_logs
from strainwave.io.study import read_study
from strainwave.numerics.parallel import one_blas_thread
from strainwave.virtual import scara
from strainwave.virtual.experiments import simulate_study

CUTOFF = 120.0  # [Hz]
CASES: tuple[tuple[Spring, int], ...] = (("linear", 4), ("three-slope", 6))
_FRICTION = {"motor_viscous_friction": 1.4, "link_viscous_friction": 2.0, "gear_damping": 3.0}
_JOINT = ("motor_inertia", "link_inertia", "gear_stiffness", "motor_coulomb_friction", *_FRICTION)


def rows() -> list[Row]:
    table = []
    with one_blas_thread():
        for spring, n in CASES:
            study, logs, values = _record(spring, periods=1)
            task = f"whole-arm fit, {spring}, {n} records of 1 s"
            time_s = _measure(study, logs[:n], values)
            error = _error(_fit(study, logs[:n], values), values)
            peer = partial(_scipy, study, logs[:n], values)
            table.append(_compare(task, time_s, error, "SciPy least_squares", peer, values))
            if spring == "linear":
                table += _other_tools(
                    task, time_s, error, Problem(study, logs[:n], _start(values), CUTOFF), values
                )
        study, logs, values = _record("linear", periods=4)
        short = [_first_second(log) for log in logs]
        base = _measure(study, short[:2], values)
        for records, name in ((short[:4], "1 s"), (short, "1 s"), (logs[:2], "4 s")):
            task = f"the same, linear, {len(records)} records of {name}"
            table.append(Row(task, _measure(study, records, values), "2 records of 1 s", base))
    return table


def _other_tools(
    task: str, time_s: float, error: float, problem: Problem, values: Values
) -> list[Row]:
    """Tools with their own simulation; C code is generated and compiled before the timing."""
    names = "CasADi's C, SciPy least_squares", "mujoco.sysid, 2 steps a sample"
    try:
        run = generated(problem.study)
    except (ImportError, FileNotFoundError):  # no CasADi, or no gcc
        first = Row(task, time_s, names[0], None, error=error)
    else:
        first = _compare(task, time_s, error, names[0], partial(casadi, problem, run), values)
    return [first, _compare(task, time_s, error, names[1], partial(mujoco_sysid, problem), values)]


def _compare(
    task: str, time_s: float, error: float, peer: str, fit: Callable[[], Values], values: Values
) -> Row:
    start = time.perf_counter()
    try:
        peer_error = _error(fit(), values)
    except (
        ImportError,
        AttributeError,
    ):  # without its extra, the module of mujoco is empty
        return Row(task, time_s, peer, None, error=error)
    return Row(task, time_s, peer, time.perf_counter() - start, error, peer_error)


def _error(estimates: Values, values: Values) -> float:
    """Largest relative error of inertias and stiffness."""
    return max(
        abs(estimates[key] / true - 1.0)
        for key, true in values.items()
        if key[0] in (*NAMES, "motor_inertia") or key[0].startswith("gear_stiffness")
    )


def _measure(study: Study, logs: list[Log], values: Values) -> float:
    return best_of(partial(_fit, study, logs, values), repeats=3)


def _record(spring: Spring, periods: int) -> tuple[Study, list[Log], Values]:
    """Open-loop records of the built-in arm, joint by joint and in falling amplitudes."""
    free: tuple[Control, ...] = ("open", "open")
    experiments = tuple(
        Experiment(
            f"prbs-j{j}-{volt:g}V",
            f"prbs-j{j}-{volt:g}V.parquet",
            "frequency",
            free,
            joint=j,
            prbs=Prbs(10, 1e-3, periods, volt),
        )
        for volt in (10.0, 8.0, 6.0)
        for j in (1, 2)
    )
    values = scara.STIFF.parameters(5, spring)
    with TemporaryDirectory() as folder:
        study = replace(scara.STIFF.study(Path(folder), spring), experiments=experiments)
        simulate_study(study, values, Path(folder), noise=SensorNoise(), as_recorded=False)
        written = read_study(Path(folder) / "study.toml")
        return written, list(read_logs(written)), values


def _first_second(log: Log) -> Log:
    n = round(1.0 / log.sample_time)
    channels = {name: x[:n] for name, x in log.channels.items()}
    return replace(log, time=log.time[:n], channels=channels)


def _models(study: Study, values: Values) -> tuple[JointModel, ...]:
    """Joint models with the true values; the starting values are set separately."""
    alpha, beta, gamma = (values[name, None] for name in ("alpha", "beta", "gamma"))
    links = (alpha + beta + 2.0 * gamma, beta)
    models = []
    for j in range(1, study.arm.n_joints + 1):
        known = {(name, j): value for (name, joint), value in values.items() if joint == j}
        stiffness = known.get(("gear_stiffness", j), known.get((SLOPES[1], j)))
        parameters = {name: known.get((name, j), stiffness) for name in _JOINT}
        parameters["link_inertia"] = links[j - 1]
        numbers = {name: float(value or 0.0) for name, value in parameters.items()}
        covariance = np.eye(len(numbers))
        models.append(
            JointModel(
                j,
                ("prbs",),
                "grey-box",
                (),
                numbers,
                covariance,
                None,
                None,
                (1.0, 99.0),
                {},
                "determined",
            )
        )
    return tuple(models)


def _start(values: Values) -> Values:
    rng = np.random.default_rng(5)
    start = {}
    for (name, joint), value in values.items():
        sign = 1.0 if rng.integers(2) else -1.0
        if name in KNEES:
            factor = 1.0 + 0.4 * sign
        elif name in _FRICTION:
            factor = _FRICTION[name] ** sign
        elif name in SLOPES:
            factor = values[SLOPES[1], joint] / value
        else:
            factor = 1.4**sign if "coulomb" in name else 1.0 + 0.05 * sign
        start[name, joint] = value * factor
    return start


def _fit(study: Study, logs: list[Log], values: Values) -> Values:
    options = WholeArmOptions(cutoff_hz=CUTOFF, settling=False)
    models = _models(study, values)
    model = fit_whole_arm(
        logs, _uninformative_rigid(values), models, Arm.of(study.arm), options, start=_start(values)
    )
    return dict(model.values)


def _uninformative_rigid(values: Values) -> RigidModel:
    """Rigid model with the true values and almost no weight."""
    names = [("gamma", None)] + [("motor_coulomb_friction", j) for j in (1, 2)]
    names += [("friction_offset", j) for j in (1, 2)]
    reported = np.array([values[name] for name in names])
    parameters = tuple(
        Parameter(name, joint, float(value), 1e3, "1", "rigid")
        for (name, joint), value in zip(names, reported, strict=True)
    )
    covariance = np.eye(len(names)) * 1e6
    return RigidModel(parameters, reported, covariance, 1.0, {}, 10.0, 1, 1, "determined")


def _shared(rows: Rows, root: FloatArray, n: int) -> FloatArray:
    """Derivatives of a record's weighted residuals by the last `n` columns, the shared unknowns."""
    scaled = rows.evaluated.columns[..., -n:] / (rows.stds * root)[:, None]
    return np.asarray(scaled.reshape(-1, n))


def _scipy(study: Study, logs: list[Log], values: Values) -> Values:
    """Soft L1 by SciPy's trust region, from the same start, with weights at the true values."""
    records = [dataset_of(log, Arm.of(study.arm), CUTOFF) for log in logs]
    space = space_of(
        _uninformative_rigid(values),
        _models(study, values),
        Arm.of(study.arm),
        largest_voltage=[10.0, 10.0],
        floor=1.0,
    )
    if study.arm.joints[0].spring == "three-slope":
        space = add_stiffness_curves(space, Arm.of(study.arm), [60.0, 15.0])
    objective = Objective.of(space, records).update_weights(space.coordinates(values))
    repeats = [np.sqrt(weights.rows_per_error) for weights in objective.weights]

    def residual(z: FloatArray) -> FloatArray:
        parts = zip(objective.rows(z), repeats, strict=True)
        return np.concatenate([(rows.residual / root).ravel() for rows, root in parts])

    def jacobian(z: FloatArray) -> FloatArray:
        parts = zip(objective.rows(z), repeats, strict=True)
        return np.concatenate([_shared(rows, root, len(z)) for rows, root in parts])

    start = space.coordinates(_start(values))
    bounds = (-space.upper, space.upper)
    solved = least_squares(
        residual, start, jacobian, bounds, loss="soft_l1", x_scale="jac", ftol=1e-6
    )
    return dict(zip(space.keys, space.parameters(solved.x).tolist(), strict=True))
