"""Runs of the built-in arm as its sensors log them, decoupled, with the truth beside them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

from strainwave import excitation, rigid, scara, signals
from strainwave.comparisons.estimates import Estimate, Way, estimate
from strainwave.decoupling import decouple
from strainwave.links import link_side
from strainwave.parameters import Values
from strainwave.physical.two_inertia import TwoInertia
from strainwave.records import (
    Control,
    Decoupled,
    Experiment,
    FloatArray,
    LinkSignals,
    Log,
    Prbs,
    RigidModel,
    Study,
)
from strainwave.simulation import Drive, Quantity, SensorNoise, Trajectory, measure, simulate

Progress = Callable[[str], None]

PAYLOAD = 5  # [kg]; what most comparisons carry
AMPLITUDE = 10.0  # [V]; the most the rig's drives give
CLOCK = 1e-3  # [s]
ORDER = 10  # of the PRBS: 1023 clocks
SAMPLE = 2.5e-4  # [s]
PERIODS = 4
_MOTION_SECONDS = 10.0
_MOTION_SPEED = 1.8  # [rad/s] of a link
_MOTION_EXCURSION = 1.2  # [rad] of a link
_MOTION_TOP_HZ = 1.0
_STEP_SECONDS = 0.5
_SENSORS: tuple[Quantity, ...] = ("voltage", "encoder", "accelerometer")
_TRUTH: tuple[Quantity, ...] = (
    "motor_angle",
    "link_angle",
    "link_velocity",
    "link_acceleration",
)


@dataclass(frozen=True, slots=True, eq=False)
class Run:
    """One experiment: what was measured of the excited joint, and what is true of it."""

    study: Study
    values: Values
    trajectory: Trajectory  # noise-free
    signals: LinkSignals
    decoupled: Decoupled
    truth: TwoInertia  # with the slope that the gear showed on the whole


class Rig:
    """The virtual SCARA arm with three-slope gears and noisy sensors; runs are made once.

    Parameters
    ----------
    seed : int
        Of the sensors' noise and of the motions.
    progress : callable
        Told what is being done.
    """

    def __init__(self, seed: int, progress: Progress = lambda _: None) -> None:
        self.seed = seed
        self.progress = progress
        self.payload = PAYLOAD
        self.study = scara.study(Path("rig"))
        self.rigid = cache(self._rigid)
        self.prbs = cache(self._prbs)
        self.estimate = cache(self._estimate)

    def steps(self, levels: tuple[float, ...], joint: int, number: int) -> Log:
        """Steps of one servo's reference, the other servo at rest, as logged.

        Parameters
        ----------
        levels : tuple of float [rad/s]
            Of the motor, each for half a second.
        joint : int
            From 1.
        number : int
            Makes the noise that of this record.

        Returns
        -------
        Log
        """
        values = scara.parameters(PAYLOAD)
        trajectory = run_steps(self.study, values, levels, joint)
        experiment = Experiment("steps", "steps.csv", "tuning", ("servo", "servo"), joint)
        return _log(experiment, trajectory, SensorNoise(), self._rng(2, joint, number))

    def _rigid(self, disks: int) -> RigidModel:
        """The first step's model, from a servoed motion of both joints."""
        self.progress(f"rigid step with {disks} kg")
        rng = self._rng(0, disks)
        reference = np.column_stack(
            [
                excitation.smooth_motion(
                    duration=_MOTION_SECONDS,
                    clock=CLOCK,
                    top_hz=_MOTION_TOP_HZ,
                    excursion=_MOTION_EXCURSION / joint.gear_ratio,
                    speed=_MOTION_SPEED / joint.gear_ratio,
                    rng=rng,
                )
                for joint in self.study.joints
            ]
        )
        both: tuple[Control, Control] = ("servo", "servo")
        drive = _drive(np.zeros_like(reference), reference, both)
        values = scara.parameters(disks)
        trajectory = simulate(
            self.study,
            values,
            drive,
            sample_time=CLOCK,
            samples=len(reference),
            record=_SENSORS,
        )
        experiment = Experiment("motion", "motion.csv", "motion", both)
        log = _log(experiment, trajectory, SensorNoise(), rng)
        return rigid.fit([signals.motor_side(log, self.study)], self.study)

    def _prbs(
        self,
        joint: int,
        *,
        disks: int = PAYLOAD,
        amplitude: float = AMPLITUDE,
        periods: int = PERIODS,
        other: Control = "open",
        start: int = 0,
    ) -> Run:
        """One joint under PRBS in open loop, the other free or servoed.

        `start` is the clock of the sequence that the record begins with.
        """
        control: tuple[Control, Control] = ("open", other) if joint == 1 else (other, "open")
        sequence = excitation.prbs(Prbs(ORDER, CLOCK, periods, amplitude))
        voltage = np.zeros((len(sequence), 2))
        voltage[:, joint - 1] = np.roll(sequence, -start)
        values = scara.parameters(disks)
        trajectory = simulate(
            self.study,
            values,
            _drive(voltage, np.zeros_like(voltage), control),
            sample_time=SAMPLE,
            samples=round(len(voltage) * CLOCK / SAMPLE),
            record=_SENSORS + _TRUTH,
        )
        experiment = Experiment("prbs", "prbs.csv", "frequency", control, joint)
        rng = self._rng(
            1, joint, disks, round(1e3 * amplitude), periods, int(other == "servo"), start
        )
        log = _log(experiment, trajectory, SensorNoise(), rng)
        links = link_side(log, self.study)
        return Run(
            study=self.study,
            values=values,
            trajectory=trajectory,
            signals=links,
            decoupled=decouple(links, self.rigid(disks), self.study)[joint - 1],
            truth=equivalent(self.study, values, trajectory, joint),
        )

    def _estimate(
        self, run: Run, *, way: Way = "pem", inputs: int = 2, outputs: int = 2
    ) -> Estimate:
        """`estimate` of one run."""
        return estimate(run.decoupled, way=way, inputs=inputs, outputs=outputs)

    def _rng(self, *names: int) -> np.random.Generator:
        return np.random.default_rng([self.seed, *names])


