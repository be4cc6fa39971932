"""Fine tuning as published: least squares on the link velocities of steps in closed loop.

The source compares the velocity steps of the arm with those of its simulation under the same servo
(Fig. 7). Here both pass the same sensors and the same fusion (10), so that the error of the fusion
cancels. There is no prior, and the only weight of a record is the size of its step.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from strainwave.domain import FloatArray, Log, SearchEnd, WholeArmOptions
from strainwave.domain.arm.parameter_table import COULOMB, OFFSET
from strainwave.dynamics.arm import Arm
from strainwave.errors import NotIdentifiable
from strainwave.identification.whole_arm.records.dataset import Dataset
from strainwave.identification.whole_arm.search.fit import Fit
from strainwave.numerics.parallel import run_parallel
from strainwave.signals.link_motion import prepare_link_signals
from strainwave.signals.recorded_input import missing_recorded_input

_TOLERANCE = 1e-4  # relative change of the cost or of the coordinates at which the search ends
_DIFFERENCE_STEP = 1e-3  # of a coordinate, the logarithm of a positive parameter
_ROWS_PER_PERIOD = 8  # of the cut-off; closer samples have no further information


def expand_published_options(options: WholeArmOptions) -> WholeArmOptions:
    """Expand the option `as_published` into the options that it implies."""
    if not options.as_published:
        return options
    return replace(
        options,
        closed_loop=True,
        settling=bool(options.settling),
        hold=tuple(dict.fromkeys((*options.hold, COULOMB, OFFSET))),
    )


def published_records(logs: Sequence[Log], arm: Arm) -> list[Log]:
    """Select the records of the published tuning method: steps in closed loop.

    `logs` have the motor signals that a simulation needs. Raises `NotIdentifiable` if none has
    use = "tuning", or if one lacks data for a closed-loop simulation.
    """
    selected = [log for log in logs if log.experiment.use == "tuning" and not log.is_continuation]
    if not selected:
        raise NotIdentifiable(
            'tuning as published needs records with use = "tuning": steps under servo'
        )
    for log in selected:
        missing = missing_recorded_input(arm, log)
        if missing is not None:
            raise NotIdentifiable(
                f"tuning as published simulates {log.name} in closed loop, but {missing}: add the "
                "missing data, or set tuning.as_published = false"
            )
    return selected


def published_search(start: Fit, records: Sequence[Dataset], arm: Arm, budget: int) -> Fit:
    """Minimise the squared differences of link velocities within the ranges of the unknowns.

    `arm` has the sensors of `records`; of a record with an excited joint that of its link is
    compared. `budget` is the maximum number of evaluations of the derivatives.
    """
    from scipy.optimize import least_squares

    space = start.space
    measured = [_velocities(record, {}, arm) for record in records]

    def residual(z: FloatArray) -> FloatArray:
        values = space.values(z)
        parts = []
        for record, velocity in zip(records, measured, strict=True):
            motion = record.run(values, record.start(), record.quantities())
            readings = {axis.channel: axis.reading(motion, values) for axis in record.channels}
            difference = _velocities(record, readings, arm) - velocity
            parts.append((difference / np.std(velocity, axis=0)).ravel())
        return np.concatenate(parts)

    def jacobian(z: FloatArray) -> FloatArray:
        steps = np.where(z < space.upper - _DIFFERENCE_STEP, _DIFFERENCE_STEP, -_DIFFERENCE_STEP)
        points = [z, *(z + np.diag(steps))]
        at, *shifted = run_parallel([partial(residual, point) for point in points])
        return np.column_stack(
            [(one - at) / step for one, step in zip(shifted, steps, strict=True)]
        )

    search = least_squares(
        residual,
        np.clip(start.z, space.lower, space.upper),
        jacobian,
        (space.lower, space.upper),
        ftol=_TOLERANCE,
        xtol=_TOLERANCE,
        max_nfev=budget,
    )
    end = SearchEnd.CONVERGED if search.status > 0 else SearchEnd.EVALUATION_LIMIT
    objective = start.objective.replace_records(records).update_weights(search.x)
    linearised = objective.linearise(search.x)
    cost = np.inf if linearised is None else linearised.cost
    return replace(
        start, objective=objective, z=search.x, cost=cost, iterations=search.nfev, end=end
    )


def _velocities(record: Dataset, readings: Mapping[str, FloatArray], arm: Arm) -> FloatArray:
    """Velocities (n_rows, n_links) by (10) of a record with other `readings` of its sensors."""
    log = replace(record.log, channels={**record.log.channels, **readings})
    joint = log.experiment.joint
    links = slice(None) if joint is None else slice(joint - 1, joint)
    every = max(1, int(1.0 / (_ROWS_PER_PERIOD * record.cutoff_hz * log.sample_time)))
    return np.asarray(prepare_link_signals(log, arm).link_velocity[::every, links])
