"""The guessed arm: drives, simulated motion, predicted precision, resonances, distance of links.

The distance between two links is that of the lines between the joints' frames.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from strainwave.domain import Control, FloatArray, Log, Parameter, Study
from strainwave.domain.arm.base_parameters import link_inertia
from strainwave.domain.arm.combinations import value_of
from strainwave.domain.arm.link_sensors import installed_axes
from strainwave.domain.arm.link_sensors.link_space import Quantity
from strainwave.domain.arm.parameters import complete_values
from strainwave.domain.keys import JointNumber, Values
from strainwave.domain.results.stage_results import ASSUMED_TORQUE_ERROR
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.simulation import Drive, SensorNoise, Trajectory, measure, simulate
from strainwave.dynamics.two_inertia import TwoInertia, anti_resonance, resonance
from strainwave.errors import InvalidInput, NumericalFailure
from strainwave.excite.plan import (
    HELD_CONTROL,
    Limits,
    Motion,
    Planned,
    PredictedMotion,
    clock_of,
)
from strainwave.identification.whole_arm import predicted_parameters

BAND_MARGIN = 5.0  # factor below the anti-resonance and above the resonance
# Spectral lines in the half-power width of the anti-resonance, to resolve its damping.
MIN_RESONANCE_LINES = 5
_DISTANCE_INTERVAL = 0.01  # [s] between compared postures; links move by millimetres in it

_QUANTITIES: tuple[Quantity, ...] = (
    "link_angle",
    "motor_velocity",
    "voltage",
    "gear_torque",
    "sliding",
    "accelerometer",
)
_MIN_SQUARED_LENGTH = 1e-12  # [m^2] of a segment; shorter ones are points


@dataclass(frozen=True, slots=True)
class GuessedArm:
    """The arm with guessed parameters and the limits within which it is moved."""

    arm: Arm
    values: Values
    limits: Limits

    @property
    def start(self) -> tuple[float, ...]:
        """Motor angles [rad] at which records begin: the posture in the middle of the limits."""
        return tuple(self.arm.motor_accelerations(self.limits.centre).tolist())

    def drive(
        self, tick: float, control: Sequence[Control], voltage: FloatArray, reference: FloatArray
    ) -> Drive:
        """Drive with inputs (n_ticks, n_joints) from rest."""
        return Drive(
            tick=tick,
            voltage=voltage,
            reference=reference,
            servo=tuple(each == HELD_CONTROL for each in control),
            motor_angle=self.start,
            initial_voltage=self.arm.holding_voltage(self.values, self.start),
        )


def servo_drive(guess: GuessedArm, reference: FloatArray) -> Drive:
    """Drive of servos that follow references (n_ticks, n_joints), from rest."""
    control = (HELD_CONTROL,) * guess.arm.n_joints
    return guess.drive(clock_of(guess.arm), control, np.zeros_like(reference), reference)


def run(guess: GuessedArm, drive: Drive) -> Trajectory:
    """Response of the guessed arm to a drive: limited quantities and accelerometers."""
    clock = clock_of(guess.arm)
    samples = round(len(drive.voltage) * drive.tick / clock)
    return simulate(
        guess.arm, guess.values, drive, sample_time=clock, samples=samples, record=_QUANTITIES
    )


def followed_motion(guess: GuessedArm, motion: Motion) -> PredictedMotion:
    """Peak values of a motion of the links that a controller follows without error.

    The gears transmit what the motors give.
    """
    arm = guess.arm
    torque = arm.inverse_dynamics(arm.parameter_vector(guess.values), *motion)
    gear_torque = torque / [joint.gear_ratio for joint in arm.joints]
    others = arm.motor_accelerations(motion[1]), torque / arm.torque_per_volt, gear_torque
    return _peaks(guess, motion[0], others, np.zeros(arm.n_joints))


def predicted_motion(guess: GuessedArm, drive: Drive) -> PredictedMotion:
    """Peak values of the guessed arm's response, and the share of time in which motors stick."""
    trajectory = run(guess, drive)
    others = trajectory["motor_velocity"], trajectory["voltage"], trajectory["gear_torque"]
    rest_share = np.asarray((trajectory["sliding"] == 0.0).mean(axis=0))
    return _peaks(guess, trajectory["link_angle"], others, rest_share)


def _peaks(
    guess: GuessedArm, angle: FloatArray, others: Sequence[FloatArray], rest_share: FloatArray
) -> PredictedMotion:
    """Peaks of link angles, and of motor velocities, voltages and gear torques (`others`)."""
    limits = guess.limits
    compared = angle[:: max(1, int(_DISTANCE_INTERVAL / clock_of(guess.arm)))]
    distance = smallest_distance(guess.arm, guess.values, compared, limits.distance)
    reach, velocity, voltage, gear_torque = (
        np.asarray(np.abs(each).max(axis=0)) for each in (angle - limits.centre, *others)
    )
    smallest = float(distance.min())
    return PredictedMotion(reach, velocity, voltage, gear_torque, rest_share, smallest)


@dataclass(frozen=True, slots=True)
class ExcitationBand:
    """Band in which one joint must be excited."""

    anti_resonance_hz: float  # of the lowest slope
    resonance_hz: float  # of the highest slope
    width_hz: float  # half-power width of the anti-resonance

    @property
    def low_hz(self) -> float:
        """Lower edge of the band."""
        return self.anti_resonance_hz / BAND_MARGIN

    @property
    def high_hz(self) -> float:
        """Upper edge of the band."""
        return self.resonance_hz * BAND_MARGIN

    @property
    def period(self) -> float:
        """Period [s] with `LINES` in the anti-resonance's width and a line at the lower edge."""
        return max(MIN_RESONANCE_LINES / self.width_hz, 1.0 / self.low_hz)


