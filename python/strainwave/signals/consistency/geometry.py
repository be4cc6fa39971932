"""Search for another geometry with which the torques of all joints agree with one arm.

The alternatives are single changes of the study: an axis, gravity, a gear ratio, a zero position,
the frame of one joint, the coupling of the motors, or all frames. Changes of continuous quantities
are found by Gauss-Newton steps of the fit of `torque_fit`, in which the parameters of the links are
eliminated (Kaufman's variable projection).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import combinations

import numpy as np

from strainwave.domain import Correction, FloatArray, channel_parts
from strainwave.domain.corrections import exchange_corrections
from strainwave.domain.kinds import kind_of
from strainwave.numerics.parallel import run_parallel
from strainwave.signals.consistency.evidence import Alternative, ChangeKind, Evidence, is_slow
from strainwave.signals.consistency.motors import EFFORTS, effort_channel
from strainwave.signals.consistency.torque_fit import (
    MIN_COST_DIFFERENCE,
    MIN_FIT_RATIO,
    FitQuality,
    TorqueFit,
    TorqueSystem,
    fit_ratio,
    fit_torques,
    predict_stretches,
    torque_system,
    unexplained_torques,
)

# Prior standard deviations of the changes: log ratio, angles [rad], lengths [m], gravity [m/s^2].
_RATIO_STD, _ANGLE_STD, _LENGTH_STD, _GRAVITY_STD = 0.3, 0.5, 0.15, 5.0
# Steps of the numerical derivatives, in prior standard deviations.
_DERIVATIVE_STEP = 1e-4
# Largest Gauss-Newton step, in prior standard deviations.
_MAX_STEP = 2.0
_MAX_STEPS = 8
# Mean unexplained share above which no search starts, or ends after the given number of steps.
_N_TRIAL_STEPS, _MAX_TRIAL_UNEXPLAINED = 3, 0.3
# Unexplained share of one torque above which exchanges of joints are tried.
_MAX_UNEXPLAINED = 0.25
# Decrease of the cost per independent row of the fit below which a change is not used to predict.
_MIN_DECREASE_TO_PREDICT = 0.03
# Share of the stretches that a better explanation predicts better.
_MIN_BETTER_FOLDS = 0.7
# Scale of the delays in rows of the low-pass record, and the delay that is tolerated [s].
_DELAY_ROWS, _TOLERATED_DELAY = 1.0, 4e-3
# Reduction of a step that does not decrease the cost, and the shortest fraction that is tried.
_STEP_REDUCTION, _MIN_STEP_FRACTION = 0.4, 0.1
# Smallest predicted unexplained share, for the logarithm.
_MIN_UNEXPLAINED = 1e-6
# Decrease of the cost per independent row below which a search is not started, or ends.
_MIN_PREDICTED_DECREASE = 0.03
_MIN_DECREASE = 2e-3
# Changes within which a description is accepted: relative, angles [rad], lengths [m], gravity
# [m/s^2], torque constants. Drawings and calibrations of robots are more accurate.
_TOLERATED_RATIO, _TOLERATED_ANGLE, _TOLERATED_LENGTH = 0.004, 0.03, 0.01
_TOLERATED_GRAVITY, _TOLERATED_TORQUE = 0.5, 0.1
# Factors of the torque of one joint in another unit.
_TORQUE_UNITS = (1e3, 1e-3)
_DEGREE = np.pi / 180.0  # [rad]
_ROTATIONS = ("theta_m", "omega_m", "ref")
_STANDARD_GRAVITY = 9.81  # [m/s^2]
# Cosine above which two directions are equal.
_EQUAL_DIRECTIONS = 0.999


@dataclass(frozen=True, slots=True)
class _Family:
    """Changes of the geometry with continuous coordinates, in prior standard deviations."""

    kind: ChangeKind
    joint: int | None
    size: int
    corrections: Callable[[FloatArray], tuple[Correction, ...]]
    tolerated: FloatArray  # (size,) coordinates of a change within which a study is accepted


def search_geometry(evidence: Evidence) -> tuple[Alternative, ...]:
    """Other explanations of the torques, the best first, and the stated one as the last.

    Each is fitted to all stretches but one and predicts that one. Listed are those that predict
    better than the stated description, on most stretches. Empty for kinds that place the joints
    and without torques.
    """
    if kind_of(evidence.arm).places_joints:
        return ()
    evidence.memory.stated_arm = evidence.arm
    slow = tuple(record for record in evidence.records if is_slow(record.experiment))
    evidence = replace(evidence, records=slow)
    system = torque_system(evidence)
    if system is None:
        return ()
    fit, stated = fit_torques(system), predict_stretches(system)
    simple = [*_discrete(evidence), *_angle_units(evidence), *_efforts(evidence, "")]

    def predict(candidates: Sequence[Alternative]) -> list[Alternative]:
        jobs = [partial(_predict, evidence, fit, stated, each) for each in candidates]
        return [each for each in run_parallel(jobs) if each is not None]

    searches = [partial(_search, evidence, fit, stated, f) for f in _promising(evidence, fit)]
    found = predict(simple) + [each for each in run_parallel(searches) if each is not None]
    further = []
    if found or max(fit.unexplained.values()) > _MAX_UNEXPLAINED:
        further = [*_joint_exchanges(evidence, "")]
    for record in _doubtful_records(system, stated):
        further += [Alternative("payload", None, (), record=record)]
        further += [*_efforts(evidence, record), *_joint_exchanges(evidence, record)]
    found += predict(further)
    return (*sorted(found, key=lambda a: a.cost), Alternative("robot", None, (), stated.cost))


def _predict(
    evidence: Evidence, fit: TorqueFit, stated: FitQuality, alternative: Alternative
) -> Alternative | None:
    """The alternative with its cost; None if it does not predict better than the stated arm."""
    changed = evidence.corrected_in(alternative.record, alternative.corrections)
    loaded = alternative.record if alternative.kind == "payload" else ""
    system = torque_system(changed, loaded)
    if system is None or (loaded and _load_inertia(system) < 0.0):
        return None
    decrease = fit.cost - fit_torques(system).cost
    if decrease < _MIN_DECREASE_TO_PREDICT * fit.n_all:
        return None
    # the others may not determine the links of a record that moves in another way
    if alternative.record and fit_ratio(decrease, 0.0, fit.n_all) < MIN_FIT_RATIO:
        return None
    return _if_better(alternative, stated, predict_stretches(system))


def _load_inertia(system: TorqueSystem) -> float:
    """Trace of the inertia of the load, the last parameters of a system with one [kg m^2]."""
    load = fit_torques(system).links[-10:]
    return float(load[[4, 6, 9]].sum())


def _if_better(
    alternative: Alternative, stated: FitQuality, predicted: FitQuality
) -> Alternative | None:
    gain = stated.cost - predicted.cost
    is_better = fit_ratio(gain, 0.0, stated.n_all) > MIN_FIT_RATIO and gain > MIN_COST_DIFFERENCE
    if not is_better or predicted.better_folds(stated) < _MIN_BETTER_FOLDS:
        return None
    return replace(alternative, cost=predicted.cost)


def _promising(evidence: Evidence, fit: TorqueFit) -> Iterator[_Family]:
    """Families of which the first Gauss-Newton step predicts a clear decrease of the cost."""
    families = [*_families(evidence)]
    slopes = run_parallel([partial(_slope, evidence, fit, f, np.zeros(f.size)) for f in families])
    frames = [slope for slope, f in zip(slopes, families, strict=True) if f.kind == "frame"]
    n = len(frames)
    tolerated = np.tile(_TOLERATED_FRAME, n)
    families.append(_Family("robot", None, 6 * n, partial(_robot, evidence), tolerated))
    slopes.append(np.column_stack(frames))
    for family, slope in zip(families, slopes, strict=True):
        _, decrease = _gauss_newton(fit, slope, np.zeros(family.size))
        if decrease - family.size / fit.n_all > _MIN_PREDICTED_DECREASE:  # the criterion of Akaike
            yield family


_TOLERATED_FRAME = np.repeat([_TOLERATED_LENGTH / _LENGTH_STD, _TOLERATED_ANGLE / _ANGLE_STD], 3)


def _fit(evidence: Evidence, corrections: Sequence[Correction]) -> TorqueFit | None:
    system = torque_system(evidence.corrected(corrections))
    return None if system is None else fit_torques(system)


def _doubtful_records(system: TorqueSystem, stated: FitQuality) -> list[str]:
    """Records without which the stretches of the others are predicted clearly better."""
    names = np.array(system.records)
    doubtful = []
    for name in dict.fromkeys(system.records) if len(set(system.records)) > 1 else ():
        kept = names != name
        others = predict_stretches(system, names[~kept].tolist())
        before, after = (quality.squares[kept].sum(axis=0) for quality in (stated, others))
        gain = 0.5 * stated.n_rows @ np.log(np.maximum(before, 1e-300) / np.maximum(after, 1e-300))
        if fit_ratio(gain, 0.0, stated.n_all) > MIN_FIT_RATIO:
            doubtful.append(name)
    return doubtful


def _efforts(evidence: Evidence, record: str) -> Iterator[Alternative]:
    """Reversed and exchanged efforts, in all records or in one."""
    joints = range(1, evidence.arm.n_joints + 1)
    for i in joints:
        name = effort_channel(evidence.channels, i)
        if name is not None:
            reverse = Correction("channels", name, "scale", -evidence.channel(name).scale)
            yield Alternative("torque", i, (reverse,), record=record)
    for pair in combinations(joints, 2):
        yield from _exchange(evidence, EFFORTS, pair, record)


def _angle_units(evidence: Evidence) -> Iterator[Alternative]:
    """All motor angles and velocities in degrees or turns."""
    if any(joint.motion == "prismatic" for joint in evidence.arm.joints):
        return
    names = [n for n in sorted(evidence.channels) if channel_parts(n)[0] in _ROTATIONS]
    for factor in (_DEGREE, 2.0 * np.pi):
        changes = [
            Correction("channels", n, "scale", evidence.channel(n).scale * factor) for n in names
        ]
        yield Alternative("unit", None, tuple(changes))


def _joint_exchanges(evidence: Evidence, record: str) -> Iterator[Alternative]:
    """Exchanged motor angles, or angles and efforts, of two joints, in all records or in one."""
    motors = ("theta_m", "omega_m", "ref")
    for pair in combinations(range(1, evidence.arm.n_joints + 1), 2):
        for kinds in (motors, (*motors, *EFFORTS)):
            yield from _exchange(evidence, kinds, pair, record)


def _exchange(
    evidence: Evidence, kinds: Sequence[str], pair: tuple[int, int], record: str
) -> Iterator[Alternative]:
    given = [kind for kind in kinds if {f"{kind}{i}" for i in pair} <= evidence.channels]
    names = [(f"{kind}{pair[0]}", f"{kind}{pair[1]}") for kind in given]
    if names:
        changes = exchange_corrections(names, evidence.study)
        yield Alternative(
            "exchange", pair[0], changes, record=record, exchanged=tuple(given), other=pair[1]
        )


def _discrete(evidence: Evidence) -> Iterator[Alternative]:
    """Other axes along the joint's frame, other directions of gravity, other couplings."""
    arm = evidence.study.arm
    units = [tuple(float(s * x) for x in e) for e in np.eye(3) for s in (1.0, -1.0)]
    for i, joint in enumerate(arm.joints, start=1):
        stated = np.array(joint.axis) / np.linalg.norm(joint.axis)
        axes = [tuple(-x for x in joint.axis), *units]
        for axis in dict.fromkeys(axes):
            if axis @ stated < _EQUAL_DIRECTIONS:
                yield Alternative("axis", i, (Correction("joint", str(i), "axis", axis),))
        for factor in _TORQUE_UNITS:
            scaled = _torque(evidence, i, np.array([np.log(factor) / _RATIO_STD]))
            if scaled:
                yield Alternative("torque", i, scaled)
    size = arm.gravity_size or _STANDARD_GRAVITY
    stated = np.array(arm.gravity or (0.0, 0.0, 0.0)) / size
    for unit in units:
        if unit @ stated < _EQUAL_DIRECTIONS:
            gravity = tuple(size * x for x in unit)
            change = Correction("arm", "", "gravity", gravity)
            yield Alternative("gravity", None, (change,))
    if arm.coupling is not None and arm.is_coupled:
        C = np.array(arm.coupling)
        for other in (np.eye(len(C)), C.T, 2.0 * np.diag(np.diag(C)) - C):
            matrix = tuple(tuple(map(float, row)) for row in other)
            change = Correction("transmission", "", "coupling", matrix)
            yield Alternative("coupling", None, (change,))
    efforts = [f"torque{i}" for i in range(1, arm.n_joints + 1)]
    efforts = [name for name in efforts if name in evidence.channels]
    if efforts and arm.gravity:
        changes = tuple(Correction("channels", n, "meaning", "without-gravity") for n in efforts)
        yield Alternative("without-gravity", None, changes)


