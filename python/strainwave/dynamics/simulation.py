"""Forward models over the compiled core: a study, parameter values and a drive in, motion out."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from strainwave import _core
from strainwave.domain import FloatArray, Study
from strainwave.domain.parameters import Values, completed
from strainwave.errors import InvalidInput, NumericalFailure
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

LONGEST_STEP = 1.25e-4
"""[s] Of the integrator, where no gear resonance asks for shorter ones."""
_STEPS_PER_PERIOD = 120.0
"""Of the fastest gear resonance: there w h = 0.05. The integrator, of fourth order, is then off by
(w h)^4/120 or 6e-8, the sensors' filters, of second, by (w h)^2/12 or 2e-4: a fiftieth of an
accelerometer's usual error of calibration. Records that are to be truths ask for shorter steps."""

_SAME_CLOCK = 2e-4
"""Two crystals of one nominal frequency differ by up to so much."""
_FEW_PARTS = 16

_OPTIONAL = {
    "friction_offset": 0.0,
    "friction_settling_time": 0.0,
    "gravity_torque_1": 0.0,
    "gravity_torque_2": 0.0,
}


@dataclass(frozen=True, slots=True)
class Drive:
    """What an experiment applies, per tick of its clock."""

    tick: float  # [s]
    voltage: FloatArray  # (n_ticks, n_joints) [V], added to the servo's
    reference: FloatArray  # (n_ticks, n_joints) [rad/s]; unused where no servo acts
    servo: tuple[bool, ...]  # per joint: whether its servo acts
    motor_angle: tuple[float, ...]  # [rad] at the start
    initial_voltage: tuple[float, ...]  # [V] that has been there before the start
    motor_velocity: tuple[float, ...] | None = None  # [rad/s] at the start; None: at rest
    link_angle: tuple[float, ...] | None = None  # [rad]; None: the links hang on their gears
    link_velocity: tuple[float, ...] | None = None  # [rad/s]; None: at rest


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


def build_arm(study: Study) -> _core.Arm:
    """The core's arm for a study: kind, gears and effects, electronics, sensors.

    Parameters
    ----------
    study : Study

    Returns
    -------
    _core.Arm
    """
    joints = study.arm.joints
    distance = [joint.accelerometer_distance or 1.0 for joint in joints]
    return _core.Arm(
        study.arm.kind,
        [joint.spring for joint in joints],
        [joint.gear_ratio for joint in joints],
        torque_per_volt=[joint.torque_per_volt or 1.0 for joint in joints],
        link_length=study.arm.link_length or 0.0,
        gravity=study.arm.gravity or 0.0,
        current_loop_hz=[joint.current_loop_hz for joint in joints],
        encoder_counts=[joint.encoder_counts for joint in joints],
        accelerometer_distance=distance,
        accelerometer_hz=[joint.accelerometer_hz for joint in joints],
        gyro_hz=[joint.gyro_hz for joint in joints],
        effects=[joint.effects for joint in joints],
        **_imu_bandwidths(study),
    )


def _imu_bandwidths(study: Study) -> dict[str, Any]:
    """What an arm needs to know of its IMUs' low-passes; nothing where it has no IMU."""
    imus = [joint.imu for joint in study.arm.joints]
    if not any(imus):
        return {}
    return {
        "imu_accelerometer_hz": [imu.accelerometer_hz if imu else None for imu in imus],
        "imu_gyro_hz": [imu.gyro_hz if imu else None for imu in imus],
    }


def parameter_vector(arm: _core.Arm, values: Values, study: Study) -> FloatArray:
    """Values by name -> the core's flat list.

    Parameters
    ----------
    arm : _core.Arm
    values : dict
        (name, joint) -> value.
    study : Study

    Returns
    -------
    (n_parameters,)

    Raises
    ------
    InvalidInput
        A parameter the arm needs is not there.
    """
    known = completed(values, study)
    missing = [
        name for name in arm.parameter_names if name not in known and name[0] not in _OPTIONAL
    ]
    if missing:
        listed = ", ".join(f"{name} of joint {joint}" if joint else name for name, joint in missing)
        raise InvalidInput(
            f"the parameters lack {listed}",
            where="--parameters",
            remedy="give every parameter of docs/notation.md that this arm has",
        )
    vector = [known.get(name, _OPTIONAL.get(name[0], 0.0)) for name in arm.parameter_names]
    return np.array(vector)


