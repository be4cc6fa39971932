"""Signals -> RigidModel: the rigid-joint arm (5)-(7) by weighted least squares.

The equations of motion are linear in the model's parameters. They are filtered to a bandwidth
chosen from the data, weighted per joint, and solved together with nuisance unknowns for the
friction of motors that may stand and for the gears' compliance; see `equations`. Deviations come
from leaving out stretches of the data and from changing the bandwidth.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Literal

import numpy as np

from strainwave.domain import (
    BoolArray,
    Diagnostic,
    FloatArray,
    Parameter,
    RigidModel,
    RigidOptions,
    Signals,
)
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.rigid_prediction import band_fit
from strainwave.errors import NotIdentifiable
from strainwave.identification.rigid.equations import (
    MOTOR_SHARE,
    Estimate,
    Loads,
    Stretch,
    anti_resonances,
    assemble,
    carried_over,
    decimation,
    estimate_of,
    halfway,
    n_compliances,
    prepare,
)
from strainwave.identification.rigid.repetition import period_of
from strainwave.identification.rigid.torque_constants import TorqueRatio, torque_ratio
from strainwave.numerics import least_squares as ls
from strainwave.numerics.distributions import student_quantile
from strainwave.numerics.parallel import one_blas_thread, side_by_side

__all__ = ["OTHER_SHARE", "RigidOptions", "fit"]

_ROUNDS = 20
_CONVERGED = 0.02  # change in white-error deviations, which are the smallest there are
_STEP = 2.0**0.5  # between bandwidths tried; twice as wide where nothing is elastic
_GAIN = np.log(1.1)  # a deviation's change that counts; the jackknife knows it no better
_UNSETTLED = 0.5  # of a deviation, by which the last round may have moved a parameter
_VAGUE = 0.003  # of all torque; from 1e-4 to 1e-3 where there is motion enough in the band
_ROWS_A_BLOCK = 2.0  # of one joint: half a period of the cut-off, over which errors are alike
_FRUITLESS = 3  # bandwidths without gain that end the search
_EVIDENT = 4.0  # deviations at which friction depends on the load: once in ten thousand by chance
_LEAST_SHARE = 0.01  # of the load: less is nothing beside the torque constant's own error
OTHER_SHARE = 0.3  # of the motor in the first inertia
_MUCH_STANDING = 0.3  # share of a record
_POOR = 300.0  # condition number; good motion gives 10 to 50
_REMEDY = "record both joints moving together, in both directions, at varied speeds and postures"
_BELOW_RESONANCE = 3.0  # anti-resonance over bandwidth from which first order suffices


_Motion = tuple[Signals, float]  # with the period that it repeats


@dataclass(frozen=True, slots=True)
class _Trial:
    """A fit at one bandwidth."""

    stretches: tuple[Stretch, ...]  # one per record
    estimate: Estimate
    compliance_deviation: FloatArray
    equations: ls.Equations
    factor: ls.Factor
    covariance: FloatArray
    determined: BoolArray
    last_move: float  # of any parameter in the last round, in its deviations

    @property
    def bandwidth_hz(self) -> float:
        """Of the equations' filter."""
        return self.stretches[0].bandwidth_hz

    @property
    def spread(self) -> FloatArray:
        """Logarithms of the parameters' deviations; infinite where not determined."""
        deviation = np.sqrt(np.clip(np.diag(self.covariance), 1e-300, None))
        return np.where(self.determined, np.log(deviation), np.inf)

    @property
    def vagueness(self) -> float:
        """Torque that one parameter's deviation makes at most, as a share of all torque."""
        deviation = np.sqrt(np.clip(np.diag(self.covariance), 0.0, None))
        torque = float(np.linalg.norm(self.factor.root * self.equations.target))
        return float(np.max(deviation * self.factor.scale)) / torque


