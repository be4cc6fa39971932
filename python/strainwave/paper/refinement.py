"""From the first response to the tuned model: Figs. 6 and 9."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from strainwave.domain import Comparison, Criterion, Evidence, JointModel
from strainwave.domain.parameters import Values
from strainwave.dynamics.two_inertia import NAMES, TwoInertia, joint_of
from strainwave.errors import NotIdentifiable
from strainwave.paper.claims import compared
from strainwave.paper.estimates import Estimate, curve, distance_db, response_evidence, response_of
from strainwave.paper.rig import Rig, Tuned
from strainwave.paper.truth import equivalent
from strainwave.presentation.figures.curves import bode
from strainwave.statespace import frequency_response

_LINES_HZ = np.geomspace(0.02, 100.0, 320)  # down to where friction limits the velocity
_WHOLE_HZ = (0.02, 100.0)
_SLOW_HZ = (0.02, 1.0)
_BETTER = "the source claims an improvement and no size of it"


@dataclass(frozen=True, slots=True)
class Stages:
    """One joint's model at each stage."""

    initial: Estimate  # state space
    modified: TwoInertia  # its zeros and pole pair, with the rigid model's lag, (18)
    evidence: Evidence  # of the latter


def stages(rig: Rig, joint: int) -> Stages:
    """The state-space model of a joint, and the physical one that (18) makes of it.

    `joint`: From 1. Raises `NotIdentifiable`: The state-space model has no pair of zeros and of
    poles.
    """
    run = rig.prbs(joint)
    model = rig.transfer(joint)
    modified = _joint(model, run.decoupled.gear_ratio)
    said = response_evidence(model, modified, f"joint {joint} by (18)")
    return Stages(rig.estimate(run), modified, said)


def modified_values(rig: Rig) -> Tuned:
    """All parameters of the arm as (18) gives them, before any tuning.

    Returns: Linear springs. Raises `NotIdentifiable`: As `stages`.
    """
    made = {joint: stages(rig, joint) for joint in (1, 2)}
    found = {joint: model.modified for joint, model in made.items()}
    evidence = [
        evidence
        for joint, model in made.items()
        for evidence in (
            model.initial.evidence,
            model.evidence,
        )
    ]
    return Tuned(_values(rig, found), tuple(evidence))


def responses(rig: Rig, joint: int, tuned: Tuned) -> Comparison:
    """Figs. 6 and 9: initial, modified and tuned response of one joint."""
    run = rig.prbs(joint)
    made = stages(rig, joint)
    optimised = equivalent(run.arm, tuned.values, run.trajectory, joint)
    truth = response_of(run.truth, _LINES_HZ)
    drawn = {
        name: response_of(model, _LINES_HZ)
        for name, model in (("modified", made.modified), ("tuned", optimised))
    }
    if made.initial.continuous is not None:
        first = frequency_response(made.initial.continuous, _LINES_HZ)
        drawn = {"initial": first} | drawn
    curves = curve("truth", truth, true=True)
    off = dict.fromkeys(("initial_db", "initial_slow_db"), float("nan"))
    true = truth.response[:, 0, 0]
    for name, response in drawn.items():
        curves += curve(name, response, band=True)
        found = response.response[:, 0, 0]
        off[f"{name}_db"] = distance_db(found, true, _LINES_HZ, _WHOLE_HZ)
        off[f"{name}_slow_db"] = distance_db(found, true, _LINES_HZ, _SLOW_HZ)
    gear = {
        "tuned: error of the stiffness [%]": optimised.gear_stiffness / run.truth.gear_stiffness,
        "tuned: error of the gear damping [%]": optimised.gear_damping / run.truth.gear_damping,
    }
    gear = {name: 100.0 * (ratio - 1.0) for name, ratio in gear.items()}
    return compared(
        6 if joint == 1 else 9,
        criteria=(
            Criterion(
                "error below 1 Hz with (18), less that of the first response [dB]",
                off["modified_slow_db"] - off["initial_slow_db"],
                "at most",
                0.0,
                _BETTER,
                "the lag of the state-space model was the better one",
            ),
            Criterion(
                "error over the whole band tuned, less that with (18) [dB]",
                off["tuned_db"] - off["modified_db"],
                "at most",
                0.0,
                _BETTER,
                ", ".join(
                    [rig.settings.why_not_better, *(f"{k} {v:+.1f}" for k, v in gear.items())]
                ),
            ),
        ),
        evidence=(
            made.initial.evidence,
            made.evidence,
            *tuned.evidence,
        ),
        values={**off, **gear},
        message=f"off by {off['initial_db']:.2f} dB at first, {off['modified_db']:.2f} dB with "
        f"the rigid lag, {off['tuned_db']:.2f} dB tuned (rms, 0.02 to 100 Hz); below 1 Hz "
        f"{off['initial_slow_db']:.2f}, {off['modified_slow_db']:.2f} and "
        f"{off['tuned_slow_db']:.2f} dB",
        plots=(bode(curves, f"Joint {joint}: motor torque to motor velocity"),),
    )


def _joint(model: JointModel, ratio: float) -> TwoInertia:
    return joint_of(np.array([model.values[name] for name in NAMES]), ratio)


def _values(rig: Rig, joints: dict[int, TwoInertia]) -> Values:
    """Joints on their own, put together with what the rigid model knows of the arm."""
    model = rig.rigid(rig.payload)
    values: Values = {}
    for name in ("beta", "gamma"):
        values[name, None] = _known(model.value(name))
    for joint, found in joints.items():
        n2 = found.gear_ratio**2
        total = found.motor_viscous_friction + n2 * found.link_viscous_friction
        link = min(max(found.link_viscous_friction, 0.0), max(total, 0.0) / n2)
        values |= {
            ("motor_inertia", joint): found.motor_inertia,
            # only the sum is well known, so a share that came out negative is none
            ("motor_viscous_friction", joint): max(total - n2 * link, 0.0),
            ("link_viscous_friction", joint): link,
            ("gear_stiffness", joint): found.gear_stiffness,
            ("gear_damping", joint): max(found.gear_damping, 0.0),
            ("motor_coulomb_friction", joint): _known(model.value("motor_coulomb_friction", joint)),
            ("friction_offset", joint): model.value("friction_offset", joint) or 0.0,
        }
    own = joints[1].gear_ratio ** 2
    total_inertia = _known(model.value("rigid_inertia", 1))
    values["alpha", None] = total_inertia - values["motor_inertia", 1] / own
    return values


def _known(value: float | None) -> float:
    if value is None:
        raise NotIdentifiable("the rigid model of the virtual arm is not complete")
    return value
