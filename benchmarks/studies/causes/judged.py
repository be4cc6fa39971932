"""What `identify` makes of a run: what it names, and how far its parameters are off."""

from __future__ import annotations

import time
from collections.abc import Collection
from dataclasses import replace
from typing import Any, Literal

import numpy as np

from benchmarks.studies.causes.drawn import Run, can_be_named, drawn
from strainwave.domain import FloatArray, Identification, Study
from strainwave.domain.effects import all_effects
from strainwave.domain.parameters import Values
from strainwave.dynamics.arm import Arm
from strainwave.errors import InvalidInput, NumericalFailure
from strainwave.identification.whole_arm.effects import effects_among
from strainwave.pipeline import identify
from strainwave.virtual.experiments import derived
from strainwave.virtual.families.causes import NOTHING, Cause, OwnPlant
from strainwave.virtual.families.short_records import plans
from strainwave.virtual.records import Simulator, recorded

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
"""What is judged, by how a name begins."""

_NAMED = 5  # score tests that are kept, the most significant first
_FAULTS = {"drive-gain": "wrong-torque-constant"}
"""Causes that are refused by their name before any fit where two joints contradict each other."""

_SHARED = {"tilt", "soft-base", "encoder-zero"}  # causes that no single joint has


def judged(
    run: Run, *, engine: Engine, series: int, named: bool = True, auto: bool = False
) -> dict[str, Any]:
    """All that is counted of one run, as JSON can hold it.

    Parameters
    ----------
    run : Run
    engine : str
    series : int
    named : bool
        Whether to fit with the cause in the study as well, where a study can name it.
    auto : bool
        Whether to fit with effects that the fit selects as well.

    Returns
    -------
    dict
    """
    name = run.cause.name
    begin = time.process_time()
    logs = logs_of(run, engine, series)
    found: dict[str, Any] = {
        "cause": name,
        "number": run.number,
        "joint": run.cause.joint,
        "sizes": dict(run.cause.sizes),
        "classes": run.rig.classes,
        "seconds_simulated": time.process_time() - begin,
        "plain": _tried(run.rig.study, logs, run),
    }
    if not _all_sound(found["plain"]):
        healthy = replace(run, cause=Cause(NOTHING, run.cause.joint, {}))
        found["healthy"] = _tried(run.rig.study, logs_of(healthy, engine, series), healthy)
    if named and can_be_named(name):
        study = _with_effects(run.rig.study, {run.cause.joint}, (name,))
        found["with_it"] = _tried(study, logs, run)
    if auto:
        found["auto"] = _tried(_with_effects(run.rig.study, {1, 2}, "auto"), logs, run)
    return found


def taking_turns(
    seed: int, names: tuple[str, ...], series: int, options: dict[str, Any]
) -> dict[str, Any]:
    """A run by its number in a study whose causes take turns; failures are found as well."""
    name, number = names[seed % len(names)], seed // len(names)
    try:
        run = drawn(name, number, series)
        return {"seed": seed, **judged(run, series=series, **options)}
    except Exception as failure:  # a study reports, it does not stop
        text = f"{type(failure).__name__}: {failure}"
        return {"seed": seed, "cause": name, "number": number, "failure": text}


def logs_of(run: Run, engine: Engine, series: int) -> dict[str, dict[str, FloatArray]]:
    """Channels of every experiment."""
    study, values = run.rig.study, run.rig.values
    arm, seed = Arm.of(study.arm), 1000 * series + run.number
    found = {}
    for k, (experiment, plan) in enumerate(
        zip(study.experiments, plans(run.rig, seed), strict=True)
    ):
        rng = np.random.default_rng([seed, k, 1])
        simulator = _simulator(run, engine, k)
        found[experiment.name] = recorded(study, arm, plan, values, run.rig.noise, rng, simulator)
    return found


def _simulator(run: Run, engine: Engine, record: int) -> Simulator:
    if engine == "own":
        return OwnPlant(run.cause, record)
    from benchmarks.studies.causes.in_mujoco import InMujoco

    return InMujoco(run.cause, record)


def _with_effects(study: Study, joints: Collection[int], effects: Any) -> Study:
    """The study with effects of some joints: names, or "auto"."""
    given = tuple(
        replace(joint, effects=effects) if number in joints else joint
        for number, joint in enumerate(study.arm.joints, start=1)
    )
    return replace(study, arm=replace(study.arm, joints=given))


