"""All numbers of a servo design as JSON.

Units of a joint's servo: the input of the drive, and the coordinate of the motor.
"""

from __future__ import annotations

import json
import tomllib
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from strainwave.domain import Joint
from strainwave.domain.arm.description import INPUTS, ControlLaw
from strainwave.tune.closed_loop import Gains, Steps
from strainwave.tune.damping import Damping
from strainwave.tune.design import JointServo, ServoDesign
from strainwave.tune.margins import Margins, margin_summaries
from strainwave.tune.observer import OUTPUTS, Observer
from strainwave.tune.shapers import RankedShaper
from strainwave.tune.verification import EstimationError


@dataclass(frozen=True, slots=True)
class Units:
    """Units of one joint."""

    angle: str  # of the motor
    input: str  # of the drive: a voltage, or a torque
    torque: str  # at the motor

    @classmethod
    def of(cls, joint: Joint) -> Units:
        """The units; without `torque_per_volt` the input is a torque."""
        angle, torque = ("m", "N") if joint.motion == "prismatic" else ("rad", "N m")
        return cls(angle, torque if joint.torque_per_volt is None else "V", torque)

    @property
    def kp(self) -> str:
        """Input per velocity."""
        return f"{self.input} s/{self.angle}"

    @property
    def ki(self) -> str:
        """Input per angle."""
        return f"{self.input}/{self.angle}"


SCHEMA = "strainwave/servo/1"

_TEXTS = tomllib.loads(Path(__file__).with_name("servo.toml").read_text(encoding="utf-8"))
_READING = (
    *("name", "channels", "weights", "quantity", "factor", "unit", "std", "source"),
    "has_bias",
)
_ERRORS = tuple(
    field.name for field in fields(EstimationError) if field.name not in ("joint", "time", "errors")
)


def to_json(design: ServoDesign) -> str:
    """Gains, filters, laws, margins, shapers and the conditions that they hold for.

    A number that is not finite, such as the margin of a loop without crossing, is null.
    """
    options = design.options
    document = {
        "schema": SCHEMA,
        "source": design.arm.source,
        "units": _TEXTS["units"],
        "equations": _TEXTS["equations"],
        "inputs": INPUTS,
        "period": design.clock.period,
        "delay": design.clock.delay,
        "required_margins": asdict(options.required),
        "required_bandwidth_hz": options.bandwidth_hz,
        "draws": options.draws,
        "seed": options.seed,
        "plants": design.n_plants,
        "conditions": [
            {
                "posture": one.posture.tolist(),
                "payload": one.payload and {"mass": one.payload.mass, "xyz": one.payload.xyz},
            }
            for one in design.conditions
        ],
        "joints": [_joint(design, joint) for joint in design.joints],
        "modes_hz": design.modes_hz.tolist(),
        "shapers": [_shaper(shaper) for shaper in design.shapers],
        "observer_equations": _TEXTS["observer_equations"],
        "observers": [_observer(design, one) for one in design.observers],
        "damping": [_damping(design, one) for one in design.dampings],
    }
    return json.dumps(_finite(document), indent=2, allow_nan=False) + "\n"


def _joint(design: ServoDesign, servo: JointServo) -> dict[str, Any]:
    number = servo.joint
    units = Units.of(design.arm.joint(number))
    results = servo.current_results
    current = servo.current and {
        **_gains(servo.current),
        "is_stable": results is not None,
        "margins": results and _margins(design, results.margins),
        "step": results and _step(results.steps),
    }
    return {
        "joint": number,
        "name": design.arm.study.arm.joint_names[number - 1],
        "units": {"motor_angle": units.angle, "limit": units.input, "kp": units.kp, "ki": units.ki},
        "limit": float(design.limits[number - 1]),
        **_gains(servo.gains),
        "filters": [
            {"hz" if key == "frequency_hz" else key: value for key, value in asdict(one).items()}
            for one in servo.gains.filters
        ],
        "law": _law(servo.gains.law()),
        "bandwidth_is_limited_by": servo.limit,
        "margins": _margins(design, servo.results.margins),
        "step": _step(servo.results.steps),
        "current": current,
    }


def _gains(gains: Gains) -> dict[str, float]:
    return {"kp": gains.kp, "ki": gains.ki, "position_gain": gains.position_gain}


def _law(law: ControlLaw) -> dict[str, Any]:
    return {
        "states": law.names,
        **{name: getattr(law, name).tolist() for name in "ABCDE"},
        "holds": law.holds.tolist(),
        "rest": law.rest().tolist(),
    }


def _margins(design: ServoDesign, margins: Margins) -> dict[str, Any]:
    """By name: the smallest margin, its frequency and plant, and the median of all plants."""
    return {
        one.name: {
            "unit": one.unit,
            "required": one.required,
            "worst": one.least,
            "worst_hz": one.frequency_hz,
            "worst_condition": int(design.condition[one.plant]),
            "worst_draw": int(design.draw[one.plant]),
            "median": one.median,
        }
        for one in margin_summaries(margins, design.options.required)
    }


def _step(steps: Steps) -> dict[str, Any]:
    return {
        name: {"worst": float(values.max()), "median": float(np.median(values))}
        for name, values in (("settling", steps.settling), ("overshoot", steps.overshoot))
    }


def _shaper(ranked: RankedShaper) -> dict[str, Any]:
    return {
        "parts": [
            {"kind": one.kind, "hz": one.omega / (2.0 * np.pi), "damping": one.damping}
            for one in ranked.shapers
        ],
        "samples": ranked.samples,
        "times": ranked.times,
        "amplitudes": ranked.amplitudes,
        "duration": ranked.impulses.duration,
        "vibration": ranked.vibration,
        "is_sufficient": ranked.is_sufficient,
    }


def _observer(design: ServoDesign, observer: Observer) -> dict[str, Any]:
    system = observer.system
    errors = [one for one in design.estimation if one.joint == observer.joint]
    return {
        "joint": observer.joint,
        "inputs": system.inputs,
        "outputs": OUTPUTS,
        "states": system.states,
        **{name: getattr(system, name).tolist() for name in "ABCD"},
        "readings": [
            {name: getattr(one, name) for name in _READING} for one in observer.measurements
        ],
        "unused": observer.unused,
        "link_inertia": observer.link_inertia,
        "rms_errors": {name: getattr(one, name) for one in errors for name in _ERRORS},
    }


def _damping(design: ServoDesign, damping: Damping) -> dict[str, Any]:
    return {
        "joint": damping.joint,
        "torsion_gain": damping.gains[0],
        "torsion_rate_gain": damping.gains[1],
        "is_used": not damping.reason,
        "reason": damping.reason,
        "ratio_without": dict(zip(("least", "median"), damping.without, strict=True)),
        "ratio_with": dict(zip(("least", "median"), damping.with_feedback, strict=True)),
        "margins": damping.margins and _margins(design, damping.margins),
        "law": None if damping.reason else _law(damping.law),
    }


def _finite(value: Any) -> Any:
    """The document with null for numbers that JSON lacks."""
    if isinstance(value, Mapping):
        return {key: _finite(one) for key, one in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(one) for one in value]
    return None if isinstance(value, float) and not np.isfinite(value) else value
