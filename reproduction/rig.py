"""Experiments of the built-in arm as its sensors log them, decoupled, with the true values.

Settings of recording and estimation for the comparisons.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path

import numpy as np

from reproduction.joint_estimates import JointEstimate, estimate, evidence_of, growth_of
from reproduction.records import Evidence, Protocol
from strainwave.domain import (
    ArmDescription,
    Control,
    Decoupled,
    Experiment,
    FloatArray,
    JointModel,
    LinearOptions,
    LinkOptions,
    LinkSignals,
    Log,
    Prbs,
    RigidModel,
    WholeArmOptions,
)
from strainwave.domain.arm.gear_laws import gear_law
from strainwave.domain.arm.link_sensors.link_space import Quantity
from strainwave.domain.keys import Values
from strainwave.domain.study import PUBLISHED_OPTIONS, Channels, EstimationMethod
from strainwave.dynamics import excitation
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.simulation import Drive, SensorNoise, Trajectory, measure, simulate
from strainwave.dynamics.two_inertia import NAMES, TwoInertia, joint_of
from strainwave.errors import NotIdentifiable
from strainwave.identification import rigid
from strainwave.identification.decoupling import decouple
from strainwave.identification.joint_model import from_state_space, identify_joint, rigid_knowledge
from strainwave.identification.whole_arm import fit_whole_arm
from strainwave.signals import motor as signals
from strainwave.signals.link_motion import prepare_link_signals
from strainwave.virtual.experiments import STEP_HOLD, smooth_reference
from strainwave.virtual.scara import SOFT, BuiltInArm


def slopes(values: Values, joint: int) -> list[float]:
    """Slopes [N m/rad] of one gear, from the innermost."""
    return [values[name, joint] for name in gear_law("three-slope").slopes]


def joint_with(values: Values, joint: int, stiffness: float, ratio: float) -> TwoInertia:
    """One joint of the arm with a linear spring [N m/rad]."""
    link_inertia = values["beta", None]
    if joint == 1:
        link_inertia += values["alpha", None] + 2.0 * values["gamma", None]
    drive = {name: values[name, joint] for name in NAMES if (name, joint) in values}
    drive |= {"link_inertia": link_inertia, "gear_stiffness": stiffness}
    return joint_of(np.array([drive[name] for name in NAMES]), ratio)


def gear_torque(
    arm: ArmDescription, values: Values, trajectory: Trajectory, joint: int
) -> tuple[FloatArray, FloatArray]:
    """Torsion [rad] and torque [N m] (n_samples,) of a gear with three slopes."""
    column, law = joint - 1, gear_law("three-slope")
    ratio = arm.joints[column].gear_ratio
    torsion = ratio * trajectory["motor_angle"][:, column] - trajectory["link_angle"][:, column]
    return torsion, law.torque(law.of_joint(values, joint), torsion)


def equivalent(
    arm: ArmDescription, values: Values, trajectory: Trajectory, joint: int
) -> TwoInertia:
    """Joint with the equivalent stiffness, which fits the spring torque over the record best.

        k = sum(T(delta) delta) / sum(delta^2)

    delta is the torsion of the record. `values` have three slopes, or one stiffness, which is then
    k.
    """
    ratio = arm.joints[joint - 1].gear_ratio
    if ("gear_stiffness", joint) in values:
        return joint_with(values, joint, values["gear_stiffness", joint], ratio)
    torsion, torque = gear_torque(arm, values, trajectory, joint)
    return joint_with(values, joint, float(torque @ torsion / (torsion @ torsion)), ratio)


CLASSICAL_METHOD: EstimationMethod = "moesp"
"""One of the weightings of MATLAB's n4sid. Feedback biases it."""


