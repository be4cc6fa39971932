"""Search for another geometry with which the torques of all joints agree with one arm.

The alternatives are single changes of the study: an axis, gravity, a gear ratio, a zero position,
the frame of one joint, the coupling of the motors, or all frames. Changes of continuous quantities
are found by Gauss-Newton steps of the fit of `torque_fit`, in which the parameters of the links are
eliminated (Kaufman's variable projection).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import combinations

import numpy as np

from strainwave.domain import Correction, FloatArray
from strainwave.domain.corrections import exchange_corrections
from strainwave.domain.kinds import kind_of
from strainwave.numerics.parallel import run_parallel
from strainwave.signals.consistency.evidence import Alternative, ChangeKind, Evidence
from strainwave.signals.consistency.torque_fit import (
    TorqueFit,
    fit_ratio,
    fit_torques,
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
# Mean unexplained share of the torques above which geometries are not compared. Measured arms with
# friction that depends on temperature and position reach 0.4, simulated ones 0.001.
_MAX_UNEXPLAINED = 0.05
# Reduction of a step that does not decrease the cost, and the shortest fraction that is tried.
_STEP_REDUCTION, _MIN_STEP_FRACTION = 0.4, 0.1
# Smallest predicted unexplained share, for the logarithm.
_MIN_UNEXPLAINED = 1e-6
# Decrease of the cost per independent row below which a search is not started, or ends.
_MIN_PREDICTED_DECREASE = 0.03
_MIN_DECREASE = 2e-3
# Changes within which a description is accepted: relative, angles [rad], lengths [m], gravity
# [m/s^2], torque constants. Drawings and calibrations of robots are more accurate.
_TOLERATED_RATIO, _TOLERATED_ANGLE, _TOLERATED_LENGTH = 0.02, 0.03, 0.01
_TOLERATED_GRAVITY, _TOLERATED_TORQUE = 0.5, 0.1
# Factors of the torque of one joint in another unit.
_TORQUE_UNITS = (1e3, 1e-3)
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
    """Alternatives to the stated geometry, the best first, and the stated geometry as the last.

    Empty for kinds that place the joints, without torques, and if no geometry explains the torques
    well: friction and drives then change the fit more.
    """
    system = None if kind_of(evidence.arm).places_joints else torque_system(evidence)
    if system is None:
        return ()
    fit = fit_torques(system)
    stated = Alternative("robot", None, (), fit.cost)
    discrete = _compare(evidence, _discrete(evidence))
    if fit_ratio(min(a.cost for a in (stated, *discrete)), 0.0, fit.n_all) > _MAX_UNEXPLAINED:
        discrete += _compare(evidence, _exchanges(evidence))
    if fit_ratio(min(a.cost for a in (stated, *discrete)), 0.0, fit.n_all) > _MAX_TRIAL_UNEXPLAINED:
        return ()
    continuous = run_parallel(
        [partial(_search, evidence, fit, family) for family in _promising(evidence, fit)]
    )
    found = [each for each in continuous if each is not None]
    better = [each for each in (*discrete, *found) if each.cost < fit.cost]
    ordered = (*sorted(better, key=lambda each: each.cost), stated)
    is_explained = fit_ratio(ordered[0].cost, 0.0, fit.n_all) < _MAX_UNEXPLAINED
    return ordered if is_explained else ()


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


def _cost(evidence: Evidence, corrections: Sequence[Correction]) -> float:
    fit = _fit(evidence, corrections)
    return np.inf if fit is None else fit.cost


def _compare(evidence: Evidence, alternatives: Iterable[Alternative]) -> list[Alternative]:
    """The alternatives with the costs of their fits."""
    listed = list(alternatives)
    costs = run_parallel([partial(_cost, evidence, each.corrections) for each in listed])
    return [replace(a, cost=c) for a, c in zip(listed, costs, strict=True)]


def _exchanges(evidence: Evidence) -> Iterator[Alternative]:
    """Exchanged motor angles, inputs, or both, of two joints."""
    for pair in combinations(range(1, evidence.arm.n_joints + 1), 2):
        angles, inputs = (
            [kind for kind in kinds if {f"{kind}{i}" for i in pair} <= evidence.channels]
            for kinds in (("theta_m",), ("u", "torque"))
        )
        for kinds in (angles, inputs, angles + inputs):
            names = [(f"{kind}{pair[0]}", f"{kind}{pair[1]}") for kind in kinds]
            corrections = exchange_corrections(names, evidence.study)
            yield Alternative("exchange", None, corrections, np.inf)


def _discrete(evidence: Evidence) -> Iterator[Alternative]:
    """Other axes along the joint's frame, other directions of gravity, other couplings."""
    arm = evidence.study.arm
    units = [tuple(float(s * x) for x in e) for e in np.eye(3) for s in (1.0, -1.0)]
    for i, joint in enumerate(arm.joints, start=1):
        stated = np.array(joint.axis) / np.linalg.norm(joint.axis)
        axes = [tuple(-x for x in joint.axis), *units]
        for axis in dict.fromkeys(axes):
            if axis @ stated < _EQUAL_DIRECTIONS:
                yield Alternative("axis", i, (Correction("joint", str(i), "axis", axis),), np.inf)
        for factor in _TORQUE_UNITS:
            scaled = _torque(evidence, i, np.array([np.log(factor) / _RATIO_STD]))
            if scaled:
                yield Alternative("torque", i, scaled, np.inf)
        for name in (f"{kind}{i}" for kind in ("torque", "u")):
            if name in evidence.channels:
                reverse = Correction("channels", name, "scale", -evidence.channel(name).scale)
                yield Alternative("torque", i, (reverse,), np.inf)
    size = arm.gravity_size or _STANDARD_GRAVITY
    stated = np.array(arm.gravity or (0.0, 0.0, 0.0)) / size
    for unit in units:
        if unit @ stated < _EQUAL_DIRECTIONS:
            gravity = tuple(size * x for x in unit)
            change = Correction("arm", "", "gravity", gravity)
            yield Alternative("gravity", None, (change,), np.inf)
    if arm.coupling is not None and arm.is_coupled:
        C = np.array(arm.coupling)
        for other in (np.eye(len(C)), C.T, 2.0 * np.diag(np.diag(C)) - C):
            matrix = tuple(tuple(map(float, row)) for row in other)
            change = Correction("transmission", "", "coupling", matrix)
            yield Alternative("coupling", None, (change,), np.inf)


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


def _search(evidence: Evidence, start: TorqueFit, family: _Family) -> Alternative | None:
    """Gauss-Newton search of one family; None if it ends within the tolerated changes."""
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
    cost = fit.cost + family.size  # the criterion of Akaike
    return Alternative(family.kind, family.joint, family.corrections(x), cost)


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
