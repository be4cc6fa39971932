"""From the first response to the tuned model: Figs. 6 and 9."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from strainwave.comparisons.estimates import (
    Estimate,
    curve,
    distance_db,
    response_of,
)
from strainwave.comparisons.rig import Rig, equivalent
from strainwave.errors import NotIdentifiable
from strainwave.parameters import Values
from strainwave.physical import identify_joint
from strainwave.physical.two_inertia import NAMES, TwoInertia, from_coefficients, joint_of
from strainwave.records import Comparison
from strainwave.report.curves import bode
from strainwave.statespace import frequency_response

_LINES_HZ = np.geomspace(0.02, 100.0, 320)  # down to where friction limits the velocity
_WHOLE_HZ = (0.02, 100.0)
_SLOW_HZ = (0.02, 1.0)


@dataclass(frozen=True, slots=True)
class Stages:
    """One joint's model at each stage."""

    initial: Estimate  # state space
    modified: TwoInertia  # its zeros and pole pair, with the rigid model's lag, (18)


def stages(rig: Rig, joint: int) -> Stages:
    """The state-space model of a joint, and the physical one that (18) makes of it.

    Parameters
    ----------
    rig : Rig
    joint : int
        From 1.

    Returns
    -------
    Stages

    Raises
    ------
    NotIdentifiable
        The state-space model has no pair of zeros below a pair of poles.
    """
    run = rig.prbs(joint)
    found = rig.estimate(run)
    zero, pole = found.anti_resonance, found.resonance
    if zero is None or pole is None:
        raise NotIdentifiable(f"the state-space model of joint {joint} does not ring")
    pairs = []
    for mode in (zero, pole):
        w = 2.0 * np.pi * mode.frequency_hz
        pairs.append(np.array([2.0 * mode.damping / w, 1.0 / w**2]))
    lag = np.array([run.decoupled.total_viscous_friction or 0.0, run.decoupled.total_inertia])
    ratio = run.study.joints[joint - 1].gear_ratio
    return Stages(found, from_coefficients(pairs[0], pairs[1], lag, ratio))


def modified_values(rig: Rig) -> Values:
    """All parameters of the arm as (18) gives them, before any tuning.

    Parameters
    ----------
    rig : Rig

    Returns
    -------
    dict
        (name, joint) -> value; linear springs.
    """
    return _values(rig, {joint: stages(rig, joint).modified for joint in (1, 2)})


def grey_box_values(rig: Rig) -> Values:
    """All parameters of the arm as the equations of motion give them, joint by joint.

    Parameters
    ----------
    rig : Rig

    Returns
    -------
    dict
        (name, joint) -> value; linear springs.
    """
    found = {}
    for joint in (1, 2):
        run = rig.prbs(joint)
        model = identify_joint([(run.signals, run.decoupled)], rig.rigid(rig.payload), run.study)
        vector = np.array([model.values[name] for name in NAMES])
        found[joint] = joint_of(vector, run.study.joints[joint - 1].gear_ratio)
    return _values(rig, found)


def responses(rig: Rig, joint: int, tuned: Values) -> Comparison:
    """Figs. 6 and 9: initial, modified and tuned response of one joint.

    Parameters
    ----------
    rig : Rig
    joint : int
    tuned : dict
        (name, joint) -> value.

    Returns
    -------
    Comparison
    """
    run = rig.prbs(joint)
    made = stages(rig, joint)
    optimised = equivalent(run.study, tuned, run.trajectory, joint)
    truth = response_of(run.truth, _LINES_HZ)
    physical = {"modified": made.modified, "tuned": optimised}
    drawn = {name: response_of(model, _LINES_HZ) for name, model in physical.items()}
    if made.initial.continuous is not None:
        first = frequency_response(made.initial.continuous, _LINES_HZ)
        drawn = {"initial": first} | drawn
    curves = curve("truth", truth, true=True)
    off: dict[str, float] = {}
    true = truth.response[:, 0, 0]
    for name, response in drawn.items():
        curves += curve(name, response, band=True)
        found = response.response[:, 0, 0]
        off[f"{name}_db"] = distance_db(found, true, _LINES_HZ, _WHOLE_HZ)
        off[f"{name}_slow_db"] = distance_db(found, true, _LINES_HZ, _SLOW_HZ)
    gear = {
        "stiffness_error_percent": optimised.gear_stiffness / run.truth.gear_stiffness,
        "gear_damping_error_percent": optimised.gear_damping / run.truth.gear_damping,
    }
    gear = {name: 100.0 * (ratio - 1.0) for name, ratio in gear.items()}
    holds = off["modified_db"] < off["initial_db"] and off["tuned_db"] < off["initial_db"]
    return Comparison(
        figure=6 if joint == 1 else 9,
        title=f"Frequency responses of joint {joint} before and after refinement",
        claim="The rigid model's low-frequency lag, and then tuning, bring the first response "
        "closer to the joint's own.",
        holds=holds,
        values={**off, **gear},
        message=f"off by {off['initial_db']:.2f} dB at first, {off['modified_db']:.2f} dB with "
        f"the rigid lag, {off['tuned_db']:.2f} dB tuned (rms, 0.02 to 100 Hz); below 1 Hz "
        f"{off['initial_slow_db']:.2f}, {off['modified_slow_db']:.2f} and "
        f"{off['tuned_slow_db']:.2f} dB{_why(off, gear)}",
        plots=(bode(curves, f"Joint {joint}: motor torque to motor velocity"),),
    )


def _why(off: Mapping[str, float], gear: Mapping[str, float]) -> str:
    if off["modified_db"] >= off["initial_db"]:
        return "; the lag of the state-space model was the better one here"
    if off["tuned_db"] >= off["initial_db"]:
        return (
            f"; tuning ended {gear['stiffness_error_percent']:+.1f} % in stiffness and "
            f"{gear['gear_damping_error_percent']:+.0f} % in gear damping from this record's truth"
        )
    return ""


def _values(rig: Rig, joints: Mapping[int, TwoInertia]) -> Values:
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