def holding_voltage(
    study: Study, values: Values, motor_angle: tuple[float, ...]
) -> tuple[float, ...]:
    """What keeps an arm up where it stands: gravity's torque over the torque per volt.

    Parameters
    ----------
    study : Study
    values : dict
        (name, joint) -> value.
    motor_angle : (n_joints,) [rad]

    Returns
    -------
    (n_joints,) [V], or [N m] where the study has no torque per volt

    Raises
    ------
    InvalidInput
        A parameter is missing or impossible.
    """
    arm = build_arm(study)
    vector = parameter_vector(arm, values, study)
    ratio = np.array([joint.gear_ratio for joint in study.arm.joints])
    still = np.zeros((1, study.arm.n_joints))
    try:
        holding = arm.inverse_dynamics(vector, np.array([motor_angle]) * ratio, still, still)[0]
    except ValueError as error:
        raise InvalidInput(str(error), where="--parameters", remedy="mend that value") from error
    per_volt = [joint.torque_per_volt or 1.0 for joint in study.arm.joints]
    return tuple(float(t / e) for t, e in zip(holding, per_volt, strict=True))


def simulate(
    study: Study,
    values: Values,
    drive: Drive,
    *,
    sample_time: float,
    samples: int,
    record: Sequence[Quantity],
    longest: float = LONGEST_STEP,
) -> Trajectory:
    """Run one experiment on an arm with given parameters, in steps that its fastest resonance asks.

    Parameters
    ----------
    study : Study
    values : dict
        (name, joint) -> value.
    drive : Drive
    sample_time : float [s]
        Between recorded samples.
    samples : int
    record : sequence of str
        Quantities to record.
    longest : float [s]
        Of the integrator's steps, where its fastest resonance does not ask for shorter ones.

    Returns
    -------
    Trajectory

    Raises
    ------
    InvalidInput
        A parameter is missing or impossible, or the clocks have no common step.
    NumericalFailure
        The motion left the finite numbers.
    """
    recorded = simulate_arms(
        study,
        [values],
        drive,
        sample_time=sample_time,
        samples=samples,
        record=record,
        longest_step=min(longest, longest_step(study, values)),
    )
    time: FloatArray = sample_time * np.arange(samples, dtype=np.float64)
    return Trajectory(time, {name: recorded[name][0] for name in record})


def longest_step(study: Study, values: Values) -> float:
    """The integrator's longest step that an arm's fastest gear resonance allows.

    Parameters
    ----------
    study : Study
    values : dict
        (name, joint) -> value.

    Returns
    -------
    float [s]
        `LONGEST_STEP` where no resonance asks for less.
    """
    fastest = fastest_resonance(study, values)
    return min(LONGEST_STEP, 1.0 / (_STEPS_PER_PERIOD * fastest)) if fastest else LONGEST_STEP


def fastest_resonance(study: Study, values: Values) -> float:
    """The highest undamped natural frequency of motors and links on their stiffest springs.

    det(K - w^2 M) = 0 with M of the links, folded or stretched, and of the motors, J/n^2.

    Parameters
    ----------
    study : Study
    values : dict
        (name, joint) -> value.

    Returns
    -------
    float [Hz]
        Zero where the values do not give it.
    """
    known, n = completed(values, study), study.arm.n_joints
    try:
        own = [(known.get(("gear_stiffness", i)), i) for i in range(1, n + 1)]
        k = np.diag([one or known["gear_stiffness_k3", i] for one, i in own])
        ratios = [joint.gear_ratio for joint in study.arm.joints]
        motor = np.diag([known["motor_inertia", i] / r**2 for i, r in enumerate(ratios, start=1)])
        links = [_link_inertias(study, known, elbow) for elbow in (np.pi, 0.0)]
    except KeyError:
        return 0.0
    stiffness, fastest = np.block([[k, -k], [-k, k]]), 0.0
    for link in links:
        inertia = np.block([[link, np.zeros((n, n))], [np.zeros((n, n)), motor]])
        try:
            root = np.linalg.inv(np.linalg.cholesky(inertia))
        except np.linalg.LinAlgError:
            return 0.0  # an impossible arm: the core says what is wrong with it
        squared = float(np.linalg.eigvalsh(root @ stiffness @ root.T)[-1])
        fastest = max(fastest, float(np.sqrt(max(squared, 0.0)) / (2.0 * np.pi)))
    return fastest


def _link_inertias(study: Study, known: Values, elbow: float) -> FloatArray:
    """M of the links alone, (n_joints, n_joints), with the elbow at an angle."""
    keys = base_names(study)
    base = [0.0 if key[0].startswith("gravity") else known[key] for key in keys]
    angle = np.zeros(study.arm.n_joints)
    angle[1:] = elbow
    return inertia_matrix(study, np.array(base), angle)


def base_names(study: Study) -> list[tuple[str, int | None]]:
    """The parameters in which the inverse dynamics are linear, in the core's order.

    Parameters
    ----------
    study : Study

    Returns
    -------
    list of (name, joint)
    """
    arm, still = build_arm(study), np.zeros((1, study.arm.n_joints))
    return arm.parameter_names[: arm.base_regressor(still, still, still).shape[2]]


