"""Step responses of the tuned arm under its servos: Figs. 7 and 8."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from strainwave.domain import Comparison, FloatArray
from strainwave.domain.keys import Values
from strainwave.identification.closed_loop import restrict_to_values
from strainwave.numerics.filters import band_pass, low_pass
from strainwave.paper.document import comparison_of, criterion_of
from strainwave.paper.rig import Rig, WholeArmEstimate, ideal_log, run_steps
from strainwave.presentation.figures import Figure
from strainwave.presentation.figures.curves import Series, pair
from strainwave.signals.link_motion import prepare_link_signals

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