def fit(signals: Sequence[Signals], arm: Arm, options: RigidOptions | None = None) -> RigidModel:
    """Identify the rigid-joint arm from motion records.

    `signals`: One per record, from `signals.motor_side`.

    Returns: Parameters that the data do not identify have the value None, and a warning says why.

    Raises `NotIdentifiable`: there is no record, or no sample of any that may be used.
    """
    if not signals:
        raise NotIdentifiable(
            'the rigid step needs a record with use = "motion": slow, smooth motion of all joints'
        )
    with one_blas_thread():  # hundreds of small factorisations
        return _fit(signals, arm, options or RigidOptions())


def _fit(signals: Sequence[Signals], arm: Arm, chosen: RigidOptions) -> RigidModel:
    motions = [(s, period_of(s)) for s in signals]
    if chosen.bandwidth_hz is not None:
        trials = [_trial(arm, _prepared(arm, motions, chosen.bandwidth_hz), None)]
    else:
        trials = _search(motions, arm)
    best = _choose(trials, arm)
    loaded = _loaded(arm, best, chosen.load_friction)
    if loaded:
        near = [best, *_neighbours(trials, best)]
        best, *near = trials = [_with_loads(arm, trial, loaded) for trial in near]
    remainder = _scatter(trials, best) + _elastic_remainder(arm, best)
    covariance = best.covariance + np.diag(remainder)
    model = _model(arm, best, covariance, _load_friction(trials, best, loaded))
    return replace(model, torque_ratio=_torque_ratio(arm, trials, best))


def _loaded(arm: Arm, best: _Trial, wanted: bool | None) -> list[int]:
    """The joints whose friction grows with the load, from 0.

    All that are wanted; otherwise those whose share stands far out of its deviation and leaves the
    joint possible: a share beside negative friction explains something else. Behind an elastic gear
    the load is not known well enough, and friction is the whole-arm fit's.
    """
    every = list(range(arm.n_joints))
    if n_compliances(arm) or wanted is False or not best.determined.all():
        return []
    if wanted:
        return every
    loads = Loads.of(every, best.stretches)
    once = ls.factorise(assemble(arm, best.stretches, best.estimate, loads), best.factor.root)
    if np.all(once.common <= _LEAST_SHARE):  # as of most arms; the rest takes many times as long
        return []
    trial = _with_loads(arm, best, every)
    share, deviation = trial.factor.common, trial.compliance_deviation
    impossible = {arm.rigid_columns[k].joint for k in _impossible(arm, trial)}
    return [
        k
        for k in every
        if share[k] > max(_LEAST_SHARE, _EVIDENT * deviation[k]) and k + 1 not in impossible
    ]


def _impossible(arm: Arm, trial: _Trial) -> list[int]:
    """Parameters that are negative beyond their uncertainty, though nothing makes them so."""
    return [
        k
        for k, column in enumerate(arm.rigid_columns)
        if trial.determined[k]
        and not column.name.startswith(("gravity", "friction_offset"))
        and trial.estimate.solution[k] + 2.0 * np.sqrt(trial.covariance[k, k]) < 0.0
    ]


def _with_loads(arm: Arm, trial: _Trial, joints: Sequence[int]) -> _Trial:
    """A fit at the same bandwidth in which friction may grow with the load."""
    loads = Loads.of(joints, trial.stretches)
    return _trial(arm, trial.stretches, trial.estimate, loads=loads)


def _load_friction(
    trials: Sequence[_Trial], best: _Trial, joints: Sequence[int]
) -> tuple[Parameter, ...]:
    """The shares of the load, with deviations that count what the bandwidths differ by."""
    found = []
    for k, joint in enumerate(joints):
        share, variance = float(best.factor.common[k]), float(best.compliance_deviation[k]) ** 2
        others = [(t.factor.common[k] - share) ** 2 for t in _neighbours(trials, best)]
        std = float(np.sqrt(variance + (max(0.0, np.median(others) - variance) if others else 0.0)))
        reach = _student(len(np.unique(best.equations.block)) - 1) * std
        interval = (share - reach, share + reach)
        found.append(Parameter("load_friction", joint + 1, share, std, "1", "rigid", interval))
    return tuple(found)


