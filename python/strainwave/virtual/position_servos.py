"""Virtual runs of position servos: the commands of a study, and the angles that the arm follows."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from strainwave.domain import Experiment, FloatArray, PositionServo, Study
from strainwave.domain.arm.parameter_table import COULOMB, OFFSET
from strainwave.domain.keys import Key, Values
from strainwave.dynamics import excitation
from strainwave.dynamics.arm import Arm
from strainwave.errors import InvalidInput
from strainwave.identification.position_servo.conclusion import DAMPING
from strainwave.identification.position_servo.loop import (
    DELAY,
    KD,
    KP,
    LIMIT,
    VELOCITY_LAG,
    VISCOUS,
    ServoLoop,
)
from strainwave.identification.position_servo.records import (
    ReferenceHold,
    Segment,
    ServoRecord,
    servo_record,
)
from strainwave.io import logs

_DURATION, _SAMPLE_TIME = 20.0, 0.005  # [s] of records without a log
_MAX_HZ, _EXCURSION, _SPEED = 4.0, 0.5, 6.0  # [Hz, rad, rad/s] of their commands
_UNLIMITED = 1e3  # [rad] times the gain: a limit that no error reaches
_KD_SHARE = 0.5  # of the damping where only the sum is known


def record_servo(
    study: Study, arm: Arm, experiment: Experiment, values: Values, rng: np.random.Generator
) -> dict[str, FloatArray]:
    """Log of an experiment by channel: the commands of its log, or smooth ones, and the angles.

    The arm starts at rest at the first command. Raises InvalidInput if a parameter is missing.
    """
    servo = arm.position_servo
    assert servo is not None
    record = _record(study, arm, experiment, rng)
    loop = ServoLoop(arm, servo, ReferenceHold.HELD)
    inputs = loop.prepare(_loop_values(arm, servo, values, study.path), record)
    at_rest = np.concatenate([record.reference[0], np.zeros(arm.n_joints)])
    whole = Segment(record, 0, len(record.time))
    angles = loop.simulate(inputs, whole, at_rest).angle / arm.gear_ratios
    columns = {"t": record.time}
    for i, joint in enumerate(arm.joints):
        count = joint.encoder_resolution
        angle = angles[:, i]
        columns[f"ref{i + 1}"] = record.reference[:, i]
        columns[f"theta_m{i + 1}"] = count * np.round(angle / count) if count else angle
        if record.feed_forward[:, i].any():
            columns[f"u{i + 1}"] = record.feed_forward[:, i]
    return columns


def _record(
    study: Study, arm: Arm, experiment: Experiment, rng: np.random.Generator
) -> ServoRecord:
    if study.log_path(experiment).exists():
        return servo_record(logs.read_log(study, experiment), arm)
    count = round(_DURATION / _SAMPLE_TIME)
    commands = [
        _SAMPLE_TIME
        * np.cumsum(
            excitation.smooth_motion(
                duration=_DURATION,
                clock=_SAMPLE_TIME,
                top_hz=_MAX_HZ,
                excursion=_EXCURSION,
                speed=_SPEED,
                rng=rng,
            )
        )[:count]
        for _ in arm.joints
    ]
    reference = np.column_stack(commands)
    time: FloatArray = _SAMPLE_TIME * np.arange(len(reference), dtype=np.float64)
    none = np.zeros_like(reference)
    return ServoRecord(experiment.name, time, reference, none, reference, experiment.payload)


def _loop_values(arm: Arm, servo: PositionServo, values: Values, path: Path) -> Values:
    """Values of a simulation from those of a result or a parameter file.

    A study whose gains are unknown may be simulated with ratios to the gain, which is then one.
    """

    def need(key: Key) -> float:
        if key not in values:
            name, joint = key
            raise InvalidInput(
                f"missing parameter: {name}" + (f" of joint {joint}" if joint else ""),
                where=str(path),
                remedy="add it to the parameters; docs/notation.md describes them",
            )
        return values[key]

    known: Values = {column.key: need(column.key) for column in arm.base.columns}
    for i in range(1, arm.n_joints + 1):
        gain, kd = servo.gain(i), servo.damping_gain(i)
        known[KP, i] = gain if gain is not None else values.get((KP, i), 1.0)
        back_emf = servo.back_emf_damping(i) or 0.0
        if (KD, i) in values or kd is not None:
            known[KD, i] = values[KD, i] if kd is None else kd
            rest = values.get((DAMPING, i), 0.0) - known[KD, i] - back_emf
            known[VISCOUS, i] = values.get((VISCOUS, i), rest) + back_emf
        else:
            known[KD, i] = _KD_SHARE * need((DAMPING, i))
            known[VISCOUS, i] = need((DAMPING, i)) - known[KD, i]
        known[COULOMB, i], known[OFFSET, i] = need((COULOMB, i)), values.get((OFFSET, i), 0.0)
        limit = values.get((LIMIT, i), servo.torque_limit(i))
        known[LIMIT, i] = _UNLIMITED * known[KP, i] if limit is None else limit
        delay = servo.delay_of(i)
        known[DELAY, i] = need((DELAY, i)) if delay is None else delay
        known[VELOCITY_LAG, i] = 1.0
    return known
