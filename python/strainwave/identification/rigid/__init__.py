"""Rigid step: identify the arm with rigid joints (5)-(7) by weighted least squares.

The equations of motion are linear in the parameters. They are low-passed to a bandwidth selected
from the data, weighted per joint, and solved together with nuisance parameters for stiction and
gear compliance; see `equations`. The covariance comes from a block jackknife and from the change of
the estimates with the bandwidth.
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
    Place,
    RigidModel,
    RigidOptions,
    Signals,
)
from strainwave.domain.distributions import student_quantile
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
    average_estimates,
    convert_estimate,
    decimation,
    estimate_of,
    n_compliances,
    prepare,
)
from strainwave.identification.rigid.repetition import period_of
from strainwave.identification.rigid.torque_constants import TorqueRatio, torque_ratio
from strainwave.numerics import least_squares as ls
from strainwave.numerics.parallel import one_blas_thread, run_parallel

__all__ = ["ALTERNATIVE_MOTOR_SHARE", "RigidOptions", "fit"]

_ROUNDS = 20  # maximum number of iterations
# change in standard deviations for white errors, which are smaller than those of the jackknife
_TOLERANCE = 0.02
_BANDWIDTH_RATIO = 2.0**0.5  # ratio of successive bandwidths; squared if no gear is elastic
# log of a significant ratio of standard deviations, the accuracy of the jackknife
_MIN_LOG_GAIN = np.log(1.1)
_MAX_LAST_CHANGE = 0.5  # last change in standard deviations above which the fit has not converged
# share of the torque above which a fit is uncertain; 1e-4 to 1e-3 with enough motion in the band
_MAX_UNCERTAIN_TORQUE_SHARE = 0.003
# minimum rows of one joint per block: half a period of the cut-off, the correlation time of errors
_MIN_ROWS_PER_BLOCK = 2.0
_MAX_BANDWIDTHS_WITHOUT_GAIN = (
    3  # number of successive bandwidths without improvement that ends the search
)
# significance of load-dependent friction in standard deviations: 1e-4 false alarms
_MIN_LOAD_FRICTION_STDS = 4.0
_MIN_LOAD_FRICTION = 0.01  # of the load; smaller shares are below the error of the torque constant
ALTERNATIVE_MOTOR_SHARE = 0.3  # alternative to MOTOR_SHARE, about one standard deviation away
_MAX_STICTION_SHARE = 0.3  # share of a record in possible stiction that causes a warning
_MAX_CONDITION_NUMBER = 300.0  # condition number that causes a warning; good motion gives 10 to 50
_REMEDY = "record both joints moving together, in both directions, at varied speeds and postures"
# minimum ratio of anti-resonance to bandwidth for the first-order compliance model
_RESONANCE_RATIO = 3.0


_Motion = tuple[Signals, float]  # signals and their period in samples


@dataclass(frozen=True, slots=True)
class _Trial:
    """Fit at one bandwidth."""

    stretches: tuple[Stretch, ...]  # one per record
    estimate: Estimate
    compliance_deviation: FloatArray
    equations: ls.Equations
    factor: ls.Factor
    covariance: FloatArray
    determined: BoolArray
    last_move: float  # largest change in the last iteration, in standard deviations

    @property
    def bandwidth_hz(self) -> float:
        """Bandwidth [Hz] of the equations' filter."""
        return self.stretches[0].bandwidth_hz

    @property
    def spread(self) -> FloatArray:
        """Log of the standard deviations; infinite for parameters that are not determined."""
        standard_deviations = np.sqrt(np.clip(np.diag(self.covariance), 1e-300, None))
        return np.where(self.determined, np.log(standard_deviations), np.inf)

    @property
    def vagueness(self) -> float:
        """Largest torque of one standard deviation of a parameter, as a share of the torque."""
        standard_deviations = np.sqrt(np.clip(np.diag(self.covariance), 0.0, None))
        torque = float(np.linalg.norm(self.factor.root * self.equations.target))
        return float(np.max(standard_deviations * self.factor.scale)) / torque


