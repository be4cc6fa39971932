"""The servo as objects of python-control."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from strainwave.domain.control_law import INPUTS, ControlLaw
from strainwave.errors import import_optional
from strainwave.servo_design.design import ServoDesign
from strainwave.servo_design.observer import OUTPUTS

if TYPE_CHECKING:
    from control import StateSpace


def state_names(law: ControlLaw) -> list[str]:
    """Names of the states of a law as identifiers."""
    words = (name.replace("-", " ").replace(",", " ").split() for name in law.names)
    return ["_".join(each) for each in words]


def controllers(design: ServoDesign) -> list[StateSpace]:
    """Discrete state-space system of each joint: `INPUTS` to `voltage`, not limited.

    The limit, the hold of integrators and the feed-forward are not linear parts of the law and are
    absent. Raises `InvalidInput` if python-control is missing.
    """
    control = import_optional("control", "a controller as state-space object", "control")
    systems = []
    for number, gains in enumerate(design.gains, start=1):
        law = gains.law()
        systems.append(
            control.ss(
                law.A + np.outer(law.E, law.C),
                law.B + np.outer(law.E, law.D),
                law.C[None],
                law.D[None],
                dt=gains.period,
                name=f"servo_{number}",
                states=state_names(law),
                inputs=list(INPUTS),
                outputs=["voltage"],
            )
        )
    return systems


def observers(design: ServoDesign) -> list[StateSpace]:
    """Discrete state-space system of each elastic joint, from its inputs to `OUTPUTS`.

    The inputs are that of the drive, the interaction torque and the readings. Raises `InvalidInput`
    if python-control is missing.
    """
    control = import_optional("control", "an observer as state-space object", "control")
    systems = []
    for observer in design.observers:
        system = observer.system
        systems.append(
            control.ss(
                *(system.A, system.B, system.C, system.D),
                dt=observer.period,
                name=f"observer_{observer.joint}",
                states=list(system.states),
                inputs=list(system.inputs),
                outputs=list(OUTPUTS),
            )
        )
    return systems
