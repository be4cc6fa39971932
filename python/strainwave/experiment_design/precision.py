"""Confidence intervals that a design's records would give with the declared sensors."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from strainwave.domain import Log, Parameter, Study
from strainwave.domain.keys import Values
from strainwave.domain.link_sensors import installed_axes
from strainwave.domain.quantities import Quantity
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.simulation import SensorNoise, measure, simulate
from strainwave.errors import InvalidInput, NumericalFailure
from strainwave.experiment_design.plan import Planned, clock_of
from strainwave.identification.whole_arm import predicted_parameters


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
