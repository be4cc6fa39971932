"""Evaluate `identify` on a run: the named effect and the errors of the parameters."""

from __future__ import annotations

import time
from collections.abc import Collection
from dataclasses import replace
from typing import Any, Literal

import numpy as np

from benchmarks.families.catalogue import plans
from benchmarks.families.causes import NO_CAUSE, Cause, OwnPlant
from benchmarks.studies.causes.runs import Run, can_be_named, draw_run
from strainwave.domain import FloatArray, Identification, Study
from strainwave.domain.keys import Values
from strainwave.dynamics.arm import Arm
from strainwave.errors import InvalidInput, NumericalFailure
from strainwave.identification.whole_arm.problem.effect_unknowns import effects_among
from strainwave.pipeline import identify
from strainwave.virtual.experiments import Simulator, derived, record_experiment

Engine = Literal["own", "mujoco"]

PRIMARY = (
    "alpha",
    "beta",
    "gamma",
    "motor_inertia",
    "gear_stiffness",
    "motor_coulomb_friction",
    "gear_damping",
)
"""Beginnings of the names of evaluated parameters."""

_FAULTS = {"drive-gain": "wrong-torque-constant"}
"""Codes of causes that the input check names if two joints contradict each other."""

_SHARED = {"tilt", "soft-base", "encoder-zero"}  # causes that do not belong to one joint
_MAX_ERROR = 0.01  # relative error of an accurate value
_MAX_DAMPING_ERROR = 0.05  # the same for gear damping


def evaluate(
    run: Run,
    *,
    engine: Engine,
    series: int,
    healthy: bool = True,
    with_effect: bool = True,
    auto: bool = False,
) -> dict[str, Any]:
    """Simulate and identify one run; the result is JSON.

    `healthy` also identifies the arm without the cause if a value is inaccurate, `with_effect` with
    the cause in the study if a study can name it, `auto` with effects that the fit selects.
    """
    name = run.cause.name
    begin = time.process_time()
    logs = simulate_logs(run, engine, series)
    result: dict[str, Any] = {
        "cause": name,
        "number": run.number,
        "joint": run.cause.joint,
        "sizes": dict(run.cause.sizes),
        "classes": run.rig.classes,
        "seconds_simulated": time.process_time() - begin,
        "plain": _identify(run.rig.study, logs, run),
    }
    if healthy and not _all_accurate(result["plain"]):
        without_cause = replace(run, cause=Cause(NO_CAUSE, run.cause.joint, {}))
        result["healthy"] = _identify(
            run.rig.study, simulate_logs(without_cause, engine, series), without_cause
        )
    if with_effect and can_be_named(name):
        study = _with_effects(run.rig.study, {run.cause.joint}, (name,))
        result["with_effect"] = _identify(study, logs, run)
    if auto:
        result["auto"] = _identify(_with_effects(run.rig.study, {1, 2}, "auto"), logs, run)
    return result


def evaluate_in_turn(
    seed: int, names: tuple[str, ...], series: int, options: dict[str, Any]
) -> dict[str, Any]:
    """Evaluate a run by its number; causes take turns. A failure is returned as a result."""
    name, number = names[seed % len(names)], seed // len(names)
    try:
        run = draw_run(name, number, series)
        return {"seed": seed, **evaluate(run, series=series, **options)}
    except Exception as failure:  # counted, so that the other runs continue
        text = f"{type(failure).__name__}: {failure}"
        return {"seed": seed, "cause": name, "number": number, "failure": text}


def simulate_logs(run: Run, engine: Engine, series: int) -> dict[str, dict[str, FloatArray]]:
    """Simulated channels of every experiment."""
    study, values = run.rig.study, run.rig.values
    arm, seed = Arm.of(study.arm), 1000 * series + run.number
    logs = {}
    for k, (experiment, plan) in enumerate(
        zip(study.experiments, plans(run.rig, seed), strict=True)
    ):
        rng = np.random.default_rng([seed, k, 1])
        simulator = _simulator(run, engine, k)
        logs[experiment.name] = record_experiment(
            study, arm, plan, values, run.rig.noise, rng, simulator
        )
    return logs


def _simulator(run: Run, engine: Engine, record: int) -> Simulator:
    if engine == "own":
        return OwnPlant(run.cause, record)
    from benchmarks.studies.causes.in_mujoco import InMujoco

    return InMujoco(run.cause, record)


def _with_effects(study: Study, joints: Collection[int], effects: Any) -> Study:
    """The study with effects of some joints: names, or "auto"."""
    all_joints = tuple(
        replace(joint, effects=effects) if number in joints else joint
        for number, joint in enumerate(study.arm.joints, start=1)
    )
    return replace(study, arm=replace(study.arm, joints=all_joints))