def fit(signals: Sequence[Signals], arm: Arm, options: RigidOptions | None = None) -> RigidModel:
    """Identify the rigid-joint arm from motion records.

    `signals` has one item per record, from `signals.prepare_motor_signals`. A parameter that the
    data do not determine has the value None, and a warning gives the reason. Raises
    `NotIdentifiable` if there is no record or no usable sample.
    """
    if not signals:
        raise NotIdentifiable(
            'the rigid step needs a record with use = "motion": slow, smooth motion of all joints'
        )
    with one_blas_thread():  # hundreds of small factorisations: several threads are slower
        return _fit(signals, arm, options or RigidOptions())


def _fit(signals: Sequence[Signals], arm: Arm, chosen: RigidOptions) -> RigidModel:
    motions = [(s, period_of(s)) for s in signals]
    if chosen.bandwidth_hz is not None:
        trials = [_trial(arm, _prepare(arm, motions, chosen.bandwidth_hz), None)]
    else:
        trials = _search(motions, arm)
    best = _select_bandwidth(trials, arm)
    loaded_joints = _load_dependent_joints(arm, best, chosen.load_friction)
    if loaded_joints:
        neighbours = [best, *_neighbours(trials, best)]
        best, *neighbours = trials = [
            _refit_with_loads(arm, trial, loaded_joints) for trial in neighbours
        ]
    model_error = _bandwidth_model_error(trials, best) + _elastic_model_error(arm, best)
    covariance = best.covariance + np.diag(model_error)
    model = _model(arm, best, covariance, _load_friction(trials, best, loaded_joints))
    return replace(model, torque_ratio=_torque_ratio(arm, trials, best))


def _load_dependent_joints(arm: Arm, best: _Trial, wanted: bool | None) -> list[int]:
    """Joints, from 0, whose friction increases with the load.

    All joints if `wanted` is True. Otherwise those with a significant share whose other parameters
    are physically possible: a share together with negative friction indicates another cause. Empty
    for arms with elastic gears: their load is not known accurately enough, and the whole-arm fit
    estimates the friction.
    """
    joints = list(range(arm.n_joints))
    if n_compliances(arm) or wanted is False or not best.determined.all():
        return []
    if wanted:
        return joints
    loads = Loads.of(joints, best.stretches)
    first_solution = ls.factorise(
        assemble(arm, best.stretches, best.estimate, loads), best.factor.root
    )
    # one solve excludes most arms; iteration takes many times as long
    if np.all(first_solution.common <= _MIN_LOAD_FRICTION):
        return []
    trial = _refit_with_loads(arm, best, joints)
    share, friction_std = trial.factor.common, trial.compliance_deviation
    implausible = {arm.rigid_columns[k].joint for k in _implausible_parameters(arm, trial)}
    return [
        k
        for k in joints
        if share[k] > max(_MIN_LOAD_FRICTION, _MIN_LOAD_FRICTION_STDS * friction_std[k])
        and k + 1 not in implausible
    ]


def _implausible_parameters(arm: Arm, trial: _Trial) -> list[int]:
    """Parameters that are significantly negative although they must be positive."""
    return [
        k
        for k, column in enumerate(arm.rigid_columns)
        if trial.determined[k]
        and not column.name.startswith(("gravity", "friction_offset"))
        and trial.estimate.solution[k] + 2.0 * np.sqrt(trial.covariance[k, k]) < 0.0
    ]


def _refit_with_loads(arm: Arm, trial: _Trial, joints: Sequence[int]) -> _Trial:
    """Fit at the same bandwidth with load-dependent friction of some joints."""
    loads = Loads.of(joints, trial.stretches)
    return _trial(arm, trial.stretches, trial.estimate, loads=loads)


def _load_friction(
    trials: Sequence[_Trial], best: _Trial, joints: Sequence[int]
) -> tuple[Parameter, ...]:
    """Load friction of the joints.

    The standard deviations include the scatter between neighbouring bandwidths.
    """
    parameters = []
    for k, joint in enumerate(joints):
        share, variance = float(best.factor.common[k]), float(best.compliance_deviation[k]) ** 2
        squared_changes = [(t.factor.common[k] - share) ** 2 for t in _neighbours(trials, best)]
        std = float(
            np.sqrt(
                variance
                + (max(0.0, np.median(squared_changes) - variance) if squared_changes else 0.0)
            )
        )
        half_width = _interval_half_width(len(np.unique(best.equations.block)) - 1) * std
        interval = (share - half_width, share + half_width)
        parameters.append(Parameter("load_friction", joint + 1, share, std, "1", "rigid", interval))
    return tuple(parameters)