def _families(evidence: Evidence) -> Iterator[_Family]:
    arm = evidence.study.arm
    if arm.gravity:
        tolerated = np.full(3, _TOLERATED_GRAVITY / _GRAVITY_STD)
        yield _Family("gravity", None, 3, partial(_gravity, evidence), tolerated)
    joints = range(1, arm.n_joints + 1)
    for i in joints:
        tolerated = np.array([_TOLERATED_RATIO / _RATIO_STD])
        yield _Family("ratio", i, 1, partial(_ratio, evidence, i), tolerated)
        tolerated = np.array([_TOLERATED_ANGLE / _ANGLE_STD])
        yield _Family("zero", i, 1, partial(_zero, evidence, i), tolerated)
        yield _Family("frame", i, 6, partial(_frame, evidence, i), _TOLERATED_FRAME)
        if _torque(evidence, i, np.zeros(1)):
            tolerated = np.array([_TOLERATED_TORQUE / _RATIO_STD])
            yield _Family("torque", i, 1, partial(_torque, evidence, i), tolerated)
    step = max(r.sample_time for r in evidence.records) / _DELAY_ROWS
    efforts = [name for i in joints if (name := effort_channel(evidence.channels, i))]
    angles = [[f"theta_m{i}", f"omega_m{i}"] for i in joints]
    for names in (efforts, *([name] for name in efforts), *angles):
        joint = channel_parts(names[0])[1] if names is not efforts else None
        late = partial(_delay, names, step)
        yield _Family("delay", joint, 1, late, np.array([_TOLERATED_DELAY / step]))