def inertia_matrix(study: Study, base: FloatArray, angle: FloatArray) -> FloatArray:
    """M(q) of the links, out of the core's regressor.

    Column k is the torques of a unit acceleration of joint k, less those of gravity.

    Parameters
    ----------
    study : Study
    base : (n_base,)
    angle : (n_joints,) [rad]
        Of the links.

    Returns
    -------
    (n_joints, n_joints) [kg m^2], or [kg] of a prismatic joint
    """
    arm, unit = build_arm(study), np.eye(study.arm.n_joints)
    at, still = np.tile(angle, (study.arm.n_joints, 1)), np.zeros_like(unit)
    torque = arm.base_regressor(at, still, unit) @ base
    held = arm.base_regressor(at, still, still) @ base
    return np.asarray(torque - held).T


def simulate_arms(
    study: Study,
    arms: Sequence[Values],
    drive: Drive,
    *,
    sample_time: float,
    samples: int,
    record: Sequence[Quantity],
    longest_step: float = LONGEST_STEP,
) -> dict[Quantity, FloatArray]:
    """Run one experiment on many arms at once, side by side in vector lanes and threads.

    Parameters
    ----------
    study : Study
    arms : sequence of dict
        (name, joint) -> value, one per arm.
    drive : Drive
    sample_time : float [s]
        Between recorded samples.
    samples : int
    record : sequence of str
        Quantities to record.
    longest_step : float [s]
        Of the integrator.

    Returns
    -------
    dict
        Quantity -> (n_arms, n_samples, n_joints).

    Raises
    ------
    InvalidInput
        A parameter is missing or impossible, or the clocks have no common step.
    NumericalFailure
        A motion left the finite numbers.
    """
    arm = build_arm(study)
    vectors = np.array([parameter_vector(arm, values, study) for values in arms])
    experiment = _experiment(study, drive, sample_time, samples, longest_step)
    with _told():
        stop_if_asked()
        recorded = arm.simulate(vectors, record=record, **experiment)
    return {name: recorded[name] for name in record}


def sensitivities(
    study: Study,
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

    Parameters
    ----------
    study : Study
    values : dict
        (name, joint) -> value.
    drive : Drive
    directions : sequence of (name, joint)
        Parameters as the core names them, or initial states: `initial_motor_angle`,
        `initial_motor_velocity`, `initial_link_angle`, `initial_link_velocity`.
    sample_time : float [s]
        Between recorded samples.
    samples : int
    record : sequence of str
        Quantities to record.
    longest_step : float [s]
        Of the integrator.
    low_pass : LowPass, optional
        Gives rows in place of samples.

    Returns
    -------
    dict
        Quantity -> values (n_samples, n_joints) and derivatives (n_samples, n_joints,
        n_directions), or as many rows.

    Raises
    ------
    InvalidInput
        A parameter is missing or impossible, or the clocks have no common step.
    NumericalFailure
        The motion left the finite numbers.
    """
    arm = build_arm(study)
    vector = parameter_vector(arm, values, study)
    experiment = _experiment(study, drive, sample_time, samples, longest_step)
    if low_pass is not None:
        experiment["taps"] = [low_pass.taps[name] for name in record]
        experiment["samples_per_row"] = low_pass.samples_per_row
    with _told():
        stop_if_asked()
        found = arm.sensitivities(
            vector, with_respect_to=list(directions), record=record, **experiment
        )
    return {name: found[name] for name in record}


def _experiment(
    study: Study, drive: Drive, sample_time: float, samples: int, longest_step: float
) -> dict[str, Any]:
    """What the core needs to know of an experiment."""
    servo = study.arm.servo if any(drive.servo) else None
    if any(drive.servo) and servo is None:
        raise InvalidInput(
            "an experiment is under servo control but the study describes no servo",
            where=str(study.path),
            remedy="add a [servo] table",
        )
    clocks = [drive.tick, sample_time] + ([servo.period] if servo else [])
    step = common_step(clocks, longest_step)
    counts = [round(clock / step) for clock in clocks]
    return {
        "voltage": np.ascontiguousarray(drive.voltage, dtype=float),
        "reference": np.ascontiguousarray(drive.reference, dtype=float),
        "servo": (servo.kp, servo.ki, servo.limit, drive.servo) if servo else None,
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


@contextmanager
def _told() -> Iterator[None]:
    """The core's complaints as this package's errors."""
    try:
        yield
    except ValueError as error:
        raise InvalidInput(str(error), remedy="check the parameters and the study") from error
    except FloatingPointError as error:
        raise NumericalFailure(str(error)) from error


def common_step(clocks: Sequence[float], longest: float = LONGEST_STEP) -> float:
    """The longest integrator step, up to a limit, of which every clock is a multiple.

    Parameters
    ----------
    clocks : sequence of float [s]
    longest : float [s]

    Returns
    -------
    float [s]

    Raises
    ------
    InvalidInput
        There is none down to a hundredth of the shortest clock.
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

    Parameters
    ----------
    trajectory : Trajectory
    noise : SensorNoise or None
        None: ideal sensors.
    rng : numpy.random.Generator

    Returns
    -------
    dict
        Quantity -> (n_samples, n_joints).
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
