"""The tuned arm under its servos: Figs. 7 and 8."""

from __future__ import annotations

import numpy as np

from strainwave.closed_loop import as_known
from strainwave.comparisons.rig import Rig, ideal_log, run_steps
from strainwave.filters import band_pass, low_pass
from strainwave.links import link_side
from strainwave.parameters import Values
from strainwave.records import Comparison, FloatArray
from strainwave.report.curves import Series, pair
from strainwave.report.figures import Figure

_TUNING = (0.0, 40.0, 0.0)  # [rad/s] of the motor
_CHECKS = ((0.0, 60.0, 0.0), (0.0, 20.0, -20.0))  # levels that tuning never saw
_SEEN_HZ = 100.0  # above it a velocity is noise
_RINGING_HZ = (5.0, 60.0)  # where the gears vibrate and the servo hardly acts
_GOOD = 90.0  # [%]


def tuning(rig: Rig, before: Values, after: Values) -> Comparison:
    """Fig. 7: a step of joint 1 and the model's answer, before and after tuning.

    Parameters
    ----------
    rig : Rig
    before, after : dict
        (name, joint) -> value.

    Returns
    -------
    Comparison
    """
    fits, rings, plots = [], [], []
    for name, values in (("before", before), ("after", after)):
        measured, model, time = _answers(rig, values, _TUNING, 0)
        fits.append(_fit(measured, model))
        rings.append(_fit(_ringing(measured, time), _ringing(model, time)))
        plots.append(_plot(measured, model, time, f"Step of joint 1, {name} tuning"))
    return Comparison(
        figure=7,
        title="Step responses of joint 1 before and after tuning",
        claim="Tuning brings the simulated step closer to the measured one.",
        holds=fits[1] > fits[0] and rings[1] > rings[0],
        values={
            "before_fit_percent": fits[0],
            "after_fit_percent": fits[1],
            "before_ringing_fit_percent": rings[0],
            "after_ringing_fit_percent": rings[1],
        },
        message=f"fit of the link velocity {fits[0]:.1f} % before, {fits[1]:.1f} % after; of what "
        f"rings above {_RINGING_HZ[0]:g} Hz {rings[0]:.1f} % and {rings[1]:.1f} %"
        + ("" if fits[1] > fits[0] else "; the first model was as good, there was little to gain"),
        plots=tuple(plots),
    )


def validation(rig: Rig, tuned: Values) -> Comparison:
    """Fig. 8: steps that the tuning never saw.

    Parameters
    ----------
    rig : Rig
    tuned : dict

    Returns
    -------
    Comparison
    """
    fits, plots = [], []
    for number, levels in enumerate(_CHECKS, start=1):
        measured, model, time = _answers(rig, tuned, levels, number)
        fits.append(_fit(measured, model))
        named = " to ".join(f"{level:g}" for level in levels)
        plots.append(_plot(measured, model, time, f"Reference {named} rad/s of the motor"))
    return Comparison(
        figure=8,
        title="Validation steps of joint 1",
        claim="The tuned model foretells steps of other sizes.",
        holds=min(fits) >= _GOOD,
        values={f"fit_percent_{k}": fit for k, fit in enumerate(fits, start=1)},
        message="fits of the link velocity "
        + " and ".join(f"{fit:.1f} %" for fit in fits)
        + ("" if min(fits) >= _GOOD else f", the least below {_GOOD:g} %"),
        plots=tuple(plots),
    )


def _answers(
    rig: Rig, values: Values, levels: tuple[float, ...], number: int
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Link velocity of the arm and of the model, both from the same sensors by the same way."""
    joint = 1
    log = rig.steps(levels, joint, number)
    own = run_steps(as_known(rig.study, values), values, levels, joint)
    velocities = []
    for record in (log, ideal_log(own, joint)):
        velocity = link_side(record, rig.study).link_velocity[:, joint - 1]
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