def _rounded(values: FloatArray) -> tuple[float, ...]:
    return tuple(float(f"{x:.9g}") for x in values.tolist())


def _gravity(evidence: Evidence, x: FloatArray) -> tuple[Correction, ...]:
    stated = np.array(evidence.study.arm.gravity)
    changed = stated + _GRAVITY_STD * x
    changed *= np.linalg.norm(stated) / np.linalg.norm(changed)
    return (Correction("arm", "", "gravity", _rounded(changed)),)


def _ratio(evidence: Evidence, i: int, x: FloatArray) -> tuple[Correction, ...]:
    ratio = evidence.study.arm.joints[i - 1].gear_ratio * float(np.exp(_RATIO_STD * x[0]))
    return (Correction("joint", str(i), "gear_ratio", ratio),)


def _torque(evidence: Evidence, i: int, x: FloatArray) -> tuple[Correction, ...]:
    """Another scale of the torque channel or of the torque constant; none without both."""
    name, constant = f"torque{i}", evidence.study.arm.joints[i - 1].known_torque_per_volt
    factor = float(np.exp(_RATIO_STD * x[0]))
    if name in evidence.channels:
        return (Correction("channels", name, "scale", evidence.channel(name).scale * factor),)
    if constant is None:
        return ()
    return (Correction("joint", str(i), "torque_per_volt", constant * factor),)


