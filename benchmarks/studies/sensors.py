"""Whole runs on drawn arms with few or mixed sensors: `python -m benchmarks.studies.sensors none`.

Sensors are named together, as `none 1khz`: which links have a sensor, then what else is unusual.
Every arm's logs go through the whole of `identify`; beside it the whole-arm fit starts from the
truth. Counted are runs by their verdicts, whole-arm fits that end where the one from the truth
does, to half of each parameter's deviation, runs that are silently wrong (determined, with a
primary parameter more than five deviations and 2 % off), and intervals that hold the truth.
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
from rich.console import Console
from rich.table import Table

from benchmarks.studies.arms import each, with_logs
from benchmarks.studies.coverage import EXACT_STEP, OF_THE_ENGINE, drawn_rig, kind_of, rows_of
from strainwave.domain import Channel, FloatArray, Identification, JointModel, Study
from strainwave.domain.parameters import Values
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.simulation import simulate
from strainwave.identification import joint_model as physical
from strainwave.identification.whole_arm import tune
from strainwave.io import logs
from strainwave.io.study import read_study, write_study
from strainwave.pipeline import identify
from strainwave.virtual.experiments import derived
from strainwave.virtual.families.rigs import Rig
from strainwave.virtual.records import Simulator

LINKS: Mapping[str, tuple[str, ...]] = {
    "none": (),
    "link1": ("a1",),
    "link2": ("a2",),
    "encoder+accelerometer": ("theta_l1", "a2"),
    "both": ("a1", "a2"),
}
"""Channels of link sensors by what a set of them is called."""
OTHERS = ("torque", "counts500", "1khz", "steps")
"""Torques logged for voltages, coarse encoders, slow sampling; only steps and motions."""
FEW_COUNTS, SLOW = 500, 1e-3
LINK_COUNTS = 2**18  # of a link encoder in a turn
TORQUE_NOISE = 2e-4  # of the largest torque in a record, as drives measure their currents
WRONG_DEVIATIONS, WRONG_SHARE = 5.0, 0.02
SAME_OPTIMUM = 0.5  # [standard deviations] between two ends of a fit that count as the same


def with_sensors(own: Rig, sensors: Sequence[str]) -> Rig:
    """A drawn arm with other sensors and experiments; link channels are left out of its logs later.

    Parameters
    ----------
    own : Rig
    sensors : sequence of str
        Of `LINKS` and `OTHERS`.

    Returns
    -------
    Rig
    """
    study = own.study
    if "counts500" in sensors:
        joints = tuple(replace(joint, encoder_counts=FEW_COUNTS) for joint in study.arm.joints)
        study = replace(study, arm=replace(study.arm, joints=joints))
    if "steps" in sensors:
        kept = tuple(e for e in study.experiments if e.use not in ("frequency", "sweep"))
        study = replace(study, experiments=kept)
    if any("theta_l" in name for name in _link_channels(sensors)):
        encoders = {f"theta_l{i}": Channel(f"theta_l{i}") for i in (1, 2)}
        study = replace(study, channels=encoders)
    return replace(own, study=study, sample_time=SLOW if "1khz" in sensors else own.sample_time)


def reduced(folder: Path, own: Rig, sensors: Sequence[str]) -> None:
    """Leave the channels that a set of sensors lacks out of logs and study.

    Parameters
    ----------
    folder : Path
        With the logs and study.toml of `with_sensors`'s arm.
    own : Rig
    sensors : sequence of str
    """
    study, links = read_study(folder / "study.toml"), _link_channels(sensors)
    rng = np.random.default_rng(int(1e12 * own.values["motor_inertia", 1]))
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
                voltage = (joint.torque_per_volt or 1.0) * columns.pop(f"u{i}")
                torque = _behind_loop(voltage, joint.current_loop_hz, log.sample_time)
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


def _behind_loop(torque: FloatArray, hz: float | None, sample_time: float) -> FloatArray:
    """What the drive measures of its torque at the samples, commands being held between them."""
    if hz is None:
        return torque
    left, found = np.exp(-2.0 * np.pi * hz * sample_time), np.empty_like(torque)
    now = torque[0]
    for k, aim in enumerate(torque.tolist()):
        found[k] = now
        now = aim + left * (now - aim)
    return found


def tried(path: Path, values: Values, *, engine: bool = False) -> dict[str, Any]:
    """Verdict, errors, and how far the whole-arm fit ends from the one started at the truth.

    How long an engine's friction takes to stop a motor is no parameter, and is left out.
    """
    begin = time.process_time()
    found = identify(path)
    seconds = time.process_time() - begin
    verdict = found.verdict
    reported: dict[str, Any] = {"verdict": verdict.status, "seconds": seconds}
    reported["reasons"] = list(verdict.reasons)
    if found.tuned is None:
        return reported
    study = read_study(path)
    known = derived(values, study.arm)
    own = [p for p in found.tuned.parameters if not (engine and p.name == OF_THE_ENGINE)]
    rows = rows_of([p for p in own if p.value is not None], known)
    reported |= {"status": found.tuned.status, "parameters": rows}
    reported["wrong"] = [
        f"{name} {joint or ''}".strip()
        for name, joint, error, deviation, _ in rows
        if f"{name} {joint or ''}".strip() in verdict.identified
        and abs(error) > WRONG_DEVIATIONS
        and abs(error) * deviation > WRONG_SHARE
        and kind_of(name) not in _SECONDARY
    ]
    reported |= _apart(found, study, values)
    return reported


_SECONDARY = ("split of viscous friction", "friction offset", "settling time", "link sensors")


def _apart(found: Identification, study: Study, values: Values) -> dict[str, Any]:
    """How far the end lies from the optimum found from the truth, in deviations."""
    assert found.tuned is not None
    every = logs.read_logs(study)
    joints = found.joints
    if len(joints) < study.arm.n_joints:
        joints = physical.models_from_catalogue(found.rigid, Arm.of(study.arm))[0]
    joints = tuple(_true(joint, values, study) for joint in joints)
    options = study.options.tuning
    try:
        home = tune(every, found.rigid, joints, Arm.of(study.arm), options, start=values)
    except Exception as failure:  # the truth itself may not do
        return {"home": f"{type(failure).__name__}: {failure}"}
    at = {(q.name, q.joint): q for q in home.parameters if q.value is not None}
    apart = {
        f"{p.name} {p.joint or ''}".strip(): abs(p.value - q.value) / q.std
        for p in found.tuned.parameters
        if (q := at.get((p.name, p.joint))) is not None
        and p.value is not None
        and q.value is not None
        and q.std
    }
    worst = max(apart, key=lambda name: apart[name], default="")
    return {"worst": worst, "apart": apart.get(worst, np.inf), "home": home.status}


def _true(joint: JointModel, values: Values, study: Study) -> JointModel:
    """A joint's model with the truth for its values: limits of the search lie about it."""
    known = derived(values, study.arm)
    own = {}
    for name, value in joint.values.items():
        alike = "gear_stiffness_k2" if name == "gear_stiffness" else name
        true = known.get((name, joint.joint), known.get((alike, joint.joint)))
        own[name] = value if true is None else true
    return replace(joint, values=own)


