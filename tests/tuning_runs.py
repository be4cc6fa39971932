"""Records of the virtual rig for the whole-arm fit, and inexact models of the earlier stages."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from strainwave.domain import (
    Control,
    Experiment,
    FloatArray,
    JointModel,
    Log,
    Parameter,
    Prbs,
    RigidModel,
    Study,
)
from strainwave.domain.arm.link_sensors import SensorAxis
from strainwave.domain.arm.link_sensors.link_space import Quantity
from strainwave.domain.arm.link_sensors.single_axis import Accelerometer, LinkEncoder
from strainwave.domain.keys import Values
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.simulation import Drive, PlannedRun, SensorNoise, plan_run, simulate
from strainwave.identification.whole_arm.problem.parameter_space import (
    ParameterSpace,
    Prior,
    Unknown,
)
from strainwave.identification.whole_arm.records.dataset import Dataset, Kernels, Motion, Variant
from strainwave.io.logs import read_log
from strainwave.io.study import read_study
from strainwave.signals.recorded_input import recorded_drive
from strainwave.virtual import scara
from strainwave.virtual.experiments import Simulator, derived, simulate_study

JOINT_NAMES = (
    "motor_inertia",
    "motor_viscous_friction",
    "link_inertia",
    "link_viscous_friction",
    "gear_stiffness",
    "gear_damping",
    "motor_coulomb_friction",
)


def truth(spring: str = "linear") -> tuple[Study, Values]:
    """Study and true parameters of the rig."""
    assert spring in ("linear", "three-slope")
    study = scara.STIFF.study(Path("nowhere"), "linear" if spring == "linear" else "three-slope")
    values = scara.STIFF.parameters(5, "linear" if spring == "linear" else "three-slope")
    return study, derived(values, study.arm)


@lru_cache(maxsize=8)
def rig_logs(spring: str = "linear", seed: int = 0) -> tuple[Study, tuple[Log, ...]]:
    """Steps of each joint to fit and for validation, and a motion for validation."""
    study, values = truth(spring)
    wanted = tuple(e for e in study.experiments if e.use in ("tuning", "check"))
    return simulated_logs(
        replace(study, experiments=wanted), values, seed=seed, noise=SensorNoise()
    )


def shaken_study(
    study: Study, amplitude: float, *, order: int = 9, joints: tuple[int, ...] = (1, 2)
) -> Study:
    """Study with one period of an open-loop PRBS on each joint as its experiments."""
    prbs = Prbs(order, 1e-3, 1, amplitude)
    free: tuple[Control, ...] = tuple("open" for _ in study.arm.joints)
    experiments = tuple(
        Experiment(f"prbs-j{j}", f"prbs-j{j}.parquet", "frequency", free, joint=j, prbs=prbs)
        for j in joints
    )
    return replace(study, experiments=experiments)


def simulated_logs(
    study: Study,
    values: Values,
    *,
    seed: int = 0,
    noise: SensorNoise | None = None,
    simulator: Simulator = simulate,
) -> tuple[Study, tuple[Log, ...]]:
    """All experiments of a study on a virtual arm, written and read again."""
    with TemporaryDirectory() as folder:
        simulate_study(
            study,
            values,
            Path(folder),
            seed=seed,
            noise=noise,
            as_recorded=False,
            simulator=simulator,
        )
        written = read_study(Path(folder) / "study.toml")
        return written, tuple(read_log(written, e) for e in written.experiments)


@lru_cache(maxsize=16)
def shaken(
    spring: str = "linear",
    amplitude: float = 10.0,
    settling: tuple[float, float] = (0.0, 0.0),
    *,
    noisy: bool = True,
    counts: bool = True,
    order: int = 9,
) -> tuple[Study, Values, tuple[Log, ...]]:
    """Short open-loop records of each joint, and the true parameters of the arm."""
    study, values = truth(spring)
    values |= {("friction_settling_time", i): t for i, t in enumerate(settling, start=1) if t}
    if not counts:
        joints = tuple(replace(joint, encoder_counts=None) for joint in study.arm.joints)
        study = replace(study, arm=replace(study.arm, joints=joints))
    wanted = shaken_study(study, amplitude, order=order)
    written, logs = simulated_logs(wanted, values, noise=SensorNoise() if noisy else None)
    return written, values, logs


def later(log: Log, first: int) -> Log:
    """The end of a record from one of its samples."""
    channels = {name: channel[first:] for name, channel in log.channels.items()}
    return replace(log, time=log.time[first:], channels=channels)


def beginning(study: Study, values: Values, log: Log, first: int) -> FloatArray:
    """True initial states of an open-loop record from one of its samples."""
    record: list[Quantity] = ["motor_velocity", "link_angle", "link_velocity"]
    run = simulate(
        Arm.of(study.arm),
        values,
        recorded_drive(Arm.of(study.arm), log),
        sample_time=log.sample_time,
        samples=len(log),
        record=record,
    )
    return np.concatenate([run[name][first] for name in record])


def joint_model(
    study: Study, joint: int, values: dict[str, float], covariance: FloatArray
) -> JointModel:
    """Joint model with values and standard deviations only."""
    return JointModel(
        joint=joint,
        experiments=("prbs",),
        method="grey-box",
        parameters=(),
        values=values,
        covariance=covariance,
        anti_resonance=None,
        resonance=None,
        band_hz=(1.0, 100.0),
        fit_percent={},
        status="determined",
    )


def joint_models(
    study: Study, known: Values, share: float, factors: FloatArray
) -> tuple[JointModel, ...]:
    """Joint models with errors of a factor (1 + share factor) and matching standard deviations.

    Coulomb friction is exact. A three-slope gear has one stiffness between its first two slopes.
    """
    models = []
    for joint in range(1, study.arm.n_joints + 1):
        if ("gear_stiffness_k1", joint) in known:
            low, high = (known[f"gear_stiffness_k{k}", joint] for k in (1, 2))
            known = {**known, ("gear_stiffness", joint): 0.5 * (low + high)}
    for joint in range(1, study.arm.n_joints + 1):
        true = np.array([known[name, joint] for name in JOINT_NAMES])
        wrong = true * (1.0 + share * np.append(factors[joint - 1], 0.0))
        deviation = share * true
        deviation[-1] *= 1e-3
        named = dict(zip(JOINT_NAMES, wrong.tolist(), strict=True))
        models.append(joint_model(study, joint, named, np.diag(deviation**2)))
    return tuple(models)


def rigid_model(study: Study, known: Values, share: float, factor: float = 0.0) -> RigidModel:
    """Rigid model with standard deviations of a share of each value.

    Inertias and gravity differ by `factor` standard deviations; friction is exact.
    """
    columns = Arm.of(study.arm).rigid_columns
    known = derived(known, study.arm)
    if study.arm.n_joints == 1:
        ratio = study.arm.joints[0].gear_ratio
        known["inertia", 1] = known["motor_inertia", 1] + ratio**2 * known["link_inertia", 1]
    values = np.array([known[c.name, c.joint] for c in columns])
    # the friction offset is zero: its standard deviation is a share of the friction
    size = [
        known["motor_coulomb_friction", c.joint] if c.name == "friction_offset" else abs(v)
        for c, v in zip(columns, values, strict=True)
    ]
    deviation = share * np.array(size)
    values += factor * deviation * np.array(["friction" not in c.name for c in columns])
    parameters = tuple(
        Parameter(c.name, c.joint, float(v), float(d), c.unit, "rigid")
        for c, v, d in zip(columns, values, deviation, strict=True)
    )
    return RigidModel(
        parameters=parameters,
        solution=values,
        covariance=np.diag(deviation**2),
        condition_number=1.0,
        fit_percent={},
        bandwidth_hz=10.0,
        decimation=1,
        n_rows=1,
        status="determined",
    )


def simulated(
    record: Dataset, values: Mapping[tuple[str, int | None], float], local: FloatArray
) -> FloatArray:
    """Channels of a record simulated without derivatives: (n_rows, n_channels)."""
    return record.filtered_channels(record.run(values, local, record.quantities()), values)


@dataclass(frozen=True, slots=True)
class LinearRecord(Dataset):
    """Record whose channels are linear in the parameters and do not depend on an initial state."""

    table: FloatArray  # (n_rows, n_channels, n_unknowns)

    def plan(self, *_: object) -> PlannedRun:
        """A run of the true arm, which `linearise` does not read."""
        values = truth()[1]
        return plan_run(
            self.arm,
            values,
            self.drive,
            sample_time=1e-3,
            samples=1,
            record=["motor_angle"],
            max_time_step=1e-4,
        )

    @property
    def n(self) -> int:
        return int(self.table.shape[2])

    def linearise(
        self,
        values: Mapping[tuple[str, int | None], float],
        local: FloatArray,
        directions: Sequence[tuple[str, int | None]],
        simulated: Motion | None = None,
        *,
        slope: FloatArray | None = None,
        variants: Sequence[Variant] = (),
    ) -> tuple[FloatArray, FloatArray]:
        asked = [int(name[1:]) for name, _ in directions]
        parameters = np.array([values[f"p{k}", None] for k in range(self.n)])
        slope = np.eye(len(asked)) if slope is None else slope
        return np.asarray(self.table @ parameters), self.table[..., asked] @ slope


def linear_search(n: int, prior: Prior | None = None) -> ParameterSpace:
    """Unknowns that are their own coordinates."""
    unknowns = tuple(Unknown(f"p{k}", None, "1", 0.0, 1.0, True, 1e6) for k in range(n))
    return ParameterSpace(unknowns, {}, prior or Prior.empty(n))


def linear_record(
    table: FloatArray, measured: FloatArray, *, noise: float = 1e-6, shifted: bool = False
) -> LinearRecord:
    """Record of that arm; with `shifted`, each channel has an unknown constant."""
    study, _ = truth()
    n, n_channels = measured.shape
    time: FloatArray = 1e-3 * np.arange(n, dtype=np.float64)
    experiment = Experiment("linear", "linear.csv", "frequency", ("open", "open"))
    still = np.zeros((1, 2))
    sensor = (Accelerometer if shifted else LinkEncoder).of_joint(study.arm.joints[0])
    return LinearRecord(
        log=Log(experiment, time, 1e-3, {}),
        arm=Arm.of(study.arm),
        cutoff_hz=100.0,
        drive=Drive(1e-3, still, still, (False, False), (0.0, 0.0), (0.0, 0.0)),
        channels=(SensorAxis(sensor, 1),) * n_channels,
        kernels=Kernels(np.ones(1), np.ones(1), 1),
        time=time,
        measured=measured,
        noise=np.full(n_channels, noise),
        counts=(0.0,) * n_channels,
        begins_in_motion=False,
        max_time_step=1e-3,
        step_error_correction=np.zeros(measured.shape),
        hold_change=still,
        table=table,
    )
