"""Search for other explanations of the torques of all joints, which compete on held-out stretches.

Each is a single change of the study or of the logs: an axis, gravity, a gear ratio, a zero, a
frame, a sign, an exchange, a delay. Continuous changes are found by Gauss-Newton steps of the fit
of `torque_fit`, in which the parameters of the links are eliminated (Kaufman's variable
projection). An explanation is listed if it predicts stretches that it was not fitted to better than
the stated description does.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import combinations

import numpy as np

from strainwave.domain import ArmDescription, Correction, FloatArray, channel_parts
from strainwave.domain.arm import Vector
from strainwave.domain.corrections import exchange_corrections
from strainwave.domain.kinds import arm_keys, kind_of
from strainwave.numerics.parallel import run_parallel
from strainwave.signals.consistency.evidence import (
    Alternative,
    ChangeKind,
    Evidence,
    is_as_good,
    is_slow,
)
from strainwave.signals.consistency.motors import EFFORTS, effort_channel
from strainwave.signals.consistency.torque_fit import (
    FitQuality,
    TorqueFit,
    TorqueSystem,
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
# Mean unexplained share above which a search ends after the given number of steps.
_N_TRIAL_STEPS, _MAX_TRIAL_UNEXPLAINED = 3, 0.3
# Unexplained share of one torque above which exchanges of joints are tried.
_MAX_UNEXPLAINED = 0.25
# Decrease of the cost per independent row of the fit below which a change is not used to predict,
# no search is started, and a search ends.
_MIN_DECREASE_TO_PREDICT, _MIN_PREDICTED_DECREASE, _MIN_DECREASE = 0.03, 0.03, 2e-3
# Probability of the gain by chance, for all explanations together; and the gain of half the
# unexplained variance of one torque, which no explanation of a sound log reaches, with the
# difference of the log likelihoods that it needs in a short log: exp(-12) for each of 160.
_MAX_CHANCE, _LARGE_GAIN, _MIN_LOG_LIKELIHOOD = 1e-3, float(np.log(2.0)), 12.0
# Log ratio of unexplained variances from which an explanation is listed: of a change with one
# coordinate, whose size is tested as well; and of other changes.
_MIN_GAIN_OF_COORDINATE, _MIN_GAIN = 0.1, float(np.log(1.3))
_MEASURED = ("ratio", "zero", "torque")
# Probability by chance of a large gain.
_MAX_CHANCE_OF_LARGE = 0.01
# Share of the largest gain of a joint that another joint may lose.
_MAX_LOSS = 0.25
# Scale of the delays in rows of the low-pass record, and the delay that is tolerated [s].
_DELAY_ROWS, _TOLERATED_DELAY = 1.0, 4e-3
# Reduction of a step that does not decrease the cost, and the shortest fraction that is tried.
_STEP_REDUCTION, _MIN_STEP_FRACTION = 0.4, 0.1
# Smallest predicted unexplained share, for the logarithm.
_MIN_UNEXPLAINED = 1e-6
# Changes within which a description is accepted: relative, angles [rad], lengths [m], gravity
# [m/s^2], torque constants. Drawings and calibrations of robots are more accurate.
_TOLERATED_RATIO, _TOLERATED_ANGLE, _TOLERATED_LENGTH = 0.004, 0.03, 0.01
_TOLERATED_GRAVITY, _TOLERATED_TORQUE = 0.5, 0.1
# Factors of the torque of one joint in another unit.
_TORQUE_UNITS = (1e3, 1e-3)
# Zeros that a search from the stated one does not reach [rad].
_QUARTER_TURNS = (0.5 * np.pi, -0.5 * np.pi, np.pi)
_DEGREE = np.pi / 180.0  # [rad]
_ROTATIONS = ("theta_m", "omega_m", "ref")
_N_LOAD_PARAMETERS = 10
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


def search_explanations(evidence: Evidence) -> tuple[Alternative, ...] | None:
    """Other explanations of the torques that predict held-out stretches better, the best first.

    None without torques; empty if a change of a tolerated size explains them as well.
    """
    evidence.memory.stated_arm = evidence.arm
    slow = tuple(record for record in evidence.records if is_slow(record.experiment))
    evidence = replace(evidence, records=slow)
    system = torque_system(evidence)
    if system is None:
        return None
    search = _Search(evidence, system, fit_torques(system), predict_stretches(system))
    simple = [*_discrete(evidence), *_angle_units(evidence), *_efforts(evidence, "")]
    for record in search.doubtful_records():
        simple += [
            Alternative("payload", None, (), record=record, n_coordinates=_N_LOAD_PARAMETERS)
        ]
        simple += [*_efforts(evidence, record), *_joint_exchanges(evidence, record)]
    jobs = [partial(search.discrete, each) for each in simple]
    families = search.families()
    jobs += [partial(search.continuous, *each) for each in families]
    tried = [*simple, *(Alternative(f.kind, f.joint, ()) for f, _ in families)]
    found = [each for each in run_parallel(jobs) if each is not None]
    if found or max(search.fit.unexplained.values()) > _MAX_UNEXPLAINED:
        exchanges = [*_joint_exchanges(evidence, "")]
        tried += exchanges
        jobs = [partial(search.discrete, each) for each in exchanges]
        found += [each for each in run_parallel(jobs) if each is not None]
    # each kind of explanation has the same share of the probability, whatever their number
    n_tried = Counter(map(_group, tried))
    limits = {group: _MAX_CHANCE / len(n_tried) / n for group, n in n_tried.items()}
    if not any(_is_evident(each, limits[_group(each)]) for each in found):
        return ()
    rivals = sorted((a for a in found if _is_evident(a, _MAX_CHANCE)), key=lambda a: a.cost)
    if any(each.is_tolerated and is_as_good(each, rivals[0]) for each in rivals):
        return ()
    return tuple(each for each in rivals if not each.is_tolerated)


def _group(each: Alternative) -> tuple[ChangeKind, bool]:
    """The kind of an explanation, of all records or of one."""
    return each.kind, bool(each.record)


def _is_evident(each: Alternative, limit: float) -> bool:
    """Whether the gain is not one of chance, of a probability below `limit`, or large.

    A load must gain much, and on all torques together: it acts on all joints, and its many
    parameters follow the friction of one.
    """
    if each.gain is None:
        return False
    largest = each.gain.mean if each.kind == "payload" else float(each.gain.by_joint.max())
    is_large = (
        largest > _LARGE_GAIN
        and each.gain.log_likelihood > _MIN_LOG_LIKELIHOOD
        and each.gain.probability < _MAX_CHANCE_OF_LARGE
    )
    return is_large or (each.gain.probability < limit and each.kind != "payload")


@dataclass(frozen=True, slots=True)
class _Search:
    """The stated description and its fit, which explanations are compared with."""

    evidence: Evidence
    system: TorqueSystem
    fit: TorqueFit
    stated: FitQuality

    def discrete(self, each: Alternative) -> Alternative | None:
        """The alternative with its gain; None if it is no clear one."""
        changed = self.evidence.corrected_in(each.record, each.corrections)
        loaded = each.record if each.kind == "payload" else ""
        system = torque_system(changed, loaded)
        if system is not None and each.kind == "exchange":
            system = self._in_stated_sizes(system)
        # of two records, either can be the one with the load
        is_one = len({r.experiment.name for r in self.evidence.records}) > 2
        if system is None or (loaded and is_one and _load_inertia(system) < 0.0):
            return None
        if self.fit.cost - fit_torques(system).cost < _MIN_DECREASE_TO_PREDICT * self.fit.n_all:
            return None
        return self._gaining(each, predict_stretches(system), _MIN_GAIN, is_pooled=False)

    def _in_stated_sizes(self, system: TorqueSystem) -> TorqueSystem:
        """Exchanged torques with the errors relative to the torques of the stated description.

        A large torque in the place of a small one has a smaller share of the same error.
        """
        stated = self.system.total, self.system.n_rows
        if set(system.total) != set(stated[0]):
            return system
        totals = {i: total * system.n_rows[i] / stated[1][i] for i, total in stated[0].items()}
        return replace(system, total=totals)

    def families(self) -> list[tuple[_Family, FloatArray]]:
        """Families with their derivatives at the stated description, and that of all frames."""
        families = [*_families(self.evidence)]
        jobs = [partial(self._slope, f, np.zeros(f.size), self.fit) for f in families]
        pairs = [*zip(families, run_parallel(jobs), strict=True)]
        frames = [slope for family, slope in pairs if family.kind == "frame"]
        if frames:
            tolerated = np.tile(_TOLERATED_FRAME, len(frames))
            change = partial(_robot, self.evidence)
            pairs.append(
                (_Family("robot", None, len(tolerated), change, tolerated), np.hstack(frames))
            )
        return pairs

    def continuous(self, family: _Family, slope: FloatArray) -> Alternative | None:
        """Gauss-Newton search of one family; None without clear gain.

        The coordinates are fitted anew to the other stretches of each stretch, to first order.
        `slope` has the derivatives at the stated description.
        """
        x, fit = np.zeros(family.size), self.fit
        for k in range(_MAX_STEPS):
            if k == _N_TRIAL_STEPS and np.exp(2.0 * fit.cost / fit.n_all) > _MAX_TRIAL_UNEXPLAINED:
                return None
            step, decrease = _gauss_newton(fit, fit.project(slope), x)
            # the criterion of Akaike
            if k == 0 and decrease - family.size / fit.n_all < _MIN_PREDICTED_DECREASE:
                return None
            fraction = min(1.0, _MAX_STEP / max(float(np.abs(step).max()), 1e-12))
            before = fit.cost
            while fraction > _MIN_STEP_FRACTION:
                trial = _fit(self.evidence, family.corrections(x + fraction * step))
                if trial is not None and trial.cost < fit.cost:
                    x, fit = x + fraction * step, trial
                    slope = self._slope(family, x, fit)
                    break
                fraction *= _STEP_REDUCTION
            if before - fit.cost < _MIN_DECREASE * fit.n_all:
                break
        system = torque_system(self.evidence.corrected(family.corrections(x)))
        if system is None:
            return None
        # a scale changes the torque itself, not its explanation
        quality = predict_stretches(system, fitted=None if family.kind == "torque" else (x, slope))
        is_tolerated = bool(np.all(np.abs(x) < family.tolerated))
        found = Alternative(
            family.kind,
            family.joint,
            family.corrections(x),
            is_tolerated=is_tolerated,
            n_coordinates=family.size,
        )
        least = _MIN_GAIN_OF_COORDINATE if family.kind in _MEASURED else _MIN_GAIN
        return self._gaining(found, quality, least, is_pooled=True)

    def doubtful_records(self) -> list[str]:
        """Records without which the stretches of the others are predicted clearly better.

        Also the one with the largest errors in any torque relative to the others.
        """
        system, names = self.system, np.array(self.system.records)
        doubtful, excess = [], {}
        tiny = np.finfo(float).tiny
        for name in dict.fromkeys(system.records) if len(set(system.records)) > 1 else ():
            kept = names != name
            others = predict_stretches(system, names[~kept].tolist())
            before, after = (q.shares[kept].sum(axis=0) + tiny for q in (self.stated, others))
            if np.max(np.log(before / after)) > _MIN_GAIN:
                doubtful.append(name)
            rows = self.stated.rows
            errors = self.stated.shares[~kept].sum(axis=0) / (rows[~kept].sum(axis=0) + tiny)
            excess[name] = float(np.max(errors * rows[kept].sum(axis=0) / before))
        if excess and (worst := max(excess, key=lambda name: excess[name])) not in doubtful:
            doubtful.append(worst)
        return doubtful

    def _gaining(
        self, each: Alternative, quality: FitQuality, least: float, *, is_pooled: bool
    ) -> Alternative | None:
        """The alternative with its gain; None if it gains too little, or all or one torque loses.

        All torques gain at least `least` together if `is_pooled`, otherwise one does.
        """
        if quality.shares.shape[1] != self.stated.shares.shape[1]:
            return None  # a torque is compared in one of the two only
        gain = quality.gain(self.stated)
        if each.kind == "exchange":  # their errors change places as well
            pair = np.isin(sorted(self.system.total), [each.joint or 0, each.other or 0])
            by_joint = np.where(pair, gain.by_joint[pair].mean(), gain.by_joint)
            gain = replace(gain, by_joint=by_joint)
        best, worst = float(gain.by_joint.max()), float(gain.by_joint.min())
        if gain.mean <= 0.0:
            return None
        if (gain.mean if is_pooled else best) < least or worst < -_MAX_LOSS * best:
            return None
        return replace(each, gain=gain, cost=quality.cost)

    def _slope(self, family: _Family, x: FloatArray, fit: TorqueFit) -> FloatArray:
        """Derivatives (n_rows, size) of the torques that the links of the fit at x leave, negated.

        They are what the coordinates explain.
        """

        def leave(at: FloatArray) -> FloatArray:
            return unexplained_torques(self.evidence.corrected(family.corrections(at)), fit.links)

        here = fit.residual / fit.weight
        changes = [here - leave(x + _DERIVATIVE_STEP * unit) for unit in np.eye(family.size)]
        return np.column_stack(changes) / _DERIVATIVE_STEP


def _load_inertia(system: TorqueSystem) -> float:
    """Trace of the inertia of the load, the last parameters of a system with one [kg m^2].

    Infinite if the links have fewer parameters than a body.
    """
    links = fit_torques(system).links
    if len(links) < 2 * _N_LOAD_PARAMETERS:
        return np.inf
    return float(links[-_N_LOAD_PARAMETERS:][[4, 6, 9]].sum())


def _fit(evidence: Evidence, corrections: Sequence[Correction]) -> TorqueFit | None:
    system = torque_system(evidence.corrected(corrections))
    return None if system is None else fit_torques(system)


_TOLERATED_FRAME = np.repeat([_TOLERATED_LENGTH / _LENGTH_STD, _TOLERATED_ANGLE / _ANGLE_STD], 3)


def _efforts(evidence: Evidence, record: str) -> Iterator[Alternative]:
    """Reversed and exchanged efforts, in all records or in one."""
    joints = range(1, evidence.arm.n_joints + 1)
    for i in joints:
        name = effort_channel(evidence.channels, i)
        if name is not None:
            yield Alternative("torque", i, _scaled(evidence, [name], -1.0), record=record)
    for pair in combinations(joints, 2):
        yield from _exchange(evidence, EFFORTS, pair, record)


def _angle_units(evidence: Evidence) -> Iterator[Alternative]:
    """All motor angles and velocities in degrees or turns."""
    if any(joint.motion == "prismatic" for joint in evidence.arm.joints):
        return
    names = [n for n in sorted(evidence.channels) if channel_parts(n)[0] in _ROTATIONS]
    for factor in (_DEGREE, 2.0 * np.pi):
        yield Alternative("unit", None, _scaled(evidence, names, factor))


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
    """Other axes, directions of gravity, signs and units, couplings, and meanings of efforts."""
    arm = evidence.study.arm
    for i in range(1, arm.n_joints + 1):
        names = [n for n in (f"theta_m{i}", f"omega_m{i}") if n in evidence.channels]
        yield Alternative("angle", i, _scaled(evidence, names, -1.0))
        if arm.joints[i - 1].motion == "revolute":
            for angle in _QUARTER_TURNS:
                yield Alternative("zero", i, _zero(evidence, i, np.array([angle / _ANGLE_STD])))
        for factor in _TORQUE_UNITS:
            scaled = _torque(evidence, i, np.array([np.log(factor) / _RATIO_STD]))
            if scaled:
                yield Alternative("torque", i, scaled)
    if not kind_of(arm).places_joints:
        yield from _axes(arm)
    yield from _gravities(arm)
    if arm.coupling is not None and arm.is_coupled:
        C = np.array(arm.coupling)
        for other in (np.eye(len(C)), C.T, 2.0 * np.diag(np.diag(C)) - C):
            matrix = tuple(tuple(map(float, row)) for row in other)
            change = Correction("transmission", "", "coupling", matrix)
            yield Alternative("coupling", None, (change,))
    efforts = [n for i in range(1, arm.n_joints + 1) if (n := f"torque{i}") in evidence.channels]
    if efforts and arm.gravity:
        changes = tuple(Correction("channels", n, "meaning", "without-gravity") for n in efforts)
        yield Alternative("without-gravity", None, changes)


_DIRECTIONS = [tuple(float(s * x) for x in e) for e in np.eye(3) for s in (1.0, -1.0)]


def _axes(arm: ArmDescription) -> Iterator[Alternative]:
    for i, joint in enumerate(arm.joints, start=1):
        stated = np.array(joint.axis) / np.linalg.norm(joint.axis)
        for axis in dict.fromkeys([tuple(-x for x in joint.axis), *_DIRECTIONS]):
            if axis @ stated < _EQUAL_DIRECTIONS:
                yield Alternative("axis", i, (Correction("joint", str(i), "axis", axis),))


def _gravities(arm: ArmDescription) -> Iterator[Alternative]:
    """Other directions of the gravity of chains; gravity of planes, where the study states none."""
    if "gravity" not in arm_keys(arm) or (arm.n_joints == 1 and not arm.gravity):
        return  # a torque that depends on the angle is not yet one of gravity
    size = arm.gravity_size or _STANDARD_GRAVITY
    others: list[float | Vector | None] = [None if arm.gravity else size]
    if not kind_of(arm).places_joints:
        stated = np.array(arm.gravity or (0.0, 0.0, 0.0)) / size
        turned = [unit for unit in _DIRECTIONS if unit @ stated < _EQUAL_DIRECTIONS]
        others = [(size * x, size * y, size * z) for x, y, z in turned]
    for other in others:
        yield Alternative("gravity", None, (Correction("arm", "", "gravity", other),))


def _scaled(evidence: Evidence, names: Sequence[str], factor: float) -> tuple[Correction, ...]:
    scales = {name: evidence.channel(name).scale * factor for name in names}
    return tuple(Correction("channels", name, "scale", scale) for name, scale in scales.items())


def _families(evidence: Evidence) -> Iterator[_Family]:
    arm = evidence.study.arm
    is_chain = not kind_of(arm).places_joints
    if arm.gravity and is_chain:
        tolerated = np.full(3, _TOLERATED_GRAVITY / _GRAVITY_STD)
        yield _Family("gravity", None, 3, partial(_gravity, evidence), tolerated)
    joints = range(1, arm.n_joints + 1)
    for i in joints:
        tolerated = np.array([_TOLERATED_RATIO / _RATIO_STD])
        yield _Family("ratio", i, 1, partial(_ratio, evidence, i), tolerated)
        tolerated = np.array([_TOLERATED_ANGLE / _ANGLE_STD])
        yield _Family("zero", i, 1, partial(_zero, evidence, i), tolerated)
        if is_chain:
            yield _Family("frame", i, 6, partial(_frame, evidence, i), _TOLERATED_FRAME)
        if _torque(evidence, i, np.zeros(1)):
            tolerated = np.array([_TOLERATED_TORQUE / _RATIO_STD])
            yield _Family("torque", i, 1, partial(_torque, evidence, i), tolerated)
    step = max(r.sample_time for r in evidence.records) / _DELAY_ROWS
    efforts = [name for i in joints if (name := effort_channel(evidence.channels, i))]
    angles = [[n for n in (f"theta_m{i}", f"omega_m{i}") if n in evidence.channels] for i in joints]
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


def _gauss_newton(fit: TorqueFit, slope: FloatArray, x: FloatArray) -> tuple[FloatArray, float]:
    """Step from x under the prior, and the predicted decrease of the cost per row."""
    gradient, curvature = slope.T @ fit.residual, slope.T @ slope + np.eye(len(x))
    explained = float(gradient @ np.linalg.solve(curvature, gradient)) / fit.n_all
    decrease = -0.5 * float(np.log(max(1.0 - explained, _MIN_UNEXPLAINED)))
    return np.asarray(np.linalg.solve(curvature, gradient - x)), decrease
