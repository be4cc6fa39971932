"""Errors and coverage with few or mixed sensors: `python -m benchmarks.studies.sensors none`.

Arguments name the link sensors and other changes together, as `none 1khz`. All stages of
`identify` run on every arm, and the whole-arm fit is repeated from the true values. Printed are
verdicts, fits that end at the optimum reached from the true values (within half a standard
deviation), silently wrong runs (determined, with a primary parameter more than five standard
deviations and 2 % from its true value), and coverage.
"""

from __future__ import annotations

import argparse
import time
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from rich.table import Table

from benchmarks.console import Console, share_of
from benchmarks.families.rigs import Rig
from benchmarks.studies.arms import run_all, run_on_logs
from benchmarks.studies.coverage import (
    ENGINE_PARAMETER,
    EXACT_STEP,
    draw_rig,
    error_rows,
    parameter_kind,
)
from strainwave.domain import Channel, FloatArray, Identification, JointModel, Study
from strainwave.domain.keys import Values
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.simulation import simulate
from strainwave.identification import joint_model as physical
from strainwave.identification.whole_arm import fit_whole_arm
from strainwave.io import logs
from strainwave.io.study import read_study, write_study
from strainwave.pipeline import identify
from strainwave.virtual.experiments import Simulator, derived

LINKS: Mapping[str, tuple[str, ...]] = {
    "none": (),
    "link1": ("a1",),
    "link2": ("a2",),
    "encoder+accelerometer": ("theta_l1", "a2"),
    "both": ("a1", "a2"),
}
"""Channels of link sensors by the name of the set."""
OTHERS = ("torque", "counts500", "1khz", "steps")
"""Torques in place of voltages, coarse encoders, slow sampling; only steps and motions."""
FEW_COUNTS = 500  # encoder counts per motor turn
SLOW_SAMPLE_TIME = 1e-3  # [s]
LINK_COUNTS = 2**18  # of a link encoder per turn
TORQUE_NOISE = 2e-4  # std over the largest torque of a record, typical of current sensors
MIN_WRONG_STD = 5.0  # [standard deviations] error of a silently wrong value
MIN_WRONG_ERROR = 0.02  # relative error of a silently wrong value
SAME_OPTIMUM = 0.5  # [standard deviations] between two ends of a fit that count as the same


def restrict_sensors(rig: Rig, sensors: Sequence[str]) -> Rig:
    """Replace sensors and experiments of an arm, by names of `LINKS` and `OTHERS`.

    `remove_channels` removes the link channels from the logs later.
    """
    study = rig.study
    if "counts500" in sensors:
        joints = tuple(replace(joint, encoder_counts=FEW_COUNTS) for joint in study.arm.joints)
        study = replace(study, arm=replace(study.arm, joints=joints))
    if "steps" in sensors:
        others = tuple(e for e in study.experiments if e.use not in ("frequency", "sweep"))
        study = replace(study, experiments=others)
    if any("theta_l" in name for name in _link_channels(sensors)):
        encoders = {f"theta_l{i}": Channel(f"theta_l{i}") for i in (1, 2)}
        study = replace(study, channels=encoders)
    sample_time = SLOW_SAMPLE_TIME if "1khz" in sensors else rig.sample_time
    return replace(rig, study=study, sample_time=sample_time)


def remove_channels(folder: Path, rig: Rig, sensors: Sequence[str]) -> None:
    """Remove the channels of absent sensors from study.toml and logs of a folder."""
    study, links = read_study(folder / "study.toml"), _link_channels(sensors)
    rng = np.random.default_rng(int(1e12 * rig.values["motor_inertia", 1]))
    for experiment in study.experiments:
        path = folder / experiment.file
        log = logs.read_log(study, experiment)
        columns = dict(log.channels)
        for i, joint in enumerate(study.arm.joints, start=1):
            for name in (f"a{i}", f"gyro{i}", f"theta_l{i}"):
                if name not in links:
                    columns.pop(name, None)
            if f"theta_l{i}" in columns:
                count = 2.0 * np.pi / LINK_COUNTS
                columns[f"theta_l{i}"] = count * np.round(columns[f"theta_l{i}"] / count)
            if "torque" in sensors:
                voltage = joint.torque_per_command * columns.pop(f"u{i}")
                torque = _measured_torque(voltage, joint.current_loop_hz, log.sample_time)
                noise = TORQUE_NOISE * np.max(np.abs(torque))
                columns[f"torque{i}"] = torque + rng.normal(0.0, noise, len(torque))
        path.unlink()
        logs.write_log(path, {"t": log.time, **columns})
    joints = tuple(replace(joint, gyro_hz=None) for joint in study.arm.joints)
    if not any(name.startswith("a") for name in links):
        joints = tuple(
            replace(joint, accelerometer_distance=None, accelerometer_hz=None) for joint in joints
        )
    if "torque" in sensors:
        joints = tuple(replace(joint, torque_per_volt=None) for joint in joints)
    write_study(replace(study, arm=replace(study.arm, joints=joints)), study.path)


