"""Step responses of the tuned arm under its servos: Figs. 7 and 8."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from strainwave.domain import Comparison, Criterion, FloatArray
from strainwave.domain.keys import Values
from strainwave.identification.closed_loop import restrict_to_values
from strainwave.numerics.filters import band_pass, low_pass
from strainwave.paper.claims import comparison_of
from strainwave.paper.rig import TUNING_STEPS, Rig, WholeArmEstimate, ideal_log, run_steps
from strainwave.presentation.figures import Figure
from strainwave.presentation.figures.curves import Series, pair
from strainwave.signals.link_motion import prepare_link_signals

_VALIDATION_STEPS = ((0.0, 60.0, 0.0), (0.0, 20.0, -20.0))  # [rad/s] of the motor
_MAX_SIGNAL_HZ = 100.0  # above, the velocity is noise
_VIBRATION_HZ = (5.0, 60.0)  # band of the gears' vibration, above that of the servo
_MIN_FIT = 97.0  # [%]
_MIN_FIT_REASON = "a smaller difference is not visible in a printed plot"


def tuning(rig: Rig, before: WholeArmEstimate, after: WholeArmEstimate) -> Comparison:
    """Fig. 7: step of joint 1 and the response of the model before and after tuning."""
    fits, vibration_fits, plots = [], [], []
    for name, model_of in (("before", before), ("after", after)):
        measured, model, time = _link_velocities(rig, model_of.values, TUNING_STEPS, 0)
        fits.append(_fit(measured, model))
        vibration_fits.append(_fit(_vibration(measured, time), _vibration(model, time)))
        plots.append(_plot(measured, model, time, f"Step of joint 1, {name} tuning"))
    return comparison_of(
        7,
        criteria=(
            Criterion(
                "fit of the link velocity after tuning, less that before [%]",
                fits[1] - fits[0],
                "at least",
                0.0,
                "the source claims an improvement without a size",
                rig.settings.why_not_better,
            ),
        ),
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
    for number, levels in enumerate(_VALIDATION_STEPS, start=1):
        measured, model, time = _link_velocities(rig, whole_arm.values, levels, number)
        fits.append(_fit(measured, model))
        level_list = " to ".join(f"{level:g}" for level in levels)
        plots.append(_plot(measured, model, time, f"Reference {level_list} rad/s of the motor"))
    return comparison_of(
        8,
        criteria=(
            Criterion(
                "least fit of the link velocity [%]",
                min(fits),
                "at least",
                _MIN_FIT,
                _MIN_FIT_REASON,
            ),
        ),
        evidence=whole_arm.evidence,
        message="fits of the link velocity " + " and ".join(f"{fit:.1f} %" for fit in fits),
        plots=tuple(plots),
    )


class _StepResponse(NamedTuple):
    measured: FloatArray
    model: FloatArray
    time: FloatArray


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


def _vibration(velocity: FloatArray, time: FloatArray) -> FloatArray:
    return band_pass(velocity, *_VIBRATION_HZ, float(time[1] - time[0]))


def _fit(measured: FloatArray, model: FloatArray) -> float:
    spread = np.linalg.norm(measured - measured.mean())
    return float(100.0 * (1.0 - np.linalg.norm(measured - model) / spread))


def _plot(measured: FloatArray, model: FloatArray, time: FloatArray, caption: str) -> Figure:
    return pair(
        Series("arm", time, measured),
        Series("model", time, model),
        "link velocity [rad/s]",
        caption,
    )
