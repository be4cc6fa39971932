"""Simulation of an arm by the compiled core, from parameter values and inputs to motion.

Record effects: effects that act through the inputs of the core, separately in each record.

A size s of such an effect acts only through parameters and initial states u of the core, so that
the derivative of a channel is dy/ds = (dy/du) (du/ds).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from typing import Any, cast

import numpy as np

from strainwave import _core
from strainwave.domain import FloatArray, LinearServo, Payload, Servo
from strainwave.domain.arm.effects import Input, RecordEffect, all_effects, effect_named
from strainwave.domain.arm.link_sensors.link_space import ACCELEROMETER_QUANTITIES, Quantity
from strainwave.domain.arm.link_sensors.single_axis import ACCELEROMETER_DENSITY
from strainwave.domain.arm.parameter_table import base_name, of_record
from strainwave.domain.keys import Key, Values
from strainwave.dynamics.arm import MAX_TIME_STEP, Arm, core_errors
from strainwave.errors import InvalidInput
from strainwave.numerics.parallel import even_groups, raise_if_stopped, run_parallel

_CLOCK_TOLERANCE = 2e-4  # relative difference of two crystal oscillators of one nominal frequency
_STRICT_CLOCK_TOLERANCE = 1e-6  # many short candidate steps would satisfy the loose tolerance
_MAX_LOOSE_CANDIDATES = 16  # candidate steps that the loose tolerance applies to
_MAX_CANDIDATES = 100  # candidate steps of `common_step`


@dataclass(frozen=True, slots=True)
class Drive:
    """Inputs of an experiment at the ticks of its clock, and its initial state."""

    tick: float  # [s]
    voltage: FloatArray  # (n_ticks, n_joints) [V], added to the servo's output
    reference: FloatArray  # (n_ticks, n_joints) [rad/s]; unused without a servo
    servo: tuple[bool, ...]  # per joint: whether the servo is active
    motor_angle: tuple[float, ...]  # [rad] at the start
    initial_voltage: tuple[float, ...]  # [V] before the start
    motor_velocity: tuple[float, ...] | None = None  # [rad/s] at the start; None: zero
    link_angle: tuple[float, ...] | None = None  # [rad]; None: static equilibrium of the gears
    link_velocity: tuple[float, ...] | None = None  # [rad/s]; None: zero
    linear_servo: LinearServo | None = None  # in place of the servo of the arm


@dataclass(frozen=True, slots=True)
class Trajectory:
    """Noise-free motion of an arm: arrays (n_samples, n_joints) by name."""

    time: FloatArray  # (n_samples,) [s]
    quantities: Mapping[Quantity, FloatArray]

    def __getitem__(self, name: Quantity) -> FloatArray:
        return self.quantities[name]


@dataclass(frozen=True, slots=True)
class LowPass:
    """Decimating FIR filter: row r is the sum over t of taps[t] x[r samples_per_row + t]."""

    taps: Mapping[Quantity, FloatArray]  # (n_taps,) each, a multiple of `samples_per_row`
    samples_per_row: int


@dataclass(frozen=True, slots=True)
class SensorNoise:
    """Sensor errors, with typical values of a good rig."""

    accelerometer_density: float = ACCELEROMETER_DENSITY  # [m/s^2/sqrt(Hz)]
    accelerometer_bias: float = 25e-3 * 9.81  # [m/s^2] standard deviation
    accelerometer_range: float = 5.0 * 9.81  # [m/s^2]
    accelerometer_bits: int = 16
    gyro_std: float = 2e-3  # [rad/s] standard deviation per sample
    torque_std: float = 0.05  # [N m] standard deviation per sample


def simulate(
    arm: Arm,
    values: Values,
    drive: Drive,
    *,
    sample_time: float,
    samples: int,
    record: Sequence[Quantity],
    max_time_step: float = MAX_TIME_STEP,
) -> Trajectory:
    """Simulate one experiment with a time step that resolves the fastest gear resonance.

    `sample_time` [s] is the period of the recorded samples, `record` lists the recorded quantities,
    and `max_time_step` [s] is an upper limit of the time step. Raises InvalidInput if a parameter
    is missing or impossible, or if the clocks have no common step. Raises NumericalFailure if the
    motion diverges.
    """
    run = plan_run(
        arm,
        values,
        drive,
        sample_time=sample_time,
        samples=samples,
        record=record,
        max_time_step=min(max_time_step, arm.max_time_step(values)),
    )
    (recorded,) = simulate_runs([run])
    time: FloatArray = sample_time * np.arange(samples, dtype=np.float64)
    return Trajectory(time, recorded)


def simulate_arms(
    arm: Arm,
    arms: Sequence[Values | FloatArray],
    drive: Drive,
    *,
    sample_time: float,
    samples: int,
    record: Sequence[Quantity],
    max_time_step: float = MAX_TIME_STEP,
) -> dict[Quantity, FloatArray]:
    """Simulate one experiment on many arms, as `simulate_runs` does.

    Arguments and errors are those of `simulate`; values may be parameter vectors of the arm. Arrays
    of the result have shape (n_arms, n_samples, n_joints).
    """
    experiment = _experiment(arm, drive, (sample_time, samples), record, max_time_step)
    recorded = simulate_runs([PlannedRun(arm, _vector(arm, one), experiment) for one in arms])
    return {name: np.stack([run[name] for run in recorded]) for name in record}


Samples = dict[Quantity, FloatArray]
"""Arrays (n_samples, n_joints) by quantity."""


@dataclass(frozen=True, slots=True)
class PlannedRun:
    """One experiment on one arm, checked and ready for the core."""

    arm: Arm
    parameters: FloatArray  # in the order of the core
    experiment: _core.Experiment


def plan_run(
    arm: Arm,
    values: Values,
    drive: Drive,
    *,
    sample_time: float,
    samples: int,
    record: Sequence[Quantity],
    max_time_step: float = MAX_TIME_STEP,
    sums: Mapping[Quantity, FloatArray] | None = None,
) -> PlannedRun:
    """Prepare one experiment on one arm; see `channel_sensitivities` for arguments and errors."""
    experiment = _experiment(arm, drive, (sample_time, samples), record, max_time_step, sums)
    return PlannedRun(arm, _vector(arm, values), experiment)


def simulate_runs(runs: Sequence[PlannedRun]) -> list[Samples]:
    """Simulate experiments in threads, several per vector register.

    Runs of one arm with equal clocks share registers, best if they are equally long. Raises
    InvalidInput if a parameter is impossible, NumericalFailure if a motion diverges.
    """
    arms: list[Arm] = []
    members: list[list[int]] = []
    for k in sorted(range(len(runs)), key=lambda k: runs[k].experiment.clock, reverse=True):
        arm = runs[k].arm
        at = next((i for i, other in enumerate(arms) if other is arm or other == arm), len(arms))
        if at == len(arms):
            arms.append(arm)
            members.append([])
        members[at].append(k)
    jobs: list[tuple[_core.Arm, list[int]]] = []
    for arm, of_arm in zip(arms, members, strict=True):
        groups = np.array_split(of_arm, even_groups(len(of_arm), arm.core.lanes))
        jobs += [(arm.core, group.tolist()) for group in groups]

    def simulated(core: _core.Arm, places: list[int]) -> list[Samples]:
        vectors = np.array([runs[k].parameters for k in places])
        experiments = [runs[k].experiment for k in places]
        with core_errors():
            return cast("list[Samples]", core.simulate(vectors, experiments))

    results: list[Samples] = [{}] * len(runs)
    parts = run_parallel([partial(simulated, *job) for job in jobs])
    for (_, chosen), part in zip(jobs, parts, strict=True):
        for k, recorded in zip(chosen, part, strict=True):
            results[k] = recorded
    return results


def _vector(arm: Arm, values: Values | FloatArray) -> FloatArray:
    return values if isinstance(values, np.ndarray) else arm.parameter_vector(values)


def sensitivities(
    arm: Arm,
    values: Values | FloatArray,
    drive: Drive,
    directions: Sequence[Key],
    *,
    sample_time: float,
    samples: int,
    record: Sequence[Quantity],
    max_time_step: float = MAX_TIME_STEP,
) -> dict[Quantity, tuple[FloatArray, FloatArray]]:
    """Simulate one experiment on one arm with exact derivatives of all recorded quantities.

    `directions` are parameters of the core or the initial states `initial_motor_angle`,
    `initial_motor_velocity`, `initial_link_angle` and `initial_link_velocity`. Each quantity has
    values (n_samples, n_joints) and derivatives (n_samples, n_joints, n_directions). Other
    arguments and errors are those of `simulate_arms`.
    """
    vector = _vector(arm, values)
    experiment = _experiment(arm, drive, (sample_time, samples), record, max_time_step)
    with core_errors():
        raise_if_stopped()
        recorded = arm.core.sensitivities(vector, experiment, list(directions))
    return {name: recorded[name] for name in record}


def channel_sensitivities(
    arm: Arm,
    values: Values | FloatArray,
    drive: Drive,
    directions: Sequence[Key],
    *,
    channels: Sequence[tuple[Quantity, int, float]],
    chain: FloatArray,
    sample_time: float,
    samples: int,
    max_time_step: float = MAX_TIME_STEP,
    low_pass: LowPass | None = None,
    sums: Mapping[Quantity, FloatArray] | None = None,
    variants: Sequence[tuple[Values, Sequence[Key]]] = (),
) -> tuple[FloatArray, FloatArray]:
    """Simulate the channels of one experiment on one arm with exact derivatives.

    A channel is a quantity of a joint, from 1, times a factor. `sums` are weights (n_joints,
    n_signals) of `LINK_SIGNALS` in the quantities such as `imu_ax`. `chain` (n_directions,
    n_columns) are the derivatives of all directions by the variables of the columns. The last
    directions, in `variants`, are sizes of effects that are zero, with values that differ where
    they have no influence then. Other arguments and errors are those of `sensitivities`.

    Returns the channels (n_samples, n_channels) and their derivatives (n_samples, n_channels,
    n_columns); with `low_pass`, rows replace the samples.
    """
    vector = _vector(arm, values)
    record = list(dict.fromkeys(name for name, _, _ in channels))
    experiment = _experiment(arm, drive, (sample_time, samples), record, max_time_step, sums)
    with core_errors():
        raise_if_stopped()
        return arm.core.channel_sensitivities(
            vector,
            experiment,
            list(directions),
            [(record.index(name), joint - 1, factor) for name, joint, factor in channels],
            chain,
            variants=[(_vector(arm, values), list(keys)) for values, keys in variants],
            taps=None if low_pass is None else [low_pass.taps[name] for name in record],
            samples_per_row=1 if low_pass is None else low_pass.samples_per_row,
        )


def _experiment(
    arm: Arm,
    drive: Drive,
    sampling: tuple[float, int],
    record: Sequence[Quantity],
    max_time_step: float,
    sums: Mapping[Quantity, FloatArray] | None = None,
) -> _core.Experiment:
    """The experiment for the core; `sampling` is the time and number of samples."""
    servo = drive.linear_servo or arm.servo if any(drive.servo) else None
    if any(drive.servo) and servo is None:
        raise InvalidInput(
            "an experiment is under servo control but the study describes no servo",
            where="[servo]",
            remedy="add a [servo] table",
        )
    if isinstance(servo, LinearServo) and len(servo.laws) != arm.n_joints:
        raise InvalidInput(f"expected {arm.n_joints} control laws, got {len(servo.laws)}")
    sample_time, samples = sampling
    clocks = [drive.tick, sample_time] + ([servo.period] if servo else [])
    step = common_step(clocks, max_time_step)
    counts = [round(clock / step) for clock in clocks]
    n_accelerometer = len(ACCELEROMETER_QUANTITIES)
    with core_errors():
        return arm.core.experiment(
            np.ascontiguousarray(drive.voltage, dtype=float),
            reference=np.ascontiguousarray(drive.reference, dtype=float),
            servo=None if servo is None else _servo_arguments(servo, drive.servo),
            step=step,
            steps_per_tick=counts[0],
            steps_per_sample=counts[1],
            steps_per_servo=counts[2] if servo else counts[0],
            samples=samples,
            motor_angle=drive.motor_angle,
            motor_velocity=drive.motor_velocity,
            link_angle=drive.link_angle,
            link_velocity=drive.link_velocity,
            initial_voltage=drive.initial_voltage,
            record=record,
            link_sensors=[
                (name, bool(np.any(weights[:, n_accelerometer:])), np.ascontiguousarray(weights))
                for name, weights in (sums or {}).items()
            ],
        )


@lru_cache(maxsize=64)  # a fit simulates many short experiments with few servos
def _servo_arguments(servo: Servo | LinearServo, active: tuple[bool, ...]) -> tuple[Any, ...]:
    if isinstance(servo, Servo):
        return servo.kp, servo.ki, servo.limit, active, servo.position_gain
    laws = [
        (law.A, law.B, law.C, law.D.tolist(), law.E, law.holds.tolist(), law.rest())
        if is_active
        else None
        for law, is_active in zip(servo.laws, active, strict=True)
    ]
    return laws, servo.limit


def common_step(clocks: Sequence[float], longest: float = MAX_TIME_STEP) -> float:
    """Longest time step [s], up to a limit, that divides every clock [s].

    Raises InvalidInput if there is no such step down to 1/100 of the shortest clock.
    """
    shortest = min(clocks)
    fewest = max(1, int(np.ceil(shortest / longest - 1e-9)))
    for parts in range(fewest, fewest + _MAX_CANDIDATES):
        step = shortest / parts
        ratios = np.array(clocks) / step
        is_loose = parts < fewest + _MAX_LOOSE_CANDIDATES
        tolerance = _CLOCK_TOLERANCE if is_loose else _STRICT_CLOCK_TOLERANCE
        if np.all(np.abs(ratios - np.round(ratios)) < tolerance * ratios):
            return step
    raise InvalidInput(
        f"the clocks {', '.join(f'{clock:g} s' for clock in clocks)} have no common step",
        remedy="choose servo period, PRBS clock and sampling period as multiples of each other",
    )


def measure(
    trajectory: Trajectory, noise: SensorNoise | None, rng: np.random.Generator
) -> dict[Quantity, FloatArray]:
    """Sensor readings of a trajectory: bias and quantisation of accelerometers, and noise.

    Without `noise` the sensors are ideal.
    """
    measured = dict(trajectory.quantities)
    if noise is None:
        return measured
    rate = 1.0 / (trajectory.time[1] - trajectory.time[0])
    if "accelerometer" in measured:
        clean = measured["accelerometer"]
        std = noise.accelerometer_density * np.sqrt(rate / 2.0)
        bias = rng.normal(0.0, noise.accelerometer_bias, clean.shape[1])
        count = 2.0 * noise.accelerometer_range / 2**noise.accelerometer_bits
        noisy = clean + bias + rng.normal(0.0, std, clean.shape)
        limited = np.clip(noisy, -noise.accelerometer_range, noise.accelerometer_range)
        measured["accelerometer"] = count * np.round(limited / count)
    stds: dict[Quantity, float] = {"gyro": noise.gyro_std, "gear_torque": noise.torque_std}
    for name in (name for name in stds if name in measured):
        measured[name] = measured[name] + rng.normal(0.0, stds[name], measured[name].shape)
    return measured


_MOTOR_ANGLE, _LINK_ANGLE = "initial_motor_angle", "initial_link_angle"
_INITIAL_STATES = (_MOTOR_ANGLE, _LINK_ANGLE)


@dataclass(frozen=True, slots=True)
class RecordInputs:
    """Inputs of the core for one record, and their derivatives with respect to the parameters."""

    values: Values  # parameters
    offsets: Mapping[Key, float]  # increments of initial states
    slopes: Mapping[Key, Mapping[Key, float]]  # derivatives by input of the core and parameter

    def shift_start(self, drive: Drive) -> Drive:
        """Drive with shifted initial states."""
        if not self.offsets:
            return drive
        motor = self._shifted(_MOTOR_ANGLE, drive.motor_angle)
        link = drive.link_angle and self._shifted(_LINK_ANGLE, drive.link_angle)
        return replace(drive, motor_angle=motor, link_angle=link)

    def _shifted(self, name: str, angles: Sequence[float]) -> tuple[float, ...]:
        joints = enumerate(angles, start=1)
        return tuple(angle + self.offsets.get((name, joint), 0.0) for joint, angle in joints)

    def read(self, angles: FloatArray, arm: Arm | None = None) -> FloatArray:
        """Encoder readings of motor angles (n_samples, n_joints) [rad] with shifted zeros.

        For link angles, pass the arm.
        """
        zeros = np.array(self._shifted(_MOTOR_ANGLE, [0.0] * angles.shape[1]))
        return angles - (zeros if arm is None else arm.links_of(zeros))

    def directions(self, parameters: Sequence[Key]) -> list[Key]:
        """Directions in which the core must differentiate to give derivatives by the parameters."""
        effects = (effect for effect in all_effects() if isinstance(effect, RecordEffect))
        sizes, requested = {name for effect in effects for name in effect.sizes}, set(parameters)
        directions = [key for key in parameters if base_name(key[0]) not in sizes]
        slopes = self.slopes.items()
        return directions + [
            k for k, row in slopes if k not in requested and requested & row.keys()
        ]

    def chain(self, directions: Sequence[Key], parameters: Sequence[Key]) -> FloatArray:
        """Derivatives (n_directions, n_parameters) of the core's directions by the parameters."""
        chain = np.zeros((len(directions), len(parameters)))
        column = {key: k for k, key in enumerate(parameters)}
        for row, key in enumerate(directions):
            for by, slope in self.slopes.get(key, {key: 1.0}).items():
                if by in column:
                    chain[row, column[by]] = slope
        return chain