def _delay(names: Sequence[str], step: float, x: FloatArray) -> tuple[Correction, ...]:
    """A delay of efforts or motor angles, in units of `step`."""
    return tuple(Correction("log", name, "delay_s", step * float(x[0])) for name in names)


def _zero(evidence: Evidence, i: int, x: FloatArray) -> tuple[Correction, ...]:
    name, ratio = f"theta_m{i}", evidence.study.arm.joints[i - 1].gear_ratio
    offset = evidence.channel(name).offset + _ANGLE_STD * float(x[0]) / ratio
    return (Correction("channels", name, "offset", offset),)


def _frame(evidence: Evidence, i: int, x: FloatArray) -> tuple[Correction, ...]:
    origin = evidence.study.arm.joints[i - 1].origin
    xyz = np.array(origin.xyz) + _LENGTH_STD * x[:3]
    rpy = np.array(origin.rpy) + _ANGLE_STD * x[3:]
    return (
        Correction("joint", str(i), "origin.xyz", _rounded(xyz)),
        Correction("joint", str(i), "origin.rpy", _rounded(rpy)),
    )


def _robot(evidence: Evidence, x: FloatArray) -> tuple[Correction, ...]:
    frames = x.reshape(-1, 6)
    return tuple(c for i, row in enumerate(frames, start=1) for c in _frame(evidence, i, row))