def band_of(
    arm: Arm, values: Values, joint: JointNumber, posture: FloatArray | None = None
) -> ExcitationBand | None:
    """Band of one joint with the others at rest; None if the gear is rigid.

    The zeros of (17) give omega_a^2 = k/m_L and the width (d_L + d_G)/m_L; the poles give omega_r.
    The link inertia is that in a posture (n_joints,); without one, that of the stretched arm. The
    margin covers the motion of other joints and other postures.
    """
    known = complete_values(values, arm)
    drive = arm.joints[joint - 1]
    if not drive.elastic:
        return None
    softest, stiffest = (
        TwoInertia(
            motor_inertia=known["motor_inertia", joint],
            motor_viscous_friction=known["motor_viscous_friction", joint],
            link_inertia=value_of(link_inertia(arm, joint, posture), known),
            link_viscous_friction=known["link_viscous_friction", joint],
            gear_stiffness=stiffness,
            gear_damping=known["gear_damping", joint],
            gear_ratio=float(arm.gear_ratios[joint - 1]),
        )
        for stiffness in drive.law.stiffness_range(drive.law.of_joint(known, joint))
    )
    damping = softest.link_viscous_friction + softest.gear_damping
    return ExcitationBand(
        anti_resonance_hz=anti_resonance(softest).frequency_hz,
        resonance_hz=resonance(stiffest).frequency_hz,
        width_hz=damping / softest.link_inertia / (2.0 * np.pi),
    )


def smallest_distance(arm: Arm, values: Values, angle: FloatArray, limit: float) -> FloatArray:
    """Smallest distance [m] between the centre lines of two links: (...); infinite without pairs.

    `angle` (..., n_joints) are link angles. The centre line of a link, and of the base, leads from
    its joint's frame to that of the next joint; that of the last link ends at its centre of mass if
    `values` contain it. Neighbours are not compared, nor links that are never further apart than
    `limit` because the links between them are too short.
    """
    starts, ends = _centre_lines(arm, values, angle)
    rest_starts, rest_ends = _centre_lines(arm, values, np.zeros(arm.n_joints))
    lengths = np.linalg.norm(rest_ends - rest_starts, axis=-1)
    smallest = np.full(angle.shape[:-1], np.inf)
    for second in range(2, len(lengths)):  # 0 is the base
        for first in range(second - 1):
            if lengths[first + 1 : second].sum() > limit:
                pair = (points[..., k, :] for k in (first, second) for points in (starts, ends))
                smallest = np.minimum(smallest, _segment_distance(*pair))
    return smallest


def _centre_lines(arm: Arm, values: Values, angle: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Ends of the centre lines of base and links: (..., n_joints + 1, 3) [m], base's frame."""
    last = arm.n_joints
    attitudes = arm.link_attitudes(angle.reshape(-1, last)).reshape(*angle.shape, 3, 3)
    position, axes = np.zeros((*angle.shape[:-1], 3)), np.eye(3)
    origins = [position]
    for i, joint in enumerate(arm.joints):
        position = position + np.array(joint.origin.xyz) @ axes
        axes = attitudes[..., i, :, :]
        if joint.motion == "prismatic":
            axis = np.array(joint.axis) / np.linalg.norm(joint.axis)
            position = position + angle[..., i, None] * (axis @ axes)
        origins.append(position)
    mass = values.get(("link_mass", last), 0.0)
    moments = [values.get((f"link_first_moment_{x}", last), 0.0) for x in "xyz"]
    origins.append(position + (np.array(moments) / mass) @ axes if mass > 0.0 else position)
    points = np.stack(origins, axis=-2)
    return points[..., :-1, :], points[..., 1:, :]


def _segment_distance(
    start: FloatArray, end: FloatArray, other_start: FloatArray, other_end: FloatArray
) -> FloatArray:
    """Distance of two line segments, arrays (..., 3): (...).

    The nearest points minimise a quadratic function over the unit square (Ericson 2005, 5.1.9).
    """
    u, v, w = end - start, other_end - other_start, start - other_start
    a, b, c, d, e = (np.sum(p * q, axis=-1) for p, q in ((u, u), (u, v), (v, v), (u, w), (v, w)))
    a, c = np.maximum(a, _MIN_SQUARED_LENGTH), np.maximum(c, _MIN_SQUARED_LENGTH)
    determinant = a * c - b * b
    is_skew = determinant > _MIN_SQUARED_LENGTH * a * c
    s = np.where(is_skew, (b * e - c * d) / np.where(is_skew, determinant, 1.0), 0.0)
    t = np.clip((b * np.clip(s, 0.0, 1.0) + e) / c, 0.0, 1.0)
    s = np.clip((b * t - d) / a, 0.0, 1.0)
    gap = w + s[..., None] * u - t[..., None] * v
    return np.asarray(np.linalg.norm(gap, axis=-1))


def torque_errors_of(arm: Arm, measured: Mapping[int, float]) -> FloatArray:
    """Errors (n_joints,) of the torques over their rms values: by joint as measured, or assumed."""
    return np.array([measured.get(i + 1, ASSUMED_TORQUE_ERROR) for i in range(arm.n_joints)])


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