def line(found: Mapping[str, Any]) -> str:
    """One arm, in a line."""
    start = f"arm {found['seed']}, {found['spring']}: "
    if "failure" in found:
        return f"{start}{found['failure']}"
    text = f"{start}{found['verdict']}, {found['seconds']:.0f} s"
    if "parameters" not in found:
        return f"{text}; {'; '.join(found['reasons'])}"
    apart = found.get("apart")
    text += f"; {found['status']}"
    text += f", {apart:.2g} deviations apart ({found['worst']})" if apart is not None else ""
    text += f"; truth: {found['home']}"
    errors = ", ".join(f"{k} {v:.2g} %" for k, v in _largest([found]).items())
    reasons = f"; {'; '.join(found['reasons'])}" if found["reasons"] else ""
    return f"{text}; {errors}" + (f"; WRONG {found['wrong']}" if found["wrong"] else "") + reasons


def _largest(found: Iterable[Mapping[str, Any]]) -> dict[str, float]:
    """Largest relative errors by kind [%]."""
    worst: dict[str, float] = defaultdict(float)
    for one in found:
        for name, _, error, deviation, _ in one.get("parameters", ()):
            if kind_of(name) not in _SECONDARY:
                worst[kind_of(name)] = max(worst[kind_of(name)], 100.0 * abs(error) * deviation)
    return dict(worst)