def _search(
    evidence: Evidence, start: TorqueFit, stated: FitQuality, family: _Family
) -> Alternative | None:
    """Gauss-Newton search of one family; None within tolerated changes or if it is no better."""
    x, fit = np.zeros(family.size), start
    for k in range(_MAX_STEPS):
        if k == _N_TRIAL_STEPS and fit_ratio(fit.cost, 0.0, fit.n_all) > _MAX_TRIAL_UNEXPLAINED:
            return None
        step, _ = _gauss_newton(fit, _slope(evidence, fit, family, x), x)
        fraction = min(1.0, _MAX_STEP / max(float(np.abs(step).max()), 1e-12))
        before = fit.cost
        while fraction > _MIN_STEP_FRACTION:
            trial = _fit(evidence, family.corrections(x + fraction * step))
            if trial is not None and trial.cost < fit.cost:
                x, fit = x + fraction * step, trial
                break
            fraction *= _STEP_REDUCTION
        if before - fit.cost < _MIN_DECREASE * fit.n_all:
            break
    if np.all(np.abs(x) < family.tolerated):
        return None
    corrections = family.corrections(x)
    system = torque_system(evidence.corrected(corrections))
    if system is None:
        return None
    found = Alternative(family.kind, family.joint, corrections)
    better = _if_better(found, stated, predict_stretches(system))
    # the coordinates are fitted to all stretches: the criterion of Akaike
    return None if better is None else replace(better, cost=better.cost + family.size)


def _slope(evidence: Evidence, fit: TorqueFit, family: _Family, x: FloatArray) -> FloatArray:
    """Derivatives of the weighted torques that the links do not explain: (n_rows, size).

    `fit` is the fit at x.
    """

    def leave(at: FloatArray) -> FloatArray:
        return unexplained_torques(evidence.corrected(family.corrections(at)), fit.links)

    here = fit.residual / fit.weight
    changes = [here - leave(x + _DERIVATIVE_STEP * unit) for unit in np.eye(family.size)]
    return fit.project(np.column_stack(changes) / _DERIVATIVE_STEP)


def _gauss_newton(fit: TorqueFit, slope: FloatArray, x: FloatArray) -> tuple[FloatArray, float]:
    """Step from x under the prior, and the predicted decrease of the cost per row."""
    gradient, curvature = slope.T @ fit.residual, slope.T @ slope + np.eye(len(x))
    explained = float(gradient @ np.linalg.solve(curvature, gradient)) / fit.n_all
    decrease = -0.5 * float(np.log(max(1.0 - explained, _MIN_UNEXPLAINED)))
    return np.asarray(np.linalg.solve(curvature, gradient - x)), decrease