def record_inputs(
    arm: Arm, values: Values, record: str, *, hanging: bool, payload: Payload | None = None
) -> RecordInputs:
    """Inputs of the core for a record of an arm with record effects.

    An effect whose size is missing in `values` is absent. `hanging` states that the links start in
    static equilibrium and therefore follow the motors. A payload adds to the parameters of the last
    link.
    """
    changed: dict[Key, tuple[Input, Mapping[str, str]]] = {
        (change.name, number): (change, names)
        for number, joint in enumerate(arm.joints, start=1)
        for effect in map(effect_named, joint.named_effects)
        if isinstance(effect, RecordEffect)
        for change, names in _inputs_of(effect, number, joint.gear_ratio, values, record)
        if not (hanging and change.name == _LINK_ANGLE)
    }
    parameters, offsets = dict(values), Values()
    if payload is not None:
        last = arm.base_names[-len(payload.parameters) :]
        carried = zip(last, payload.parameters, strict=True)
        parameters |= {key: values.get(key, 0.0) + value for key, value in carried}
    slopes: dict[Key, dict[Key, float]] = {}
    for key, (change, names) in changed.items():
        (offsets if key[0] in _INITIAL_STATES else parameters)[key] = change.value
        slopes[key] = {(names.get(by, by), key[1]): slope for by, slope in change.slopes.items()}
    return RecordInputs(parameters, offsets, slopes)


def _inputs_of(
    effect: RecordEffect, number: int, gear_ratio: float, values: Values, record: str
) -> Iterator[tuple[Input, Mapping[str, str]]]:
    """Changes by one effect, each with the names of its sizes in `values`."""
    names = {name: of_record(name, record) if effect.by_record else name for name in effect.sizes}
    known = {name: value for (name, joint), value in values.items() if joint == number}
    known |= {name: values.get((record_name, number), 0.0) for name, record_name in names.items()}
    for change in effect.inputs(known, gear_ratio):
        yield change, names