def _load_warning(share: Parameter) -> Diagnostic:
    """Warn about friction that depends on the load."""
    message = (
        f"friction increases by {share.value:.3f} +- {share.std:.3f} of the load. Predictions of"
    )
    message += " the rigid model include this; simulations and exports do not"
    return Diagnostic("load-friction", f"joint {share.joint}", message)


def _torque_ratio(arm: Arm, trials: Sequence[_Trial], best: _Trial) -> tuple[float, float] | None:
    """Estimated ratio of the torque constants of joints 1 and 2, relative to the study.

    Returned with its standard deviation, which includes the scatter between neighbouring
    bandwidths.
    """
    estimate = _torque_ratio_at(arm, best)
    if estimate is None:  # not determined by the motion in any band
        return None
    others = [_torque_ratio_at(arm, t) for t in _neighbours(trials, best)]
    excess = [
        max(0.0, (other.value - estimate.value) ** 2 - other.variance)
        for other in others
        if other is not None
    ]
    variance = estimate.variance + (float(np.median(excess)) if excess else 0.0)
    return 1.0 / estimate.value, float(np.sqrt(variance)) / estimate.value**2


def _torque_ratio_at(arm: Arm, trial: _Trial) -> TorqueRatio | None:
    # the common unknowns are compliances, then load shares; only compliances are linearised
    n, n_common = n_compliances(arm), trial.equations.common.shape[1]
    compliance = np.pad(trial.estimate.compliance[:n], (0, n_common - n))
    return torque_ratio(arm, trial.equations, trial.factor.root, compliance)


def _search(motions: Sequence[_Motion], arm: Arm) -> list[_Trial]:
    """Fit at increasing bandwidths while the estimates improve and the gears are nearly rigid."""
    trials: list[_Trial] = []
    least_spread, n_without_gain = np.full(len(arm.rigid_columns), np.inf), 0
    is_rigid = n_compliances(arm) == 0
    for bandwidth in _bandwidths(motions, _BANDWIDTH_RATIO ** (2 if is_rigid else 1)):
        limits = [_max_rigid_bandwidth(arm, trial) for trial in trials[-2:]]
        if len(limits) > 1 and bandwidth > max(limits):  # a single trial may be unreliable
            break
        stretches = _prepare(arm, motions, bandwidth)
        start = (
            convert_estimate(trials[-1].estimate, trials[-1].stretches, stretches)
            if trials
            else None
        )
        trial = _trial(arm, stretches, start)
        trials.append(trial)
        has_improved = bool(np.any(trial.spread < least_spread - _MIN_LOG_GAIN))
        n_without_gain = 0 if has_improved else n_without_gain + 1
        least_spread = np.minimum(least_spread, trial.spread)
        if n_without_gain >= _MAX_BANDWIDTHS_WITHOUT_GAIN:
            break
    return trials


def _max_rigid_bandwidth(arm: Arm, trial: _Trial) -> float:
    """Bandwidth [Hz] above which the first-order compliance model is not valid.

    Infinite if the trial is uncertain: at low bandwidths a parameter may be poorly determined, and
    its effect may be attributed to compliance. If the blocks are shorter than the correlation time
    of the errors, the standard deviations are unreliable.
    """
    blocks = len(np.unique(trial.equations.block)) * arm.n_joints
    is_uncertain = (
        trial.vagueness > _MAX_UNCERTAIN_TORQUE_SHARE
        or len(trial.equations.target) < _MIN_ROWS_PER_BLOCK * blocks
    )
    if not n_compliances(arm) or is_uncertain:
        return np.inf
    compliance = np.clip(trial.estimate.compliance - 2.0 * trial.compliance_deviation, 0.0, None)
    lower_bound = replace(trial.estimate, compliance=compliance)
    return float(np.min(anti_resonances(arm, lower_bound))) / _RESONANCE_RATIO