def _load_warning(share: Parameter) -> Diagnostic:
    text = (
        f"friction grows by {share.value:.3f} +- {share.std:.3f} of the load, and is predicted so;"
    )
    text += " simulate and export leave that out"
    return Diagnostic("load-friction", f"joint {share.joint}", text)


def _torque_ratio(arm: Arm, trials: Sequence[_Trial], best: _Trial) -> tuple[float, float] | None:
    """Joint 1's torque constant over joint 2's, as the data have it and as the study has it.

    The deviation counts what the neighbouring bandwidths differ by, like the parameters' own.
    """
    found = _torque_ratio_at(arm, best)
    if found is None:  # where the motion cannot say, neither can it in another band
        return None
    others = [_torque_ratio_at(arm, t) for t in _neighbours(trials, best)]
    excess = [
        max(0.0, (other.value - found.value) ** 2 - other.variance)
        for other in others
        if other is not None
    ]
    variance = found.variance + (float(np.median(excess)) if excess else 0.0)
    return 1.0 / found.value, float(np.sqrt(variance)) / found.value**2


def _torque_ratio_at(arm: Arm, trial: _Trial) -> TorqueRatio | None:
    # behind the compliances, shares of the load: no equation is built around these
    n, n_common = n_compliances(arm), trial.equations.common.shape[1]
    around = np.pad(trial.estimate.compliance[:n], (0, n_common - n))
    return torque_ratio(arm, trial.equations, trial.factor.root, around)


def _search(motions: Sequence[_Motion], arm: Arm) -> list[_Trial]:
    """Trials at rising bandwidths, while they gain and the arm still looks nearly rigid."""
    trials: list[_Trial] = []
    least, since = np.full(len(arm.rigid_columns), np.inf), 0
    stiff = n_compliances(arm) == 0
    for bandwidth in _bandwidths(motions, _STEP ** (2 if stiff else 1)):
        limits = [_surely_elastic(arm, trial) for trial in trials[-2:]]
        if len(limits) > 1 and bandwidth > max(limits):  # one trial alone may mistake its band
            break
        stretches = _prepared(arm, motions, bandwidth)
        around = (
            carried_over(trials[-1].estimate, trials[-1].stretches, stretches) if trials else None
        )
        trial = _trial(arm, stretches, around)
        trials.append(trial)
        gained = bool(np.any(trial.spread < least - _GAIN))
        since = 0 if gained else since + 1
        least = np.minimum(least, trial.spread)
        if since >= _FRUITLESS:
            break
    return trials


def _surely_elastic(arm: Arm, trial: _Trial) -> float:
    """Bandwidth above which the arm's elasticity is certainly more than first order.

    A trial that leaves a parameter vague, as low bandwidths do, may take anything for compliance;
    and one whose blocks are shorter than its errors are alike does not know how vague it is.
    """
    blocks = len(np.unique(trial.equations.block)) * arm.n_joints
    unsure = trial.vagueness > _VAGUE or len(trial.equations.target) < _ROWS_A_BLOCK * blocks
    if not n_compliances(arm) or unsure:
        return np.inf
    certain = np.clip(trial.estimate.compliance - 2.0 * trial.compliance_deviation, 0.0, None)
    sure = replace(trial.estimate, compliance=certain)
    return float(np.min(anti_resonances(arm, sure))) / _BELOW_RESONANCE


def _bandwidths(motions: Sequence[_Motion], step: float) -> Iterator[float]:
    """From where nine tenths of the motion's power lie below, up to half the signals' own."""
    top = min(s.bandwidth_hz or 0.5 / s.sample_time for s, _ in motions) / 2.0
    shortest = min(period * s.sample_time for s, period in motions)
    bandwidth = max([8.0 / shortest, *(_motion_band(s) for s, _ in motions)])
    bandwidth = min(bandwidth, top)
    while bandwidth <= top:
        yield bandwidth
        bandwidth *= step