def _tried(study: Study, logs: dict[str, dict[str, FloatArray]], run: Run) -> dict[str, Any]:
    """Status, what is named and the primary parameters with their truth."""
    begin = time.process_time()
    try:
        found = identify(study, data=logs, threads=1)
    except (InvalidInput, NumericalFailure) as refusal:
        return {
            "status": "refused",
            "reason": str(refusal)[-200:],
            "seconds": time.process_time() - begin,
            "named": None,
            "parameters": [],
        }
    seconds = time.process_time() - begin
    truth = derived(run.rig.values, run.rig.study.arm)
    if run.cause.name == "friction-by-record":  # there is no one friction
        del truth["motor_coulomb_friction", run.cause.joint]
    return {
        "status": found.verdict.status,
        "seconds": seconds,
        "tuned_seconds": found.timing_s.get("tuned"),
        "fit": found.tuned.status if found.tuned else None,
        "reason": found.reason,
        "suspected": [each.code for each in found.suspected],
        "named": _named(found),
        "score_tests": _score_tests(found),
        "fitted": _fitted(found),
        "effects": _effects(found),
        "parameters": _parameters(found, truth),
    }


def _named(found: Identification) -> list[Any] | None:
    """The cause and the joint that the first warning of an effect or of a mount names."""
    effects = {effect.warning_code: effect.name for effect in all_effects()}
    effects |= {"sensor-mount": "sensor-mount"}
    for warning in found.warnings:
        if warning.code in effects:
            return [effects[warning.code], int(warning.where.rsplit(" ", 1)[-1])]
    return None


def _score_tests(found: Identification) -> list[list[Any]]:
    criticism = found.tuned.criticism if found.tuned else None
    if criticism is None:
        return []
    return [
        [test.effect, test.joint, test.gain, test.share, test.evident]
        for test in criticism.score_tests[:_NAMED]
    ]


def _fitted(found: Identification) -> list[list[Any]]:
    """Effects that were fitted one at a time to tell them apart."""
    criticism = found.tuned.criticism if found.tuned else None
    causes = criticism.causes if criticism is not None else ()
    return [[cause.effect, cause.joint, cause.gain, cause.share] for cause in causes]


def _effects(found: Identification) -> list[list[Any]]:
    """Effects in the fitted model and their joints, those whose values do not count among them."""
    parameters = found.tuned.parameters if found.tuned else ()
    keys = ((p.name, p.joint) for p in parameters)
    return [[name, joint] for joint, name in effects_among(keys, len(found.study.arm.joints))]


def _parameters(found: Identification, truth: Values) -> list[list[Any]]:
    """Name, joint, truth, value and 95 % half-width; value and half-width None where not given."""
    rows: list[list[Any]] = []
    known = {(p.name, p.joint): p for p in found.parameters}
    for (name, joint), true in truth.items():
        if not name.startswith(PRIMARY):
            continue
        p = known.get((name, joint))
        half = 0.5 * (p.ci95[1] - p.ci95[0]) if p is not None and p.ci95 is not None else None
        rows.append([name, joint, true, p.value if p is not None else None, half])
    return rows


def error_percent(row: list[Any]) -> float | None:
    """Of a parameter [%]; None where it has no value."""
    _, _, true, value, _ = row
    return None if value is None else 100.0 * (value / true - 1.0)


def is_sound(row: list[Any]) -> bool | None:
    """Whether a value is near the truth or its interval holds it; None where there is none."""
    name, _, true, value, half = row
    if value is None:
        return None
    near = (0.05 if name == "gear_damping" else 0.01) * abs(true)
    return bool(abs(value - true) <= max(near, half or 0.0))


def matters(found: dict[str, Any]) -> bool:
    """Whether ignoring the cause costs a parameter that is sound of the same arm without it."""
    if "healthy" not in found:
        return False
    ignored = {(row[0], row[1]): is_sound(row) for row in found["plain"]["parameters"]}
    healthy = [(row[0], row[1]) for row in found["healthy"]["parameters"] if is_sound(row)]
    return not all(ignored.get(key) for key in healthy)


def _all_sound(tried: dict[str, Any]) -> bool:
    return bool(tried["parameters"]) and all(is_sound(row) for row in tried["parameters"])


def verdict_on(found: dict[str, Any]) -> str:
    """What the run without the cause says of it: one of `VERDICTS`."""
    named, suspected = found["plain"]["named"], found["plain"].get("suspected")
    if suspected:
        return "input fault" if _FAULTS.get(found["cause"]) in suspected else "refused"
    if named is None:
        return "nothing"
    if found["cause"] == NOTHING or named[0] != found["cause"]:
        return "another"
    at_joint = named[1] == found["joint"] or found["cause"] in _SHARED
    return "effect and joint" if at_joint else "effect"


def taken_up(found: dict[str, Any]) -> str:
    """What a fit that selects effects took up: one of `SELECTIONS`."""
    effects = [name for name, _ in found["auto"].get("effects", [])]
    if not effects:
        return "none"
    if found["cause"] not in effects:
        return "others"
    return "it alone" if len(effects) == 1 else "it and others"


SELECTIONS = ("it alone", "it and others", "others", "none")
VERDICTS = ("effect and joint", "effect", "input fault", "another", "nothing", "refused")
