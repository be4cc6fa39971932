"""Elastic model and a record -> what its sensors should have read, by applying its input again.

Servo, references and open-loop voltages are the record's; the arm is the model. What is compared
are motor velocities, from the encoders' differences, and accelerometers, all through one zero-phase
low-pass.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from strainwave.domain import Diagnostic, FloatArray, Log, Prediction
from strainwave.domain.effects import effect_named
from strainwave.domain.gear_laws import known_instead
from strainwave.domain.parameter_table import base_name
from strainwave.domain.parameters import Values
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.link_sensors import as_read
from strainwave.dynamics.record_effects import inputs_in
from strainwave.dynamics.rigid_prediction import fit_percent
from strainwave.dynamics.simulation import Drive, Quantity, simulate_arms
from strainwave.numerics.filters import differentiate, low_pass, noise_deviation, signal_band
from strainwave.signals.recorded_input import check_recorded_input, recorded_drive

_MOVES = 10.0  # times its noise: below that a fit would judge the sensor, not the model


def with_known_effects(arm: Arm, known: Collection[tuple[str, int | None]]) -> Arm:
    """The arm with only those effects whose parameters are known."""
    known = {(base_name(name), joint) for name, joint in known}
    joints = tuple(
        replace(
            joint,
            effects=tuple(
                effect
                for effect in joint.possible_effects
                if all((name, number) in known for name in effect_named(effect).required)
            ),
        )
        for number, joint in enumerate(arm.joints, start=1)
    )
    return arm.with_joints(joints)


def as_known(arm: Arm, values: Mapping[tuple[str, int | None], float]) -> Arm:
    """The arm with simpler springs where the values know no more of them, and known effects.

    `values`: (name, joint) -> value.
    """
    joints = tuple(
        replace(joint, spring=known_instead(joint.law, joint.law.of_joint(values, number)).name)
        for number, joint in enumerate(arm.joints, start=1)
    )
    return with_known_effects(arm.with_joints(joints), values.keys())


def velocity_band(log: Log, arm: Arm) -> float:
    """Frequency up to which the liveliest motor's angle stands out of its noise [Hz].

    Returns: [Hz].
    """
    numbers = range(1, arm.n_joints + 1)
    return max(signal_band(log.channels[f"theta_m{i}"], log.sample_time) for i in numbers)


@dataclass(frozen=True, slots=True)
class Observed:
    """What a record shows of its motion, and how a simulated arm is to be compared with it."""

    log: Log
    drive: Drive
    cutoff_hz: float
    channels: tuple[str, ...]  # omega_m{i} [rad/s], then a{i} [m/s^2]
    time: FloatArray  # (n_rows,) [s] without the filter's edges
    measured: FloatArray  # (n_rows, n_channels)
    noise: (
        FloatArray  # (n_channels,) standard deviation of the sensor's own noise behind the filter
    )

    @property
    def moves(self) -> tuple[bool, ...]:
        """Per channel, whether it stands well out of its noise."""
        return tuple((np.std(self.measured, axis=0) > _MOVES * self.noise).tolist())

    def simulated(self, arm: Arm, values: Mapping[tuple[str, int | None], float]) -> FloatArray:
        """The same channels of an arm that goes through the same experiment.

        An accelerometer's bias is unknown: its simulated mean is set to the measured one. Its delay
        and its scale are among the values where they are known.

        `arm`: With springs and effects that fit the values.
        `values`: (name, joint) -> value.

        Returns: (n_rows, n_channels).
        """
        record: list[Quantity] = ["encoder"]
        if len(self.channels) > arm.n_joints:
            record.append("accelerometer")
        hanging = self.drive.link_angle is None
        inputs = inputs_in(arm, dict(values), self.log.name, hanging=hanging)
        runs = simulate_arms(
            arm,
            [inputs.values],
            inputs.begun(self.drive),
            sample_time=self.log.sample_time,
            samples=len(self.log),
            record=record,
        )
        columns = [runs["encoder"][0]]
        for name in self.channels[arm.n_joints :]:
            joint, T = int(name[1:]), self.log.sample_time
            read = as_read(runs["accelerometer"][0, :, joint - 1], T, joint, values)
            columns.append(read[:, None])
        seen = _filtered(np.hstack(columns), arm.n_joints, self.log, self.cutoff_hz)
        shift = self.measured.mean(axis=0) - seen.mean(axis=0)
        shift[: arm.n_joints] = 0.0
        return np.asarray(seen + shift)


def observe(log: Log, arm: Arm, cutoff_hz: float | None = None) -> Observed:
    """Velocities and accelerations of a record, ready to be compared.

    `cutoff_hz` [Hz]: Of the low-pass; as far up as the encoders show motion if it is not given.

    Raises `InvalidInput`: the log lacks something that simulating it needs.
    """
    check_recorded_input(arm, log)
    cutoff = cutoff_hz or velocity_band(log, arm)
    numbers = range(1, arm.n_joints + 1)
    placed = [i for i in numbers if has_accelerometer(log, arm, i)]
    raw = [log.channels[f"theta_m{i}"] for i in numbers]
    raw += [log.channels[f"a{i}"] for i in placed]
    T = log.sample_time
    # of white noise below the cut-off, differentiated for the encoders
    slope = 2.0 * np.pi * cutoff / np.sqrt(3.0)
    shares = np.array([slope] * arm.n_joints + [1.0] * len(placed))
    noise = np.array([noise_deviation(channel) for channel in raw])
    return Observed(
        log=log,
        drive=recorded_drive(arm, log),
        cutoff_hz=cutoff,
        channels=tuple([f"omega_m{i}" for i in numbers] + [f"a{i}" for i in placed]),
        time=log.time[_inside(log, cutoff)],
        measured=_filtered(np.column_stack(raw), arm.n_joints, log, cutoff),
        noise=noise * shares * np.sqrt(min(1.0, 2.0 * T * cutoff)),
    )


def predict_closed_loop(
    values: Values, log: Log, arm: Arm, cutoff_hz: float | None = None
) -> Prediction:
    """Simulate a record on an arm with elastic joints, and compare.

    `values`: (name, joint) -> value; of a gear with a curve one `gear_stiffness` will do.
    `log`: Of any experiment whose references and open-loop voltages are there.
    `cutoff_hz` [Hz]: Of the low-pass for both sides; from the record if it is not given.

    Returns: Channels `omega_m{i}` [rad/s] and, where there are accelerometers, `a{i}` [m/s^2]. The
    fit of a channel that hardly stands out of its noise is NaN, and a warning says so.

    Raises `InvalidInput`: the log lacks something that simulating it needs, or a parameter is
    missing or impossible; `NumericalFailure`: the motion left the finite numbers.
    """
    seen = observe(log, arm, cutoff_hz)
    return prediction_of(seen, seen.simulated(as_known(arm, values), values))


def prediction_of(seen: Observed, predicted: FloatArray) -> Prediction:
    """The record of a comparison.

    `predicted` (n_rows, n_channels).
    """
    fits = np.where(seen.moves, fit_percent(seen.measured, predicted), np.nan)
    return Prediction(
        experiment=seen.log.name,
        time=seen.time,
        channels=seen.channels,
        measured=seen.measured,
        predicted=predicted,
        fit_percent=dict(zip(seen.channels, fits.tolist(), strict=True)),
        warnings=tuple(_still(seen)),
    )


def _still(seen: Observed) -> Iterator[Diagnostic]:
    for name, moves in zip(seen.channels, seen.moves, strict=True):
        if not moves:
            text = f"{name} has no fit: what it shows hardly stands out of its noise"
            yield Diagnostic("nothing-to-predict", seen.log.name, text)


def has_accelerometer(log: Log, arm: Arm, joint: int) -> bool:
    """Whether a joint's accelerometer was logged, and it is known where it sits.

    `joint`: From 1.
    """
    own = arm.joints[joint - 1]
    placed = own.motion == "prismatic" or own.accelerometer_distance is not None
    return placed and f"a{joint}" in log.channels


def _inside(log: Log, cutoff_hz: float) -> slice:
    """Without the edges, which hold the filter's transients."""
    edge = min(int(np.ceil(1.0 / (cutoff_hz * log.sample_time))), len(log) // 4)
    return slice(edge, len(log) - edge)


def _filtered(raw: FloatArray, n_joints: int, log: Log, cutoff_hz: float) -> FloatArray:
    """Encoders, then accelerometers, (n_samples, n_channels, ...), through the low-pass."""
    smooth = np.array(low_pass(raw, cutoff_hz, log.sample_time))
    smooth[:, :n_joints] = differentiate(smooth[:, :n_joints], log.sample_time)
    return np.asarray(smooth[_inside(log, cutoff_hz)])