@dataclass(frozen=True, slots=True)
class Settings:
    """Settings from an experiment to a model."""

    protocol: Protocol
    sample_time: float  # [s] of the logs
    periods: int  # of the PRBS, 1023 clocks of 1 ms each
    links: LinkOptions = field(default_factory=LinkOptions)
    linear: LinearOptions = field(default_factory=LinearOptions)
    tuning: WholeArmOptions = field(default_factory=WholeArmOptions)
    records: int = 4  # of one period at each amplitude of Figs. 14 and 15


OWN_SETTINGS = Settings("own", sample_time=2.5e-4, periods=4)
"""Default settings of `identify`."""

PUBLISHED_SETTINGS = Settings(
    "as-published",
    sample_time=2.5e-5,
    periods=1,
    links=PUBLISHED_OPTIONS.links,
    linear=PUBLISHED_OPTIONS.statespace,
    tuning=PUBLISHED_OPTIONS.tuning,
    records=1,
)
"""Settings of the source: 0.025 ms, one period of 1.023 s, decimated to 2 ms, order 4."""


Progress = Callable[[str], None]

DEFAULT_PAYLOAD = 5  # [kg] of most comparisons
MAX_AMPLITUDE = 10.0  # [V] limit of the rig's drives
CLOCK_PERIOD = 1e-3  # [s] of servo and PRBS
PRBS_ORDER = 10  # of the PRBS: 1023 clocks
STEP_SAMPLE_TIME = 2.5e-4  # [s] of step records
_SERVOS: tuple[Control, Control] = ("servo", "servo")
_SENSORS: tuple[Quantity, ...] = ("voltage", "encoder", "accelerometer")
_TRUTH: tuple[Quantity, ...] = ("motor_angle", "link_angle", "link_velocity", "link_acceleration")


@dataclass(frozen=True, slots=True, eq=False)
class Run:
    """One experiment: measurements of the excited joint, and its true model."""

    name: str
    arm: Arm
    values: Values
    trajectory: Trajectory  # noise-free
    log: Log
    signals: LinkSignals
    decoupled: Decoupled
    truth: TwoInertia  # with the equivalent stiffness of the record


@dataclass(frozen=True, slots=True)
class WholeArmEstimate:
    """Parameters of the arm with its full payload, fitted at once."""

    values: Values
    evidence: tuple[Evidence, ...]