def _bandwidths(motions: Sequence[_Motion], step: float) -> Iterator[float]:
    """Yield bandwidths from that of 90 % of the motion's power to half the signals' bandwidth."""
    top = min(s.bandwidth_hz or 0.5 / s.sample_time for s, _ in motions) / 2.0
    shortest = min(period * s.sample_time for s, period in motions)
    bandwidth = max([8.0 / shortest, *(_motion_band(s) for s, _ in motions)])
    bandwidth = min(bandwidth, top)
    while bandwidth <= top:
        yield bandwidth
        bandwidth *= step


def _motion_band(signals: Signals) -> float:
    """Frequency [Hz] below which 90 % of the power of each velocity lies."""
    highest = 0.0
    count = len(signals.time)
    frequency = np.fft.rfftfreq(count, signals.sample_time)
    centred_index = np.arange(count) - 0.5 * (count - 1)
    for velocity in signals.motor_velocity.T:
        detrended = velocity - velocity.mean()
        detrended -= centred_index * (centred_index @ detrended / (centred_index @ centred_index))
        cumulative_power = np.cumsum(np.abs(np.fft.rfft(detrended)) ** 2)
        if cumulative_power[-1] > 0.0:
            highest = max(
                highest,
                float(frequency[np.searchsorted(cumulative_power, 0.9 * cumulative_power[-1])]),
            )
    return highest


def _prepare(arm: Arm, motions: Sequence[_Motion], bandwidth_hz: float) -> tuple[Stretch, ...]:
    return tuple(prepare(arm, s, bandwidth_hz, period) for s, period in motions)


def _trial(
    arm: Arm,
    stretches: tuple[Stretch, ...],
    around: Estimate | None,
    motor_share: float = MOTOR_SHARE,
    loads: Loads | None = None,
) -> _Trial:
    """Fit at one bandwidth: iterate parameters, compliances and weights to convergence."""
    equations = assemble(arm, stretches, around, loads)
    if not len(equations.target):
        raise NotIdentifiable("every sample is at an edge or in saturation; record for longer")
    root = ls.initial_weights(equations.target, equations.group)
    last_step = np.zeros(len(arm.rigid_columns))
    for iteration in range(_ROUNDS):
        factor = ls.factorise(equations, root)
        previous = factor.value if around is None else around.solution
        change = factor.value - previous
        change_size = np.abs(change)
        known = factor.deviation > 0.0  # other parameters do not change
        step = np.divide(change, factor.deviation, out=np.zeros_like(change), where=known)
        has_converged = iteration > 1 and np.all(change_size <= _TOLERANCE * factor.deviation)
        estimate = estimate_of(arm, stretches, equations, factor, motor_share)
        if around is not None and step @ last_step < 0.0 and not has_converged:  # oscillates
            estimate = average_estimates(around, estimate)
        around, last_step = estimate, step
        if has_converged:
            break
        root = ls.root_weights(equations, factor)
        equations = assemble(arm, stretches, around, loads)
    covariance, compliance_variance = ls.jackknife(equations, factor)
    identified = ls.determined(equations, factor, covariance) & _determines_friction(arm, stretches)
    standard_deviations = np.sqrt(np.clip(np.diag(covariance), 1e-300, None))
    assert around is not None
    return _Trial(
        stretches=stretches,
        estimate=around,
        compliance_deviation=np.sqrt(compliance_variance),
        equations=equations,
        factor=factor,
        covariance=covariance,
        determined=identified,
        last_move=float(np.max((change_size / standard_deviations)[identified], initial=0.0)),
    )


def _determines_friction(arm: Arm, stretches: Sequence[Stretch]) -> BoolArray:
    """False for Coulomb friction and offset of a joint that never slides in both directions.

    The apparent information on them comes from the prior of the stiction torque, not from data.
    """
    identified = np.ones(len(arm.rigid_columns), dtype=bool)
    for k, column in enumerate(arm.rigid_columns):
        if column.joint is not None and column.name in (
            "motor_coulomb_friction",
            "friction_offset",
        ):
            signs = {
                sign
                for s in stretches
                for sign in np.unique(s.signals.direction[:, column.joint - 1])
            }
            identified[k] = {-1.0, 1.0} <= signs
    return identified