def summary(found: Sequence[Mapping[str, Any]]) -> Table:
    """All arms: verdicts, ends, coverage, errors."""
    table = Table("", "", box=None)
    fitted = [one for one in found if "parameters" in one]
    for verdict in ("determined", "partly-determined", "not-determined", "inconsistent-input"):
        of_it = [one for one in found if one.get("verdict") == verdict]
        home = [one for one in of_it if one.get("apart", np.inf) < SAME_OPTIMUM]
        text = f"{len(of_it)}, {len(home)} at the optimum found from the truth"
        table.add_row(verdict, text)
    table.add_row("failures", str(sum("failure" in one for one in found)))
    wrong = [one for one in fitted if one["verdict"] == "determined" and one["wrong"]]
    table.add_row("silently wrong", str(len(wrong)))
    held: dict[str, list[bool]] = defaultdict(list)
    errors: dict[str, list[float]] = defaultdict(list)
    for one in fitted:
        for name, _, error, deviation, inside in one["parameters"]:
            if inside is not None:
                held[kind_of(name)].append(inside)
                errors[kind_of(name)].append(100.0 * abs(error) * deviation)
    every = [inside for own in held.values() for inside in own]
    table.add_row("inside", f"{100.0 * np.mean(every):.1f} % of {len(every)}" if every else "")
    for kind, own in sorted(held.items()):
        error = np.array(errors[kind])
        text = f"inside {100.0 * np.mean(own):.1f} %, errors {np.median(error):.2g} %"
        table.add_row(kind, f"{text}, at most {error.max():.2g} %")
    seconds = [one["seconds"] for one in found if "seconds" in one]
    text = f"{np.median(seconds):.1f}, at most {max(seconds):.1f}" if seconds else ""
    table.add_row("processor time [s]", text)
    return table


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    names = [*LINKS, *OTHERS]
    parser.add_argument("sensors", nargs="+", choices=names)
    parser.add_argument("--arms", type=int, default=100)
    parser.add_argument("--catalogue", action="store_true", help="arms over a gear catalogue")
    parser.add_argument("--seed", type=int, default=0, help="of the catalogue's series of arms")
    parser.add_argument("--engine", action="store_true", help="let MuJoCo move the arms")
    parser.add_argument("--out", type=Path, help="lines of JSON, from which a run goes on")
    chosen = parser.parse_args()
    simulator: Simulator = partial(simulate, longest=EXACT_STEP)
    if chosen.engine:
        from benchmarks.studies.engine import in_mujoco as simulator
    arm = partial(_arm, sensors=chosen.sensors, series=chosen.seed, catalogue=chosen.catalogue)
    work = partial(
        with_logs,
        work=partial(tried, engine=chosen.engine),
        arm=arm,
        simulator=simulator,
        change=partial(reduced, sensors=chosen.sensors),
    )
    found = []
    for one in each(chosen.arms, work, chosen.out):
        found.append(one)
        print(line(one), flush=True)
    Console().print(summary(found))


def _arm(seed: int, *, sensors: Sequence[str], series: int, catalogue: bool) -> Rig:
    return with_sensors(drawn_rig(seed, series, catalogue=catalogue), sensors)


if __name__ == "__main__":
    main()
