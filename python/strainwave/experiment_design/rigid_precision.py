"""Confidence intervals of the rigid parameters that a motion would give.

Confidence intervals that a design's records would give with the declared sensors.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from strainwave.domain import FloatArray, Log, Parameter, Study
from strainwave.domain.combinations import value_of
from strainwave.domain.keys import Values
from strainwave.domain.link_sensors import installed_axes
from strainwave.domain.link_sensors.link_space import Quantity
from strainwave.domain.parameters import complete_values
from strainwave.domain.stage_results import ASSUMED_TORQUE_ERROR
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.simulation import SensorNoise, measure, simulate
from strainwave.errors import InvalidInput, NumericalFailure
from strainwave.experiment_design.plan import Planned, clock_of
from strainwave.experiment_design.rigid_motion import Motion, Search, full_regressor
from strainwave.identification.whole_arm import predicted_parameters

LOW_PASS_RATIO = 5.0
"""Bandwidth of the rigid step over the highest frequency of the motion."""


def torque_errors_of(arm: Arm, measured: Mapping[int, float]) -> FloatArray:
    """Errors (n_joints,) of the torques over their rms values: by joint as measured, or assumed."""
    return np.array([measured.get(i + 1, ASSUMED_TORQUE_ERROR) for i in range(arm.n_joints)])


def standard_deviations(
    search: Search, motion: Motion, top_hz: float, torque_errors: FloatArray | float = 0.0
) -> FloatArray:
    """Standard deviations of `Arm.rigid_columns` after one period of a motion.

    The encoder's rounding has the variance q^2/12 at each tick. After the rigid step's low-pass B
    it becomes an error of the acceleration with variance (2 pi)^4 B^5/5 S, S = 2 tick q^2/12.
    Multiplied by the rigid inertia it is an error of the torque, independent 2 B times per second.
    `torque_errors` (n_joints,) are further errors of the torques over their rms values. `motion`
    has one period of `search`, `top_hz` is its highest frequency. Infinite for parameters that the
    motion does not determine.
    """
    arm = search.arm
    bandwidth = LOW_PASS_RATIO * top_hz
    rounding = np.array([joint.encoder_resolution for joint in arm.joints])
    density = 2.0 * clock_of(arm) * rounding**2 / 12.0
    acceleration = np.sqrt((2.0 * np.pi) ** 4 * bandwidth**5 / 5.0 * density)
    torque = arm.inverse_dynamics(search.vector, *motion)
    further = torque_errors * np.sqrt(np.mean(torque**2, axis=0))
    n = search.arm.n_joints
    rest, of_motors = np.zeros((n, n)), search.arm.links_of(np.eye(n))
    accelerated = search.arm.inverse_dynamics(search.vector, rest, rest, of_motors)
    static = search.arm.inverse_dynamics(search.vector, rest, rest, rest)
    error = np.hypot(np.diagonal(accelerated - static) * acceleration, further)
    rows = full_regressor(arm, motion) / error[:, None]
    n_independent = 2.0 * bandwidth * search.period
    rows = rows.reshape(-1, rows.shape[2]) * np.sqrt(n_independent / len(motion[0]))
    norms = np.linalg.norm(rows, axis=0)
    scale = np.where(norms > 0.0, norms, 1.0)
    _, singular, directions = np.linalg.svd(rows / scale, full_matrices=False)
    with np.errstate(divide="ignore"):
        return np.asarray(np.linalg.norm(directions / singular[:, None], axis=0) / scale)


def predicted_rigid_parameters(arm: Arm, values: Values, std: FloatArray) -> Iterator[Parameter]:
    """The guessed rigid parameters with their predicted intervals."""
    known = complete_values(values, arm)
    for column, each in zip(arm.rigid_columns, std.tolist(), strict=True):
        parts = {key: weight for key, weight in column.parts.items() if key in known}
        value = value_of(parts, known)
        if np.isfinite(each):
            yield Parameter.estimated(column.key, value, each, column.unit, "rigid")
        else:
            yield Parameter(*column.key, None, None, column.unit, "rigid")


def reference_sizes(arm: Arm, values: Values) -> dict[int, float]:
    """Sizes by which standard deviations are judged, by column; parameters of size zero have none.

    They are the guessed magnitudes. Base parameters that combine parameters of links may be nearly
    zero, so the largest of the same unit counts.
    """
    sizes = [abs(values.get(column.key, 0.0)) for column in arm.rigid_columns]
    if arm.base.has_groups:
        known = complete_values(values, arm)
        columns = arm.base.columns
        of_base = [abs(value_of(column.parts, known)) for column in columns]
        for k, column in enumerate(columns):
            alike = [
                size for size, c in zip(of_base, columns, strict=True) if c.unit == column.unit
            ]
            sizes[k] = max(alike)
    return {k: size for k, size in enumerate(sizes) if size > 0.0}


def predicted_precision(
    study: Study, values: Values, records: Sequence[Planned], *, seed: int
) -> tuple[Parameter, ...]:
    """Predict the result of the whole-arm fit of the guessed arm for the planned records.

    The prediction uses the voltages at full amplitude and the steps; sweeps add little information
    and take the most time. The sensors are those that the tables of the joints describe and
    [channels] names, without IMUs. `seed` is that of their noise, which determines the compared
    band. Empty if no record excites a gear enough for a fit.
    """
    rng = np.random.default_rng(seed)
    fitted = [r for r in records if r.experiment.use in ("frequency", "tuning")]
    logs = [_log(study, values, record, rng) for record in fitted]
    try:
        return predicted_parameters(logs, Arm.of(study.arm), values)
    except (InvalidInput, NumericalFailure):  # for example records in which the motor sticks
        return ()


def _log(study: Study, values: Values, record: Planned, rng: np.random.Generator) -> Log:
    """A planned record as a log at the drive's clock, with sensor noise."""
    arm, tick = Arm.of(study.arm), clock_of(study.arm)
    axes = [
        axis
        for i in range(1, arm.n_joints + 1)
        for axis in installed_axes(arm, i, study.channels)
        if not axis.is_mounted
    ]
    quantities: list[Quantity] = ["voltage", "encoder"]
    quantities += [name for axis in axes for name in axis.quantities]
    run = simulate(
        arm,
        values,
        record.drive,
        sample_time=tick,
        samples=round(record.duration / tick),
        record=list(dict.fromkeys(quantities)),
    )
    readings = measure(run, SensorNoise(), rng)
    channels = {}
    for i, joint in enumerate(study.arm.joints):
        drive = "u" if joint.torque_per_volt else "torque"
        channels[f"{drive}{i + 1}"] = readings["voltage"][:, i]
        channels[f"theta_m{i + 1}"] = readings["encoder"][:, i]
    channels |= {axis.channel: axis.reading(readings, {}) for axis in axes}
    return Log(record.experiment, run.time, tick, channels)