class Rig:
    """A built-in arm with three-slope gears and noisy sensors. Runs are cached.

    `seed` is that of sensor noise, motions and the start of the PRBS.
    """

    def __init__(
        self,
        seed: int,
        settings: Settings = OWN_SETTINGS,
        progress: Progress = lambda _: None,
        built_in: BuiltInArm = SOFT,
    ) -> None:
        self.seed = seed
        self.built_in = built_in
        self.settings = settings
        self.progress = progress
        self.payload = DEFAULT_PAYLOAD
        self.arm = Arm.of(built_in.study(Path("rig")).arm)
        self.rigid = cache(self._rigid)
        self.prbs = cache(self._prbs)
        self.estimate = cache(self._estimate)
        self.physical = cache(self._physical)
        self.transfer = cache(self._transfer)
        self.whole_arm = cache(self._whole_arm)
        self._prbs_start = int(self._rng(3).integers(2**PRBS_ORDER - 1))

    def tuning_steps(self, joint: int) -> tuple[float, ...]:
        """Reference [rad/s] of a motor in the record for fine tuning."""
        return (0.0, self.built_in.step_speed[joint - 1], 0.0)

    def clear_caches(self) -> None:
        """Release all runs and models, which take some hundred megabytes."""
        models = (self.rigid, self.estimate, self.physical, self.transfer, self.whole_arm)
        for function in (self.prbs, *models):
            function.cache_clear()

    def steps(self, levels: tuple[float, ...], joint: int, number: int) -> Log:
        """Log of steps of one servo's reference with the other servo's reference at zero.

        `levels` [rad/s] are those of the motor for half a second each. `number` selects the noise.
        """
        values = self.built_in.parameters(DEFAULT_PAYLOAD)
        trajectory = run_steps(self.arm, values, levels, joint)
        name = f"steps-j{joint}-{number}"
        experiment = Experiment(name, f"{name}.csv", "tuning", _SERVOS, joint)
        log = _log(experiment, trajectory, SensorNoise(), self._rng(2, joint, number))
        reference = _reference(levels, joint)
        ticks = np.floor(log.time / CLOCK_PERIOD + 1e-9).astype(int)
        references = {f"ref{i}": reference[ticks, i - 1] for i in (1, 2)}
        return replace(log, channels={**log.channels, **references})

    def _rigid(self, disks: int) -> RigidModel:
        """Rigid model from a servoed motion of both joints."""
        self.progress(f"rigid step with {disks} kg")
        rng = self._rng(0, disks)
        reference = np.column_stack(
            [smooth_reference(joint.gear_ratio, CLOCK_PERIOD, rng) for joint in self.arm.joints]
        )
        values = self.built_in.parameters(disks)
        trajectory = _simulated(self.arm, values, _SERVOS, CLOCK_PERIOD, reference=reference)
        experiment = Experiment("motion", "motion.csv", "motion", _SERVOS)
        log = _log(experiment, trajectory, SensorNoise(), rng)
        return rigid.fit_rigid([signals.prepare_motor_signals(log, self.arm)], self.arm)

    def _prbs(
        self,
        joint: int,
        *,
        disks: int = DEFAULT_PAYLOAD,
        amplitude: float = MAX_AMPLITUDE,
        periods: int | None = None,
        other: Control = "open",
        start: int = 0,
    ) -> Run:
        """One joint under PRBS in open loop, the other free or servoed.

        `start` is the clock of the sequence at which the record starts, relative to that of the
        seed.
        """
        control: tuple[Control, Control] = ("open", other) if joint == 1 else (other, "open")
        count = periods or self.settings.periods
        sequence = excitation.prbs(Prbs(PRBS_ORDER, CLOCK_PERIOD, count, amplitude))
        voltage = np.zeros((len(sequence), 2))
        voltage[:, joint - 1] = np.roll(sequence, -start - self._prbs_start)
        values = self.built_in.parameters(disks)
        trajectory = _simulated(
            self.arm, values, control, self.settings.sample_time, voltage=voltage
        )
        loop = "servoed" if other == "servo" else "free"
        name = f"joint {joint} at {amplitude:g} V, {disks} kg, joint {3 - joint} {loop}"
        file = f"prbs-j{joint}"
        experiment = Experiment(file, f"{file}.csv", "frequency", control, joint)
        rng = self._rng(
            1, joint, disks, round(1e3 * amplitude), count, int(other == "servo"), start
        )
        log = _log(experiment, trajectory, SensorNoise(), rng)
        links = prepare_link_signals(log, self.arm, self.settings.links)
        return Run(
            name=name,
            arm=self.arm,
            values=values,
            trajectory=trajectory,
            log=log,
            signals=links,
            decoupled=decouple(links, self.rigid(disks), self.arm)[joint - 1],
            truth=equivalent(self.arm, values, trajectory, joint),
        )

    def _estimate(
        self,
        *runs: Run,
        method: EstimationMethod | None = None,
        inputs: Channels = "both",
        outputs: Channels = "both",
        order: int | None = None,
    ) -> JointEstimate:
        """State-space model of one joint with the given changes of the settings."""
        linear = self.settings.linear
        linear = replace(
            linear,
            method=method or linear.method,
            inputs=inputs,
            outputs=outputs,
            order=order or linear.order,
        )
        restrictions = [
            text
            for text, channels in (("motor input only", inputs), ("one output", outputs))
            if channels == "motor"
        ]
        name = ", ".join([linear.method, runs[0].name, *restrictions])
        return estimate([run.decoupled for run in runs], linear, name)

    def _physical(self, *runs: Run, disks: int = DEFAULT_PAYLOAD) -> JointModel:
        """Physical parameters of one joint from its equations of motion."""
        return identify_joint(
            [(run.signals, run.decoupled) for run in runs], self.rigid(disks), self.arm
        )

    def _transfer(self, joint: int) -> JointModel:
        """Physical parameters from the state-space model and the rigid model's lag, (18)."""
        run = self.prbs(joint)
        estimate = self.estimate(run)
        if estimate.model is None:
            raise NotIdentifiable(estimate.evidence.warnings[-1].message)
        known = rigid_knowledge(self.rigid(DEFAULT_PAYLOAD), self.arm, joint)
        return from_state_space(estimate.model, run.decoupled, self.arm, known)

    def _whole_arm(self) -> WholeArmEstimate:
        """All parameters from a PRBS and a step of each joint, or as published."""
        self.progress("fine tuning")
        logs = [self.steps(self.tuning_steps(joint), joint, 0) for joint in (1, 2)]
        arm, name = self.arm, "whole arm"
        if self.settings.tuning.as_published:
            joints = [self.transfer(joint) for joint in (1, 2)]
            arm = arm.with_joints(replace(joint, spring="linear") for joint in arm.joints)
            name = "fine tuning as published"
        else:
            runs = [self.prbs(joint) for joint in (1, 2)]
            joints = [self.physical(run) for run in runs]
            logs += [run.log for run in runs]
        model = fit_whole_arm(logs, self.rigid(DEFAULT_PAYLOAD), joints, arm, self.settings.tuning)
        values, evidence = dict(model.values), evidence_of(model, name)
        if self.settings.tuning.as_published:  # the ranges are part of the method
            growth = max(
                growth_of(joint_with(values, number, values["gear_stiffness", number], ratio))
                for number, ratio in enumerate((j.gear_ratio for j in arm.joints), start=1)
            )
            evidence = replace(evidence, growth=growth)
        return WholeArmEstimate(values, (evidence,))

    def _rng(self, *names: int) -> np.random.Generator:
        return np.random.default_rng([self.seed, *names])


