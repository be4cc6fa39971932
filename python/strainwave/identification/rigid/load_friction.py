"""Friction that increases with the load of a joint."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from strainwave.domain import Diagnostic, Parameter, Place
from strainwave.identification.rigid.bandwidth import excess_variance, neighbours
from strainwave.identification.rigid.equations import Loads, assemble
from strainwave.identification.rigid.stretch import n_compliances
from strainwave.identification.rigid.trial import Trial
from strainwave.numerics import least_squares as ls

# significance of load-dependent friction in standard deviations: 1e-4 false alarms
_MIN_LOAD_FRICTION_STDS = 4.0
_MIN_LOAD_FRICTION = 0.01  # of the load; smaller shares are below the error of the torque constant


def load_dependent_joints(best: Trial, wanted: bool | None) -> list[int]:
    """Joints, from 0, whose friction increases with the load.

    All joints if `wanted` is True. Otherwise those with a significant share whose other parameters
    are physically possible: a share together with negative friction indicates another cause. Empty
    for arms with elastic gears: their load is not known accurately enough, and the whole-arm fit
    estimates the friction.
    """
    arm = best.arm
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
    trial = best.refit_with_loads(joints)
    share, friction_std = trial.factor.common, trial.common_deviation
    implausible = {arm.rigid_columns[k].joint for k in trial.implausible}
    return [
        k
        for k in joints
        if share[k] > max(_MIN_LOAD_FRICTION, _MIN_LOAD_FRICTION_STDS * friction_std[k])
        and k + 1 not in implausible
    ]


def load_friction(
    trials: Sequence[Trial], best: Trial, joints: Sequence[int]
) -> tuple[Parameter, ...]:
    """Load friction of the joints.

    The standard deviations include the scatter between neighbouring bandwidths.
    """
    n = len(joints)
    values = best.factor.common[:n]
    nearby = neighbours(trials, best)
    others = [(t.factor.common[:n], t.common_deviation[:n] ** 2) for t in nearby]
    stds = np.sqrt(best.common_deviation[:n] ** 2 + excess_variance(values, others))
    width = best.interval_half_width
    return tuple(
        Parameter.estimated(("load_friction", joint + 1), share, std, "1", "rigid", width)
        for joint, share, std in zip(joints, values.tolist(), stds.tolist(), strict=True)
    )


def load_warning(share: Parameter) -> Diagnostic:
    """Warn about friction that depends on the load."""
    place = Place(joint=share.joint)
    return Diagnostic("load-friction", place, share=share.value, std=share.std)
