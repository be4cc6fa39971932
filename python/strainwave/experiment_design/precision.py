"""The intervals that a design's records would give, with the sensors that the study declares."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from strainwave.domain import Log, Parameter, Study
from strainwave.domain.parameters import Values
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.simulation import Quantity, SensorNoise, measure, simulate
from strainwave.errors import InvalidInput, NumericalFailure
from strainwave.experiment_design.plan import Planned, clock_of
from strainwave.identification.whole_arm import predicted_parameters


def predicted_precision(
    study: Study, values: Values, records: Sequence[Planned], *, seed: int = 0
) -> tuple[Parameter, ...]:
    """What the whole-arm fit would say of the guessed arm after the planned records.

    Of those at full amplitude and the steps: weaker copies add little and take the most time.

    `study`: A link has an accelerometer if its joint declares where it sits, a gyro if it declares
    its bandwidth, and an encoder if [channels] names its link angle; a joint without any of them
    has its motor's encoder alone. `values`: (name, joint) -> value of the guessed arm. `seed`: Of
    the sensors' noise, which decides the band that is compared. Returns: With the guess's values;
    empty where no record excites a gear enough for a fit.
    """
    rng = np.random.default_rng(seed)
    fast = [r for r in records if r.experiment.use in ("frequency", "tuning")]
    logs = [_log(study, values, one, rng) for one in fast]
    try:
        return predicted_parameters(logs, Arm.of(study.arm), values)
    except (InvalidInput, NumericalFailure):  # records in which friction holds the motor, say
        return ()


def _log(study: Study, values: Values, record: Planned, rng: np.random.Generator) -> Log:
    """A planned record as it would be logged, at the drive's clock."""
    tick = clock_of(study.arm)
    quantities: list[Quantity] = ["voltage", "encoder", "accelerometer", "gyro", "link_angle"]
    run = simulate(
        Arm.of(study.arm),
        values,
        record.drive,
        sample_time=tick,
        samples=round(record.duration / tick),
        record=quantities,
    )
    seen = measure(run, SensorNoise(), rng)
    channels = {}
    for i, joint in enumerate(study.arm.joints):
        drive = "u" if joint.torque_per_volt else "torque"
        channels[f"{drive}{i + 1}"] = seen["voltage"][:, i]
        channels[f"theta_m{i + 1}"] = seen["encoder"][:, i]
        if joint.accelerometer_distance:
            channels[f"a{i + 1}"] = seen["accelerometer"][:, i]
        if joint.gyro_hz:
            channels[f"gyro{i + 1}"] = seen["gyro"][:, i]
        if f"theta_l{i + 1}" in study.channels:
            channels[f"theta_l{i + 1}"] = seen["link_angle"][:, i]
    return Log(record.experiment, run.time, tick, channels)