def _elastic_model_error(arm: Arm, best: _Trial) -> FloatArray:
    """Variance (n_parameters,) of the error of the first-order compliance model.

    It has two parts: the change of the estimates with the motor's share of the first inertia, from
    one half to about one standard deviation away; and the second-order term in (w / w_a)^2,
    estimated as the first-order change times (bandwidth / anti-resonance)^2.
    """
    ratio = best.bandwidth_hz / float(np.min(anti_resonances(arm, best.estimate)))
    if ratio == 0.0:
        return np.zeros(len(best.covariance))
    solution = best.estimate.solution
    rigid_arm = arm.behind_rigid_gears()
    rigid_trial, other_share_trial = run_parallel(
        [
            partial(_trial, rigid_arm, best.stretches, best.estimate),
            partial(_trial, arm, best.stretches, best.estimate, ALTERNATIVE_MOTOR_SHARE),
        ]
    )
    next_order = (solution - rigid_trial.estimate.solution) * ratio**2
    return np.asarray(next_order**2 + (solution - other_share_trial.estimate.solution) ** 2)


def _select_bandwidth(trials: Sequence[_Trial], arm: Arm) -> _Trial:
    """Select the bandwidth at which all standard deviations are close to their minimum.

    The regret of a bandwidth is the largest ratio of a standard deviation to its minimum over the
    bandwidths. For elastic gears, the lowest bandwidth with a small regret is selected, because
    model error is largest at high frequencies.
    """
    spread = np.array([trial.spread for trial in trials])
    least_spread = spread.min(axis=0)
    identified = np.isfinite(least_spread)
    regret = np.max(spread[:, identified] - least_spread[identified], axis=1, initial=0.0)
    if not any(joint.elastic for joint in arm.joints):
        return trials[int(np.argmin(regret))]
    return trials[int(np.argmax(regret <= regret.min() + _MIN_LOG_GAIN))]


def _neighbours(trials: Sequence[_Trial], best: _Trial) -> list[_Trial]:
    return [
        t for t in trials if t is not best and 0.45 <= t.bandwidth_hz / best.bandwidth_hz <= 2.1
    ]


def _bandwidth_model_error(trials: Sequence[_Trial], best: _Trial) -> FloatArray:
    """Variance (n_parameters,) of the model error, from the change with the bandwidth.

    With an exact model, the estimates at all bandwidths agree within their standard deviations. The
    excess is the median over neighbouring bandwidths, which is insensitive to uncertain trials at
    low bandwidths.
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
    """Result of a fit; parameters that are not identified are None."""
    columns = arm.rigid_columns
    identified = best.determined
    standard_deviations = np.sqrt(np.diag(covariance))
    n_blocks = len(np.unique(best.equations.block))
    half_width = _interval_half_width(n_blocks - 1)
    parameters = []
    for k, column in enumerate(columns):
        value, std = float(best.estimate.solution[k]), float(standard_deviations[k])
        parameters.append(
            Parameter(
                name=column.name,
                joint=column.joint,
                value=value if identified[k] else None,
                std=std if identified[k] else None,
                unit=column.unit,
                stage="rigid",
                ci95=(value - half_width * std, value + half_width * std)
                if identified[k]
                else None,
            )
        )
    status: Literal["determined", "partly-determined", "not-identifiable"] = "not-identifiable"
    if identified.any():
        status = "determined" if identified.all() else "partly-determined"
    mask = np.where(identified, 1.0, np.nan)
    return RigidModel(
        parameters=tuple(parameters),
        solution=best.estimate.solution,
        covariance=covariance * np.outer(mask, mask),
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


def _interval_half_width(degrees: int) -> float:
    """Half-width of a 95 % interval in standard deviations, for `degrees` degrees of freedom."""
    return student_quantile(0.975, max(1, degrees))


def _fits(
    arm: Arm, best: _Trial, stretch: Stretch, shares: tuple[Parameter, ...]
) -> dict[str, float]:
    """Fit in percent of each torque of a fitted record, within the model's band."""
    solution, band = best.estimate.solution, best.bandwidth_hz
    fits = band_fit(arm, solution, stretch.signals, band, shares)
    return dict(zip(stretch.signals.torque_channel, fits.tolist(), strict=True))


