"""Forward models over the compiled core: an arm, parameter values and a drive in, motion out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from strainwave.domain import FloatArray
from strainwave.domain.parameters import Values
from strainwave.dynamics.arm import LONGEST_STEP, Arm, core_errors
from strainwave.errors import InvalidInput
from strainwave.numerics.parallel import stop_if_asked

Quantity = Literal[
    "voltage",
    "motor_torque",
    "motor_angle",
    "motor_velocity",
    "link_angle",
    "link_velocity",
    "link_acceleration",
    "gear_torque",
    "encoder",
    "accelerometer",
    "gyro",
    "specific_force_x",
    "specific_force_y",
    "angular_acceleration",
    "squared_rate",
    "angular_rate",
    "sliding",
]
"""What a run can record."""

_SAME_CLOCK = 2e-4
"""Two crystals of one nominal frequency differ by up to so much."""
_FEW_PARTS = 16


@dataclass(frozen=True, slots=True)
class Drive:
    """What an experiment applies, per tick of its clock."""

    tick: float  # [s]
    voltage: FloatArray  # (n_ticks, n_joints) [V], added to the servo's
    reference: FloatArray  # (n_ticks, n_joints) [rad/s]; unused where no servo acts
    servo: tuple[bool, ...]  # per joint: whether its servo acts
    motor_angle: tuple[float, ...]  # [rad] at the start
    initial_voltage: tuple[float, ...]  # [V] that has been there before the start
    motor_velocity: tuple[float, ...] | None = None  # [rad/s] at the start; None: at standstill
    link_angle: tuple[float, ...] | None = None  # [rad]; None: the links hang on their gears
    link_velocity: tuple[float, ...] | None = None  # [rad/s]; None: at standstill


@dataclass(frozen=True, slots=True)
class Trajectory:
    """What an arm did: (n_samples, n_joints) arrays by name, noise-free."""

    time: FloatArray  # (n_samples,) [s]
    quantities: Mapping[Quantity, FloatArray]

    def __getitem__(self, name: Quantity) -> FloatArray:
        return self.quantities[name]


@dataclass(frozen=True, slots=True)
class LowPass:
    """Rows in place of samples: row r is the sum of taps[t] x[r samples_per_row + t]."""

    taps: Mapping[Quantity, FloatArray]  # (n_taps,) each, a multiple of `samples_per_row`
    samples_per_row: int


@dataclass(frozen=True, slots=True)
class SensorNoise:
    """What real sensors add; theory's orders of magnitude for a decent rig."""

    accelerometer_density: float = 100e-6 * 9.81  # [m/s^2/sqrt(Hz)]
    accelerometer_bias: float = 25e-3 * 9.81  # [m/s^2], one standard deviation
    accelerometer_range: float = 5.0 * 9.81  # [m/s^2]
    accelerometer_bits: int = 16
    gyro_deviation: float = 2e-3  # [rad/s] per sample


def simulate(
    arm: Arm,
    values: Values,
    drive: Drive,
    *,
    sample_time: float,
    samples: int,
    record: Sequence[Quantity],
    longest: float = LONGEST_STEP,
) -> Trajectory:
    """Run one experiment on an arm with given parameters, in steps that its fastest resonance asks.

    `values`: (name, joint) -> value. `sample_time` [s]: Between recorded samples. `record`:
    Quantities to record. `longest` [s]: Of the integrator's steps, where its fastest resonance does
    not ask for shorter ones. Raises `InvalidInput`: A parameter is missing or impossible, or the
    clocks have no common step. Raises `NumericalFailure`: The motion left the finite numbers.
    """
    recorded = simulate_arms(
        arm,
        [values],
        drive,
        sample_time=sample_time,
        samples=samples,
        record=record,
        longest_step=min(longest, arm.longest_step(values)),
    )
    time: FloatArray = sample_time * np.arange(samples, dtype=np.float64)
    return Trajectory(time, {name: recorded[name][0] for name in record})


def simulate_arms(
    arm: Arm,
    arms: Sequence[Values],
    drive: Drive,
    *,
    sample_time: float,
    samples: int,
    record: Sequence[Quantity],
    longest_step: float = LONGEST_STEP,
) -> dict[Quantity, FloatArray]:
    """Run one experiment on many arms at once, side by side in vector lanes and threads.

    `arms`: (name, joint) -> value, one per arm. `sample_time` [s]: Between recorded samples.
    `record`: Quantities to record. `longest_step` [s]: Of the integrator. Returns: Quantity ->
    (n_arms, n_samples, n_joints). Raises `InvalidInput`: A parameter is missing or impossible, or
    the clocks have no common step. Raises `NumericalFailure`: A motion left the finite numbers.
    """
    vectors = np.array([arm.parameter_vector(values) for values in arms])
    experiment = _experiment(arm, drive, sample_time, samples, longest_step)
    with core_errors():
        stop_if_asked()
        recorded = arm.core.simulate(vectors, record=record, **experiment)
    return {name: recorded[name] for name in record}