def _motion_band(signals: Signals) -> float:
    """Frequency below which nine tenths of the velocities' power lie [Hz]."""
    highest = 0.0
    count = len(signals.time)
    frequency = np.fft.rfftfreq(count, signals.sample_time)
    along = np.arange(count) - 0.5 * (count - 1)
    for velocity in signals.motor_velocity.T:
        steady = velocity - velocity.mean()
        steady -= along * (along @ steady / (along @ along))
        share = np.cumsum(np.abs(np.fft.rfft(steady)) ** 2)
        if share[-1] > 0.0:
            highest = max(highest, float(frequency[np.searchsorted(share, 0.9 * share[-1])]))
    return highest


def _prepared(arm: Arm, motions: Sequence[_Motion], bandwidth_hz: float) -> tuple[Stretch, ...]:
    return tuple(prepare(arm, s, bandwidth_hz, period) for s, period in motions)


def _trial(
    arm: Arm,
    stretches: tuple[Stretch, ...],
    around: Estimate | None,
    motor_share: float = MOTOR_SHARE,
    loads: Loads | None = None,
) -> _Trial:
    """Fit at one bandwidth: parameters, compliances and weights in turn until nothing moves."""
    equations = assemble(arm, stretches, around, loads)
    if not len(equations.target):
        raise NotIdentifiable("every sample is at an edge or in saturation; record for longer")
    root = ls.first_weights(equations.target, equations.group)
    last = np.zeros(len(arm.rigid_columns))
    for rounds in range(_ROUNDS):
        factor = ls.factorise(equations, root)
        before = factor.value if around is None else around.solution
        change = factor.value - before
        moved = np.abs(change)
        known = factor.deviation > 0.0  # others stay where they are
        step = np.divide(change, factor.deviation, out=np.zeros_like(change), where=known)
        settled = rounds > 1 and np.all(moved <= _CONVERGED * factor.deviation)
        found = estimate_of(arm, stretches, equations, factor, motor_share)
        if around is not None and step @ last < 0.0 and not settled:  # to and fro
            found = halfway(around, found)
        around, last = found, step
        if settled:
            break
        root = ls.root_weights(equations, factor)
        equations = assemble(arm, stretches, around, loads)
    covariance, compliance_variance = ls.jackknife(equations, factor)
    identified = ls.determined(equations, factor, covariance) & _shows_friction(arm, stretches)
    deviation = np.sqrt(np.clip(np.diag(covariance), 1e-300, None))
    assert around is not None
    return _Trial(
        stretches=stretches,
        estimate=around,
        compliance_deviation=np.sqrt(compliance_variance),
        equations=equations,
        factor=factor,
        covariance=covariance,
        determined=identified,
        last_move=float(np.max((moved / deviation)[identified], initial=0.0)),
    )


def _shows_friction(arm: Arm, stretches: Sequence[Stretch]) -> BoolArray:
    """False for Coulomb friction and offset of a joint that never slides both ways.

    What little its edges seem to say of them is the prior on friction at standstill, not data.
    """
    identified = np.ones(len(arm.rigid_columns), dtype=bool)
    for k, column in enumerate(arm.rigid_columns):
        if column.joint is not None and column.name in (
            "motor_coulomb_friction",
            "friction_offset",
        ):
            ways = {
                sign
                for s in stretches
                for sign in np.unique(s.signals.direction[:, column.joint - 1])
            }
            identified[k] = {-1.0, 1.0} <= ways
    return identified


def _elastic_remainder(arm: Arm, best: _Trial) -> FloatArray:
    """Variance from what the first order of elasticity leaves out.

    Two things: the motor's share of the first inertia, taken as one half, is changed to what is
    about a standard deviation away; and the next order in (w / w_a)^2 is taken to move the
    parameters by what the first order did, times (bandwidth / anti-resonance)^2.

    Returns: (n_parameters,).
    """
    ratio = best.bandwidth_hz / float(np.min(anti_resonances(arm, best.estimate)))
    if ratio == 0.0:
        return np.zeros(len(best.covariance))
    here = best.estimate.solution
    stiff = arm.behind_rigid_gears()
    rigid, other = side_by_side(
        [
            partial(_trial, stiff, best.stretches, best.estimate),
            partial(_trial, arm, best.stretches, best.estimate, OTHER_SHARE),
        ]
    )
    next_order = (here - rigid.estimate.solution) * ratio**2
    return np.asarray(next_order**2 + (here - other.estimate.solution) ** 2)


