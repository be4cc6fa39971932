"""Physical ranges of parameters: the one place that says which values an arm can have."""

from __future__ import annotations

from collections.abc import Mapping

from strainwave.domain.gear_laws import Range, gear_parameters

_RANGES: Mapping[str, Range] = {
    "alpha": "positive",
    "beta": "positive",
    "gamma": "any",  # of its own; with alpha and beta gamma^2 < alpha beta
    "gravity_torque_1": "any",
    "gravity_torque_2": "any",
    "rigid_inertia": "positive",
    "inertia": "positive",
    "motor_inertia": "positive",
    "link_inertia": "positive",
    "motor_viscous_friction": "non-negative",
    "link_viscous_friction": "non-negative",
    "total_viscous_friction": "non-negative",
    "motor_coulomb_friction": "non-negative",
    "friction_offset": "any",
    "friction_settling_time": "non-negative",
    "gear_damping": "non-negative",
    "stribeck_friction": "non-negative",
    "stribeck_velocity": "positive",
    "hysteresis_torque": "non-negative",
    "hysteresis_twist": "positive",
    "kinematic_error_cos": "any",
    "kinematic_error_sin": "any",
}


def physical_ranges() -> Mapping[str, Range]:
    """By parameter name, in the order of tables; a sensor's constant has none.

    Returns
    -------
    dict
        Those of gears before their damping.
    """
    gears = {name: parameter.range for name, parameter in gear_parameters().items()}
    at = list(_RANGES).index("gear_damping")
    ranges = list(_RANGES.items())
    return dict([*ranges[:at], *gears.items(), *ranges[at:]])


def physical_range(name: str) -> Range:
    """The range of one parameter.

    Parameters
    ----------
    name : str
        As in docs/notation.md.

    Returns
    -------
    "positive", "non-negative" or "any"
    """
    of_gear = gear_parameters().get(name)
    return of_gear.range if of_gear is not None else _RANGES.get(name, "any")


def is_physical(name: str, value: float) -> bool:
    """Whether an arm can have this value.

    Parameters
    ----------
    name : str
        As in docs/notation.md.
    value : float [SI]

    Returns
    -------
    bool
        False for what is not finite, too.
    """
    if not abs(value) < float("inf"):
        return False
    least = physical_range(name)
    return least == "any" or value > 0.0 or (value == 0.0 and least == "non-negative")
