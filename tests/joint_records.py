"""Decoupled PRBS records of one joint of a virtual arm, with an inexact rigid model."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from elastic_runs import log_of, prbs_run, rig, rig_values, true_model
from strainwave.domain import Decoupled, LinkSignals, RigidModel, Study
from strainwave.domain.keys import Values
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.two_inertia import TwoInertia
from strainwave.identification import decoupling
from strainwave.signals import link_motion as links

RIGID_ERROR = 1e-3
"""Relative, of every parameter of the rigid model: that of a good motion record."""


@dataclass(frozen=True)
class Case:
    """Inputs of a stage and the true result."""

    study: Study
    values: Values
    model: RigidModel
    signals: LinkSignals
    decoupled: Decoupled
    truth: TwoInertia

    @property
    def records(self) -> list[tuple[LinkSignals, Decoupled]]:
        return [(self.signals, self.decoupled)]


@cache
def case(seed: int, joint: int = 1) -> Case:
    """The rig with gears and motors changed by up to 30 %; both joints are excited."""
    rng = np.random.default_rng(seed)
    study = rig()
    values = rig_values(study)
    for (name, number), value in values.items():
        if number is not None:
            values[name, number] = value * float(np.exp(rng.uniform(-0.26, 0.26)))
    run = prbs_run(study, joint, both=True, values=values)
    model = erring(true_model(study, values), rng)
    signals = links.prepare_link_signals(log_of(run, joint, seed=seed), Arm.of(study.arm))
    decoupled = decoupling.decouple(signals, model, Arm.of(study.arm))[joint - 1]
    return Case(study, values, model, signals, decoupled, truth_of(values, joint))


def erring(model: RigidModel, rng: np.random.Generator) -> RigidModel:
    """Rigid model with errors drawn from its covariance."""
    deviation = RIGID_ERROR * np.abs(model.solution)
    solution = model.solution + deviation * rng.standard_normal(len(deviation))
    parameters = tuple(
        replace(p, value=float(v), std=float(d))
        for p, v, d in zip(model.parameters, solution, deviation, strict=True)
    )
    return replace(
        model, parameters=parameters, solution=solution, covariance=np.diag(deviation**2)
    )


def truth_of(values: Values, joint: int) -> TwoInertia:
    """True model of the decoupled joint with the arm stretched."""
    alpha, beta, gamma = (values[name, None] for name in ("alpha", "beta", "gamma"))
    return TwoInertia(
        motor_inertia=values["motor_inertia", joint],
        motor_viscous_friction=values["motor_viscous_friction", joint],
        link_inertia=alpha + beta + 2.0 * gamma if joint == 1 else beta,
        link_viscous_friction=values["link_viscous_friction", joint],
        gear_stiffness=values["gear_stiffness", joint],
        gear_damping=values["gear_damping", joint],
        gear_ratio=0.01,
    )
