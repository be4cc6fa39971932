"""Models from the first response to the tuned arm, and its step responses: Figs. 6 to 9."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from reproduction.document import comparison_of, criterion_of
from reproduction.joint_estimates import (
    JointEstimate,
    curve,
    distance_db,
    evidence_of,
    growth_of,
    response_of,
)
from reproduction.records import Comparison, Evidence
from reproduction.rig import Rig, WholeArmEstimate, equivalent, ideal_log, run_steps
from strainwave.domain import FloatArray
from strainwave.domain.keys import Values
from strainwave.dynamics.two_inertia import TwoInertia, joint_of
from strainwave.errors import NotIdentifiable
from strainwave.identification.closed_loop import restrict_to_values
from strainwave.identification.joint_model.agreement import vector_of
from strainwave.numerics.filters import band_pass, low_pass
from strainwave.report.figures import Figure
from strainwave.report.figures.curves import Series, bode, pair
from strainwave.signals.link_motion import prepare_link_signals
from strainwave.statespace import frequency_response

_LINES_HZ = np.geomspace(0.02, 100.0, 320)  # from frequencies at which friction dominates
_FULL_BAND_HZ = (0.02, 100.0)  # of response errors
_LOW_BAND_HZ = (0.02, 1.0)  # in which the lag of the rigid model dominates


@dataclass(frozen=True, slots=True)
class Stages:
    """Models of one joint."""

    initial: JointEstimate  # state space
    modified: TwoInertia  # zeros and pole pair of `initial`, lag of the rigid model, (18)
    evidence: Evidence  # of `modified`


def stages(rig: Rig, joint: int) -> Stages:
    """State-space model of a joint, from 1, and the physical model that (18) derives from it.

    Raises NotIdentifiable if the state-space model has no pair of zeros or of poles.
    """
    run = rig.prbs(joint)
    model = rig.transfer(joint)
    modified = joint_of(vector_of(model), run.decoupled.gear_ratio)
    # the model is judged by its response, not by single parameters
    evidence = replace(evidence_of(model, f"joint {joint} by (18)"), growth=growth_of(modified))
    return Stages(rig.estimate(run), modified, evidence)


def modified_values(rig: Rig) -> WholeArmEstimate:
    """Parameters of the arm by (18) with linear springs, before tuning.

    Raises NotIdentifiable as `stages` does.
    """
    models = {joint: stages(rig, joint) for joint in (1, 2)}
    modified = {joint: model.modified for joint, model in models.items()}
    evidence = [e for m in models.values() for e in (m.initial.evidence, m.evidence)]
    return WholeArmEstimate(_values(rig, modified), tuple(evidence))


def responses(rig: Rig, joint: int, whole_arm: WholeArmEstimate) -> Comparison:
    """Figs. 6 and 9: initial, modified and tuned response of one joint."""
    run = rig.prbs(joint)
    models = stages(rig, joint)
    tuned_joint = equivalent(run.arm, whole_arm.values, run.trajectory, joint)
    truth = response_of(run.truth, _LINES_HZ)
    plotted = {
        name: response_of(model, _LINES_HZ)
        for name, model in (("modified", models.modified), ("tuned", tuned_joint))
    }
    if models.initial.continuous is not None:
        first = frequency_response(models.initial.continuous, _LINES_HZ)
        plotted = {"initial": first} | plotted
    curves = curve("truth", truth, true=True)
    errors = dict.fromkeys(("initial_db", "initial_slow_db"), float("nan"))
    true = truth.response[:, 0, 0]
    for name, response in plotted.items():
        curves += curve(name, response, band=True)
        estimate = response.response[:, 0, 0]
        errors[f"{name}_db"] = distance_db(estimate, true, _LINES_HZ, _FULL_BAND_HZ)
        errors[f"{name}_slow_db"] = distance_db(estimate, true, _LINES_HZ, _LOW_BAND_HZ)
    gear = {
        "tuned: error of the stiffness [%]": tuned_joint.gear_stiffness / run.truth.gear_stiffness,
        "tuned: error of the gear damping [%]": tuned_joint.gear_damping / run.truth.gear_damping,
    }
    gear = {name: 100.0 * (ratio - 1.0) for name, ratio in gear.items()}
    return comparison_of(
        6 if joint == 1 else 9,
        criteria=(
            criterion_of("slow-error", errors["modified_slow_db"] - errors["initial_slow_db"]),
            criterion_of(
                "tuned-error",
                errors["tuned_db"] - errors["modified_db"],
                ", ".join(f"{name} {value:+.1f}" for name, value in gear.items()),
            ),
        ),
        evidence=(models.initial.evidence, models.evidence, *whole_arm.evidence),
        values={**errors, **gear},
        message=f"off by {errors['initial_db']:.2f} dB at first, {errors['modified_db']:.2f} dB "
        f"with the rigid lag, {errors['tuned_db']:.2f} dB tuned (rms, 0.02 to 100 Hz); below 1 Hz "
        f"{errors['initial_slow_db']:.2f}, {errors['modified_slow_db']:.2f} and "
        f"{errors['tuned_slow_db']:.2f} dB",
        plots=(bode(curves, f"Joint {joint}: motor torque to motor velocity"),),
    )


def _values(rig: Rig, joints: dict[int, TwoInertia]) -> Values:
    """Arm parameters from single joints and the rigid model."""
    rigid = rig.rigid(rig.payload)
    values: Values = {}
    for name in ("beta", "gamma"):
        values[name, None] = _known(rigid.value(name))
    for joint, model in joints.items():
        n2 = model.gear_ratio**2
        total = model.motor_viscous_friction + n2 * model.link_viscous_friction
        link = min(max(model.link_viscous_friction, 0.0), max(total, 0.0) / n2)
        values |= {
            ("motor_inertia", joint): model.motor_inertia,
            # only the sum is well determined, so a negative part is set to zero
            ("motor_viscous_friction", joint): max(total - n2 * link, 0.0),
            ("link_viscous_friction", joint): link,
            ("gear_stiffness", joint): model.gear_stiffness,
            ("gear_damping", joint): max(model.gear_damping, 0.0),
            ("motor_coulomb_friction", joint): _known(rigid.value("motor_coulomb_friction", joint)),
            ("friction_offset", joint): rigid.value("friction_offset", joint) or 0.0,
        }
    n2 = joints[1].gear_ratio ** 2
    total_inertia = _known(rigid.value("rigid_inertia", 1))
    values["alpha", None] = total_inertia - values["motor_inertia", 1] / n2
    return values


def _known(value: float | None) -> float:
    if value is None:
        raise NotIdentifiable("the rigid model of the virtual arm is not complete")
    return value


_VALIDATION_STEPS = ((0.0, 1.5, 0.0), (0.0, 0.5, -0.5))  # over the speed of the tuning steps
_MAX_SIGNAL_HZ = 100.0  # above, the velocity is noise
_VIBRATION_HZ = (5.0, 60.0)  # band of the gears' vibration, above that of the servo


def tuning(rig: Rig, before: WholeArmEstimate, after: WholeArmEstimate) -> Comparison:
    """Fig. 7: step of joint 1 and the response of the model before and after tuning."""
    models = {"before": before, "after": after}
    steps = [_link_velocities(rig, m.values, rig.tuning_steps(1), 0) for m in models.values()]
    fits = [step.fit() for step in steps]
    vibration_fits = [step.vibration().fit() for step in steps]
    plots = [
        step.plot(f"Step of joint 1, {name} tuning")
        for name, step in zip(models, steps, strict=True)
    ]
    return comparison_of(
        7,
        criteria=(criterion_of("tuned-fit", fits[1] - fits[0]),),
        evidence=(*before.evidence, *after.evidence),
        values={
            "vibration fit before [%]": vibration_fits[0],
            "vibration fit after [%]": vibration_fits[1],
        },
        message=f"fit of the link velocity {fits[0]:.1f} % before, {fits[1]:.1f} % after; of the "
        f"vibration above {_VIBRATION_HZ[0]:g} Hz {vibration_fits[0]:.1f} % and "
        f"{vibration_fits[1]:.1f} %",
        plots=tuple(plots),
    )


def validation(rig: Rig, whole_arm: WholeArmEstimate) -> Comparison:
    """Fig. 8: steps for validation."""
    fits, plots = [], []
    for number, shares in enumerate(_VALIDATION_STEPS, start=1):
        levels = tuple(share * rig.built_in.step_speed[0] for share in shares)
        step = _link_velocities(rig, whole_arm.values, levels, number)
        fits.append(step.fit())
        level_list = " to ".join(f"{level:g}" for level in levels)
        plots.append(step.plot(f"Reference {level_list} rad/s of the motor"))
    return comparison_of(
        8,
        criteria=(criterion_of("validation-fit", min(fits)),),
        evidence=whole_arm.evidence,
        message="fits of the link velocity " + " and ".join(f"{fit:.1f} %" for fit in fits),
        plots=tuple(plots),
    )


class _StepResponse(NamedTuple):
    """Link velocities of the arm and of the model."""

    measured: FloatArray
    model: FloatArray
    time: FloatArray

    def fit(self) -> float:
        """Fit of the model [%]."""
        spread = np.linalg.norm(self.measured - self.measured.mean())
        return float(100.0 * (1.0 - np.linalg.norm(self.measured - self.model) / spread))

    def vibration(self) -> _StepResponse:
        """The part in the band of the gears' vibration."""
        T = float(self.time[1] - self.time[0])
        measured, model = (band_pass(v, *_VIBRATION_HZ, T) for v in (self.measured, self.model))
        return _StepResponse(measured, model, self.time)

    def plot(self, caption: str) -> Figure:
        """Both velocities and their difference."""
        arm = Series("arm", self.time, self.measured)
        model = Series("model", self.time, self.model)
        return pair(arm, model, "link velocity [rad/s]", caption)


def _link_velocities(
    rig: Rig, values: Values, levels: tuple[float, ...], number: int
) -> _StepResponse:
    """Link velocities of the arm and of the model, from the same sensors."""
    joint = 1
    log = rig.steps(levels, joint, number)
    model = run_steps(restrict_to_values(rig.arm, values), values, levels, joint)
    velocities = []
    for record in (log, ideal_log(model, joint)):
        velocity = prepare_link_signals(record, rig.arm).link_velocity[:, joint - 1]
        velocities.append(low_pass(velocity, _MAX_SIGNAL_HZ, record.sample_time))
    return _StepResponse(velocities[0], velocities[1], log.time)