def _warnings(arm: Arm, best: _Trial) -> Iterator[Diagnostic]:
    """Warnings on unidentified parameters, stiction, excitation, convergence and elasticity."""
    columns = arm.rigid_columns
    records = Place.in_records(*(s.signals.experiment.name for s in best.stretches))
    for k, column in enumerate(columns):
        if not best.determined[k]:
            place = Place(joint=column.joint, parameter=column.name)
            yield Diagnostic.at("not-identifiable", place, _reason(arm, best, k))
    for stretch in best.stretches:
        stiction_shares = (stretch.signals.direction == 0.0).mean(axis=0)
        for i, share in enumerate(stiction_shares):
            if share > _MAX_STICTION_SHARE:
                message = (
                    f"motor {i + 1} may stick in {100.0 * share:.0f} % of the record; these samples"
                )
                message += (
                    " contain no information on its friction; move faster and reverse less often"
                )
                place = Place.in_records(stretch.signals.experiment.name)
                yield Diagnostic.at("standing", place, message)
    if best.factor.condition_number > _MAX_CONDITION_NUMBER and best.determined.all():
        weakest_direction = np.abs(best.factor.directions[-1])
        names_involved = ", ".join(str(columns[k]) for k in np.flatnonzero(weakest_direction > 0.3))
        message = (
            f"condition number {best.factor.condition_number:.0f}: the records poorly separate"
        )
        yield Diagnostic.at("poor-excitation", records, f"{message} {names_involved}; {_REMEDY}")
    for k in _implausible_parameters(arm, best):
        message = (
            f"{best.estimate.solution[k]:.3g} {columns[k].unit} is negative beyond its uncertainty:"
        )
        message += " the data contradict a rigid arm with Coulomb and viscous friction"
        place = Place(joint=columns[k].joint, parameter=columns[k].name)
        yield Diagnostic.at("implausible", place, message)
    if best.last_move > _MAX_LAST_CHANGE:
        message = f"after {_ROUNDS} iterations a parameter still changes by {best.last_move:.1f}"
        message += " standard deviations; record a longer or more varied motion"
        yield Diagnostic.at("not-settled", records, message)
    limit = _max_rigid_bandwidth(arm, best)
    if best.bandwidth_hz > limit:
        message = (
            f"the anti-resonance at {_RESONANCE_RATIO * limit:.1f} Hz is too close to the motion"
        )
        message += f" band of {best.bandwidth_hz:.1f} Hz for a rigid model; move more slowly"
        yield Diagnostic.at("not-rigid", records, message)


def _reason(arm: Arm, best: _Trial, unknown: int) -> str:
    """Reason why one parameter is not identifiable, and what to record."""
    columns = arm.rigid_columns
    column = columns[unknown]
    joint = column.joint
    motion_directions = [s.signals.direction for s in best.stretches]
    if joint is not None:
        directions = np.concatenate([d[:, joint - 1] for d in motion_directions])
        if not np.any(directions):
            return f"joint {joint} does not move; record a motion in which it does"
        one_way = not (np.any(directions > 0.0) and np.any(directions < 0.0))
        if one_way and column.name in ("motor_coulomb_friction", "friction_offset"):
            message = (
                f"joint {joint} moves in one direction only, so that Coulomb friction and offset"
            )
            return f"{message} are not separately identifiable; record motion in both directions"
    joints_at_rest = [
        str(i + 1)
        for i in range(arm.n_joints)
        if not any(np.any(d[:, i]) for d in motion_directions)
    ]
    if joints_at_rest:
        return f"joint {', '.join(joints_at_rest)} does not move; {_REMEDY}"
    others = [str(columns[k]) for k in _companions(best, unknown)]
    if others:
        return f"these records cannot separate it from {', '.join(others)}; {_REMEDY}"
    return f"these records contain too little information on it; {_REMEDY}"


def _companions(best: _Trial, unknown: int) -> list[int]:
    """Unidentified parameters that compensate for another without a change of the residuals."""
    return [k for k in ls.companions(best.factor, unknown) if not best.determined[k]]