def _choose(trials: Sequence[_Trial], arm: Arm) -> _Trial:
    """The bandwidth at which no parameter is much less certain than it might be.

    The regret of a bandwidth is the largest ratio of a deviation there to that parameter's least.
    Behind elastic gears the lowest of the good bandwidths is taken, because what the model leaves
    out shows at high frequencies first.
    """
    spread = np.array([trial.spread for trial in trials])
    least = spread.min(axis=0)
    identified = np.isfinite(least)
    regret = np.max(spread[:, identified] - least[identified], axis=1, initial=0.0)
    if not any(joint.elastic for joint in arm.joints):
        return trials[int(np.argmin(regret))]
    return trials[int(np.argmax(regret <= regret.min() + _GAIN))]


def _neighbours(trials: Sequence[_Trial], best: _Trial) -> list[_Trial]:
    return [
        t for t in trials if t is not best and 0.45 <= t.bandwidth_hz / best.bandwidth_hz <= 2.1
    ]


def _scatter(trials: Sequence[_Trial], best: _Trial) -> FloatArray:
    """Variance from model error that shows as dependence on the bandwidth.

    Were the model exact, every bandwidth would give the same values within their deviations; what
    the neighbours, within a factor of about two, differ by beyond those is what it lacks. The
    median, because a trial at a low bandwidth may see too little to be any guide.

    Returns: (n_parameters,).
    """
    excess = [
        np.clip(
            (t.estimate.solution - best.estimate.solution) ** 2 - np.diag(t.covariance), 0.0, None
        )
        for t in _neighbours(trials, best)
    ]
    return np.median(excess, axis=0) if excess else np.zeros(len(best.covariance))


def _model(
    arm: Arm, best: _Trial, covariance: FloatArray, shares: tuple[Parameter, ...]
) -> RigidModel:
    """The record of a fit: what was not identified becomes None."""
    columns = arm.rigid_columns
    identified = best.determined
    deviation = np.sqrt(np.diag(covariance))
    n_blocks = len(np.unique(best.equations.block))
    reach = _student(n_blocks - 1)
    parameters = []
    for k, column in enumerate(columns):
        value, std = float(best.estimate.solution[k]), float(deviation[k])
        parameters.append(
            Parameter(
                name=column.name,
                joint=column.joint,
                value=value if identified[k] else None,
                std=std if identified[k] else None,
                unit=column.unit,
                stage="rigid",
                ci95=(value - reach * std, value + reach * std) if identified[k] else None,
            )
        )
    status: Literal["determined", "partly-determined", "not-identifiable"] = "not-identifiable"
    if identified.any():
        status = "determined" if identified.all() else "partly-determined"
    unknown = np.where(identified, 1.0, np.nan)
    return RigidModel(
        parameters=tuple(parameters),
        solution=best.estimate.solution,
        covariance=covariance * np.outer(unknown, unknown),
        condition_number=best.factor.condition_number,
        fit_percent={
            s.signals.experiment.name: _fits(arm, best, s, shares) for s in best.stretches
        },
        bandwidth_hz=best.bandwidth_hz,
        decimation=max(
            decimation(s.signals.sample_time, best.bandwidth_hz) for s in best.stretches
        ),
        n_rows=len(best.equations.target),
        status=status,
        warnings=(*_warnings(arm, best), *(_load_warning(share) for share in shares)),
        load_friction=shares,
    )


def _student(degrees: int) -> float:
    """Half width of a 95 % interval in deviations, for a deviation from so many differences."""
    return student_quantile(0.975, max(1, degrees))


