"""The tuned arm under its servos: Figs. 7 and 8."""

from __future__ import annotations

import numpy as np

from strainwave.domain import Comparison, Criterion, FloatArray
from strainwave.domain.parameters import Values
from strainwave.identification.closed_loop import as_known
from strainwave.numerics.filters import band_pass, low_pass
from strainwave.paper.claims import compared
from strainwave.paper.rig import TUNING_STEPS, Rig, Tuned, ideal_log, run_steps
from strainwave.presentation.figures import Figure
from strainwave.presentation.figures.curves import Series, pair
from strainwave.signals.link_motion import link_side

_CHECKS = ((0.0, 60.0, 0.0), (0.0, 20.0, -20.0))  # levels of the validation data
_SEEN_HZ = 100.0  # above it a velocity is noise
_RINGING_HZ = (5.0, 60.0)  # where the gears vibrate and the servo hardly acts
_GOOD = 97.0  # [%]
_WIDTH = "what the curves of a printed plot such as the source's can differ by unseen"


def tuning(rig: Rig, before: Tuned, after: Tuned) -> Comparison:
    """Fig. 7: a step of joint 1 and the model's answer, before and after tuning."""
    fits, rings, plots = [], [], []
    for name, model_of in (("before", before), ("after", after)):
        measured, model, time = _answers(rig, model_of.values, TUNING_STEPS, 0)
        fits.append(_fit(measured, model))
        rings.append(_fit(_ringing(measured, time), _ringing(model, time)))
        plots.append(_plot(measured, model, time, f"Step of joint 1, {name} tuning"))
    return compared(
        7,
        criteria=(
            Criterion(
                "fit of the link velocity after tuning, less that before [%]",
                fits[1] - fits[0],
                "at least",
                0.0,
                "the source claims an improvement and no size of it",
                rig.settings.why_not_better,
            ),
        ),
        evidence=(*before.evidence, *after.evidence),
        values={"vibration fit before [%]": rings[0], "vibration fit after [%]": rings[1]},
        message=f"fit of the link velocity {fits[0]:.1f} % before, {fits[1]:.1f} % after; of the "
        f"vibration above {_RINGING_HZ[0]:g} Hz {rings[0]:.1f} % and {rings[1]:.1f} %",
        plots=tuple(plots),
    )


def validation(rig: Rig, tuned: Tuned) -> Comparison:
    """Fig. 8: steps of the validation data."""
    fits, plots = [], []
    for number, levels in enumerate(_CHECKS, start=1):
        measured, model, time = _answers(rig, tuned.values, levels, number)
        fits.append(_fit(measured, model))
        named = " to ".join(f"{level:g}" for level in levels)
        plots.append(_plot(measured, model, time, f"Reference {named} rad/s of the motor"))
    return compared(
        8,
        criteria=(
            Criterion("least fit of the link velocity [%]", min(fits), "at least", _GOOD, _WIDTH),
        ),
        evidence=tuned.evidence,
        message="fits of the link velocity " + " and ".join(f"{fit:.1f} %" for fit in fits),
        plots=tuple(plots),
    )


def _answers(
    rig: Rig, values: Values, levels: tuple[float, ...], number: int
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Link velocity of the arm and of the model, both from the same sensors by the same way."""
    joint = 1
    log = rig.steps(levels, joint, number)
    own = run_steps(as_known(rig.arm, values), values, levels, joint)
    velocities = []
    for record in (log, ideal_log(own, joint)):
        velocity = link_side(record, rig.arm).link_velocity[:, joint - 1]
        velocities.append(low_pass(velocity, _SEEN_HZ, record.sample_time))
    return velocities[0], velocities[1], log.time


def _ringing(velocity: FloatArray, time: FloatArray) -> FloatArray:
    return band_pass(velocity, *_RINGING_HZ, float(time[1] - time[0]))


def _fit(measured: FloatArray, model: FloatArray) -> float:
    away = np.linalg.norm(measured - measured.mean())
    return float(100.0 * (1.0 - np.linalg.norm(measured - model) / away))


def _plot(measured: FloatArray, model: FloatArray, time: FloatArray, caption: str) -> Figure:
    return pair(
        Series("arm", time, measured),
        Series("model", time, model),
        "link velocity [rad/s]",
        caption,
    )
