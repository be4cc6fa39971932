"""Synthetic identification of the elastic rig, computed from its true values."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.linalg import expm

from results import arm_model, identification, prediction
from strainwave.domain import (
    ComplexArray,
    Decoupled,
    Experiment,
    FloatArray,
    FrequencyResponse,
    Identification,
    JointModel,
    Log,
    Parameter,
    RecordModel,
    SearchEnd,
    StateSpace,
    Study,
    TorqueHistogram,
)
from strainwave.domain.arm.description import unit_of
from strainwave.dynamics.two_inertia import (
    NAMES,
    TwoInertia,
    anti_resonance,
    resonance,
    state_space,
)
from strainwave.virtual import scara

JOINT = TwoInertia(1.5e-4, 2e-4, 3.8, 0.5, 25000.0, 20.0, 0.01)
SPREAD = 0.02
"""Relative deviation of each physical parameter, independent of the others."""
BAND = (5.0, 50.0)
SAMPLE = 1e-3
CURVE = {
    "gear_stiffness_k1": (16000.0, 160.0),
    "gear_stiffness_k2": (25000.0, 250.0),
    "gear_stiffness_k3": (29000.0, 900.0),
    "gear_knee_t1": (7.0, 0.2),
    "gear_knee_t2": (25.0, 1.0),
}


def study() -> Study:
    return scara.STIFF.study(Path("rig/study.toml"), "three-slope")


def response(f: FloatArray) -> ComplexArray:
    """G11 of the joint."""
    model = state_space(JOINT)
    s = 2j * np.pi * f[:, None, None]
    return np.asarray(
        (model.C @ np.linalg.solve(s * np.eye(3) - model.A, model.B.astype(complex)))[:, 0, 0]
    )


def measured() -> FrequencyResponse:
    """Frequency response of the joint, without information above 60 Hz."""
    f = np.arange(1.0, 500.0)
    G = np.zeros((len(f), 2, 2), dtype=np.complex128)
    G[:, 0, 0] = response(f)
    coherence = np.repeat(np.where(f > 60.0, 0.3, 0.99)[:, None], 2, axis=1)
    return FrequencyResponse(f, G, coherence=coherence, method="welch", n_averages=8)


def joint_model(number: int = 1) -> JointModel:
    covariance = np.diag((SPREAD * JOINT.vector) ** 2)
    own = study().arm.joints[number - 1]
    parameters = tuple(
        Parameter(
            name, number, v, SPREAD * v, unit_of(name, own), "decoupled", (0.96 * v, 1.04 * v)
        )
        for name, v in zip(NAMES, JOINT.vector.tolist(), strict=True)
    )
    return JointModel(
        joint=number,
        experiments=("prbs-j1",),
        method="grey-box",
        parameters=parameters,
        values=dict(zip(NAMES, JOINT.vector.tolist(), strict=True)),
        covariance=covariance,
        anti_resonance=anti_resonance(JOINT, covariance),
        resonance=resonance(JOINT, covariance),
        band_hz=BAND,
        fit_percent={"torque": 99.0, "torsion": 98.0},
        status="determined",
    )


def sampled() -> StateSpace:
    """Discrete-time model of the joint with zero-order hold."""
    model = state_space(JOINT)
    block = np.zeros((5, 5))
    block[:3, :3], block[:3, 3:] = model.A, model.B
    stepped = expm(SAMPLE * block)
    return StateSpace(
        A=stepped[:3, :3],
        B=stepped[:3, 3:],
        C=model.C,
        D=np.zeros((2, 2)),
        K=np.zeros((3, 2)),
        noise_covariance=np.eye(2),
        initial_states=np.zeros((1, 3)),
        sample_time=SAMPLE,
        hold=("zero", "zero"),
        method="pem",
        status=SearchEnd.CONVERGED,
        fit_percent=(99.0, 99.0),
        prediction_fit_percent=(99.0, 99.0),
        n_samples=1000,
        n_parameters=20,
        log_likelihood=0.0,
    )


def decoupled(name: str, size: float, *, use: str = "frequency", joint: int = 1) -> Decoupled:
    """A record with motor motion at 10 Hz and link motion at 20 Hz."""
    time: FloatArray = SAMPLE * np.arange(4000, dtype=np.float64)
    motor = np.sin(2.0 * np.pi * 10.0 * time)
    other = size / JOINT.gear_ratio * np.sin(2.0 * np.pi * 20.0 * time)
    experiment = Experiment(name, f"{name}.csv", use, ("open", "open"), joint)  # type: ignore[arg-type]
    return Decoupled(
        experiment=experiment,
        joint=joint,
        time=time,
        sample_time=SAMPLE,
        inputs=np.column_stack([motor, other]),
        outputs=np.zeros((4000, 2)),
        valid=np.ones(4000, dtype=bool),
        held=True,
        gear_ratio=JOINT.gear_ratio,
        total_inertia=None,
        total_viscous_friction=None,
        bandwidth_hz=None,
        shared=(),
        fusion=None,
        richness_hz=np.linspace(1.0, 40.0, 40),
        checks=(),
    )


def record_model(name: str, size: float) -> RecordModel:
    return RecordModel(decoupled(name, size), joint_model(), sampled(), None, None)


def curve_parameters(**changed: float | None) -> tuple[tuple[Parameter, ...], FloatArray]:
    """Gear curve and its covariance; None removes a parameter."""
    reported = []
    for name, (value, std) in CURVE.items():
        shown = changed.get(name, value)
        reported.append(Parameter(name, 1, shown, None if shown is None else std, "-", "tuned"))
    return tuple(reported), np.diag([std**2 for _, std in CURVE.values()])


def log(name: str) -> Log:
    """A record of the drives, the motor angles and one accelerometer."""
    time: FloatArray = SAMPLE * np.arange(4000, dtype=np.float64)
    wave = np.sin(2.0 * np.pi * 10.0 * time)
    channels = {"u1": 10.0 * wave, "u2": 0.0 * wave, "theta_m1": wave, "theta_m2": wave, "a1": wave}
    experiment = Experiment(name, f"{name}.csv", "frequency", ("open", "open"), 1)
    return Log(experiment, time, SAMPLE, channels)


def elastic_identification() -> Identification:
    parameters, covariance = curve_parameters()
    edges = np.linspace(0.0, 60.0, 61)
    share = np.diff(1.0 - np.exp(-edges / 10.0))
    whole_arm = replace(
        arm_model(parameters, covariance),
        simulated=(prediction("step-j1", 99.0, 98.0),),
        gear_loads=(TorqueHistogram(1, edges, share / share.sum()),),
    )
    return replace(
        identification(),
        study=study(),
        stages=("rigid", "decoupled", "tuned"),
        records=(record_model("prbs-j1", 0.5), record_model("prbs-j1-held", 0.2)),
        joints=(joint_model(),),
        responses={1: measured()},
        whole_arm=whole_arm,
        logs=(log("prbs-j1"),),
    )