def _fits(
    arm: Arm, best: _Trial, stretch: Stretch, shares: tuple[Parameter, ...]
) -> dict[str, float]:
    """Fit of each torque of a fitted record, within the model's band."""
    solution, band = best.estimate.solution, best.bandwidth_hz
    fits = band_fit(arm, solution, stretch.signals, band, shares)
    return dict(zip(stretch.signals.torque_channel, fits.tolist(), strict=True))


def _warnings(arm: Arm, best: _Trial) -> Iterator[Diagnostic]:
    """What the reader must know: unknowns not identified, motors that stand, motion too fast."""
    columns = arm.rigid_columns
    names = ", ".join(s.signals.experiment.name for s in best.stretches)
    for k, column in enumerate(columns):
        if not best.determined[k]:
            yield Diagnostic("not-identifiable", str(column), _why(arm, best, k))
    for stretch in best.stretches:
        stands = (stretch.signals.direction == 0.0).mean(axis=0)
        for i, share in enumerate(stands):
            if share > _MUCH_STANDING:
                text = f"motor {i + 1} may stand for {100.0 * share:.0f} % of the record, which"
                text += (
                    " then carries no information on its friction; move faster, reverse less often"
                )
                yield Diagnostic("standing", stretch.signals.experiment.name, text)
    if best.factor.condition_number > _POOR and best.determined.all():
        weak = np.abs(best.factor.directions[-1])
        involved = ", ".join(str(columns[k]) for k in np.flatnonzero(weak > 0.3))
        text = f"condition number {best.factor.condition_number:.0f}: the records hardly separate"
        yield Diagnostic("poor-excitation", names, f"{text} {involved}; {_REMEDY}")
    for k in _impossible(arm, best):
        text = (
            f"{best.estimate.solution[k]:.3g} {columns[k].unit} is negative beyond its uncertainty:"
        )
        text += (
            " the records show something that a rigid arm with Coulomb and viscous friction is not"
        )
        yield Diagnostic("implausible", str(columns[k]), text)
    if best.last_move > _UNSETTLED:
        text = f"after {_ROUNDS} rounds a parameter still moves by {best.last_move:.1f} standard"
        text += " deviations; record a longer or livelier motion"
        yield Diagnostic("not-settled", names, text)
    limit = _surely_elastic(arm, best)
    if best.bandwidth_hz > limit:
        text = f"the gears' compliance shows at {_BELOW_RESONANCE * limit:.1f} Hz, too near to the"
        text += f" motion's {best.bandwidth_hz:.1f} Hz for a rigid model; move more slowly"
        yield Diagnostic("not-rigid", names, text)


def _why(arm: Arm, best: _Trial, unknown: int) -> str:
    """Why one parameter could not be identified, and what to record."""
    columns = arm.rigid_columns
    column = columns[unknown]
    joint = column.joint
    moving = [s.signals.direction for s in best.stretches]
    if joint is not None:
        directions = np.concatenate([d[:, joint - 1] for d in moving])
        if not np.any(directions):
            return f"joint {joint} does not move; record a motion in which it does"
        one_way = not (np.any(directions > 0.0) and np.any(directions < 0.0))
        if one_way and column.name in ("motor_coulomb_friction", "friction_offset"):
            text = f"joint {joint} moves in one direction only, so that Coulomb friction and offset"
            return f"{text} are not separately identifiable; record motion in both directions"
    still = [str(i + 1) for i in range(arm.n_joints) if not any(np.any(d[:, i]) for d in moving)]
    if still:
        return f"joint {', '.join(still)} does not move; {_REMEDY}"
    others = [str(columns[k]) for k in _companions(best, unknown)]
    if others:
        return f"these records cannot separate it from {', '.join(others)}; {_REMEDY}"
    return f"these records hardly depend on it; {_REMEDY}"


def _companions(best: _Trial, unknown: int) -> list[int]:
    """Unknowns that may trade against one without the data noticing."""
    return [k for k in ls.companions(best.factor, unknown) if not best.determined[k]]