def _link_channels(sensors: Sequence[str]) -> tuple[str, ...]:
    return next((LINKS[name] for name in sensors if name in LINKS), LINKS["both"])


def _measured_torque(torque: FloatArray, hz: float | None, sample_time: float) -> FloatArray:
    """Torque behind the current loop at the samples; commands are held between them."""
    if hz is None:
        return torque
    decay, measured = np.exp(-2.0 * np.pi * hz * sample_time), np.empty_like(torque)
    state = torque[0]
    for k, command in enumerate(torque.tolist()):
        measured[k] = state
        state = command + decay * (state - command)
    return measured


def evaluate(path: Path, values: Values, *, engine: bool = False) -> dict[str, Any]:
    """Verdict, errors, and the distance to the fit that starts from the true values.

    Friction settling times of MuJoCo are not counted.
    """
    begin = time.process_time()
    identification = identify(path)
    seconds = time.process_time() - begin
    verdict = identification.verdict
    reported: dict[str, Any] = {"verdict": verdict.status, "seconds": seconds}
    reported["reasons"] = list(verdict.reasons)
    whole_arm = identification.whole_arm
    if whole_arm is None:
        return reported
    study = read_study(path)
    parameters = [p for p in whole_arm.parameters if not (engine and p.name == ENGINE_PARAMETER)]
    rows = error_rows([p for p in parameters if p.value is not None], derived(values, study.arm))
    reported |= {"status": whole_arm.status, "parameters": rows}
    reported["wrong"] = [
        f"{name} {joint or ''}".strip()
        for name, joint, error, std, _ in rows
        if (name, joint or None) in verdict.identified
        and abs(error) > MIN_WRONG_STD
        and abs(error) * std > MIN_WRONG_ERROR
        and parameter_kind(name) not in _SECONDARY
    ]
    reported |= _distance_to_optimum(identification, study, values)
    return reported


_SECONDARY = ("split of viscous friction", "friction offset", "settling time", "link sensors")


def _distance_to_optimum(
    identification: Identification, study: Study, values: Values
) -> dict[str, Any]:
    """Largest distance [standard deviations] to the fit that starts from the true values."""
    assert identification.whole_arm is not None
    arm, joints = Arm.of(study.arm), identification.joints
    if len(joints) < study.arm.n_joints:
        joints = physical.models_from_catalogue(identification.rigid, arm)[0]
    joints = tuple(_with_true_values(joint, values, study) for joint in joints)
    options = study.options.tuning
    try:
        optimum = fit_whole_arm(
            logs.read_logs(study), identification.rigid, joints, arm, options, start=values
        )
    except Exception as failure:  # the fit may refuse true values
        return {"optimum": f"{type(failure).__name__}: {failure}"}
    at = {(q.name, q.joint): q for q in optimum.parameters if q.value is not None}
    distances = {
        f"{p.name} {p.joint or ''}".strip(): abs(p.value - q.value) / q.std
        for p in identification.whole_arm.parameters
        if (q := at.get((p.name, p.joint))) is not None
        and p.value is not None
        and q.value is not None
        and q.std
    }
    farthest = max(distances, key=lambda name: distances[name], default="")
    distance = distances.get(farthest, np.inf)
    return {"farthest": farthest, "distance": distance, "optimum": optimum.status}


def _with_true_values(joint: JointModel, values: Values, study: Study) -> JointModel:
    """A joint's model with its true values, so that the ranges of the fit contain them."""
    true_values = derived(values, study.arm)
    model_values = {}
    for name, value in joint.values.items():
        equivalent = "gear_stiffness_k2" if name == "gear_stiffness" else name
        true = true_values.get((name, joint.joint), true_values.get((equivalent, joint.joint)))
        model_values[name] = value if true is None else true
    return replace(joint, values=model_values)