def run_steps(arm: Arm, values: Values, levels: tuple[float, ...], joint: int) -> Trajectory:
    """Trajectory of an arm under its velocity servos, one of them with a reference of steps.

    `values` have the springs of `arm`. `levels` [rad/s].
    """
    reference = _reference(levels, joint)
    return _simulated(arm, values, _SERVOS, STEP_SAMPLE_TIME, reference=reference)


def _reference(levels: tuple[float, ...], joint: int) -> FloatArray:
    """References (n_ticks, 2) [rad/s]; that of the other servo is zero."""
    steps = excitation.steps(np.array(levels), hold=STEP_HOLD, clock=CLOCK_PERIOD)
    both = np.zeros((len(steps), 2))
    both[:, joint - 1] = steps
    return both


def ideal_log(trajectory: Trajectory, joint: int) -> Log:
    """Log of a model's steps with the sensors of the rig, without noise."""
    experiment = Experiment("model", "model.csv", "tuning", _SERVOS, joint)
    return _log(experiment, trajectory, None, np.random.default_rng(0))


def _simulated(
    arm: Arm,
    values: Values,
    control: tuple[Control, ...],
    sample_time: float,
    *,
    voltage: FloatArray | None = None,
    reference: FloatArray | None = None,
) -> Trajectory:
    """Trajectory from rest under one of the inputs, (n_ticks, 2); the other is zero."""
    given = reference if voltage is None else voltage
    assert given is not None
    drive = Drive(
        tick=CLOCK_PERIOD,
        voltage=np.zeros_like(given) if voltage is None else voltage,
        reference=np.zeros_like(given) if reference is None else reference,
        servo=tuple(c == "servo" for c in control),
        motor_angle=(0.0, 0.0),
        initial_voltage=(0.0, 0.0),
    )
    samples = round(len(given) * CLOCK_PERIOD / sample_time)
    return simulate(
        arm, values, drive, sample_time=sample_time, samples=samples, record=_SENSORS + _TRUTH
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
