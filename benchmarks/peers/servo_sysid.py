"""Position servos fitted by mujoco.sysid, by its recipe: rollouts of a pendulum with a `position`
actuator, the delay as a parameter of the sensor, and Gauss-Newton with finite differences.

The goal is held between samples, as by the servo; known gains and weights are given.
"""

from __future__ import annotations

import io
from collections.abc import Callable
from contextlib import redirect_stdout
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.families.servos import ServoRig
from strainwave.domain import FloatArray

_STEP = 1e-3  # [s] of MuJoCo
_LENGTH = 0.1  # [m] of the pendulum, whose mass stands for the gravity torque
_GRAVITY = 9.81  # [m/s^2]
_FACTOR = 30.0  # bounds of a parameter around its start
_MAX_DELAY = 0.05  # [s]
_COUNT = 2.0 * np.pi / 4096


def fit_by_sysid(
    rig: ServoRig, folder: Path, start: dict[str, float]
) -> tuple[dict[str, float], dict[str, float]]:
    """Values by name, and half-widths of their 95 % intervals, from the fitted records.

    `start` has the starting value of every parameter; kp is held where the study states it.
    """
    import mujoco
    from mujoco import sysid

    def setter(change: Callable[[Any, float], None]) -> Callable[[Any, Any], None]:
        return lambda spec, parameter: change(spec, float(np.exp(parameter.value[0])))

    def set_kp(spec: Any, kp: float) -> None:
        actuator = spec.actuators[0]
        actuator.gainprm[0], actuator.biasprm[1] = kp, -kp

    def set_limit(spec: Any, limit: float) -> None:
        spec.actuators[0].forcerange = [-limit, limit]

    changes: dict[str, Callable[[Any, float], None]] = {
        "armature": lambda spec, x: setattr(spec.joints[0], "armature", x),
        "gravity_torque_1": lambda spec, x: setattr(
            spec.body("link"), "mass", x / _GRAVITY / _LENGTH
        ),
        "motor_coulomb_friction": lambda spec, x: setattr(spec.joints[0], "frictionloss", x),
        "servo_damping": lambda spec, x: (
            setattr(spec.joints[0], "damping", [x, 0.0, 0.0])
            if np.ndim(spec.joints[0].damping)
            else setattr(spec.joints[0], "damping", x)
        ),
        "servo_kp": set_kp,
        "torque_limit": set_limit,
    }
    parameters = sysid.ParameterDict()
    for name, change in changes.items():
        x, reach = np.log(start[name]), np.log(_FACTOR)
        parameters.add(
            sysid.Parameter(
                name,
                x,
                x - reach,
                x + reach,
                frozen=name == "servo_kp" and rig.states_scale,
                modifier=setter(change),
            )
        )
    parameters.add(sysid.Parameter("servo_delay", start["servo_delay"], 0.0, _MAX_DELAY))
    groups = []
    for name in ("multisine", "chirp", "loaded"):
        file = folder / f"{name}.csv"
        if file.exists():
            spec = mujoco.MjSpec.from_string(_model(rig, start, payload=name == "loaded"))
            groups.append(_sequences(spec, name, np.loadtxt(file, delimiter=",", skiprows=1)))

    def compare(params: Any, predicted: Any, measured: Any, *_: Any, **__: Any) -> Any:
        delay = float(params["servo_delay"].value[0])
        inside = measured.times > _MAX_DELAY + _STEP
        late = sysid.apply_resample_and_delay(predicted, measured.times[inside], delay)
        return (late.data - measured.data[inside]) / _COUNT, late, late

    residual = sysid.build_residual_fn(
        models_sequences=groups, modify_residual=compare, resample_true=False
    )
    with redirect_stdout(io.StringIO()):  # its optimiser prints each iteration
        fit, outcome = sysid.optimize(parameters, residual, verbose=False, eps=1e-4)
    residuals, _, _ = residual(fit.as_vector(), fit)
    _, widths = sysid.calculate_intervals([r.ravel() for r in residuals], outcome.jac)
    free = [name for name in (*changes, "servo_delay") if not fit[name].frozen]
    half = dict(zip(free, widths.tolist(), strict=True))
    values = {n: float(np.exp(fit[n].value[0])) for n in changes}
    half = {n: w * values.get(n, 1.0) for n, w in half.items()}
    values["servo_delay"] = float(fit["servo_delay"].value[0])
    values["inertia"] = values["armature"] + values["gravity_torque_1"] * _LENGTH / _GRAVITY
    half["inertia"] = half["armature"]
    return values, half


def _model(rig: ServoRig, start: dict[str, float], *, payload: bool) -> str:
    mass, x = rig.payload
    load = (
        f'<body pos="{x} 0 0"><inertial pos="0 0 0" mass="{mass}" diaginertia="1e-9 1e-9 1e-9"/>'
        "</body>"
    )
    weight, kp = start["gravity_torque_1"] / _GRAVITY / _LENGTH, start["servo_kp"]
    return (
        f'<mujoco><compiler angle="radian"/><option timestep="{_STEP}" gravity="0 0 {-_GRAVITY}" '
        'integrator="implicitfast"><flag contact="disable"/></option><worldbody>'
        '<body name="link"><joint name="joint" type="hinge" axis="0 -1 0"/>'
        f'<inertial pos="{_LENGTH} 0 0" mass="{weight}" diaginertia="1e-9 1e-9 1e-9"/>'
        f"{load if payload else ''}</body></worldbody>"
        f'<actuator><position name="servo" joint="joint" kp="{kp}" forcelimited="true" '
        f'forcerange="{-start["torque_limit"]} {start["torque_limit"]}"/></actuator>'
        '<sensor><jointpos name="angle" joint="joint"/></sensor></mujoco>'
    )


def _sequences(spec: Any, name: str, log: FloatArray) -> Any:
    from mujoco import sysid

    time, goal, angle = log.T
    model = spec.compile()
    fine = _STEP * np.arange(round(time[-1] / _STEP) + 1)
    held = goal[np.searchsorted(time, fine + 0.5 * _STEP, side="right") - 1]
    controls = sysid.TimeSeries.from_control_names(fine, held[:, None], model, ["servo"])
    measured = sysid.TimeSeries.from_names(time, angle[:, None], model)
    initial = sysid.create_initial_state(model, np.array([angle[0]]))
    return sysid.ModelSequences(name, spec, [name], [initial], [controls], [measured])