def _identify(study: Study, logs: dict[str, dict[str, FloatArray]], run: Run) -> dict[str, Any]:
    """Status, named effect, and primary parameters with true values."""
    begin = time.process_time()
    try:
        result = identify(study, data=logs, threads=1)
    except (InvalidInput, NumericalFailure) as refusal:
        return {
            "status": "refused",
            "reason": str(refusal)[-200:],
            "seconds": time.process_time() - begin,
            "named": None,
            "parameters": [],
        }
    seconds = time.process_time() - begin
    true_values = derived(run.rig.values, run.rig.study.arm)
    if run.cause.name == "friction-by-record":  # friction has no single true value
        del true_values["motor_coulomb_friction", run.cause.joint]
    return {
        "status": result.verdict.status,
        "seconds": seconds,
        "tuned_seconds": result.timing_s.get("tuned"),
        "fit": result.whole_arm.status if result.whole_arm else None,
        "reason": result.reason,
        "suspected": [suspicion.code for suspicion in result.suspected],
        "named": _named_effect(result),
        "fitted": _fitted_effects(result),
        "effects": _effects(result),
        "parameters": _parameters(result, true_values),
    }


def _named_effect(result: Identification) -> list[Any] | None:
    """Effect and joint of the first cause, included or likely, or of a sensor mount."""
    criticism = result.whole_arm.criticism if result.whole_arm else None
    if criticism is not None and criticism.causes:
        return [criticism.causes[0].effect, criticism.causes[0].joint]
    for warning in result.warnings:
        if warning.code == "sensor-mount":
            return ["sensor-mount", int(warning.where.rsplit(" ", 1)[-1])]
    return None


def _fitted_effects(result: Identification) -> list[list[Any]]:
    """Rival effects that were fitted one at a time."""
    criticism = result.whole_arm.criticism if result.whole_arm else None
    causes = criticism.causes if criticism is not None else ()
    return [[cause.effect, cause.joint, cause.gain, cause.share] for cause in causes]


def _effects(result: Identification) -> list[list[Any]]:
    """Effects of the fitted model and their joints, also those with rejected values."""
    parameters = result.whole_arm.parameters if result.whole_arm else ()
    keys = ((p.name, p.joint) for p in parameters)
    return [[name, joint] for joint, name in effects_among(keys, len(result.study.arm.joints))]


def _parameters(result: Identification, true_values: Values) -> list[list[Any]]:
    """Name, joint, true value, value and 95 % half-width; the last two may be None."""
    rows: list[list[Any]] = []
    estimates = {(p.name, p.joint): p for p in result.parameters}
    for (name, joint), true in true_values.items():
        if not name.startswith(PRIMARY):
            continue
        p = estimates.get((name, joint))
        half = 0.5 * (p.ci95[1] - p.ci95[0]) if p is not None and p.ci95 is not None else None
        rows.append([name, joint, true, p.value if p is not None else None, half])
    return rows


def error_percent(row: list[Any]) -> float | None:
    """Relative error of a parameter [%]; None without a value."""
    _, _, true, value, _ = row
    return None if value is None else 100.0 * (value / true - 1.0)


def is_accurate(row: list[Any]) -> bool | None:
    """Whether a value is close to the true one or its interval contains it; None: no value."""
    name, _, true, value, half = row
    if value is None:
        return None
    limit = (_MAX_DAMPING_ERROR if name == "gear_damping" else _MAX_ERROR) * abs(true)
    return bool(abs(value - true) <= max(limit, half or 0.0))


def matters(result: dict[str, Any]) -> bool:
    """Whether the cause makes a parameter inaccurate that is accurate without it."""
    if "healthy" not in result:
        return False
    ignored = {(row[0], row[1]): is_accurate(row) for row in result["plain"]["parameters"]}
    healthy = [(row[0], row[1]) for row in result["healthy"]["parameters"] if is_accurate(row)]
    return not all(ignored.get(key) for key in healthy)


def _all_accurate(result: dict[str, Any]) -> bool:
    return bool(result["parameters"]) and all(is_accurate(row) for row in result["parameters"])


def naming_outcome(result: dict[str, Any]) -> str:
    """How the run without the effect names its cause: one of `OUTCOMES`."""
    named, suspected = result["plain"]["named"], result["plain"].get("suspected")
    if suspected:
        return "input fault" if _FAULTS.get(result["cause"]) in suspected else "refused"
    if named is None:
        return "nothing"
    if result["cause"] == NO_CAUSE or named[0] != result["cause"]:
        return "another"
    at_joint = named[1] == result["joint"] or result["cause"] in _SHARED
    return "effect and joint" if at_joint else "effect"


def selection_outcome(result: dict[str, Any]) -> str:
    """Which effects a fit with "auto" includes: one of `SELECTIONS`."""
    effects = [name for name, _ in result["auto"].get("effects", [])]
    if not effects:
        return "none"
    if result["cause"] not in effects:
        return "others"
    return "alone" if len(effects) == 1 else "with others"


SELECTIONS = ("alone", "with others", "others", "none")
OUTCOMES = ("effect and joint", "effect", "input fault", "another", "nothing", "refused")