def sensitivities(
    arm: Arm,
    values: Values,
    drive: Drive,
    directions: Sequence[tuple[str, int | None]],
    *,
    sample_time: float,
    samples: int,
    record: Sequence[Quantity],
    longest_step: float = LONGEST_STEP,
    low_pass: LowPass | None = None,
) -> dict[Quantity, tuple[FloatArray, FloatArray]]:
    """Run one experiment on one arm, with exact derivatives of all that is recorded.

    `values`: (name, joint) -> value. `directions`: Parameters as the core names them, or initial
    states: `initial_motor_angle`, `initial_motor_velocity`, `initial_link_angle`,
    `initial_link_velocity`. `sample_time` [s]: Between recorded samples. `record`: Quantities to
    record. `longest_step` [s]: Of the integrator. `low_pass`: Gives rows in place of samples.
    Returns: Quantity -> values (n_samples, n_joints) and derivatives (n_samples, n_joints,
    n_directions), or as many rows. Raises `InvalidInput`: A parameter is missing or impossible, or
    the clocks have no common step. Raises `NumericalFailure`: The motion left the finite numbers.
    """
    vector = arm.parameter_vector(values)
    experiment = _experiment(arm, drive, sample_time, samples, longest_step)
    if low_pass is not None:
        experiment["taps"] = [low_pass.taps[name] for name in record]
        experiment["samples_per_row"] = low_pass.samples_per_row
    with core_errors():
        stop_if_asked()
        found = arm.core.sensitivities(
            vector, with_respect_to=list(directions), record=record, **experiment
        )
    return {name: found[name] for name in record}


def _experiment(
    arm: Arm, drive: Drive, sample_time: float, samples: int, longest_step: float
) -> dict[str, Any]:
    """What the core needs to know of an experiment."""
    servo = arm.servo if any(drive.servo) else None
    if any(drive.servo) and servo is None:
        raise InvalidInput(
            "an experiment is under servo control but the study describes no servo",
            where="[servo]",
            remedy="add a [servo] table",
        )
    clocks = [drive.tick, sample_time] + ([servo.period] if servo else [])
    step = common_step(clocks, longest_step)
    counts = [round(clock / step) for clock in clocks]
    return {
        "voltage": np.ascontiguousarray(drive.voltage, dtype=float),
        "reference": np.ascontiguousarray(drive.reference, dtype=float),
        "servo": servo and (servo.kp, servo.ki, servo.limit, drive.servo, servo.position_gain),
        "step": step,
        "steps_per_tick": counts[0],
        "steps_per_sample": counts[1],
        "steps_per_servo": counts[2] if servo else counts[0],
        "samples": samples,
        "motor_angle": drive.motor_angle,
        "motor_velocity": drive.motor_velocity,
        "link_angle": drive.link_angle,
        "link_velocity": drive.link_velocity,
        "initial_voltage": drive.initial_voltage,
    }


def common_step(clocks: Sequence[float], longest: float = LONGEST_STEP) -> float:
    """The longest integrator step, up to a limit, of which every clock is a multiple.

    `clocks` [s]. `longest` [s]. Returns [s]. Raises `InvalidInput`: There is none down to a
    hundredth of the shortest clock.
    """
    shortest = min(clocks)
    fewest = max(1, int(np.ceil(shortest / longest - 1e-9)))
    for parts in range(fewest, fewest + 100):
        step = shortest / parts
        ratios = np.array(clocks) / step
        # of many fine steps some would fit anything
        tolerance = _SAME_CLOCK if parts < fewest + _FEW_PARTS else 1e-6
        if np.all(np.abs(ratios - np.round(ratios)) < tolerance * ratios):
            return step
    raise InvalidInput(
        f"the clocks {', '.join(f'{clock:g} s' for clock in clocks)} have no common step",
        remedy="choose servo period, PRBS clock and sampling time as multiples of one another",
    )


def measure(
    trajectory: Trajectory, noise: SensorNoise | None, rng: np.random.Generator
) -> dict[Quantity, FloatArray]:
    """What the sensors write down: bias, noise and rounding added to accelerometers and gyros.

    `noise`: None: ideal sensors. Returns: Quantity -> (n_samples, n_joints).
    """
    measured = dict(trajectory.quantities)
    if noise is None:
        return measured
    rate = 1.0 / (trajectory.time[1] - trajectory.time[0])
    if "accelerometer" in measured:
        clean = measured["accelerometer"]
        deviation = noise.accelerometer_density * np.sqrt(rate / 2.0)
        bias = rng.normal(0.0, noise.accelerometer_bias, clean.shape[1])
        count = 2.0 * noise.accelerometer_range / 2**noise.accelerometer_bits
        noisy = clean + bias + rng.normal(0.0, deviation, clean.shape)
        limited = np.clip(noisy, -noise.accelerometer_range, noise.accelerometer_range)
        measured["accelerometer"] = count * np.round(limited / count)
    if "gyro" in measured:
        clean = measured["gyro"]
        measured["gyro"] = clean + rng.normal(0.0, noise.gyro_deviation, clean.shape)
    return measured