def line(result: Mapping[str, Any]) -> str:
    """One arm, in a line."""
    head = f"arm {result['seed']}, {result['spring']}: "
    if "failure" in result:
        return f"{head}{result['failure']}"
    text = f"{head}{result['verdict']}, {result['seconds']:.0f} s"
    if "parameters" not in result:
        return f"{text}; {'; '.join(result['reasons'])}"
    distance = result.get("distance")
    text += f"; {result['status']}"
    text += (
        f", {distance:.2g} std from optimum ({result['farthest']})" if distance is not None else ""
    )
    text += f"; from true values: {result['optimum']}"
    errors = ", ".join(f"{k} {v:.2g} %" for k, v in _largest_errors([result]).items())
    wrong = f"; WRONG {result['wrong']}" if result["wrong"] else ""
    reasons = f"; {'; '.join(result['reasons'])}" if result["reasons"] else ""
    return f"{text}; {errors}{wrong}{reasons}"


def _largest_errors(results: Iterable[Mapping[str, Any]]) -> dict[str, float]:
    """Largest relative errors by kind of parameter [%]."""
    largest: dict[str, float] = defaultdict(float)
    for result in results:
        for name, _, error, std, _ in result.get("parameters", ()):
            kind = parameter_kind(name)
            if kind not in _SECONDARY:
                largest[kind] = max(largest[kind], 100.0 * abs(error) * std)
    return dict(largest)


def summary(results: Sequence[Mapping[str, Any]]) -> list[Table]:
    """All arms: verdicts and optima; coverage and errors by kind of parameter."""
    verdicts = Table("verdict", "arms", "at the optimum from the true values", box=None)
    fitted = [result for result in results if "parameters" in result]
    for verdict in ("determined", "partly-determined", "not-determined", "inconsistent-input"):
        group = [result for result in results if result.get("verdict") == verdict]
        same = sum(result.get("distance", np.inf) < SAME_OPTIMUM for result in group)
        verdicts.add_row(verdict, str(len(group)), str(same))
    verdicts.add_row("failure", str(sum("failure" in result for result in results)))
    wrong = sum(result["verdict"] == "determined" and bool(result["wrong"]) for result in fitted)
    verdicts.add_row("silently wrong", str(wrong))
    seconds = [result["seconds"] for result in results if "seconds" in result]
    if seconds:
        verdicts.add_row("processor time [s]", f"{np.median(seconds):.1f}, {max(seconds):.1f}")
    coverage: dict[str, list[bool]] = defaultdict(list)
    errors: dict[str, list[float]] = defaultdict(list)
    for result in fitted:
        for name, _, error, std, inside in result["parameters"]:
            if inside is not None:
                for kind in ("all", parameter_kind(name)):
                    coverage[kind].append(inside)
                    errors[kind].append(100.0 * abs(error) * std)
    kinds = Table("parameters", "inside", "median error", "largest error", box=None)
    for kind, of_kind in sorted(coverage.items()):
        sizes = (f"{size:.2g} %" for size in (np.median(errors[kind]), max(errors[kind])))
        kinds.add_row(kind, share_of(of_kind), *sizes)
    return [verdicts, kinds]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    names = [*LINKS, *OTHERS]
    parser.add_argument("sensors", nargs="+", choices=names)
    parser.add_argument("--arms", type=int, default=100)
    parser.add_argument("--catalogue", action="store_true", help="arms over a gear catalogue")
    parser.add_argument("--seed", type=int, default=0, help="series of the catalogue's arms")
    parser.add_argument("--engine", action="store_true", help="simulate in MuJoCo")
    parser.add_argument("--out", type=Path, help="lines of JSON; a repeated run continues")
    options = parser.parse_args()
    simulator: Simulator = partial(simulate, max_time_step=EXACT_STEP)
    if options.engine:
        from benchmarks.studies.engine import in_mujoco as simulator
    arm = partial(_draw, sensors=options.sensors, series=options.seed, catalogue=options.catalogue)
    work = partial(
        run_on_logs,
        work=partial(evaluate, engine=options.engine),
        arm=arm,
        simulator=simulator,
        change=partial(remove_channels, sensors=options.sensors),
    )
    results = []
    for result in run_all(range(options.arms), work, options.out):
        results.append(result)
        print(line(result), flush=True)
    for table in summary(results):
        Console().print(table)


def _draw(seed: int, *, sensors: Sequence[str], series: int, catalogue: bool) -> Rig:
    return restrict_sensors(draw_rig(seed, series, catalogue=catalogue), sensors)


if __name__ == "__main__":
    main()
