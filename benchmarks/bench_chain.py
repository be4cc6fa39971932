"""One step of serial chains with elastic joints, against MuJoCo and Pinocchio.

Drawn chains of three, six and seven joints under a 5 V PRBS on every motor, in steps of 0.25 ms.
MuJoCo integrates the exported chain by Runge-Kutta. Pinocchio computes the accelerations of the
rigid links alone, four times as a Runge-Kutta step does, called from Python.
"""

from __future__ import annotations

from itertools import count
from typing import Any

import numpy as np

from benchmarks.studies.drawn_chains import Chain, draw_chain
from benchmarks.timing import Row, best_of
from strainwave.domain import FloatArray, Parameter, Prbs
from strainwave.dynamics import excitation
from strainwave.dynamics.arm import Arm
from strainwave.export.mjcf import to_mjcf
from strainwave.export.source import IdentifiedArm
from strainwave.export.urdf import to_urdf

STEP = 2.5e-4  # [s]
STEPS_PER_TICK = 4
TICKS = 1023
STEPS = STEPS_PER_TICK * TICKS


def rows() -> list[Row]:
    table = []
    for n in (3, 6, 7):
        chain = _draw(n)
        plain, directions = _time_step(chain), _directions(Arm.of(chain.study.arm))
        derivatives = _time_derivatives(chain)
        task = f"a step of {n} joints"
        table += [
            Row(task, plain, "MuJoCo, RK4", _mujoco(chain)),
            Row(task, plain, "Pinocchio, 4 ABA of the links", _pinocchio(chain)),
            Row(
                f"{task} with {len(directions)} derivatives",
                derivatives,
                f"{len(directions)} more simulations",
                (len(directions) + 1) * plain,
            ),
        ]
    return table


def _draw(n: int) -> Chain:
    """The first chain of n joints without IMUs."""
    chains = (draw_chain(seed) for seed in count())
    return next(c for c in chains if c.study.arm.n_joints == n and c.sensors == "motor")


def _voltage(n: int) -> FloatArray:
    period = excitation.prbs(Prbs(10, 1e-3, 1, 5.0))
    return np.column_stack([np.roll(period, 97 * i) for i in range(n)])


def _experiment(n: int) -> dict[str, Any]:
    return {
        "voltage": _voltage(n),
        "motor_angle": (0.0,) * n,
        "step": STEP,
        "steps_per_tick": STEPS_PER_TICK,
        "steps_per_sample": STEPS_PER_TICK,
        "samples": TICKS,
        "record": ["motor_velocity"],
    }


def _time_step(chain: Chain) -> float:
    arm = Arm.of(chain.study.arm)
    values = arm.parameter_vector(chain.values)[None, :]
    experiment = arm.core.experiment(**_experiment(arm.n_joints))
    return best_of(lambda: arm.core.simulate(values, [experiment])) / STEPS


def _directions(arm: Arm) -> list[tuple[str, int | None]]:
    """All base parameters, and those of motors and gears."""
    return [key for key in arm.parameter_names if key[0] != "friction_settling_time"]


def _time_derivatives(chain: Chain) -> float:
    arm = Arm.of(chain.study.arm)
    values, names = arm.parameter_vector(chain.values), _directions(arm)
    experiment = arm.core.experiment(**_experiment(arm.n_joints))

    def run() -> None:
        arm.core.sensitivities(values, experiment, names)

    return best_of(run, repeats=3) / STEPS


def _identified(chain: Chain) -> IdentifiedArm:
    parameters = tuple(
        Parameter(name, joint, value, 0.0, "1", "tuned")
        for (name, joint), value in chain.values.items()
    )
    return IdentifiedArm(chain.study, parameters, "truth", standard=chain.values)


def _mujoco(chain: Chain) -> float | None:
    try:
        import mujoco
    except ImportError:
        return None
    model = mujoco.MjModel.from_xml_string(to_mjcf(_identified(chain)).data.decode())
    model.opt.timestep = STEP
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_RK4
    data, voltage = mujoco.MjData(model), _voltage(chain.study.arm.n_joints)

    def run() -> None:
        mujoco.mj_resetData(model, data)
        for k in range(STEPS):
            if k % STEPS_PER_TICK == 0:
                data.ctrl[:] = voltage[k // STEPS_PER_TICK]
            mujoco.mj_step(model, data)

    return best_of(run, repeats=3) / STEPS


def _pinocchio(chain: Chain) -> float | None:
    try:
        import pinocchio
    except ImportError:
        return None
    model = pinocchio.buildModelFromXML(to_urdf(_identified(chain)).data.decode())
    data = model.createData()
    rates = np.random.default_rng(0).normal(size=(1000, 2, model.nv))
    postures = [pinocchio.integrate(model, pinocchio.neutral(model), v) for v, _ in rates]

    def run() -> None:
        for q, (v, torque) in zip(postures, rates, strict=True):
            pinocchio.aba(model, data, q, v, torque)

    return 4.0 * best_of(run) / len(rates)
