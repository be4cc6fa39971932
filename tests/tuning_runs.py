"""Tuning records of the virtual rig, and models of the stages before as wrong as they say."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from strainwave import scara
from strainwave.logs import read_log
from strainwave.parameters import Values
from strainwave.records import FloatArray, JointModel, Log, Parameter, RigidModel, Study
from strainwave.regressor import columns_of
from strainwave.simulation import SensorNoise
from strainwave.study import read_study
from strainwave.virtual import derived, simulate_study

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
    """The rig's study and everything that is true of it."""
    assert spring in ("linear", "three-slope")
    study = scara.study(Path("nowhere"), "linear" if spring == "linear" else "three-slope")
    values = scara.parameters(5, "linear" if spring == "linear" else "three-slope")
    return study, derived(values, study)


@lru_cache(maxsize=8)
def rig_logs(spring: str = "linear", seed: int = 0) -> tuple[Study, tuple[Log, ...]]:
    """Steps of either joint, for tuning and as a check, and a motion as a check."""
    study, values = truth(spring)
    wanted = tuple(e for e in study.experiments if e.use in ("tuning", "check"))
    with TemporaryDirectory() as folder:
        simulate_study(
            replace(study, experiments=wanted),
            values,
            Path(folder),
            seed=seed,
            noise=SensorNoise(),
            replay=False,
        )
        written = read_study(Path(folder) / "study.toml")
        return written, tuple(read_log(written, e) for e in written.experiments)


def joint_model(
    study: Study, joint: int, values: dict[str, float], covariance: FloatArray
) -> JointModel:
    """A joint's model that only says its values and how far they may be off."""
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
    """Values times (1 + share factor), deviations to match; Coulomb friction is known."""
    models = []
    for joint in range(1, study.n_joints + 1):
        true = np.array([known[name, joint] for name in JOINT_NAMES])
        wrong = true * (1.0 + share * np.append(factors[joint - 1], 0.0))
        deviation = share * true
        deviation[-1] *= 1e-3
        named = dict(zip(JOINT_NAMES, wrong.tolist(), strict=True))
        models.append(joint_model(study, joint, named, np.diag(deviation**2)))
    return tuple(models)


def rigid_model(study: Study, known: Values, share: float, factor: float = 0.0) -> RigidModel:
    """beta and gamma times (1 + share factor), with that deviation; friction as it is."""
    columns = columns_of(study)
    values = np.array([known.get((c.name, c.joint), 0.0) for c in columns])
    deviation = np.array(
        [share * abs(v) if c.joint is None else 1e-6 for c, v in zip(columns, values, strict=True)]
    )
    values += factor * np.array(
        [d if c.joint is None else 0.0 for c, d in zip(columns, deviation, strict=True)]
    )
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
