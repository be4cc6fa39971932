"""A synthetic identification."""

from __future__ import annotations

import numpy as np

from strainwave.domain import (
    ArmModel,
    Cause,
    Criticism,
    Diagnostic,
    FloatArray,
    Identification,
    Parameter,
    ParameterShift,
    Place,
    Prediction,
    ResidualCorrelation,
    ResidualTest,
    RigidModel,
    SearchEnd,
)
from virtual_arms import rigid_two_link


def prediction(name: str, *fits: float) -> Prediction:
    time: FloatArray = 0.01 * np.arange(5000, dtype=np.float64)
    measured = np.column_stack([np.sin(3.0 * time + k) for k in range(len(fits))])
    channels = tuple(f"torque{k + 1}" for k in range(len(fits)))
    return Prediction(
        name, time, channels, measured, 0.9 * measured, dict(zip(channels, fits, strict=True))
    )


def arm_model(parameters: tuple[Parameter, ...], covariance: FloatArray) -> ArmModel:
    """A whole-arm fit with these parameters."""
    return ArmModel(
        parameters=parameters,
        values={(p.name, p.joint): p.value or 0.0 for p in parameters},
        covariance=covariance,
        fit_percent={"prbs-j1": {"omega_m1": 99.0}},
        initial_fit_percent={"prbs-j1": {"omega_m1": 80.0}},
        simulated=(),
        initial=(),
        iterations=7,
        end=SearchEnd.CONVERGED,
        criticism=criticism(),
    )


def criticism() -> Criticism:
    """Criticism with one unexplained channel and an effect that would explain it."""
    frequency = np.linspace(0.0, 100.0, 51)
    left = ResidualTest(
        "prbs-j1",
        "a1",
        deviation=0.3,
        noise=0.1,
        frequency_hz=frequency,
        density=1e-3 / (1.0 + frequency),
        noise_density=np.full(51, 1e-5),
        worst_hz=22.0,
        whiteness=1e-9,
        input_joint=1,
        input_correlation=-0.4,
        input_delay=0.006,
        input_probability=1e-20,
        correlation=ResidualCorrelation(
            lag_time=5e-3,
            n_samples=1000,
            autocorrelation=np.exp(-np.arange(26.0)),
            cross_correlation=np.column_stack([np.sinc(np.arange(-25.0, 26.0)), np.zeros(51)]),
            cross_std=np.array([0.05, 0.05]),
        ),
    )
    moved = ParameterShift("gear_damping", 1, 40.0, -16.0, -30.0)
    torque = Parameter("hysteresis_torque", 1, 2.1, 0.1, "N m", "tuned", (1.9, 2.3))
    cause = Cause(1, "hysteresis", (torque,), 440.0, 0.3, (moved,))
    return Criticism((left,), (cause,))


def identification(name: str = "inertia") -> Identification:
    parameters = (
        Parameter(name, 1, 0.0201, 0.0002, "kg m^2", "rigid", (0.0197, 0.0205)),
        Parameter("friction_offset", 1, None, None, "N m", "rigid"),
    )
    model = RigidModel(
        parameters=parameters,
        solution=np.array([0.0201, 0.0]),
        covariance=np.diag([4e-8, np.nan]),
        condition_number=12.5,
        fit_percent={"motion": {"torque1": 97.5}},
        bandwidth_hz=5.0,
        decimation=40,
        n_rows=300,
        status="partly-determined",
    )
    return Identification(
        study=rigid_two_link(),
        created="2026-01-01T00:00:00+00:00",
        version="0.1.0",
        stages=("rigid",),
        rigid=model,
        fitted=(prediction("motion", 97.5),),
        checks=(prediction("check", 91.25, float("nan")),),
        stage_warnings=(
            Diagnostic("saturated", Place.in_records("motion"), channel="u1", share=0.1),
        ),
        timing_s={"read": 0.01, "rigid": 0.5},
    )
