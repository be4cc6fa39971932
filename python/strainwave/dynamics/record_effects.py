"""Record effects: effects that act through the inputs of the core, separately in each record.

A size s of such an effect acts only through parameters and initial states u of the core, so that
the derivative of a channel is dy/ds = (dy/du) (du/ds).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from strainwave.domain import FloatArray, Payload
from strainwave.domain.effects import Input, RecordEffect, all_effects, effect_named
from strainwave.domain.keys import Key, Values
from strainwave.domain.parameter_table import base_name, of_record
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.simulation import Drive

_MOTOR_ANGLE, _LINK_ANGLE = "initial_motor_angle", "initial_link_angle"
_INITIAL_STATES = (_MOTOR_ANGLE, _LINK_ANGLE)


@dataclass(frozen=True, slots=True)
class RecordInputs:
    """Inputs of the core for one record, and their derivatives with respect to the parameters."""

    values: Values  # parameters
    offsets: Mapping[Key, float]  # increments of initial states
    slopes: Mapping[Key, Mapping[Key, float]]  # derivatives by input of the core and parameter

    def shift_start(self, drive: Drive) -> Drive:
        """Drive with shifted initial states."""
        if not self.offsets:
            return drive
        motor = self._shifted(_MOTOR_ANGLE, drive.motor_angle)
        link = drive.link_angle and self._shifted(_LINK_ANGLE, drive.link_angle)
        return replace(drive, motor_angle=motor, link_angle=link)

    def _shifted(self, name: str, angles: Sequence[float]) -> tuple[float, ...]:
        joints = enumerate(angles, start=1)
        return tuple(angle + self.offsets.get((name, joint), 0.0) for joint, angle in joints)

    def read(self, angles: FloatArray, arm: Arm | None = None) -> FloatArray:
        """Encoder readings of motor angles (n_samples, n_joints) [rad] with shifted zeros.

        For link angles, pass the arm.
        """
        zeros = np.array(self._shifted(_MOTOR_ANGLE, [0.0] * angles.shape[1]))
        return angles - (zeros if arm is None else arm.links_of(zeros))

    def directions(self, parameters: Sequence[Key]) -> list[Key]:
        """Directions in which the core must differentiate to give derivatives by the parameters."""
        sizes, requested = _sizes(), set(parameters)
        directions = [key for key in parameters if base_name(key[0]) not in sizes]
        slopes = self.slopes.items()
        return directions + [
            k for k, row in slopes if k not in requested and requested & row.keys()
        ]

    def by_parameters(
        self, tangent: FloatArray, directions: Sequence[Key], parameters: Sequence[Key]
    ) -> FloatArray:
        """Derivatives with respect to parameters from those in the directions of the core.

        Further entries of the last axis of `tangent` do not change.
        """
        if not self.slopes and list(directions) == list(parameters):
            return tangent
        chain = np.zeros((len(directions), len(parameters)))
        column = {key: k for k, key in enumerate(parameters)}
        for row, key in enumerate(directions):
            for by, slope in self.slopes.get(key, {key: 1.0}).items():
                if by in column:
                    chain[row, column[by]] = slope
        n = len(directions)
        return np.concatenate([tangent[..., :n] @ chain, tangent[..., n:]], axis=-1)


def record_inputs(
    arm: Arm, values: Values, record: str, *, hanging: bool, payload: Payload | None = None
) -> RecordInputs:
    """Inputs of the core for a record of an arm with record effects.

    An effect whose size is missing in `values` is absent. `hanging` states that the links start in
    static equilibrium and therefore follow the motors. A payload adds to the parameters of the last
    link.
    """
    changed: dict[Key, tuple[Input, Mapping[str, str]]] = {
        (change.name, number): (change, names)
        for number, joint in enumerate(arm.joints, start=1)
        for effect in map(effect_named, joint.named_effects)
        if isinstance(effect, RecordEffect)
        for change, names in _inputs_of(effect, number, joint.gear_ratio, values, record)
        if not (hanging and change.name == _LINK_ANGLE)
    }
    parameters, offsets = dict(values), Values()
    if payload is not None:
        last = arm.base_names[-len(payload.parameters) :]
        carried = zip(last, payload.parameters, strict=True)
        parameters |= {key: values.get(key, 0.0) + value for key, value in carried}
    slopes: dict[Key, dict[Key, float]] = {}
    for key, (change, names) in changed.items():
        (offsets if key[0] in _INITIAL_STATES else parameters)[key] = change.value
        slopes[key] = {(names.get(by, by), key[1]): slope for by, slope in change.slopes.items()}
    return RecordInputs(parameters, offsets, slopes)


def _inputs_of(
    effect: RecordEffect, number: int, gear_ratio: float, values: Values, record: str
) -> Iterator[tuple[Input, Mapping[str, str]]]:
    """Changes by one effect, each with the names of its sizes in `values`."""
    names = {name: of_record(name, record) if effect.by_record else name for name in effect.sizes}
    known = {name: value for (name, joint), value in values.items() if joint == number}
    known |= {name: values.get((record_name, number), 0.0) for name, record_name in names.items()}
    for change in effect.inputs(known, gear_ratio):
        yield change, names


def _sizes() -> set[str]:
    """Names of the sizes of all record effects."""
    effects = (effect for effect in all_effects() if isinstance(effect, RecordEffect))
    return {name for effect in effects for name in effect.sizes}