def run_steps(study: Study, values: Values, levels: tuple[float, ...], joint: int) -> Trajectory:
    """An arm under its velocity servos, one of them told to step.

    Parameters
    ----------
    study : Study
    values : dict
        (name, joint) -> value, of the study's kinds of springs.
    levels : tuple of float [rad/s]
    joint : int
        From 1.

    Returns
    -------
    Trajectory
    """
    reference = excitation.steps(np.array(levels), hold=_STEP_SECONDS, clock=CLOCK)
    both = np.zeros((len(reference), 2))
    both[:, joint - 1] = reference
    drive = _drive(np.zeros_like(both), both, ("servo", "servo"))
    samples = round(len(both) * CLOCK / SAMPLE)
    return simulate(
        study, values, drive, sample_time=SAMPLE, samples=samples, record=_SENSORS + _TRUTH
    )


def ideal_log(trajectory: Trajectory, joint: int) -> Log:
    """A model's steps as the rig's sensors would log them, without noise.

    Parameters
    ----------
    trajectory : Trajectory
    joint : int

    Returns
    -------
    Log
    """
    experiment = Experiment("model", "model.csv", "tuning", ("servo", "servo"), joint)
    return _log(experiment, trajectory, None, np.random.default_rng(0))


def spring_torque(values: Values, joint: int, twist: FloatArray) -> FloatArray:
    """The three-slope law of one gear.

    Parameters
    ----------
    values : dict
    joint : int
    twist : (n_samples,) [rad]

    Returns
    -------
    (n_samples,) [N m]
    """
    k1, k2, k3 = slopes(values, joint)
    t1, t2 = (values[f"gear_knee_t{i}", joint] for i in (1, 2))
    first = t1 / k1
    second = first + (t2 - t1) / k2
    size = np.abs(twist)
    torque = (
        k1 * np.minimum(size, first)
        + k2 * np.clip(size - first, 0.0, second - first)
        + k3 * np.maximum(size - second, 0.0)
    )
    return np.asarray(np.sign(twist) * torque)


def slopes(values: Values, joint: int) -> tuple[float, float, float]:
    """K1, K2, K3 of one gear.

    Parameters
    ----------
    values : dict
    joint : int

    Returns
    -------
    tuple of float [N m/rad]
    """
    return (
        values["gear_stiffness_k1", joint],
        values["gear_stiffness_k2", joint],
        values["gear_stiffness_k3", joint],
    )


def joint_with(values: Values, joint: int, stiffness: float, ratio: float) -> TwoInertia:
    """One joint of the arm on its own, with a linear spring.

    Parameters
    ----------
    values : dict
    joint : int
    stiffness : float [N m/rad]
    ratio : float

    Returns
    -------
    TwoInertia
    """
    own = values["beta", None]
    if joint == 1:
        own += values["alpha", None] + 2.0 * values["gamma", None]
    return TwoInertia(
        motor_inertia=values["motor_inertia", joint],
        motor_viscous_friction=values["motor_viscous_friction", joint],
        link_inertia=own,
        link_viscous_friction=values["link_viscous_friction", joint],
        gear_stiffness=stiffness,
        gear_damping=values["gear_damping", joint],
        gear_ratio=ratio,
    )


def equivalent(study: Study, values: Values, trajectory: Trajectory, joint: int) -> TwoInertia:
    """The joint with the slope that fits its spring's torque over the whole run best.

    k = sum(T(delta) delta) / sum(delta^2), with the twist delta of the run.

    Parameters
    ----------
    study : Study
    values : dict
        With three slopes, or with one, which is then the answer.
    trajectory : Trajectory
    joint : int
        From 1.

    Returns
    -------
    TwoInertia
    """
    ratio = study.joints[joint - 1].gear_ratio
    if ("gear_stiffness", joint) in values:
        return joint_with(values, joint, values["gear_stiffness", joint], ratio)
    column = joint - 1
    twist = ratio * trajectory["motor_angle"][:, column] - trajectory["link_angle"][:, column]
    torque = spring_torque(values, joint, twist)
    return joint_with(values, joint, float(torque @ twist / (twist @ twist)), ratio)


def _drive(voltage: FloatArray, reference: FloatArray, control: tuple[Control, ...]) -> Drive:
    return Drive(
        tick=CLOCK,
        voltage=voltage,
        reference=reference,
        servo=tuple(c == "servo" for c in control),
        motor_angle=(0.0, 0.0),
        initial_voltage=(0.0, 0.0),
    )


def _log(
    experiment: Experiment,
    trajectory: Trajectory,
    noise: SensorNoise | None,
    rng: np.random.Generator,
) -> Log:
    measured = measure(trajectory, noise, rng)
    channels: dict[str, FloatArray] = {}
    names: dict[str, Quantity] = {"u": "voltage", "theta_m": "encoder", "a": "accelerometer"}
    for name, quantity in names.items():
        for column in range(measured[quantity].shape[1]):
            channels[f"{name}{column + 1}"] = measured[quantity][:, column]
    sample_time = float(trajectory.time[1] - trajectory.time[0])
    return Log(experiment, trajectory.time, sample_time, channels)
